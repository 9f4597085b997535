"""Point arrays: NumPy's ``.npy`` and ``.npz``, and KITTI's ``.bin`` without a header."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from laci_lidar.columns import Columns
from laci_lidar.errors import ScanError
from laci_stereo.io.numpy_file import archived, array_in
from laci_stereo.io.text_file import listed

KITTI = ("x", "y", "z", "intensity")
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
    return _columns("points", array_in(content, what, ScanError), what)


def read_npz(content: bytes, what: str) -> Columns:
    """Read an archive with one array of points and, optionally, one array for each further field.

    Raises
    ------
    ScanError
        If the points are missing, an array does not fit them, or the archive is damaged.
    """
    arrays = archived(content, what, ScanError)
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
