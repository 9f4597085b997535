from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.errors import MatchError, OpenError
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.result import Calibration
from laci_stereo.core.settings import JointSettings, Settings
from tests.passages import meeting
from tests.simulated import LEFT_TURN, Drive, car, lidar, scene, together

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("observed_once")]

LATE_S = 0.03
LOOSE = Settings(joint=JointSettings(clock_sigma_s=LATE_S))
UNKNOWN = Settings().with_clock(1.0)
MOVED_DEG = 0.6 / 74_000.0


@cache
def by_both(settings: Settings) -> tuple[Calibration, FloatArray]:
    recording, logs, truth = meeting(LATE_S)
    return calibrate(recording, together(logs), settings), truth


def test_all_senders_that_are_seen_are_used_and_tell_the_clock_together() -> None:
    """What a late clock moves along the road it moves against the road for the one that comes the other way."""
    found, truth = by_both(LOOSE)
    recording, logs, _ = meeting(LATE_S)
    alone = calibrate(recording, logs[0], LOOSE)
    assert {each.station_id for each in found.passages} == {42, 43}
    assert np.linalg.norm(alone.T_utm_sensor[:2, 3] - truth) > 0.15
    assert np.linalg.norm(found.T_utm_sensor[:2, 3] - truth) < 0.05
    assert found.quality.track_xy_sigma_m < 0.5 * alone.quality.track_xy_sigma_m
    assert found.drive.time_offset_s == pytest.approx(LATE_S, abs=3 * found.time_sigma_s)
    assert found.quality.verdict == "pass"
    assert found.quality.frames_seen == sum(len(each.track.sightings) for each in found.passages)


def test_clocks_that_nobody_knows_are_told_by_cars_that_meet() -> None:
    recording, logs, _ = meeting(LATE_S)
    with pytest.raises(OpenError, match="the clock offset"):
        calibrate(recording, logs[0], UNKNOWN)
    found, truth = by_both(UNKNOWN)
    assert np.linalg.norm(found.T_utm_sensor[:2, 3] - truth) < 0.05


@pytest.mark.parametrize("late_s", [-0.6, 0.5])
def test_clocks_that_are_far_off_are_told_by_cars_that_meet(late_s: float) -> None:
    """By either car alone any offset is as good as any other."""
    recording, logs, truth = meeting(late_s)
    found = calibrate(recording, together(logs), UNKNOWN)
    assert {each.station_id for each in found.passages} == {42, 43}
    assert np.linalg.norm(found.T_utm_sensor[:2, 3] - truth) < 0.05
    assert found.drive.time_offset_s == pytest.approx(late_s, abs=3 * found.time_sigma_s)
    assert found.time_sigma_s < 0.02


def test_the_paper_knows_one_sender_alone() -> None:
    recording, logs, _ = meeting()
    assert calibrate(recording, together(logs), Settings(method="paper")).others == ()


def test_senders_that_contradict_each_other_are_a_warning() -> None:
    recording, (one, other), _ = meeting()
    moved = replace(other, longitude_deg=other.longitude_deg + MOVED_DEG)
    found = calibrate(recording, together([one, moved]))
    assert found.others == ()
    assert found.quality.verdict == "warn"
    (reason,) = found.quality.reasons
    assert reason.startswith(f"only station {found.drive.station_id} was used: no majority of the 2 drives (station 4")


def test_a_sender_that_tells_something_wrong_is_not_used_and_it_is_said() -> None:
    recording, (one, other), _ = meeting()
    turned = replace(other, heading_deg=(other.heading_deg + 6.0) % 360.0)
    found = calibrate(recording, together([one, turned]))
    assert (found.drive.station_id, found.others, found.quality.verdict) == (42, (), "pass")
    (remark,) = (remark for remark in found.remarks if "station 43" in remark)
    assert remark.startswith("station 43 is seen as well, but was not used: the messages' heading is ")


@pytest.mark.parametrize("late_s", [-0.25, 0.2])
def test_a_sender_that_is_seen_by_another_clock_alone_is_told(late_s: float) -> None:
    """Each of the two clocks may be the wrong one, so the result is not taken for right without a warning."""
    recording, (one, other), _ = meeting()
    late = replace(other, stamps_ns=other.stamps_ns + round(1e9 * late_s))
    found = calibrate(recording, together([one, late]))
    assert (found.drive.station_id, found.others, found.quality.verdict) == (42, (), "warn")
    reason = found.quality.reasons[0]
    assert reason.startswith("only station 42 was used: no majority of the 2 drives (station 42, station 43) agrees: ")
    told = re.search(
        r"; station 43 is seen (0\.\d\d) s (before|after) its messages have it there, as by a wrong clock$", reason
    )
    assert told is not None
    # Its boxes are 0.3 m off, which it drives in 0.05 s.
    assert float(told[1]) == pytest.approx(abs(late_s), abs=0.05)
    assert told[2] == ("before" if late_s > 0.0 else "after")


def test_a_sender_that_nobody_sees_has_no_other_clock() -> None:
    recording, logs, _ = meeting()
    aside = car(Drive((29.0, -24.0), 90.0, speeds=((0.0, 9.0),)))
    found = calibrate(replace(recording, movers=(recording.movers[0], aside)), together(logs))
    assert (found.drive.station_id, found.others) == (42, ())
    assert not any("43" in each for each in (*found.quality.reasons, *found.remarks))


def turning(later_s: float) -> Drive:
    """Come the other way and turn across the road, at different times."""
    return replace(LEFT_TURN, start_s=later_s)


@pytest.mark.parametrize("late_s", [-0.3, 0.2])
def test_the_sensors_clock_is_told_by_a_second_sender_that_turns(late_s: float) -> None:
    """The first one is on a straight road: by itself it is as well seen 1.6 m farther on."""
    recording, logs, truth = meeting(late_s, turning(0.0))
    found = calibrate(recording, together(logs))
    assert np.linalg.norm(found.T_utm_sensor[:2, 3] - truth) > 1.0
    assert found.quality.verdict == "warn"
    (told,) = re.findall(
        r"with the clocks (\d\.\d\d) s apart, stations 42 and 43 would match their messages: --clock ",
        "\n".join(found.quality.reasons),
    )
    assert float(told) == pytest.approx(abs(late_s), abs=0.05)
    right = calibrate(recording, together(logs), UNKNOWN)
    assert np.linalg.norm(right.T_utm_sensor[:2, 3] - truth) < 0.05
    assert not any("with the clocks" in each for each in right.quality.reasons)


def test_of_a_clock_that_is_set_nothing_is_said() -> None:
    recording, logs, truth = meeting(0.0, turning(0.0))
    found = calibrate(recording, together(logs))
    assert np.linalg.norm(found.T_utm_sensor[:2, 3] - truth) < 0.05
    assert (found.quality.verdict, found.quality.reasons) == ("pass", ())


def test_senders_of_which_none_is_likelier_are_refused_with_the_clock_that_suits_both() -> None:
    recording, logs, _ = meeting(0.2, turning(-3.0))
    with pytest.raises(MatchError, match=r"fit equally well .*; with the clocks 0\.1\d s apart, stations 42 and 43 "):
        calibrate(recording, together(logs))


def test_a_refusal_names_the_clock_by_which_the_one_sender_is_seen() -> None:
    made = scene(LEFT_TURN, lidar(32, 160), frames_hz=5.0)
    late = replace(made.messages, stamps_ns=made.messages.stamps_ns + 1_200_000_000)
    with pytest.raises(MatchError, match=r"no moving object fits .*; with the clocks 1\.[12]\d s apart, station 42 "):
        calibrate(made.recording, late)


@pytest.mark.parametrize("late_s", [-0.08, 0.12])
def test_a_sender_that_contradicts_the_clock_and_the_place_is_a_warning(late_s: float) -> None:
    recording, logs, truth = meeting(late_s, turning(0.5))
    found = calibrate(recording, together(logs))
    assert (found.drive.station_id, found.others, found.quality.verdict) == (42, (), "warn")
    assert np.linalg.norm(found.T_utm_sensor[:2, 3] - truth) > 0.5
    assert re.match(
        r"station 43 is seen as well, but was not used: the clocks are -?\d+ ms apart, .*; no majority of the 2 ",
        found.quality.reasons[0],
    )


def test_a_sender_whose_clock_alone_is_wrong_does_no_harm() -> None:
    """By a clock of its own it has the sensor at the same place."""
    recording, (one, other), truth = meeting(0.0, turning(1.0))
    late = replace(other, stamps_ns=other.stamps_ns + 200_000_000)
    found = calibrate(recording, together([one, late]))
    assert np.linalg.norm(found.T_utm_sensor[:2, 3] - truth) < 0.05
    assert (found.drive.station_id, found.others, found.quality.verdict) == (42, (), "pass")
    assert any(
        each.startswith("station 43 is seen as well, but was not used: the clocks are ") for each in found.remarks
    )
