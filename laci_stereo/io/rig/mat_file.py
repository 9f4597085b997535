"""MATLAB's .mat files of version 5 to 7, read without SciPy, whose own reader crashes on many damaged ones.

A header of 128 bytes is followed by elements: type, length, data, padded to 8 bytes. An element of type 15 is
compressed by zlib; one of type 14 is a variable, which consists of elements itself: flags, size, name, and what its
class requires.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from laci_stereo.core.errors import RigError
from laci_stereo.io.file_storage import Node

TO_STRUCT = "in MATLAB: s = toStruct(stereoParams); save('stereo.mat', 's', '-v7')"
"""MATLAB code that writes a readable file; for messages."""

LARGEST_UNPACKED = 1 << 26
"""Bytes: ten times the usual unpacked size of the largest calibration file."""

LARGEST_MATRIX = 10_000
"""Largest number of elements of a matrix: rotations and lenses have a dozen; the corners and errors of the calibration
images are not needed."""

_HDF5, _VERSION_7_3 = b"\x89HDF", b"MATLAB 7.3"
MAT_MAGICS = (b"MATLAB ", _HDF5)
_HEADER = 128
_MATRIX, _COMPRESSED = 14, 15
_STRUCT, _CHAR, _OPAQUE, _NUMERIC = 2, 4, 17, range(6, 16)
_OBJECTS = (3, _OPAQUE)
_TYPES = {
    1: "i1",
    2: "u1",
    3: "i2",
    4: "u2",
    5: "i4",
    6: "u4",
    7: "f4",
    9: "f8",
    12: "i8",
    13: "u8",
    16: "u1",
    17: "u2",
}
_DEEPEST = 5


class _DamageError(ValueError):
    """The file ends too early or contradicts itself."""


@dataclass(frozen=True)
class _Element:
    kind: int
    data: bytes


@dataclass(frozen=True)
class _Variable:
    """A variable; ``node`` is a text in angle brackets if its type does not occur in calibrations."""

    name: str
    node: Node


_OBJECT = _Variable("", "<object>")


def parse_mat(path: Path, content: bytes) -> dict[str, Node]:
    """Return the variables in the content of a .mat file: matrices as lists of rows, structs as mappings.

    Raises
    ------
    RigError
        If the file is damaged, is of a version that cannot be read, or holds an object instead of a struct.
    """
    if content.startswith((_VERSION_7_3, _HDF5)):
        raise RigError(f"{path} is a MATLAB file of version 7.3 (HDF5); needed is version 7, {TO_STRUCT}")
    try:
        order = {b"IM": "<", b"MI": ">"}[content[_HEADER - 2 : _HEADER]]
        variables = [_variable(data, order, 0) for data in _top(content[_HEADER:], order)]
    except (_DamageError, KeyError, struct.error, zlib.error) as problem:
        raise RigError(f"{path} is a damaged MATLAB file ({problem!r}); needed is one {TO_STRUCT}") from problem
    root = {variable.name: variable.node for variable in variables}
    if _OBJECT.node in root.values() and not any(isinstance(node, dict) for node in root.values()):
        raise RigError(f"{path} holds a MATLAB object, which only MATLAB can open; needed is a struct, {TO_STRUCT}")
    return root


def _top(content: bytes, order: str) -> Iterator[bytes]:
    """Yield the data of each variable, unpacked."""
    left = LARGEST_UNPACKED
    for element in _elements(content, order):
        if element.kind == _COMPRESSED:
            unpacked = zlib.decompressobj().decompress(element.data, left + 1)
            left -= len(unpacked)
            if left < 0:
                raise _DamageError(f"it unpacks to more than {LARGEST_UNPACKED} bytes")
            inner = next(_elements(unpacked, order), None)
        else:
            inner = element
        if inner is not None and inner.kind == _MATRIX:
            yield inner.data


def _elements(content: bytes, order: str) -> Iterator[_Element]:
    at = 0
    while at + 8 <= len(content):
        kind, length = struct.unpack_from(f"{order}II", content, at)
        start = at + 8
        if kind >> 16:  # up to four bytes of data are stored in the tag itself
            kind, length, start = kind & 0xFFFF, kind >> 16, at + 4
            at += 8
        else:
            at = start + length + (0 if kind == _COMPRESSED else -length % 8)
        if start + length > len(content):
            raise _DamageError(f"an element of {length} bytes ends beyond the file")
        yield _Element(kind, content[start : start + length])


def _next(elements: Iterator[_Element]) -> _Element:
    element = next(elements, None)
    if element is None:
        raise _DamageError("a variable ends too early")
    return element


def _variable(data: bytes, order: str, depth: int) -> _Variable:
    if not data:
        return _Variable("", "<empty>")
    elements = _elements(data, order)
    flags = _next(elements).data
    if len(flags) < 4:
        raise _DamageError("a variable has no class")
    kind = struct.unpack_from(f"{order}I", flags)[0] & 0xFF
    if kind in _OBJECTS:
        return _OBJECT
    size = [int(extent) for extent in _values(_next(elements), order)]
    name = _next(elements).data.decode("ascii", "replace")
    if kind == _STRUCT and size == [1, 1] and depth < _DEEPEST:
        return _Variable(name, _fields(elements, order, depth))
    if kind == _CHAR:
        letters = [int(letter) for letter in _values(_next(elements), order)[:LARGEST_MATRIX]]
        return _Variable(name, "".join(chr(letter) for letter in letters if 0 <= letter < 0xD800))
    if kind in _NUMERIC:
        return _Variable(name, _matrix(_values(_next(elements), order), size))
    return _Variable(name, "<other>")


def _fields(elements: Iterator[_Element], order: str, depth: int) -> dict[str, Node]:
    length = [int(value) for value in _values(_next(elements), order)]
    if len(length) != 1 or length[0] < 1:
        raise _DamageError("a struct does not tell the length of its names")
    text = _next(elements).data
    names = [
        text[at : at + length[0]].split(b"\0")[0].decode("ascii", "replace") for at in range(0, len(text), length[0])
    ]
    return {name: _variable(_next(elements).data, order, depth + 1).node for name in names}


def _values(element: _Element, order: str) -> np.ndarray[tuple[int], np.dtype[np.generic]]:
    kind = np.dtype(f"{order}{_TYPES[element.kind]}")
    return np.frombuffer(element.data[: len(element.data) // kind.itemsize * kind.itemsize], dtype=kind)


def _matrix(values: np.ndarray[tuple[int], np.dtype[np.generic]], size: list[int]) -> Node:
    if len(size) != 2 or size[0] * size[1] != len(values) or not 0 < len(values) <= LARGEST_MATRIX or min(size) < 1:
        return "<matrix>"
    rows: Node = values.astype(np.float64).reshape(size, order="F").tolist()
    return rows
