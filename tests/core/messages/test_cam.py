from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from laci_stereo.core.errors import CamError, TrackError
from laci_stereo.core.frames import FloatArray, rotate_xy, wrap
from laci_stereo.core.messages.cam import (
    CENTRE,
    ELLIPSE_SIGMAS,
    FRONT,
    MAX_GAP_S,
    CamLog,
    ReferencePoint,
    VehicleTrack,
    vehicle_track,
)
from laci_stereo.core.world import World
from tests.simulated import EPOCH_NS, SYDNEY, ULM, Drive, Place, cam_log, car, together

NORTH = Drive((0.0, 0.0), 90.0, speeds=((0.0, 10.0),))
TURN = Drive((0.0, 0.0), 200.0, ((20.0, 0.0), (15.0, 90.0)), ((0.0, 8.0),))
BRAKE = Drive((0.0, 0.0), 30.0, speeds=((0.0, 10.0), (1.0, 10.0), (3.03, 0.0)))


def track_of(log: CamLog, place: Place = ULM, reference: ReferencePoint = FRONT) -> VehicleTrack:
    return vehicle_track(log, World.around(place.latitude_deg, place.longitude_deg), EPOCH_NS, reference)


def in_world(place: Place, xy: FloatArray) -> FloatArray:
    return World.around(place.latitude_deg, place.longitude_deg).from_utm(place.to_utm(xy))


def plain(stamps_s: FloatArray, xy: FloatArray, yaw_rad: FloatArray | None = None) -> VehicleTrack:
    yaw_rad = np.zeros(len(stamps_s)) if yaw_rad is None else yaw_rad
    return VehicleTrack(stamps_s, 0, xy, yaw_rad, 4.5, 1.8)


def circle(radius_m: float, speed_mps: float, times: FloatArray) -> FloatArray:
    angle = speed_mps * times / radius_m
    return radius_m * np.column_stack([np.cos(angle), np.sin(angle)])


# from messages to poses


@pytest.mark.parametrize("place", [ULM, SYDNEY])
@pytest.mark.parametrize("drive", [NORTH, TURN])
def test_the_centre_of_the_vehicle_is_found(place: Place, drive: Drive) -> None:
    track = track_of(cam_log(place, car(drive, 4.5, 1.8), 5.0, rounded=False), place)
    xy, yaw = drive.at(track.stamps_s)
    assert track.xy == pytest.approx(in_world(place, xy), abs=1e-4)
    assert track.yaw_rad == pytest.approx(yaw + 2 * np.pi * round((track.yaw_rad[0] - yaw[0]) / (2 * np.pi)), abs=1e-5)
    assert (track.length_m, track.width_m) == (4.5, 1.8)


def test_rounded_messages_are_good_to_a_centimetre() -> None:
    track = track_of(cam_log(ULM, car(TURN), 5.0))
    assert np.abs(track.xy - in_world(ULM, TURN.at(track.stamps_s)[0])).max() < 0.012


@pytest.mark.parametrize(
    ("sent", "reference"),
    [
        (None, FRONT),
        ((0.0, 0.0), CENTRE),
        ((-1.4, 0.0), ReferencePoint(-1.4)),
        ((0.7, -0.35), ReferencePoint(0.7, -0.35)),
    ],
)
def test_every_reference_point_gives_the_same_centre(
    sent: tuple[float, float] | None, reference: ReferencePoint
) -> None:
    track = track_of(cam_log(ULM, car(TURN), 5.0, reference=sent, rounded=False), reference=reference)
    assert track.xy == pytest.approx(in_world(ULM, TURN.at(track.stamps_s)[0]), abs=1e-4)


def test_the_wrong_reference_point_is_half_a_length_off() -> None:
    track = track_of(cam_log(ULM, car(TURN, 4.4), 5.0, rounded=False), reference=CENTRE)
    error = np.linalg.norm(track.xy - in_world(ULM, TURN.at(track.stamps_s)[0]), axis=1)
    assert error == pytest.approx(2.2, abs=1e-3)


def test_a_standing_vehicle_keeps_its_heading() -> None:
    # The simulated sender's heading is arbitrary while it stands.
    drive = replace(TURN, speeds=((0.0, 8.0), (1.0, 8.0), (2.5, 0.0), (4.5, 0.0), (6.0, 8.0)))
    log = cam_log(ULM, car(drive), 7.0, rounded=False)
    track = track_of(log)
    xy, yaw = drive.at(track.stamps_s)
    assert np.cos(track.yaw_rad - yaw).min() > np.cos(np.radians(2.0))
    assert track.xy == pytest.approx(in_world(ULM, xy), abs=0.1)


@pytest.mark.parametrize("until_s", [0.0, 3.0], ids=["briefly", "most of the time"])
@pytest.mark.parametrize("first", ["forwards", "backwards"])
def test_a_reversing_vehicle_keeps_its_heading(first: str, until_s: float) -> None:
    slow = ((-2.0, 2.5), (until_s, 2.5), (until_s + 1.0, 8.0))
    drive = replace(TURN, speeds=slow if first == "backwards" else tuple((3.0 - at, v) for at, v in reversed(slow)))
    log = cam_log(ULM, car(drive), 5.0, rounded=False)
    at_s = (log.stamps_ns - EPOCH_NS) / 1e9
    back = at_s < until_s if first == "backwards" else at_s > 3.0 - until_s
    assert 0 < np.count_nonzero(back) < len(log)
    track = track_of(replace(log, heading_deg=(log.heading_deg + 180.0 * back) % 360.0))
    assert track.xy == pytest.approx(in_world(ULM, drive.at(track.stamps_s)[0]), abs=1e-4)


@pytest.mark.parametrize("gap_s", [1.0, 1.8])
def test_who_reverses_beside_a_gap_in_which_it_cannot_turn_keeps_its_heading(gap_s: float) -> None:
    drive = replace(TURN, speeds=((0.0, 1.0), (2.0, 1.0), (4.0, 2.0), (6.0, 8.0)))
    log = cam_log(ULM, car(drive), 7.0, rounded=False)
    at_s = (log.stamps_ns - EPOCH_NS) / 1e9
    log, at_s = (each[(at_s < 2.0) | (at_s > 2.0 + gap_s)] for each in (log, at_s))
    assert np.diff(at_s).max() > gap_s
    track = track_of(replace(log, heading_deg=(log.heading_deg + 180.0 * (at_s < 2.0)) % 360.0))
    assert track.xy == pytest.approx(in_world(ULM, drive.at(track.stamps_s)[0]), abs=1e-3)


def test_a_turn_during_a_gap_is_no_reversing() -> None:
    drive = Drive((0.0, 0.0), 0.0, ((10.0, 0.0), (15.0, 170.0)), ((0.0, 5.0),))
    log = cam_log(ULM, car(drive), 7.0, rounded=False)
    log = log[(log.stamps_ns < EPOCH_NS + 1_900_000_000) | (log.stamps_ns > EPOCH_NS + 5_100_000_000)]
    track = track_of(log)
    assert track.xy == pytest.approx(in_world(ULM, drive.at(track.stamps_s)[0]), abs=1e-4)


def test_speed_that_was_not_sent_follows_from_the_positions() -> None:
    log = cam_log(ULM, car(BRAKE), 5.0)
    track = track_of(replace(log, speed_mps=np.full(len(log), np.nan)))
    assert np.abs(np.degrees(track.yaw_rad) - 30.0).max() < 1.0


@pytest.mark.parametrize("every", [2, 10])
@pytest.mark.parametrize("drive", [NORTH, TURN])
def test_positions_that_are_repeated_until_there_is_a_new_one_are_left_out(drive: Drive, every: int) -> None:
    log = cam_log(ULM, car(drive), 5.0, rate_hz=10.0)
    new = np.arange(len(log)) % every == 0
    last = np.maximum.accumulate(np.where(new, np.arange(len(log)), 0))
    held = replace(log, latitude_deg=log.latitude_deg[last], longitude_deg=log.longitude_deg[last])
    track, expected = track_of(held), track_of(log[new])
    np.testing.assert_array_equal(track.stamps_s, expected.stamps_s)
    np.testing.assert_allclose(track.xy, expected.xy, atol=1e-9)
    assert any("repeat an older position" in remark for remark in track.remarks)


@pytest.mark.filterwarnings("error")
def test_a_position_that_never_changes_though_the_vehicle_moves() -> None:
    log = cam_log(ULM, car(NORTH), 6.0)
    frozen = replace(log, latitude_deg=np.full(len(log), 48.4), longitude_deg=np.full(len(log), 9.9))
    with pytest.raises(CamError, match=f"{len(log) - 1} of {len(log)} messages of station .* repeat an older position"):
        track_of(frozen)


def test_a_vehicle_that_waits_repeats_no_older_position() -> None:
    waits = replace(NORTH, speeds=((0.0, 8.0), (1.0, 8.0), (3.0, 0.0), (6.0, 0.0), (7.0, 8.0)))
    log = cam_log(ULM, car(waits), 9.0, rate_hz=10.0)
    assert len(track_of(log).stamps_s) == len(log)


def test_altitudes_that_are_all_zero_are_unknown() -> None:
    log = cam_log(ULM, car(TURN), 5.0)
    track = track_of(replace(log, altitude_m=np.zeros(len(log))))
    assert track.altitude_m is None
    assert any("0 m as altitude" in remark for remark in track.remarks)
    sea_level_m = np.linspace(-0.05, 0.05, len(log))
    assert track_of(replace(log, altitude_m=sea_level_m)).altitude_m is not None


def test_values_that_a_sender_did_not_know_are_skipped() -> None:
    log = cam_log(ULM, car(TURN), 5.0, rounded=False)
    every_third = np.where(np.arange(len(log)) % 3 == 0, np.nan, 1.0)
    known = track_of(log)
    track = track_of(replace(log, heading_deg=log.heading_deg * every_third, length_m=log.length_m * every_third[::-1]))
    assert track.xy == pytest.approx(known.xy, abs=0.05)
    track = track_of(replace(log, latitude_deg=log.latitude_deg * every_third))
    assert len(track.stamps_s) == np.count_nonzero(np.isfinite(every_third))


def test_an_axis_that_is_not_told_is_as_long_as_the_other() -> None:
    log = cam_log(ULM, car(TURN), 6.0)
    axis, nothing = np.full(len(log), 0.6 * ELLIPSE_SIGMAS), np.full(len(log), np.nan)
    for major, minor in ((axis, nothing), (nothing, axis), (axis, axis)):
        told = track_of(replace(log, semi_major_95_m=major, semi_minor_95_m=minor))
        assert told.position_sigma_m == pytest.approx(0.6)
    assert np.isnan(track_of(replace(log, semi_major_95_m=nothing, semi_minor_95_m=nothing)).position_sigma_m)


@pytest.mark.parametrize("minor", [1.0, 0.5, 0.1])
def test_the_error_of_a_place_is_that_of_the_reported_ellipse(minor: float) -> None:
    log = cam_log(ULM, car(TURN), 6.0)
    axes = np.full(len(log), ELLIPSE_SIGMAS), np.full(len(log), minor * ELLIPSE_SIGMAS)
    track = track_of(replace(log, semi_major_95_m=axes[0], semi_minor_95_m=axes[1]))
    drawn = np.random.default_rng(0).normal(size=(100_000, 2)) * [1.0, minor]
    assert np.sqrt(2.0) * track.position_sigma_m == pytest.approx(np.sqrt((drawn**2).sum(axis=1).mean()), rel=0.01)


def test_accuracy_is_said_only_of_positions_whose_messages_do_not_tell_it() -> None:
    log = cam_log(ULM, car(TURN), 6.0)
    told, nothing = np.full(len(log), 0.6 * ELLIPSE_SIGMAS), np.full(len(log), np.nan)
    for major, minor in ((told, nothing), (nothing, told), (told, told)):
        assert track_of(replace(log, semi_major_95_m=major, semi_minor_95_m=minor).exact_to(2.0)).position_sigma_m == (
            pytest.approx(0.6)
        )
    untold = replace(log, semi_major_95_m=nothing, semi_minor_95_m=nothing)
    assert track_of(untold.exact_to(2.0)).position_sigma_m == pytest.approx(2.0)


def test_stamps_are_exact_far_from_1970() -> None:
    log = cam_log(ULM, car(NORTH), 5.0)
    assert ((track_of(log).stamps_s * 1e9).round().astype(np.int64) == log.stamps_ns - EPOCH_NS).all()


@pytest.mark.parametrize("drive", [NORTH, TURN])
def test_headings_that_were_never_sent_are_those_of_the_motion(drive: Drive) -> None:
    log = cam_log(ULM, car(drive), 6.0)
    known, found = track_of(log), track_of(replace(log, heading_deg=np.full(len(log), np.nan)))
    assert known.remarks == ()
    (remark,) = found.remarks
    assert remark.startswith("the messages report no heading")
    sent = found.xy + rotate_xy(found.yaw_rad, np.tile(found.reference, (len(log), 1)))
    moved = np.diff(sent, axis=0)
    off = wrap(np.arctan2(moved[:, 1], moved[:, 0]) - (found.yaw_rad[1:] + found.yaw_rad[:-1]) / 2.0)
    assert np.degrees(np.abs(off)).max() < 5.0
    assert np.degrees(found.yaw_rad[[0, -1]]) == pytest.approx(np.degrees(known.yaw_rad[[0, -1]]), abs=3.0)


def test_a_two_wheelers_width_is_not_its_bodys() -> None:
    log = cam_log(ULM, car(NORTH), 6.0)
    for width_m, said in ((0.8, 1), (1.0, 1), (1.2, 0), (1.7, 0)):
        sent = replace(log, length_m=np.full(len(log), 2.2), width_m=np.full(len(log), width_m))
        doubts = track_of(sent).objections
        assert ["two-wheelers" in doubt for doubt in doubts] == [True] * said


@pytest.mark.parametrize("count", [0, 1])
def test_too_few_messages(count: int) -> None:
    log = cam_log(ULM, car(NORTH), 2.0)
    with pytest.raises(CamError, match=f"^{count} CAMs with a position.*at least 2"):
        track_of(log[np.arange(len(log)) < count])


def test_messages_that_are_all_far_apart_tell_no_way() -> None:
    log = cam_log(ULM, car(NORTH), 12.0, rate_hz=0.5)
    with pytest.raises(CamError, match=rf"the {len(log)} messages of station 42 are 2\.00 s apart or more; .* 1\.5 s"):
        track_of(log)


def test_a_vehicle_that_stands_still() -> None:
    with pytest.raises(TrackError, match="station 42 stands still"):
        track_of(cam_log(ULM, car(replace(NORTH, speeds=((0.0, 0.0),))), 2.0))


# interpolation


@pytest.mark.parametrize("rate_hz", [1.0, 10.0])
def test_a_braking_vehicle_stays_between_its_positions(rate_hz: float) -> None:
    stamps = np.arange(0.0, 6.0, 1.0 / rate_hz)
    track = plain(stamps, BRAKE.at(stamps)[0].round(2))
    times = np.linspace(0.0, stamps[-1], 997)
    xy, _, known = track.at(times)
    after = np.searchsorted(stamps, times).clip(1)
    both = np.stack([track.xy[after - 1], track.xy[after]])
    assert known.all()
    assert (xy >= both.min(axis=0) - 1e-3).all()
    assert (xy <= both.max(axis=0) + 1e-3).all()
    assert np.abs(xy - BRAKE.at(times)[0]).max() < (0.01 if rate_hz == 10.0 else 0.35)


@given(st.floats(-3.0, 3.0), st.floats(0.0, 40.0), st.lists(st.floats(0.05, 1.0), min_size=2, max_size=20))
def test_a_constant_speed_is_exact(direction: float, speed: float, steps: list[float]) -> None:
    stamps = np.cumsum(steps)
    velocity = speed * np.array([np.cos(direction), np.sin(direction)])
    track = plain(stamps, stamps[:, None] * velocity)
    times = np.linspace(stamps[0], stamps[-1], 33)
    assert track.at(times)[0] == pytest.approx(times[:, None] * velocity, abs=1e-9)


@pytest.mark.parametrize(("rate_hz", "most_m"), [(10.0, 0.01), (5.0, 0.02), (2.0, 0.06), (1.0, 0.15)])
@pytest.mark.parametrize(("radius_m", "speed_mps"), [(10.0, 5.0), (10.0, 8.0), (20.0, 10.0)])
def test_a_circle(radius_m: float, speed_mps: float, rate_hz: float, most_m: float) -> None:
    stamps = np.arange(0.0, 10.0, 1.0 / rate_hz)
    times = np.linspace(2.0, 7.0, 501)
    xy, _, _ = plain(stamps, circle(radius_m, speed_mps, stamps)).at(times)
    assert np.linalg.norm(xy - circle(radius_m, speed_mps, times), axis=1).max() < most_m


@pytest.mark.parametrize("rate_hz", [5.0, 2.0, 1.0])
def test_a_vehicle_that_leaves_a_bend(rate_hz: float) -> None:
    """It unwinds its steering wheel from 25 deg/s in 2 s; a straight line between messages is off by a t^2 / 8."""
    stamps, times = np.arange(-3.0, 5.0, 1.0 / rate_hz), np.linspace(-2.0, 4.0, 601)

    def yaw_deg(at: FloatArray) -> FloatArray:
        unwound = at.clip(0.0, 2.0)
        return 25.0 * (np.minimum(at, 0.0) + unwound - unwound**2 / 4.0)

    track = VehicleTrack(stamps, 0, np.zeros((len(stamps), 2)), np.radians(yaw_deg(stamps)), 4.5, 1.8)
    off_deg = np.abs(np.degrees(track.at(times)[1]) - yaw_deg(times))
    assert off_deg.max() < 12.5 / rate_hz**2 / 8 / 2


@pytest.mark.parametrize("messages", [2, 5])
def test_what_is_beyond_a_gap_does_not_bend_the_way(messages: int) -> None:
    """A vehicle turns right around a corner, and left around the next one while its messages are lost."""
    stamps = np.arange(messages) * 0.5
    lost = np.concatenate([stamps, stamps[-1] + 2.0 + stamps])
    right = circle(10.0, -5.0, stamps)
    xy = np.concatenate([right, right[-1] + np.array([9.0, -9.0]) + circle(10.0, 5.0, stamps)])
    yaw = np.concatenate([-0.5 * stamps, 0.5 * stamps])
    times = np.linspace(0.0, stamps[-1], 51)
    at, _, known = VehicleTrack(lost, 0, xy, yaw, 4.5, 1.8).at(times)
    assert known.all()
    assert np.linalg.norm(at - circle(10.0, -5.0, times), axis=1).max() < 0.03


def test_the_heading_goes_the_short_way_through_north() -> None:
    drive = Drive((0.0, 0.0), 95.0, ((40.0, -10.0),), ((0.0, 10.0),))
    log = cam_log(ULM, car(drive), 4.0)
    assert log.heading_deg.min() < 10.0
    assert log.heading_deg.max() > 350.0
    _, yaw, _ = track_of(log).at(np.linspace(0.0, 4.0, 201))
    assert (np.diff(np.degrees(yaw)) > -0.2).all()
    assert (np.diff(np.degrees(yaw)) < 0.06).all()
    assert np.degrees(np.ptp(yaw)) == pytest.approx(10.0, abs=0.3)


def test_gaps_and_ends_are_unknown() -> None:
    stamps = np.array([0.0, 1.0, 2.0, 3.6, 4.0, 5.5])
    track = plain(stamps, stamps[:, None] * [5.0, 0.0])
    times = np.array([-0.01, 0.0, 0.5, 1.99, 2.0, 2.01, 3.59, 3.61, 4.75, 5.5, 5.51])
    xy, yaw, known = track.at(times)
    assert known.tolist() == [False, True, True, True, True, False, False, True, True, True, False]
    assert (np.isnan(xy[:, 0]) == ~known).all()
    assert (np.isnan(yaw) == ~known).all()
    assert xy[known, 0] == pytest.approx(5.0 * times[known])


def test_two_messages_are_enough() -> None:
    xy, _, known = plain(np.array([0.0, 1.0]), np.array([[0.0, 0.0], [3.0, 4.0]])).at(np.array([0.25, 0.75]))
    assert known.all()
    assert xy == pytest.approx(np.array([[0.75, 1.0], [2.25, 3.0]]))


def test_no_stamps() -> None:
    xy, yaw, known = plain(np.array([0.0, 1.0]), np.zeros((2, 2))).at(np.zeros(0))
    assert xy.shape == (0, 2)
    assert len(yaw) == len(known) == 0


# the log


def test_stations() -> None:
    logs = [
        cam_log(ULM, car(NORTH), last_s, station=station)
        for last_s, station in ((1.0, 7), (4.0, 3), (2.0, 5), (4.0, 2))
    ]
    log = together(logs)
    assert (np.diff(log.stamps_ns) >= 0).all()
    assert log.stations() == [2, 3, 5, 7]
    for one in logs:
        assert (log.of(int(one.station_id[0])).stamps_ns == one.stamps_ns).all()
    assert len(log.of(99)) == 0


@given(st.floats(0.0, 4.0), st.floats(0.0, 4.0), st.floats(1.0, 10.0))
@settings(deadline=None, max_examples=30)
def test_between_keeps_what_interpolation_needs(first_s: float, span_s: float, rate_hz: float) -> None:
    log = cam_log(ULM, car(NORTH), 10.0, rate_hz, first_s=-4.0)
    first, last = EPOCH_NS + round(first_s * 1e9), EPOCH_NS + round((first_s + span_s) * 1e9)
    kept = log.between(first, last)
    assert kept.stamps_ns[0] <= first
    assert kept.stamps_ns[-1] >= last
    assert kept.stamps_ns[0] >= first - MAX_GAP_S * 1e9
    assert kept.stamps_ns[-1] <= last + MAX_GAP_S * 1e9
