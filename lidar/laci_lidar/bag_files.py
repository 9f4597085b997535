"""Messages in bags: whole ones by rosbags, cut-off ones record by record up to the damage. The extra ``bag``."""

from __future__ import annotations

import bz2
import mmap
import re
import sqlite3
import struct
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Protocol, TypeAlias
from urllib.parse import quote

import lz4.frame
from rosbags.interfaces import Connection
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from laci_lidar.errors import ScanError
from laci_stereo.io.text_file import quoted

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

ROS1_MAGIC, MCAP_MAGIC, SQLITE_MAGIC = b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n", b"SQLite format 3\x00"

LARGEST_CHUNK = 1 << 28
"""Bytes of a chunk of messages, unpacked; writers close them after some megabytes."""

_UNPACK: dict[str, Callable[[bytes], bytes]] = {
    "": bytes,
    "none": bytes,
    "bz2": lambda packed: bz2.BZ2Decompressor().decompress(packed, LARGEST_CHUNK),
    "lz4": lambda packed: bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, LARGEST_CHUNK)),
    "zstd": lambda packed: zstd.ZstdDecompressor().decompress(packed, LARGEST_CHUNK),
}


Stream: TypeAlias = BytesIO | mmap.mmap


@dataclass(frozen=True)
class Topic:
    """Where messages of one type are.

    Attributes
    ----------
    name : str
    type_name : str
        Such as ``sensor_msgs/msg/PointCloud2``.
    ros1 : bool
        Written by ROS 1, and so serialised in its way.
    definition : str
        Of the message, as the bag tells it; may be empty.
    digest : str
        ROS 1's MD5 sum of the definition.
    """

    name: str
    type_name: str
    ros1: bool
    definition: str = ""
    digest: str = ""


@dataclass(frozen=True)
class Message:
    """A message as it was recorded.

    Attributes
    ----------
    topic : Topic
    recorded_ns : int
        When it was written, Unix time, nanoseconds.
    data : bytes
    """

    topic: Topic
    recorded_ns: int
    data: bytes


class CutOffError(Exception):
    """A bag cannot be read any further."""


class Bag(Protocol):
    """A bag's messages, read as often as they are asked for."""

    def topics(self) -> list[Topic]:
        """Return the topics, each once."""

    def count(self, topic: str) -> int | None:
        """Return how many messages a topic should have, or None if the bag does not tell."""

    def messages(self, topic: str, times_ns: Sequence[int] | None = None) -> Iterator[Message]:
        """Yield a topic's messages in the order of recording, all or those that were recorded at given times.

        Raises
        ------
        CutOffError
            Where it is damaged, after what is whole.
        """


def open_bag(path: Path) -> Bag:
    """Open a ROS 1 bag, a folder that ROS 2 wrote, or one of its files.

    Raises
    ------
    ScanError
        If it is none of these.
    """
    whole = WholeBag(path)
    try:
        whole.topics()
    except CutOffError:
        return DamagedBag(path)
    return whole


class WholeBag:
    """A bag as rosbags reads it."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._ros1 = path.is_file() and _begins(path, ROS1_MAGIC)

    def topics(self) -> list[Topic]:
        """Return the topics, each once."""
        return list({topic.name: topic for topic, _ in self._connections()}.values())

    def count(self, topic: str) -> int | None:
        """Return how many messages a topic has."""
        return sum(count for found, count in self._connections() if found.name == topic)

    def messages(self, topic: str, times_ns: Sequence[int] | None = None) -> Iterator[Message]:
        """Yield a topic's messages in the order of recording, all or those that were recorded at given times.

        Raises
        ------
        CutOffError
            Where it is damaged.
        """
        windows = [(None, None)] if times_ns is None else [(time, time + 1) for time in times_ns]
        try:
            with self._reader() as reader:
                wanted = [connection for connection in reader.connections if connection.topic == topic]
                found = {connection.id: _topic(connection, self._ros1) for connection in wanted}
                for start, stop in windows:
                    for connection, recorded_ns, data in reader.messages(wanted, start, stop):
                        yield Message(found[connection.id], recorded_ns, bytes(data))
        except Exception as problem:  # of many kinds: the bytes may be anything
            raise CutOffError(_in_a_line(problem)) from problem

    def _connections(self) -> list[tuple[Topic, int]]:
        try:
            with self._reader() as reader:
                return [(_topic(connection, self._ros1), connection.msgcount) for connection in reader.connections]
        except Exception as problem:  # of many kinds: the bytes may be anything
            raise CutOffError(_in_a_line(problem)) from problem

    def _reader(self) -> Reader1 | Reader2:
        return Reader1(self._path) if self._ros1 else Reader2(self._path)


def _topic(connection: Connection, ros1: bool) -> Topic:
    return Topic(connection.topic, connection.msgtype, ros1, connection.msgdef.data, connection.digest)


def _in_a_line(problem: Exception) -> str:
    return quoted(str(problem) or type(problem).__name__)


class DamagedBag:
    """A bag that lost its index or its end: read from the start, record by record."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._files = _storage_files(path)

    def topics(self) -> list[Topic]:
        """Return the topics that have a whole message, each once."""
        found: dict[str, Topic] = {}
        with suppress(CutOffError):
            for message in self._all():
                found.setdefault(message.topic.name, message.topic)
        return list(found.values())

    def count(self, topic: str) -> int | None:
        """Return how many messages a topic should have by a ROS 2 bag's ``metadata.yaml``, if there is one."""
        try:
            metadata = YAML(typ="safe").load((self._path / "metadata.yaml").read_text())
            topics = metadata["rosbag2_bagfile_information"]["topics_with_message_count"]
            return sum(int(told["message_count"]) for told in topics if told["topic_metadata"]["name"] == topic)
        except (OSError, UnicodeDecodeError, YAMLError, TypeError, KeyError, ValueError):
            return None

    def messages(self, topic: str, times_ns: Sequence[int] | None = None) -> Iterator[Message]:
        """Yield a topic's messages in the order of recording, all or those that were recorded at given times.

        Raises
        ------
        CutOffError
            Where it is damaged.
        """
        times = None if times_ns is None else set(times_ns)
        for message in self._all():
            if message.topic.name == topic and (times is None or message.recorded_ns in times):
                yield message

    def _all(self) -> Iterator[Message]:
        for file in self._files:
            try:
                yield from _walk(file)
            except CutOffError as problem:
                raise CutOffError(f"{file.name} is damaged or cut off: {problem}") from problem
            except Exception as problem:  # of many kinds: the bytes may be anything
                raise CutOffError(f"{file.name} is damaged or cut off: {_in_a_line(problem)}") from problem


def _storage_files(path: Path) -> list[Path]:
    """Return the files with a bag's messages in the order in which they were written."""
    if path.is_file():
        return [path]
    files = [file for file in path.iterdir() if file.suffix in (".mcap", ".db3") and file.is_file()]
    if not files:
        raise ScanError(f"{path} holds no .mcap or .db3 file; needed is a folder that ROS 2 recorded")
    return sorted(
        files, key=lambda file: [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", file.name)]
    )


def _walk(file: Path) -> Iterator[Message]:
    if _begins(file, ROS1_MAGIC):
        return _ros1_messages(file)
    if _begins(file, MCAP_MAGIC):
        return _mcap_messages(file)
    if _begins(file, SQLITE_MAGIC):
        return _sqlite_messages(file)
    raise CutOffError("it is no ROS 1 bag, MCAP or SQLite file")


def _begins(file: Path, magic: bytes) -> bool:
    try:
        with file.open("rb") as stream:
            return stream.read(len(magic)) == magic
    except OSError as problem:
        raise ScanError(f"{file} cannot be read: {problem.strerror}; needed is a bag") from problem


@contextmanager
def _mapped(file: Path) -> Iterator[Stream]:
    """Map a file into memory, where a promise of more bytes than there are takes none."""
    with file.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
        yield content


def _exactly(stream: Stream, size: int) -> bytes:
    data = stream.read(size)
    if len(data) != size:
        raise CutOffError(f"{len(data)} of {size} bytes of a record are there")
    return data


def _unpacked(compression: str, packed: bytes) -> Stream:
    if compression not in _UNPACK:
        raise CutOffError(f"compression {quoted(compression)}")
    unpacked = _UNPACK[compression](packed)
    if len(unpacked) >= LARGEST_CHUNK:
        raise CutOffError(f"a chunk of {LARGEST_CHUNK} bytes or more")
    return BytesIO(unpacked)


# ROS 1: records of a header (fields "name=value") and data; chunks hold records of connections and messages.


def _ros1_messages(file: Path) -> Iterator[Message]:
    topics: dict[bytes, Topic] = {}
    indexed = False
    with _mapped(file) as stream:
        _exactly(stream, len(ROS1_MAGIC))
        for header, data in _ros1_records(stream):
            indexed |= header.get("op") == b"\x06"
            if header.get("op") == b"\x05":
                for inner, content in _ros1_records(_unpacked(header["compression"].decode(), data)):
                    yield from _ros1_message(inner, content, topics)
            else:
                yield from _ros1_message(header, data, topics)
    if not indexed:
        raise CutOffError("its index is missing")


def _ros1_records(stream: Stream) -> Iterator[tuple[dict[str, bytes], bytes]]:
    while size := stream.read(4):
        header = _ros1_fields(_exactly(stream, *struct.unpack("<I", size)))
        yield header, _exactly(stream, *struct.unpack("<I", _exactly(stream, 4)))


def _ros1_fields(header: bytes) -> dict[str, bytes]:
    fields = {}
    stream = BytesIO(header)
    while size := stream.read(4):
        name, separator, value = _exactly(stream, *struct.unpack("<I", size)).partition(b"=")
        if not separator:
            raise CutOffError("a header without fields")
        fields[name.decode()] = value
    return fields


def _ros1_message(header: dict[str, bytes], data: bytes, topics: dict[bytes, Topic]) -> Iterator[Message]:
    try:
        if header.get("op") == b"\x07":
            told = _ros1_fields(data)
            package, _, name = told["type"].decode().rpartition("/")
            topics[header["conn"]] = Topic(
                header["topic"].decode(),
                f"{package}/msg/{name}",
                True,
                told["message_definition"].decode(errors="replace"),
                told["md5sum"].decode(),
            )
        elif header.get("op") == b"\x02" and header["conn"] in topics:
            seconds, nanoseconds = struct.unpack("<II", header["time"])
            yield Message(topics[header["conn"]], seconds * 10**9 + nanoseconds, data)
    except KeyError as problem:
        raise CutOffError(f"a record without its {problem}") from problem


# MCAP: records of an opcode, a length and content; chunks hold records of schemas, channels and messages.


@dataclass(frozen=True)
class _Schema:
    name: str
    definition: str


def _mcap_messages(file: Path) -> Iterator[Message]:
    schemas: dict[int, _Schema] = {}
    topics: dict[int, Topic] = {}
    with _mapped(file) as stream:
        _exactly(stream, len(MCAP_MAGIC))
        for code, content in _mcap_records(stream):
            if code in (0x02, 0x0F):  # footer, end of data
                return
            if code == 0x06:
                record = BytesIO(content)
                _exactly(record, 28)
                compression = _mcap_text(record)
                packed = _exactly(record, *struct.unpack("<Q", _exactly(record, 8)))
                for inner, inside in _mcap_records(_unpacked(compression, packed)):
                    yield from _mcap_message(inner, inside, schemas, topics)
            else:
                yield from _mcap_message(code, content, schemas, topics)
    raise CutOffError("its end is missing")


def _mcap_records(stream: Stream) -> Iterator[tuple[int, bytes]]:
    while code := stream.read(1):
        yield code[0], _exactly(stream, *struct.unpack("<Q", _exactly(stream, 8)))


def _mcap_text(record: Stream) -> str:
    return _exactly(record, *struct.unpack("<I", _exactly(record, 4))).decode(errors="replace")


def _mcap_message(
    code: int, content: bytes, schemas: dict[int, _Schema], topics: dict[int, Topic]
) -> Iterator[Message]:
    record = BytesIO(content)
    if code == 0x03:
        number = struct.unpack("<H", _exactly(record, 2))[0]
        name, _, definition = _mcap_text(record), _mcap_text(record), _mcap_text(record)
        package, _, short = name.rpartition("/")
        schemas[number] = _Schema(f"{package.removesuffix('/msg')}/msg/{short}", definition)
    elif code == 0x04:
        number, schema = struct.unpack("<HH", _exactly(record, 4))
        topic, encoding = _mcap_text(record), _mcap_text(record)
        told = schemas.get(schema, _Schema("unknown", ""))
        topics[number] = Topic(topic, told.name, encoding == "ros1", told.definition)
    elif code == 0x05:
        number, _, recorded_ns = struct.unpack("<HIQ", _exactly(record, 14))
        _exactly(record, 8)
        if number in topics:
            yield Message(topics[number], recorded_ns, record.read())


def _sqlite_messages(file: Path) -> Iterator[Message]:
    address = f"file:{quote(str(file.absolute()))}?mode=ro&immutable=1"
    with closing(sqlite3.connect(address, uri=True)) as database:
        # What SQLite's own recovery does to look into a file that is shorter than it should be.
        database.execute("PRAGMA writable_schema = ON")
        topics = {
            number: Topic(str(name), str(type_name), False)
            for number, name, type_name in database.execute("SELECT id, name, type FROM topics")
        }
        # The order of writing needs no index, whose pages may be those that are missing.
        for number, recorded_ns, data in database.execute("SELECT topic_id, timestamp, data FROM messages"):
            if number in topics:
                yield Message(topics[number], int(recorded_ns), bytes(data))
