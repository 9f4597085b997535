"""Where the console script begins."""

from laci_stereo.start import start


def main() -> None:
    """Run ``laci-lidar``."""
    start("laci_lidar.cli")
