"""A folder of scans, one in each file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from laci_lidar.errors import ScanError
from laci_lidar.read import FORMATS, SUFFIXES, ScanFormat, read_scan
from laci_lidar.scan import Scan
from laci_lidar.sequence import counted
from laci_stereo.core.errors import ImageError
from laci_stereo.core.frames import IntArray
from laci_stereo.io.stamps import folder_stamps, iso_text
from laci_stereo.stereo.ahead import map_ahead


@dataclass(frozen=True)
class ScanFolder:
    """The scans in a folder, none of them read yet, in the order of time (implements `ScanSequence`).

    Attributes
    ----------
    path : Path
    files : tuple of Path
    stamps_ns : ndarray of int64, shape (n,)
        Unix time, nanoseconds, strictly ascending.
    skipped : dict of str to str
        The files that could not be read so far, each with the reason, in one line.
    notes : tuple of str
    """

    path: Path
    files: tuple[Path, ...]
    stamps_ns: IntArray
    skipped: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.files)

    @classmethod
    def open(cls, path: Path) -> ScanFolder:
        """List the scans in a folder, by their names. Hidden files and those of no known format are left out.

        Raises
        ------
        ScanError
            If the folder is missing, holds no scan or several formats, or a scan has no time or the time of another.
        """
        names = _scan_names(path)
        try:
            stamps = folder_stamps(path, names)
        except ImageError as problem:
            raise ScanError(str(problem)) from problem
        order = np.argsort(stamps, kind="stable")
        stamps = stamps[order]
        doubled = np.flatnonzero(np.diff(stamps) == 0)
        if len(doubled):
            first, second = (names[order[doubled[0] + i]] for i in (0, 1))
            raise ScanError(
                f"{path}: {first} and {second} have the same time, {iso_text(int(stamps[doubled[0]]))}; needed is one "
                "time for each scan"
            )
        return cls(path, tuple(path / names[i] for i in order), stamps)

    def read(self, indices: Sequence[int], threads: int) -> Iterator[Scan | None]:
        """Yield the scans at the indices, None where one is unreadable.

        Raises
        ------
        ScanError
            At the end, if more than a fifth of them were unreadable.
        """
        return counted(map_ahead(self._attempt, indices, threads), self.skipped)

    def _attempt(self, index: int) -> tuple[str, Scan | ScanError]:
        file = self.files[index]
        try:
            return file.name, read_scan(file, int(self.stamps_ns[index]))
        except ScanError as problem:
            return file.name, problem


def _scan_names(folder: Path) -> list[str]:
    try:
        inside = sorted(folder.iterdir())
    except FileNotFoundError:
        raise ScanError(f"{folder} does not exist; needed is a folder of scans") from None
    except NotADirectoryError:
        raise ScanError(f"{folder} is a file; needed is a folder of scans") from None
    except (OSError, ValueError) as problem:
        raise ScanError(f"{folder} cannot be read: {problem}; needed is a folder of scans") from problem
    scans = [entry for entry in inside if _is_scan(entry)]
    if not scans:
        raise ScanError(
            f"{folder} holds {len(inside)} files but no scan; needed are {', '.join(sorted(SUFFIXES))} files"
        )
    formats = Counter(_format(entry).name for entry in scans)
    if len(formats) > 1:
        found = " and ".join(f"{count} {name}" for name, count in formats.most_common())
        raise ScanError(f"{folder} holds {found} files; needed are scans of one format")
    return [entry.name for entry in scans]


def _is_scan(entry: Path) -> bool:
    return entry.suffix.lower() in SUFFIXES and not entry.name.startswith(".") and entry.is_file()


def _format(entry: Path) -> ScanFormat:
    return next(known for known in FORMATS if entry.suffix.lower() in known.suffixes)
