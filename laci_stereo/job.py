"""A calibration job, for any kind of sensor: from a recording and the messages of a drive to a result folder."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Protocol

from laci_stereo.check.describe import check_document, check_line
from laci_stereo.check.images import Checked
from laci_stereo.check.lanes import MAP_SIGMA_M
from laci_stereo.check.result import beside_map
from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.cloud import PointCloudSource
from laci_stereo.core.errors import CalibrationError, CamError
from laci_stereo.core.frames import Raster
from laci_stereo.core.messages.cam import FRONT, CamLog, ReferencePoint
from laci_stereo.core.messages.stations import world_around
from laci_stereo.core.result import Calibration
from laci_stereo.core.settings import Settings
from laci_stereo.io.cam.gnss import OF_ANTENNA
from laci_stereo.io.cam.log import read_cam_log
from laci_stereo.io.images import write_picture
from laci_stereo.io.maps.lane_map import LaneMap, read_lane_map
from laci_stereo.io.output import EVIDENCE_FILE, RESULT_FILE, result_folder
from laci_stereo.io.overlap import check_overlap
from laci_stereo.io.result.calibration_file import Provenance, to_document, to_text
from laci_stereo.io.result.evidence_file import Kept, write_evidence
from laci_stereo.report.page import Made, Photographs, write_page
from laci_stereo.report.summary import summarise
from laci_stereo.report.topdown import draw_topdown

PAGE_FILE = "report.html"

BLOCK_BYTES = 1 << 20
"""Files are hashed in blocks of this size: a bag may be larger than the memory."""


@dataclass(frozen=True, kw_only=True)
class DriveOptions:
    """The settings that any kind of calibration offers to a user.

    Attributes
    ----------
    lane_map : Path or None
        Lanelet2, OpenDRIVE, GeoJSON, DXF or CSV; None looks for map.osm and the like beside the recording.
    map_crs : str or None
        The map's coordinate system where its file does not state it; see `read_lane_map`.
    station : int or None
        The sender; None uses all that are clearly seen.
    reference : ReferencePoint or None
        The point on the vehicle to which the messages' positions refer; None assumes the reference point of CAMs, and
        refuses positions of an antenna.
    cam_sigma_m : float or None
        Uncertainty of positions whose messages do not report it, one standard deviation; None assumes RTK-corrected
        positions (`JointSettings`).
    crs : str or None
        The UTM zone; None uses the zone of the messages.
    name : str or None
        The sensor's name; None uses the name of the folder around the recording.
    background : tuple of int, Path or None
        First and last frame without moving objects, or the path of a recording without them; None detects them.
    core : Settings
    """

    lane_map: Path | None = None
    map_crs: str | None = None
    station: int | None = None
    reference: ReferencePoint | None = None
    cam_sigma_m: float | None = None
    crs: str | None = None
    name: str | None = None
    background: tuple[int, int] | Path | None = None
    core: Settings = field(default_factory=Settings)

    @property
    def point(self) -> ReferencePoint:
        """The point on the vehicle to which the messages' positions refer: as set, else that of CAMs."""
        return self.reference or FRONT

    def config(self) -> dict[str, object]:
        """Return every effective setting except the paths, which are among the inputs."""
        background = self.background
        return {
            "background_frames": str(background) if isinstance(background, Path) else background,
            "station": self.station,
            "reference": asdict(self.point),
            "cam_sigma_m": self.cam_sigma_m,
            "crs": self.crs,
            "map_crs": self.map_crs,
            **asdict(self.core),
        }


@dataclass(frozen=True)
class Drive:
    """The messages of a drive and the map of the site.

    Attributes
    ----------
    cam : Path
    messages : CamLog
        Messages of the stations that may be the sender.
    lane_map : LaneMap or None
    files : mapping of str to str
        The files that were read, with their SHA-256.
    notes : tuple of str
        How the files were interpreted.
    """

    cam: Path
    messages: CamLog
    lane_map: LaneMap | None
    files: Mapping[str, str]
    notes: tuple[str, ...]


def read_drive(cam: Path, lane_map: Path | None, span_ns: tuple[int, int], options: DriveOptions) -> Drive:
    """Read the messages and the map, and check that they belong to the recording.

    Parameters
    ----------
    cam : Path
    lane_map : Path or None
    span_ns : tuple of int
        First and last stamp of the recording.
    options : DriveOptions

    Raises
    ------
    CamError, MapError
        If one cannot be read, they are of another time or place, or positions are an antenna's and the options do not
        state where on the vehicle it is.
    """
    recorded = read_cam_log(cam)
    if recorded.is_receiver and options.reference is None:
        raise CamError(f"{cam} is {recorded.format}, and {OF_ANTENNA}")
    messages = _of_station(recorded.log, options.station, cam)
    if options.cam_sigma_m is not None:
        messages = messages.exact_to(options.cam_sigma_m)
    with _naming(cam):
        check_overlap(messages, *span_ns)
        world = world_around(messages.between(*span_ns, options.core.match.clock_sigma_s), options.crs)
    read = read_lane_map(lane_map, world, options.map_crs) if lane_map is not None else None
    files = {str(path): sha256(path) for path in (cam, lane_map) if path is not None}
    return Drive(cam, messages, read, files, recorded.notes + (read.notes if read is not None else ()))


class Recording(PointCloudSource, Protocol):
    """A source that remembers which of its files it could not use."""

    @property
    def skipped(self) -> tuple[str, ...]:
        """Why each unusable frame was left out, one line each."""


Watch = Callable[[PointCloudSource], PointCloudSource]
"""Wraps a recording, for example to show progress while its frames are consumed."""


@dataclass(frozen=True, kw_only=True)
class Task(ABC):
    """Inputs that were read and checked for consistency, before the time-consuming estimation.

    A kind of sensor that has images, sees lines or learns about itself has a class of its own, with the methods for it.

    Attributes
    ----------
    drive : Drive
    options : DriveOptions
    provenance : Provenance
    inputs : str
        Description of what was read.
    doubts, failures : tuple of str
        Objections: what in the inputs may have spoilt the result, and what surely has, one line each.
    """

    drive: Drive
    options: DriveOptions
    provenance: Provenance
    inputs: str
    doubts: tuple[str, ...] = ()
    failures: tuple[str, ...] = ()

    @abstractmethod
    def calibrate(self, watch: Watch) -> Calibration:
        """Estimate the transform, which takes long.

        Raises
        ------
        LaciError
            If the recording cannot be read or does not determine a transform.
        """

    @property
    def lane_map(self) -> LaneMap | None:
        """The map of the site."""
        return self.drive.lane_map

    @property
    def read(self) -> str:
        """Description of what was read and of how much of it was unusable."""
        return f"{self.inputs}, {len(self.skipped)} unreadable"

    @property
    def skipped(self) -> tuple[str, ...]:
        """What turned out to be unreadable during the run, one line each."""
        return ()

    def again(self, _found: Calibration | CalibrationError, /) -> Task | None:
        """Return a task that includes what a result, or a refusal, shows about the sensor; None if nothing is new."""
        return None

    def check(self, _calibration: Calibration, /) -> Checked | None:
        """Check whether the map's lines lie on the road's; None without a map, or if the sensor cannot see lines."""
        return None

    def draw(self, _calibration: Calibration, /) -> Iterator[tuple[str, Raster]]:
        """Draw the pictures that only this kind of sensor has, each with its file name."""
        yield from ()

    def photograph(self, _calibration: Calibration, /) -> Photographs | None:
        """Return some images of the drive for the report; None if the sensor takes none."""
        return None

    def remarks(self) -> tuple[str, ...]:
        """Return remarks on the sensor after the recording was read, one line each."""
        return ()

    def run(self, watch: Watch = lambda source: source) -> Result:
        """Calibrate, again where the result shows something new about the sensor, and check the result against the map.

        Parameters
        ----------
        watch : callable

        Raises
        ------
        LaciError
            If the recording cannot be read or does not determine a transform.
        """
        try:
            with _naming(self.drive.cam):
                found = self.calibrate(watch)
        except CalibrationError as error:
            if (task := self.again(error)) is not None:
                return task.run(watch)
            if not (objections := self.failures + self.doubts):
                raise
            raise type(error)("; ".join((str(error), *objections))) from error
        if (task := self.again(found)) is not None:
            return task.run(watch)
        found = found.doubted(*self.doubts).failed(*self.failures)
        lanes = self.check(found)
        return Result(found if lanes is None else beside_map(found, lanes.check), self, lanes)


@dataclass(frozen=True, kw_only=True)
class Job(Task):
    """A task for a sensor whose frames are point clouds.

    Attributes
    ----------
    recording : Recording
    """

    recording: Recording

    def calibrate(self, watch: Watch) -> Calibration:
        """Find ground, background and vehicle in the frames, and match the vehicle's track with the messages."""
        options = self.options
        return calibrate(
            watch(self.recording), self.drive.messages, options.core, reference=options.point, crs=options.crs
        )

    @property
    def skipped(self) -> tuple[str, ...]:
        """Why each unusable frame was left out."""
        return self.recording.skipped


class Origin(Protocol):
    """The origin of a result: a task that was run, or results that were combined."""

    @property
    def provenance(self) -> Provenance:
        """The result's inputs and settings."""

    @property
    def read(self) -> str:
        """Description of what was read and of how much of it was unusable."""

    @property
    def lane_map(self) -> LaneMap | None:
        """The map of the site."""

    @property
    def skipped(self) -> tuple[str, ...]:
        """What was left out during the run, one line each."""

    def draw(self, calibration: Calibration, /) -> Iterator[tuple[str, Raster]]:
        """Draw the sensor's own pictures, each with its file name."""

    def photograph(self, calibration: Calibration, /) -> Photographs | None:
        """Return some images of the drive; None if the sensor takes none."""

    def remarks(self) -> tuple[str, ...]:
        """Return remarks on the sensor, one line each."""


@dataclass(frozen=True)
class Result:
    """A calibration and its origin.

    Attributes
    ----------
    calibration : Calibration
        Its verdict takes the check of the lanes into account.
    job : Origin
    lanes : Checked or None
        Whether the map's lines lie on the road's; this never enters the estimate.
    """

    calibration: Calibration
    job: Origin
    lanes: Checked | None = None

    @property
    def summary(self) -> str:
        """A summary of ten lines for a human reader, and one line on the lanes if there is a map."""
        provenance = self.job.provenance
        words = summarise(self.calibration, f"{provenance.name} ({provenance.frame})", self.job.read)
        return words if self.lanes is None else f"{words}\n{'Lanes':<11}{check_line(self.lanes.check)}"

    def save(self, out: Path | str = "calibration", *, overwrite: bool = False, command: str | None = None) -> Path:
        """Write calibration.json, the report and the pictures into a folder, all of them or none.

        Parameters
        ----------
        out : path
        overwrite : bool
        command : str or None
            The command line that started the calibration, for the report.

        Returns
        -------
        Path
            The folder.

        Raises
        ------
        OutputError
            If the folder exists (and is no result, or ``overwrite`` is False), or cannot be written.
        """
        out = Path(out)
        notes = self.job.provenance.notes + self.calibration.remarks + self.job.remarks()
        provenance = replace(self.job.provenance, notes=notes)
        lanes = None if self.lanes is None else check_document(self.lanes.check, MAP_SIGMA_M)
        document = to_document(self.calibration, replace(provenance, notes=notes + self.job.skipped), lanes)
        made = Made(
            provenance=provenance,
            read=self.job.read,
            skipped=self.job.skipped,
            lane_map=self.job.lane_map,
            photographs=self.job.photograph(self.calibration),
            command=command,
            check=None if self.lanes is None else self.lanes.picture,
        )
        with result_folder(out, overwrite=overwrite) as folder:
            (folder / RESULT_FILE).write_text(to_text(document), encoding="utf-8")
            page = write_page(self.calibration, document, made)
            (folder / PAGE_FILE).write_text(page, encoding="utf-8", errors="backslashreplace")  # paths may be any bytes
            for name, picture in self.pictures():
                write_picture(folder / name, picture)
            kept = Kept(
                provenance.name,
                provenance.kind,
                provenance.frame,
                provenance.T_sensor_rectified,
                self.calibration.passages,
            )
            write_evidence(folder / EVIDENCE_FILE, kept)
        return out

    def pictures(self) -> Iterator[tuple[str, Raster]]:
        """Draw the view from above and the sensor's own pictures, each with its file name."""
        yield "topdown.png", draw_topdown(self.calibration, self.job.lane_map)
        yield from self.job.draw(self.calibration)
        if self.lanes is not None:
            yield "check.png", self.lanes.picture


def sha256(path: Path) -> str:
    """Return a file's SHA-256 in hexadecimal digits; for a folder, that of the concatenation of its files."""
    files = sorted(file for file in path.iterdir() if file.is_file()) if path.is_dir() else [path]
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as content:
            while block := content.read(BLOCK_BYTES):
                digest.update(block)
    return digest.hexdigest()


@contextmanager
def _naming(cam: Path) -> Iterator[None]:
    """Prefix the file's name to errors in messages that are found where their file is no longer known."""
    try:
        yield
    except CamError as error:
        raise CamError(f"{cam}: {error}") from error


def _of_station(log: CamLog, station: int | None, cam: Path) -> CamLog:
    if station is None:
        return log
    if station not in log.stations():
        present = ", ".join(str(number) for number in log.stations()[:10])
        raise CamError(f"{cam}: station {station} is not in the log; needed is one of {present}")
    return log.of(station)
