"""The syntaxes of calibration files, recognised by content: FileStorage, lines, sections, MATLAB's, NumPy's."""

from __future__ import annotations

import re
from configparser import ConfigParser
from configparser import Error as ConfigError
from pathlib import Path

from laci_stereo.core.errors import RigError
from laci_stereo.io.file_content import read_content
from laci_stereo.io.file_storage import Node, StorageError, parse_file_storage
from laci_stereo.io.numpy_file import ARCHIVE_MAGIC, archived
from laci_stereo.io.rig.document import Document
from laci_stereo.io.rig.mat_file import MAT_MAGICS, parse_mat
from laci_stereo.io.text_file import shortened, text_in

LARGEST_FILE = 1 << 23
"""Bytes: a calibration with all corners that were detected for it has a tenth of that."""

_LARGEST_ARRAY = 10_000
"""Bytes: the rotation vectors of a hundred images are not needed."""

_KITTI = re.compile(r"^(?:K_0\d|P_rect_0\d|P\d):\s+[-+.\d]+e?[-+\d]*(?:\s|$)", re.MULTILINE)
_KITTI_LINE = re.compile(r"(\w+):\s*(.*)")
_MIDDLEBURY = re.compile(r"^\s*cam0\s*=\s*\[", re.MULTILINE)
_MIDDLEBURY_LINE = re.compile(r"\s*(\w+)\s*=\s*(.*)")


_ZED = re.compile(r"^\s*\[LEFT_CAM_\w+\]\s*$", re.MULTILINE)


def read_document(path: Path) -> Document:
    """Read a calibration file.

    Raises
    ------
    RigError
        If the file is missing, larger than calibrations are, or in none of these syntaxes.
    """
    content = read_content(path, RigError, "a stereo calibration", LARGEST_FILE)
    if content.startswith(MAT_MAGICS):
        return Document(str(path), parse_mat(path, content))
    if content.startswith(ARCHIVE_MAGIC):
        return Document(str(path), _arrays(path, content))
    text = text_in(content, path, RigError)
    if len(text) > LARGEST_FILE:
        raise RigError(
            f"{path} unpacks to {len(text)} letters; needed is a stereo calibration, of at most {LARGEST_FILE}"
        )
    return Document(str(path), _parsed(path, text))


def _arrays(path: Path, content: bytes) -> dict[str, Node]:
    """Return the numbers of NumPy's ``.npz``, without large arrays such as corners."""
    arrays = archived(content, str(path), RigError, largest=_LARGEST_ARRAY)
    return {name: _node(array.tolist()) for name, array in arrays.items() if array.dtype.kind in "fiu"}


def _node(values: object) -> Node:
    return [_node(value) for value in values] if isinstance(values, list) else float(str(values))


def _parsed(path: Path, text: str) -> dict[str, Node]:
    if _KITTI.search(text):
        return _lines(text, _KITTI_LINE)
    if _MIDDLEBURY.search(text):
        return _lines(text, _MIDDLEBURY_LINE)
    if _ZED.search(text):
        return _sections(path, text)
    try:
        return dict(parse_file_storage(text))
    except StorageError as problem:
        raise RigError(
            f"{path} is no OpenCV FileStorage file (YAML, JSON or XML), nor in any other known format: {problem}"
        ) from problem


def _lines(text: str, pattern: re.Pattern[str]) -> dict[str, Node]:
    """Return the entries of a file with one entry per line; semicolons separate the rows of a matrix in brackets."""
    root: dict[str, Node] = {}
    for line in text.splitlines():
        match = pattern.fullmatch(line.strip())
        if match:
            root[match[1]] = _values(match[2])
    return root


def _sections(path: Path, text: str) -> dict[str, Node]:
    """Return the sections of an INI file, their names in capitals."""
    parser = ConfigParser(strict=False, interpolation=None)
    try:
        parser.read_string(text)
    except ConfigError as problem:
        raise RigError(f"{path} cannot be read: {shortened(str(problem))}; needed is a ZED's SN*.conf") from problem
    return {
        name.upper(): {entry: _values(value) for entry, value in section.items()} for name, section in parser.items()
    }


def _values(text: str) -> Node:
    rows: list[Node] = [_row(row) for row in text.strip("[] ").split(";")]
    return rows[0] if len(rows) == 1 else rows


def _row(text: str) -> Node:
    try:
        numbers: list[Node] = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        return text.strip()
    return numbers[0] if len(numbers) == 1 else numbers
