"""Folders of files with a time each, in their names or in a list beside them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from laci_stereo.core.errors import InputError
from laci_stereo.core.frames import IntArray
from laci_stereo.io.stamps import TimeUnit, iso_text, iso_time, number, unit_of, with_fractions
from laci_stereo.io.text_file import quoted, read_text

STAMP_FILES = ("timestamps.txt", "timestamps.csv")

_NUMBER_IN_NAME = re.compile(r"[0-9]+(?:\.[0-9]+)?")

_SEPARATORS = (re.compile(","), re.compile(";"), re.compile(r"\t"), re.compile(r"\s+(?!\s*[0-9]{2}:)"))
"""Between the cells of a list; the time of day stays with its date."""

_UTC_IN_NAME = re.compile(
    r"(?<![0-9])([0-9]{4})[-_]?([0-9]{2})[-_]?([0-9]{2})[T_ -]([0-9]{2})[-_:]?([0-9]{2})[-_:]?([0-9]{2})"
    r"(?:[.,_-]([0-9]{1,9}))?Z(?![a-zA-Z])"
)
"""ISO 8601 in UTC, with what file systems allow instead of colons."""

_DATE = re.compile(r"(?<![0-9])20[0-9]{2}([-_]?)[01][0-9]\1[0-3][0-9]")


@dataclass(frozen=True)
class FileKind:
    """A kind of files in a folder.

    Attributes
    ----------
    noun : str
        Noun for one of them.
    suffixes : frozenset of str
        Lower case.
    formats : str
        The formats, for messages.
    error : type of InputError
        The error class to raise if the folder is unusable.
    """

    noun: str
    suffixes: frozenset[str]
    formats: str
    error: type[InputError]

    def has(self, entry: Path) -> bool:
        """Return whether a path is a file of this kind; hidden files are not."""
        return entry.suffix.lower() in self.suffixes and not entry.name.startswith(".") and entry.is_file()


def names_in(folder: Path, kind: FileKind) -> list[str]:
    """Return the sorted names of the files of a kind.

    Raises
    ------
    InputError
        Of the kind's class, if the folder is missing, cannot be read, or holds no such file.
    """
    needed = f"needed is a folder of {kind.noun}s"
    try:
        inside = sorted(folder.iterdir())
    except FileNotFoundError:
        raise kind.error(f"{folder} does not exist; {needed}") from None
    except NotADirectoryError:
        raise kind.error(f"{folder} is a file; {needed}") from None
    except (OSError, ValueError) as problem:
        why = getattr(problem, "strerror", None) or problem
        raise kind.error(f"{folder} cannot be read: {why}; {needed}") from problem
    if not inside:
        raise kind.error(f"{folder} is empty; needed are {kind.noun}s")
    names = [entry.name for entry in inside if kind.has(entry)]
    if not names:
        below = next((entry for entry in inside if entry.is_dir() and _any_in(entry, kind)), None)
        where = "" if below is None else f", as in {below}"
        raise kind.error(
            f"{folder} holds {len(inside)} files but no {kind.noun}; needed are {kind.formats} files{where}"
        )
    return names


def _any_in(folder: Path, kind: FileKind) -> bool:
    try:
        return any(map(kind.has, folder.iterdir()))
    except OSError:
        return False


def in_time(folder: Path, names: Sequence[str], kind: FileKind) -> tuple[tuple[Path, ...], IntArray]:
    """Return the paths of files ordered by time, and their strictly ascending times (Unix, nanoseconds), shape (n,).

    Raises
    ------
    InputError
        Of the kind's class, if a file has no time, or the same time as another one.
    """
    stamps = folder_stamps(folder, names, kind)
    order = np.argsort(stamps, kind="stable")
    files, stamps = tuple(folder / names[i] for i in order), stamps[order]
    doubled = np.flatnonzero(np.diff(stamps) == 0)
    if len(doubled):
        first, second = files[doubled[0]].name, files[doubled[0] + 1].name
        raise kind.error(
            f"{folder}: {first} and {second} have the same time, {iso_text(int(stamps[doubled[0]]))} "
            f"({stamps[doubled[0]]} ns); needed is one time for each {kind.noun}"
        )
    return files, stamps


def folder_stamps(folder: Path, names: Sequence[str], kind: FileKind) -> IntArray:
    """Return the times of the files in a folder, Unix, nanoseconds, in the order of their names, which are sorted.

    They are read from ``timestamps.txt`` or ``timestamps.csv`` if there is one, else from the files' names; where these
    hold no time, from such a file beside the folder, as in KITTI's recordings.

    Raises
    ------
    InputError
        Of the kind's class, if a file has no time.
    """
    for stamp_file in STAMP_FILES:
        if (folder / stamp_file).is_file():
            return _listed_stamps(folder / stamp_file, names, kind)
    return _stamps_in_names(folder, names, kind)


def _stamps_in_names(folder: Path, names: Sequence[str], kind: FileKind) -> IntArray:
    moments = [_utc_in(name) for name in names]
    if None not in moments:
        return np.array(moments, dtype=np.int64)
    numbers = _numbers_in(names)
    unit, place = _unit_and_place(numbers)
    if unit is None:
        beside = next((path for name in STAMP_FILES if (path := folder.parent / name).is_file()), None)
        if beside is not None:
            return _listed_stamps(beside, names, kind)
        if all(numbers):
            are = "dates, of no time zone that is told" if _DATE.search(names[0]) else "frame numbers, not times"
            raise kind.error(
                f"{folder}: the names (such as {quoted(names[0])}) are {are}; put a timestamps.txt "
                f"with one Unix time per {kind.noun} into the folder, or name the {kind.noun}s by their time, "
                "in Unix seconds or parts of them"
            )
        nameless = next(name for name, found in zip(names, numbers, strict=True) if not found)
        raise kind.error(
            f"{folder}: the name {quoted(nameless)} holds no time; needed is a Unix time in the name of each "
            f"{kind.noun}, or a timestamps.txt in the folder"
        )
    stamps = [unit.to_ns(found[place]) if len(found) > place else None for found in numbers]
    for name, stamp in zip(names, stamps, strict=True):
        if stamp is None:
            raise kind.error(
                f"{folder}: the name {quoted(name)} holds no time in {unit.name}, as the other names do; needed is one "
                "way of naming in the whole folder"
            )
    return np.array(stamps, dtype=np.int64)


def _utc_in(name: str) -> int | None:
    found = _UTC_IN_NAME.search(name)
    if found is None:
        return None
    *clock, fraction = found.groups()
    moment = iso_time("{}-{}-{}T{}:{}:{}".format(*clock) + f".{fraction or 0}Z")
    return None if moment is None else moment.ns


def _numbers_in(names: Sequence[str]) -> list[list[Decimal]]:
    """Return the numbers in each name, with numbers of seconds and of their fraction joined to one."""
    return _whole_numbers([_NUMBER_IN_NAME.findall(Path(name).stem) for name in names])


def _whole_numbers(texts: list[list[str]]) -> list[list[Decimal]]:
    joined = (_joined(texts, place) for place in range(min(map(len, texts))))
    texts = next((found for found in joined if found is not texts), texts)
    return [[Decimal(text) for text in found] for found in texts]


def _joined(texts: list[list[str]], place: int) -> list[list[str]]:
    """Join seconds and parts of them: ``sec_nsec``, ``sec_usec`` or ``sec_msec``, or with a point if not padded.

    Without padding, 1.5 means either five nanoseconds or half a second after second 1; and what follows seconds may be
    a counter. Both are read as parts of a second if that makes the intervals less than half as irregular. Nine digits
    are no counter.
    """
    alone = [found[place] for found in texts]
    dotted = all("." in text for text in alone)
    if dotted:
        pairs, rest = [text.partition(".")[::2] for text in alone], place + 1
    elif all(len(found) > place + 1 for found in texts):
        pairs, rest = [(found[place], found[place + 1]) for found in texts], place + 2
    else:
        return texts
    whole, lengths = with_fractions(pairs), {len(after) for _, after in pairs}
    if whole is None or len({after for _, after in pairs}) < 2 or (dotted and len(lengths) == 1):
        return texts
    if (dotted or max(lengths) < 9) and 2 * _unevenness(whole) >= _unevenness(alone):
        return texts
    return [[*found[:place], one, *found[rest:]] for found, one in zip(texts, whole, strict=True)]


def _unevenness(times: Sequence[str]) -> float:
    """Return the mean absolute deviation of the intervals between times from their median, seconds."""
    first = min(map(Decimal, times))
    steps = np.diff(np.sort([float(Decimal(time) - first) for time in times]))
    return float(np.abs(steps - np.median(steps)).mean())


def _unit_and_place(numbers: list[list[Decimal]]) -> tuple[TimeUnit | None, int]:
    """Return the unit of the times among several numbers each, and the index of the one that is the time."""
    fits = []
    for place in range(max(map(len, numbers), default=0)):
        column = [found[place] for found in numbers if len(found) > place]
        unit = unit_of(column)
        if unit is not None:
            # A serial number is the same everywhere; of two times, the one with the finer unit is used.
            varies = len(set(column)) > 1
            fits.append((sum(unit.to_ns(value) is not None for value in column), varies, -unit.ns, -place, unit))
    if not fits:
        return None, 0
    *_, minus_place, unit = max(fits, key=lambda fit: fit[:4])
    return unit, -minus_place


@dataclass(frozen=True)
class _Row:
    """A row of a list of times.

    Attributes
    ----------
    line : int
        Its line of the file, counted from 1.
    name : str or None
        The file that it names, if any.
    cells : list of str
        The others.
    """

    line: int
    name: str | None
    cells: list[str]

    @property
    def moment_ns(self) -> int | None:
        """The time in ISO 8601, if there is one."""
        return next((moment.ns for cell in self.cells if (moment := iso_time(cell)) is not None), None)

    @property
    def numbers(self) -> list[str]:
        """The numbers, as they are written."""
        return [cell for cell in self.cells if number(cell) is not None]

    @property
    def may_have_time(self) -> bool:
        """Whether there is anything that may be a time, as there is not in a header."""
        return self.moment_ns is not None or bool(self.numbers)


def _listed_stamps(path: Path, names: Sequence[str], kind: FileKind) -> IntArray:
    lines = [line.strip() for line in read_text(path, kind.error).splitlines()]
    by_name = {Path(name).stem: name for name in names} | {name: name for name in names}
    rows = [_row(i, line, by_name) for i, line in enumerate(lines, start=1) if line and not line.startswith("#")]
    if any(row.name is not None for row in rows):
        return _stamps_by_name(path, names, [row for row in rows if row.name is not None and row.may_have_time], kind)
    if rows and not rows[0].may_have_time:
        rows = rows[1:]
    if len(rows) != len(names):
        raise kind.error(
            f"{path} holds {len(rows)} times; needed are {len(names)}, one for each {kind.noun} in the folder"
        )
    return _in_order_of_counters(names, _times(path, rows, kind))


def _in_order_of_counters(names: Sequence[str], stamps: IntArray) -> IntArray:
    """Return the times of files that are listed in the order of the counters in their names, shape (n,).

    By the alphabet, ``frame10`` goes before ``frame2``. That order is kept only if times ascend with the counters so.
    """
    order = sorted(range(len(names)), key=lambda i: _with_counters(names[i]))
    if (np.diff(stamps) < 0).any() and (np.diff(stamps[order]) >= 0).all():
        return stamps
    ordered = np.empty_like(stamps)
    ordered[order] = stamps
    return ordered


def _with_counters(name: str) -> list[str | int]:
    return [int(part) if i % 2 else part for i, part in enumerate(re.split("([0-9]+)", name))]


def _stamps_by_name(path: Path, names: Sequence[str], rows: list[_Row], kind: FileKind) -> IntArray:
    of_name = dict(zip([row.name for row in rows], _times(path, rows, kind), strict=True))
    missing = [name for name in names if name not in of_name]
    if missing:
        raise kind.error(
            f"{path} holds no time for {len(missing)} of {len(names)} {kind.noun}s, "
            f"the first of them {quoted(missing[0])}"
        )
    return np.array([of_name[name] for name in names], dtype=np.int64)


def _row(line: int, text: str, by_name: Mapping[str, str]) -> _Row:
    """Split a row such as ``name stamp``, ``stamp,name`` or ``number;name;stamp;exposure``; names may have a folder."""
    splits = [cells for separator in _SEPARATORS if len(cells := separator.split(text)) > 1]
    # A name may contain spaces.
    ends = [text.split(None, 1), text.rsplit(None, 1)] if " " in text else []
    for split in [*splits, *ends]:
        cells = [cell.strip().strip('"') for cell in split]
        files = [re.split(r"[/\\]", cell)[-1] for cell in cells]
        found = [by_name.get(file) for file in files]
        # A time may look like a name without its suffix.
        place = max(range(len(cells)), key=lambda i: (found[i] is not None, found[i] == files[i], -i))
        if found[place] is not None:
            return _Row(line, found[place], cells[:place] + cells[place + 1 :])
    return _Row(line, None, [cell.strip().strip('"') for cell in max([[text], *splits], key=len)])


def _times(path: Path, rows: list[_Row], kind: FileKind) -> IntArray:
    numbers = _whole_numbers([row.numbers for row in rows if row.moment_ns is None] or [[]])
    unit, place = _unit_and_place(numbers)
    numbered = iter(numbers)
    stamps = []
    for row in rows:
        ns = row.moment_ns
        if ns is None:
            found = next(numbered)
            ns = unit.to_ns(found[place]) if unit is not None and len(found) > place else None
        if ns is None:
            counted = f"a Unix time in {unit.name}" if unit is not None else "a Unix time or an ISO 8601 time"
            raise kind.error(f"{path}, line {row.line}: the time is {quoted(' '.join(row.cells))}; needed is {counted}")
        stamps.append(ns)
    return np.array(stamps, dtype=np.int64)
