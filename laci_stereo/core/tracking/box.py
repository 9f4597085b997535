"""The paper's box fit: an oriented rectangle around the points that one sensor sees of one vehicle.

Usable by itself for online detection::

    from laci_stereo.core import fit_box

    box = fit_box(xy, sensor_xy=(0.0, 0.0))
    inside = box.contains(other_xy)

Source: LACI (Mueller et al., ITSC 2019), section III-C. Beams of light fall from the sensor onto the points; a line is
fitted to the points that are lit, the nearest in each beam; the points near it (Q) and those of the bar perpendicular
to it (P) are then fitted by two orthogonal lines.

The paper lights the points once and uses one line. A vehicle that is seen at its corner shows two sides, and one line
through both has the direction of neither; if it is seen along one of its sides, that side is hidden in a single beam.
Here the line therefore has four candidates, and the one whose two orthogonal lines fit the points best is chosen.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from laci_stereo.core.errors import BoxError
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray, rotate_xy
from laci_stereo.core.settings import BoxSettings

_DEFAULTS = BoxSettings()

_Sums: TypeAlias = Sequence[float]
"""Sums over the points of one line: their number and the sums of x, y, x x, x y and y y."""

_Line: TypeAlias = tuple[float, float, float]
"""(c, n_x, n_y): the points with c + n_x x + n_y y = 0; (n_x, n_y) is the unit normal."""

_NOWHERE: _Line = (1e12, 0.0, 0.0)
"""A line far from every point; it is finite, since multiplying infinity raises a floating-point flag in some BLAS."""

_NO_POINTS: _Sums = (0.0,) * 6

_COVERED_SIGMAS = 2.0
"""Gate of a line's points in standard deviations of their noise: it contains nearly all of them, and little of the
vehicle's inside."""

_CUT_RMS = 0.44
"""Root mean square of Gaussian noise truncated at two standard deviations, relative to the point of truncation."""

_KEPT_SIGMAS = 3.0
"""Gate of the narrowing of the tolerance: by Chebyshev's inequality each step keeps at least 8 of 9 points, whatever
their distribution."""

_NARROWINGS = 3
"""Number of narrowing steps: enough from 20 cm down to the noise of a LiDAR; further ones change little."""

_MAX_BINS = 1000
"""Largest number of bins, so that one far outlier does not exhaust the memory."""


@dataclass(frozen=True)
class Box:
    """A rectangle in the plane.

    Attributes
    ----------
    centre : ndarray, shape (2,)
        Centre in the frame of the points, metres.
    length_m, width_m : float
        Extents along yaw and across it; the length is the longer one.
    yaw_rad : float
        Direction of the length, in [-pi/2, pi/2]: points do not distinguish front and rear.
    """

    centre: FloatArray
    length_m: float
    width_m: float
    yaw_rad: float

    def corners(self) -> FloatArray:
        """Return the corners, shape (4, 2), counter-clockwise, the front left one first."""
        signs = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
        return self.centre + rotate_xy(self.yaw_rad, signs * (self.length_m / 2, self.width_m / 2))

    def contains(self, xy: FloatArray, margin_m: float = 0.0) -> BoolArray:
        """Return which points lie in the box or on its border.

        Parameters
        ----------
        xy : ndarray, shape (..., 2)
            Points in the frame of the box, metres.
        margin_m : float
            Distance by which every side is moved outwards first.

        Returns
        -------
        ndarray of bool, shape (...)
        """
        offset = np.abs(rotate_xy(-self.yaw_rad, xy - self.centre))
        along, across = offset[..., 0], offset[..., 1]
        inside: BoolArray = (along <= self.length_m / 2 + margin_m) & (across <= self.width_m / 2 + margin_m)
        return inside


def fit_box(
    xy: FloatArray,
    settings: BoxSettings = _DEFAULTS,
    sensor_xy: Sequence[float] | FloatArray = (0.0, 0.0),
    sigma_m: float | None = None,
) -> Box:
    """Fit a rectangle to the points that a sensor sees of one vehicle (paper section III-C).

    Parameters
    ----------
    xy : ndarray, shape (n, 2)
        Points in the plane, metres, n >= 3; of one, two or all sides of the vehicle, and some of its inside.
    settings : BoxSettings
        Widths of bins and the tolerance of lines.
    sensor_xy : array_like, shape (2,)
        Position of the sensor in the frame of the points.
    sigma_m : float, optional
        Typical noise of the points. Without it the tolerance widens until it covers the dispersion of the points.

    Returns
    -------
    Box
        The bounding box of all points along the direction of the sides, in the frame of the points.

    Raises
    ------
    BoxError
        If there are fewer than three points, if all are the same, or if values are not finite or have the wrong shape.
    """
    points = _checked(xy, sensor_xy, sigma_m)
    centre = points.mean(axis=1)
    across_rad = _across_light(centre.tolist(), sensor_xy)
    moments = _moments(_turned(-across_rad) @ (points - centre[:, None]))
    yaw_in_light = _fit_yaw(moments, settings, sigma_m)
    return _bounding_box(points, across_rad + yaw_in_light)


def _checked(xy: FloatArray, sensor_xy: Sequence[float] | FloatArray, sigma_m: float | None) -> FloatArray:
    """Return the points as contiguous rows of x and y, shape (2, n), or raise BoxError."""
    points = np.asarray(xy, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise BoxError(f"xy: shape {points.shape}, needed is (n, 2)")
    if len(points) < 3:
        raise BoxError(f"xy: {len(points)} points, needed are at least 3")
    points = np.ascontiguousarray(points.T)
    if not np.isfinite(points).all():
        raise BoxError(f"xy: {np.sum(~np.isfinite(points).all(axis=0))} points that are not finite, needed are 0")
    if (points == points[:, :1]).all():
        raise BoxError(f"xy: {points.shape[1]} points at one place, needed are at least 2 places")
    if np.shape(sensor_xy) != (2,):
        raise BoxError(f"sensor_xy: shape {np.shape(sensor_xy)}, needed is (2,)")
    if not (math.isfinite(sensor_xy[0]) and math.isfinite(sensor_xy[1])):
        raise BoxError(f"sensor_xy: ({sensor_xy[0]}, {sensor_xy[1]}), needed are finite numbers")
    if sigma_m is not None and not 0.0 <= sigma_m < math.inf:
        raise BoxError(f"sigma_m: {sigma_m}, needed is a finite number from 0")
    return points


def _across_light(centre: Sequence[float], sensor: Sequence[float] | FloatArray) -> float:
    """Return the angle of the x axis for which the light falls along y.

    The mean of the points is inside the vehicle's convex outline, so parallel beams of light from the sensor towards it
    fall on every side that the sensor sees.
    """
    return math.atan2(sensor[0] - centre[0], centre[1] - sensor[1])


def _turned(yaw_rad: float) -> FloatArray:
    """Return the rotation by yaw, shape (2, 2)."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[c, -s], [s, c]])


def _moments(points: FloatArray) -> FloatArray:
    """Return 1, x, y, x x, x y and y y of points of shape (2, n), shape (6, n)."""
    moments = np.ones((6, points.shape[1]))
    moments[1:3] = points
    np.multiply(points[0], points, out=moments[3:5])
    np.multiply(points[1], points[1], out=moments[5])
    return moments


def _fit_yaw(moments: FloatArray, settings: BoxSettings, sigma_m: float | None) -> float:
    """Return the yaw of the vehicle's sides in the frame of the light, in which the light falls along y."""
    widest = settings.max_tolerance_m
    tolerance = min(max(settings.line_tolerance_m, _COVERED_SIGMAS * (sigma_m or 0.0)), widest)
    lines = _line_candidates(moments, _lit(moments, settings.light_bin_m))
    distances = _best_corner(lines, moments, tolerance, settings.bar_bin_m)
    while sigma_m is None and tolerance < widest and not _covers_noise(distances, tolerance):
        tolerance = min(2.0 * tolerance, widest)
        distances = _best_corner(lines, moments, tolerance, settings.bar_bin_m)
    return _settle(distances, moments, tolerance)


def _covers_noise(distances: FloatArray, tolerance: float) -> bool:
    """Return whether the points' dispersion is less than that of noise which the tolerance truncates.

    ``distances``, shape (2, n), are those from the two lines.
    """
    return _residual(np.minimum(distances[0], distances[1]), tolerance) <= _CUT_RMS * tolerance


def _bins(values: FloatArray, bin_m: float) -> IntArray:
    """Return the index of each value's bin, from 0."""
    above = values - values.min()
    bins: IntArray = (above / max(bin_m, float(above.max()) / _MAX_BINS)).astype(np.int64)
    return bins


def _lit(moments: FloatArray, bin_m: float) -> IntArray:
    """Return the indices of the nearest point in each beam, in the order of x (paper: the minimum of y in each bin)."""
    x, y = moments[1], moments[2]
    beam = _bins(x, bin_m)
    far_to_near = np.argsort(y)[::-1]
    nearest = np.full(int(beam.max()) + 1, -1)
    nearest[beam[far_to_near]] = far_to_near
    lit = nearest[nearest >= 0]
    # On a convex outline no lit point is farther than both of its neighbours: such a point is inside, or on a far side.
    depth = y[lit]
    keep = np.ones(len(lit), dtype=bool)
    keep[1:-1] = depth[1:-1] <= np.maximum(depth[:-2], depth[2:])
    kept: IntArray = lit[keep]
    return kept


def _line_candidates(moments: FloatArray, lit: IntArray) -> FloatArray:
    """Return candidate lines, shape (h, 3), one of which is likely to be a side.

    One line runs through all lit points (the paper's, for one lit side); two run through the lit points to the left and
    to the right of the nearest point, the corner (both sides of a corner face the light); and one runs perpendicular to
    the light (one side is hidden in a beam).
    """
    corner = int(moments[2, lit].argmin())
    parts = np.zeros((3, moments.shape[1]))
    parts[0, lit] = 1.0
    parts[1, lit[: corner + 1]] = 1.0
    parts[2, lit[corner:]] = 1.0
    through = [_two_lines(sums, _NO_POINTS)[1] for sums in (parts @ moments.T).tolist()]
    return np.array([*through, (-moments[2, lit[corner]], 0.0, 1.0)])


def _best_corner(lines: FloatArray, moments: FloatArray, tolerance: float, bar_bin_m: float) -> FloatArray:
    """Fit two orthogonal lines from each candidate, and return the points' distances from the best, shape (2, n)."""
    q, p = _line_and_bar(lines, moments, tolerance, bar_bin_m).astype(np.float64) @ moments.T
    fits = [_two_lines(*sums) for sums in zip(q.tolist(), p.tolist(), strict=True)]
    distances = _distances(np.array([[fit[1] for fit in fits], [fit[2] for fit in fits]]), moments)
    # A point on neither line costs the same wherever it is, so points inside the vehicle have no influence.
    cost = (np.minimum(np.minimum(distances[0], distances[1]), tolerance) ** 2).sum(axis=1)
    best: FloatArray = distances[:, int(cost.argmin())]
    return best


def _line_and_bar(lines: FloatArray, moments: FloatArray, tolerance: float, bar_bin_m: float) -> BoolArray:
    """Return which points are on each line (Q) and on the bar perpendicular to it (P), shape (2, h, n).

    Points on the line are not part of the bar, so an I shape has no bar. Where several bins have similar counts, the
    paper uses Q alone; here the bar is kept, since either end of a box shape is perpendicular to the line and
    stabilises it.
    """
    on_line = _distances(lines, moments) <= tolerance
    # The normal (n_x, n_y) belongs to the direction (n_y, -n_x).
    along = (lines[:, 2:0:-1] * (1.0, -1.0)) @ moments[1:3]
    bins = _bins(along, max(bar_bin_m, tolerance))
    n_bins = int(bins.max()) + 1
    first = np.arange(0, len(lines) * n_bins, n_bins)
    bins += first[:, None]
    counts = np.bincount(bins[~on_line], minlength=len(lines) * n_bins).reshape(len(lines), n_bins)
    densest = first + counts.argmax(axis=1)
    return np.stack([on_line, (bins == densest[:, None]) & ~on_line])


def _two_lines(q: _Sums, p: _Sums) -> tuple[float, _Line, _Line]:
    """Fit two orthogonal lines; return the direction of the first in radians, then both lines.

    Paper section III-C. A row of A is (1, 0, x, y) for a point of Q and (0, 1, y, -x) for one of P, so that M11 is
    diagonal and M22 - M12^T M11^-1 M12 is the scatter matrix of Q plus that of P rotated by 90 deg. The eigenvector
    alpha of its smallest eigenvalue has a closed form, and the lines' offsets are c = -M11^-1 M12 alpha.
    """
    q_x, q_y, q_xx, q_xy, q_yy = _scatter(q)
    p_x, p_y, p_xx, p_xy, p_yy = _scatter(p)
    yaw = 0.5 * math.atan2(2.0 * (q_xy - p_xy), (q_xx - q_yy) - (p_xx - p_yy))
    c, s = math.cos(yaw), math.sin(yaw)
    return yaw, (q_x * s - q_y * c, -s, c), (-p_x * c - p_y * s, c, s) if p[0] else _NOWHERE


def _scatter(sums: _Sums) -> tuple[float, float, float, float, float]:
    """Return the means of x and y and the centred sums of x x, x y and y y; all are 0 if there are no points."""
    n, x, y, xx, xy, yy = sums
    mean_x, mean_y = (x / n, y / n) if n else (0.0, 0.0)
    return mean_x, mean_y, xx - x * mean_x, xy - x * mean_y, yy - y * mean_y


def _distances(lines: FloatArray, moments: FloatArray) -> FloatArray:
    """Return the distances of the points from lines of shape (..., 3), shape (..., n)."""
    return np.abs(lines @ moments[:3])


def _residual(distances: FloatArray, tolerance: float) -> float:
    """Return the root mean square of the distances, shape (n,), that lie within the tolerance."""
    near = distances[distances <= tolerance]
    return math.sqrt(near @ near / max(len(near), 1))


def _settle(distances: FloatArray, moments: FloatArray, tolerance: float) -> float:
    """Narrow the tolerance to the points' own dispersion, which excludes points inside; return the yaw of the sides."""
    yaw = 0.0
    for _ in range(_NARROWINGS):
        nearest = np.minimum(distances[0], distances[1])
        tolerance = min(tolerance, _KEPT_SIGMAS * _residual(nearest, tolerance))
        members = distances <= np.minimum(nearest, tolerance)
        q, p = (members.astype(np.float64) @ moments.T).tolist()
        yaw, *lines = _two_lines(q, p)
        distances = _distances(np.array(lines), moments)
    return yaw


def _bounding_box(points: FloatArray, yaw_rad: float) -> Box:
    """Return the box of points, shape (2, n), whose sides lie along and across the yaw."""
    turned = _turned(-yaw_rad) @ points
    low, high = turned.min(axis=1), turned.max(axis=1)
    along, across = (high - low).tolist()
    centre = _turned(yaw_rad) @ ((low + high) / 2)
    longer_rad = yaw_rad if along >= across else yaw_rad + math.pi / 2
    return Box(centre, max(along, across), min(along, across), math.remainder(longer_rad, math.pi))
