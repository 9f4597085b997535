"""Messages in the files of a bag, record by record up to where a file is damaged. Requires the extra ``bag``."""

from __future__ import annotations

import bz2
import mmap
import sqlite3
import struct
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import TypeAlias
from urllib.parse import quote

import lz4.frame

from laci_stereo.io.file_content import MCAP_MAGIC, SQLITE_MAGIC
from laci_stereo.io.text_file import quoted, shortened

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

ROS1_MAGIC = b"#ROSBAG V2.0\n"

LARGEST_CHUNK = 1 << 28
"""Largest unpacked chunk of messages, bytes; writers close chunks after some megabytes."""

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
    """A topic, with the type of its messages.

    Attributes
    ----------
    name : str
    type_name : str
        Such as ``sensor_msgs/msg/PointCloud2``.
    ros1 : bool
        Whether it was written by ROS 1, in whose format its messages are serialised.
    definition : str
        Definition of the message type in the bag; may be empty.
    digest : str
        MD5 sum of the definition, in ROS 1.
    """

    name: str
    type_name: str
    ros1: bool
    definition: str = ""
    digest: str = ""

    @property
    def shown(self) -> str:
        """Its name, shortened for a message."""
        return shortened(self.name, 80)


@dataclass(frozen=True)
class Message:
    """A message as it was recorded; ``recorded_ns`` is the time of that, Unix, nanoseconds."""

    topic: Topic
    recorded_ns: int
    data: bytes


class CutOffError(Exception):
    """A bag cannot be read beyond this point."""


def walk(file: Path) -> Iterator[Message]:
    """Return an iterator over the messages in a file of a bag.

    Raises
    ------
    CutOffError
        Where the file is damaged, after the intact messages. Exceptions of other types mean the same, as the bytes may
        be anything.
    """
    if begins(file, ROS1_MAGIC):
        return _ros1_messages(file)
    if begins(file, MCAP_MAGIC):
        return _mcap_messages(file)
    if begins(file, SQLITE_MAGIC):
        return _sqlite_messages(file)
    raise CutOffError("it is no ROS 1 bag, MCAP or SQLite file")


def begins(file: Path, magic: bytes) -> bool:
    """Return whether a file begins with the given bytes."""
    with file.open("rb") as stream:
        return stream.read(len(magic)) == magic


@contextmanager
def _mapped(file: Path) -> Iterator[Stream]:
    """Map a file into memory, so that a record whose stated length exceeds the file allocates nothing."""
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


# ROS 1: records consist of a header (fields "name=value") and data; chunks hold records of connections and messages.


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
            fields = _ros1_fields(data)
            package, _, name = fields["type"].decode().rpartition("/")
            topics[header["conn"]] = Topic(
                header["topic"].decode(),
                f"{package}/msg/{name}",
                True,
                fields["message_definition"].decode(errors="replace"),
                fields["md5sum"].decode(),
            )
        elif header.get("op") == b"\x02" and header["conn"] in topics:
            seconds, nanoseconds = struct.unpack("<II", header["time"])
            yield Message(topics[header["conn"]], seconds * 10**9 + nanoseconds, data)
    except KeyError as problem:
        raise CutOffError(f"a record without its {problem}") from problem


# MCAP: records consist of an opcode, a length and content; chunks hold records of schemas, channels and messages.


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
        # SQLite's own recovery sets this, too, to read a truncated file.
        database.execute("PRAGMA writable_schema = ON")
        topics = {
            number: Topic(str(name), str(type_name), False)
            for number, name, type_name in database.execute("SELECT id, name, type FROM topics")
        }
        # Without ORDER BY, rows come in the order of writing, and no index is used, whose pages may be missing.
        for number, recorded_ns, data in database.execute("SELECT topic_id, timestamp, data FROM messages"):
            if number in topics:
                yield Message(topics[number], int(recorded_ns), bytes(data))
