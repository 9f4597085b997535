"""Times as people write them: numbers whose size tells their unit, and ISO 8601; in, and out of, a folder's names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from decimal import Decimal
from pathlib import Path

import numpy as np

from laci_stereo.core.errors import ImageError
from laci_stereo.core.frames import IntArray
from laci_stereo.io.text_file import quoted, read_text

STAMP_FILES = ("timestamps.txt", "timestamps.csv")

_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?")
_NUMBER_IN_NAME = re.compile(r"[0-9]+(?:\.[0-9]+)?")
_ISO = re.compile(
    r"([0-9]{4})-?([0-9]{2})-?([0-9]{2})[Tt ]+([0-9]{2}):?([0-9]{2}):?([0-9]{2})(?:[.,]([0-9]+))?"
    r"\s*(?:([Zz])|([+-])([0-9]{2}):?([0-9]{2})?)?"
)
_UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


@dataclass(frozen=True)
class TimeUnit:
    """A unit that Unix times are counted in.

    Attributes
    ----------
    name : str
    ns : int
        Nanoseconds in one unit.
    """

    name: str
    ns: int

    def to_ns(self, value: Decimal) -> int | None:
        """Return the time in nanoseconds, or None if the number's size says that it has another unit."""
        # From 1973 to 2286: the ranges of two units never touch, and clocks that count from 1980 or 2004 lie inside.
        if not Decimal(10**17) <= value * self.ns < Decimal(9 * 10**18):
            return None
        return int((value * self.ns).to_integral_value())


UNITS = (
    TimeUnit("seconds", 10**9),
    TimeUnit("milliseconds", 10**6),
    TimeUnit("microseconds", 10**3),
    TimeUnit("nanoseconds", 1),
)


def number(text: str) -> Decimal | None:
    """Return the number that a text is, exactly, or None."""
    return Decimal(text) if _NUMBER.fullmatch(text) else None


def unit_of(values: Sequence[Decimal]) -> TimeUnit | None:
    """Return the unit that times are counted in, by the size of the middle one, or None if they are no Unix times."""
    if not values:
        return None
    middle = sorted(values)[len(values) // 2]
    return next((unit for unit in UNITS if unit.to_ns(middle) is not None), None)


@dataclass(frozen=True)
class IsoTime:
    """A time written as ISO 8601.

    Attributes
    ----------
    ns : int
        Unix time, nanoseconds.
    has_zone : bool
        Whether it said how far it is from UTC; where it did not, it was taken for UTC.
    """

    ns: int
    has_zone: bool


def iso_time(text: str) -> IsoTime | None:
    """Return the time that an ISO 8601 text such as ``2011-09-26 13:02:25.964389445`` is, exactly, or None."""
    match = _ISO.fullmatch(text.strip())
    if match is None:
        return None
    *clock, fraction, zulu, sign, hours, minutes = match.groups()
    try:
        moment = datetime(*map(int, clock), tzinfo=timezone.utc)  # type: ignore[misc, arg-type]
        offset = timedelta(hours=int(hours or 0), minutes=int(minutes or 0))
        since_epoch = moment - _UNIX_EPOCH - (-offset if sign == "-" else offset)
    except (ValueError, OverflowError):
        return None
    ns = (since_epoch // timedelta(seconds=1)) * 10**9 + int((fraction or "0")[:9].ljust(9, "0"))
    # Beyond these years an int64 of nanoseconds overflows.
    return IsoTime(ns, bool(zulu or sign)) if 1700 <= moment.year <= 2200 else None


def iso_text(stamp_ns: int) -> str:
    """Return a Unix time as ISO 8601 in UTC, to the millisecond."""
    return (_UNIX_EPOCH + timedelta(milliseconds=round(stamp_ns / 10**6))).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z"


def folder_stamps(folder: Path, names: Sequence[str]) -> IntArray:
    """Find the times of the files in a folder.

    They are in ``timestamps.txt`` or ``timestamps.csv`` where there is one, and in the files' names where not.

    Parameters
    ----------
    folder : Path
    names : sequence of str
        Sorted; at least one.

    Returns
    -------
    ndarray of int64, shape (n,)
        Unix time in nanoseconds, in the order of the names.

    Raises
    ------
    ImageError
        If a file has no time.
    """
    for stamp_file in STAMP_FILES:
        if (folder / stamp_file).is_file():
            return _listed_stamps(folder / stamp_file, names)
    return _stamps_in_names(folder, names)


def _stamps_in_names(folder: Path, names: Sequence[str]) -> IntArray:
    numbers = [[Decimal(found) for found in _NUMBER_IN_NAME.findall(Path(name).stem)] for name in names]
    unit, place = _unit_and_place(numbers)
    if unit is None:
        if all(numbers):
            raise ImageError(
                f"{folder}: the names (such as {quoted(names[0])}) are frame numbers, not times; put a timestamps.txt "
                "with one Unix time per image into the folder, or name the images by their time"
            )
        nameless = next(name for name, found in zip(names, numbers, strict=True) if not found)
        raise ImageError(
            f"{folder}: the name {quoted(nameless)} holds no time; needed is a Unix time in the name of each image, "
            "or a timestamps.txt in the folder"
        )
    stamps = [unit.to_ns(found[place]) if len(found) > place else None for found in numbers]
    for name, stamp in zip(names, stamps, strict=True):
        if stamp is None:
            raise ImageError(
                f"{folder}: the name {quoted(name)} holds no time in {unit.name}, as the other names do; needed is one "
                "way of naming in the whole folder"
            )
    return np.array(stamps, dtype=np.int64)


def _unit_and_place(numbers: list[list[Decimal]]) -> tuple[TimeUnit | None, int]:
    """Return the unit of the times in the names, and which of the numbers in a name is the time."""
    fits = []
    for place in range(max(len(found) for found in numbers)):
        column = [found[place] for found in numbers if len(found) > place]
        unit = unit_of(column)
        if unit is not None:
            # Of two times in the names the finer one tells more.
            fits.append((sum(unit.to_ns(value) is not None for value in column), -unit.ns, -place, unit))
    if not fits:
        return None, 0
    *_, minus_place, unit = max(fits, key=lambda fit: fit[:3])
    return unit, -minus_place


def _listed_stamps(path: Path, names: Sequence[str]) -> IntArray:
    lines = [line.strip() for line in read_text(path, ImageError).splitlines()]
    rows = [(i, line) for i, line in enumerate(lines, start=1) if line and not line.startswith("#")]
    by_name = {Path(name).stem: name for name in names} | {name: name for name in names}
    split = [_named(line, by_name) for _, line in rows]
    if any(name is not None for name, _ in split[:2]):
        return _stamps_by_name(path, names, rows, split)
    if rows and not _is_time(rows[0][1]):
        rows = rows[1:]
    if len(rows) != len(names):
        raise ImageError(f"{path} holds {len(rows)} times; needed are {len(names)}, one for each image in the folder")
    return _times(path, rows)


def _stamps_by_name(
    path: Path, names: Sequence[str], rows: list[tuple[int, str]], split: list[tuple[str | None, str]]
) -> IntArray:
    known = [
        (i, name, stamp)
        for (i, _), (name, stamp) in zip(rows, split, strict=True)
        if name is not None and _is_time(stamp)
    ]
    stamps = _times(path, [(i, stamp) for i, _, stamp in known])
    of_name = {name: stamp for (_, name, _), stamp in zip(known, stamps, strict=True)}
    missing = [name for name in names if name not in of_name]
    if missing:
        raise ImageError(
            f"{path} holds no time for {len(missing)} of {len(names)} images, the first of them {quoted(missing[0])}"
        )
    return np.array([of_name[name] for name in names], dtype=np.int64)


def _named(line: str, by_name: Mapping[str, str]) -> tuple[str | None, str]:
    """Return the file's name and the rest of a row such as ``name stamp``, ``name,stamp`` or ``stamp,name``."""
    for separator in (",", ";", "\t", None):
        for fields in (line.split(separator, 1), line.rsplit(separator, 1)):
            if len(fields) == 2:
                first, second = (field.strip().strip('"') for field in fields)
                if first in by_name:
                    return by_name[first], second
                if second in by_name:
                    return by_name[second], first
    return None, line


def _is_time(text: str) -> bool:
    return number(text) is not None or iso_time(text) is not None


def _times(path: Path, rows: list[tuple[int, str]]) -> IntArray:
    numbers = [value for value in (number(text) for _, text in rows) if value is not None]
    unit = unit_of(numbers)
    stamps = []
    for i, text in rows:
        value, moment = number(text), iso_time(text)
        ns = unit.to_ns(value) if unit is not None and value is not None else moment.ns if moment is not None else None
        if ns is None:
            counted = f"a Unix time in {unit.name}" if unit is not None else "a Unix time or an ISO 8601 time"
            raise ImageError(f"{path}, line {i}: the time is {quoted(text)}; needed is {counted}")
        stamps.append(ns)
    return np.array(stamps, dtype=np.int64)
