"""Medians, which what strays does not move."""

from __future__ import annotations

import numpy as np

from laci_stereo.core.frames import FloatArray

NORMAL = 1.4826
"""Standard deviation of normal noise over the median of its size."""


def weighted_median(values: FloatArray, weight: FloatArray) -> float:
    """Return the value, of some of shape (n,), up to which the smallest ones have half of all the weight."""
    order = np.argsort(values)
    share = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(share, share[-1] / 2)])
