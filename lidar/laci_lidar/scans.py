"""Opening of a user's recording: a folder of scans or a bag."""

from __future__ import annotations

from pathlib import Path

from laci_lidar.errors import ScanError
from laci_lidar.folder import ScanFolder
from laci_lidar.read import SUFFIXES
from laci_lidar.sequence import ScanSequence
from laci_stereo.io.cam.packet_capture import PCAP_FORMATS, PCAPNG_MAGIC
from laci_stereo.io.file_content import BAG_MAGICS, begins_with

_BAG_SUFFIXES = (".bag", ".mcap", ".db3")
_CAPTURE_SUFFIXES = frozenset({".pcap", ".pcapng"})


def open_scans(path: Path, topic: str | None = None) -> ScanSequence:
    """Open a folder of scans, a ROS 1 bag, a ROS 2 bag or an MCAP file; without a topic, its only one with clouds.

    Raises
    ------
    ScanError
        If the path is none of these, or unusable.
    """
    if _is_bag(path):
        try:
            from laci_lidar.bag import BagScans
        except ImportError as problem:
            raise ScanError(
                f"{path}: reading bags needs the extra 'bag' ({problem.name} is not installed); "
                "needed is pip install 'laci-stereo[bag]'"
            ) from problem
        return BagScans.open(path, topic)
    if path.is_file() and path.suffix.lower() in SUFFIXES:
        raise ScanError(f"{path} is a single scan; needed is the folder with all of them, or a bag")
    if _is_capture(path):
        raise ScanError(
            f"{path} is a packet capture of a scanner, which only its maker's software decodes; needed are scans as "
            "that exports them, such as PCD, or a bag of its ROS driver's point clouds"
        )
    if topic is not None:
        raise ScanError(f"{path} is no bag, and has no topic {topic!r}; needed is a bag, or no topic")
    return ScanFolder.open(path)


def _is_capture(path: Path) -> bool:
    """Return whether a path is a packet capture, or a folder that contains captures and no scan."""
    if path.is_dir():
        inside = [entry.suffix.lower() for entry in path.iterdir()]
        return not SUFFIXES.intersection(inside) and bool(_CAPTURE_SUFFIXES.intersection(inside))
    return begins_with(path, (*PCAP_FORMATS, PCAPNG_MAGIC))


def _is_bag(path: Path) -> bool:
    if path.is_dir():
        return (path / "metadata.yaml").is_file() or any(
            entry.suffix in _BAG_SUFFIXES[1:] and entry.is_file() for entry in path.iterdir()
        )
    return begins_with(path, BAG_MAGICS) or (path.is_file() and path.suffix.lower() in _BAG_SUFFIXES)
