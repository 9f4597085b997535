from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from laci_stereo.core.errors import CombineError
from laci_stereo.core.estimation.agreement import agreeing, weighted_mean
from laci_stereo.core.estimation.joint import JointFit
from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.matching import PlanarMatch

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


def names(count: int) -> list[str]:
    return [f"run {i}" for i in range(count)]


def test_drives_that_err_as_they_say_agree() -> None:
    rng = np.random.default_rng(0)
    for _ in range(300):
        count = int(rng.integers(2, 8))
        kept, left_out = agreeing(names(count), drawn(count, rng))
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
        kept, left_out = agreeing(names(7), fits)
        assert [each.name for each in left_out] == [f"run {i}" for i in wrong]
        assert len(kept) == left_out[0].others == 5
        assert min(each.sigmas for each in left_out) > 4.0


def test_a_vague_drive_cannot_tell_which_of_two_sharp_ones_is_wrong() -> None:
    rng = np.random.default_rng(2)
    fits = drawn(3, rng, (0.2, 0.2, 20.0))
    fits[1] = fit(np.array([0.0, 0.5, 0.0]), fits[1].covariance, fits[1].centre_level)
    with pytest.raises(CombineError, match=r"run [01] and run [01] contradict each other"):
        agreeing(names(3), fits)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_no_majority_is_no_agreement(count: int) -> None:
    rng = np.random.default_rng(3)
    fits = [
        fit(np.array([0.0, 3.0 * i, 0.0]), one.covariance, one.centre_level) for i, one in enumerate(drawn(count, rng))
    ]
    with pytest.raises(CombineError, match=f"no majority of the {count} drives \\(run 0, run 1"):
        agreeing(names(count), fits)


def test_one_drive_agrees_with_itself() -> None:
    assert agreeing(["run"], drawn(1, np.random.default_rng(4))) == ([0], ())


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
