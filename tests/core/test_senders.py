from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.errors import OpenError
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.result import Calibration
from laci_stereo.core.settings import JointSettings, MatchSettings, Settings
from tests.passages import meeting
from tests.simulated import Drive, car, together

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("observed_once")]

LATE_S = 0.03
LOOSE = Settings(joint=JointSettings(clock_sigma_s=LATE_S))
UNKNOWN = Settings(match=MatchSettings(clock_sigma_s=1.0), joint=JointSettings(clock_sigma_s=1.0))
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
    assert found.time_offset_s == pytest.approx(LATE_S, abs=3 * found.time_sigma_s)
    assert found.quality.verdict == "pass"
    assert found.quality.frames_seen == sum(len(each.track.sightings) for each in found.passages)


def test_clocks_that_nobody_knows_are_told_by_cars_that_meet() -> None:
    recording, logs, _ = meeting(LATE_S)
    with pytest.raises(OpenError, match="the clocks' offset"):
        calibrate(recording, logs[0], UNKNOWN)
    found, truth = by_both(UNKNOWN)
    assert np.linalg.norm(found.T_utm_sensor[:2, 3] - truth) < 0.05


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
    assert reason.startswith(f"only station {found.station_id} was used: no majority of the 2 drives (station 4")


def test_a_sender_that_tells_something_wrong_is_not_used_and_it_is_said() -> None:
    recording, (one, other), _ = meeting()
    turned = replace(other, heading_deg=(other.heading_deg + 6.0) % 360.0)
    found = calibrate(recording, together([one, turned]))
    assert (found.station_id, found.others, found.quality.verdict) == (42, (), "pass")
    (remark,) = (remark for remark in found.remarks if "station 43" in remark)
    assert remark.startswith("station 43 is seen as well, but was not used: the messages' heading is ")


@pytest.mark.parametrize("late_s", [-0.25, 0.2])
def test_a_sender_that_is_seen_by_another_clock_alone_is_told(late_s: float) -> None:
    """Each of the two clocks may be the wrong one, so the result is not taken for right without a warning."""
    recording, (one, other), _ = meeting()
    late = replace(other, stamps_ns=other.stamps_ns + round(1e9 * late_s))
    found = calibrate(recording, together([one, late]))
    assert (found.station_id, found.others, found.quality.verdict) == (42, (), "warn")
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
    assert (found.station_id, found.others) == (42, ())
    assert not any("43" in each for each in (*found.quality.reasons, *found.remarks))
