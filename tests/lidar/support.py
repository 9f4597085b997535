"""Scans of one scene, and files of every format with them, written by the formats' own libraries."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import numpy.typing as npt
import pytest
import trimesh
from laci_lidar.errors import ScanError
from laci_lidar.scans import open_scans
from pypcd4 import Encoding, PointCloud
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.typesys import Stores, get_typestore

Array = npt.NDArray[Any]

EPOCH_NS = 1_760_000_000_000_000_000
PERIOD_NS = 100_000_000
ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
CLOUD = "sensor_msgs/msg/PointCloud2"
_ROS_TYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


def scene(seed: int = 0, points: int = 300) -> dict[str, Array]:
    """Points between 2 and 90 m as float32, with an intensity and a time in the sweep in nanoseconds."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(points, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    xyz = (directions * rng.uniform(2.0, 90.0, (points, 1))).astype(np.float32)
    return {
        "x": xyz[:, 0],
        "y": xyz[:, 1],
        "z": xyz[:, 2],
        "intensity": rng.integers(0, 255, points).astype(np.float32),
        "t": np.linspace(0, 99_000_000, points).astype(np.uint32),
    }


def refusal(path: Path, topic: str | None = None) -> str:
    """Return the one line, which names the path, with which a recording is refused."""
    with pytest.raises(ScanError) as refused:
        open_scans(path, topic)
    assert str(path) in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1
    return str(refused.value)


def xyz_of(columns: Mapping[str, Array]) -> Array:
    return np.column_stack([columns[axis] for axis in "xyz"]).astype(np.float64)


def records_of(columns: Mapping[str, Array]) -> Array:
    dtype = np.dtype([(name, column.dtype) for name, column in columns.items()])
    records = np.empty(len(columns["x"]), dtype)
    for name, column in columns.items():
        records[name] = column
    return records


def write_pcd(path: Path, columns: Mapping[str, Array], encoding: Encoding = Encoding.BINARY) -> Path:
    types = tuple(column.dtype.type for column in columns.values())
    PointCloud.from_points(list(columns.values()), tuple(columns), types).save(path, encoding)
    return path


def write_ply(path: Path, columns: Mapping[str, Array], encoding: str = "binary") -> Path:
    vertices = trimesh.PointCloud(xyz_of(columns))
    path.write_bytes(vertices.export(file_type="ply", encoding=encoding))
    return path


def write_big_endian_ply(path: Path, columns: Mapping[str, Array]) -> Path:
    """No library at hand writes this byte order."""
    names = {"f": "float", "u": "uint"}
    properties = [f"property {names[column.dtype.kind]} {name}" for name, column in columns.items()]
    header = [
        "ply",
        "format binary_big_endian 1.0",
        f"element vertex {len(columns['x'])}",
        *properties,
        "end_header",
        "",
    ]
    records = records_of(columns)
    path.write_bytes("\n".join(header).encode() + records.astype(records.dtype.newbyteorder(">")).tobytes())
    return path


def write_las(path: Path, columns: Mapping[str, Array], crs: Any = None) -> Path:
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, 1e-4)
    if crs is not None:
        header.add_crs(crs)
    las = laspy.LasData(header)
    las.x, las.y, las.z = (columns[axis].astype(np.float64) for axis in "xyz")
    las.intensity = columns["intensity"].astype(np.uint16)
    las.gps_time = columns["t"] / 1e9
    las.write(str(path))
    return path


def write_bin(path: Path, columns: Mapping[str, Array]) -> Path:
    np.column_stack([columns[name] for name in ("x", "y", "z", "intensity")]).astype("<f4").tofile(path)
    return path


def write_npy(path: Path, columns: Mapping[str, Array]) -> Path:
    np.save(path, np.column_stack([columns[name] for name in ("x", "y", "z", "intensity")]))
    return path


def write_structured_npy(path: Path, columns: Mapping[str, Array]) -> Path:
    np.save(path, records_of(columns))
    return path


def write_npz(path: Path, columns: Mapping[str, Array]) -> Path:
    np.savez_compressed(path, points=xyz_of(columns), intensity=columns["intensity"], t=columns["t"])
    return path


FILE_FORMATS: dict[str, tuple[str, Callable[[Path, Mapping[str, Array]], Path]]] = {
    "pcd ascii": (".pcd", lambda path, columns: write_pcd(path, columns, Encoding.ASCII)),
    "pcd binary": (".pcd", write_pcd),
    "pcd compressed": (".pcd", lambda path, columns: write_pcd(path, columns, Encoding.BINARY_COMPRESSED)),
    "ply ascii": (".ply", lambda path, columns: write_ply(path, columns, "ascii")),
    "ply binary": (".ply", write_ply),
    "ply big-endian": (".ply", write_big_endian_ply),
    "las": (".las", write_las),
    "laz": (".laz", write_las),
    "kitti": (".bin", write_bin),
    "npy": (".npy", write_npy),
    "npy structured": (".npy", write_structured_npy),
    "npz": (".npz", write_npz),
}
"""Suffix and writer of each format."""

RESOLUTION_M = {"pcd ascii": 1e-6, "ply ascii": 1e-6, "las": 1e-4, "laz": 1e-4}
"""Of formats that do not keep every bit."""


def write_folder(
    folder: Path,
    scans: Sequence[Mapping[str, Array]],
    form: str = "pcd binary",
    stamps_ns: Sequence[int] | None = None,
) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    suffix, write = FILE_FORMATS[form]
    for stamp, columns in zip(stamps_ns or evenly(len(scans)), scans, strict=True):
        write(folder / f"{stamp}{suffix}", columns)
    return folder


def evenly(count: int) -> list[int]:
    return [EPOCH_NS + i * PERIOD_NS for i in range(count)]


def cloud_message(columns: Mapping[str, Array], stamp_ns: int, ros1: bool, big_endian: bool = False) -> Any:
    types = ROS1.types if ros1 else ROS2.types
    records = records_of(columns)
    if big_endian:
        records = records.astype(records.dtype.newbyteorder(">"))
    fields = [
        types["sensor_msgs/msg/PointField"](name, records.dtype.fields[name][1], _ROS_TYPES[column.dtype.str[1:]], 1)
        for name, column in columns.items()
    ]
    time = types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    header = types["std_msgs/msg/Header"](*([7] if ros1 else []), time, "lidar")
    size = records.dtype.itemsize
    data = np.frombuffer(records.tobytes(), np.uint8)
    return types[CLOUD](header, 1, len(records), fields, big_endian, size, size * len(records), data, True)


def write_bag1(
    path: Path,
    topics: Mapping[str, Sequence[Mapping[str, Array]]],
    compression: str | None = None,
    delay_ns: int = 0,
    stamps_ns: Sequence[int] | None = None,
) -> Path:
    writer = Writer1(path)
    if compression is not None:
        writer.set_compression(Writer1.CompressionFormat[compression.upper()])
    with writer:
        chatter = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=ROS1)
        connections = {topic: writer.add_connection(topic, CLOUD, typestore=ROS1) for topic in topics}
        count = max((len(scans) for scans in topics.values()), default=3)
        for i, stamp in enumerate(stamps_ns or evenly(count)):
            said = ROS1.types["std_msgs/msg/String"](f"hello {i}")
            writer.write(chatter, stamp, ROS1.serialize_ros1(said, "std_msgs/msg/String"))
            for topic, scans in topics.items():
                message = cloud_message(scans[i], stamp, ros1=True)
                writer.write(connections[topic], stamp + delay_ns, ROS1.serialize_ros1(message, CLOUD))
    return path


def write_bag2(
    path: Path,
    topics: Mapping[str, Sequence[Mapping[str, Array]]],
    storage: str = "sqlite3",
    compression: str | None = None,
    big_endian: bool = False,
    stamps_ns: Sequence[int] | None = None,
) -> Path:
    writer = Writer2(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    if compression is not None:
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with writer:
        chatter = writer.add_connection("/chatter", "std_msgs/msg/String", typestore=ROS2)
        connections = {topic: writer.add_connection(topic, CLOUD, typestore=ROS2) for topic in topics}
        count = max((len(scans) for scans in topics.values()), default=3)
        for i, recorded in enumerate(evenly(count)):
            said = ROS2.types["std_msgs/msg/String"](f"hello {i}")
            writer.write(chatter, recorded, ROS2.serialize_cdr(said, "std_msgs/msg/String"))
            for topic, scans in topics.items():
                stamp = recorded if stamps_ns is None else stamps_ns[i]
                message = cloud_message(scans[i], stamp, ros1=False, big_endian=big_endian)
                writer.write(connections[topic], recorded, ROS2.serialize_cdr(message, CLOUD))
    return path
