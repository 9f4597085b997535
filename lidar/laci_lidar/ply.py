"""PLY files: ascii, binary little-endian and binary big-endian."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_lidar.columns import LONGEST_HEADER, Columns, Field, from_text, unpacked
from laci_lidar.errors import ScanError
from laci_stereo.io.text_file import quoted

_TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    fields: tuple[Field, ...]
    has_list: bool

    @property
    def size(self) -> int:
        return self.count * sum(field.size for field in self.fields)


@dataclass(frozen=True)
class _Header:
    encoding: str
    elements: tuple[_Element, ...]
    size: int


def is_ply(head: bytes) -> bool:
    """Return whether a file is a PLY file, from its first bytes."""
    return head.startswith((b"ply\n", b"ply\r"))


def read_ply(content: bytes, what: str) -> Columns:
    """Read the vertices of a PLY file.

    Raises
    ------
    ScanError
        If it is damaged, its header claims more than the file contains, or its vertices have lists.
    """
    header = _header(content, what)
    index = next((i for i, element in enumerate(header.elements) if element.name == "vertex"), None)
    if index is None:
        names = ", ".join(quoted(element.name) for element in header.elements[:10]) or "none"
        raise ScanError(f"{what} has the elements {names}; needed is 'vertex'")
    before, vertex = header.elements[:index], header.elements[index]
    if any(element.has_list for element in (*before, vertex)):
        raise ScanError(f"{what}: lists in or before its vertices; needed are vertices of plain numbers")
    data = memoryview(content)[header.size :]
    if header.encoding == "ascii":
        skipped = sum(element.count for element in before)
        if 2 * (vertex.count + skipped) > len(data) + 1:
            raise _short(what, vertex, f"{len(data)} bytes of text follow")
        text = bytes(data).split(b"\n", skipped)[-1]
        return from_text(text, vertex.fields, vertex.count, what)
    start = sum(element.size for element in before)
    if start + vertex.size > len(data):
        raise _short(what, vertex, f"{len(data)} bytes follow where {start + vertex.size} are needed")
    return unpacked(data[start:], vertex.fields, vertex.count)


def _short(what: str, vertex: _Element, found: str) -> ScanError:
    return ScanError(f"{what} is cut off: its header promises {vertex.count} points, and {found}")


def _header(content: bytes, what: str) -> _Header:
    end = content.find(b"end_header", 0, LONGEST_HEADER)
    line_end = content.find(b"\n", end)
    if end < 0 or line_end < 0:
        raise ScanError(f"{what} is no PLY file: its header has no line end_header within {LONGEST_HEADER} bytes")
    lines = [line.split() for line in content[:end].decode("latin-1").splitlines()]
    encoding = next((words[1] for words in lines if len(words) > 1 and words[0] == "format"), "")
    if encoding not in _ORDERS:
        raise ScanError(f"{what}: the format is {quoted(encoding)}; needed is one of {', '.join(_ORDERS)}")
    groups: list[list[list[str]]] = []
    for words in lines[1:]:
        if words[:1] == ["element"]:
            groups.append([words])
        elif words[:1] == ["property"] and groups:
            groups[-1].append(words)
    elements = tuple(_element(group[0], group[1:], _ORDERS[encoding], what) for group in groups)
    return _Header(encoding, elements, line_end + 1)


def _element(head: list[str], properties: list[list[str]], order: str, what: str) -> _Element:
    if len(head) != 3 or not (head[2].isascii() and head[2].isdigit() and len(head[2]) <= 18):
        raise ScanError(f"{what}: {quoted(' '.join(head))}; needed is 'element NAME COUNT'")
    fields = []
    for words in properties:
        if words[1:2] == ["list"]:
            continue
        if len(words) != 3 or words[1] not in _TYPES:
            raise ScanError(f"{what}: {quoted(' '.join(words))}; needed is 'property TYPE NAME'")
        fields.append(Field(words[2], np.dtype(order + _TYPES[words[1]])))
    if not fields and head[1] == "vertex":
        raise ScanError(f"{what}: its vertices have 0 plain properties; needed are x, y and z")
    has_list = any(words[1:2] == ["list"] for words in properties)
    return _Element(head[1], int(head[2]), tuple(fields), has_list)
