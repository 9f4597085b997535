"""Messages of type ``sensor_msgs/PointCloud2``, decoded with rosbags; requires the extra ``bag``."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from laci_lidar.columns import Column, Columns
from laci_lidar.errors import ScanError
from laci_stereo.io.bag.message_types import known_types, types_told
from laci_stereo.io.text_file import quoted

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"

_VALUES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}
_LARGEST_POINT = 1 << 16


def is_known(ros1: bool, definition: str, digest: str) -> bool:
    """Return whether a bag's definition of the message, if it contains one, is the standard one.

    Parameters
    ----------
    ros1 : bool
    definition : str
        Text in ROS's or OMG's language; may be empty for ROS 2.
    digest : str
        ROS 1's MD5 sum; otherwise unused.
    """
    types = known_types(ros1)
    if ros1:
        return digest in ("", "*", types.generate_msgdef(POINT_CLOUD)[1])
    if not definition.strip():
        return True
    try:
        parsed = types_told(definition, POINT_CLOUD)
    except Exception:  # exceptions of many types, all of which mean that this is no definition
        return False
    # Only names and types of fields are compared; constants and comments do not matter.
    return POINT_CLOUD in parsed and all(
        [name for name, _ in fields] == [name for name, _ in types.fielddefs[known][1]]
        for known, (_, fields) in parsed.items()
        if known in types.fielddefs
    )


def header_stamp_ns(message: bytes, ros1: bool) -> int | None:
    """Return the time in a message's header, nanoseconds, or None if the message is too short."""
    if len(message) < 12:
        return None
    if ros1:
        return _nanoseconds(*struct.unpack_from("<II", message, 4))
    return _nanoseconds(*struct.unpack_from("<iI" if message[1] & 1 else ">iI", message, 4))


def _nanoseconds(seconds: int, nanoseconds: int) -> int:
    return seconds * 10**9 + nanoseconds


def read_message(message: bytes, ros1: bool, what: str) -> Columns:
    """Decode a message into columns.

    Raises
    ------
    ScanError
        If it is damaged.
    """
    types = known_types(ros1)
    try:
        cloud: Any = (types.deserialize_ros1 if ros1 else types.deserialize_cdr)(message, POINT_CLOUD)
    except Exception as problem:  # exceptions of many types: the bytes may be anything
        raise ScanError(
            f"{what} cannot be decoded: {quoted(str(problem))}; needed is a sensor_msgs/PointCloud2"
        ) from problem
    points = _points(cloud, what)
    return {field.name: _column(points, field, cloud.is_bigendian, what) for field in cloud.fields[:_LARGEST_POINT]}


def _points(cloud: Any, what: str) -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
    """Return the bytes of a message's points, shape (n, point_step)."""
    height, width, step, row = cloud.height, cloud.width, cloud.point_step, cloud.row_step
    if not 0 < step <= _LARGEST_POINT:
        raise ScanError(f"{what}: a point has {step} bytes; needed are 1 to {_LARGEST_POINT}")
    row = row if height > 1 else width * step
    if row < width * step or height * row > len(cloud.data):
        raise ScanError(
            f"{what} promises {height} rows of {width} points with {step} bytes, and has {len(cloud.data)} bytes"
        )
    rows = cloud.data[: height * row].reshape(height, row)[:, : width * step]
    return np.ascontiguousarray(rows).reshape(height * width, step)


def _column(points: np.ndarray[tuple[int, int], np.dtype[np.uint8]], field: Any, big_endian: bool, what: str) -> Column:
    if field.datatype not in _VALUES:
        raise ScanError(f"{what}: the field {quoted(field.name)} has type {field.datatype}; needed is 1 to 8")
    dtype = np.dtype((">" if big_endian else "<") + _VALUES[field.datatype])
    count = max(field.count, 1)  # some drivers write 0
    end = field.offset + count * dtype.itemsize
    if end > points.shape[1]:
        raise ScanError(f"{what}: the field {quoted(field.name)} ends at byte {end} of {points.shape[1]} in a point")
    values = np.ascontiguousarray(points[:, field.offset : end]).view(dtype)
    return values[:, 0] if count == 1 else values
