"""Candidates for the vehicle in one frame: clusters of points above ground and outside the background, with boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.ndimage import uniform_filter

from laci_stereo.core.cloud import Cameras, PointCloud
from laci_stereo.core.columns import Columns
from laci_stereo.core.errors import BoxError
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray, dot_xy, perpendicular, transform
from laci_stereo.core.settings import Settings, VehicleSettings
from laci_stereo.core.subsampling import evenly
from laci_stereo.core.tracking.background import Background
from laci_stereo.core.tracking.box import Box, fit_box
from laci_stereo.core.tracking.cluster import cluster
from laci_stereo.core.tracking.land import FLAT, Land
from laci_stereo.core.vehicle.outline import SIDES_HIGHEST_M

Flaw = Literal["cut", "far", "thin"]
"""Reason for which a sighting is left out: cut by the border of the field of view, too far away, too sparse for a
box."""

KEPT_POINTS, KEPT_LOW = 800, 1200
"""Largest numbers of a cluster's points, and of the low points below or around it, that are kept, so that memory does
not grow with the sensor's density. The same fraction of both is kept, such that neither number is exceeded, but at
least as many points as a vehicle needs. The choice of the kept points moves a result by millimetres, and by centimetres
with half of these numbers."""

STRAY = 0.02
"""Fraction of a cluster's points at either end of it that may be outliers of another object."""


@dataclass(frozen=True)
class Low(Columns):
    """Points below a cluster or on the road around it; the noise of their heights is too large to distinguish the two.

    Attributes
    ----------
    points : ndarray, shape (n, 3)
        Points in the level frame, metres.
    sigma_along_m, sigma_across_m : ndarray, shape (n,)
        Standard deviations of their noise along and across the line of sight.
    """

    points: FloatArray
    sigma_along_m: FloatArray
    sigma_across_m: FloatArray


NOTHING_LOW = Low(np.zeros((0, 3)), np.zeros(0), np.zeros(0))
NO_BORDERS: FloatArray = np.full((2, 3), np.nan)


@dataclass(frozen=True)
class Sighting:
    """A cluster that may be a vehicle, in one frame.

    Attributes
    ----------
    stamp_s : float
        Time at which its points were measured, seconds since the recording's first stamp.
    frame_s : float
        Stamp of its frame, in the same seconds; all sightings in a frame share it.
    points : ndarray, shape (n, 3)
        A subset of its points, level frame, metres; empty where a detector gave the box.
    sigma_along_m, sigma_across_m : ndarray, shape (n,)
        Standard deviations of these points along and across the line of sight.
    count : int
        Number of all its points; 1 where a detector gave the box.
    middle : ndarray, shape (2,)
        Median of all its points on the ground plan: biased towards the sensor, but less noisy than the box.
    box : Box
        Box on the ground plan of the level frame.
    flaw : {"cut", "far", "thin"} or None
        Reason for which its box is unreliable.
    sigma_m : float
        Median noise of its points along the line of sight.
    radial_mps : float or None
        Measured speed away from the sensor; None where it was not measured.
    late_s : ndarray, shape (n,), or None
        Delay of each point's measurement after ``stamp_s``; None if all were measured at that time.
    turn_s, window_rad : float
        See `PointCloud`.
    begin_rad : float
        Azimuth in the level frame at which the scans of a turning scanner begin, at the elevation of the sighting.
    cameras : Cameras or None
        The cameras by which it was seen, level frame; None for other sensors.
    low : Low
        Points below or around it, the same fraction of which is kept as of its points.
    borders : ndarray, shape (2, 3)
        Its outermost points, right and left as seen from the sensor; only for cameras, whose bearings are exact to a
        matching window. NaN where the field of view ends there, the background is near, or nothing is seen below the
        mirrors.
    """

    stamp_s: float
    frame_s: float
    points: FloatArray
    sigma_along_m: FloatArray
    sigma_across_m: FloatArray
    count: int
    middle: FloatArray
    box: Box
    flaw: Flaw | None
    sigma_m: float = 0.0
    radial_mps: float | None = None
    late_s: FloatArray | None = None
    turn_s: float = 0.0
    begin_rad: float = np.pi
    window_rad: float = 0.0
    cameras: Cameras | None = None
    low: Low = NOTHING_LOW
    borders: FloatArray = field(default_factory=lambda: NO_BORDERS)

    @property
    def detected(self) -> bool:
        """Whether it is a detector's box, without points."""
        return self.count == 1

    def without_points(self) -> Sighting:
        """Return the sighting with its box but without points."""
        points, along, across = NOTHING_LOW.points, NOTHING_LOW.sigma_along_m, NOTHING_LOW.sigma_across_m
        bare = replace(self, points=points, sigma_along_m=along, sigma_across_m=across, late_s=None)
        return replace(bare, low=NOTHING_LOW, borders=NO_BORDERS)

    def thinned(self, most: int) -> Sighting:
        """Return the sighting with at most ``most`` of its points, and none of the low ones."""
        kept = evenly(len(self.points), most)
        return replace(
            self,
            points=self.points[kept],
            sigma_along_m=self.sigma_along_m[kept],
            sigma_across_m=self.sigma_across_m[kept],
            late_s=None if self.late_s is None else self.late_s[kept],
            low=NOTHING_LOW,
        )


def find_vehicles(
    cloud: PointCloud,
    frame_s: float,
    T_level_sensor: FloatArray,
    background: Background,
    settings: Settings,
    land: Land = FLAT,
) -> list[Sighting]:
    """Find the clusters in a frame that may be vehicles (paper section III-C).

    Parameters
    ----------
    cloud : PointCloud
    frame_s : float
        Stamp of the cloud, seconds since the recording's first stamp.
    T_level_sensor : ndarray, shape (4, 4)
    background : Background
    settings : Settings
    land : Land

    Returns
    -------
    list of Sighting
        The one with most points first.
    """
    points = transform(T_level_sensor, cloud.points)
    limits = settings.vehicle
    # A vehicle at the limit has points on both sides of it; the cluster's median decides.
    near = np.flatnonzero(
        (cloud.sigma_along_m < 2 * limits.max_sigma_m) & (points[:, 2] < settings.background.max_height_m)
    )
    z = points[near, 2]
    noise_m = limits.ground_sigmas * sigma_z(
        points[near] - T_level_sensor[:3, 3], cloud.sigma_along_m[near], cloud.sigma_across_m[near]
    )
    standing = (z > limits.min_height_m) & (z > noise_m) & (z > land.top_at(points[near, :2]))
    open_ = ~standing & (noise_m > limits.min_height_m) & (z + noise_m > limits.min_height_m)
    upright = near[standing]
    hidden = background.covers(points[upright, :2])
    covered, candidates = upright[hidden], upright[~hidden]
    low = near[open_][~background.covers(points[near[open_], :2])]
    found = []
    for group in cluster(points[candidates, :2], settings.cluster):
        members = candidates[group]
        sigma_m = float(np.median(cloud.sigma_along_m[members]))
        below = low[_below(points[low], points[members], sigma_m, float(T_level_sensor[2, 3]), settings)]
        its_low = Low(points[below], cloud.sigma_along_m[below], cloud.sigma_across_m[below])
        sighting = _sighting(points[members], cloud[members], its_low, frame_s, settings)
        if sighting is not None:
            borders = _borders(points[members], cloud[members], points[covered, :2], settings)
            cameras = None if cloud.cameras is None else cloud.cameras.turned(T_level_sensor[:3, :3])
            found.append(replace(sighting, borders=borders, cameras=cameras))
    return found


def _below(points: FloatArray, members: FloatArray, sigma_m: float, height_m: float, settings: Settings) -> BoolArray:
    """Return which points, shape (n, 3), level frame, may belong to a cluster or to the road below it, shape (n,).

    These points are seen within the cluster's bearings, from its top down to the elevation at which it would end above
    the ground, and at the distance of its members up to their noise.
    """
    xy, reach_m = np.median(members[:, :2], axis=0), settings.cluster.reach_m
    forward = (xy / max(float(np.hypot(*xy)), 1e-9))[None]
    off, own = (_sight(each, forward, height_m) for each in (points, members))
    least, most = np.quantile(own, (STRAY, 1.0 - STRAY), axis=0)
    least[2] = (settings.vehicle.min_height_m - height_m) / max(float(least[1]), 1e-9)
    slack = np.array(
        [reach_m / max(float(np.hypot(*xy)), 1e-9), reach_m + settings.vehicle.ground_sigmas * sigma_m, 0.0]
    )
    inside: BoolArray = ((off >= least - slack) & (off <= most + slack)).all(axis=1)
    return inside


def _sight(points: FloatArray, forward: FloatArray, height_m: float) -> FloatArray:
    """Return the azimuth from ``forward``, the range on the ground plan, and the slope of the sight, shape (n, 3)."""
    range_m = np.maximum(np.hypot(*points[:, :2].T), 1e-9)
    return np.column_stack([_bearing(points, forward[0]), range_m, (points[:, 2] - height_m) / range_m])


def sigma_z(sight: FloatArray, sigma_along_m: FloatArray, sigma_across_m: FloatArray) -> FloatArray:
    """Return the standard deviation of points' heights, shape (n,), given the vectors to them, shape (n, 3)."""
    slope = sight[:, 2] / np.maximum(np.linalg.norm(sight, axis=1), 1e-9)
    sigma_m: FloatArray = np.hypot(slope * sigma_along_m, np.sqrt(1 - slope**2) * sigma_across_m)
    return sigma_m


def dense(xy: FloatArray, settings: VehicleSettings) -> BoolArray:
    """Return which points, shape (n, 2), lie where the outline is dense, shape (n,).

    The points of upright sides accumulate on the ground plan, whereas those of matches that bleed from these sides onto
    the road behind are spread along the line of sight. All of the few points of a sparse scanner are kept.
    """
    cells = np.floor(xy / settings.density_cell_m).astype(np.int64)
    cells -= cells.min(axis=0)
    counts = np.zeros(cells.max(axis=0) + 3, dtype=np.int64)
    np.add.at(counts, (cells[:, 0] + 1, cells[:, 1] + 1), 1)
    around = uniform_filter(counts.astype(np.float64), 3, mode="constant")[cells[:, 0] + 1, cells[:, 1] + 1]
    keep: BoolArray = around >= settings.density_share * np.median(around)
    return keep


def box_around(points: FloatArray, settings: Settings) -> Box:
    """Fit a box to the outline of a cluster, shape (n, 3), level frame.

    Raises
    ------
    BoxError
        If too little of the cluster is dense enough.
    """
    return fit_box(points[dense(points[:, :2], settings.vehicle), :2], settings.box)


def together(first: Sighting, second: Sighting, settings: Settings) -> Sighting:
    """Return the union of two sightings in one frame that are pieces of one object."""
    main, other = sorted((first, second), key=lambda one: one.count, reverse=True)
    count = main.count + other.count
    kept = [evenly(len(one.points), round(KEPT_POINTS * one.count / count) + 1) for one in (main, other)]
    stamp_s = (main.count * main.stamp_s + other.count * other.stamp_s) / count
    points = _of_both(main.points, other.points, kept)
    low = [
        one.low[evenly(len(one.low.points), round(len(one.low.points) * len(part) / max(len(one.points), 1)))]
        for one, part in zip((main, other), kept, strict=True)
    ]
    late_s = None
    if main.late_s is not None and other.late_s is not None:
        late_s = _of_both(main.late_s + main.stamp_s - stamp_s, other.late_s + other.stamp_s - stamp_s, kept)
    try:
        box = box_around(points, settings)
    except BoxError:
        box = main.box
    return replace(
        main,
        stamp_s=stamp_s,
        points=points,
        sigma_along_m=_of_both(main.sigma_along_m, other.sigma_along_m, kept),
        sigma_across_m=_of_both(main.sigma_across_m, other.sigma_across_m, kept),
        count=count,
        middle=np.median(points[:, :2], axis=0),
        box=box,
        flaw=other.flaw if other.flaw == "cut" else main.flaw,
        late_s=late_s,
        low=low[0].joined(low[1]),
        borders=_outer(main, other),
    )


def _outer(main: Sighting, other: Sighting) -> FloatArray:
    """Return the borders, shape (2, 3), of two pieces of one object."""
    both = np.stack([main.borders, other.borders])
    bearings = np.column_stack([_bearing(piece, main.middle) for piece in both])
    right, left = bearings[0].argmin(), bearings[1].argmax()  # a cut piece's NaN is chosen first
    return np.stack([both[right, 0], both[left, 1]])


def _of_both(main: FloatArray, other: FloatArray, kept: Sequence[IntArray]) -> FloatArray:
    return np.concatenate([main[kept[0]], other[kept[1]]])


def _sighting(points: FloatArray, cloud: PointCloud, low: Low, frame_s: float, settings: Settings) -> Sighting | None:
    limits = settings.vehicle
    sigma_m = float(np.median(cloud.sigma_along_m))
    flaw: Flaw | None = None
    if cloud.at_edge.mean() > limits.max_edge_share:
        flaw = "cut"
    elif sigma_m > limits.max_sigma_m:
        flaw = "far"
    elif len(points) < limits.min_points:
        flaw = "thin"
    try:
        box = box_around(points, settings)
    except BoxError:
        return None
    if flaw is None and max(box.length_m, box.width_m) < limits.min_extent_m:
        flaw = "thin"
    # The same fraction of both is kept, to preserve their proportion, and enough points for a vehicle.
    share = min(KEPT_POINTS / len(points), KEPT_LOW / max(1, len(low.points)))
    share = min(1.0, max(share, limits.min_points / len(points)))
    kept, kept_low = (evenly(count, round(share * count)) for count in (len(points), len(low.points)))
    late_s = 0.0 if cloud.offset_s is None else float(np.median(cloud.offset_s))
    return Sighting(
        stamp_s=frame_s + late_s,
        frame_s=frame_s,
        points=points[kept],
        sigma_along_m=cloud.sigma_along_m[kept],
        sigma_across_m=cloud.sigma_across_m[kept],
        count=len(points),
        middle=np.median(points[:, :2], axis=0),
        box=box,
        flaw=flaw,
        sigma_m=sigma_m,
        late_s=None if cloud.offset_s is None else cloud.offset_s[kept] - late_s,
        turn_s=cloud.turn_s,
        begin_rad=np.pi if cloud.turned_rad is None else _begin(points, cloud.turned_rad),
        window_rad=cloud.window_rad,
        low=low[kept_low],
    )


def _begin(points: FloatArray, turned_rad: FloatArray) -> float:
    """Return the azimuth in the level frame at which scans begin; with a tilted scanner, at the points' elevation."""
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    return float(np.angle(np.exp(1j * (azimuth - turned_rad)).mean()))


def _borders(points: FloatArray, cloud: PointCloud, beside: FloatArray, settings: Settings) -> FloatArray:
    """Return the outermost points of a cluster, shape (2, 3): see `Sighting.borders`.

    A few points may be outliers of another object, so the outermost point must have as many others as make a cluster
    within half a matching window farther inside, the accuracy to which a border is known anyway.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Points of the cluster, level frame.
    cloud : PointCloud
        The same points with their noise, sensor frame.
    beside : ndarray, shape (m, 2)
        Points covered by the background: within reach of them a border may be hidden, too.
    settings : Settings
    """
    low = np.flatnonzero(points[:, 2] < SIDES_HIGHEST_M)
    if cloud.window_rad == 0.0 or len(low) < settings.cluster.min_points:
        return NO_BORDERS
    middle = np.median(points[:, :2], axis=0)
    return np.stack([_outermost(points[low], way, cloud[low], middle, beside, settings) for way in (-1.0, 1.0)])


def _outermost(
    points: FloatArray, way: float, cloud: PointCloud, middle: FloatArray, beside: FloatArray, settings: Settings
) -> FloatArray:
    """Return the outermost point, shape (3,), on the right (``way`` = -1) or the left (1); NaN where it is unknown."""
    inward = -way * _bearing(points, middle)
    order = np.argsort(inward)
    near = np.searchsorted(inward[order], inward[order] + cloud.window_rad / 2) - np.arange(len(order))
    crowded = order[near >= settings.cluster.min_points]
    unknown: FloatArray = NO_BORDERS[0]
    if not len(crowded):
        return unknown
    found = crowded[0]
    cut = cloud.at_edge[np.abs(inward - inward[found]) < cloud.window_rad].any()
    reached = np.linalg.norm(beside - points[found, :2], axis=1) < settings.cluster.reach_m
    return unknown if cut or reached.any() else points[found]


def _bearing(points: FloatArray, middle: FloatArray) -> FloatArray:
    """Return the bearings of points, shape (n, 3), counter-clockwise from that of ``middle``, shape (n,), rad."""
    forward = (middle / max(float(np.hypot(*middle)), 1e-9))[None]
    xy = points[:, :2]
    bearing: FloatArray = np.arctan2(dot_xy(perpendicular(forward), xy), dot_xy(forward, xy))
    return bearing
