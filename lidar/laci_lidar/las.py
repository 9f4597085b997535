"""LAS and LAZ files, by laspy: the extra ``las``."""

from __future__ import annotations

import io
import struct

import laspy
import numpy as np
from pyproj.exceptions import CRSError

from laci_lidar.columns import Columns
from laci_lidar.errors import ScanError
from laci_stereo.io.text_file import quoted

LARGEST_RATIO = 1000
"""LAZ makes points about ten times smaller; a header that promises a hundred times more than that is wrong."""

_VLR_SIZE, _EVLR_SIZE = 54, 60
_DIMENSIONS = ("intensity", "gps_time")


def read_las(content: bytes, what: str) -> Columns:
    """Read a LAS or LAZ file's content.

    Raises
    ------
    ScanError
        If it is damaged, its header promises more than it holds, or its coordinates are on a map.
    """
    try:
        _check_records(content, what)
        with laspy.open(io.BytesIO(content), laz_backend=laspy.LazBackend.Lazrs) as reader:
            _check_points(reader.header, content, what)
            _check_local(reader.header, what)
            las = reader.read()
    except (ScanError, MemoryError, KeyboardInterrupt, SystemExit):
        raise
    except BaseException as problem:  # a panic of the decompressor is no Exception
        raise ScanError(
            f"{what} cannot be read: {quoted(str(problem))}; needed is a whole LAS or LAZ file"
        ) from problem
    if len(las.points) != las.header.point_count:
        raise ScanError(f"{what} is cut off: {len(las.points)} of {las.header.point_count} points are there")
    names = set(las.point_format.dimension_names)
    axes = {name: np.asarray(axis.scaled_array()) for name, axis in (("x", las.x), ("y", las.y), ("z", las.z))}
    return axes | {name: np.asarray(las[name]) for name in _DIMENSIONS if name in names}


def _check_records(content: bytes, what: str) -> None:
    """Check the counts that laspy believes."""
    if len(content) < 227:
        raise ScanError(f"{what} is cut off: {len(content)} bytes; the header alone has 227")
    records = struct.unpack_from("<I", content, 100)[0]
    extended = struct.unpack_from("<I", content, 243)[0] if content[25] >= 4 and len(content) >= 247 else 0
    if records * _VLR_SIZE + extended * _EVLR_SIZE > len(content):
        raise ScanError(
            f"{what}: its header promises {records + extended} records before its points, and the file has "
            f"{len(content)} bytes"
        )


def _check_points(header: laspy.LasHeader, content: bytes, what: str) -> None:
    needed = header.point_count * header.point_format.size
    start = header.offset_to_point_data
    following = len(content) - start
    if needed > following * (LARGEST_RATIO if header.are_points_compressed else 1):
        raise ScanError(
            f"{what} is cut off: its header promises {header.point_count} points, and {max(following, 0)} bytes follow"
        )
    if header.are_points_compressed and following >= 8:
        table = struct.unpack_from("<q", content, start)[0]
        if 0 <= table <= len(content) - 8 and struct.unpack_from("<I", content, table + 4)[0] > header.point_count + 1:
            raise ScanError(f"{what} is damaged: it has more chunks than its {header.point_count} points")


def _check_local(header: laspy.LasHeader, what: str) -> None:
    try:
        crs = header.parse_crs()
    except CRSError:
        return
    if crs is not None and (crs.is_projected or crs.is_geographic or crs.is_geocentric):
        raise ScanError(
            f"{what} has the coordinate system {quoted(crs.name)}: these are world coordinates already; needed are "
            "points in the sensor's own frame"
        )
