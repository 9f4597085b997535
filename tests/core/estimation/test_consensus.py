from __future__ import annotations

import numpy as np
import pytest

from laci_stereo.core.estimation.consensus import Estimates, uncorrelated
from laci_stereo.core.frames import FloatArray

COUNT, EVERYONE = 4, range(4)


def related(rng: np.random.Generator) -> FloatArray:
    """Return a covariance by which estimates err alike in part, shape (4, 3, 4, 3)."""
    own = np.kron(np.eye(COUNT), np.ones((3, 3))) * rng.normal(size=(3 * COUNT, 3 * COUNT))
    common = rng.normal(size=(3 * COUNT, 2))
    covariance: FloatArray = (own @ own.T + common @ common.T + 0.1 * np.eye(3 * COUNT)).reshape(COUNT, 3, COUNT, 3)
    return covariance


def drawn(covariance: FloatArray, rng: np.random.Generator, draws: int) -> list[Estimates]:
    root = np.linalg.cholesky(covariance.reshape(3 * COUNT, -1))
    return [Estimates((root @ rng.normal(size=3 * COUNT)).reshape(COUNT, 3), covariance) for _ in range(draws)]


def test_the_weighted_mean_errs_as_it_says() -> None:
    rng = np.random.default_rng(5)
    made = [each.mean(EVERYONE) for each in drawn(related(rng), rng, 4000)]
    scatter = np.cov(np.array([mean for mean, _ in made]).T)
    assert scatter == pytest.approx(made[0][1], rel=0.15, abs=0.02 * float(np.trace(made[0][1])))


def test_estimates_that_err_alike_differ_as_they_say() -> None:
    rng = np.random.default_rng(6)
    made = drawn(related(rng), rng, 4000)
    assert np.mean([each.chance(EVERYONE) < 0.01 for each in made]) == pytest.approx(0.01, abs=0.005)
    assert np.mean([each.difference([0, 2], [1])[1] ** 2 for each in made]) == pytest.approx(3.0, rel=0.06)
    assert np.mean([each.distances(EVERYONE) ** 2 for each in made], axis=0) == pytest.approx(3.0, rel=0.06)


def test_an_estimate_is_as_far_from_the_others_as_chi_square_falls_without_it() -> None:
    rng = np.random.default_rng(7)
    (alike,) = drawn(related(rng), rng, 1)
    falls = [alike.chi_square(EVERYONE) - alike.chi_square([j for j in EVERYONE if j != i]) for i in EVERYONE]
    assert alike.distances(EVERYONE) ** 2 == pytest.approx(falls)
    own = Estimates(alike.values, uncorrelated(alike.covariance[EVERYONE, :, EVERYONE]))
    apart = [own.difference([i], [j for j in EVERYONE if j != i])[1] for i in EVERYONE]
    assert own.distances(EVERYONE) == pytest.approx(apart)
