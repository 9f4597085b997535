"""Stereo recordings as frames for the monitor."""

from __future__ import annotations

import copy
import hashlib
import logging
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.errors import ImageError
from laci_stereo.core.frames import IntArray
from laci_stereo.io.images import ImageFolder, StereoPair, first_size, pair_images
from laci_stereo.io.rig.stereo_calibration import read_stereo_calibration
from laci_stereo.io.rig.stereo_rig import StereoRig
from laci_stereo.mask.stage import VehicleMask
from laci_stereo.monitor.frames import Arrivals
from laci_stereo.stereo.reader import GreyReader
from laci_stereo.stereo.recording import StereoRecording
from laci_stereo.stereo.settings import StereoSettings

log = logging.getLogger(__name__)


class StereoFrames:
    """The image pairs of two folders (implements `Frames`).

    Parameters
    ----------
    left, right : Path
        Folders of the left and right images.
    stereo : tuple of Path
        Files of the stereo calibration.
    settings : StereoSettings
    mask : VehicleMask or None
    follow : bool
        Whether the folders may grow. If so, files that are still being written are held back, and empty folders are no
        error.
    """

    def __init__(
        self,
        left: Path,
        right: Path,
        stereo: tuple[Path, ...],
        settings: StereoSettings,
        mask: VehicleMask | None = None,
        *,
        follow: bool = False,
    ) -> None:
        self._left, self._right, self._stereo = left, right, stereo
        self._settings, self._mask = settings, mask
        self._pairs: list[StereoPair] = []
        self._arrivals = Arrivals() if follow else None

    @property
    def uri(self) -> str:
        """The folder of left images."""
        return str(self._left)

    @property
    def stamps_ns(self) -> IntArray:
        """Times of the pairs."""
        return np.array([pair.stamp_ns for pair in self._pairs], dtype=np.int64)

    @property
    def identity(self) -> dict[str, str]:
        """Hashes of the first image and the stereo calibration, and the settings of the stereo matching, by name."""
        settings = {name: str(value) for name, value in asdict(self._settings).items() if name != "workers"}
        return {
            "first image": hashlib.sha256(self._pairs[0].left.read_bytes()).hexdigest(),
            "stereo calibration": hashlib.sha256(b"".join(file.read_bytes() for file in self._stereo)).hexdigest(),
            **{f"stereo.{name}": value for name, value in settings.items()},
        }

    def refresh(self, whole: int) -> None:
        """List the pairs that have arrived since the last call; see `Frames.refresh`.

        Raises
        ------
        ImageError
            If the folders hold no pairs and are not followed, or one of them does not exist.
        """
        if self._arrivals is None and self._pairs:
            return
        last_ns = self._pairs[-1].stamp_ns if self._pairs else -1
        try:
            listed = pair_images(ImageFolder.open(self._left), ImageFolder.open(self._right)).pairs
        except ImageError as problem:
            if self._arrivals is None or not self._left.is_dir() or not self._right.is_dir():
                raise
            log.info("waiting: %s", problem)
            return
        new = [pair for pair in listed if pair.stamp_ns > last_ns]
        if self._arrivals is not None:
            known = max(whole - len(self._pairs), 0)
            waiting = [pair.images for pair in new[known:]]
            new = new[: known + self._arrivals.whole(waiting, time.monotonic())]
        self._pairs += new

    def learn(self, frames: range) -> StereoScene:
        """Return the static scene of a range of pairs: how it looks, and its road."""
        recording = StereoRecording(
            self._pairs,
            self._rig,
            self._settings,
            background=self._pairs[frames.start : frames.stop],
            mask=self._mask,
        )
        return StereoScene(recording)

    @cached_property
    def _rig(self) -> StereoRig:
        size = first_size(pair.left for pair in self._pairs)
        return read_stereo_calibration(self._stereo, size, self._left, self._settings.baseline_m, self._right)


class _Patient(GreyReader):
    """A reader without a limit on unusable images; the monitor has its own."""

    def check(self, frames: Sequence[tuple[Path, ...]]) -> None:
        """Accept any number of unusable images."""


@dataclass
class StereoScene:
    """The static scene, learnt from a range of a stereo recording's pairs (implements `Scene`)."""

    recording: StereoRecording
    unusable: int = 0

    def survey(self) -> Iterator[PointCloud]:
        """Yield point clouds of whole frames, those in which least moves."""
        return self.recording.survey()

    def section(self, frames: range) -> Iterator[PointCloud]:
        """Yield point clouds of the parts of the pairs that differ from this scene."""
        self.recording.whole_region()  # the copy below shares what has been learnt by now
        part = copy.copy(self.recording)
        part.pairs = self.recording.pairs[frames.start : frames.stop]
        part.reader = _Patient(part.rig)
        part.reader.eight_bit = self.recording.reader.eight_bit
        yield from part
        self.unusable = len(part.skipped)
