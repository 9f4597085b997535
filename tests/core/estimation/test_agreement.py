from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.errors import CombineError
from laci_stereo.core.estimation.agreement import LeftOut, agreeing, estimates_of
from laci_stereo.core.estimation.consensus import Estimates
from laci_stereo.core.estimation.joint import JointFit, fit_jointly
from laci_stereo.core.estimation.recordings import SENDER_S
from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.settings import JointSettings
from tests.core.outlines import STRAIGHT, TRUTH, evidence
from tests.simulated import Drive

YAW = 3.1  # so that noise carries some across the seam of angles
PLACE = np.array([12.0, -3.0])


def fit(error: FloatArray, covariance: FloatArray, centre: FloatArray) -> JointFit:
    """Return an estimate that is wrong by (yaw, x, y) at its centre; the truth leaves `PLACE` of the world at zero."""
    yaw = float(np.angle(np.exp(1j * (YAW + error[0]))))
    shift = PLACE + rotate_xy(YAW, centre) + error[1:] - rotate_xy(yaw, centre)
    return JointFit(PlanarMatch(yaw, shift), (0.0,), covariance, centre, (0.0,), ((),), 0.0, 30, 1.0)


def drawn(count: int, rng: np.random.Generator, scales: Sequence[float] | None = None) -> list[JointFit]:
    made = []
    for i in range(count):
        root = np.diag([0.01, 0.05, 0.05]) @ (np.eye(3) + 0.3 * rng.normal(size=(3, 3)))
        root *= 1.0 if scales is None else scales[i]
        made.append(fit(root @ rng.normal(size=3), root @ root.T, rng.uniform(-20.0, 20.0, 2)))
    return made


def independent(fits: Sequence[JointFit]) -> Estimates:
    return estimates_of(fits, range(len(fits)))


def agreed(fits: Sequence[JointFit]) -> tuple[list[int], tuple[LeftOut, ...]]:
    return agreeing([f"run {i}" for i in range(len(fits))], independent(fits))


def test_drives_that_err_as_they_say_agree() -> None:
    rng = np.random.default_rng(0)
    for _ in range(300):
        count = int(rng.integers(2, 8))
        kept, left_out = agreed(drawn(count, rng))
        # One of a thousand times a drive is left out by chance.
        assert kept == list(range(count))
        assert left_out == ()


def test_those_that_are_wrong_are_left_out_whichever_they_are() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        fits = drawn(7, rng)
        wrong = sorted(rng.choice(7, 2, replace=False).tolist())
        for i, east in zip(wrong, (1.5, -1.2), strict=True):
            fits[i] = fit(np.array([0.0, east, 0.0]), fits[i].covariance, fits[i].centre_level)
        kept, left_out = agreed(fits)
        assert [each.name for each in left_out] == [f"run {i}" for i in wrong]
        assert len(kept) == left_out[0].others == 5
        assert min(each.sigmas for each in left_out) > 4.0


def test_a_vague_drive_cannot_tell_which_of_two_sharp_ones_is_wrong() -> None:
    rng = np.random.default_rng(2)
    fits = drawn(3, rng, (0.2, 0.2, 20.0))
    fits[1] = fit(np.array([0.0, 0.5, 0.0]), fits[1].covariance, fits[1].centre_level)
    with pytest.raises(CombineError, match=r"run [01] and run [01] contradict each other"):
        agreed(fits)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_no_majority_is_no_agreement(count: int) -> None:
    rng = np.random.default_rng(3)
    fits = [
        fit(np.array([0.0, 3.0 * i, 0.0]), one.covariance, one.centre_level) for i, one in enumerate(drawn(count, rng))
    ]
    with pytest.raises(CombineError, match=f"no majority of the {count} drives \\(run 0, run 1"):
        agreed(fits)


def moved(one: JointFit, east_m: float) -> JointFit:
    return replace(one, match=PlanarMatch(one.match.yaw_rad, one.match.shift + np.array([east_m, 0.0])))


def test_of_two_groups_that_agree_the_larger_one_need_not_be_right() -> None:
    rng = np.random.default_rng(6)
    for alike in (3, 4):
        fits = [moved(one, 0.6 if i < alike else 0.0) for i, one in enumerate(drawn(10, rng, [0.3] * 10))]
        with pytest.raises(CombineError, match=r"agree in two groups, 0\.\d\d m and .*: run \d.*; or run \d"):
            agreed(fits[: 5 + alike])
    fits = [moved(one, 0.6 if i < 2 else 0.0) for i, one in enumerate(drawn(10, rng, [0.3] * 10))]
    kept, left_out = agreed(fits)
    assert kept == list(range(2, 10))
    assert all(each.shift_m == pytest.approx(0.6, abs=0.1) for each in left_out)


def test_vague_drives_do_not_make_sharp_ones_that_are_wrong_alike_a_majority() -> None:
    rng = np.random.default_rng(7)
    for _ in range(20):
        fits = drawn(10, rng, [0.3] * 7 + [1.5] * 3)
        fits = [moved(one, 0.35 if i < 4 else 0.0) for i, one in enumerate(fits)]
        with pytest.raises(CombineError, match="the drives agree in two groups"):
            agreed(fits)


@pytest.mark.parametrize("larger", [1.0, 2.0])
def test_drives_that_differ_more_than_they_say_are_less_certain_by_as_much(larger: float) -> None:
    rng = np.random.default_rng(8)
    made = []
    for _ in range(200):
        fits = drawn(6, rng)
        wider = [replace(one, covariance=one.covariance / larger**2) for one in fits]
        made.append((independent(wider).excess(range(6)), independent(wider).chance(range(6))))
    excesses, chances = np.array(made).T
    assert excesses.min() >= 1.0
    assert np.median(excesses) == pytest.approx(larger**2, rel=0.1)
    if larger == 1.0:
        assert np.mean(chances < 0.1) == pytest.approx(0.1, abs=0.05)


def test_one_drive_agrees_with_itself() -> None:
    assert agreed(drawn(1, np.random.default_rng(4))) == ([0], ())


@pytest.mark.parametrize(
    "other",
    [replace(STRAIGHT, start=(-17.0, 31.7)), replace(STRAIGHT, start=(0.0, -4.0), yaw_deg=120.0)],
    ids=["the same way", "the other way"],
)
def test_a_clock_that_senders_share_parts_them_only_if_they_go_different_ways(other: Drive) -> None:
    """And it parts them by as much as it moves both, which is more than if each had such a clock of its own."""
    settings, along = JointSettings(clock_sigma_s=0.03), rotate_xy(np.radians(-60.0), np.array([1.0, 0.0]))
    late_s = float(np.sqrt(settings.clock_sigma_s**2 - SENDER_S**2))
    seen = [evidence(drive, offset_s=late_s, per_frame=10) for drive in (STRAIGHT, other)]
    alone = [fit_jointly([each], TRUTH, settings=settings, close=True, mistakes=False) for each in seen]
    estimates = estimates_of(alone, [1, 2])
    (one, both), (_, other_one) = estimates.covariance[0].transpose(1, 0, 2), estimates.covariance[1].transpose(1, 0, 2)
    apart_m = abs(float(along @ (estimates.values[1] - estimates.values[0])[1:]))
    sigma_m = float(np.sqrt(along @ (one + other_one - both - both.T)[1:, 1:] @ along))
    assert apart_m == pytest.approx(2.0 * 7.0 * late_s if other.yaw_deg > 0.0 else 0.0, abs=0.03)
    assert apart_m < sigma_m < np.hypot(apart_m, 0.15)  # the vehicles, and how each sender stamps
