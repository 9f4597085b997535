"""The errors of a satellite receiver's positions, and their correlation in time and along the path."""

from __future__ import annotations

import numpy as np

from laci_stereo.core.frames import FloatArray
from laci_stereo.core.settings import JointSettings

KNOTS_PER_TIME = 4
"""Number of knots of an error's course per correlation time, or per correlation length along the path."""

ALIKE = 0.5
"""Fraction of the variance that two receivers' errors share at one time, and one receiver's errors at two places.
Satellites' orbits and clocks and the atmosphere are common to both, multipath from walls is not: the former dominate
without corrections, the latter with them. With half, no number of receivers is taken to be more accurate than it is by
more than a factor of the square root of two."""

FINEST_M = 0.01
"""Least standard deviation of a position: the last digit in the message is a centimetre."""


def position_sigma_m(told_m: float, settings: JointSettings) -> float:
    """Return the standard deviation of positions that messages report, or that of the settings if they report NaN."""
    return max(told_m, FINEST_M) if np.isfinite(told_m) else settings.position_sigma_m


def decay(stamps_s: FloatArray, way_m: FloatArray, settings: JointSettings) -> FloatArray:
    """Return the correlation, shape (k, k), of one receiver's errors at times and distances travelled, shape (k,).

    The whole error changes with time. The multipath part also changes with the distance travelled, and no faster while
    the vehicle is stationary.
    """
    reflected = (1.0 - ALIKE) * np.exp(-np.abs(way_m[:, None] - way_m) / settings.bias_way_m)
    correlation: FloatArray = in_time(stamps_s, settings) * (ALIKE + reflected)
    return correlation


def in_time(stamps_s: FloatArray, settings: JointSettings) -> FloatArray:
    """Return the correlation of errors at k times, shape (k,), by time alone, shape (k, k)."""
    correlation: FloatArray = np.exp(-np.abs(stamps_s[:, None] - stamps_s) / settings.bias_time_s)
    return correlation
