"""A LiDAR recording as a source of frames for the monitor."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from laci_lidar.errors import ScanError
from laci_lidar.folder import SCANS, ScanFolder
from laci_lidar.recording import LidarRecording
from laci_lidar.scan import Scan
from laci_lidar.scans import open_scans
from laci_lidar.sequence import ScanSequence
from laci_lidar.settings import LidarSettings, Sweep
from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.errors import CalibrationFileError
from laci_stereo.core.frames import Axes, IntArray
from laci_stereo.core.tracking.background import BACKGROUND_FRAMES
from laci_stereo.monitor.frames import Arrivals


class LidarFrames:
    """The scans of a folder or bag (implements `Frames`).

    Parameters
    ----------
    path : Path
    topic : str or None
        Topic of a bag.
    settings : LidarSettings
    follow : bool
        The path is a folder that may grow: files that are still being written are not used yet, and it may be empty.

    Raises
    ------
    ScanError
        If the path is to be followed and is no folder.
    """

    def __init__(self, path: Path, topic: str | None, settings: LidarSettings, *, follow: bool = False) -> None:
        if follow and not path.is_dir():
            raise ScanError(f"{path}: is no folder, and cannot be followed; needed is a folder of scans")
        self._path, self._topic, self._settings = path, topic, settings
        self._arrivals = Arrivals() if follow else None
        self._scans: ScanSequence | None = None

    @property
    def uri(self) -> str:
        """Path of the folder or bag."""
        return str(self._path)

    @property
    def stamps_ns(self) -> IntArray:
        """Stamps of the scans, Unix time, nanoseconds."""
        return np.zeros(0, dtype=np.int64) if self._scans is None else self._scans.stamps_ns

    @property
    def identity(self) -> dict[str, str]:
        """Digest of the first scan, and the settings with which scans are read."""
        assert self._scans is not None
        first = next(iter(self._scans.read([0], 1)))
        content = b"" if first is None else np.ascontiguousarray(first.points).tobytes()
        settings = {name: str(value) for name, value in asdict(self._settings).items() if name != "workers"}
        return {
            "first scan": hashlib.sha256(content).hexdigest(),
            **{f"lidar.{name}": value for name, value in settings.items()},
        }

    def refresh(self, whole: int) -> None:
        """List the scans that have arrived since the last call.

        Raises
        ------
        ScanError
            If there are none, and the folder is not to be followed.
        """
        if self._arrivals is None:
            self._scans = self._scans or open_scans(self._path, self._topic)
            return
        if not any(SCANS.has(entry) for entry in self._path.iterdir()):
            return
        listed = ScanFolder.open(self._path)
        old = self._scans if isinstance(self._scans, ScanFolder) else ScanFolder(self._path, (), self.stamps_ns)
        last_ns = int(old.stamps_ns[-1]) if len(old) else -1
        first = int(np.searchsorted(listed.stamps_ns, last_ns, side="right"))
        known = max(whole - len(old), 0)
        waiting = [(file,) for file in listed.files[first + known :]]
        stop = first + known + self._arrivals.whole(waiting, time.monotonic())
        if stop > first:
            stamps_ns = np.concatenate([old.stamps_ns, listed.stamps_ns[first:stop]])
            self._scans = ScanFolder(self._path, old.files + listed.files[first:stop], stamps_ns)

    def learn(self, frames: range) -> LidarScene:
        """Learn the field of view, the noise and the static background from some scans."""
        return LidarScene(self, LidarRecording(self.scans(frames), self._settings))

    def scans(self, frames: range) -> Part:
        """Return a range of scans."""
        assert self._scans is not None
        return Part(self._scans, frames)


@dataclass(frozen=True)
class Part:
    """Consecutive scans of a recording (implements `ScanSequence`); unusable ones are reported to the monitor."""

    whole: ScanSequence
    frames: range
    skipped: dict[str, str] = field(default_factory=dict)

    @property
    def path(self) -> Path:
        """Path of the whole recording."""
        return self.whole.path

    @property
    def stamps_ns(self) -> IntArray:
        """Stamps of these scans."""
        return self.whole.stamps_ns[self.frames.start : self.frames.stop]

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of the whole recording."""
        return self.whole.notes

    def __len__(self) -> int:
        return len(self.frames)

    def read(self, indices: Sequence[int], threads: int) -> Iterator[Scan | None]:
        """Yield scans by their index within this part; None if a scan is unreadable."""
        there = [self.frames[index] for index in indices]
        # The sequence is not read to its end, where it raises if many scans are unusable.
        for index, scan in zip(there, islice(self.whole.read(there, threads), len(there)), strict=True):
            if scan is None:
                self.skipped[str(index)] = f"scan {index} is unusable"
            yield scan


@dataclass
class LidarScene:
    """The scene in a part of a LiDAR recording (implements `Scene`)."""

    frames: LidarFrames
    recording: LidarRecording
    unusable: int = 0

    def survey(self) -> Iterator[PointCloud]:
        """Yield whole frames, uniformly spaced, as many as the background needs."""
        return self.recording.whole_frames(BACKGROUND_FRAMES)

    def section(self, frames: range) -> Iterator[PointCloud]:
        """Yield a range of scans as clouds."""
        scans = self.frames.scans(frames)
        part = LidarRecording(scans, self.recording.settings)
        part.scanner = self.recording.scanner
        yield from part
        self.unusable = len(scans.skipped)


def stored_settings(path: Path, workers: int) -> LidarSettings:
    """Return the settings with which the scans of a ``calibration.json`` were read, its axes included.

    Raises
    ------
    CalibrationFileError
        If the file does not contain them.
    """
    try:
        config: dict[str, Any] = json.loads(path.read_bytes())["config"]["lidar"]
        forward, up = (tuple(map(float, config["axes"][name])) for name in ("forward", "up"))
        sweep = Sweep(**config["sweep"]) if isinstance(config["sweep"], dict) else config["sweep"]
        known = {one.name: config[one.name] for one in fields(LidarSettings) if one.name in config}
        return LidarSettings(
            **{
                **known,
                "axes": Axes(forward, up),  # type: ignore[arg-type]
                "sweep": sweep,
                "workers": workers,
                "accumulate": 1,
            }
        )
    except (KeyError, TypeError, ValueError) as problem:
        raise CalibrationFileError(
            f"{path}: config.lidar does not tell how scans are read; needed is a result of laci-lidar, or an import"
        ) from problem
