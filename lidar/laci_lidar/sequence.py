"""The protocol of a recording of scans: stamps are known at once, scans are read on demand."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Protocol

from laci_lidar.errors import ScanError
from laci_lidar.scan import Scan
from laci_stereo.core.cloud import MAX_BAD_SHARE
from laci_stereo.core.frames import IntArray

log = logging.getLogger(__name__)


class ScanSequence(Protocol):
    """A lazy recording, which can be read any number of times."""

    @property
    def path(self) -> Path:
        """Path of the folder or bag."""

    @property
    def stamps_ns(self) -> IntArray:
        """Unix times in nanoseconds, strictly ascending, shape (n,)."""

    @property
    def skipped(self) -> dict[str, str]:
        """The scans that could not be read so far, by name, each with a one-line reason."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks for the user on the recording, one line each."""

    def __len__(self) -> int:
        """Return the number of scans."""

    def read(self, indices: Sequence[int], threads: int) -> Iterator[Scan | None]:
        """Yield the scans at ascending indices; None if a scan is unreadable.

        Raises
        ------
        ScanError
            At the end, if more than a fifth of them were unreadable.
        """


def counted(results: Iterable[tuple[str, Scan | ScanError]], skipped: dict[str, str]) -> Iterator[Scan | None]:
    """Yield scans, None for those that could not be read; the latter are added to ``skipped``.

    Raises
    ------
    ScanError
        At the end, if more than a fifth could not be read.
    """
    attempted, failed = 0, []
    for name, result in results:
        attempted += 1
        if isinstance(result, Scan):
            yield result
            continue
        failed.append(str(result))
        if name not in skipped:
            log.info("%s", result)
        skipped[name] = str(result)
        yield None
    if len(failed) > MAX_BAD_SHARE * attempted:
        raise ScanError(
            f"of what was read so far, {len(failed)} of {attempted} scans are unusable; needed are at least "
            f"{1 - MAX_BAD_SHARE:.0%} usable; the first: {failed[0]}"
        )
