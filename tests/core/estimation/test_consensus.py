from __future__ import annotations

import numpy as np
import pytest

from laci_stereo.core.estimation.consensus import weighted_mean


def test_the_weighted_mean_errs_as_it_says() -> None:
    rng = np.random.default_rng(5)
    roots = rng.normal(size=(4, 3, 3))
    covariances = roots @ roots.transpose(0, 2, 1) + 0.1 * np.eye(3)
    cholesky = np.linalg.cholesky(covariances)
    means = [
        weighted_mean(np.einsum("nij,nj->ni", cholesky, rng.normal(size=(4, 3))), covariances) for _ in range(4000)
    ]
    scatter = np.cov(np.array([mean for mean, _ in means]).T)
    assert scatter == pytest.approx(means[0][1], rel=0.15, abs=0.02 * float(np.trace(means[0][1])))
