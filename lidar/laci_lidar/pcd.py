"""PCD files of the Point Cloud Library: ascii, binary and binary_compressed."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from laci_lidar import lzf
from laci_lidar.columns import LONGEST_HEADER, Columns, Field, from_text, named, unpacked
from laci_lidar.errors import ScanError
from laci_stereo.io.text_file import quoted

_TYPES = {("F", 2): "<f2", ("F", 4): "<f4", ("F", 8): "<f8"} | {
    (kind, size): f"<{kind.lower()}{size}" for kind in "IU" for size in (1, 2, 4, 8)
}
_ENTRIES = frozenset(
    ["VERSION", "FIELDS", "COLUMNS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS", "DATA"]
)


@dataclass(frozen=True)
class _Header:
    fields: tuple[Field, ...]
    points: int
    encoding: str
    size: int

    @property
    def point_size(self) -> int:
        return sum(field.size for field in self.fields)


def is_pcd(head: bytes) -> bool:
    """Return whether a file is a PCD file, from its first bytes."""
    first = head.lstrip()
    return first.startswith((b"# .PCD", b"VERSION ", b"FIELDS ")) or (first.startswith(b"#") and b"\nVERSION " in first)


def read_pcd(content: bytes, what: str) -> Columns:
    """Read the content of a PCD file.

    Raises
    ------
    ScanError
        If it is damaged, or its header claims more than the file contains.
    """
    header = _header(content, what)
    data = memoryview(content)[header.size :]
    if header.encoding == "ascii":
        if 2 * header.points > len(data) + 1:
            raise _short(what, header.points, f"{len(data)} bytes of text follow")
        return from_text(bytes(data), header.fields, header.points, what)
    if header.encoding == "binary":
        needed = header.points * header.point_size
        if needed > len(data):
            raise _short(what, header.points, f"{len(data)} bytes follow where {needed} are needed")
        return unpacked(data, header.fields, header.points)
    if header.encoding == "binary_compressed":
        return _decompressed(data, header, what)
    raise ScanError(f"{what}: DATA is {quoted(header.encoding)}; needed is 'ascii', 'binary' or 'binary_compressed'")


def _short(what: str, points: int, found: str) -> ScanError:
    return ScanError(f"{what} is cut off: its header promises {points} points, and {found}")


def _decompressed(data: memoryview, header: _Header, what: str) -> Columns:
    needed = header.points * header.point_size
    if len(data) < 8:
        raise _short(what, header.points, f"{len(data)} bytes follow")
    packed_size, size = struct.unpack_from("<II", data)
    if packed_size > len(data) - 8:
        raise _short(what, header.points, f"{len(data) - 8} compressed bytes follow where {packed_size} are needed")
    if size != needed:
        raise _short(what, header.points, f"{size} bytes are compressed where {needed} are needed")
    try:
        raw = lzf.decompress(data[8 : 8 + packed_size], size)
    except ValueError as problem:
        raise ScanError(f"{what} is damaged: {problem}") from problem
    # Compressed values are stored field by field.
    columns, at = [], 0
    for field in header.fields:
        column = np.frombuffer(raw, field.dtype, field.count * header.points, at)
        columns.append(column if field.count == 1 else column.reshape(header.points, field.count))
        at += field.size * header.points
    return named(header.fields, columns)


def _header(content: bytes, what: str) -> _Header:
    entries: dict[str, list[str]] = {}
    at = 0
    while "DATA" not in entries:
        end = content.find(b"\n", at, LONGEST_HEADER)
        if end < 0:
            raise ScanError(
                f"{what} is no PCD file: its header has no line DATA within {min(at, LONGEST_HEADER)} bytes"
            )
        words = content[at:end].decode("latin-1").split()
        at = end + 1
        if words and not words[0].startswith("#"):
            if words[0] not in _ENTRIES:
                raise ScanError(f"{what}: the header's entry {quoted(words[0])} is unknown; needed is a PCD header")
            entries[words[0]] = words[1:]
    fields = _fields(entries, what)
    return _Header(fields, _points(entries, what), " ".join(entries["DATA"]), at)


def _fields(entries: Mapping[str, list[str]], what: str) -> tuple[Field, ...]:
    names = entries.get("FIELDS") or entries.get("COLUMNS") or []
    sizes = _numbers(entries, "SIZE", what)
    types = entries.get("TYPE", [])
    counts = _numbers(entries, "COUNT", what) if "COUNT" in entries else [1] * len(names)
    if not names or not len(names) == len(sizes) == len(types) == len(counts):
        raise ScanError(
            f"{what}: the header has {len(names)} FIELDS, {len(sizes)} SIZE, {len(types)} TYPE and {len(counts)} "
            "COUNT; needed is one of each for every field"
        )
    if sum(counts) > LONGEST_HEADER:
        raise ScanError(f"{what}: {sum(counts)} values for each point; needed are at most {LONGEST_HEADER}")
    fields = []
    for name, size, kind, count in zip(names, sizes, types, counts, strict=True):
        if (kind, size) not in _TYPES:
            raise ScanError(
                f"{what}: the field {quoted(name)} has type {quoted(kind)} of {size} bytes; needed is F, I or U"
            )
        fields.append(Field(name, np.dtype(_TYPES[kind, size]), count))
    return tuple(fields)


def _points(entries: Mapping[str, list[str]], what: str) -> int:
    if "POINTS" in entries:
        points = _numbers(entries, "POINTS", what)
    else:
        points = [
            a * b for a, b in zip(_numbers(entries, "WIDTH", what), _numbers(entries, "HEIGHT", what), strict=False)
        ]
    if len(points) != 1:
        raise ScanError(f"{what}: the header tells {len(points)} numbers of points; needed is one entry POINTS")
    return points[0]


def _numbers(entries: Mapping[str, list[str]], entry: str, what: str) -> list[int]:
    words = entries.get(entry, [])
    if not all(word.isascii() and word.isdigit() and len(word) <= 18 for word in words):
        raise ScanError(f"{what}: {entry} is {quoted(' '.join(words))}; needed are whole numbers")
    return [int(word) for word in words]
