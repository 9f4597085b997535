"""The rows of a CSV file of messages, and its columns as times, whole numbers and numbers."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeAlias, TypeVar

import numpy as np

from laci_stereo.core.errors import CamError
from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.io.cam_columns import COLUMNS, REQUIRED, SPEED, STATION_ID, TIMESTAMP, Column, Quantity
from laci_stereo.io.stamps import iso_time, number, unit_of
from laci_stereo.io.text_file import listed, quoted, read_text

Array = TypeVar("Array", FloatArray, IntArray)
Problems: TypeAlias = Mapping[int, str]
"""What is wrong with a row, by its index."""

_MISSING = frozenset({"", "-", "na", "n/a", "nan", "none", "null", "unavailable"})


@dataclass(frozen=True)
class Parsed(Generic[Array]):
    """A column's values, shape (n,), the rows whose cell could not be read, and how the others were understood."""

    values: Array
    problems: Problems
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Table:
    """A CSV file.

    Attributes
    ----------
    path : Path
    header : list of str
    rows : list of list of str
        Each as wide as the header.
    line_numbers : list of int
        Where each row stands in the file, the header being row 1.
    problems : mapping of int to str
        The rows that have more cells than the header.
    """

    path: Path
    header: list[str]
    rows: list[list[str]]
    line_numbers: list[int]
    problems: Problems

    def texts(self, column: Column) -> list[str] | None:
        """Return the cells of a column, or None if there is no such column."""
        place = column.find(self.header)
        return None if place is None else [row[place] for row in self.rows]

    def notes(self) -> list[str]:
        """Return which columns stand in for others, and which are lacking."""
        places = {column: column.find(self.header) for column in COLUMNS}
        notes = [
            f"column {self.header[place]} read as {column.name}"
            for column, place in places.items()
            if place is not None and self.header[place] != column.name
        ]
        return notes if places[SPEED] is not None else [*notes, "no column speed; it follows from the positions"]


def read_table(path: Path) -> Table:
    """Read a CSV file with a header row, whose cells are separated by commas, semicolons or tabs.

    Raises
    ------
    CamError
        If it cannot be read, has no rows, or lacks a column that a log of messages needs.
    """
    text = read_text(path, CamError)
    first_line = next(line for line in text.splitlines() if line.strip())
    separator = max(",;\t", key=first_line.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=separator)
    lines = []
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            if any(cells):
                lines.append((reader.line_num, cells))
    except csv.Error as problem:
        raise CamError(f"{path}, row {reader.line_num}: {problem}; needed is a CSV file") from problem
    if not lines:
        raise CamError(f"{path} holds no header row; needed is one that names the columns")
    (_, titles), *found = lines
    header = [title.lstrip("# ") for title in titles]
    _check_header(path, header)
    if not found:
        raise CamError(f"{path} holds a header but no rows; needed is at least one message")
    width = len(header)
    too_long = {
        i: f"it has {len(cells)} fields; needed are {width}" for i, (_, cells) in enumerate(found) if any(cells[width:])
    }
    rows = [(cells + [""] * width)[:width] for _, cells in found]
    return Table(path, header, rows, [line_number for line_number, _ in found], too_long)


def stamps_ns(table: Table) -> Parsed[IntArray]:
    """Return the messages' Unix times in nanoseconds; the unit follows from the size of the middle one."""
    texts = table.texts(TIMESTAMP) or []
    numbers = [number(text) for text in texts]
    moments = [iso_time(text) if value is None else None for text, value in zip(texts, numbers, strict=True)]
    unit = unit_of([value for value in numbers if value is not None])
    needed = f"a Unix time in {unit.name}" if unit is not None else "a Unix time or an ISO 8601 time"
    stamps: list[int] = []
    problems = {}
    for i, (text, value, moment) in enumerate(zip(texts, numbers, moments, strict=True)):
        stamp = (
            moment.ns if moment is not None else unit.to_ns(value) if unit is not None and value is not None else None
        )
        if stamp is None:
            problems[i] = f"timestamp is {quoted(text)}; needed is {needed}"
        stamps.append(stamp or 0)
    notes = []
    if unit is not None and unit.ns != 10**9:
        notes.append(f"timestamp: Unix time in {unit.name}")
    without_zone = sum(moment is not None and not moment.has_zone for moment in moments)
    if without_zone:
        notes.append(f"timestamp: {without_zone} times without a zone, taken for UTC")
    return Parsed(np.array(stamps, dtype=np.int64), problems, tuple(notes))


def station_ids(table: Table) -> Parsed[IntArray]:
    """Return who sent each message; without such a column all are from station 0."""
    texts = table.texts(STATION_ID)
    if texts is None or all(_is_missing(text) for text in texts):
        note = "no station_id; all rows are taken for those of one station, 0"
        return Parsed(np.zeros(len(table.rows), dtype=np.int64), {}, (note,))
    ids = [_whole(text) for text in texts]
    problems = {
        i: f"station_id is {quoted(text)}; needed is a whole number below 2^63"
        for i, (text, station) in enumerate(zip(texts, ids, strict=True))
        if station is None
    }
    return Parsed(np.array([station or 0 for station in ids], dtype=np.int64), problems)


def numbers_of(table: Table, quantity: Quantity) -> Parsed[FloatArray]:
    """Return a quantity's numbers, in whatever unit they are; NaN where they are missing."""
    values = np.full(len(table.rows), np.nan)
    problems = {}
    for i, text in enumerate(table.texts(quantity) or []):
        if _is_missing(text):
            continue
        if number(text) is None or not np.isfinite(float(text)):
            problems[i] = f"{quantity.name} is {quoted(text)}; needed is a number"
        else:
            values[i] = float(text)
    known = quantity.known(values)
    unavailable = int((np.isnan(known) & ~np.isnan(values)).sum())
    note = f'{quantity.name}: {unavailable} times {quantity.unavailable}, ETSI\'s "unavailable"; taken as missing'
    return Parsed(known, problems, (note,) if unavailable else ())


def merged(problems: Iterable[Problems]) -> Problems:
    """Return what is wrong with each row, the first of several things, in the order of the rows."""
    first: dict[int, str] = {}
    for some in problems:
        first = {**some, **first}
    return dict(sorted(first.items()))


def _check_header(path: Path, header: list[str]) -> None:
    lacking = [column.name for column in REQUIRED if column.find(header) is None]
    if not lacking:
        return
    if any(number(title) is not None or iso_time(title) is not None for title in header):
        raise CamError(f"{path} begins with {listed(header, 4)}; needed is a header row that names the columns")
    raise CamError(
        f"{path} lacks the column {', '.join(lacking)}; needed are {', '.join(column.name for column in REQUIRED)}, "
        f"it holds {listed(header)}"
    )


def _is_missing(text: str) -> bool:
    return text.lower() in _MISSING


def _whole(text: str) -> int | None:
    value = number(text)
    return int(value) if value is not None and -(2**63) <= value < 2**63 and value % 1 == 0 else None
