"""From paths to a result folder: the run behind ``laci-stereo calibrate``, for Python."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import cv2

from laci_stereo.core.calibrate import calibrate as calibrate_source
from laci_stereo.core.calibrate import world_around
from laci_stereo.core.cam import FRONT, CamLog, ReferencePoint
from laci_stereo.core.cloud import PointCloudSource
from laci_stereo.core.errors import CamError, ImageError, OutputError, RigError, SettingError
from laci_stereo.core.frames import Raster
from laci_stereo.core.result import Calibration
from laci_stereo.core.settings import Settings
from laci_stereo.io.calibration_file import Provenance, to_document, to_text
from laci_stereo.io.cam_csv import read_cam_csv
from laci_stereo.io.images import ImageFolder, Pairs, StereoPair, pair_images, read_image
from laci_stereo.io.lane_map import LaneMap, find_lane_map, read_lane_map
from laci_stereo.io.output import RESULT_FILE, result_folder
from laci_stereo.io.overlap import check_overlap
from laci_stereo.io.stereo_calibration import find_stereo_calibration, read_stereo_calibration
from laci_stereo.report.overlay import draw_overlay, overlay_stamps
from laci_stereo.report.summary import summarise
from laci_stereo.report.topdown import draw_topdown
from laci_stereo.stereo.recording import StereoRecording
from laci_stereo.stereo.settings import StereoSettings

STEREO_FRAME = "raw left camera: origin in the lens, x right, y down, z forward"


@dataclass(frozen=True)
class Options:
    """What a user can say beyond the three paths.

    Attributes
    ----------
    stereo : Path or None
        The stereo calibration; None looks for stereo.yaml, .yml or .json beside the left images.
    lane_map : Path or None
        Lanelet2 or GeoJSON; None looks for map.osm beside the left images.
    background : tuple of int, Path or None
        First and last frame without moving objects, or a folder with such images in ``left`` and ``right``; None
        looks for them.
    station : int or None
        The sender; None takes the one whose track fits.
    reference : ReferencePoint
        Where on the vehicle the messages' positions are.
    crs : str or None
        The UTM zone; None takes the messages'.
    name : str or None
        What people call the sensor; None takes the name of the folder around the left images.
    core : Settings
    camera : StereoSettings
    """

    stereo: Path | None = None
    lane_map: Path | None = None
    background: tuple[int, int] | Path | None = None
    station: int | None = None
    reference: ReferencePoint = FRONT
    crs: str | None = None
    name: str | None = None
    core: Settings = field(default_factory=Settings)
    camera: StereoSettings = field(default_factory=StereoSettings)


@dataclass(frozen=True)
class Job:
    """Inputs that were read and hold together, before the long work.

    Attributes
    ----------
    recording : StereoRecording
    cam : Path
        The log.
    messages : CamLog
        Of the stations that may be the sender.
    lane_map : LaneMap or None
    provenance : Provenance
    inputs : str
        What was read, in words.
    options : Options
    """

    recording: StereoRecording
    cam: Path
    messages: CamLog
    lane_map: LaneMap | None
    provenance: Provenance
    inputs: str
    options: Options

    def run(self, watch: Callable[[PointCloudSource], PointCloudSource] = lambda source: source) -> StereoResult:
        """Calibrate.

        Parameters
        ----------
        watch : callable
            Wraps the recording, for example to show progress while its frames are consumed.

        Raises
        ------
        LaciError
            If the recording cannot be read or does not determine a transform.
        """
        options = self.options
        with _naming(self.cam):
            calibration = calibrate_source(
                watch(self.recording), self.messages, options.core, reference=options.reference, crs=options.crs
            )
        return StereoResult(calibration, self)


@dataclass(frozen=True)
class StereoResult:
    """A calibration and what it was made from.

    Attributes
    ----------
    calibration : Calibration
    job : Job
    """

    calibration: Calibration
    job: Job

    @property
    def skipped(self) -> tuple[str, ...]:
        """Why each image that could not be used was left out, one line each."""
        skipped = self.job.recording.reader.skipped
        return tuple(skipped[path] for path in sorted(skipped))

    @property
    def summary(self) -> str:
        """Ten lines that a person understands."""
        provenance = self.job.provenance
        inputs = f"{self.job.inputs}, {len(self.skipped)} unreadable images"
        return summarise(self.calibration, f"{provenance.name} ({provenance.frame})", inputs)

    def save(self, out: Path | str = "calibration", *, overwrite: bool = False) -> Path:
        """Write calibration.json and the pictures into a folder, as a whole or not at all.

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
        provenance = replace(
            self.job.provenance,
            notes=self.job.provenance.notes + self.skipped,
            T_sensor_rectified=self.job.recording.rectification.T_sensor_rectified,
        )
        text = to_text(to_document(self.calibration, provenance))
        with result_folder(out, overwrite=overwrite) as folder:
            (folder / RESULT_FILE).write_text(text, encoding="utf-8")
            for name, picture in self.pictures():
                _write_picture(folder / name, picture)
        return out

    def pictures(self) -> list[tuple[str, Raster]]:
        """Draw the overlays and the top-down view, each with its file name."""
        job, calibration = self.job, self.calibration
        drawn = [("topdown.png", draw_topdown(calibration, job.lane_map))]
        epoch_ns = job.recording.span_ns[0]
        for number, stamp_s in enumerate(overlay_stamps(calibration), start=1):
            pair = min(job.recording.pairs, key=lambda pair: abs((pair.stamp_ns - epoch_ns) / 1e9 - stamp_s))
            image = job.recording.reader.colour(pair.left)
            lens = job.recording.rig.left
            drawn.append((f"overlay_{number}.png", draw_overlay(image, lens, calibration, stamp_s, job.lane_map)))
        return drawn


def calibrate(left: Path | str, right: Path | str, cam: Path | str, options: Options | None = None) -> StereoResult:
    """Calibrate a stereo camera from two folders of images and a log of Cooperative Awareness Messages.

    Parameters
    ----------
    left, right : path
        Folders of images whose names, or a ``timestamps.txt`` beside them, tell the time.
    cam : path
        The log, as CSV.
    options : Options

    Raises
    ------
    InputError
        If something cannot be read or makes no sense.
    CalibrationError
        If it was read but does not determine a transform.
    """
    return prepare(Path(left), Path(right), Path(cam), options).run()


def prepare(left: Path, right: Path, cam: Path, options: Options | None = None) -> Job:
    """Read everything but the images, and check that it holds together.

    Raises
    ------
    InputError
    """
    options = options or Options()
    pairs = pair_images(ImageFolder.open(left), ImageFolder.open(right))
    stereo = options.stereo or find_stereo_calibration(left)
    if stereo is None:
        raise RigError(
            f"{left.absolute().parent}: no stereo.yaml, stereo.yml or stereo.json; needed is one, or --stereo FILE"
        )
    rig = read_stereo_calibration(stereo, _image_size(pairs))
    recorded = read_cam_csv(cam)
    recording = StereoRecording(
        pairs.pairs,
        rig,
        options.camera,
        options.core.ground,
        _background(pairs, options.background),
        options.name or left.absolute().parent.name,
    )
    messages = _of_station(recorded.log, options.station, cam)
    with _naming(cam):
        check_overlap(messages, *recording.span_ns)
        world = world_around(messages.between(*recording.span_ns), options.crs)
    map_path = options.lane_map or find_lane_map(left)
    lane_map = read_lane_map(map_path, world) if map_path is not None else None
    hashed = [path for path in (stereo, cam, map_path) if path is not None]
    return Job(
        recording=recording,
        cam=cam,
        messages=messages,
        lane_map=lane_map,
        provenance=Provenance(
            name=recording.name,
            kind=recording.kind,
            frame=STEREO_FRAME,
            inputs={str(left): len(pairs), str(right): len(pairs)} | {str(path): _sha256(path) for path in hashed},
            config=_config(options),
            notes=(*_notes(pairs), *recorded.notes, *(lane_map.notes if lane_map is not None else ())),
        ),
        inputs=f"{len(pairs)} image pairs ({pairs.unpaired_left + pairs.unpaired_right} unpaired), {len(messages)} CAMs",
        options=options,
    )


@contextmanager
def _naming(cam: Path) -> Iterator[None]:
    """Put the file's name before what is found wrong with messages where their file is not known any more."""
    try:
        yield
    except CamError as error:
        raise CamError(f"{cam}: {error}") from error


def _image_size(pairs: Pairs) -> tuple[int, int]:
    """Return the width and height of the first image that can be read."""
    problem: ImageError | None = None
    for pair in pairs.pairs:
        try:
            image = read_image(pair.left)
        except ImageError as error:
            problem = problem or error
        else:
            return image.shape[1], image.shape[0]
    assert problem is not None  # there is at least one pair
    raise problem


def _background(pairs: Pairs, asked: tuple[int, int] | Path | None) -> Sequence[StereoPair] | None:
    if asked is None:
        return None
    if isinstance(asked, Path):
        return pair_images(ImageFolder.open(asked / "left"), ImageFolder.open(asked / "right")).pairs
    first, last = asked
    if not 0 <= first <= last < len(pairs):
        raise SettingError(
            f"background frames are {first}..{last}; needed are first <= last within 0..{len(pairs) - 1}"
        )
    return pairs.pairs[first : last + 1]


def _of_station(log: CamLog, station: int | None, cam: Path) -> CamLog:
    if station is None:
        return log
    if station not in log.stations():
        present = ", ".join(str(number) for number in log.stations()[:10])
        raise CamError(f"{cam}: station {station} is not in the log; needed is one of {present}")
    return log.of(station)


def _config(options: Options) -> dict[str, object]:
    """Return every effective setting; paths stand among the inputs."""
    background = options.background
    return {
        "method": "paper",
        "background": str(background) if isinstance(background, Path) else background,
        "station": options.station,
        "reference": asdict(options.reference),
        "crs": options.crs,
        **asdict(options.core),
        "stereo": asdict(options.camera),
    }


def _notes(pairs: Pairs) -> tuple[str, ...]:
    unpaired = (("left", pairs.unpaired_left), ("right", pairs.unpaired_right))
    return tuple(f"{count} {side} images without a partner" for side, count in unpaired if count)


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _write_picture(path: Path, picture: Raster) -> None:
    encoded, content = cv2.imencode(path.suffix, picture)
    if not encoded:
        raise OutputError(f"{path}: cannot be encoded as {path.suffix}")
    path.write_bytes(content.tobytes())
