"""Observation of a scene by the boxes of the user's own detector: ground plane and tracks."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from laci_stereo.core.columns import Columns
from laci_stereo.core.errors import GroundError
from laci_stereo.core.frames import Axes, BoolArray, FloatArray, IntArray, transform, wrap
from laci_stereo.core.ground.box_ground import (
    LEVEL_SIGMA_RAD,
    Unlike,
    elsewhere_below,
    first_plane,
    level_ground,
    plane_below,
    unlike_origin,
)
from laci_stereo.core.ground.plane import GroundPlane
from laci_stereo.core.observe import Observation
from laci_stereo.core.settings import Settings, TrackSettings
from laci_stereo.core.tracking.background import Background
from laci_stereo.core.tracking.box import Box
from laci_stereo.core.tracking.box_point import BoxPoint, to_centre
from laci_stereo.core.tracking.sighting import Sighting
from laci_stereo.core.tracking.tracks import Track, link_tracks

log = logging.getLogger(__name__)

LOST_FRAMES = 5
"""Number of consecutive frames in which even a slow detector may miss an object without ending its track."""


@dataclass(frozen=True)
class DetectionLog(Columns):
    """Detections in the order of time. Unknown values are NaN.

    Attributes
    ----------
    stamps_ns : ndarray of int64, shape (n,)
        Unix time, nanoseconds, ascending; at least one.
    points_sensor : ndarray, shape (n, 3)
        Reference point of each object in the sensor frame, metres. The third coordinate is only needed to find the
        ground.
    above_ground_m : ndarray, shape (n,)
        Height of that point above the road: half of the object's height for the centre of its box.
    yaw_rad : ndarray, shape (n,)
        Direction of the box: right-handed about the sensor's axis that is nearest to vertical, from x (from y if x is
        that axis).
    length_m, width_m : ndarray, shape (n,)
        Size of the box, metres.
    track_id : ndarray of int64, shape (n,)
        The detector's number of the object; -1 if it gives none.
    radial_mps : ndarray, shape (n,)
        Speed of the object away from the sensor.
    """

    stamps_ns: IntArray
    points_sensor: FloatArray
    above_ground_m: FloatArray
    yaw_rad: FloatArray
    length_m: FloatArray
    width_m: FloatArray
    track_id: IntArray
    radial_mps: FloatArray

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last stamp, Unix time, nanoseconds."""
        return int(self.stamps_ns[0]), int(self.stamps_ns[-1])

    def is_box(self) -> BoolArray:
        """Return which detections have a size and a direction, shape (n,); the others are points."""
        known: BoolArray = np.isfinite(self.yaw_rad) & np.isfinite(self.length_m) & np.isfinite(self.width_m)
        return known


@dataclass(frozen=True)
class BoxObservation(Observation):
    """The scene according to the boxes of a detector.

    Attributes
    ----------
    objections : tuple of str
        What the boxes contradict in what was stated about them.
    """

    objections: tuple[str, ...] = ()


def observe_detections(
    detections: DetectionLog,
    axes: Axes,
    settings: Settings | None = None,
    level_m: float | None = None,
    *,
    point: BoxPoint = "centre",
    tilt_sigma_rad: float = LEVEL_SIGMA_RAD,
    otherwise_m: FloatArray | None = None,
) -> BoxObservation:
    """Find the ground below the boxes of a detector, and link the boxes to tracks on it.

    Parameters
    ----------
    detections : DetectionLog
        Of another ``point`` than the centre, only those that are boxes (`DetectionLog.is_box`).
    axes : Axes
        Axes of the sensor.
    settings : Settings
    level_m : float or None
        Height of the sensor above the ground, if its up axis is vertical; with None the ground is fitted to the boxes.
    point : BoxPoint
        Point of the boxes on the ground plan that their positions are of; front is where the yaw points to.
    tilt_sigma_rad : float
        Standard deviation of that axis about each horizontal one.
    otherwise_m : ndarray, shape (n,), or None
        Height above the road of the boxes' other point that positions may be of, see `DetectionLog.above_ground_m`.

    Raises
    ------
    GroundError
        If the boxes do not determine the ground.
    """
    settings = settings or Settings()
    objections: tuple[str, ...] = ()

    def on(ground: GroundPlane) -> list[Sighting]:
        return _sightings(detections, ground, axes, point)

    if level_m is not None:
        ground = level_ground(level_m, axes, tilt_sigma_rad)
        tracks = _tracks(detections, on(ground), settings.track)
    else:
        ground, tracks, objections = _ground_and_tracks(detections, axes, settings, on, otherwise_m)
    log.info("ground: %.3f m below the sensor; %d tracks", ground.height_m, len(tracks))
    nothing = Background((), 0, settings.background.margin_m)
    sightings = on(ground)
    made = (Track(tuple(sightings[row] for row in rows)) for rows in tracks)
    return BoxObservation(axes, ground, nothing, tuple(made), objections=objections)


def _ground_and_tracks(
    detections: DetectionLog,
    axes: Axes,
    settings: Settings,
    on: Callable[[GroundPlane], list[Sighting]],
    otherwise_m: FloatArray | None,
) -> tuple[GroundPlane, list[IntArray], tuple[str, ...]]:
    """Return the ground, the tracks on it, and objections; the ground is fitted with each object weighted by its path.

    Raises
    ------
    GroundError
        If there is none; with the objections, and other axes with which there is one.
    """
    known = np.flatnonzero(np.isfinite(detections.points_sensor).all(axis=1) & np.isfinite(detections.above_ground_m))
    points, above_m = detections.points_sensor[known], detections.above_ground_m[known]
    start = first_plane(points, above_m, axes, settings.ground)
    tracks = _tracks(detections, on(start), settings.track)
    place = np.full(len(detections), -1)
    place[known] = np.arange(len(known))
    objects = [found for rows in tracks if len(found := place[rows][place[rows] >= 0])]
    objections: tuple[str, ...] = ()
    if otherwise_m is not None:
        unlike = unlike_origin(points, (above_m, otherwise_m[known]), objects, axes, settings.ground)
        objections = _other_origin(unlike, above_m)
    try:
        return plane_below(points, above_m, objects, axes, settings.ground), tracks, objections
    except GroundError as error:
        elsewhere = elsewhere_below(points, above_m, objects, axes, settings.ground)
        raise GroundError("; ".join((str(error), *objections, *([elsewhere] if elsewhere else [])))) from error


def _other_origin(unlike: Unlike | None, above_m: FloatArray) -> tuple[str, ...]:
    """Return an objection if the boxes' other point clearly fits the ground better."""
    if unlike is None:
        return ()
    given, other = ("centre", "bottom") if np.median(above_m) > 0.0 else ("bottom", "centre")
    words = (
        f"objects of different heights are {unlike.given_m:.2f} m off one ground if their positions are of the boxes' "
        f"{given}, and {unlike.other_m:.2f} m if of the {other}: needed is --box-origin {other}, or correct heights"
    )
    return (words,)


def _tracks(detections: DetectionLog, sightings: Sequence[Sighting], settings: TrackSettings) -> list[IntArray]:
    """Return the indices of each object's detections, in the order of time, the object with most of them first."""
    settings = replace(settings, max_lost_s=max(settings.max_lost_s, LOST_FRAMES * _interval_s(detections)))
    by_number = np.argsort(detections.track_id, kind="stable")
    ends = np.flatnonzero(np.diff(detections.track_id[by_number])) + 1
    tracks: list[IntArray] = []
    for rows in np.split(by_number, ends):
        named = detections.track_id[rows[0]] >= 0
        tracks += _unbroken(rows, sightings, settings) if named else _linked(rows, sightings, settings)
    return sorted(tracks, key=len, reverse=True)


def _interval_s(detections: DetectionLog) -> float:
    """Return the median time from one frame to the next; 0 with a single frame."""
    steps_s = np.diff(np.unique(detections.stamps_ns)) / 1e9
    return float(np.median(steps_s)) if len(steps_s) else 0.0


def _unbroken(rows: IntArray, sightings: Sequence[Sighting], settings: TrackSettings) -> list[IntArray]:
    """Split detections with one number where they are interrupted for long or jump: trackers reuse their numbers."""
    stamps_s = np.array([sightings[row].stamp_s for row in rows])
    xy = np.array([sightings[row].middle for row in rows])
    step_s, step_m = np.diff(stamps_s), np.linalg.norm(np.diff(xy, axis=0), axis=1)
    torn = (step_s > settings.max_lost_s) | (step_m > settings.jitter_m + settings.max_speed_mps * step_s)
    return np.split(rows, np.flatnonzero(torn) + 1)


def _linked(rows: IntArray, sightings: Sequence[Sighting], settings: TrackSettings) -> list[IntArray]:
    """Link detections that have no number."""
    row_of = {id(sightings[row]): row for row in rows}
    stamps_s = np.array([sightings[row].frame_s for row in rows])
    frames = np.split(rows, np.flatnonzero(np.diff(stamps_s)) + 1)
    tracks = link_tracks(([sightings[row] for row in frame] for frame in frames), settings)
    return [np.array([row_of[id(sighting)] for sighting in track.sightings]) for track in tracks]


def _sightings(detections: DetectionLog, ground: GroundPlane, axes: Axes, point: BoxPoint) -> list[Sighting]:
    """Return detections as sightings on the ground plan, with stamps since the first one."""
    T_level_sensor = ground.T_level_sensor(axes)
    # A sensor without elevation measures in its own plane, which may be taken as parallel to the ground only if level.
    xy = transform(T_level_sensor, np.nan_to_num(detections.points_sensor))[:, :2]
    is_box = detections.is_box()
    length, width = (np.where(is_box, size, 0.0) for size in (detections.length_m, detections.width_m))
    along = np.where(is_box, detections.yaw_rad, 0.0) + np.where(width > length, np.pi / 2, 0.0)
    length, width = np.maximum(length, width), np.minimum(length, width)
    heading = _headings(along, ground.normal, axes) @ T_level_sensor[:2, :3].T
    yaw = wrap(2 * np.arctan2(heading[:, 1], heading[:, 0])) / 2
    xy = xy + to_centre(xy, heading, length, width, point)
    stamps_s = (detections.stamps_ns - detections.stamps_ns[0]) / 1e9
    no_points, no_noise = np.zeros((0, 3)), np.zeros(0)
    return [
        Sighting(
            stamp_s=float(stamps_s[i]),
            frame_s=float(stamps_s[i]),
            points=no_points,
            sigma_along_m=no_noise,
            sigma_across_m=no_noise,
            count=1,
            middle=xy[i],
            box=Box(xy[i], float(length[i]), float(width[i]), float(yaw[i])),
            flaw=None,
            radial_mps=float(detections.radial_mps[i]) if np.isfinite(detections.radial_mps[i]) else None,
        )
        for i in range(len(detections))
    ]


def _headings(yaw_rad: FloatArray, normal: FloatArray, axes: Axes) -> FloatArray:
    """Return vectors along the ground, sensor frame, shape (n, 3), that have the yaws about the most upright axis."""
    upright = int(np.argmax(np.abs(axes.up)))
    about = np.eye(3)[upright]
    zero = np.eye(3)[1 if upright == 0 else 0]
    flat = np.outer(np.cos(yaw_rad), zero) + np.outer(np.sin(yaw_rad), np.cross(about, zero))
    along: FloatArray = flat - np.outer(flat @ normal / (about @ normal), about)
    return along
