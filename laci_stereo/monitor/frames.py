"""The interface between a sensor and the monitor: a growing sequence of frames, and the static scene that they show."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol

from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.frames import IntArray

STILL_S = 1.0
"""A file whose size has not changed for this long is complete: writers flush far more often."""


class Scene(Protocol):
    """The static scene as learnt from some frames of a sensor."""

    def survey(self) -> Iterator[PointCloud]:
        """Yield point clouds of whole frames in which little moves."""

    def section(self, frames: range) -> Iterator[PointCloud]:
        """Yield the point clouds of any frames of the recording, in order; empty ones for unreadable frames."""

    @property
    def unusable(self) -> int:
        """Number of frames of the latest section that could not be read, once the section was read to its end."""


class Frames(Protocol):
    """The frames of a recording."""

    @property
    def uri(self) -> str:
        """Location of the recording."""

    @property
    def stamps_ns(self) -> IntArray:
        """Times of the frames known to be complete, ascending, shape (n,), Unix, nanoseconds."""

    @property
    def identity(self) -> dict[str, str]:
        """Properties that identify this recording and how it is read (hashes or values), by name."""

    def refresh(self, whole: int) -> None:
        """Look for new frames; the first ``whole`` frames are known to be complete."""

    def learn(self, frames: range) -> Scene:
        """Learn the static scene from a range of frames."""


class Arrivals:
    """Detects which files of a growing folder are complete: those whose sizes have not changed for `STILL_S`."""

    def __init__(self) -> None:
        self._sizes: dict[Path, tuple[int, float]] = {}

    def whole(self, frames: Sequence[Sequence[Path]], now_s: float) -> int:
        """Return the number of leading frames that are complete.

        Parameters
        ----------
        frames : sequence of sequence of Path
            The files of each frame that was not yet known to be complete.
        now_s : float
            Time of a monotonic clock, seconds.
        """
        still = [False not in [self._still(file, now_s) for file in files] for files in frames]
        count = still.index(False) if False in still else len(still)
        for files in frames[:count]:
            for file in files:
                del self._sizes[file]
        return count

    def _still(self, file: Path, now_s: float) -> bool:
        try:
            size = file.stat().st_size
        except OSError:
            size = -1
        before, since_s = self._sizes.get(file, (None, now_s))
        if size != before:
            self._sizes[file] = (size, now_s)
            return False
        return now_s - since_s >= STILL_S
