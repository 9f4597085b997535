"""What a drive leaves open is refused, and what its messages get wrong is said: each brought about by a scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.errors import CamError, MatchError, OpenError, TrackError
from laci_stereo.core.messages.cam import CENTRE, ELLIPSE_SIGMAS, CamLog
from laci_stereo.core.result import Calibration
from laci_stereo.core.settings import JointSettings, Settings
from tests.core.test_calibrate import errors
from tests.simulated import LEFT_TURN, STRAIGHT, ULM, Drive, Scene, Solid, cam_log, car, lidar, scene, stereo

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("observed_once")]

UNKNOWN_CLOCK = Settings().with_clock(1.0)
TURNING, STEADY = scene(LEFT_TURN, lidar()), scene(STRAIGHT, lidar())
BRAKING = scene(replace(STRAIGHT, speeds=((0.0, 8.0), (2.0, 8.0), (4.0, 5.0))), lidar(), last_s=7.0)
SLOWING = scene(replace(STRAIGHT, speeds=((0.0, 8.0), (2.0, 8.0), (4.0, 7.2))), lidar(), last_s=6.5)


def late(log: CamLog, by_s: float) -> CamLog:
    return replace(log, stamps_ns=log.stamps_ns + round(by_s * 1e9))


def accurate(log: CamLog) -> CamLog:
    """Let messages tell the accuracy that is assumed where they do not."""
    semi = np.full(len(log), JointSettings().position_sigma_m * ELLIPSE_SIGMAS)
    return replace(log, semi_major_95_m=semi, semi_minor_95_m=semi)


def follower(length: float) -> Scene:
    """A steady drive with another car 15 m behind at the same speed."""
    behind = Drive((22.0, 37.0), -90.0, speeds=((0.0, 8.0),))
    return scene(STRAIGHT, lidar(), others=[car(behind, length)])


def covered(made: Scene, found: Calibration) -> None:
    """The truth is within three sigma."""
    error = errors(made, found)
    assert error.track_xy_m < 3.0 * found.quality.track_xy_sigma_m
    assert abs(error.yaw_deg) < 3.0 * found.quality.yaw_sigma_deg


def reason(found: Calibration, part: str) -> str:
    """The one reason for doubt that holds these words."""
    assert found.quality.verdict == "warn"
    (line,) = (line for line in found.quality.reasons if part in line)
    return line


# refused


def test_a_steady_drive_does_not_tell_the_clock() -> None:
    with pytest.raises(OpenError, match=r"weakest along the drive .* the clock offset, known to \d+ ms"):
        calibrate(STEADY.recording, STEADY.messages, UNKNOWN_CLOCK)


@pytest.mark.parametrize("by_s", [-0.3, 0.0, 0.3])
@pytest.mark.parametrize(
    "made",
    [pytest.param(BRAKING, id="brakes"), pytest.param(SLOWING, id="slows by a tenth")],
)
def test_a_change_of_speed_does(made: Scene, by_s: float) -> None:
    found = calibrate(made.recording, late(made.messages, by_s), UNKNOWN_CLOCK)
    covered(made, found)
    assert abs(found.drive.time_offset_s - by_s) < 3.0 * found.time_sigma_s
    assert found.time_sigma_s < 0.1


@pytest.mark.parametrize(("last_s", "lost"), [(12.0, 0), (4.5, 15)])
def test_messages_are_known_as_far_as_clocks_may_be_apart(last_s: float, lost: int) -> None:
    by_s = 2.4
    log = late(cam_log(ULM, BRAKING.vehicle, last_s, first_s=-5.0), by_s)
    left_out = calibrate(BRAKING.recording, log, UNKNOWN_CLOCK).quality.left_out
    assert "bare" not in left_out
    assert left_out.get("unknown", 0) == pytest.approx(lost, abs=1)


def test_one_that_follows_at_the_same_speed_cannot_be_told_apart() -> None:
    made = follower(4.4)
    with pytest.raises(
        MatchError, match=r"two moving objects, .* fit nearly equally well \(odds of [1-9.]+ to 1\): record a drive"
    ):
        calibrate(made.recording, made.messages)


def test_unless_it_is_of_another_length() -> None:
    made = follower(4.0)
    found = calibrate(made.recording, made.messages)
    covered(made, found)
    assert errors(made, found).track_xy_m < 0.3


def test_a_caravan_that_is_seen_as_one_with_its_car() -> None:
    made = scene(STRAIGHT, lidar(layers=32))
    bar, caravan = Solid((-2.5, 0.0), 0.0, 1.4, 1.6, 0.2, 1.0), Solid((-5.6, 0.0), 0.0, 5.6, 2.2, 0.4, 2.6)
    (alone,) = made.recording.movers
    towing = replace(alone, parts=(*alone.parts, bar, caravan))
    with pytest.raises(
        MatchError, match=r"in \d+ frames, is (9|10)\.\d m long, .* more than 4\.4 m: if it tows something"
    ):
        calibrate(replace(made.recording, movers=(towing,)), made.messages)


def test_a_lorry_that_shunts_within_its_own_length() -> None:
    to_and_fro = Drive((24.0, -3.0), 90.0, speeds=((0.0, 2.0), (2.7, 2.0), (2.8, -2.0), (5.5, -2.0), (5.6, 2.0)))
    made = scene(LEFT_TURN, lidar())
    lorry = car(to_and_fro.turned(np.radians(35.0)), 8.5, 2.4)
    with pytest.raises(TrackError, match=r"8\.5 m long, occupies one place (9\d|100)% of the time, .* its length$"):
        calibrate(replace(made.recording, movers=(lorry,)), cam_log(ULM, lorry, 6.0))


def test_a_drive_that_is_seen_from_ahead_only() -> None:
    towards = scene(Drive((34.0, 0.0), 180.0, speeds=((0.0, 8.0),)), lidar(layers=12), last_s=2.0)
    with pytest.raises(MatchError, match=r"the vehicle's outline is seen in \d frames .* needed are 10"):
        calibrate(towards.recording, towards.messages)


def test_pixels_that_are_too_large_to_tell_the_outline_from_the_road() -> None:
    few, many = (
        scene(LEFT_TURN, stereo(baseline_m=1.0, width_px=width, window_px=11), height_m=14.0, down_deg=28.0)
        for width in (320, 1280)
    )
    with pytest.raises(MatchError, match=r"needed are 10; the matcher's window is 1\.\d m high there, so that"):
        calibrate(few.recording, few.messages)
    covered(many, calibrate(many.recording, many.messages))


def test_heights_that_noise_hides_in_the_road_tell_nevertheless() -> None:
    short = scene(LEFT_TURN, stereo(baseline_m=0.4, window_px=11), height_m=14.0, down_deg=28.0)
    found = calibrate(short.recording, short.messages)
    (drive,) = found.passages
    noise = [np.median(one.sigma_along_m) for one in drive.track.usable]
    assert np.median(noise) > 0.25  # and half of that in height, of which five sigma are above the bonnet
    covered(short, found)
    assert errors(short, found).track_xy_m < 0.2


def test_from_ahead_bonnet_and_windscreen_are_pieces_of_one_vehicle() -> None:
    towards = scene(Drive((60.0, 0.0), 180.0, speeds=((0.0, 8.0),)), lidar(), last_s=3.8)
    covered(towards, calibrate(towards.recording, towards.messages))


@pytest.mark.parametrize("last_s", [1.6, 5.0])
def test_a_stranger_on_the_senders_way_at_nearly_its_speed(last_s: float) -> None:
    stranger = scene(replace(STRAIGHT, speeds=((0.0, 8.4),)), lidar(), last_s=last_s)
    messages = scene(STRAIGHT, lidar(), last_s=last_s).messages
    with pytest.raises(MatchError, match=r"station 42 fits one of 1 moving objects, .* but that may be by chance"):
        calibrate(stranger.recording, messages)
    untold = replace(messages, length_m=np.full(len(messages), np.nan))
    told = r"by chance .* the messages report no length of the vehicle: taken as a car's"
    with pytest.raises(MatchError, match=told):
        calibrate(stranger.recording, untold)


def test_messages_that_contradict_one_another() -> None:
    log = TURNING.messages
    with pytest.raises(CamError, match="contradict one another"):
        calibrate(TURNING.recording, replace(log, speed_mps=3.6 * log.speed_mps))


# said


def test_clocks_that_are_farther_apart_than_was_said() -> None:
    found = calibrate(TURNING.recording, late(TURNING.messages, 0.1))
    assert "where 10 ms were expected: --clock unknown" in reason(found, "the clocks are")
    covered(TURNING, found)


@pytest.mark.parametrize("off_deg", [-4.0, 4.0])
def test_a_heading_that_is_not_the_bodys(off_deg: float) -> None:
    log = TURNING.messages
    found = calibrate(TURNING.recording, replace(log, heading_deg=(log.heading_deg + off_deg) % 360.0))
    told = reason(found, "heading")
    assert abs(float(told.split()[4]) - off_deg) < 1.0
    covered(TURNING, found)


@pytest.mark.parametrize("off_m", [-0.6, 0.6])
def test_a_length_that_is_wrong(off_m: float) -> None:
    told = cam_log(ULM, STEADY.vehicle, 6.0, reference=(0.0, 0.0))
    found = calibrate(STEADY.recording, replace(told, length_m=told.length_m + off_m), reference=CENTRE)
    told = reason(found, "the vehicle's length is")
    assert abs(float(told.split()[4]) + off_m) < 0.1
    covered(STEADY, found)


def test_dimensions_that_were_not_told() -> None:
    log = accurate(TURNING.messages)
    nothing = np.full(len(log), np.nan)
    found = calibrate(TURNING.recording, replace(log, length_m=nothing, width_m=nothing))
    covered(TURNING, found)
    assert [("length" in line, "width" in line) for line in found.remarks] == [(True, False), (False, True)]


def test_an_accuracy_that_was_not_told() -> None:
    untold, told = (calibrate(TURNING.recording, log) for log in (TURNING.messages, accurate(TURNING.messages)))
    (remark,) = untold.remarks
    assert "the messages report no accuracy of their positions: taken as 0.02 m" in remark
    assert told.remarks == ()
    assert np.array_equal(told.T_world_sensor, untold.T_world_sensor)


def test_headings_that_were_not_told() -> None:
    log = accurate(TURNING.messages)
    found = calibrate(TURNING.recording, replace(log, heading_deg=np.full(len(log), np.nan)))
    covered(TURNING, found)
    (remark,) = found.remarks
    assert remark.startswith("the messages report no heading")


def test_positions_that_are_a_metre_off_make_a_result_that_may_be() -> None:
    found = calibrate(TURNING.recording, TURNING.messages.exact_to(1.0))
    assert found.remarks == ()
    assert found.quality.track_xy_sigma_m > 0.7
    assert found.quality.verdict == "warn"


def test_an_accuracy_that_is_out_of_range() -> None:
    log = TURNING.messages
    semi = np.full(len(log), 40.94)
    found = calibrate(TURNING.recording, replace(log, semi_major_95_m=semi, semi_minor_95_m=semi))
    assert found.quality.verdict == "fail"


def test_positions_that_are_wrong() -> None:
    log, rng = TURNING.messages, np.random.default_rng(0)
    wrong = rng.random(len(log)) < 0.3
    off_deg = np.where(wrong, rng.uniform(-1e-4, 1e-4, len(log)), 0.0)
    found = calibrate(TURNING.recording, replace(log, latitude_deg=log.latitude_deg + off_deg))
    covered(TURNING, found)
    assert f"of {len(log)} messages of station 42 are left out" in found.remarks[0]


def test_positions_of_which_more_are_wrong_than_may_be() -> None:
    log, rng = TURNING.messages, np.random.default_rng(0)
    off_deg = np.where(rng.permutation(len(log)) < 0.4 * len(log), rng.uniform(-1e-4, 1e-4, len(log)), 0.0)
    found = calibrate(TURNING.recording, replace(log, latitude_deg=log.latitude_deg + off_deg))
    assert f"of {len(log)} messages of station 42" in reason(found, "are left out")
    covered(TURNING, found)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_positions_of_another_point_than_was_said(side: float) -> None:
    told = cam_log(ULM, TURNING.vehicle, 6.0, reference=(0.0, 0.7 * side))
    found = calibrate(TURNING.recording, told, reference=CENTRE)
    assert f"to the {'left' if side > 0 else 'right'} of the point" in reason(found, "the messages' positions are 0.")


def test_positions_of_another_part_of_the_vehicle_are_told_and_put_right() -> None:
    """Of its middle, where those of the middle of its front were said."""
    found = calibrate(TURNING.recording, cam_log(ULM, TURNING.vehicle, 6.0, reference=(0.0, 0.0)))
    words = reason(found, "the messages' positions are")
    assert "behind the point that --cam-reference gives" in words
    assert float(words.split()[4]) == pytest.approx(TURNING.vehicle.length / 2, abs=0.15)
    covered(TURNING, found)
    assert errors(TURNING, found).track_xy_m < 0.05


def test_positions_of_the_rear_axle_do_no_harm() -> None:
    """How far behind they are and how late looks nearly alike: where the sensor is does not depend on it."""
    found = calibrate(TURNING.recording, cam_log(ULM, TURNING.vehicle, 6.0, reference=(-1.4, 0.0)))
    assert "behind the point that --cam-reference gives" in reason(found, "the messages' positions are")
    covered(TURNING, found)
    assert errors(TURNING, found).track_xy_m < 0.05


def test_a_heading_that_is_wrong_by_far_is_put_right() -> None:
    log = TURNING.messages
    found = calibrate(TURNING.recording, replace(log, heading_deg=(log.heading_deg + 10.0) % 360.0))
    assert float(reason(found, "heading").split()[4]) == pytest.approx(10.0, abs=0.5)
    covered(TURNING, found)


@pytest.mark.parametrize("lag_s", [0.2, 0.4])
def test_headings_that_are_older_than_the_positions(lag_s: float) -> None:
    log = TURNING.messages
    sent_s = 1e-9 * (log.stamps_ns - log.stamps_ns[0])
    heading = np.degrees(np.interp(sent_s - lag_s, sent_s, np.unwrap(np.radians(log.heading_deg))))
    found = calibrate(TURNING.recording, replace(log, heading_deg=heading % 360.0))
    words = reason(found, "headings are")
    assert words.endswith(" ms older than their positions")
    assert float(words.split()[4]) == pytest.approx(1e3 * lag_s, abs=80.0)
    covered(TURNING, found)


def test_positions_that_their_sender_hardly_knows() -> None:
    log = TURNING.messages
    semi = np.full(len(log), 0.6 * np.sqrt(-2.0 * np.log(0.05)))  # of the ellipse that holds 95 %
    found = calibrate(TURNING.recording, replace(log, semi_major_95_m=semi, semi_minor_95_m=semi))
    assert "the CAMs' own positions are known to 0.60 m" in found.quality.advice
    covered(TURNING, found)


@pytest.mark.parametrize("begin_deg", [180.0, 0.0, -10.0])
@pytest.mark.parametrize(
    ("turn_s", "how"),
    [(-0.1, "spinning clockwise"), (0.1, "spinning counter-clockwise")],
)
def test_a_scanner_that_turns_and_does_not_tell_the_points_times(turn_s: float, how: str, begin_deg: float) -> None:
    """Where its scans begin in the middle of the drive, what is seen of the vehicle jumps by a turn's way."""
    made = scene(STRAIGHT, replace(lidar(), turn_s=turn_s, begin_rad=np.radians(begin_deg)))
    found = calibrate(made.recording, accurate(made.messages))
    (remark,) = found.remarks
    assert remark.startswith(f"by the drive, the scanner measures a scan's points {how} (probability 100%)")
    covered(made, found)


def test_messages_that_are_lost() -> None:
    log = TURNING.messages
    covered(TURNING, calibrate(TURNING.recording, log[np.random.default_rng(0).random(len(log)) < 0.5]))
