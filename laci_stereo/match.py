"""From a log of detections to a result: what ``laci-stereo match`` runs, for Python."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from laci_stereo.core.calibrate import locate, vehicles_of, world_around
from laci_stereo.core.detections import DetectionLog, observe_detections
from laci_stereo.core.errors import DetectionError
from laci_stereo.core.frames import FORWARD_LEFT_UP_AXES, Axes
from laci_stereo.core.ground.box_ground import HEIGHT_SIGMA_M, LEVEL_SIGMA_DEG, SLOPE_SIGMA, Below, ground_below
from laci_stereo.core.result import Calibration
from laci_stereo.core.robust import TAIL
from laci_stereo.core.settings import above_zero
from laci_stereo.io.detections import read_detections
from laci_stereo.io.maps.lane_map import find_lane_map
from laci_stereo.io.result.calibration_file import Provenance
from laci_stereo.job import DriveOptions, Result, Task, Watch, read_drive, sha256

STEEP = 2.0
"""Number of standard deviations beyond which a slope is mentioned."""

BoxOrigin = Literal["centre", "bottom"]


@dataclass(frozen=True, kw_only=True)
class MatchOptions(DriveOptions):
    """Options of the calibration from the boxes of a detector.

    Attributes
    ----------
    axes : Axes
        Axes of the sensor's frame.
    box_origin : {"centre", "bottom"}
        Point of a box that its position refers to.
    level_m : float or None
        Height of the sensor above the ground, if its up axis is vertical; None finds the ground below the boxes.
    """

    axes: Axes = FORWARD_LEFT_UP_AXES
    box_origin: BoxOrigin = "centre"
    level_m: float | None = None

    def config(self) -> dict[str, object]:
        """Return every effective setting; paths are among the inputs."""
        own = {"axes": asdict(self.axes), "box_origin": self.box_origin, "level_m": self.level_m}
        return {**super().config(), **own}


@dataclass(frozen=True, kw_only=True)
class MatchTask(Task):
    """Detections and messages that are consistent with each other.

    Attributes
    ----------
    detections : DetectionLog
    axes : Axes
        Axes of the sensor's frame.
    level_m : float or None
        See `MatchOptions`.
    """

    detections: DetectionLog
    axes: Axes
    level_m: float | None

    def calibrate(self, watch: Watch) -> Calibration:  # noqa: ARG002, there are no frames to watch
        """Project the detections onto the ground, and match the vehicles' tracks."""
        options = self.options
        first_ns, last_ns = self.detections.span_ns
        messages = self.drive.messages.between(first_ns, last_ns, options.core.match.clock_sigma_s)
        world = world_around(messages, options.crs)
        vehicles = vehicles_of(messages, world, first_ns, options.point)
        seen = observe_detections(self.detections, self.axes, options.core, self.level_m)
        return _with_assumption(locate(seen, vehicles, world, options.core))


def match(detections: Path | str, cam: Path | str, options: MatchOptions | None = None) -> Result:
    """Calibrate a sensor from the boxes of a detector and a log of Cooperative Awareness Messages.

    Parameters
    ----------
    detections : path
        The log of boxes, as CSV.
    cam : path
        The log of messages, in any format that `read_cam_log` knows.
    options : MatchOptions

    Raises
    ------
    InputError
        If something cannot be read or makes no sense.
    CalibrationError
        If it was read but does not determine a transform.
    """
    return prepare(Path(detections), Path(cam), options).run()


def prepare(detections: Path, cam: Path, options: MatchOptions | None = None) -> MatchTask:
    """Read everything, and check that it is consistent.

    Raises
    ------
    InputError
    """
    options = options or MatchOptions()
    recorded = read_detections(detections)
    log = recorded.log
    if options.box_origin == "bottom":
        log = replace(log, above_ground_m=np.zeros(len(log)))
    below = _check_ground(detections, log, options)
    drive = read_drive(cam, options.lane_map or find_lane_map(detections), log.span_ns, options)
    return MatchTask(
        drive=drive,
        options=options,
        provenance=Provenance(
            name=options.name or detections.absolute().parent.name,
            kind="detections",
            frame=f"as in the detections: {_in_words(options.axes)}",
            inputs={str(detections): sha256(detections), **drive.files},
            config=options.config(),
            notes=(*recorded.notes, _ground_note(log, options, below), *drive.notes),
        ),
        inputs=f"{len(log)} detections at {len(np.unique(log.stamps_ns))} times, {len(drive.messages)} CAMs",
        detections=log,
        axes=options.axes,
        level_m=options.level_m,
    )


def _with_assumption(calibration: Calibration) -> Calibration:
    """Return a calibration with an objection if detections have no size: they may be anywhere on the vehicle."""
    sized = np.array([sighting.box.length_m > 0.0 for sighting in calibration.drive.track.sightings])
    if 2 * sized.sum() >= len(sized):
        return calibration
    vehicle, quality = calibration.drive.vehicle, calibration.quality
    reason = (
        "the detections have no size and are taken for the vehicle's centre; if they are on its near side, the "
        f"position is off by up to {np.hypot(vehicle.length_m, vehicle.width_m) / 2:.1f} m"
    )
    return replace(calibration, quality=quality.doubted(reason))


def _check_ground(path: Path, log: DetectionLog, options: MatchOptions) -> Below | None:
    """Raise if nothing determines the ground; return the ground by the boxes, if it is specified as level."""
    no_z = bool(np.isnan(log.points_sensor[:, 2]).all())
    if options.level_m is not None:
        above_zero("--level", options.level_m, "m")
        if no_z and options.axes.up[2] == 0.0:
            raise DetectionError(f"{path} lacks z, but {_in_words(options.axes)}; needed is z, or other --axes")
        below = _below(log, options.axes)
        if below is not None:
            _check_level(path, below, options.level_m)
        return below
    if no_z:
        raise DetectionError(f"{path} lacks z; needed is z to find the ground below the boxes, or --level HEIGHT")
    if np.isnan(log.above_ground_m).all():
        raise DetectionError(
            f"{path} lacks height; needed is height to find the ground below the boxes' centres, --box-origin bottom, "
            "or --level HEIGHT"
        )
    return None


def _check_level(path: Path, below: Below, level_m: float) -> None:
    """Raise if the boxes are at another height below the sensor, or on ground that is steeper than roads are."""
    if abs(below.height_m - level_m) > TAIL * np.hypot(below.height_sigma_m, HEIGHT_SIGMA_M):
        raise DetectionError(
            f"{path}: the boxes stand {below.height_m:.1f} m below the sensor, give or take {below.height_sigma_m:.1f} "
            f"m, by their z and height; --level is {level_m:g} m: needed is one height (see --box-origin and --axes), "
            "or boxes without z"
        )
    if below.slope > TAIL * np.hypot(below.slope_sigma, SLOPE_SIGMA):
        raise DetectionError(
            f"{path}: the ground below the boxes falls or rises by {below.slope:.0%}, "
            f"{np.degrees(np.arctan(below.slope)):.1f} deg, by their z and height; by --level the sensor is level to "
            f"{LEVEL_SIGMA_DEG:g} deg, and roads below it are less steep: needed is no --level, or boxes without z"
        )


def _below(log: DetectionLog, axes: Axes) -> Below | None:
    """Return the ground according to the boxes' own heights; None where they have none."""
    known = np.isfinite(log.points_sensor).all(axis=1) & np.isfinite(log.above_ground_m)
    return ground_below(log.points_sensor[known], log.above_ground_m[known], axes) if known.any() else None


def _ground_note(log: DetectionLog, options: MatchOptions, below: Below | None) -> str:
    if options.level_m is None:
        return f"x, y and z taken for the {options.box_origin} of the boxes (see --box-origin)"
    if np.isnan(log.points_sensor[:, 2]).all():
        return f"no z; x and y taken for distances along the ground, {options.level_m:g} m below the sensor"
    note = f"the sensor's axis is taken for vertical, and the ground for {options.level_m:g} m below it"
    if below is None or below.slope < STEEP * np.hypot(below.slope_sigma, np.radians(LEVEL_SIGMA_DEG)):
        return note
    slope = f"by the boxes' z it falls or rises by {below.slope:.1%}"
    return f"{note}; {slope}: a road that steep, or a sensor that is not level"


def _in_words(axes: Axes) -> str:
    return ", ".join(
        f"{'-' if sum(axis) < 0 else ''}{'xyz'[int(np.argmax(np.abs(axis)))]} {way}"
        for axis, way in ((axes.forward, "forward"), (axes.up, "up"))
    )
