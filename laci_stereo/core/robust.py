"""What strays: how far it may, and medians, which it does not move."""

from __future__ import annotations

import numpy as np

from laci_stereo.core.frames import FloatArray

NORMAL = 1.4826
"""Standard deviation of normal noise over the median of its size."""

TAIL = 4.0
"""So many sigma are what tolerances allow; what is beyond is a mistake, and as likely large as small."""


def weighted_median(values: FloatArray, weight: FloatArray) -> float:
    """Return the value, of some of shape (n,), up to which the smallest ones have half of all the weight."""
    order = np.argsort(values)
    share = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(share, share[-1] / 2)])
