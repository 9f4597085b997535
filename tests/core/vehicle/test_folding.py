from __future__ import annotations

import logging

import numpy as np
import pytest

from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.errors import TrackError
from laci_stereo.core.frames import BoolArray, invert, transform
from laci_stereo.core.messages.cam import FRONT, VehicleTrack, vehicle_track
from laci_stereo.core.vehicle.folding import STRAIGHT_RAD, TOWED_M
from laci_stereo.core.world import World
from tests.articulated import LENGTH_M, articulated, fold, messages
from tests.simulated import EPOCH_NS, ULM, Drive

BEND = Drive((0.0, 0.0), 20.0, ((15.0, 0.0), (16.0, 90.0)), ((0.0, 7.0),))
THEN_BENDS = Drive((24.0, 26.0), -90.0, ((34.0, 0.0), (14.0, -80.0)), ((0.0, 8.0),))
ROUND = Drive((38.0, -10.0), 150.0, ((60.0, -250.0),), ((0.0, 7.0),), start_s=-3.0)
BENDS_IN_VIEW = Drive((46.0, -26.0), 90.0, ((6.0, 0.0), (17.0, 85.0)), ((0.0, 7.0),), start_s=-1.0)


def told(drive: Drive, length_m: float, width_m: float = 2.5) -> BoolArray:
    stamps = np.arange(-3.0, 14.0, 0.1)
    return VehicleTrack(stamps, 0, *drive.at(stamps), length_m, width_m).folded


@pytest.mark.parametrize(("length_m", "width_m"), [(15.0, 2.55), (12.0, 2.5), (7.4, 2.1), (4.5, 1.8)])
def test_what_may_be_rigid_never_folds(length_m: float, width_m: float) -> None:
    assert not told(BEND, length_m, width_m).any()


@pytest.mark.parametrize(("length_m", "width_m"), [(16.5, 2.55), (18.7, 2.5), (10.5, 1.8), (12.0, 2.1)])
def test_lorries_and_cars_with_trailers_and_articulated_buses_do(length_m: float, width_m: float) -> None:
    assert told(BEND, length_m, width_m).any()
    assert not told(Drive((0.0, 0.0), 20.0), length_m, width_m).any()


def test_it_folds_as_a_trailer_does() -> None:
    stamps = np.arange(-3.0, 14.0, 0.1)
    angle = np.abs(fold(BEND, stamps))
    assert np.degrees(angle.max()) > 30.0
    found = told(BEND, LENGTH_M)
    assert found[angle > 1.5 * STRAIGHT_RAD].all()
    assert not found[angle < STRAIGHT_RAD / 1.5].any()


def test_after_a_bend_it_straightens_by_a_share_of_its_drawbar() -> None:
    found = told(BEND, LENGTH_M)
    last_s = np.arange(-3.0, 14.0, 0.1)[found].max()
    # The angle decays as exp(-s / drawbar) after the bend's 31 m, which are driven after 31 / 7 s.
    at_the_end = abs(fold(BEND, np.array([31.0 / 7.0]))[0])
    assert 7.0 * last_s - 31.0 == pytest.approx(TOWED_M * np.log(at_the_end / STRAIGHT_RAD), abs=2.0)


@pytest.mark.parametrize("wave_m", [20.0, 30.0, 45.0])
def test_while_it_weaves_it_is_never_straight(wave_m: float) -> None:
    """Not even where the angle passes zero: its trailer is on its way from one side to the other."""
    stamps = np.arange(0.0, 10.0, 0.1)
    along, per_m = 20.0 * stamps, 2.0 * np.pi / wave_m
    slope = 2.0 * STRAIGHT_RAD * np.cos(per_m * along)
    xy = np.column_stack([along, 2.0 * STRAIGHT_RAD / per_m * np.sin(per_m * along)])
    found = VehicleTrack(stamps, 0, xy, np.arctan(slope), LENGTH_M, 2.5).folded
    assert found[np.abs(along - 100.0) < 100.0 - wave_m].all()


def test_between_two_bends_that_are_far_apart_it_is_straight() -> None:
    drive = Drive((0.0, 0.0), 20.0, ((16.0, 40.0), (80.0, 0.0), (16.0, -40.0)), ((0.0, 7.0),))
    stamps = np.arange(-3.0, 14.0, 0.1)
    straight = (7.0 * stamps > 16.0 + 4.0 * TOWED_M) & (7.0 * stamps < 96.0)
    assert straight.any()
    assert not told(drive, LENGTH_M)[straight].any()


@pytest.mark.parametrize("rate_hz", [2.0, 5.0, 10.0])
@pytest.mark.parametrize("turn_deg", [120.0, -120.0])
def test_no_message_of_a_tractor_in_a_narrow_bend_is_taken_for_wrong(rate_hz: float, turn_deg: float) -> None:
    # Its wheels are 5 m behind its front, not two thirds of 16.5 m.
    bend = Drive((0.0, 0.0), 45.0, ((10.0, 0.0), (18.0, turn_deg)), ((0.0, 4.0),))
    log = messages(bend, 12.0, rate_hz)
    track = vehicle_track(log, World.around(ULM.latitude_deg, ULM.longitude_deg), EPOCH_NS, FRONT)
    assert len(track.stamps_s) == len(log)


@pytest.mark.slow
def test_where_it_is_straight_it_calibrates(caplog: pytest.LogCaptureFixture) -> None:
    made = articulated(THEN_BENDS, last_s=7.0)
    with caplog.at_level(logging.WARNING):
        found = calibrate(made.recording, made.messages, crs=ULM.crs)
    assert "16.5 m long" in caplog.text
    assert "articulates in bends" in caplog.text
    bends = np.abs(fold(THEN_BENDS, made.recording.times_s)) > 1.5 * STRAIGHT_RAD
    assert found.quality.frames_used <= np.count_nonzero(~bends)
    xy, _ = made.vehicle.drive.at(found.drive.track.stamps_s)
    sensor = transform(invert(made.recording.T_world_sensor), np.column_stack([xy, np.zeros(len(xy))]))
    off = transform(found.T_utm_sensor, sensor)[:, :2] - ULM.to_utm(xy)
    assert np.sqrt((off**2).sum(axis=1).mean()) < 3.0 * found.quality.track_xy_sigma_m
    R = found.T_world_sensor[:3, :3] @ made.recording.T_world_sensor[:3, :3].T
    assert abs(np.degrees(np.arctan2(R[1, 0], R[0, 0]))) < 3.0 * found.quality.yaw_sigma_deg
    assert found.quality.track_xy_sigma_m < 0.3


def test_who_bends_all_the_time_is_told_so() -> None:
    made = articulated(ROUND)
    with pytest.raises(TrackError, match=r"16\.5 m long.*articulates in bends, which it does at .*: drive straight"):
        calibrate(made.recording, made.messages, crs=ULM.crs)


@pytest.mark.slow
def test_who_bends_while_in_view_is_told_so() -> None:
    made = articulated(BENDS_IN_VIEW)
    with pytest.raises(TrackError, match=r"station 42's, 16\.5 m long, articulates in bends, at \d+ of"):
        calibrate(made.recording, made.messages, crs=ULM.crs)
