"""Tables in CSV files, with the separators, column names and number formats found in practice, and columns of times."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeAlias, TypeVar

import numpy as np

from laci_stereo.core.errors import InputError
from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.io.epochs import OF_GPS_WEEK, WEEK_MS
from laci_stereo.io.stamps import iso_time, number, unit_of
from laci_stereo.io.text_file import listed, quoted, read_text

Array = TypeVar("Array", FloatArray, IntArray)
Problems: TypeAlias = Mapping[int, str]
"""Index of each bad row, with the reason."""

BAD_SHARE = 0.2
"""Largest fraction of bad values that is tolerated: more are no exceptions, but mean that the file is unsuitable or was
misunderstood."""

_MISSING = frozenset({"", "-", "na", "n/a", "nan", "none", "null", "unavailable"})
_DECIMAL_COMMA = re.compile(r"([+-]?[0-9]*),([0-9]+(?:[eE][+-]?[0-9]+)?)")


@dataclass(frozen=True)
class Column:
    """A column, and the names by which it is recognised.

    Attributes
    ----------
    name : str
        The canonical name.
    synonyms : tuple of str
        Other names, in order of preference, as `plain_name` returns them: case, spaces and underscores of a title do
        not matter.
    """

    name: str
    synonyms: tuple[str, ...]

    def find(self, header: Sequence[str]) -> int | None:
        """Return the index of the column in a header, or None."""
        plain = [plain_name(title) for title in header]
        return next((plain.index(name) for name in (plain_name(self.name), *self.synonyms) if name in plain), None)


TIMESTAMP = Column(
    "timestamp",
    (
        *("timestamputc", "timestampunix", "timestamps", "time", "ts", "t", "stamp", "unixtime", "utc", "utctime"),
        *("datetime", "epoch", "timestampns", "timestampus", "timestampms", "timens", "timeus", "timems"),
        *("gpstime", "timestampits", "referencetime", "generationtime"),
    ),
)


@dataclass(frozen=True)
class Parsed(Generic[Array]):
    """A column's values, shape (n,), the rows whose cell could not be read, and notes on its interpretation."""

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
        Each as long as the header.
    line_numbers : list of int
        Line of the file on which each row ends, counted from 1.
    problems : mapping of int to str
        The rows with more cells than the header.
    error : type of InputError
        The error class to raise if the file is unusable.
    """

    path: Path
    header: list[str]
    rows: list[list[str]]
    line_numbers: list[int]
    problems: Problems
    error: type[InputError]

    def texts(self, column: Column) -> list[str] | None:
        """Return the cells of a column, or None if the table does not have it."""
        place = column.find(self.header)
        return None if place is None else [row[place] for row in self.rows]

    def numbers(self, column: Column) -> Parsed[FloatArray]:
        """Return the numbers in a column, NaN where a cell or the whole column is missing."""
        values = np.full(len(self.rows), np.nan)
        problems = {}
        for i, text in enumerate(self.texts(column) or []):
            if is_missing(text):
                continue
            if number(text) is None or not np.isfinite(float(text)):
                problems[i] = f"{column.name} is {quoted(text)}; needed is a number"
            else:
                values[i] = float(text)
        return Parsed(values, problems)

    def skip_notes(self, problems: Problems) -> list[str]:
        """Return a note on bad rows that are left out, if any.

        Raises
        ------
        InputError
            Of the table's class, if more than a fifth of the rows are bad.
        """
        return skip_notes(self.path, problems, "row", self.line_numbers, self.error)


def read_table(path: Path, required: Sequence[Column], error: type[InputError], row_noun: str) -> Table:
    """Read a CSV file with a header row and cells separated by commas, semicolons or tabs.

    Numbers may have decimal commas.

    Parameters
    ----------
    path : Path
    required : sequence of Column
        The columns without which the table is unusable.
    error : type of InputError
        The error class to raise.
    row_noun : str
        What a row holds, for the error message.

    Raises
    ------
    InputError
        Of the class ``error``, if the file cannot be read, has no rows, or lacks a required column.
    """
    lines = _lines(path, error)
    if not lines:
        raise error(f"{path} holds no header row; needed is one that names the columns")
    (_, titles), *found = lines
    header = [title.lstrip("# ") for title in titles]
    _check_header(path, header, required, error)
    if not found:
        raise error(f"{path} holds a header but no rows; needed is at least one {row_noun}")
    width = len(header)
    too_long = {
        i: f"it has {len(cells)} fields; needed are {width}" for i, (_, cells) in enumerate(found) if any(cells[width:])
    }
    rows = [[_with_point(cell) for cell in (cells + [""] * width)[:width]] for _, cells in found]
    return Table(path, header, rows, [line_number for line_number, _ in found], too_long, error)


def _lines(path: Path, error: type[InputError]) -> list[tuple[int, list[str]]]:
    """Return the line number and the cells of each line that is not empty."""
    text = read_text(path, error)
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
        raise error(f"{path}, row {reader.line_num}: {problem}; needed is a CSV file") from problem
    return lines


def _check_header(path: Path, header: list[str], required: Sequence[Column], error: type[InputError]) -> None:
    lacking = [column.name for column in required if column.find(header) is None]
    if not lacking:
        return
    if any(number(_with_point(title)) is not None or iso_time(title) is not None for title in header):
        raise error(f"{path} begins with {listed(header, 4)}; needed is a header row that names the columns")
    raise error(
        f"{path} lacks the column {', '.join(lacking)}; needed are {', '.join(column.name for column in required)}, "
        f"it holds {listed(header)}"
    )


def stamps_ns(table: Table) -> Parsed[IntArray]:
    """Return the rows' Unix times in nanoseconds; the unit of numbers follows from the magnitude of their median."""
    texts = table.texts(TIMESTAMP) or []
    numbers = [number(text) for text in texts]
    moments = [iso_time(text) if value is None else None for text, value in zip(texts, numbers, strict=True)]
    known = sorted(value for value in numbers if value is not None)
    unit = unit_of(known)
    needed = f"a Unix time in {unit.name}" if unit is not None else "a Unix time or an ISO 8601 time"
    if unit is None and known and 0 <= known[len(known) // 2] < WEEK_MS:
        needed += f"; if it is of a GPS week, add to its seconds {OF_GPS_WEEK}"
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


def skip_notes(path: Path, problems: Problems, noun: str, places: Sequence[int], error: type[InputError]) -> list[str]:
    """Return a note on bad items of a file that are left out, such as rows or lines; ``places`` are their numbers.

    Raises
    ------
    InputError
        Of the class ``error``, if more than a fifth of the items are bad.
    """
    if not problems:
        return []
    first, problem = next(iter(problems.items()))
    where = f"{noun} {places[first]}: {problem}"
    if len(problems) > BAD_SHARE * len(places):
        raise error(f"{path}, {where} ({len(problems)} of {len(places)} {noun}s are bad, at most a fifth may be)")
    return [f"{len(problems)} bad {noun}s skipped, the first of them {where}"]


def merged(problems: Iterable[Problems]) -> Problems:
    """Return the first problem of each row from several sources, in the order of the rows."""
    first: dict[int, str] = {}
    for some in problems:
        first = {**some, **first}
    return dict(sorted(first.items()))


def is_missing(text: str) -> bool:
    """Return whether a cell stands for a missing value."""
    return text.lower() in _MISSING


def plain_name(title: str) -> str:
    """Return a column's title in lower case, with letters and digits only."""
    return "".join(character for character in title.lower() if character.isalnum())


def _with_point(cell: str) -> str:
    """Return a number with a decimal point instead of a comma; anything else unchanged."""
    found = _DECIMAL_COMMA.fullmatch(cell)
    return f"{found[1]}.{found[2]}" if found else cell
