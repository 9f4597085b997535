"""The lane check of a LiDAR: paint is where the road returns more light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from laci_lidar.sequence import ScanSequence
from laci_stereo.check.images import Checked
from laci_stereo.check.lanes import MAP_SIGMA_M, check_lanes
from laci_stereo.check.picture import draw_check
from laci_stereo.check.placed import Placed
from laci_stereo.check.profiles import OFFSETS_M, REACH_M, STEP_M, Profiles
from laci_stereo.check.sections import FARTHEST_M, SECTION_M, Sections
from laci_stereo.core.frames import FloatArray, Raster, transform
from laci_stereo.io.lane_map import LaneMap
from laci_stereo.report.lines import clip_slab
from laci_stereo.stereo.recording import spread

SCANS = 20
"""Evenly spread: the noise of their ranges fills what lies between beams."""

GROUND_M = 0.3
"""Off the plane, at most: roads are crowned and bent by less within sight, and bodies of vehicles begin above."""

LEAST_POINTS = 10
"""Across a section, from which a profile can be told."""

PIXELS_PER_M = 16.0
MOST_PIXELS = 1600


@dataclass(frozen=True)
class Road:
    """Points of the ground and how bright they are.

    Attributes
    ----------
    xy : ndarray, shape (n, 2)
        World.
    intensity : ndarray, shape (n,)
        In the sensor's own unit.
    """

    xy: FloatArray
    intensity: FloatArray


class PlacedRanging(Placed):
    """A sensor that measures distances: a point that is higher than thought is still where it is."""

    def lengthening(self, xy: FloatArray) -> FloatArray:
        """Return no movement, shape (n, 2)."""
        return np.zeros_like(xy)


def check_scans(
    scans: ScanSequence, placed: Placed, lane_map: LaneMap, map_sigma_m: float = MAP_SIGMA_M
) -> Checked | None:
    """Hold a map against what a LiDAR saw.

    Parameters
    ----------
    scans : ScanSequence
    placed : Placed
    lane_map : LaneMap
    map_sigma_m : float
        Standard deviation of a line's place in the map.

    Returns
    -------
    Checked or None
        None where the scans have no intensity.

    Raises
    ------
    ScanError
        If more than a fifth of the scans that are looked at cannot be read.
    """
    road = road_in(scans, placed)
    if road is None:
        return None
    ranging = PlacedRanging(placed.T_world_sensor, placed.covariance, placed.centre_world, placed.boxes)
    tree = cKDTree(road.xy)
    check = check_lanes(lane_map.lines, ranging, lambda sections: profiles_in_scans(road, tree, sections), map_sigma_m)
    view = _view(road)
    backdrop = view.backdrop(road)
    return Checked(check, draw_check(backdrop, view.project, check, ranging, lane_map))


def road_in(scans: ScanSequence, placed: Placed) -> Road | None:
    """Return the ground's points of some scans, or None if they have no intensity.

    Raises
    ------
    ScanError
    """
    found, bright = [np.zeros((0, 2))], [np.zeros(0)]
    has_intensity = False
    for scan in scans.read(spread(range(len(scans)), SCANS), 1):
        if scan is None or scan.intensity is None or np.ptp(scan.intensity) == 0:
            continue
        has_intensity = True
        points = transform(placed.T_world_sensor, scan.points)
        apart_m = np.linalg.norm(points[:, :2] - placed.origin[:2], axis=1)
        ground = (np.abs(points[:, 2]) < GROUND_M) & (apart_m < FARTHEST_M)
        found.append(points[ground, :2])
        bright.append(scan.intensity[ground])
    return Road(np.concatenate(found), np.concatenate(bright)) if has_intensity else None


def profiles_in_scans(road: Road, tree: cKDTree, sections: Sections) -> Profiles:
    """Average the road's intensity across sections of lines, over as much as lies between points.

    Parameters
    ----------
    road : Road
    tree : cKDTree
        Of its points.
    sections : Sections
    """
    values = np.full((len(sections), len(OFFSETS_M)), np.nan)
    cells_m = np.full(len(sections), np.inf)
    around = tree.query_ball_point(sections.xy, float(np.hypot(REACH_M, SECTION_M / 2))) if len(sections) else []
    for number, indices in enumerate(around):
        beside = road.xy[indices] - sections.xy[number]
        across = beside @ sections.left[number]
        inside = (np.abs(beside @ sections.ahead[number]) < SECTION_M / 2) & (np.abs(across) < REACH_M)
        if inside.sum() < LEAST_POINTS:
            continue
        cell_m = _gap(across[inside])
        cells_m[number] = cell_m
        values[number] = _smoothed(across[inside], road.intensity[indices][inside], cell_m)
    return Profiles(values, cells_m, in_image=False)


def _gap(across_m: FloatArray) -> float:
    """Return the mean length of the gap between points in which a place of the window lies."""
    gaps = np.diff(np.concatenate([[-REACH_M], np.sort(across_m), [REACH_M]]))
    return max(float((gaps**2).sum() / gaps.sum()), STEP_M)


def _smoothed(across_m: FloatArray, values: FloatArray, cell_m: float) -> FloatArray:
    """Return the mean of values about `OFFSETS_M`, with Gaussian weights as wide as a cell; NaN where none is near."""
    weights = np.exp(-0.5 * ((OFFSETS_M[:, None] - across_m) / (cell_m / 2)) ** 2)
    total = weights.sum(axis=1)
    near = total > np.exp(-2.0)  # a point within a cell
    smoothed: FloatArray = np.where(near, weights @ values / np.maximum(total, 1e-12), np.nan)
    return smoothed


@dataclass(frozen=True)
class _View:
    """A picture of the road from above, north up."""

    low: FloatArray
    high: FloatArray
    scale_px: float

    def pixels(self, xy: FloatArray) -> FloatArray:
        """Map points, shape (n, 2), world, to pixels."""
        return np.column_stack([xy[:, 0] - self.low[0], self.high[1] - xy[:, 1]]) * self.scale_px

    def project(self, xy: FloatArray) -> list[FloatArray]:
        """Return the pieces of a line, shape (n, 2), that are in view, pixels."""
        return [
            self.pixels(piece)
            for part in clip_slab(xy, 0, self.low[0], self.high[0])
            for piece in clip_slab(part, 1, self.low[1], self.high[1])
        ]

    def backdrop(self, road: Road) -> Raster:
        """Draw the road's intensity, shape (height, width), uint8."""
        width, height = np.ceil((self.high - self.low) * self.scale_px).astype(int) + 1
        column, row = np.rint(self.pixels(road.xy)).astype(int).T
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        flat = row[inside] * width + column[inside]
        count = np.bincount(flat, minlength=width * height)
        mean = np.bincount(flat, road.intensity[inside], minlength=width * height) / np.maximum(count, 1)
        dark, bright = np.quantile(road.intensity, [0.02, 0.98])
        grey = 60.0 + 195.0 * np.clip((mean - dark) / max(bright - dark, 1e-9), 0.0, 1.0)
        return np.where(count > 0, grey, 25.0).astype(np.uint8).reshape(height, width)


def _view(road: Road) -> _View:
    low, high = np.quantile(road.xy, [0.01, 0.99], axis=0) if len(road.xy) else (-np.ones(2), np.ones(2))
    extent = np.maximum(high - low, 10.0)
    middle = (low + high) / 2
    return _View(middle - extent / 2, middle + extent / 2, min(PIXELS_PER_M, MOST_PIXELS / float(extent.max())))
