"""What frames and points have in common: by that many of them tell no more than a few."""

from __future__ import annotations

import numpy as np

from laci_stereo.core.estimation.evidence import SAME_VIEW_M, Evidence
from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.robust import NORMAL, TAIL, weighted_median

SAME_ERROR_M = 10.0
"""A matcher errs by texture, by gloss and by what is behind an edge, and so alike until the vehicle is seen from
elsewhere: 20 m from the camera it has turned by 30 deg after so much of its way."""

SAME_BORDER_M = 5.0
"""Half of what a border is seen in the wrong place by is the body's texture beside it, and lasts as long; the other
half is what is behind it, which is another thing after each window."""

FOLLOWED, LEAST_TELLING = 1.5, 0.25
"""Of the independent errors of boxes along each of two axes, so many are taken for the sensor's yaw and position. Of
two each, one of four is left to tell how large they are, and fewer are not taken to tell less."""


def course_of(distances: FloatArray, way_m: FloatArray, worth: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return of boxes' errors on each axis the variance, shape (2,), and what share of it lasts from frame to frame.

    Parameters
    ----------
    distances : ndarray, shape (2, m)
        Metres.
    way_m, worth : ndarray, shape (m,)
        Where on the way; how much each tells.
    """
    if len(worth) < 3:
        return np.zeros(2), np.ones(2)
    between = np.minimum(worth[1:], worth[:-1])
    centred = distances - np.average(distances, axis=1, weights=worth)[:, None]
    scatter = np.array([_variance(each, worth) for each in centred])
    steps = np.array([_variance(np.diff(each), between) for each in distances]) / 2.0
    # A step has so much of what lasts, and the scatter lacks as much of it as the fit has followed.
    newer = 1.0 - float(np.average(np.exp(-np.diff(way_m) / SAME_ERROR_M), weights=between))
    left = max(1.0 - FOLLOWED / float(worth.sum()) - newer, LEAST_TELLING)
    # A few independent errors tell their variance badly; so those along and across do it together.
    lasting = float(np.maximum(scatter - steps, 0.0).mean()) / left
    variance = lasting + np.maximum(steps - newer * lasting, 0.0)
    return variance, lasting / np.maximum(variance, 1e-12)


def _variance(errors: FloatArray, weight: FloatArray) -> float:
    """Return the mean square, shape (), of errors about 0; what is a mistake counts as if at the edge of tolerances."""
    most = (TAIL * NORMAL * weighted_median(np.abs(errors), weight)) ** 2
    return float(np.average(np.minimum(errors**2, most), weights=weight))


def worth_of(drive: Evidence, alike_m: float) -> FloatArray:
    """Return how much each frame tells, shape (m,): those in which the vehicle is at one place show the same.

    Each shares what it shows with those nearer than ``alike_m`` along the way, the more the nearer they are.
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
    """Return which frames, shape (m,), say one thing together: those of one time, and of all in which it stands."""
    seconds = (drive.stamps_s - drive.stamps_s[:1]) // block_s
    first, own = np.unique(seconds, return_index=True, return_inverse=True)[1:]
    blocks: IntArray = (drive.way_m[first] // SAME_VIEW_M).astype(np.int64)[own.reshape(-1)]
    return blocks


def mean_overlap(extent: FloatArray) -> FloatArray:
    """Return by how much two windows overlap that begin anywhere along some extents, in windows, on average.

    The mean of max(0, 1 - |s - t|) over s and t from 0 to an extent e: 1 - e / 3, and beyond one window
    1 / e - 1 / (3 e^2).
    """
    within = np.minimum(extent, 1.0)
    beyond = np.maximum(extent, 1.0)
    overlap: FloatArray = np.where(extent < 1.0, 1.0 - within / 3.0, (1.0 - 1.0 / (3.0 * beyond)) / beyond)
    return overlap
