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
from laci_stereo.io.stamps import TimeUnit, iso_text, iso_time, number, unit_of
from laci_stereo.io.text_file import quoted, read_text

STAMP_FILES = ("timestamps.txt", "timestamps.csv")

_NUMBER_IN_NAME = re.compile(r"[0-9]+(?:\.[0-9]+)?")
_SECONDS = re.compile(r"[0-9]{10}")
_NANOSECONDS = re.compile(r"[0-9]{1,9}")
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
    """Return the times of the files in a folder.

    They are read from ``timestamps.txt`` or ``timestamps.csv`` if there is one, else from the files' names.

    Parameters
    ----------
    folder : Path
    names : sequence of str
        Sorted names of the files; at least one.
    kind : FileKind

    Returns
    -------
    ndarray of int64, shape (n,)
        Unix time in nanoseconds, in the order of the names.

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
    numbers = _numbers_in(names)
    unit, place = _unit_and_place(numbers)
    if unit is None:
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


def _numbers_in(names: Sequence[str]) -> list[list[Decimal]]:
    """Return the numbers in each name, with numbers of seconds and of nanoseconds joined to one."""
    texts = [_NUMBER_IN_NAME.findall(Path(name).stem) for name in names]
    joined = (_joined(texts, place) for place in range(min(map(len, texts))))
    texts = next((found for found in joined if found is not texts), texts)
    return [[Decimal(text) for text in found] for found in texts]


def _joined(texts: list[list[str]], place: int) -> list[list[str]]:
    """Join seconds and nanoseconds: ``sec_nsec``, or ``sec.nsec`` if the latter is not padded to nine digits.

    Without padding, 1.5 means either five nanoseconds or half a second after second 1. It is read as nanoseconds if
    that makes the intervals less than half as irregular.
    """
    dotted = ["." in found[place] for found in texts]
    if all(dotted):
        pairs = [found[place].split(".") for found in texts]
        rest = place + 1
    elif not any(dotted) and all(len(found) > place + 1 for found in texts):
        pairs = [found[place : place + 2] for found in texts]
        rest = place + 2
    else:
        return texts
    lengths = {len(after) for _, after in pairs}
    fit = all(_SECONDS.fullmatch(before) and _NANOSECONDS.fullmatch(after) for before, after in pairs)
    if not fit or max(lengths) < 9 or len({after for _, after in pairs}) < 2:
        return texts
    whole = [f"{before}.{after:>09}" for before, after in pairs]
    if all(dotted) and (len(lengths) == 1 or 2 * _unevenness(whole) > _unevenness([found[place] for found in texts])):
        return texts
    return [[*found[:place], one, *found[rest:]] for found, one in zip(texts, whole, strict=True)]


def _unevenness(times: Sequence[str]) -> float:
    """Return the mean absolute deviation of the intervals between times from their median, seconds."""
    first = min(map(Decimal, times))
    steps = np.diff(np.sort([float(Decimal(time) - first) for time in times]))
    return float(np.abs(steps - np.median(steps)).mean())


def _unit_and_place(numbers: list[list[Decimal]]) -> tuple[TimeUnit | None, int]:
    """Return the unit of the times in the names, and the index of the number in each name that is the time."""
    fits = []
    for place in range(max(len(found) for found in numbers)):
        column = [found[place] for found in numbers if len(found) > place]
        unit = unit_of(column)
        if unit is not None:
            # If the names hold two times, the one with the finer unit is used.
            fits.append((sum(unit.to_ns(value) is not None for value in column), -unit.ns, -place, unit))
    if not fits:
        return None, 0
    *_, minus_place, unit = max(fits, key=lambda fit: fit[:3])
    return unit, -minus_place


def _listed_stamps(path: Path, names: Sequence[str], kind: FileKind) -> IntArray:
    lines = [line.strip() for line in read_text(path, kind.error).splitlines()]
    rows = [(i, line) for i, line in enumerate(lines, start=1) if line and not line.startswith("#")]
    by_name = {Path(name).stem: name for name in names} | {name: name for name in names}
    split = [_named(line, by_name) for _, line in rows]
    if any(name is not None for name, _ in split[:2]):
        return _stamps_by_name(path, names, rows, split, kind)
    if rows and not _is_time(rows[0][1]):
        rows = rows[1:]
    if len(rows) != len(names):
        raise kind.error(
            f"{path} holds {len(rows)} times; needed are {len(names)}, one for each {kind.noun} in the folder"
        )
    return _times(path, rows, kind)


def _stamps_by_name(
    path: Path, names: Sequence[str], rows: list[tuple[int, str]], split: list[tuple[str | None, str]], kind: FileKind
) -> IntArray:
    known = [
        (i, name, stamp)
        for (i, _), (name, stamp) in zip(rows, split, strict=True)
        if name is not None and _is_time(stamp)
    ]
    stamps = _times(path, [(i, stamp) for i, _, stamp in known], kind)
    of_name = {name: stamp for (_, name, _), stamp in zip(known, stamps, strict=True)}
    missing = [name for name in names if name not in of_name]
    if missing:
        raise kind.error(
            f"{path} holds no time for {len(missing)} of {len(names)} {kind.noun}s, "
            f"the first of them {quoted(missing[0])}"
        )
    return np.array([of_name[name] for name in names], dtype=np.int64)


def _named(line: str, by_name: Mapping[str, str]) -> tuple[str | None, str]:
    """Split a row such as ``name stamp``, ``name,stamp`` or ``stamp,name`` into the file's name and the rest."""
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


def _times(path: Path, rows: list[tuple[int, str]], kind: FileKind) -> IntArray:
    numbers = [value for value in (number(text) for _, text in rows) if value is not None]
    unit = unit_of(numbers)
    stamps = []
    for i, text in rows:
        value, moment = number(text), iso_time(text)
        ns = unit.to_ns(value) if unit is not None and value is not None else moment.ns if moment is not None else None
        if ns is None:
            counted = f"a Unix time in {unit.name}" if unit is not None else "a Unix time or an ISO 8601 time"
            raise kind.error(f"{path}, line {i}: the time is {quoted(text)}; needed is {counted}")
        stamps.append(ns)
    return np.array(stamps, dtype=np.int64)
