from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from laci_stereo.core.estimation.mixture import Mixture, first_shares, weigh
from laci_stereo.core.frames import FloatArray


def settled(distance: FloatArray, sigma: float) -> Mixture:
    """Repeat the steps of expectation maximisation until the shares stand."""
    shares = first_shares(1)
    for _ in range(60):
        found = weigh(distance, np.full(len(distance), sigma), np.zeros(len(distance), dtype=np.int64), shares)
        shares = found.shares
    return found


def fitted(distance: FloatArray, sigma: float) -> float:
    """Return the place of the surface that is most likely."""
    at, shares = 0.0, first_shares(1)
    for _ in range(100):
        found = weigh(distance - at, np.full(len(distance), sigma), np.zeros(len(distance), dtype=np.int64), shares)
        at += sigma**2 * float(found.slope.mean()) / float(found.surface.mean())
        shares = found.shares
    return at


def drawn(sigma: float, behind: float, elsewhere: float, seed: int = 0, count: int = 20_000) -> FloatArray:
    rng = np.random.default_rng(seed)
    distance = sigma * rng.normal(size=count)
    kind = rng.random(count)
    distance = distance - np.where(kind < behind, rng.exponential(0.7, count), 0.0)
    lost = kind > 1 - elsewhere
    distance[lost] = rng.uniform(-2.5, 2.5, int(lost.sum()))
    return distance


@pytest.mark.parametrize(("behind", "elsewhere"), [(0.0, 0.02), (0.2, 0.05), (0.4, 0.1)])
def test_shares_and_depth_are_found(behind: float, elsewhere: float) -> None:
    found = settled(drawn(0.1, behind, elsewhere), 0.1)
    assert found.shares[0, 0] == pytest.approx(behind, abs=0.05)
    assert found.shares[0, 1] == pytest.approx(elsewhere, abs=0.04)
    if behind:
        assert found.shares[-1, 0] == pytest.approx(0.7, rel=0.2)


@pytest.mark.parametrize("sigma", [0.03, 0.1, 0.3])
@pytest.mark.parametrize("behind", [0.0, 0.2, 0.4])
def test_what_lies_behind_does_not_pull_the_surface(sigma: float, behind: float) -> None:
    distance = drawn(sigma, behind, 0.03)
    assert fitted(distance, sigma) == pytest.approx(0.0, abs=0.1 * sigma)
    if behind:  # which the mean and the median would suffer
        assert np.median(distance) < -0.15 * sigma


@given(st.floats(-3.0, 3.0), st.floats(0.01, 0.5), st.floats(0.05, 0.6), st.floats(0.01, 0.3), st.floats(0.05, 3.0))
def test_the_slope_is_the_derivative(d: float, sigma: float, behind: float, elsewhere: float, depth: float) -> None:
    shares = np.array([[behind, elsewhere, 1.0], [depth, depth, depth]])
    group = np.zeros(1, dtype=np.int64)
    step = 1e-5 * sigma
    more, less = (weigh(np.array([d + s]), np.array([sigma]), group, shares).log_likelihood[0] for s in (step, -step))
    slope = weigh(np.array([d]), np.array([sigma]), group, shares).slope[0]
    assert slope == pytest.approx(-(more - less) / (2 * step), abs=1e-3 / sigma)


def test_groups_keep_their_own_shares_only_where_they_are_large() -> None:
    rng = np.random.default_rng(3)
    clean, dirty = 0.05 * rng.normal(size=500), 0.05 * rng.normal(size=500) - rng.exponential(0.7, 500)
    few = 0.05 * rng.normal(size=2)
    distance = np.concatenate([clean, dirty, few])
    group = np.repeat([0, 1, 2], [500, 500, 2])
    shares = first_shares(3)
    for _ in range(40):
        shares = weigh(distance, np.full(len(distance), 0.05), group, shares).shares
    assert shares[0, 0] < 0.1
    assert shares[1, 0] > 0.6
    assert shares[0, 0] < shares[2, 0] < shares[1, 0]


def test_noise_larger_than_told_does_not_pull_the_surface() -> None:
    rng = np.random.default_rng(5)
    distance = 0.3 * rng.normal(size=20_000)
    assert fitted(distance, 0.1) == pytest.approx(0.0, abs=0.5 * 0.1)
    assert settled(distance, 0.1).shares[0, 2] == pytest.approx(3.0, rel=0.1)


def test_what_points_have_in_common_tells_a_group_nothing_of_its_own() -> None:
    rng = np.random.default_rng(3)
    distance = np.concatenate([0.05 * rng.normal(size=500), 0.05 * rng.normal(size=500) - rng.exponential(0.7, 500)])
    group, sigma = np.repeat([0, 1], 500), np.full(1000, 0.05)
    apart = []
    for worth in (1.0, 4.0 / 500):
        shares = first_shares(2)
        for _ in range(40):
            shares = weigh(distance, sigma, group, shares, np.full(1000, worth)).shares
        apart.append(float(shares[1, 0] - shares[0, 0]))
    assert apart[0] > 0.5
    assert apart[1] < 0.2
