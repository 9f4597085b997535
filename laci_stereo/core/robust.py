"""Outliers: the limit beyond which values count as such, and robust statistics, which they do not affect."""

from __future__ import annotations

import numpy as np

from laci_stereo.core.frames import FloatArray

NORMAL = 1.4826
"""Ratio of the standard deviation of normal noise to the median of its absolute value."""

TAIL = 4.0
"""Number of standard deviations that tolerances allow; what is beyond is a mistake, of any size."""

TUKEY = 4.685
"""Tuning constant of Tukey's biweight in standard deviations, for 95 % efficiency on normal noise."""

STUDENT = 4.0
"""Degrees of freedom of Student's t, with which one value in twenty may be an outlier."""


def weighted_median(values: FloatArray, weight: FloatArray) -> float:
    """Return the weighted median of values, shape (n,): those up to it have half of the total weight."""
    order = np.argsort(values)
    share = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(share, share[-1] / 2)])
