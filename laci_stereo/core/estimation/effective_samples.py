"""Effective sample sizes: frames and points with correlated errors carry the information of a few independent ones."""

from __future__ import annotations

import numpy as np

from laci_stereo.core.estimation.evidence import SAME_VIEW_M, Evidence
from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.robust import NORMAL, TAIL, weighted_median

SAME_ERROR_M = 10.0
"""Correlation length of matching errors along the path: they depend on texture, specular reflection and what is behind
an edge, and stay alike until the vehicle is seen from elsewhere. At 20 m from the camera, its aspect has rotated by 30
deg after this distance."""

SAME_BORDER_M = 5.0
"""Correlation length of the errors of borders along the path: half of their variance is due to the body's texture
beside the border and lasts as long as the matching errors; the other half is due to what is behind it, which differs
after each window."""

FOLLOWED, LEAST_TELLING = 1.5, 0.25
"""Number of independent errors of boxes on each of two axes that the estimate of the sensor's yaw and position has
absorbed, and the least fraction that is assumed to be left. With two independent errors on each axis, one of four is
left to estimate their variance; with fewer, the fraction is not reduced further."""


def course_of(distances: FloatArray, way_m: FloatArray, worth: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the variance of boxes' errors on each axis, and the fraction that persists from frame to frame, (2,) each.

    Parameters
    ----------
    distances : ndarray, shape (2, m)
        Errors along both axes, metres.
    way_m, worth : ndarray, shape (m,)
        Distance travelled, metres, and effective number of independent frames that each frame counts as.
    """
    if len(worth) < 3:
        return np.zeros(2), np.ones(2)
    between = np.minimum(worth[1:], worth[:-1])
    centred = distances - np.average(distances, axis=1, weights=worth)[:, None]
    scatter = np.array([_variance(each, worth) for each in centred])
    steps = np.array([_variance(np.diff(each), between) for each in distances]) / 2.0
    # A step contains this fraction of the persistent variance, and the dispersion lacks the fraction that the fit
    # absorbed.
    newer = 1.0 - float(np.average(np.exp(-np.diff(way_m) / SAME_ERROR_M), weights=between))
    left = max(1.0 - FOLLOWED / float(worth.sum()) - newer, LEAST_TELLING)
    # A few independent errors determine their variance poorly; it is therefore averaged over both axes.
    lasting = float(np.maximum(scatter - steps, 0.0).mean()) / left
    variance = lasting + np.maximum(steps - newer * lasting, 0.0)
    return variance, lasting / np.maximum(variance, 1e-12)


def _variance(errors: FloatArray, weight: FloatArray) -> float:
    """Return the mean square of errors about 0; outliers count as if they were at the limit of the tolerances."""
    most = (TAIL * NORMAL * weighted_median(np.abs(errors), weight)) ** 2
    return float(np.average(np.minimum(errors**2, most), weights=weight))


def worth_of(drive: Evidence, alike_m: float) -> FloatArray:
    """Return the effective number of independent frames that each frame counts as, shape (m,).

    Frames in which the vehicle is at one place show the same. Each frame is correlated with those nearer than
    ``alike_m`` along the path, the more the nearer they are.
    """
    if not len(drive):
        return np.ones(0)
    way = drive.way_m / alike_m
    total = np.append(0.0, np.cumsum(way))
    first, last, own = np.searchsorted(way, way - 1.0), np.searchsorted(way, way + 1.0), np.arange(len(way))
    before = (own - first) * (1.0 - way) + total[own] - total[first]
    after = (last - own) * (1.0 + way) - total[last] + total[own]
    worth: FloatArray = 1.0 / (before + after)
    return worth


def blocks_of(drive: Evidence, block_s: float) -> IntArray:
    """Return each frame's block, shape (m,): an interval of time, and all frames in which the vehicle is stationary."""
    seconds = (drive.stamps_s - drive.stamps_s[:1]) // block_s
    first, own = np.unique(seconds, return_index=True, return_inverse=True)[1:]
    blocks: IntArray = (drive.way_m[first] // SAME_VIEW_M).astype(np.int64)[own.reshape(-1)]
    return blocks


def mean_overlap(extent: FloatArray) -> FloatArray:
    """Return the mean overlap of two windows that begin anywhere along an extent, as a fraction of a window.

    The extents are in windows. The mean of max(0, 1 - |s - t|) over s and t from 0 to an extent e is 1 - e / 3, and
    beyond one window 1 / e - 1 / (3 e^2).
    """
    within = np.minimum(extent, 1.0)
    beyond = np.maximum(extent, 1.0)
    overlap: FloatArray = np.where(extent < 1.0, 1.0 - within / 3.0, (1.0 - 1.0 / (3.0 * beyond)) / beyond)
    return overlap
