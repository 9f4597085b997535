"""Logs in which something is wrong, and what is made of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.errors import CamError
from laci_stereo.core.frames import BoolArray, FloatArray
from laci_stereo.core.messages.cam import CENTRE, FRONT, CamLog, ReferencePoint, VehicleTrack, vehicle_track
from laci_stereo.core.world import World
from tests.simulated import EPOCH_NS, SYDNEY, ULM, Drive, Place, cam_log, car

TURN = Drive((0.0, 0.0), 200.0, ((20.0, 0.0), (15.0, 90.0)), ((0.0, 8.0), (4.0, 8.0), (6.0, 4.0)))
STOP = Drive((0.0, 0.0), 30.0, speeds=((0.0, 9.0), (2.0, 9.0), (5.0, 0.0), (8.0, 0.0), (10.0, 5.0)))
BEND = Drive((0.0, 0.0), 0.0, ((5.0, 0.0), (11.0, -90.0)), ((0.0, 6.0),))
"""A radius of 7 m, in which the front goes 17 deg aside of where it points."""

BACKING = Drive(
    (0.0, 0.0),
    30.0,
    ((20.0, 0.0), (20.0, 150.0)),
    ((0.0, 6.0), (3.0, 6.0), (5.0, 0.0), (5.5, 0.0), (6.5, -2.5), (9.0, -2.5), (10.0, 0.0), (10.5, 0.0), (13.0, 5.0)),
)
"""Backs up by 9 m within a bend with a radius of 8 m, with headings of its motion."""

DRIVES = {"turn": TURN, "stop": STOP}


def log_of(drive: Drive) -> CamLog:
    return cam_log(ULM, car(drive), 12.0, reference=(0.0, 0.0))


def track_of(log: CamLog, place: Place = ULM, reference: ReferencePoint = CENTRE) -> VehicleTrack:
    return vehicle_track(log, World.around(place.latitude_deg, place.longitude_deg), EPOCH_NS, reference)


def told(length_m: float, width_m: float) -> VehicleTrack:
    log = log_of(TURN)
    return track_of(
        replace(log, length_m=np.full(len(log), round(length_m, 1)), width_m=np.full(len(log), round(width_m, 1)))
    )


def moved(log: CamLog, which: BoolArray, north_m: FloatArray | float, east_m: FloatArray | float) -> CamLog:
    """Shift the positions of some messages."""
    north, east = np.broadcast_to(north_m, len(log)), np.broadcast_to(east_m, len(log))
    cos = np.cos(np.radians(log.latitude_deg))
    return replace(
        log,
        latitude_deg=log.latitude_deg + np.where(which, north / 111_200, 0.0),
        longitude_deg=log.longitude_deg + np.where(which, east / (111_200 * cos), 0.0),
    )


def error_m(track: VehicleTrack, drive: Drive, place: Place = ULM) -> FloatArray:
    world = World.around(place.latitude_deg, place.longitude_deg)
    error: FloatArray = np.linalg.norm(track.xy - world.from_utm(place.to_utm(drive.at(track.stamps_s)[0])), axis=1)
    return error


@pytest.mark.parametrize("place", [ULM, SYDNEY], ids=["Ulm", "Sydney"])
@pytest.mark.parametrize("rate_hz", [10.0, 2.0])
@pytest.mark.parametrize("drive", [TURN, STOP, BEND], ids=["turn", "stop", "bend"])
def test_nothing_is_left_out_of_a_log_without_mistakes(drive: Drive, rate_hz: float, place: Place) -> None:
    for reference in (CENTRE, FRONT):
        log = cam_log(place, car(drive), 12.0, rate_hz, reference=(0.0, 0.0) if reference is CENTRE else None)
        track = track_of(log, place, reference)
        assert len(track.stamps_s) == len(log)
        assert track.remarks == ()


@pytest.mark.parametrize("turn_deg", [300.0, -300.0])
def test_a_bus_in_a_bend_whose_front_tells_its_own_course_and_the_speed_of_the_wheels(turn_deg: float) -> None:
    around = Drive((0.0, 0.0), 45.0, ((40.0, turn_deg),), ((0.0, 4.0),))
    log = cam_log(ULM, car(around, 12.0, 2.5), 8.0, 2.0, first_s=0.0)
    # The front is 6 m ahead of what moves where the body points: a quarter faster, and 38 deg aside.
    aside_deg = np.degrees(np.arctan(6.0 * np.radians(turn_deg) / 40.0))
    own = replace(log, heading_deg=(log.heading_deg - aside_deg) % 360.0)
    assert len(track_of(own, reference=FRONT).stamps_s) == len(log)
    wrong = np.arange(len(log)) % 4 == 2
    assert len(track_of(moved(own, wrong, 3.0, -3.0), reference=FRONT).stamps_s) == np.count_nonzero(~wrong)


def test_a_vehicle_that_reverses_and_tells_where_its_body_points() -> None:
    log = log_of(STOP)
    back = log.stamps_ns > EPOCH_NS + int(6.5e9)
    turned = replace(log, heading_deg=np.where(back, log.heading_deg + 180.0, log.heading_deg) % 360.0)
    assert len(track_of(turned).stamps_s) == len(log)


@pytest.mark.parametrize("rate_hz", [10.0, 2.0, 1.0])
@pytest.mark.parametrize("length_m", [4.4, 5.9])
def test_nothing_is_left_out_where_a_vehicle_backs_up_within_a_bend(length_m: float, rate_hz: float) -> None:
    """The direction of its motion turns over, but the front stays where it is."""
    log = cam_log(ULM, car(BACKING, length_m, 1.9), 13.0, rate_hz).exact_to(0.02)
    assert len(track_of(log, reference=FRONT).stamps_s) == len(log)


@pytest.mark.parametrize("length_m", [4.4, 5.9])
def test_wrong_positions_are_left_out_where_a_vehicle_backs_up_within_a_bend(length_m: float) -> None:
    log = cam_log(ULM, car(BACKING, length_m, 1.9), 13.0).exact_to(0.02)
    wrong = np.arange(len(log)) % 5 == 3
    assert len(track_of(moved(log, wrong, 2.0, -2.0), reference=FRONT).stamps_s) == np.count_nonzero(~wrong)


@pytest.mark.parametrize("reference", [CENTRE, FRONT], ids=["centre", "front"])
def test_a_wrong_heading_does_not_turn_those_after_it_over(reference: ReferencePoint) -> None:
    log = cam_log(ULM, car(BEND), 4.0, 5.0, reference=(0.0, 0.0) if reference is CENTRE else None)
    for wrong in range(8, 16):
        # From the wrong heading it is less than a right angle to the next one, but not from the one before.
        heading = log.heading_deg.copy()
        heading[wrong] += 95.0
        track = track_of(replace(log, heading_deg=heading % 360.0), reference=reference)
        assert len(log) - 1 <= len(track.stamps_s)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("drive", DRIVES.values(), ids=DRIVES)
def test_wrong_positions_in_a_third_of_the_messages(drive: Drive, seed: int) -> None:
    log, rng = log_of(drive), np.random.default_rng(seed)
    wrong = rng.random(len(log)) < 0.3
    track = track_of(moved(log, wrong, *rng.uniform(-15.0, 15.0, (2, len(log)))))
    assert len(track.stamps_s) >= np.count_nonzero(~wrong)
    # What is as near as that to where it should be cannot be told from what a receiver does.
    assert error_m(track, drive).max() < 0.8
    assert f"of {len(log)} messages of station 42 are left out" in track.remarks[0]


def test_half_of_the_messages_lost() -> None:
    log = log_of(TURN)
    got = log[np.random.default_rng(0).random(len(log)) < 0.5]
    assert len(track_of(got).stamps_s) == len(got)


@pytest.mark.parametrize("at_s", [3.0, 8.0])
def test_after_a_jump_that_stays_the_longer_part_is_kept(at_s: float) -> None:
    log = log_of(TURN)
    later = log.stamps_ns > EPOCH_NS + int(at_s * 1e9)
    track = track_of(moved(log, later, 0.8, -0.6))
    longer = later if 2 * np.count_nonzero(later) > len(log) else ~later
    assert np.array_equal((track.stamps_s * 1e9).round().astype(np.int64) + EPOCH_NS, log.stamps_ns[longer])


def test_speeds_that_were_never_sent_are_not_missed() -> None:
    log = log_of(TURN)
    wrong = np.arange(len(log)) % 4 == 2
    bad = moved(replace(log, speed_mps=np.full(len(log), np.nan)), wrong, 5.0, 5.0)
    track = track_of(bad)
    assert error_m(track, TURN).max() < 0.8
    assert len(track.stamps_s) == np.count_nonzero(~wrong)


@pytest.mark.parametrize(("change", "told"), [("speed_mps", 3.6), ("heading_deg", 0.0)])
def test_messages_that_contradict_one_another(change: str, told: float) -> None:
    log = log_of(TURN)
    wrong = log.speed_mps * told if change == "speed_mps" else (log.heading_deg + 90.0) % 360.0
    with pytest.raises(
        CamError, match=r"station 42 contradict one another: .* needed is half; the reported speed is .* m/s"
    ):
        track_of(replace(log, **{change: wrong}))


@pytest.mark.parametrize(("unit", "per_mps"), [("km/h", 3.6), ("knots", 1.9438), ("miles per hour", 2.2369)])
def test_speeds_in_another_unit_are_named(unit: str, per_mps: float) -> None:
    log = log_of(TURN)
    with pytest.raises(CamError, match=f"likely: speed is in {unit}$"):
        track_of(replace(log, speed_mps=per_mps * log.speed_mps))


def test_two_messages_that_contradict_one_another_are_no_track() -> None:
    log = log_of(TURN)[np.array([20, 21])]
    with pytest.raises(CamError, match=r"contradict one another: 1 of 2 positions"):
        track_of(moved(log, np.array([False, True]), 0.0, 111.0))


# dimensions


def test_length_and_width_exchanged() -> None:
    with pytest.raises(CamError, match=r"width, 4\.70 m, exceeds its length, 1\.80 m; exchanged\?"):
        told(1.8, 4.7)


def test_a_car_without_dimensions_is_taken_for_a_usual_one() -> None:
    log = log_of(TURN)
    unknown = np.full(len(log), np.nan)
    track = track_of(replace(log, length_m=unknown, width_m=unknown))
    assert track.guessed_m[0] > 0.2 > track.guessed_m[1] > 0.05
    # Half of a metre on either side are the cars of every day.
    for length_m, width_m in ((3.7, 1.65), (4.4, 1.8), (5.1, 1.95)):
        assert abs(track.length_m - length_m) < 2.0 * track.guessed_m[0]
        assert abs(track.width_m - width_m) < 2.0 * track.guessed_m[1]
    assert [("length" in remark, "width" in remark) for remark in track.remarks] == [(True, False), (False, True)]


def test_a_lorry_without_width_is_as_wide_as_allowed() -> None:
    log = log_of(TURN)
    track = track_of(replace(log, length_m=np.full(len(log), 11.8), width_m=np.full(len(log), np.nan)))
    assert (track.length_m, track.width_m, track.guessed_m[0]) == (11.8, 2.55, 0.0)
    assert "lorry" in track.remarks[0]


def test_a_width_over_the_mirrors_is_none_of_a_body() -> None:
    lorry, allowed = told(11.8, 2.9), told(11.8, 2.6)
    assert lorry.width_m == 2.55
    assert "2.90 m, more than roads allow (2.6 m)" in lorry.remarks[0]
    assert (allowed.width_m, allowed.guessed_m, allowed.remarks) == (2.6, (0.0, 0.0), ())


def test_a_bus_without_length_is_refused() -> None:
    log = log_of(TURN)
    bus = replace(log, length_m=np.full(len(log), np.nan), width_m=np.full(len(log), 2.55))
    with pytest.raises(CamError, match=r"length is in none of the \d+ messages, and its width, 2\.55 m"):
        track_of(bus)


def test_a_wrong_row_does_not_change_the_dimensions() -> None:
    log = log_of(TURN)
    length = log.length_m.copy()
    length[3] = 42.0
    assert track_of(replace(log, length_m=length)).length_m == 4.4


BODIES = [
    ("Volkswagen Polo", 4.07, 1.751, 1.964),
    ("Volkswagen Golf", 4.28, 1.789, 2.073),
    ("Renault Clio", 4.05, 1.798, 1.988),
    ("Ford Focus", 4.38, 1.825, 1.979),
    ("Fiat 500", 3.57, 1.627, 1.893),
    ("Volkswagen Tiguan", 4.51, 1.839, 2.099),
    ("Tesla Model 3", 4.69, 1.849, 2.088),
    ("Volvo XC60", 4.69, 1.902, 2.117),
    ("Volkswagen Transporter", 4.90, 1.904, 2.297),
    ("Mercedes Sprinter", 5.93, 2.020, 2.345),
    ("Fiat Ducato", 5.41, 2.050, 2.508),
    ("Ford Transit", 5.53, 2.059, 2.474),
]
"""Length, width and width over the mirrors, as the makers tell them."""


@pytest.mark.parametrize(("name", "length_m", "width_m", "over_mirrors_m"), BODIES)
def test_a_width_is_that_of_the_body_whether_mirrors_were_counted_or_not(
    name: str, length_m: float, width_m: float, over_mirrors_m: float
) -> None:
    for width in (width_m, over_mirrors_m):
        taken = told(length_m, width)
        sigma_m = np.hypot(taken.guessed_m[1], 0.05)
        assert abs(taken.width_m - width_m) < 2.5 * sigma_m < 0.4, name


def test_a_usual_width_is_taken_as_it_is_told() -> None:
    for _, length_m, width_m, _ in BODIES:
        taken = told(length_m, width_m)
        assert taken.width_m == round(width_m, 1)
        assert taken.guessed_m[1] < 0.08
        assert not taken.remarks


def test_it_is_said_that_a_width_is_over_the_mirrors() -> None:
    taken = told(4.2, 2.2)
    assert abs(taken.width_m - 1.77) < 0.06
    assert any("2.20 m" in remark and "over its mirrors" in remark for remark in taken.remarks)


@pytest.mark.parametrize("length_m", [1.9, 2.2, 2.5, 3.0, 4.0])
def test_nothing_is_wider_than_it_tells(length_m: float) -> None:
    for width_m in np.arange(0.5, 1.9, 0.1):
        assert told(length_m, width_m).width_m <= round(float(width_m), 1) + 1e-9


def test_a_bus_is_as_wide_as_it_tells() -> None:
    assert (told(12.0, 2.5).width_m, told(12.0, 2.5).guessed_m[1]) == (2.5, 0.0)
