"""From a track to a passage: the heading, the size and the centre of an object that drives through the view.

The median of the visible points is not the centre: a sensor sees one or two sides. So a passage's length and width are
estimated from the frames that show them, and in every frame a rectangle of that size is aligned with the sides that
face the sensor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, IntArray, along_line, rotate_xy
from laci_stereo.core.settings import BoxSettings, TrackSettings
from laci_stereo.core.tracking.deskew import WINDOW_S, motion
from laci_stereo.monitor.kept import UNIT_M, Kept
from laci_stereo.monitor.settings import MonitorSettings

SLOW_M = 0.5
"""An object that moves by less within `WINDOW_S` keeps its previous heading: its middles scatter by some
centimetres."""

CHORD_M = 1.0
"""The path is a polyline through centres at least this far apart. Their noise is smaller, so a waiting object covers no
distance; in a bend with a radius of 10 m the polyline is 1 cm off."""

ROUNDS = 2
"""Headings are computed from the middles in the first round, and from the resulting centres in the second."""

OUTER_SHARE = 0.02
"""Fraction of an outline's points that may lie beyond its near side: outliers that the density filter kept."""

SIDE_M = BoxSettings.line_tolerance_m
"""Points of one upright side lie within this, or within twice the standard deviation of their noise if that is
larger."""

OUTER_SIDES = 2.0
"""The near side is searched within this many of these widths from the outermost points."""

CAR_WIDTH_M, TRUCK_WIDTH_M = 1.8, 2.5
"""The far side is seldom seen, so typical widths are assumed: nine of ten passenger cars are within 0.15 m of the
first, and lorries and buses are 2.5 to 2.55 m wide (directive 96/53/EC). An object's centre is off by half of the
difference between its width and the typical one."""

WIDEST_CAR_M = (CAR_WIDTH_M + TRUCK_WIDTH_M) / 2
"""Visible width from which an object is assumed to be as wide as a lorry."""

NARROW_M = 1.0
"""An object with a narrower visible front or rear is a two-wheeler, and its visible width is its width."""

CAR_LENGTH_M = 3.0
"""Two-wheelers are shorter than this."""

LENGTH_SHARE = 0.75
"""An object's length is this quantile of its visible lengths over the frames that show a flank: the outermost beams and
pixels lie within the ends of a body, seldom beyond them."""

FACING = float(np.sin(np.radians(20.0)))
"""Sine of 20 deg. A side seen at a flatter angle does not determine a position: its points are few and blend with
those of the adjacent side."""


@dataclass(frozen=True)
class Passage:
    """An object's drive through the view: the frames in which its outline was whole, in the order of time.

    Attributes
    ----------
    frames : ndarray of int64, shape (n,)
        Frame numbers.
    stamps_s : ndarray, shape (n,)
        Seconds since the recording's first stamp.
    centres : ndarray, shape (n, 2)
        World, metres.
    yaw_rad : ndarray, shape (n,)
        Direction of the object's front, world.
    speed_mps : ndarray, shape (n,)
    length_m, width_m, height_m : float
    """

    frames: IntArray
    stamps_s: FloatArray
    centres: FloatArray
    yaw_rad: FloatArray
    speed_mps: FloatArray
    length_m: float
    width_m: float
    height_m: float

    def spaced(self, step_m: float) -> tuple[FloatArray, FloatArray]:
        """Return positions along the path at intervals of ``step_m``, shape (m, 2), and the yaw there, shape (m,)."""
        corners = [0]
        for i, centre in enumerate(self.centres):
            if np.linalg.norm(centre - self.centres[corners[-1]]) >= CHORD_M:
                corners.append(i)
        xy, yaw_rad = self.centres[corners], np.unwrap(self.yaw_rad)[corners]
        along = along_line(xy)
        places = np.arange(step_m / 2, along[-1], step_m)
        return np.column_stack([np.interp(places, along, axis) for axis in xy.T]), np.interp(places, along, yaw_rad)


def passage_of(
    kept: Sequence[Kept], origin: FloatArray, limits: TrackSettings, settings: MonitorSettings
) -> Passage | None:
    """Turn a track into a passage.

    Parameters
    ----------
    kept : sequence of Kept
        The track's sightings; level frame, with axes parallel to the world's.
    origin : ndarray, shape (2,)
        Origin of the level frame in the world: the point below the sensor.
    limits : TrackSettings
    settings : MonitorSettings

    Returns
    -------
    Passage or None
        None for an object seen in too few frames (`MonitorSettings.min_frames`), or moving by less than
        `MonitorSettings.min_path_m`.
    """
    outlined = [one for one in kept if len(one.outline)]
    in_a_second = 1.0 / np.median(np.diff([one.stamp_s for one in kept])) if len(kept) > 1 else 0.0
    if len(outlined) < np.clip(in_a_second, settings.least_frames, settings.min_frames):
        return None
    middles = np.array([one.middle for one in outlined])
    if np.linalg.norm(np.ptp(middles, axis=0)) < settings.min_path_m:
        return None
    stamps_s = np.array([one.stamp_s for one in outlined])
    centres, yaw_rad = middles, np.zeros(0)
    for _ in range(ROUNDS):
        yaw_rad = _headings(stamps_s, centres, limits)
        seen = [_Seen.of(one, yaw) for one, yaw in zip(outlined, yaw_rad, strict=True)]
        length_m = _shown_m(seen, 0, LENGTH_SHARE)
        width_m = _width_m(_shown_m(seen, 1, 0.5), length_m)
        centres = np.array([one.centre(length_m, width_m) for one in seen])
    if np.linalg.norm(np.ptp(centres, axis=0)) < settings.min_path_m:
        return None
    height_m = float(np.median([one.top_m for one in outlined]))
    rows = [one for one in kept if one.whole and stamps_s[0] <= one.stamp_s <= stamps_s[-1]]
    at_s = np.array([one.stamp_s for one in rows])
    xy = np.column_stack([np.interp(at_s, stamps_s, centres[:, axis]) for axis in (0, 1)])
    yaw = np.interp(at_s, stamps_s, np.unwrap(yaw_rad))
    frames = np.array([one.frame for one in rows], dtype=np.int64)
    return Passage(frames, at_s, xy + origin, yaw, _speeds(at_s, xy), length_m, width_m, height_m)


def _headings(stamps_s: FloatArray, xy: FloatArray, limits: TrackSettings) -> FloatArray:
    """Return the direction of travel, shape (n,), from a path of constant acceleration fitted around each time.

    While an object hardly moves, it keeps its previous heading; at the beginning of a track, the first heading that is
    known.
    """
    yaw = np.full(len(xy), np.nan)
    for i, stamp_s in enumerate(stamps_s):
        near = np.abs(stamps_s - stamp_s) <= WINDOW_S
        if near.sum() < 2 or np.linalg.norm(np.ptp(xy[near], axis=0)) < SLOW_M:
            continue
        velocity, _ = motion(stamps_s[near] - stamp_s, xy[near], limits)
        yaw[i] = np.arctan2(velocity[1], velocity[0])
    known = np.flatnonzero(np.isfinite(yaw))
    if not len(known):
        way = xy[-1] - xy[0]
        return np.full(len(xy), np.arctan2(way[1], way[0]))
    held = np.maximum(np.searchsorted(known, np.arange(len(xy)), side="right") - 1, 0)
    filled: FloatArray = yaw[known[held]]
    return filled


def _speeds(stamps_s: FloatArray, xy: FloatArray) -> FloatArray:
    """Return the speed, shape (n,): the displacement from half a second before to half a second after each time."""
    before = np.searchsorted(stamps_s, stamps_s - WINDOW_S / 2, side="left")
    after = np.searchsorted(stamps_s, stamps_s + WINDOW_S / 2, side="right") - 1
    way = np.linalg.norm(xy[after] - xy[before], axis=1)
    speed: FloatArray = way / np.maximum(stamps_s[after] - stamps_s[before], 1e-9)
    return speed


@dataclass(frozen=True)
class _Seen:
    """An outline in the object's own axes: x ahead, y to the left, from the sighting's middle.

    Attributes
    ----------
    middle : ndarray, shape (2,)
        Origin of these axes, level frame.
    yaw_rad : float
    low, high : ndarray, shape (2,)
        Least and greatest coordinates of the points on both axes.
    sensor : ndarray, shape (2,)
        Direction to the sensor, a unit vector.
    near : ndarray, shape (2,)
        Coordinates of the sides that face the sensor, on both axes.
    blur_m : ndarray, shape (2,)
        Widening of the outline by noise, on both axes: one standard deviation at either end.
    """

    middle: FloatArray
    yaw_rad: float
    low: FloatArray
    high: FloatArray
    sensor: FloatArray
    near: FloatArray
    blur_m: FloatArray

    @classmethod
    def of(cls, kept: Kept, yaw_rad: float) -> _Seen:
        points = rotate_xy(-yaw_rad, kept.outline.astype(np.float64) * UNIT_M)
        to_sensor = rotate_xy(-yaw_rad, -kept.middle)
        low, high = points.min(axis=0), points.max(axis=0)
        sensor = to_sensor / max(float(np.linalg.norm(to_sensor)), 1e-9)
        signs = np.where(sensor < 0.0, -1.0, 1.0)
        side_m = max(SIDE_M, 2 * kept.sigma_m)
        near = [signs[axis] * _side(points[:, axis] * signs[axis], side_m) for axis in (0, 1)]
        return cls(kept.middle, yaw_rad, low, high, sensor, np.array(near), 2 * kept.sigma_m * np.abs(sensor))

    def centre(self, length_m: float, width_m: float) -> FloatArray:
        """Return the centre, shape (2,), level: half a body behind each side that faces the sensor.

        On an axis whose side is seen too flatly (`FACING`), it is halfway between the ends of the outline.
        """
        behind = self.near - np.sign(self.sensor) * np.array([length_m, width_m]) / 2
        both = (self.low + self.high) / 2
        firm = np.abs(self.sensor) > FACING
        return self.middle + rotate_xy(self.yaw_rad, np.where(firm, behind, both))


def _side(towards: FloatArray, side_m: float) -> float:
    """Return the coordinate of the side that faces the sensor: where the points are densest near the outermost ones.

    Parameters
    ----------
    towards : ndarray, shape (n,)
        Coordinates of the points on the axis that points to the sensor.
    side_m : float
        Width of the band within which the points of a side lie.
    """
    ordered = np.sort(towards)
    outer = ordered[ordered >= np.quantile(ordered, 1 - OUTER_SHARE) - OUTER_SIDES * side_m]
    counts = np.searchsorted(outer, outer + side_m, side="right") - np.arange(len(outer))
    start = int(counts.argmax())
    return float(np.median(outer[start : start + counts[start]]))


def _shown_m(seen: Sequence[_Seen], axis: int, share: float) -> float:
    """Return an object's length (axis 0) or width (axis 1) as far as it is visible.

    It is the quantile ``share`` of the extents on this axis over the frames that show the side along it: a flank for
    the length, the front or rear for the width. Where none does, it is the 0.9 quantile over all frames.
    """
    extents = np.array([one.high[axis] - one.low[axis] - one.blur_m[axis] for one in seen])
    shown: BoolArray = np.abs([one.sensor[1 - axis] for one in seen]) > FACING
    return float(np.quantile(extents[shown], share)) if shown.any() else float(np.quantile(extents, 0.9))


def _width_m(shown_m: float, length_m: float) -> float:
    """Return an object's width, classified by its visible width and its length."""
    if shown_m < NARROW_M and length_m < CAR_LENGTH_M:
        return shown_m
    return CAR_WIDTH_M if shown_m < WIDEST_CAR_M else TRUCK_WIDTH_M
