"""What a pass rules out, it rules out in every direction."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from laci_stereo.check.fit import PlanarError
from laci_stereo.check.verdict import ERROR_RATE, TOO_FAR_M, Evidence, judge
from laci_stereo.core.frames import FloatArray

FOUND = Evidence(in_view=16, found=12, rival=0.0)
LOOSE = np.diag([0.5**2, 0.5**2, 0.01**2])


def measured(shift_m: FloatArray, covariance: FloatArray) -> PlanarError:
    whole = np.diag([0.0, 0.0, np.radians(0.05) ** 2])
    whole[:2, :2] = covariance
    return PlanarError(np.zeros(2), np.append(shift_m, 0.0), whole, LOOSE)


def turned(by_rad: float) -> FloatArray:
    return np.array([[np.cos(by_rad), -np.sin(by_rad)], [np.sin(by_rad), np.cos(by_rad)]])


@pytest.mark.parametrize("towards_deg", range(0, 180, 15))
@pytest.mark.parametrize(("shift_m", "outcome"), [(0.19, "pass"), (0.22, "cannot tell"), (0.29, "cannot tell")])
def test_a_shift_is_judged_alike_in_all_directions(towards_deg: float, shift_m: float, outcome: str) -> None:
    ahead = turned(np.radians(towards_deg)) @ np.array([shift_m, 0.0])
    assert judge(FOUND, measured(ahead, 0.045**2 * np.diag([1.0, 1.01]))).outcome == outcome


@pytest.mark.parametrize("seed", range(50))
def test_a_pass_is_seldom_wrong_in_any_direction(seed: int) -> None:
    rng = np.random.default_rng(seed)
    axes = turned(rng.uniform(0.0, np.pi))
    covariance = axes @ np.diag(rng.uniform(0.01, 0.12, 2) ** 2) @ axes.T
    shift_m = turned(rng.uniform(0.0, 2.0 * np.pi)) @ np.array([rng.uniform(0.0, 0.3), 0.0])
    directions = np.array([turned(angle)[:, 0] for angle in np.linspace(0.0, np.pi, 37)])
    beyond = TOO_FAR_M - np.abs(directions @ shift_m)
    sigma = np.sqrt(np.einsum("ij,jk,ik->i", directions, covariance, directions))
    worst = float(ndtr(-beyond / sigma).max())
    found = judge(FOUND, measured(shift_m, covariance))
    assert (found.outcome == "pass") == (worst <= ERROR_RATE) or abs(worst - ERROR_RATE) < 1e-3
    if found.outcome == "cannot tell":
        assert "is not ruled out: the lines say" in found.reasons[0]
