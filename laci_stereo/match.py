"""From a log of detections to a result: what ``laci-stereo match`` runs, for Python."""

from __future__ import annotations

import logging
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from laci_stereo.core.box_motion import contradictions
from laci_stereo.core.calibrate import locate
from laci_stereo.core.detections import DetectionLog, observe_detections
from laci_stereo.core.errors import CalibrationError, DetectionError
from laci_stereo.core.frames import FORWARD_LEFT_UP_AXES, Axes, FloatArray
from laci_stereo.core.ground.box_ground import (
    HEIGHT_SIGMA_M,
    LEVEL_SIGMA_DEG,
    LEVEL_SIGMA_RAD,
    SLOPE_SIGMA,
    Below,
    ground_by_heights,
)
from laci_stereo.core.messages.stations import senders_of
from laci_stereo.core.result import Calibration
from laci_stereo.core.robust import TAIL
from laci_stereo.core.settings import above_zero
from laci_stereo.core.tracking.box_point import BoxPoint
from laci_stereo.io.detections import read_detections
from laci_stereo.io.maps.lane_map import find_lane_map
from laci_stereo.io.result.calibration_file import Provenance
from laci_stereo.job import DriveOptions, Result, Task, Watch, read_drive, sha256

log = logging.getLogger(__name__)

STEEP = 2.0
"""Number of standard deviations beyond which a slope is mentioned, or, with that of roads' own slopes, doubted."""

BoxOrigin = Literal["centre", "bottom"]


@dataclass(frozen=True, kw_only=True)
class MatchOptions(DriveOptions):
    """Options of the calibration from the boxes of a detector.

    Attributes
    ----------
    axes : Axes
        Axes of the sensor's frame.
    box_origin : {"centre", "bottom"}
        Height in a box of the point that its position refers to.
    box_point : BoxPoint
        The same on the ground plan.
    level_m : float or None
        Height of the sensor above the ground, if its up axis is vertical; None finds the ground below the boxes.
    """

    axes: Axes = FORWARD_LEFT_UP_AXES
    box_origin: BoxOrigin = "centre"
    box_point: BoxPoint = "centre"
    level_m: float | None = None

    def config(self) -> dict[str, object]:
        """Return every effective setting; paths are among the inputs."""
        own = ("box_origin", "box_point", "level_m")
        return {**super().config(), "axes": asdict(self.axes), **{name: getattr(self, name) for name in own}}


@dataclass(frozen=True, kw_only=True)
class MatchTask(Task):
    """Detections and messages that are consistent with each other.

    Attributes
    ----------
    detections : DetectionLog
    axes : Axes
        Axes of the sensor's frame.
    level_m : float or None
    box_point : BoxPoint
        See `MatchOptions`.
    tilt_sigma_rad : float
        Standard deviation of the up axis about each horizontal one where it is stated to be vertical.
    otherwise_m : ndarray, shape (n,)
        See `observe_detections`.
    """

    detections: DetectionLog
    axes: Axes
    level_m: float | None
    box_point: BoxPoint
    tilt_sigma_rad: float
    otherwise_m: FloatArray

    def calibrate(self, watch: Watch) -> Calibration:  # noqa: ARG002, there are no frames to watch
        """Project the detections onto the ground, and match the vehicles' tracks."""
        options = self.options
        span_ns, clock_sigma_s = self.detections.span_ns, options.core.match.clock_sigma_s
        senders = senders_of(self.drive.messages, span_ns, options.point, options.crs, clock_sigma_s)
        seen = observe_detections(
            self.detections,
            self.axes,
            options.core,
            self.level_m,
            point=self.box_point,
            tilt_sigma_rad=self.tilt_sigma_rad,
            otherwise_m=self.otherwise_m,
        )
        remarks = contradictions(seen.tracks, options.core.match)
        try:
            found = locate(seen, senders.vehicles, senders.world, options.core, senders.by_other_clocks)
        except CalibrationError as error:
            if not (*remarks, *seen.objections):
                raise
            raise type(error)("; ".join((str(error), *remarks, *seen.objections))) from error
        for remark in remarks:
            log.warning("%s", remark)
        return _with_assumption(replace(found, found=(*found.found, *remarks)).doubted(*seen.objections))


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
    boxes, points_notes = _placed(detections, recorded.log, options.box_point)
    centre_m, bottom_m = boxes.above_ground_m, np.zeros(len(boxes))
    above_m, otherwise_m = (centre_m, bottom_m) if options.box_origin == "centre" else (bottom_m, centre_m)
    boxes = replace(boxes, above_ground_m=above_m)
    below = _check_ground(detections, recorded.no_height, boxes, options)
    tilt_sigma_rad, not_level = _tilt(below)
    drive = read_drive(cam, options.lane_map or find_lane_map(detections), boxes.span_ns, options)
    return MatchTask(
        drive=drive,
        options=options,
        provenance=Provenance(
            name=options.name or detections.absolute().parent.name,
            kind="detections",
            frame=f"as in the detections: {_in_words(options.axes)}",
            inputs={str(detections): sha256(detections), **drive.files},
            config=options.config(),
            notes=(*recorded.notes, *points_notes, _ground_note(boxes, options, below), *drive.notes),
        ),
        inputs=f"{len(boxes)} detections at {len(np.unique(boxes.stamps_ns))} times, {len(drive.messages)} CAMs",
        doubts=not_level,
        detections=boxes,
        axes=options.axes,
        level_m=options.level_m,
        box_point=options.box_point,
        tilt_sigma_rad=tilt_sigma_rad,
        otherwise_m=otherwise_m,
    )


def _placed(path: Path, log: DetectionLog, point: BoxPoint) -> tuple[DetectionLog, list[str]]:
    """Return the detections whose place on the vehicle is known, and notes on the others.

    Raises
    ------
    DetectionError
        If there is none.
    """
    is_box = log.is_box()
    bare = int((~is_box).sum())
    if point == "centre":
        lack = f"{bare} of {len(log)} detections lack yaw, length or width; taken for points at the vehicle's centre"
        return log, [lack] if bare else []
    if bare == len(log):
        raise DetectionError(
            f"{path}: none of {len(log)} detections has yaw, length and width; needed are these for --box-point {point}"
        )
    lack = f"{bare} of {len(log)} detections dropped, which lack yaw, length or width, needed for --box-point {point}"
    taken = f"x and y taken for the {point.replace('-', ' ')} of the boxes (--box-point)"
    return log[is_box], [*([lack] if bare else []), taken]


def _with_assumption(calibration: Calibration) -> Calibration:
    """Return a calibration with an objection if detections have no size: they may be anywhere on the vehicle."""
    sized = np.array([sighting.box.length_m > 0.0 for sighting in calibration.drive.track.sightings])
    if 2 * sized.sum() >= len(sized):
        return calibration
    vehicle = calibration.drive.vehicle
    reason = (
        "the detections have no size and are taken for the vehicle's centre; if they are on its near side, the "
        f"position is off by up to {np.hypot(vehicle.length_m, vehicle.width_m) / 2:.1f} m"
    )
    return calibration.doubted(reason)


def _check_ground(path: Path, no_height: str, boxes: DetectionLog, options: MatchOptions) -> Below | None:
    """Raise if nothing determines the ground; return the ground by the boxes, if it is specified as level.

    ``no_height`` says why no box has a height, if none has.
    """
    no_z = bool(np.isnan(boxes.points_sensor[:, 2]).all())
    if options.level_m is not None:
        above_zero("--level", options.level_m, "m")
        if no_z and options.axes.up[2] == 0.0:
            raise DetectionError(f"{path} lacks z, but {_in_words(options.axes)}; needed is z, or other --axes")
        below = _below(boxes, options.axes)
        if below is not None:
            _check_level(path, below, options.level_m)
        return below
    if no_z:
        raise DetectionError(f"{path} lacks z; needed is z to find the ground below the boxes, or --level HEIGHT")
    if np.isnan(boxes.above_ground_m).all():
        raise DetectionError(
            f"{path} {no_height}; needed is height to find the ground below the boxes' centres, --box-origin bottom, "
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


def _tilt(below: Below | None) -> tuple[float, tuple[str, ...]]:
    """Return the standard deviation of a stated vertical axis, and an objection if the boxes contradict it.

    Either the road is as steep as the ground below the boxes or the sensor is tilted by as much, which is not known:
    the axis is off by nothing or by the whole slope.
    """
    if below is None or below.slope < STEEP * np.hypot(below.slope_sigma, SLOPE_SIGMA):
        return LEVEL_SIGMA_RAD, ()
    tilt_rad = np.arctan(below.slope)
    words = (
        f"the ground below the boxes falls or rises by {below.slope:.1%}, {np.degrees(tilt_rad):.1f} deg, by their z "
        f"and height, and most roads by less than {STEEP * SLOPE_SIGMA:.0%}: unless this one does, the sensor is not "
        "level as --level says; without --level the ground is fitted below the boxes"
    )
    return float(np.hypot(LEVEL_SIGMA_RAD, tilt_rad / np.sqrt(2.0))), (words,)


def _below(boxes: DetectionLog, axes: Axes) -> Below | None:
    """Return the ground according to the boxes' own heights; None where they have none."""
    known = np.isfinite(boxes.points_sensor).all(axis=1) & np.isfinite(boxes.above_ground_m)
    return ground_by_heights(boxes.points_sensor[known], boxes.above_ground_m[known], axes) if known.any() else None


def _ground_note(boxes: DetectionLog, options: MatchOptions, below: Below | None) -> str:
    if options.level_m is None:
        what = "x, y and z" if options.box_point == "centre" else "z"
        return f"{what} taken for the {options.box_origin} of the boxes (see --box-origin and --box-point)"
    if np.isnan(boxes.points_sensor[:, 2]).all():
        return f"no z; x and y taken for distances along the ground, {options.level_m:g} m below the sensor"
    note = f"the sensor's axis is taken for vertical, and the ground for {options.level_m:g} m below it"
    if below is None or below.slope < STEEP * np.hypot(below.slope_sigma, LEVEL_SIGMA_RAD):
        return note
    slope = f"by the boxes' z it falls or rises by {below.slope:.1%}"
    return f"{note}; {slope}: a road that steep, or a sensor that is not level"


def _in_words(axes: Axes) -> str:
    return ", ".join(
        f"{'-' if sum(axis) < 0 else ''}{'xyz'[int(np.argmax(np.abs(axis)))]} {way}"
        for axis, way in ((axes.forward, "forward"), (axes.up, "up"))
    )
