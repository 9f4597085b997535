"""What one drive tells about where the sensor is: the vehicle's points in every frame, and its track in the world."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.tracking.sighting import sigma_z
from laci_stereo.core.tracking.tracks import Track

SAME_VIEW_M = 0.5
"""What is seen of a vehicle, and how wrongly, is new after so much of its way: a density cell of its outline."""

FRAMES_PER_PLACE = 10
"""Frames of one place tell no more than one of them, but for noise, which so many make a third."""


@dataclass(frozen=True)
class Evidence:
    """One drive.

    Attributes
    ----------
    stamps_s : ndarray, shape (m,)
        Of the frames.
    middles : ndarray, shape (m, 2)
        Of the vehicle in each frame, level: its median point, or the centre of the box that a detector gave.
    lacking_m : ndarray, shape (m, 2)
        By how much a detector's box is shorter and narrower than the vehicle; all of it where it gave no size.
    points : ndarray, shape (n, 3)
        Level frame, metres; none where a detector gave the boxes.
    frame : ndarray of int, shape (n,)
        Which frame each is of.
    sigma_along_m, sigma_across_m, sigma_z_m : ndarray, shape (n,)
        Their noise on the ground plan, along and across the line of sight, and upwards.
    height_m : float
        Of the sensor above the ground.
    vehicle : VehicleTrack
    turn_s : float
        How long a turn of the scanner lasts if it turns, and the points' times are not known; else 0.
    window_rad : float
        Side of the window within which points have their noise in common; 0 if each has its own.
    borders : ndarray, shape (m, 2, 3), or None
        The vehicle's outermost points in each frame, level, right and left; NaN where unknown, None: all are.
    begins_rad : ndarray, shape (m,), or None
        See `Sighting`; None: behind.
    """

    stamps_s: FloatArray
    middles: FloatArray
    lacking_m: FloatArray
    points: FloatArray
    frame: IntArray
    sigma_along_m: FloatArray
    sigma_across_m: FloatArray
    sigma_z_m: FloatArray
    height_m: float
    vehicle: VehicleTrack
    turn_s: float = 0.0
    window_rad: float = 0.0
    borders: FloatArray | None = None
    begins_rad: FloatArray | None = None

    def __len__(self) -> int:
        return len(self.stamps_s)

    @cached_property
    def way_m(self) -> FloatArray:
        """How far the vehicle has come at each frame by its messages, shape (m,)."""
        return way_driven(self.vehicle.at(self.stamps_s)[0], SAME_VIEW_M)

    @cached_property
    def frames_late_s(self) -> FloatArray:
        """How much later than in the mean a scanner that turns counter-clockwise sees each frame's middle, (m,)."""
        late_s: FloatArray = (self._turned_rad - self._turned_rad.mean()) * (self.turn_s / (2 * np.pi))
        return late_s

    @cached_property
    def _turned_rad(self) -> FloatArray:
        """How far to the left of where a scan begins each frame's middle is, 0 to 2 pi, shape (m,)."""
        begins = np.pi if self.begins_rad is None else self.begins_rad
        turned: FloatArray = (np.arctan2(self.middles[:, 1], self.middles[:, 0]) - begins) % (2 * np.pi)
        return turned

    @cached_property
    def beside_rad(self) -> FloatArray:
        """How far to the left of its frame's middle each point is seen, shape (n,)."""
        (x, y), (u, v) = self.middles[self.frame].T, self.points[:, :2].T
        beside_rad: FloatArray = np.arctan2(x * v - y * u, x * u + y * v)
        return beside_rad

    @cached_property
    def above_rad(self) -> FloatArray:
        """How far above the sensor's horizon each point is seen, shape (n,)."""
        above_rad: FloatArray = np.arctan2(self.points[:, 2] - self.height_m, np.hypot(*self.points[:, :2].T))
        return above_rad

    @cached_property
    def blur_m(self) -> FloatArray:
        """How far up an upright side what is below it reaches into what each point tells, shape (n,), metres.

        By half of the matcher's window, and by twice the noise of the line of sight.
        """
        level_m = np.maximum(np.hypot(*self.points[:, :2].T), 1e-9)
        range_m = np.hypot(level_m, self.points[:, 2] - self.height_m)
        blur_m: FloatArray = (self.window_rad / 2 * range_m + 2.0 * self.sigma_across_m) * range_m / level_m
        return blur_m

    @cached_property
    def points_late_s(self) -> FloatArray:
        """How much later than its frame's middle such a scanner sees each point, shape (n,).

        Beyond where a scan begins that is almost a turn earlier.
        """
        middle_rad = self._turned_rad[self.frame]
        late_rad: FloatArray = (middle_rad + self.beside_rad) % (2 * np.pi) - middle_rad
        return late_rad * (self.turn_s / (2 * np.pi))

    def thinned(self, rows: int) -> Evidence:
        """Return about so many of the points, spread evenly over all frames, but for most in which the vehicle stands.

        At any place `FRAMES_PER_PLACE` are left, from the first to the last.
        """
        drive = self._moving()
        keep = np.arange(0, len(drive.points), max(1, len(drive.points) // max(1, rows)))
        return drive._with_points(keep)

    def _moving(self) -> Evidence:
        place = np.unique(self.way_m // SAME_VIEW_M, return_inverse=True)[1].reshape(-1)
        count = np.bincount(place)
        rank = np.arange(len(self)) - (np.cumsum(count) - count)[place]
        # Those at which the next of nine equal steps from the first to the last has begun.
        step = (rank * (FRAMES_PER_PLACE - 1)) // np.maximum(count[place] - 1, 1)
        kept = (count[place] <= FRAMES_PER_PLACE) | (np.diff(step, prepend=-1) != 0) | (rank == 0)
        if kept.all():
            return self
        drive = self._with_points(np.flatnonzero(kept[self.frame]))
        return replace(
            drive,
            stamps_s=self.stamps_s[kept],
            middles=self.middles[kept],
            lacking_m=self.lacking_m[kept],
            frame=(np.cumsum(kept) - 1)[drive.frame],
            borders=None if self.borders is None else self.borders[kept],
            begins_rad=None if self.begins_rad is None else self.begins_rad[kept],
        )

    def _with_points(self, keep: IntArray) -> Evidence:
        return replace(
            self,
            points=self.points[keep],
            frame=self.frame[keep],
            sigma_along_m=self.sigma_along_m[keep],
            sigma_across_m=self.sigma_across_m[keep],
            sigma_z_m=self.sigma_z_m[keep],
        )


def way_driven(xy: FloatArray, still_m: float) -> FloatArray:
    """Return how far something has come at each of its places, shape (m,); the places' shape is (m, 2).

    What comes no farther than ``still_m`` from where it was, and back, stands: its way is how far it came once.
    """
    way_m = np.zeros(len(xy))
    begin, before_m, farthest_m = xy[:1].ravel().tolist(), 0.0, 0.0
    for i, at in enumerate(xy.tolist()):
        farthest_m = max(farthest_m, math.dist(begin, at))
        way_m[i] = before_m + farthest_m
        if farthest_m >= still_m:
            begin, before_m, farthest_m = at, float(way_m[i]), 0.0
    return way_m


def evidence_of(track: Track, vehicle: VehicleTrack, height_m: float) -> Evidence:
    """Collect what a track tells while its sender's position is known.

    Sightings that a box cannot be trusted for are in it: a part of the outline is as good as its points.
    """
    stamps = np.array([sighting.stamp_s for sighting in track.sightings])
    known = vehicle.at(stamps)[2]
    seen = [sighting for sighting, is_known in zip(track.sightings, known, strict=True) if is_known]
    parts = [part for sighting in seen for part in (sighting, sighting.low)]
    points = np.concatenate([np.zeros((0, 3)), *(part.points for part in parts)])
    along = np.concatenate([np.zeros(0), *(part.sigma_along_m for part in parts)])
    across = np.concatenate([np.zeros(0), *(part.sigma_across_m for part in parts)])
    sizes = np.array([(sighting.box.length_m, sighting.box.width_m) for sighting in seen]).reshape(-1, 2)
    sight = points - np.array([0.0, 0.0, height_m])
    down = sight[:, 2] / np.linalg.norm(sight, axis=1)
    level = np.sqrt(1.0 - down**2)
    return Evidence(
        stamps_s=stamps[known],
        middles=np.array([sighting.middle for sighting in seen]).reshape(-1, 2),
        lacking_m=(np.array([vehicle.length_m, vehicle.width_m]) - sizes).clip(0.0),
        points=points,
        frame=np.repeat(np.arange(len(parts)) // 2, [len(part.points) for part in parts]),
        sigma_along_m=np.hypot(level * along, down * across),
        sigma_across_m=across,
        sigma_z_m=sigma_z(sight, along, across),
        height_m=height_m,
        vehicle=vehicle,
        turn_s=track.turn_s,
        window_rad=track.window_rad,
        borders=np.array([sighting.borders for sighting in seen]).reshape(-1, 2, 3),
        begins_rad=np.array([sighting.begin_rad for sighting in seen]),
    )
