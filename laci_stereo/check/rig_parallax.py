"""Analysis of matched points under a stereo calibration: vertical parallax and disparities below zero.

With a correct calibration, partners (matched points) lie in one row after rectification, and no point lies beyond
infinity.

Vertical parallax is the row of a point in the rectified right image minus that in the left one; disparity is the
corresponding difference of columns. A small rotation w of the right camera and an error e of the direction of the
baseline shift a point at (x, y), in focal lengths, with disparity d, by f (w_z x - w_x (1 + y^2) + w_y x y) + d (e_y -
e_z y) rows and by f (w_y (1 + x^2) - w_z y - w_x x y) columns, to first order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.check.rig_points import COLUMNS, ROWS, Rectified
from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.robust import NORMAL
from laci_stereo.stereo.settings import StereoSettings

FLOOR_PX = StereoSettings().disparity_floor_px
"""Standard deviation that the noise model allows for imperfect rectification."""

FEWEST_IN_CELL = 9
"""Least number of matches in a cell: the median then does not depend on any single match."""

MEDIAN_SIGMA = float(np.sqrt(np.pi / 2))
"""Standard deviation of the median of normally distributed values, in units of that of their mean."""

LEAST_NOISE_PX = 0.01
"""Lower limit of a match's standard deviation: without it, perfect matches would get unlimited weight."""

PRIOR_RAD = np.radians(2.0)
"""A priori standard deviation of each parameter of a turn. A camera that has turned further on its bar is noticed by
eye; the prior also keeps a flat scene from leaving a parameter undetermined."""


@dataclass(frozen=True)
class Cells:
    """Systematic errors of the cells that contain enough matches, pixels.

    Attributes
    ----------
    parallax_px, disparity_px : ndarray, shape (c,)
        Medians of vertical parallax and disparity.
    sigma_px : ndarray, shape (c,)
        Standard deviations of the parallax medians.
    count : ndarray of int, shape (c,)
    """

    parallax_px: FloatArray
    disparity_px: FloatArray
    sigma_px: FloatArray
    count: IntArray


@dataclass(frozen=True)
class Turn:
    """Estimated rotation and displacement of the right camera relative to its calibration.

    Attributes
    ----------
    angles_rad : ndarray, shape (3,)
        Rotation about its x, y and z axis.
    sigma_rad : ndarray, shape (3,)
        Standard deviations, with an allowance for residual lens errors.
    shift_rad : ndarray, shape (2,)
        Change of the direction of the baseline, along y and z.
    left_over_px : float
        95th percentile of the systematic parallax that the turn does not explain.
    """

    angles_rad: FloatArray
    sigma_rad: FloatArray
    shift_rad: FloatArray
    left_over_px: float


@dataclass(frozen=True)
class RowsTurn:
    """The pitch and roll of the right camera that explain most of the parallax, if it has no other error.

    Attributes
    ----------
    angles_rad, sigma_rad : ndarray, shape (2,)
        Rotation about its x and z axis, and its standard deviations.
    effect_px : float
        Root mean square of the parallax that this rotation causes, over the matches.
    """

    angles_rad: FloatArray
    sigma_rad: FloatArray
    effect_px: float


@dataclass(frozen=True)
class Parallax:
    """Results of the parallax analysis.

    Attributes
    ----------
    median_px, high_px : float
        Median of the vertical parallax, and 95th percentile of its absolute value.
    noise_px : float
        Its dispersion within a cell, one standard deviation.
    systematic_px : float
        95th percentile over the matches of their cell's systematic parallax: the amount by which the absolute value of
        the cell's median exceeds three of its standard deviations.
    trend_px : tuple of float
        Parallax in the middle of the image, and its change across the width and across the height.
    behind_px : float
        The largest amount by which a cell's median disparity is below zero beyond noise (three standard deviations),
        of the cells with enough matches in each pair.
    cells : Cells
    turn : Turn
    rows_turn : RowsTurn
    """

    median_px: float
    high_px: float
    noise_px: float
    systematic_px: float
    trend_px: tuple[float, float, float]
    behind_px: float
    cells: Cells
    turn: Turn
    rows_turn: RowsTurn


@dataclass(frozen=True)
class Lag:
    """Delay of the right images relative to the left ones, measured with moving points, ``count`` of them.

    ``effect_px`` is the 95th percentile of the displacement of these points by it.
    """

    seconds: float
    sigma_s: float
    effect_px: float
    count: int


def measure(points: Rectified) -> Parallax:
    """Separate systematic parallax of matches from noise."""
    parallax = points.parallax_px
    design = turn_rows(points)
    turn, covariance = _robust_fit(design, parallax, points.cell, PRIOR_RAD)
    residual = parallax - design @ turn
    noise = _scatter(residual - _cell_medians(residual, points.cell))
    cells = _cells(points, parallax, noise)
    left_over = _cells(points, residual, noise)
    floor = FLOOR_PX / np.maximum(np.sqrt((design**2).mean(axis=0)), 1e-9)
    sigma = np.sqrt(np.diag(covariance) + floor**2)
    flat, _ = _robust_fit(_plane_rows(points), parallax, points.cell, np.inf)
    # One mismatch along a row, as in a row of windows, is found again in each pair: so many points must be different.
    enough = cells.count >= FEWEST_IN_CELL * len(np.unique(points.pair))
    behind = np.where(enough, -cells.disparity_px - 3 * cells.sigma_px, 0.0)
    return Parallax(
        median_px=float(np.median(parallax)),
        high_px=float(np.percentile(np.abs(parallax), 95)),
        noise_px=noise,
        systematic_px=_high(cells),
        trend_px=(float(flat[0]), float(flat[1]), float(flat[2])),
        behind_px=float(behind.max(initial=0.0)),
        cells=cells,
        turn=Turn(turn[:3], sigma[:3], turn[3:], _high(left_over)),
        rows_turn=_rows_turn(design[:, [0, 2]], points),
    )


def _rows_turn(design: FloatArray, points: Rectified) -> RowsTurn:
    angles, covariance = _robust_fit(design, points.parallax_px, points.cell, PRIOR_RAD)
    effect_px = float(np.sqrt(((design @ angles) ** 2).mean()))
    return RowsTurn(angles, np.sqrt(np.diag(covariance)), effect_px)


def turn_rows(points: Rectified) -> FloatArray:
    """Return the derivatives of parallax by the three angles and two shifts of a `Turn`, px/rad, shape (n, 5)."""
    f, d = points.focal_px, -points.sign * points.disparity_px
    x, y = ((points.right - points.centre_px) / f).T
    return np.column_stack([-f * (1 + y**2), f * x * y, f * x, -d, d * y])


def lag(moving: Rectified, found: Parallax) -> Lag | None:
    """Return the delay of the right images, from points that move up or down in the image; None if too few do.

    A point that moves by v rows per second is v dt lower in an image that was taken dt later.
    """
    parameters = np.concatenate([found.turn.angles_rad, found.turn.shift_rad])
    if len(moving) < FEWEST_IN_CELL:
        return None
    velocity = moving.flow_px / moving.later_s[:, None]
    residual = moving.parallax_px - turn_rows(moving) @ parameters
    seconds, covariance = _robust_fit(velocity[:, 1:], residual, moving.pair, np.inf)
    floor_s = FLOOR_PX / max(float(np.sqrt((velocity[:, 1] ** 2).mean())), 1e-9)
    fastest = float(np.percentile(np.linalg.norm(velocity, axis=1), 95))
    sigma_s = float(np.hypot(np.sqrt(covariance[0, 0]), floor_s))
    return Lag(float(seconds[0]), sigma_s, abs(float(seconds[0])) * fastest, len(moving))


def _plane_rows(points: Rectified) -> FloatArray:
    across = points.left / points.size - 0.5
    return np.column_stack([np.ones(len(points)), across])


def _robust_fit(
    design: FloatArray, values: FloatArray, cluster: IntArray, prior: float
) -> tuple[FloatArray, FloatArray]:
    """Fit the columns of a design to values robustly against a minority of outliers; return parameters and covariance.

    The parameters have an a priori mean of zero and standard deviation of ``prior``. The covariance allows any
    correlation of residuals within a cluster, as lens errors are nearly constant within a cell (sandwich estimate).
    """
    weight = np.ones(len(values))
    scale = LEAST_NOISE_PX
    for _ in range(20):
        normal = (design * weight[:, None]).T @ design + np.eye(design.shape[1]) * (scale / prior) ** 2
        normal += np.eye(design.shape[1]) * 1e-12 * np.trace(normal)
        parameters = np.linalg.solve(normal, (design * weight[:, None]).T @ values)
        residual = values - design @ parameters
        scale = _scatter(residual)
        weight = 1.0 / (1.0 + (residual / scale) ** 2)
    inverse = np.linalg.inv(normal)
    pull = design * (weight * residual)[:, None]
    each = np.stack([pull[cluster == number].sum(axis=0) for number in np.unique(cluster)])
    covariance: FloatArray = inverse @ (each.T @ each) @ inverse
    return parameters, covariance


def _scatter(residual: FloatArray) -> float:
    """Return a robust standard deviation from the median absolute value."""
    return max(NORMAL * float(np.median(np.abs(residual))), LEAST_NOISE_PX)


def _cell_medians(values: FloatArray, cell: IntArray) -> FloatArray:
    """Return the median of each value's cell, shape (n,)."""
    medians = np.zeros(len(values))
    for number in np.unique(cell):
        medians[cell == number] = np.median(values[cell == number])
    return medians


def _cells(points: Rectified, values: FloatArray, noise_px: float) -> Cells:
    """Return the medians of the cells with enough matches.

    A stationary camera sees the same points in every pair, so that only one pair's matches count as independent.
    """
    cell, pairs = points.cell, len(np.unique(points.pair))
    full = [np.flatnonzero(cell == number) for number in range(COLUMNS * ROWS)]
    full = [members for members in full if len(members) >= FEWEST_IN_CELL]
    count = np.array([len(members) for members in full], dtype=np.int64)
    return Cells(
        np.array([np.median(values[members]) for members in full]),
        np.array([np.median(points.disparity_px[members]) for members in full]),
        MEDIAN_SIGMA * noise_px / np.sqrt(np.maximum(count / pairs, 1.0)),
        count,
    )


def _high(cells: Cells) -> float:
    """Return the 95th percentile over the matches of the systematic parallax of their cells."""
    if not len(cells.count):
        return 0.0
    certain = np.maximum(np.abs(cells.parallax_px) - 3 * cells.sigma_px, 0.0)
    order = np.argsort(certain)
    reached = np.cumsum(cells.count[order]) >= 0.95 * cells.count.sum()
    return float(certain[order][reached][0])
