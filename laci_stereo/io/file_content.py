"""The bytes of a file, as they are or unpacked if it is compressed by gzip."""

from __future__ import annotations

import gzip
import zlib
from io import BytesIO
from pathlib import Path

from laci_stereo.core.errors import InputError

GZIP_MAGIC = b"\x1f\x8b"

LFS_MAGIC = b"version https://git-lfs"
"""With which begins what stands instead of a large file in a checkout without it."""

MCAP_MAGIC, SQLITE_MAGIC = b"\x89MCAP0\r\n", b"SQLite format 3\x00"
BAG_MAGICS = (b"#ROSBAG", MCAP_MAGIC, SQLITE_MAGIC)
"""First bytes of ROS 1 bags, MCAP files and ROS 2 bags."""

LARGEST_UNPACKED = 1 << 28
"""Bytes: an hour of a dozen senders' messages as text. A file that unpacks to more may be crafted to exhaust the
memory."""


def begins_with(path: Path, magics: tuple[bytes, ...]) -> bool:
    """Return whether a file begins with one of several magic numbers; False if unreadable, which reading reports."""
    try:
        with path.open("rb") as stream:
            return stream.read(max(map(len, magics))).startswith(magics)
    except (OSError, ValueError):
        return False


def read_bytes(path: Path, error: type[InputError], needed: str = "a file", largest: int | None = None) -> bytes:
    """Return the content of a file.

    Parameters
    ----------
    path : Path
    error : type of InputError
    needed : str
        What the file should be, with its article.
    largest : int or None
        Largest size, bytes.

    Raises
    ------
    InputError
        Of the class ``error``, if the file is missing, a folder, unreadable, too large or a pointer of Git LFS.
    """
    try:
        if largest is not None and (size := path.stat().st_size) > largest:
            raise error(f"{path} has {size} bytes; needed is {needed}, of at most {largest}")
        content = path.read_bytes()
    except FileNotFoundError:
        raise error(f"{path} does not exist; needed is {needed}") from None
    except (OSError, ValueError) as problem:
        if path.is_dir():  # which Windows does not tell
            raise error(f"{path} is a folder; needed is {needed}") from None
        why = getattr(problem, "strerror", None) or problem
        raise error(f"{path} cannot be read: {why}; needed is {needed}") from problem
    if content.startswith(LFS_MAGIC):
        raise error(f"{path} is a pointer of Git LFS, not the file itself; needed is that (git lfs pull)")
    return content


def read_content(path: Path, error: type[InputError], needed: str = "a file", largest: int | None = None) -> bytes:
    """Return the content of a file, unpacked if it is compressed by gzip; parameters are those of `read_bytes`.

    Raises
    ------
    InputError
        As in `read_bytes`, or if the packed content is damaged or unpacks to more than `LARGEST_UNPACKED`.
    """
    content = read_bytes(path, error, needed, largest)
    return _unpacked(path, content, error) if content.startswith(GZIP_MAGIC) else content


def _unpacked(path: Path, packed: bytes, error: type[InputError]) -> bytes:
    try:
        with gzip.GzipFile(fileobj=BytesIO(packed)) as stream:
            content = stream.read(LARGEST_UNPACKED + 1)
    except (OSError, EOFError, zlib.error) as problem:
        raise error(f"{path} is damaged: {problem}; needed is a whole gzip file") from problem
    if len(content) > LARGEST_UNPACKED:
        raise error(f"{path} unpacks to more than {LARGEST_UNPACKED} bytes; needed is a smaller file, or it unpacked")
    return content
