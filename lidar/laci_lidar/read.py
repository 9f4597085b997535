"""Reading of one scan from a file of any format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from laci_lidar.arrays import read_bin, read_npy, read_npz
from laci_lidar.columns import Columns
from laci_lidar.errors import ScanError
from laci_lidar.pcd import is_pcd, read_pcd
from laci_lidar.ply import is_ply, read_ply
from laci_lidar.scan import Scan, scan_of
from laci_stereo.io.file_content import read_bytes

LARGEST_FILE = 1 << 30
"""Size of a scan with ten million points and ten fields; a larger file is a whole recording."""

_HEAD = 512


@dataclass(frozen=True)
class ScanFormat:
    """A file format of scans.

    Attributes
    ----------
    name : str
    suffixes : tuple of str
        Suffixes of file names, lower case.
    begins : callable
        Returns whether a file has this format, from its first bytes.
    read : callable
        Returns the columns of a file's content; the second argument names the file in errors.
    """

    name: str
    suffixes: tuple[str, ...]
    begins: Callable[[bytes], bool]
    read: Callable[[bytes, str], Columns]


def _read_las(content: bytes, what: str) -> Columns:
    try:
        from laci_lidar.las import read_las
    except ImportError as problem:
        raise ScanError(
            f"{what}: reading LAS and LAZ needs the extra 'las' ({problem.name} is not installed); "
            "needed is pip install 'laci-stereo[las]'"
        ) from problem
    return read_las(content, what)


KITTI_FORMAT = ScanFormat("KITTI", (".bin",), lambda _: False, read_bin)
"""Numbers without a header: the content does not identify the format."""

FORMATS = (
    ScanFormat("PCD", (".pcd",), is_pcd, read_pcd),
    ScanFormat("PLY", (".ply",), is_ply, read_ply),
    ScanFormat("LAS", (".las", ".laz"), lambda head: head.startswith(b"LASF"), _read_las),
    ScanFormat("npy", (".npy",), lambda head: head.startswith(b"\x93NUMPY"), read_npy),
    ScanFormat("npz", (".npz",), lambda head: head.startswith(b"PK\x03\x04"), read_npz),
    KITTI_FORMAT,
)

SUFFIXES = frozenset(suffix for known in FORMATS for suffix in known.suffixes)


def read_scan(path: Path, stamp_ns: int | None = None) -> Scan:
    """Read a scan: PCD, PLY, LAS, LAZ, KITTI's .bin, .npy or .npz.

    The format is recognised by the content, that of KITTI, which has no signature, by the name. The points' own times
    may refer to the scan's Unix time, ``stamp_ns``.

    Raises
    ------
    ScanError
        If the file is missing, damaged, of another format than its name says, or contains no points in metres.
    """
    what = str(path)
    content = read_bytes(path, ScanError, "a scan", LARGEST_FILE)
    if not content:
        raise ScanError(f"{path} is empty (0 bytes); needed is a scan")
    return scan_of(_format(content, path).read(content, what), what, stamp_ns)


def _format(content: bytes, path: Path) -> ScanFormat:
    head = content[:_HEAD]
    found = next((known for known in FORMATS if known.begins(head)), None)
    by_name = next((known for known in FORMATS if path.suffix.lower() in known.suffixes), None)
    if found is not None and by_name is not None and found is not by_name:
        raise ScanError(
            f"{path} is a {found.name} file by its content; needed is {by_name.name} as its name says, or a name that "
            f"ends in {found.suffixes[0]}"
        )
    if found is None and by_name is not KITTI_FORMAT:
        named = f"no {by_name.name} file" if by_name is not None else "of no known format"
        raise ScanError(
            f"{path} is {named}: it begins with {head[:8]!r}; needed is PCD, PLY, LAS, LAZ, .bin, .npy or .npz"
        )
    return found or KITTI_FORMAT
