"""Conversion from a sensor's own axes to x forward, y left, z up."""

from __future__ import annotations

import numpy as np

from laci_stereo.core.frames import Axes, FloatArray


def forward_left_up(axes: Axes) -> FloatArray:
    """Return the rotation, shape (3, 3), from the sensor frame to x forward, y left, z up.

    If the two axes are not exactly perpendicular, up is kept.
    """
    up = np.asarray(axes.up, dtype=np.float64)
    up /= np.linalg.norm(up)
    left = np.cross(up, np.asarray(axes.forward, dtype=np.float64))
    left /= np.linalg.norm(left)
    return np.stack([np.cross(left, up), left, up])
