from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.estimation.drive_model import DriveModel
from laci_stereo.core.estimation.recordings import CLOCK_S, SAME, SENDER_S, SENDER_SHARE, Recordings
from laci_stereo.core.messages.receiver import ALIKE
from laci_stereo.core.settings import JointSettings
from tests.core.outlines import STRAIGHT, evidence
from tests.simulated import Drive

SETTINGS = JointSettings()
ONE, OTHER = 42, 43
FAR_S = 30 * 86_400.0


def model(begin_s: float = 0.0, sigma_m: float = 0.02, drive: Drive = STRAIGHT) -> DriveModel:
    """Return the model of a drive whose recording begins then."""
    seen = evidence(drive)
    vehicle = replace(seen.vehicle, epoch_ns=1_700_000_000_000_000_000 + round(1e9 * begin_s), position_sigma_m=sigma_m)
    return DriveModel(replace(seen, vehicle=vehicle), np.zeros(2), SETTINGS)


def clocks(stations: Sequence[int], begins_s: Sequence[float], sigma_s: float) -> np.ndarray:
    models = [model(begin_s) for begin_s in begins_s]
    return np.linalg.inv(Recordings(models, stations).clocks(np.full(len(models), sigma_s**-2)))


def drifts(stations: Sequence[int], models: Sequence[DriveModel]) -> np.ndarray:
    return np.linalg.inv(Recordings(models, stations).drifts(SETTINGS))


@pytest.mark.parametrize("sigma_s", [0.001, 0.01, 1.0])
def test_the_sensors_clock_is_common_to_a_recording_and_each_sender_stamps_by_itself(sigma_s: float) -> None:
    covariance = clocks([1, 2, 3], [0.0, FAR_S, 0.0], sigma_s)
    own_s = min(SENDER_S, SENDER_SHARE * sigma_s)
    assert np.diag(covariance) == pytest.approx(sigma_s**2)
    assert covariance[0, 0] + covariance[2, 2] - 2 * covariance[0, 2] == pytest.approx(2 * own_s**2, rel=1e-3)
    assert covariance[1, [0, 2]] == pytest.approx(0.0)


@pytest.mark.parametrize("sigma_s", [0.001, 0.01, 1.0])
def test_of_one_sender_the_clocks_are_as_far_apart_a_moment_later_and_on_another_day_but_for_the_sensors(
    sigma_s: float,
) -> None:
    covariance = clocks([ONE] * 3, [0.0, 5.0, FAR_S], sigma_s)
    own_s = min(SENDER_S, SENDER_SHARE * sigma_s)
    apart_s2 = covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1]
    assert apart_s2 == pytest.approx(
        2 * (1 - SAME) * own_s**2 + (sigma_s**2 - own_s**2) * (5.0 / CLOCK_S) ** 2, rel=1e-3
    )
    assert covariance[2, :2] == pytest.approx(SAME * own_s**2)


def test_receivers_err_alike_in_part_at_one_time_and_by_themselves_on_other_days() -> None:
    models = [model(0.0, 0.01), model(20.0, 0.3), model(FAR_S, 0.02)]
    covariance = drifts([1, 2, 3], models)
    own = np.repeat(range(3), [len(each.knots) for each in models])
    assert np.sqrt(np.diag(covariance)) == pytest.approx(np.array([0.01, 0.3, 0.02])[own])
    passed_s = np.abs(20.0 + models[1].knots.at_s - models[0].knots.at_s[:, None])
    between = ALIKE * 0.01 * 0.3 * np.exp(-passed_s / SETTINGS.bias_time_s)
    assert covariance[np.ix_(own == 0, own == 1)] == pytest.approx(between)
    assert covariance[np.ix_(own == 2, own != 2)] == pytest.approx(0.0)


def test_a_receiver_errs_alike_in_all_drives_of_one_day() -> None:
    """It goes on where it was: what is cut from one drive is as alike as its own parts are."""
    halves = [replace(STRAIGHT, start_s=0.0), replace(STRAIGHT, start_s=-30.0)]  # 210 m farther on
    one, other = model(0.0, 0.3, halves[0]), model(30.0, 0.3, halves[1])
    covariance = drifts([ONE, ONE], [one, other]) / 0.3**2
    from_end_to_begin = covariance[len(one.knots) - 1, len(one.knots)]
    way_m = float(np.linalg.norm(other.ends[0] - one.ends[1]))
    passed_s = 30.0 + other.knots.at_s[0] - one.knots.at_s[-1]
    decayed = ALIKE + (1.0 - ALIKE) * np.exp(-way_m / SETTINGS.bias_way_m)
    assert from_end_to_begin == pytest.approx(decayed * np.exp(-passed_s / SETTINGS.bias_time_s))
    assert drifts([ONE, OTHER], [one, other])[0, -1] < 0.3**2 * covariance[0, -1]


def test_drives_of_which_nothing_is_known_have_nothing_in_common() -> None:
    models = [model(), model()]
    recordings = Recordings(models)
    assert recordings.senders == pytest.approx(np.eye(2))
    assert recordings.clocks(np.array([4.0, 9.0])) == pytest.approx(np.diag([4.0, 9.0]))
    count = len(models[0].knots)
    assert recordings.drifts(SETTINGS)[:count, count:] == pytest.approx(0.0)
