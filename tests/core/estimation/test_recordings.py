from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.estimation.drive_model import DriveModel
from laci_stereo.core.estimation.recordings import (
    CLOCK_S,
    LASTING_CLOCK,
    LASTING_PLACE,
    SAME,
    SAME_SIZE,
    SENDER_S,
    SENDER_SHARE,
    SENDERS,
    Recordings,
)
from laci_stereo.core.messages.receiver import ALIKE
from laci_stereo.core.settings import JointSettings
from tests.core.outlines import STRAIGHT, evidence
from tests.simulated import Drive

SETTINGS = JointSettings()
ONE, OTHER = 42, 43
FAR_S = 30 * 86_400.0


def model(
    begin_s: float = 0.0, sigma_m: float = 0.02, drive: Drive = STRAIGHT, length_m: float | None = None
) -> DriveModel:
    """Return the model of a drive whose recording begins then."""
    seen = evidence(drive)
    vehicle = replace(seen.vehicle, epoch_ns=1_700_000_000_000_000_000 + round(1e9 * begin_s), position_sigma_m=sigma_m)
    vehicle = replace(vehicle, length_m=length_m or vehicle.length_m)
    return DriveModel(replace(seen, vehicle=vehicle), np.zeros(2), SETTINGS)


def clocks(stations: Sequence[int], begins_s: Sequence[float], sigma_s: float) -> np.ndarray:
    models = [model(at_s, length_m=4.0 + 0.1 * one) for one, at_s in zip(stations, begins_s, strict=True)]
    return np.linalg.inv(Recordings(models, stations).clocks(np.full(len(models), sigma_s**-2)))


def drifts(stations: Sequence[int], models: Sequence[DriveModel]) -> np.ndarray:
    return np.linalg.inv(Recordings(models, stations).drifts(SETTINGS))


@pytest.mark.parametrize("sigma_s", [0.001, 0.01, 1.0])
def test_the_sensors_clock_is_common_to_a_recording_and_each_sender_stamps_by_itself(sigma_s: float) -> None:
    covariance = clocks([1, 2, 3], [0.0, FAR_S, 0.0], sigma_s)
    own_s = min(SENDER_S, SENDER_SHARE * sigma_s)
    assert np.diag(covariance) == pytest.approx(sigma_s**2)
    apart_s2 = covariance[0, 0] + covariance[2, 2] - 2 * covariance[0, 2]
    assert apart_s2 == pytest.approx(2 * (1 - SENDERS) * own_s**2, rel=1e-3)
    assert covariance[1, [0, 2]] == pytest.approx(LASTING_CLOCK * (sigma_s**2 - own_s**2) + SENDERS * own_s**2)


@pytest.mark.parametrize("sigma_s", [0.001, 0.01, 1.0])
def test_of_one_sender_the_clocks_are_as_far_apart_a_moment_later_and_on_another_day_but_for_the_sensors(
    sigma_s: float,
) -> None:
    covariance = clocks([ONE] * 3, [0.0, 5.0, FAR_S], sigma_s)
    own_s = min(SENDER_S, SENDER_SHARE * sigma_s)
    apart_s2 = covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1]
    assert apart_s2 == pytest.approx(
        2 * (1 - SAME) * own_s**2 + (1 - LASTING_CLOCK) * (sigma_s**2 - own_s**2) * (5.0 / CLOCK_S) ** 2, rel=1e-3
    )
    assert covariance[2, :2] == pytest.approx(SAME * own_s**2 + LASTING_CLOCK * (sigma_s**2 - own_s**2))


@pytest.mark.parametrize("guessed", [False, True])
def test_vehicles_of_one_size_may_be_one(guessed: bool) -> None:
    """A size that nobody reported tells nothing of it."""
    models = [model(length_m=length_m) for length_m in (4.5, 4.5, 4.6)]
    if guessed:
        for each in models:
            each.drive = replace(each.drive, vehicle=replace(each.drive.vehicle, guessed_m=(0.3, 0.1)))
    senders = Recordings(models, [1, 2, 3]).senders
    assert senders[0, 1] == (SENDERS if guessed else SAME_SIZE)
    assert senders[2, :2] == pytest.approx(SENDERS)
    assert Recordings(models, [1, 1, 3]).senders[0, 1] == SAME
    assert np.linalg.eigvalsh(senders).min() > 0.0


def test_a_width_that_was_corrected_for_mirrors_is_a_size_nevertheless() -> None:
    models = [model(length_m=4.5) for _ in range(2)]
    for each in models:
        each.drive = replace(each.drive, vehicle=replace(each.drive.vehicle, guessed_m=(0.0, 0.02)))
    assert Recordings(models, [1, 2]).senders[0, 1] == SAME_SIZE


def test_a_station_that_reports_two_sizes_is_alike_to_those_of_either() -> None:
    models = [model(length_m=length_m) for length_m in (6.9, 7.0, 6.9, 7.0, 4.5)]
    senders = Recordings(models, [1, 1, 2, 3, 4]).senders
    assert senders[0, 1] == SAME
    assert senders[np.ix_([0, 1], [2, 3])] == pytest.approx(SAME_SIZE)
    assert senders[4, :4] == pytest.approx(SENDERS)
    assert np.linalg.eigvalsh(senders).min() > 0.0


def test_the_clock_of_one_recording_is_one_unknown_whoever_sends() -> None:
    """A hundred times the prior is a hundred times the volume, and not that for each sender."""
    together = Recordings([model(length_m=4.0 + 0.1 * one) for one in range(3)], [1, 2, 3])
    apart = Recordings([model(FAR_S * one, length_m=4.0 + 0.1 * one) for one in range(3)], [1, 2, 3])
    alone = Recordings([model()], [1])
    wider = [each.log_clock_volume(1.0) - each.log_clock_volume(0.01) for each in (alone, together, apart)]
    assert wider[0] == pytest.approx(np.log(100.0))
    assert wider[0] <= wider[1] < 1.2 * wider[0]
    assert wider[2] == pytest.approx(3 * np.log(100.0), rel=0.1)


def test_no_number_of_drives_is_more_certain_than_what_they_have_in_common() -> None:
    models = [model(day * FAR_S, 0.3) for day in range(20)]
    mean = np.zeros(sum(len(each.knots) for each in models))
    mean[np.cumsum([0, *(len(each.knots) for each in models[:-1])])] = 1.0 / len(models)
    variance = mean @ drifts(range(20), models) @ mean
    assert variance == pytest.approx(0.3**2 * (LASTING_PLACE + (1.0 - LASTING_PLACE) / 20))


def test_receivers_err_alike_in_part_at_one_time_and_less_on_other_days() -> None:
    models = [model(0.0, 0.01), model(20.0, 0.3), model(FAR_S, 0.02)]
    covariance = drifts([1, 2, 3], models)
    own = np.repeat(range(3), [len(each.knots) for each in models])
    assert np.sqrt(np.diag(covariance)) == pytest.approx(np.array([0.01, 0.3, 0.02])[own])
    passed_s = np.abs(20.0 + models[1].knots.at_s - models[0].knots.at_s[:, None])
    passing = ALIKE * np.exp(-passed_s / SETTINGS.bias_time_s)
    between = 0.01 * 0.3 * (LASTING_PLACE + (1.0 - LASTING_PLACE) * passing)
    assert covariance[np.ix_(own == 0, own == 1)] == pytest.approx(between)
    last = np.sqrt(np.diag(covariance))
    assert covariance[np.ix_(own == 2, own != 2)] == pytest.approx(
        LASTING_PLACE * np.outer(last[own == 2], last[own != 2])
    )


def test_a_receiver_errs_alike_in_all_drives_of_one_day() -> None:
    """It goes on where it was: what is cut from one drive is as alike as its own parts are."""
    halves = [replace(STRAIGHT, start_s=0.0), replace(STRAIGHT, start_s=-30.0)]  # 210 m farther on
    one, other = model(0.0, 0.3, halves[0]), model(30.0, 0.3, halves[1])
    covariance = drifts([ONE, ONE], [one, other]) / 0.3**2
    from_end_to_begin = covariance[len(one.knots) - 1, len(one.knots)]
    way_m = float(np.linalg.norm(other.ends[0] - one.ends[1]))
    passed_s = 30.0 + other.knots.at_s[0] - one.knots.at_s[-1]
    decayed = ALIKE + (1.0 - ALIKE) * np.exp(-way_m / SETTINGS.bias_way_m)
    passing = decayed * np.exp(-passed_s / SETTINGS.bias_time_s)
    assert from_end_to_begin == pytest.approx(LASTING_PLACE + (1.0 - LASTING_PLACE) * passing)
    assert drifts([ONE, OTHER], [one, other])[0, -1] < 0.3**2 * covariance[0, -1]


def test_drives_of_which_nothing_is_known_have_nothing_in_common() -> None:
    models = [model(), model()]
    recordings = Recordings(models)
    assert recordings.senders == pytest.approx(np.eye(2))
    assert recordings.clocks(np.array([4.0, 9.0])) == pytest.approx(np.diag([4.0, 9.0]))
    count = len(models[0].knots)
    assert recordings.drifts(SETTINGS)[:count, count:] == pytest.approx(0.0)
