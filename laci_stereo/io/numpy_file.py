"""Arrays in NumPy's ``.npy`` and ``.npz`` files, read without trust in what their headers promise."""

from __future__ import annotations

import io
import zipfile
from typing import Any

import numpy as np
import numpy.typing as npt

from laci_stereo.core.errors import InputError
from laci_stereo.io.text_file import quoted

ARCHIVE_MAGIC = b"PK\x03\x04"

LARGEST_RATIO = 1100
"""Deflate compresses data by a factor of at most 1032."""

_HEADER_AT = 12
"""Offset of the header, after magic number, version and length."""


def archived(
    content: bytes, what: str, error: type[InputError], *, largest: int | None = None, most: int | None = None
) -> dict[str, npt.NDArray[Any]]:
    """Return the arrays of an archive (``.npz``) by their names.

    Parameters
    ----------
    content : bytes
    what : str
        The file, for errors.
    error : type of InputError
    largest : int or None
        Arrays of more bytes are left out.
    most : int or None
        Largest size of all arrays together, bytes.

    Raises
    ------
    InputError
        Of the class ``error``, if the archive is damaged or too large, or as in `array_in`.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
            unpacked = sum(member.file_size for member in members)
            if most is not None and unpacked > most:
                raise error(f"{what} unpacks to {unpacked} bytes; needed are at most {most}")
            return {
                member.filename.removesuffix(".npy"): _member(archive, member, what, error)
                for member in members
                if largest is None or member.file_size <= largest
            }
    except error:
        raise
    except Exception as problem:  # of many types: the bytes may be anything
        raise error(f"{what} is damaged: {quoted(str(problem))}; needed is a whole archive of arrays") from problem


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, what: str, error: type[InputError]) -> npt.NDArray[Any]:
    if member.file_size > LARGEST_RATIO * max(member.compress_size, 1):
        raise error(
            f"{what}: {quoted(member.filename)} promises {member.file_size} bytes from {member.compress_size}; "
            "needed is an archive that NumPy wrote"
        )
    return array_in(archive.read(member), f"{what}, array {quoted(member.filename)}", error)


def array_in(content: bytes, what: str, error: type[InputError]) -> npt.NDArray[Any]:
    """Return the array of a file (``.npy``). Pickles are never loaded.

    Raises
    ------
    InputError
        Of the class ``error``, if it is damaged, or a pickle.
    """
    stream = io.BytesIO(content)
    if b"\\" in content[_HEADER_AT : content.find(b"\n", _HEADER_AT)]:  # NumPy would parse it as Python, with a warning
        raise error(f"{what} is no array: its header holds a backslash; needed is a file that NumPy wrote")
    try:
        version = np.lib.format.read_magic(stream)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read_header(stream)
    except Exception as problem:  # exceptions of many types: a header is parsed as Python
        raise error(f"{what} is no array: {quoted(str(problem))}; needed is a file that NumPy wrote") from problem
    if dtype.hasobject:
        raise error(
            f"{what} is a pickle (type {quoted(str(dtype))}), which is never loaded; needed is an array of numbers"
        )
    count = 1
    for length in shape:
        count *= max(int(length), 0)
    following = len(content) - stream.tell()
    if dtype.itemsize == 0 or count * dtype.itemsize > following:
        raise error(
            f"{what} is cut off: its header promises {quoted(str(shape))} values of {dtype.itemsize} bytes, and "
            f"{following} bytes follow"
        )
    values: npt.NDArray[Any] = np.frombuffer(content, dtype, count, stream.tell())
    return values.reshape(shape, order="F" if fortran else "C")
