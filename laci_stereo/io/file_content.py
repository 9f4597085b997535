"""The bytes of a file, unpacked if it is compressed by gzip."""

from __future__ import annotations

import gzip
import zlib
from io import BytesIO
from pathlib import Path

from laci_stereo.core.errors import InputError

GZIP_MAGIC = b"\x1f\x8b"

LFS_MAGIC = b"version https://git-lfs"
LFS_POINTER = "a pointer of Git LFS, not the file itself; needed is that (git lfs pull)"
"""What stands instead of a large file in a checkout without it, and the remedy."""

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


def read_content(path: Path, error: type[InputError]) -> bytes:
    """Return the content of a file, unpacked if it is compressed by gzip.

    Raises
    ------
    InputError
        Of the class ``error``, if the file is missing, a folder or unreadable, or if its packed content is damaged or
        too large.
    """
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise error(f"{path} does not exist; needed is a file") from None
    except IsADirectoryError:
        raise error(f"{path} is a folder; needed is a file") from None
    except OSError as problem:
        raise error(f"{path} cannot be read: {problem.strerror}; needed is a file") from problem
    except ValueError as problem:
        raise error(f"{path} cannot be read: {problem}; needed is a file") from problem
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
