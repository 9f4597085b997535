"""Headings that all messages of a log tell wrongly are refused, and those that are right are not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.errors import CamError
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.messages.cam import CENTRE, FRONT, CamLog, VehicleTrack, vehicle_track
from laci_stereo.core.world import World
from tests.simulated import EPOCH_NS, ULM, Drive, cam_log, car

TURN = Drive((0.0, 0.0), 200.0, ((20.0, 0.0), (15.0, 90.0)), ((0.0, 8.0), (4.0, 8.0), (6.0, 4.0)))
STRAIGHT = Drive((0.0, 0.0), 10.0, speeds=((0.0, 9.0),))
BEND = Drive((0.0, 0.0), 90.0, ((30.0, 0.0), (11.0, -90.0)), ((0.0, 6.0),))
SLOW = Drive((0.0, 0.0), 10.0, speeds=((0.0, 3.0),))


def log_of(drive: Drive) -> CamLog:
    return cam_log(ULM, car(drive), 12.0)


def track_of(log: CamLog) -> VehicleTrack:
    latitude_deg, longitude_deg = float(np.median(log.latitude_deg)), float(np.median(log.longitude_deg))
    return vehicle_track(log, World.around(latitude_deg, longitude_deg), EPOCH_NS, FRONT)


def told(log: CamLog, tell: Callable[[FloatArray], FloatArray]) -> CamLog:
    return replace(log, heading_deg=tell(log.heading_deg) % 360.0)


@pytest.mark.parametrize("drive", [TURN, STRAIGHT, BEND], ids=["turn", "straight", "bend"])
@pytest.mark.parametrize(
    ("tell", "likely"),
    [
        (np.radians, "headings are in radians"),
        (lambda heading: np.radians((heading + 180.0) % 360.0 - 180.0), "headings are in radians"),
        (lambda heading: np.radians((90.0 - heading) % 360.0), "in radians, counter-clockwise from east"),
        (lambda heading: 90.0 - heading, "headings are counter-clockwise from east"),
        (lambda heading: heading / 10.0, "taken for tenths"),
    ],
    ids=["radians", "radians of both signs", "radians from east", "from east", "tenths"],
)
def test_another_reading_that_fits_is_named(
    drive: Drive, tell: Callable[[FloatArray], FloatArray], likely: str
) -> None:
    with pytest.raises(CamError, match=f"heading is .* off the way .* station 42 .* degrees clockwise .* {likely}"):
        track_of(told(log_of(drive), tell))


@pytest.mark.parametrize(("side", "words"), [("latitude_deg", "latitudes lack"), ("longitude_deg", "longitudes lack")])
def test_a_sign_that_was_lost(side: str, words: str) -> None:
    log = log_of(TURN)
    with pytest.raises(CamError, match=f"likely: .*{words} their sign"):
        track_of(replace(log, **{side: -getattr(log, side)}))


@pytest.mark.parametrize("drive", [TURN, STRAIGHT, BEND], ids=["turn", "straight", "bend"])
def test_one_heading_for_all(drive: Drive) -> None:
    log = log_of(drive)
    with pytest.raises(CamError, match=f"heading is 0 in all of {len(log)} messages of station 42"):
        track_of(told(log, np.zeros_like))


@pytest.mark.parametrize("change", ["headings", "longitudes"])
def test_nobody_reverses_as_fast_as_that(change: str) -> None:
    log = log_of(replace(STRAIGHT, yaw_deg=0.0))
    wrong = told(log, lambda heading: heading + 180.0)
    if change == "longitudes":
        wrong = replace(log, longitude_deg=-log.longitude_deg)
    with pytest.raises(
        CamError, match=r"would reverse at up to 9\.\d m/s in .* turned by 180 deg, .* or longitudes or"
    ):
        track_of(wrong)


def test_who_reverses_all_the_way_slowly_may_do_so_and_it_is_doubted() -> None:
    log = log_of(SLOW)
    (doubt,) = track_of(told(log, lambda heading: heading + 180.0)).objections
    assert "reverses all the way" in doubt
    assert track_of(log).objections == ()


@pytest.mark.parametrize("yaw_deg", range(0, 360, 30))
@pytest.mark.parametrize("drive", [TURN, STRAIGHT, BEND, SLOW], ids=["turn", "straight", "bend", "slow"])
def test_right_headings_are_never_doubted(drive: Drive, yaw_deg: int) -> None:
    assert track_of(log_of(replace(drive, yaw_deg=float(yaw_deg)))).objections == ()


def test_messages_of_which_many_are_left_out_are_doubted() -> None:
    log = log_of(TURN)
    for share, doubts in ((0.2, 0), (0.4, 1)):
        wrong = np.random.default_rng(0).permutation(len(log)) < share * len(log)
        off_deg = np.random.default_rng(1).uniform(-1e-4, 1e-4, len(log))
        track = vehicle_track(
            replace(log, latitude_deg=log.latitude_deg + np.where(wrong, off_deg, 0.0)),
            World.around(ULM.latitude_deg, ULM.longitude_deg),
            EPOCH_NS,
            CENTRE,
        )
        assert len(track.objections) == doubts
