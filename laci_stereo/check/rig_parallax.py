"""What matched points say of a stereo calibration: after rectification they lie in one row, and no one beyond infinity.

Vertical parallax is the row of a point in the rectified right image less that in the left one, disparity the columns'
difference. A small turn w of the right camera and an error e of the direction to it shift a point at (x, y), in focal
lengths, with disparity d, by f (w_z x - w_x (1 + y^2) + w_y x y) + d (e_y - e_z y) rows and by
f (w_y (1 + x^2) - w_z y - w_x x y) columns, to first order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.check.rig_points import COLUMNS, ROWS, Rectified
from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.robust import NORMAL
from laci_stereo.stereo.settings import StereoSettings

FLOOR_PX = StereoSettings().disparity_floor_px
"""What the noise model leaves to imperfect rectification, one standard deviation."""

FEWEST_IN_CELL = 9
"""Matches: the median is then not any one match's."""

MEDIAN_SIGMA = float(np.sqrt(np.pi / 2))
"""Of a median of normal values, in those of their mean."""

LEAST_NOISE_PX = 0.01
"""No match is better: it keeps perfect ones from weighing without end."""

PRIOR_RAD = np.radians(2.0)
"""A camera that has turned further on its bar is seen by eye; it keeps a flat scene from leaving a turn open."""


@dataclass(frozen=True)
class Cells:
    """What is systematic in the cells that hold enough matches, pixels.

    Attributes
    ----------
    parallax_px, disparity_px : ndarray, shape (c,)
        Medians.
    sigma_px : ndarray, shape (c,)
        Of these medians.
    count : ndarray of int, shape (c,)
    """

    parallax_px: FloatArray
    disparity_px: FloatArray
    sigma_px: FloatArray
    count: IntArray


@dataclass(frozen=True)
class Turn:
    """How the right camera seems to be turned and shifted against its calibration.

    Attributes
    ----------
    angles_rad : ndarray, shape (3,)
        About its x, y and z axis.
    sigma_rad : ndarray, shape (3,)
        With the floor that lenses leave.
    shift_rad : ndarray, shape (2,)
        Of the direction to it, along y and z.
    left_over_px : float
        Systematic parallax that it does not explain, 95th percentile.
    """

    angles_rad: FloatArray
    sigma_rad: FloatArray
    shift_rad: FloatArray
    left_over_px: float


@dataclass(frozen=True)
class RowsTurn:
    """The turn of the right camera that explains most of the parallax, if it has turned up and rolled, and no more.

    Attributes
    ----------
    angles_rad, sigma_rad : ndarray, shape (2,)
        About its x and z axis.
    effect_px : float
        Root mean square, over the matches, of the parallax by it.
    """

    angles_rad: FloatArray
    sigma_rad: FloatArray
    effect_px: float


@dataclass(frozen=True)
class Parallax:
    """The findings.

    Attributes
    ----------
    median_px, high_px : float
        Of the vertical parallax; 95th percentile of its amount.
    noise_px : float
        Its scatter within a cell, one standard deviation.
    systematic_px : float
        95th percentile over the matches of the amount of their cell's median beyond three of its sigmas.
    trend_px : tuple of float
        Parallax in the middle of the image, and its change across the width and the height.
    behind_px : float
        How far the median disparity of some cell is below zero beyond noise.
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
    """How much later the right images were taken than the left ones, by what moves.

    Attributes
    ----------
    seconds, sigma_s : float
    effect_px : float
        What that does to the points that move, 95th percentile.
    count : int
    """

    seconds: float
    sigma_s: float
    effect_px: float
    count: int


def measure(points: Rectified) -> Parallax:
    """Find what is systematic in the parallax of matches, and what is noise."""
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
    behind = -cells.disparity_px - 3 * cells.sigma_px
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
    """Return how each match's parallax, pixels, follows from the turn, rad, and the shift's direction, rad: (n, 5)."""
    f, d = points.focal_px, -points.sign * points.disparity_px
    x, y = ((points.right - points.centre_px) / f).T
    return np.column_stack([-f * (1 + y**2), f * x * y, f * x, -d, d * y])


def lag(moving: Rectified, found: Parallax) -> Lag | None:
    """Find how much later the right images were taken, from points that move up or down in the image; None if few do.

    A point with v rows per second is v dt lower in an image that was taken dt later.
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
    """Fit values by the columns of a design, whatever a minority does; return parameters and covariance.

    The parameters are taken to be zero within ``prior``, one sigma. The covariance takes the residuals of a cluster for
    one, as a lens's errors are alike within a cell (sandwich estimate).
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
    """Return a standard deviation, by the median."""
    return max(NORMAL * float(np.median(np.abs(residual))), LEAST_NOISE_PX)


def _cell_medians(values: FloatArray, cell: IntArray) -> FloatArray:
    """Return for each value the median of its cell."""
    medians = np.zeros(len(values))
    for number in np.unique(cell):
        medians[cell == number] = np.median(values[cell == number])
    return medians


def _cells(points: Rectified, values: FloatArray, noise_px: float) -> Cells:
    """Return the medians of the cells with enough matches. A camera that stands still sees the same points again."""
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
    """Return the 95th percentile over the matches of what is systematic beyond noise."""
    if not len(cells.count):
        return 0.0
    certain = np.maximum(np.abs(cells.parallax_px) - 3 * cells.sigma_px, 0.0)
    order = np.argsort(certain)
    reached = np.cumsum(cells.count[order]) >= 0.95 * cells.count.sum()
    return float(certain[order][reached][0])
