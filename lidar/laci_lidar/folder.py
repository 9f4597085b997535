"""A folder of scans, with one scan in each file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from laci_lidar.errors import ScanError
from laci_lidar.read import FORMATS, SUFFIXES, ScanFormat, read_scan
from laci_lidar.scan import Scan
from laci_lidar.sequence import counted
from laci_stereo.core.frames import IntArray
from laci_stereo.io.ahead import map_ahead
from laci_stereo.io.timed_files import FileKind, in_time, names_in

SCANS = FileKind("scan", SUFFIXES, ", ".join(sorted(SUFFIXES)), ScanError)


@dataclass(frozen=True)
class ScanFolder:
    """The scans in a folder in order of time, read only on demand (implements `ScanSequence`).

    Attributes
    ----------
    path : Path
    files : tuple of Path
    stamps_ns : ndarray of int64, shape (n,)
        Unix time, nanoseconds, strictly ascending.
    skipped : dict of str to str
        The files that could not be read so far, each with a one-line reason.
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
        """List the scans in a folder by their names. Hidden files and files of unknown formats are left out.

        Raises
        ------
        ScanError
            If the folder is missing or contains no scan or several formats, or a scan has no time or another one's.
        """
        names = names_in(path, SCANS)
        formats = Counter(_format(name).name for name in names)
        if len(formats) > 1:
            found = " and ".join(f"{count} {name}" for name, count in formats.most_common())
            raise ScanError(f"{path} holds {found} files; needed are scans of one format")
        return cls(path, *in_time(path, names, SCANS))

    def read(self, indices: Sequence[int], threads: int) -> Iterator[Scan | None]:
        """Yield the scans at the indices, see `ScanSequence`."""
        return counted(map_ahead(self._attempt, indices, threads), self.skipped)

    def _attempt(self, index: int) -> tuple[str, Scan | ScanError]:
        file = self.files[index]
        try:
            return file.name, read_scan(file, int(self.stamps_ns[index]))
        except ScanError as problem:
            return file.name, problem


def _format(name: str) -> ScanFormat:
    return next(known for known in FORMATS if name.lower().endswith(known.suffixes))
