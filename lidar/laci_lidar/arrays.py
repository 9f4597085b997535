"""Point arrays: NumPy's ``.npy`` and ``.npz``, and KITTI's ``.bin`` without a header."""

from __future__ import annotations

import io
import zipfile
import zlib
from typing import Any

import numpy as np
import numpy.typing as npt

from laci_lidar.columns import Columns
from laci_lidar.errors import ScanError
from laci_stereo.io.text_file import listed, quoted

KITTI = ("x", "y", "z", "intensity")
LARGEST_RATIO = 1100
"""Deflate compresses data by a factor of at most 1032."""

_HEADER_AT = 12
"""Offset of the header, after magic number, version and length."""

_POINTS = ("points", "xyz", "points_xyz", "pointcloud", "point_cloud", "cloud", "pcd", "data", "arr_0")


def read_bin(content: bytes, what: str) -> Columns:
    """Read a KITTI file: x, y, z and intensity of each point as float32, and nothing else.

    Raises
    ------
    ScanError
        If the content is not points of four numbers.
    """
    if len(content) % 16:
        raise ScanError(f"{what} has {len(content)} bytes; needed are 16 for each point: x, y, z, intensity as float32")
    values = np.frombuffer(content, "<f4").reshape(-1, 4)
    wrong = np.flatnonzero(~(values[:, 3] >= 0.0))
    if len(wrong):
        raise ScanError(
            f"{what}: the fourth number of point {wrong[0]} is {values[wrong[0], 3]:g}; needed is an intensity of 0 or "
            "more: x, y, z, intensity as float32"
        )
    return dict(zip(KITTI, values.T, strict=True))


def read_npy(content: bytes, what: str) -> Columns:
    """Read an array of shape (n, 3) or (n, 4 or more), possibly in layers, or of records with fields x, y and z.

    Pickles are never loaded.

    Raises
    ------
    ScanError
        If it is any other array, damaged, or a pickle.
    """
    return _columns("points", _array(content, what), what)


def read_npz(content: bytes, what: str) -> Columns:
    """Read an archive with one array of points and, optionally, one array for each further field.

    Raises
    ------
    ScanError
        If the points are missing, an array does not fit them, or the archive is damaged.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            arrays = {
                member.filename.removesuffix(".npy"): _member(archive, member, what) for member in archive.infolist()
            }
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        OSError,
        NotImplementedError,
        ValueError,
        RuntimeError,
    ) as problem:
        raise ScanError(f"{what} is damaged: {quoted(str(problem))}; needed is a whole archive of arrays") from problem
    main = next((name for name in _POINTS if name in arrays), None)
    if main is None and len(arrays) == 1:
        main = next(iter(arrays))
    columns = dict(_columns(main, arrays.pop(main), what)) if main is not None else {}
    for name, array in arrays.items():
        columns.setdefault(name, array)
    axes = {name.lower(): column for name, column in columns.items()}  # names are not case-sensitive
    if not all(axis in axes for axis in "xyz"):
        raise ScanError(f"{what} has the arrays {listed(list(columns)) or '(none)'}; needed is 'points', or x, y and z")
    points = len(axes["x"]) if axes["x"].ndim else 0
    return {name: column for name, column in columns.items() if column.shape == (points,)}


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, what: str) -> npt.NDArray[Any]:
    if member.file_size > LARGEST_RATIO * max(member.compress_size, 1):
        raise ScanError(
            f"{what}: {quoted(member.filename)} promises {member.file_size} bytes from {member.compress_size}; "
            "needed is an archive that NumPy wrote"
        )
    return _array(archive.read(member), f"{what}, array {quoted(member.filename)}")


def _array(content: bytes, what: str) -> npt.NDArray[Any]:
    stream = io.BytesIO(content)
    if b"\\" in content[_HEADER_AT : content.find(b"\n", _HEADER_AT)]:  # NumPy would parse it as Python, with a warning
        raise ScanError(f"{what} is no array: its header holds a backslash; needed is a file that NumPy wrote")
    try:
        version = np.lib.format.read_magic(stream)
        read_header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read_header(stream)
    except Exception as problem:  # exceptions of many types: a header is parsed as Python
        raise ScanError(f"{what} is no array: {quoted(str(problem))}; needed is a file that NumPy wrote") from problem
    if dtype.hasobject:
        raise ScanError(
            f"{what} is a pickle (type {quoted(str(dtype))}), which is never loaded; needed is an array of numbers"
        )
    count = 1
    for length in shape:
        count *= max(int(length), 0)
    following = len(content) - stream.tell()
    if dtype.itemsize == 0 or count * dtype.itemsize > following:
        raise ScanError(
            f"{what} is cut off: its header promises {quoted(str(shape))} values of {dtype.itemsize} bytes, and "
            f"{following} bytes follow"
        )
    values: npt.NDArray[Any] = np.frombuffer(content, dtype, count, stream.tell())
    return values.reshape(shape, order="F" if fortran else "C")


def _columns(name: str, array: npt.NDArray[Any], what: str) -> Columns:
    if array.dtype.names is not None:
        records = array.reshape(-1)
        return {field: records[field] for field in array.dtype.names}
    if array.dtype.kind in "fiu" and array.ndim in (2, 3) and array.shape[-1] >= 3:
        points = array.reshape(-1, array.shape[-1])  # also of arrays with layers and columns
        if len(points) < len(KITTI) + 1 < points.shape[1]:
            raise ScanError(
                f"{what} holds an array of shape {array.shape}; needed is one row for each point: transposed"
            )
        return dict(zip(KITTI, points.T, strict=False))
    if array.dtype.kind in "fiu" and array.ndim == 1:
        return {name: array}
    raise ScanError(f"{what} holds {array.dtype} of shape {array.shape}; needed are points of shape (n, 3) or (n, 4)")
