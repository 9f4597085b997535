"""Estimation of a scanner's noise from its points on the ground and from the pattern of its beams."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls
from scipy.spatial import cKDTree

from laci_stereo.core.frames import Axes, FloatArray, IntArray
from laci_stereo.core.ground.axes import ground_below
from laci_stereo.core.ground.plane import GroundPlane
from laci_stereo.core.robust import NORMAL
from laci_stereo.core.settings import GroundSettings
from laci_stereo.core.subsampling import evenly

START_SIGMA_M = 0.02
"""Initial value, typical of data sheets, with which the ground is fitted for the first time."""

USUAL_SIGMA_M = 0.03
"""Used if too little ground is seen for an estimate: the data sheet of the Velodyne VLP-16, the scanner most used at
roads, states a typical range accuracy of 3 cm."""

SMALLEST_SIGMA_M, LARGEST_SIGMA_M = 0.005, 0.2
"""Limits of the estimate: no road scanner is more precise than the one, none on the market is worse than the other."""

SMALLEST_SIGMA_RAD, LARGEST_SIGMA_RAD = 1e-4, 1e-2
"""Limits of the estimate: encoders are no more precise than the one, beams no wider than the other."""

NEAR_GROUND_M = 0.1
"""Distance from the plane within which points are on the road; beyond it kerbs begin."""

GROUND_POINTS = 20_000
"""Number of points that suffice to fit the plane, because the part of its error that neighbours share cancels."""

_SAMPLE = 3000
_SAME_BEAM_RAD = 1e-4
_BINS = 8
# The smallest bin then has about eight pairs.
_MIN_PAIRS = 1000
# Limits grazing angles to 3 deg, which is the horizon, or 100 m from 5 m above the ground.
_SMALLEST_STEEPNESS = 0.05


@dataclass(frozen=True)
class Noise:
    """Standard deviations of a scanner's ranges and bearings.

    ``assumed`` is what is assumed rather than estimated, as a sentence; empty if nothing is.
    """

    range_sigma_m: float
    angle_sigma_rad: float
    assumed: str = ""


def estimate_angle_sigma(scans: Sequence[FloatArray]) -> float:
    """Estimate the standard deviation of bearings from the beam pattern of scans, each of shape (n, 3).

    The point that a beam hits lies anywhere within its step, because steps are made about as wide as the beam. The
    bearing is therefore uniformly distributed over the angle between neighbouring beams, and its standard deviation is
    this angle / sqrt(12).
    """
    steps = [_neighbours(_directions(points))[2] for points in scans]
    found = np.concatenate(steps) if steps else np.zeros(0)
    if len(found) == 0:
        return SMALLEST_SIGMA_RAD
    return float(np.clip(np.median(found) / np.sqrt(12.0), SMALLEST_SIGMA_RAD, LARGEST_SIGMA_RAD))


def estimate_range_sigma(
    scans: Sequence[FloatArray], angle_sigma_rad: float, axes: Axes, settings: GroundSettings
) -> float | None:
    """Estimate the standard deviation of ranges from points on the ground in scans, each of shape (n, 3).

    The plane predicts the range of every point on the road. The residuals of two neighbours in one scan differ only by
    noise, because they share the effects of the road's crown and of the plane's error. A bearing error d changes the
    predicted range by k d, k = range / tan(grazing angle), so the variance of a residual is sigma_range^2 + k^2
    sigma_bearing^2. A line fitted to the variances over k^2 separates the two; using the medians of bins excludes
    kerbs. The result is None if there are too few neighbours.

    Raises
    ------
    GroundError
        If no ground is found.
    """
    points = np.concatenate(scans) if scans else np.zeros((0, 3))
    points = points[:: max(1, len(points) // GROUND_POINTS)]
    range_m = np.linalg.norm(points, axis=1)
    along = np.full(len(points), START_SIGMA_M)
    ground = ground_below(points, along, range_m * angle_sigma_rad, axes, settings)
    differences, leverage = np.concatenate([_differences(scan, ground) for scan in scans], axis=1)
    if len(differences) < _MIN_PAIRS:
        return None
    # Only the steeper half is used, since far away the road's unevenness matters; bins are narrowest where k is
    # smallest.
    edges = np.round(len(leverage) / 2 * np.linspace(0.0, 1.0, _BINS + 1) ** 2).astype(np.int64)
    bins = np.split(np.argsort(leverage)[: edges[-1]], edges[1:-1])
    variance = np.array([np.median(np.abs(differences[bin_])) ** 2 * NORMAL**2 / 2 for bin_ in bins])
    squares = np.array([np.median(leverage[bin_] ** 2) for bin_ in bins])
    # The standard deviation of a variance is proportional to the variance over the root of the number of pairs.
    weight = np.sqrt(np.diff(edges)) / np.maximum(variance, SMALLEST_SIGMA_M**2)
    (at_nothing, _), _ = nnls(np.column_stack([weight, weight * squares]), weight * variance)
    return float(np.clip(np.sqrt(at_nothing), SMALLEST_SIGMA_M, LARGEST_SIGMA_M))


def _differences(points: FloatArray, ground: GroundPlane) -> FloatArray:
    """Return the differences of range residuals between neighbours on the ground, and their k; shape (2, n)."""
    road = points[np.abs(ground.heights(points)) < NEAR_GROUND_M]
    directions = _directions(road)
    steepness = np.maximum(-directions @ ground.normal, _SMALLEST_STEEPNESS)
    residuals = np.linalg.norm(road, axis=1) - ground.height_m / steepness
    sample, neighbour, angle = _neighbours(directions)
    if len(angle) == 0:
        return np.zeros((2, 0))
    near = angle < 2 * np.median(angle)
    sample, neighbour = sample[near], neighbour[near]
    leverage = ground.height_m / steepness[sample] * np.sqrt(1 / steepness[sample] ** 2 - 1)
    return np.stack([residuals[sample] - residuals[neighbour], leverage])


def _neighbours(directions: FloatArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Return a sample of directions, the nearest other beam of each, and the angle between them, radians."""
    nothing = np.zeros(0, dtype=np.int64)
    if len(directions) < 3:
        return nothing, nothing, np.zeros(0)
    sample = evenly(len(directions), _SAMPLE)
    # A beam's second return has the direction of the first.
    angle, index = map(np.asarray, cKDTree(directions).query(directions[sample], k=3))
    which = np.where(angle[:, 1] > _SAME_BEAM_RAD, 1, 2)
    rows = np.arange(len(sample))
    angle, other = angle[rows, which], index[rows, which]
    usable = (angle > _SAME_BEAM_RAD) & np.isfinite(angle)
    return sample[usable], other[usable], angle[usable]


def _directions(points: FloatArray) -> FloatArray:
    directions: FloatArray = points / np.linalg.norm(points, axis=1, keepdims=True)
    return directions
