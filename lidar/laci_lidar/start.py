"""Entry point of the console script."""

from laci_stereo.start import start


def main() -> None:
    """Run ``laci-lidar``."""
    start("laci_lidar.cli")
