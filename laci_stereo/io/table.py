"""Tables in CSV files, with the separators, column names and number formats found in practice, and columns of times."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from pathlib import Path
from typing import Generic, TypeAlias, TypeVar

import numpy as np

from laci_stereo.core.errors import InputError
from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.io.epochs import GPS_WEEK_NOTE, OF_GPS_WEEK, WEEK_MS, times_of_weeks
from laci_stereo.io.stamps import iso_time, number, unit_of, with_fractions
from laci_stereo.io.text_file import listed, quoted, read_text

Array = TypeVar("Array", FloatArray, IntArray)
Problems: TypeAlias = Mapping[int, str]
"""Index of each bad row, with the reason."""

BAD_SHARE = 0.2
"""Largest fraction of bad values that is tolerated: more are no exceptions, but mean that the file is unsuitable or was
misunderstood."""

_SHORTEST_LAST = 3
"""Fewest letters of the last name of a path: ``velocity.x`` is no x."""

_DELIMITERS = ",;\t|"
_DELIMITER_LINE = re.compile(r"sep=([,;\t|])\s*")
"""First line by which spreadsheets tell each other the separator."""

_MISSING = frozenset({"", "-", "na", "n/a", "nan", "none", "null", "unavailable"})
_TIME_OF_DAY = re.compile(r"[0-9]{2}:[0-9]{2}:[0-9]{2}")
_DAY_OR_MONTH_FIRST = re.compile(r"[0-9]{1,2}[/-][0-9]{1,2}[/-][0-9]{2,4}\b")
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
        """Return the index of the column in a header, or None.

        Titles may be paths, as where nested messages were flattened: ``its.latitude``, ``heading.heading_value.value``.
        Their last name but ``value`` counts where no whole title fits, and no other ends so.
        """
        names = (plain_name(self.name), *self.synonyms)
        plain = [plain_name(title) for title in header]
        last = [plain_name(_last_name(title)) if "." in title else "" for title in header]
        whole = (plain.index(name) for name in names if name in plain)
        ends = (last.index(name) for name in names if len(name) >= _SHORTEST_LAST and last.count(name) == 1)
        return next(whole, None) if any(name in plain for name in names) else next(ends, None)


def _last_name(path: str) -> str:
    return path.removesuffix(".value").rpartition(".")[2]


TIMESTAMP = Column(
    "timestamp",
    (
        *("timeepoch", "unixtimestamp", "times", "timesec", "timestampsec"),
        *("timestamputc", "timestampunix", "timestamps", "time", "ts", "t", "stamp", "unixtime", "utc", "utctime"),
        *("datetime", "epoch", "timestampns", "timestampus", "timestampms", "timens", "timeus", "timems"),
        *("gpstime", "timestampits", "referencetime", "generationtime"),
    ),
)


_DATE = Column("date", ("dateutc", "utcdate", "datum"))
_SECONDS = Column("sec", ("secs", "stampsec", "stampsecs", "headerstampsec", "headerstampsecs", "tvsec"))
_NANOSECONDS = Column(
    "nanosec", ("nsec", "nsecs", "stampnanosec", "stampnsec", "stampnsecs", "headerstampnanosec", "headerstampnsecs")
)
_GPS_WEEK = Column("gps_week", ("week", "weekno", "weeknumber", "gpsweekno", "gpsweeknumber", "wn", "wnc"))
_GPS_SECONDS = Column(
    "gps_tow_s",
    (
        *("tow", "tows", "gpstow", "timeofweek", "timeofweeks", "gpstimeofweek", "gpstimeofweeks"),
        *("secondsofweek", "sow", "gpssow", "gpsseconds", "gpssecondsofweek"),
    ),
)
_GPS_MILLISECONDS = Column("gps_tow_ms", ("towms", "itow", "itowms", "timeofweekms", "gpsms", "gpsmilliseconds"))


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
    time_notes : tuple of str
        How the column of times was made of others.
    """

    path: Path
    header: list[str]
    rows: list[list[str]]
    line_numbers: list[int]
    problems: Problems
    error: type[InputError]
    time_notes: tuple[str, ...] = ()

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
    """Read a CSV file with a header row and cells separated by commas, semicolons, tabs or bars.

    Numbers may have decimal commas. Comments, lines that begin with ``#``, may go before the header.

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
    rows = [(line_number, [_with_point(cell) for cell in cells]) for line_number, cells in found]
    return table_of(path, header, rows, required, error, row_noun)


def table_of(
    path: Path,
    header: list[str],
    found: Sequence[tuple[int, list[str]]],
    required: Sequence[Column],
    error: type[InputError],
    row_noun: str,
) -> Table:
    """Return a table of rows, each with its number in the file; parameters and errors are those of `read_table`."""
    width = len(header)
    rows = [(cells + [""] * width)[:width] for _, cells in found]
    too_long = {
        i: f"it has {len(cells)} fields; needed are {width}" for i, (_, cells) in enumerate(found) if any(cells[width:])
    }
    time_notes: tuple[str, ...] = ()
    if TIMESTAMP in required:
        header, rows, time_notes = _with_whole_times(header, rows)
    _check_header(path, header, required, error)
    if not found:
        raise error(f"{path} holds a header but no rows; needed is at least one {row_noun}")
    return Table(path, header, rows, [line_number for line_number, _ in found], too_long, error, time_notes)


def _with_whole_times(header: list[str], rows: list[list[str]]) -> tuple[list[str], list[list[str]], tuple[str, ...]]:
    """Join the columns of seconds and nanoseconds, of date and time of day, or of the GPS week and the time in it."""
    place, date = TIMESTAMP.find(header), _DATE.find(header)
    seconds, nanoseconds = _SECONDS.find(header), _NANOSECONDS.find(header)
    if place is not None and date is not None:
        joined = [f"{row[date]} {row[place]}" if _TIME_OF_DAY.match(row[place]) else row[place] for row in rows]
        rows = [[*row[:place], text, *row[place + 1 :]] for row, text in zip(rows, joined, strict=True)]
    elif place is None and seconds is not None and nanoseconds is not None:
        rows = [[*row, f"{row[seconds]}.{row[nanoseconds]:0>9}"] for row in rows]
        header = [*header, TIMESTAMP.name]
    elif place is None and (times := _of_gps_weeks(header, rows)) is not None:
        rows = [[*row, text] for row, text in zip(rows, times, strict=True)]
        return [*header, TIMESTAMP.name], rows, (GPS_WEEK_NOTE,)
    return header, rows, ()


def _of_gps_weeks(header: list[str], rows: list[list[str]]) -> list[str] | None:
    """Return the times of the weeks of GPS and the times in them, as text; None without both columns."""
    week, unit_ns, place = _GPS_WEEK.find(header), 10**9, _GPS_SECONDS.find(header)
    if place is None:
        unit_ns, place = 10**6, _GPS_MILLISECONDS.find(header)
    if week is None or place is None:
        return None
    return times_of_weeks([row[week] for row in rows], [row[place] for row in rows], unit_ns)


def _lines(path: Path, error: type[InputError]) -> list[tuple[int, list[str]]]:
    """Return the line number and the cells of each line that is not empty, from the header on."""
    lines = read_text(path, error).splitlines(keepends=True)
    filled = [i for i, line in enumerate(lines) if line.strip()]
    told = _DELIMITER_LINE.fullmatch(lines[filled[0]])
    if told:
        filled = filled[1:]
    head = _header_at(lines, filled)
    delimiter = told[1] if told else _delimiter(lines[head]) if filled else ","
    reader = csv.reader(io.StringIO("".join(lines[head:]), newline=""), delimiter=delimiter)
    found = []
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            if any(cells):
                found.append((head + reader.line_num, cells))
    except csv.Error as problem:
        raise error(f"{path}, row {head + reader.line_num}: {problem}; needed is a CSV file") from problem
    return found


def _delimiter(line: str) -> str:
    return max(_DELIMITERS, key=line.count)


def _header_at(lines: Sequence[str], filled: Sequence[int]) -> int:
    """Return the index of the header: the last comment before the rows, if it has as many cells, or what follows."""
    comments = next((i for i, place in enumerate(filled) if not lines[place].lstrip().startswith("#")), len(filled))
    if comments in (0, len(filled)):
        return filled[0] if filled else len(lines)
    last, first = lines[filled[comments - 1]], lines[filled[comments]]
    delimiter = _delimiter(last)
    is_header = 0 < last.count(delimiter) == first.count(delimiter)
    return filled[comments - 1] if is_header else filled[comments]


def _check_header(path: Path, header: list[str], required: Sequence[Column], error: type[InputError]) -> None:
    lacking = [column.name for column in required if column.find(header) is None]
    if not lacking:
        return
    columns = f"CSV with the columns {', '.join(column.name for column in required)}"
    if header[0].startswith(("{", "[")):
        raise error(f"{path} is JSON; needed is {columns}")
    if len(header) == 1 and (header[0].endswith(":") or header[0].startswith(("%YAML", "- ", "---"))):
        raise error(f"{path} looks like YAML; needed is {columns}")
    if any(number(_with_point(title)) is not None or iso_time(title) is not None for title in header):
        raise error(f"{path} begins with {listed(header, 4)}; needed is a header row that names the columns")
    week = _GPS_SECONDS.find(header) if _GPS_WEEK.find(header) is None else None
    of_week = "" if week is None else f" (beside {quoted(header[week])}, needed is {_GPS_WEEK.name}, the GPS week)"
    alone = "" if len(header) != 1 else ", as one column: needed are commas, semicolons or tabs between the columns"
    raise error(
        f"{path} lacks the column {', '.join(lacking)}; needed are {', '.join(column.name for column in required)}, "
        f"it holds {listed(header)}{alone}{of_week}"
    )


def stamps_ns(table: Table) -> Parsed[IntArray]:
    """Return the rows' Unix times in nanoseconds; the unit of numbers follows from the magnitude of their median."""
    texts, padding_notes = _padded(table.texts(TIMESTAMP) or [])
    numbers = [number(text) for text in texts]
    moments = [iso_time(text) if value is None else None for text, value in zip(texts, numbers, strict=True)]
    known = sorted(value for value in numbers if value is not None)
    unit = unit_of(known)
    needed = (
        f"a Unix time in {unit.name}"
        if unit is not None
        else "a Unix time or an ISO 8601 time such as 2025-10-09T08:53:22.237Z"
    )
    if unit is None and known and 0 <= known[len(known) // 2] < WEEK_MS:
        needed += "; if it counts from a recording's begin, add that in Unix time"
        needed += f"; if it is of a GPS week, add to its seconds {OF_GPS_WEEK}, or give the columns gps_week, gps_tow_s"
    if any(_DAY_OR_MONTH_FIRST.match(text) for text in texts):
        needed += ", the year first: else the day may be the month"
    stamps: list[int] = []
    problems = {}
    for i, (text, value, moment) in enumerate(zip(texts, numbers, moments, strict=True)):
        stamp = (
            moment.ns if moment is not None else unit.to_ns(value) if unit is not None and value is not None else None
        )
        if stamp is None:
            problems[i] = f"timestamp is {quoted(text)}; needed is {needed}"
        stamps.append(stamp or 0)
    notes = [*table.time_notes, *padding_notes]
    if unit is not None and unit.ns != 10**9 and not table.time_notes:
        notes.append(f"timestamp: Unix time in {unit.name}")
    without_zone = sum(moment is not None and not moment.has_zone for moment in moments)
    if without_zone:
        notes.append(f"timestamp: {without_zone} times without a zone, taken for UTC")
    return Parsed(np.array(stamps, dtype=np.int64), problems, tuple(notes))


def _padded(texts: list[str]) -> tuple[list[str], list[str]]:
    """Return times with the leading zeros that nanoseconds lack behind the point, as in ``1760000002.5`` for 5 ns.

    They lack them where times are in order with these zeros, and not without.
    """
    pairs = [text.partition(".")[::2] for text in texts]
    whole = with_fractions(pairs)
    if whole is None or not _descends(texts) or _descends(whole):
        return texts, []
    return whole, ["timestamp: parts of seconds without leading zeros behind the point, by the order of the rows"]


def _descends(times: Sequence[str]) -> bool:
    values = [Decimal(time) for time in times]
    return any(after < before for before, after in pairwise(values))


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
