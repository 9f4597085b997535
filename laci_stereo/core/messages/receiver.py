"""How a satellite receiver's positions err, and for how long alike."""

from __future__ import annotations

import numpy as np

from laci_stereo.core.frames import FloatArray
from laci_stereo.core.settings import JointSettings

KNOTS_PER_TIME = 4
"""Knots of an error's course in the time, or on the way, over which it decays."""

ALIKE = 0.5
"""Of the variance of two receivers' errors at one time, and of one receiver's here and there. Satellites' orbits and
clocks and the air above are the same for both, what walls reflect is not: the former is most of it without corrections,
the latter with them. With half, no number of receivers is taken for better than it is by more than the square root of
two."""

FINEST_M = 0.01
"""No position is better than that: its last digit in the message is a centimetre."""


def position_sigma_m(told_m: float, settings: JointSettings) -> float:
    """Return how exact positions are, as messages tell, or as the settings say where they do not: NaN."""
    return max(told_m, FINEST_M) if np.isfinite(told_m) else settings.position_sigma_m


def decay(stamps_s: FloatArray, way_m: FloatArray, settings: JointSettings) -> FloatArray:
    """Return how one receiver's errors at some times and places of its way, shape (k,), are correlated, shape (k, k).

    All of an error changes with the time; what walls reflect also with the way, and while it stands no faster.
    """
    reflected = (1.0 - ALIKE) * np.exp(-np.abs(way_m[:, None] - way_m) / settings.bias_way_m)
    correlation: FloatArray = in_time(stamps_s, settings) * (ALIKE + reflected)
    return correlation


def in_time(stamps_s: FloatArray, settings: JointSettings) -> FloatArray:
    """Return how errors at some times, shape (k,), are correlated by these alone, shape (k, k)."""
    correlation: FloatArray = np.exp(-np.abs(stamps_s[:, None] - stamps_s) / settings.bias_time_s)
    return correlation
