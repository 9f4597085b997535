"""Points around a LiDAR, accumulated from some of its scans, and the points near a map's lines."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from laci_lidar.scan import Scan
from laci_lidar.sequence import ScanSequence
from laci_stereo.check.placed import Placed
from laci_stereo.check.profiles import OFFSETS_M, REACH_M, STEP_M
from laci_stereo.check.sections import FARTHEST_M, SECTION_M, Sections
from laci_stereo.core.columns import Columns
from laci_stereo.core.frames import FloatArray, IntArray, transform
from laci_stereo.core.subsampling import spread

SCANS = 20
"""Number of scans, uniformly spaced: their range noise fills the space between beams, and moving objects are in few."""

LOWEST_M, HIGHEST_M = -0.5, 2.5
"""Range of heights over the plane: roads deviate by less within sight, and the eaves of the lowest buildings are
above."""

WINDOW_M = float(np.hypot(REACH_M, SECTION_M / 2))
"""Distance from the middle of a section to a corner of the area that is examined."""

LEAST_POINTS = 10
"""Least number of points across a section for a profile."""


@dataclass(frozen=True)
class Surroundings(Columns):
    """Points of several scans in the world frame.

    Attributes
    ----------
    points : ndarray, shape (n, 3)
        World, metres.
    intensity : ndarray, shape (n,)
        Intensity in the sensor's own unit; NaN if there is none.
    scan : ndarray of int, shape (n,)
        Index of each point's scan.
    """

    points: FloatArray
    intensity: FloatArray
    scan: IntArray

    @cached_property
    def tree(self) -> cKDTree:
        """Search tree over the points' horizontal positions."""
        return cKDTree(self.points[:, :2])

    def beside(self, xy: FloatArray) -> Surroundings:
        """Return all points within `WINDOW_M` of positions, shape (k, 2), and few others."""
        low = xy.min(axis=0, initial=0.0) - WINDOW_M
        marked = ((xy - low) / WINDOW_M).astype(np.int64)
        near = np.zeros(marked.max(axis=0, initial=0) + 2, dtype=bool)
        for step in np.ndindex(3, 3):
            near[tuple((marked + step - 1).T)] = True
        column, row = ((self.points[:, :2] - low) / WINDOW_M).T
        inside = (column >= 0) & (row >= 0) & (column < near.shape[0]) & (row < near.shape[1])
        inside[inside] = near[column[inside].astype(np.int64), row[inside].astype(np.int64)]
        return self[inside]


@dataclass(frozen=True)
class Window:
    """The points beside one section of a line.

    Attributes
    ----------
    number : int
        Index of the section.
    across_m : ndarray, shape (k,)
        Offsets to the left of the line.
    around : Surroundings
    """

    number: int
    across_m: FloatArray
    around: Surroundings


def surroundings_in(scans: ScanSequence, placed: Placed) -> Surroundings:
    """Accumulate the points of some scans.

    Raises
    ------
    ScanError
        If more than a fifth of the selected scans cannot be read.
    """
    none, found = Surroundings(np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=np.int64)), []
    for number, scan in enumerate(scans.read(spread(range(len(scans)), SCANS), 1)):
        if scan is None:
            continue
        points = transform(placed.T_world_sensor, scan.points)
        apart_m = np.linalg.norm(points[:, :2] - placed.origin[:2], axis=1)
        near = (points[:, 2] > LOWEST_M) & (points[:, 2] < HIGHEST_M) & (apart_m < FARTHEST_M)
        found.append(Surroundings(points[near], _intensity(scan)[near], np.full(int(near.sum()), number)))
    return none.joined(*found)


def _intensity(scan: Scan) -> FloatArray:
    """Return the points' intensity; NaN if there is none, and for all points if it is constant."""
    unknown = np.full(len(scan.points), np.nan)
    if scan.intensity is None:
        return unknown
    told = np.where(np.isfinite(scan.intensity), scan.intensity, np.nan)
    return told if len(np.unique(told[np.isfinite(told)])) > 1 else unknown


def windows(around: Surroundings, sections: Sections) -> Iterator[Window]:
    """Yield the points within `REACH_M` on either side of each section."""
    if len(sections) == 0:
        return
    for number, indices in enumerate(around.tree.query_ball_point(sections.xy, WINDOW_M)):
        near = np.array(indices, dtype=np.int64)
        beside = around.points[near, :2] - sections.xy[number]
        across = beside @ sections.left[number]
        inside = (np.abs(beside @ sections.ahead[number]) < SECTION_M / 2) & (np.abs(across) < REACH_M)
        if inside.sum() >= LEAST_POINTS:
            yield Window(number, across[inside], around[near[inside]])


def gaps(across_m: FloatArray) -> FloatArray:
    """Return the lengths of the gaps between points in a window, shape (k + 1,)."""
    return np.diff(np.concatenate([[-REACH_M], np.sort(across_m), [REACH_M]]))


def typical(lengths_m: FloatArray) -> float:
    """Return the mean length of the gap that contains a random place."""
    return max(float((lengths_m**2).sum() / max(lengths_m.sum(), 1e-9)), STEP_M)


def smoothed(across_m: FloatArray, values: FloatArray, cell_m: float) -> FloatArray:
    """Return the local mean of values at `OFFSETS_M`, with Gaussian weights of cell width; NaN if no point is near."""
    weights = np.exp(-0.5 * ((OFFSETS_M[:, None] - across_m) / (cell_m / 2)) ** 2)
    total = weights.sum(axis=1)
    near = total > np.exp(-2.0)  # a point within a cell
    mean: FloatArray = np.where(near, weights @ values / np.maximum(total, 1e-12), np.nan)
    return mean
