"""Calibration of a LiDAR from scans to a result: what ``laci-lidar calibrate`` runs, for use from Python."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from itertools import islice
from pathlib import Path

from laci_lidar.check import check_scans
from laci_lidar.errors import ScanError
from laci_lidar.recording import LidarRecording
from laci_lidar.scan import Scan
from laci_lidar.scans import open_scans
from laci_lidar.sequence import ScanSequence
from laci_lidar.settings import LidarSettings, Sweep
from laci_stereo.check.images import Checked
from laci_stereo.check.result import placed_by
from laci_stereo.core.result import Calibration
from laci_stereo.core.subsampling import spread
from laci_stereo.io.maps.lane_map import find_lane_map
from laci_stereo.io.result.calibration_file import Provenance
from laci_stereo.io.stamp_errors import StampErrors
from laci_stereo.job import DriveOptions, Job, Result, read_drive

LOOKED_AT = 5
"""Number of scans that are read to see whether points have times; the others come from the same driver."""


@dataclass(frozen=True, kw_only=True)
class LidarOptions(DriveOptions):
    """The user's options for the calibration of a LiDAR; without a topic, the only one of a bag with point clouds."""

    topic: str | None = None
    scanner: LidarSettings = field(default_factory=LidarSettings)

    def config(self) -> dict[str, object]:
        """Return all effective settings; paths are listed among the inputs."""
        return {**super().config(), "topic": self.topic, "lidar": asdict(self.scanner)}


@dataclass(frozen=True, kw_only=True)
class LidarJob(Job):
    """A task for a LiDAR."""

    recording: LidarRecording

    def check(self, calibration: Calibration, /) -> Checked | None:
        """Check whether the map's lines lie on the road's."""
        if self.lane_map is None:
            return None
        return check_scans(self.recording.scans, placed_by(calibration), self.lane_map)

    def remarks(self) -> tuple[str, ...]:
        """Return what was assumed of the scanner."""
        return self.recording.remarks()


def calibrate(scans: Path | str, cam: Path | str, options: LidarOptions | None = None) -> Result:
    """Calibrate a LiDAR from its scans and a log of Cooperative Awareness Messages.

    Parameters
    ----------
    scans : path
        A folder of scans, or a ROS bag or MCAP file.
    cam : path
        A log of messages in any format that `read_cam_log` supports.
    options : LidarOptions

    Raises
    ------
    InputError
        If an input cannot be read or makes no sense.
    CalibrationError
        If the inputs were read but do not determine a transform.
    """
    return prepare(Path(scans), Path(cam), options).run()


def prepare(scans: Path, cam: Path, options: LidarOptions | None = None) -> LidarJob:
    """Read all inputs except the scans, and check their consistency.

    Raises
    ------
    InputError
    """
    options = options or LidarOptions()
    sequence = open_scans(scans, options.topic)
    if isinstance(options.scanner.sweep, Sweep):
        _check_untimed(sequence)
    recording = LidarRecording(
        sequence,
        options.scanner,
        options.core.ground,
        _background(options.background),
        options.name or scans.absolute().name,
    )
    drive = read_drive(cam, options.lane_map or find_lane_map(scans), recording.span_ns, options)
    stamps = stamp_errors(sequence)
    return LidarJob(
        recording=recording,
        drive=drive,
        options=options,
        provenance=Provenance(
            name=recording.name,
            kind=recording.kind,
            frame="as in the scans",
            inputs={str(scans): len(sequence), **drive.files},
            config=options.config(),
            notes=sequence.notes + stamps.notes + drive.notes,
        ),
        inputs=f"{len(sequence)} scans, {len(drive.messages)} CAMs",
        doubts=stamps.doubts(options.core.match),
    )


def _check_untimed(scans: ScanSequence) -> None:
    """Raise if points have times of their own, which a sweep given by the user would contradict.

    Raises
    ------
    ScanError
    """
    if any(scan.offset_s is not None for scan in _looked_at(scans)):
        raise ScanError(
            f"{scans.path}: the points have times of their own, and --sweep tells others; needed is no --sweep, or "
            "--sweep none where scans were motion-compensated"
        )


def stamp_errors(scans: ScanSequence) -> StampErrors:
    """Return the errors of the scans' times, which points with Unix times of their own do not have."""
    found = StampErrors.of("scans", scans.stamps_ns)
    if found.notes and any(scan.clock == "Unix" for scan in _looked_at(scans)):
        return StampErrors("scans", 0.0)
    return found


def _looked_at(scans: ScanSequence) -> list[Scan]:
    """Return some of the scans, but for unusable ones."""
    indices = spread(range(len(scans)), LOOKED_AT)
    # The sequence is not read to its end, where it raises if many scans are unusable.
    return [scan for scan in islice(scans.read(indices, 1), len(indices)) if scan is not None]


def _background(asked: tuple[int, int] | Path | None) -> ScanSequence | range | None:
    if asked is None:
        return None
    if isinstance(asked, Path):
        return open_scans(asked)
    first, last = asked
    return range(first, last + 1)
