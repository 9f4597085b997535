from __future__ import annotations

import numpy as np
import pytest

from laci_stereo.core.estimation.effective_samples import mean_overlap


def test_windows_overlap_on_average_by_their_mean() -> None:
    rng = np.random.default_rng(0)
    extents = np.array([0.0, 0.3, 1.0, 2.5, 20.0])
    for extent, overlap in zip(extents, mean_overlap(extents), strict=True):
        apart = np.abs(np.subtract(*(extent * rng.random((2, 100_000)))))
        assert overlap == pytest.approx(np.maximum(0.0, 1.0 - apart).mean(), abs=0.005)
