"""LAS and LAZ files, read with laspy; requires the extra ``las``."""

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
"""LAZ reduces the size of points by a factor of about ten; a header that claims a hundred times more is wrong."""

_MINOR_AT = 25
_VLR_SIZE, _EVLR_SIZE = 54, 60
_ITEMS_AT = 34
_LAYERED = 3
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
"""Number of layers of each kind of item; extra bytes have one layer each."""
_DIMENSIONS = ("intensity", "gps_time")


def read_las(content: bytes, what: str) -> Columns:
    """Read the content of a LAS or LAZ file.

    Raises
    ------
    ScanError
        If it is damaged, its header claims more than the file contains, or its coordinates are map coordinates.
    """
    try:
        _check_records(content, what)
        with laspy.open(io.BytesIO(content), laz_backend=laspy.LazBackend.Lazrs) as reader:
            _check_points(reader.header, content, what)
            _check_local(reader.header, what)
            las = reader.read()
    except (ScanError, MemoryError, KeyboardInterrupt, SystemExit):
        raise
    except BaseException as problem:  # a panic of the decompressor is not an Exception
        raise ScanError(
            f"{what} cannot be read: {quoted(str(problem))}; needed is a whole LAS or LAZ file"
        ) from problem
    if len(las.points) != las.header.point_count:
        raise ScanError(f"{what} is cut off: {len(las.points)} of {las.header.point_count} points are there")
    names = set(las.point_format.dimension_names)
    with np.errstate(over="ignore", invalid="ignore"):  # a damaged scale gives infinite points, which are no returns
        axes = {name: np.asarray(axis.scaled_array()) for name, axis in (("x", las.x), ("y", las.y), ("z", las.z))}
    return axes | {name: np.asarray(las[name]) for name in _DIMENSIONS if name in names}


def _check_records(content: bytes, what: str) -> None:
    """Check the counts that laspy relies on."""
    counts_extended = len(content) > _MINOR_AT and content[_MINOR_AT] >= 4
    header_size = 375 if counts_extended else 227
    if len(content) < header_size:
        raise ScanError(f"{what} is cut off: {len(content)} bytes; the header alone has {header_size}")
    records = struct.unpack_from("<I", content, 100)[0]
    extended = struct.unpack_from("<I", content, 243)[0] if counts_extended else 0
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
    if header.are_points_compressed and following >= 16:
        table = struct.unpack_from("<q", content, start)[0]
        if table == -1:  # written to a stream: the offset is at the end
            table = struct.unpack_from("<q", content, len(content) - 8)[0]
        if not start <= table <= len(content) - 8:
            raise ScanError(f"{what} is damaged: its chunk table is at byte {table} of {len(content)}")
        if struct.unpack_from("<I", content, table + 4)[0] > header.point_count + 1:
            raise ScanError(f"{what} is damaged: it has more chunks than its {header.point_count} points")
        _check_layers(header, content, table, what)


def _check_layers(header: laspy.LasHeader, content: bytes, table: int, what: str) -> None:
    """Check the sizes that chunks declare for their layers: the decompressor allocates memory accordingly.

    From LAS 1.4 on, a chunk is one whole point, the number of its points, the size of each layer, and the layers
    (LASzip, "layered chunked").
    """
    for record in header.vlrs.get("LasZipVlr"):
        (compressor,) = struct.unpack_from("<H", record.record_data)
        kinds = [kind for kind, *_ in struct.iter_unpack("<HHH", record.record_data[_ITEMS_AT:])]
        if compressor != _LAYERED:
            continue
        layers = struct.Struct(f"<{sum(_LAYERS.get(kind, header.point_format.num_extra_bytes) for kind in kinds)}I")
        at = header.offset_to_point_data + 8
        while at < table:
            sizes_at = at + header.point_format.size + 4
            after = sizes_at + layers.size
            if after <= table:
                after += sum(layers.unpack_from(content, sizes_at))
            if after > table:
                raise ScanError(f"{what} is damaged: a chunk at byte {at} ends at {after}; needed is {table} at most")
            at = after


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
