"""The evidence of one drive: the vehicle's points in every frame, and its track in the world."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from laci_stereo.core.cloud import Cameras
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.tracking.sighting import sigma_z
from laci_stereo.core.tracking.tracks import Track

SAME_VIEW_M = 0.5
"""Distance travelled after which the view of a vehicle, and its errors, are new: a cell of the density of its
outline."""

FRAMES_PER_PLACE = 10
"""Largest number of frames that are kept at one place: they contain no more information than one of them, except for
their noise, which this number reduces to a third."""


@dataclass(frozen=True)
class Evidence:
    """One drive past the sensor.

    Attributes
    ----------
    stamps_s : ndarray, shape (m,)
        Times of the frames.
    middles : ndarray, shape (m, 2)
        The vehicle in each frame, level frame: its median point, or the centre of the box that a detector gave.
    lacking_m : ndarray, shape (m, 2)
        By how much a detector's box is shorter and narrower than the vehicle: by the whole size where it gave none;
        negative where it is longer or wider.
    points : ndarray, shape (n, 3)
        Level frame, metres; none where a detector gave the boxes.
    frame : ndarray of int, shape (n,)
        Index of each point's frame.
    sigma_along_m, sigma_across_m, sigma_z_m : ndarray, shape (n,)
        Standard deviations of the points on the ground plan along and across the line of sight, and in height.
    height_m : float
        Height of the sensor above the ground.
    vehicle : VehicleTrack
    borders : ndarray, shape (m, 2, 3)
        The vehicle's outermost points in each frame, level frame, right and left; NaN where unknown.
    begins_rad : ndarray, shape (m,)
        See `Sighting`.
    turn_s : float
        Duration of a scanner's revolution if it may rotate and the points' times are not known; else 0.
    window_rad : float
        Side of the window within which points share their noise; 0 if each has its own.
    cameras : Cameras or None
        Level frame; None for other sensors than stereo cameras.
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
    borders: FloatArray
    begins_rad: FloatArray
    turn_s: float = 0.0
    window_rad: float = 0.0
    cameras: Cameras | None = None

    def __len__(self) -> int:
        return len(self.stamps_s)

    @cached_property
    def way_m(self) -> FloatArray:
        """Distance travelled by the vehicle at each frame according to its messages, shape (m,)."""
        return way_driven(self.vehicle.at(self.stamps_s)[0], SAME_VIEW_M)

    @cached_property
    def frames_late_s(self) -> FloatArray:
        """Delay of each frame's middle, relative to the mean, if the scanner rotates counter-clockwise, shape (m,)."""
        late_s: FloatArray = (self._turned_rad - self._turned_rad.mean()) * (self.turn_s / (2 * np.pi))
        return late_s

    @cached_property
    def _turned_rad(self) -> FloatArray:
        """Azimuth of each frame's middle to the left of where a scan begins, 0 to 2 pi, shape (m,)."""
        turned: FloatArray = (np.arctan2(self.middles[:, 1], self.middles[:, 0]) - self.begins_rad) % (2 * np.pi)
        return turned

    @cached_property
    def has_borders(self) -> bool:
        """Whether any border is known."""
        return bool(np.isfinite(self.borders).any())

    @cached_property
    def beside_rad(self) -> FloatArray:
        """Azimuth of each point to the left of its frame's middle, shape (n,)."""
        (x, y), (u, v) = self.middles[self.frame].T, self.points[:, :2].T
        beside_rad: FloatArray = np.arctan2(x * v - y * u, x * u + y * v)
        return beside_rad

    @cached_property
    def above_rad(self) -> FloatArray:
        """Elevation of each point above the sensor's horizon, shape (n,)."""
        above_rad: FloatArray = np.arctan2(self.points[:, 2] - self.height_m, np.hypot(*self.points[:, :2].T))
        return above_rad

    @cached_property
    def farther_per_m(self) -> FloatArray:
        """Fraction by which a point is measured too far per metre that it moves between the exposures, shape (n, 2).

        The motion is that from the left to the right image, level frame. A point at depth Z that moves across its line
        of sight by w has the disparity f (B - w) / Z, so that w / B of the measured depth is too much; across the
        optical axis w = m . r - (x / Z) m . f, for a motion m, the directions r of the baseline and f of the axis, and
        the point's coordinate x along r.
        """
        if self.cameras is None:
            return np.zeros((len(self.points), 2))
        sight = self.points - np.array([0.0, 0.0, self.height_m])
        baseline_m = float(np.linalg.norm(self.cameras.baseline_m))
        right, ahead = self.cameras.baseline_m / baseline_m, self.cameras.ahead
        beside = (sight @ right) / (sight @ ahead)
        per_m: FloatArray = (right[:2] - beside[:, None] * ahead[:2]) / baseline_m
        return per_m

    @cached_property
    def blur_m(self) -> FloatArray:
        """Height on an upright side up to which what is below it affects each point, shape (n,), metres.

        This is half of the matching window, plus twice the noise across the line of sight.
        """
        level_m = np.maximum(np.hypot(*self.points[:, :2].T), 1e-9)
        range_m = np.hypot(level_m, self.points[:, 2] - self.height_m)
        blur_m: FloatArray = (self.window_rad / 2 * range_m + 2.0 * self.sigma_across_m) * range_m / level_m
        return blur_m

    @cached_property
    def points_late_s(self) -> FloatArray:
        """Delay of each point after its frame's middle, if the scanner rotates counter-clockwise, shape (n,).

        For points beyond the azimuth at which a scan begins it is almost a revolution earlier.
        """
        middle_rad = self._turned_rad[self.frame]
        late_rad: FloatArray = (middle_rad + self.beside_rad) % (2 * np.pi) - middle_rad
        return late_rad * (self.turn_s / (2 * np.pi))

    def thinned(self, rows: int) -> Evidence:
        """Return this drive with about ``rows`` uniformly spaced points.

        Of the frames in which the vehicle is stationary, most are left out. At any place `FRAMES_PER_PLACE` frames
        remain, from the first to the last.
        """
        drive = self.of_frames(self._moving())
        keep = np.arange(0, len(drive.points), max(1, len(drive.points) // max(1, rows)))
        return drive._with_points(keep)

    def _moving(self) -> BoolArray:
        """Return which frames are kept, shape (m,)."""
        place = np.unique(self.way_m // SAME_VIEW_M, return_inverse=True)[1].reshape(-1)
        count = np.bincount(place)
        rank = np.arange(len(self)) - (np.cumsum(count) - count)[place]
        # Frames at which the next of nine equal steps from the first to the last has begun.
        step = (rank * (FRAMES_PER_PLACE - 1)) // np.maximum(count[place] - 1, 1)
        kept: BoolArray = (count[place] <= FRAMES_PER_PLACE) | (np.diff(step, prepend=-1) != 0) | (rank == 0)
        return kept

    def of_frames(self, kept: BoolArray) -> Evidence:
        """Return this drive with some of its frames, given as booleans, shape (m,)."""
        drive = self._with_points(np.flatnonzero(kept[self.frame]))
        return replace(
            drive,
            stamps_s=self.stamps_s[kept],
            middles=self.middles[kept],
            lacking_m=self.lacking_m[kept],
            frame=(np.cumsum(kept) - 1)[drive.frame],
            borders=self.borders[kept],
            begins_rad=self.begins_rad[kept],
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
    """Return the distance travelled at each of an object's places, shape (m,); the places' shape is (m, 2).

    An object that moves no farther than ``still_m`` from where it was, and back, is stationary: its distance travelled
    is its largest distance from there.
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
    """Return the evidence of a track while its sender's position is known.

    Sightings with unreliable boxes are included: a part of the outline is as good as its points.
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
        lacking_m=np.array([vehicle.length_m, vehicle.width_m]) - sizes,
        points=points,
        frame=np.repeat(np.arange(len(parts)) // 2, [len(part.points) for part in parts]),
        sigma_along_m=np.hypot(level * along, down * across),
        sigma_across_m=across,
        sigma_z_m=sigma_z(sight, along, across),
        height_m=height_m,
        vehicle=vehicle,
        borders=np.array([sighting.borders for sighting in seen]).reshape(-1, 2, 3),
        begins_rad=np.array([sighting.begin_rad for sighting in seen]),
        turn_s=track.turn_s,
        window_rad=track.window_rad,
        cameras=track.cameras,
    )
