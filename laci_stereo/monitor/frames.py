"""What a monitor asks of a sensor: frames that may become more, and the scene at rest as some of them show it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol

from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.frames import IntArray

STILL_S = 1.0
"""A file whose size has not changed for so long is written: writers flush far more often."""


class Scene(Protocol):
    """What a sensor has learnt of its scene at rest."""

    def survey(self) -> Iterator[PointCloud]:
        """Yield whole frames, in which little moves."""

    def section(self, frames: range) -> Iterator[PointCloud]:
        """Yield some frames of the recording, of any time, in order; empty ones for those that cannot be read."""

    @property
    def unusable(self) -> int:
        """How many frames of the latest section could not be read, once it was read to its end."""


class Frames(Protocol):
    """The frames of a recording."""

    @property
    def kind(self) -> str:
        """``stereo`` or ``lidar``."""

    @property
    def uri(self) -> str:
        """Where they are."""

    @property
    def stamps_ns(self) -> IntArray:
        """Times of those that are known to be whole, ascending, shape (n,), Unix, nanoseconds."""

    @property
    def identity(self) -> dict[str, str]:
        """What tells this recording and the way in which it is read from another, by name."""

    def refresh(self, whole: int) -> None:
        """Look for more; so many of the first are known to be whole."""

    def learn(self, frames: range) -> Scene:
        """Learn the scene at rest."""


class Arrivals:
    """Tells which files of a growing folder are whole: those whose sizes have been still."""

    def __init__(self) -> None:
        self._sizes: dict[Path, tuple[int, float]] = {}

    def whole(self, frames: Sequence[Sequence[Path]], now_s: float) -> int:
        """Return how many of the first frames are whole.

        Parameters
        ----------
        frames : sequence of sequence of Path
            The files of each frame that was not known to be whole before.
        now_s : float
            Of a clock that does not jump.
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
