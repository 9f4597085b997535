"""Analysis of matched points under a stereo calibration."""

from __future__ import annotations

import numpy as np
import pytest

from laci_stereo.check.rig_parallax import measure
from laci_stereo.check.rig_points import Rectified
from laci_stereo.core.frames import FloatArray

PAIRS = 5


def seen(left: FloatArray, disparity_px: FloatArray) -> Rectified:
    """Points as a stationary camera matches them, alike in each pair."""
    rng = np.random.default_rng(2)
    left, disparity_px = np.tile(left, (PAIRS, 1)), np.tile(disparity_px, PAIRS)
    noise = 0.1 * rng.normal(size=left.shape)
    right = left - np.column_stack([disparity_px, np.zeros(len(left))]) + noise
    pair = np.repeat(np.arange(PAIRS), len(left) // PAIRS)
    unknown = np.full(left.shape, np.nan)
    return Rectified(left, right, unknown, unknown[:, 0], pair, 670.0, 0.5, np.array([400.0, 250.0]), (800, 500), 1)


@pytest.mark.parametrize(("off_px", "behind"), [(0.0, False), (-6.0, True)])
def test_one_mismatch_does_not_put_points_beyond_infinity(off_px: float, behind: bool) -> None:
    """It is found again in each pair, and the cell at the image's corner holds nothing else."""
    rng = np.random.default_rng(1)
    left = rng.uniform((100.0, 90.0), (800.0, 500.0), (800, 2))
    true_px = 0.1 * (left[:, 1] - 90.0)
    points = seen(np.append(left, [[30.0, 40.0], [50.0, 20.0]], axis=0), np.append(true_px, [-2.0, -2.5]) + off_px)
    assert (measure(points).behind_px > 1.0) == behind
