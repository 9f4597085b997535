from __future__ import annotations

import numpy as np
import pytest

from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.vehicle.tractrix import LEVERS_M
from tests.simulated import Drive

TURN = Drive((0.0, 0.0), 20.0, ((15.0, 0.0), (14.0, 90.0), (6.0, -40.0)), ((0.0, 7.0), (3.0, 4.0), (6.0, 8.0)))


def driven(lever_m: float, backwards: bool = False) -> tuple[VehicleTrack, FloatArray, FloatArray]:
    """Return the track of a point ahead of the rear axle with its direction of motion as heading, and the body's yaw.

    The rear axle follows the drive, so its direction is the body's.
    """
    stamps = np.arange(-3.0, 8.0, 0.05)
    rear, yaw = TURN.at(-stamps if backwards else stamps)
    point = rear + rotate_xy(yaw, np.tile([lever_m, 0.0], (len(yaw), 1)))
    motion = np.gradient(point, stamps, axis=0) * (-1.0 if backwards else 1.0)
    heading = np.unwrap(np.arctan2(motion[:, 1], motion[:, 0]))
    heading += 2 * np.pi * np.round((yaw - heading).mean() / (2 * np.pi))
    return VehicleTrack(stamps, 0, point, heading, 4.6, 1.8), stamps, yaw


@pytest.mark.parametrize("backwards", [False, True], ids=["forwards", "reversing"])
@pytest.mark.parametrize("lever_m", [1.0, 2.7, 3.75, 6.0, 12.0])
def test_the_body_follows_the_point(lever_m: float, backwards: bool) -> None:
    track, stamps, yaw = driven(lever_m, backwards)
    by_heading = np.degrees(np.abs(track.yaw_rad - yaw)).max()
    assert by_heading > 4 * lever_m
    turned, _ = track.body.at(stamps, lever_m)
    off = np.degrees(np.abs(track.yaw_rad + turned - yaw))
    # The way's curvature jumps four times, and with it the heading: around these messages it is anything in between.
    assert np.percentile(off, 90) < 0.1
    assert off.max() < 0.15 * by_heading


def test_without_a_lever_the_heading_is_the_body_s() -> None:
    for track, stamps, _ in (driven(3.0), driven(3.0, backwards=True), steered(3.0, THREE_POINTS)):
        turned, _ = track.body.at(stamps, 0.0)
        assert (turned == 0.0).all()
        assert (track.body.begun_at(stamps, 0.0)[0] == 0.0).all()


def test_on_a_straight_road_levers_do_not_matter() -> None:
    stamps = np.arange(0.0, 5.0, 0.1)
    track = VehicleTrack(stamps, 0, np.column_stack([7.0 * stamps, 0.0 * stamps]), 0.0 * stamps, 4.6, 1.8)
    turned, by_lever = track.body.at(stamps, 3.0)
    assert turned == pytest.approx(0.0)
    assert by_lever == pytest.approx(0.0)


@pytest.mark.parametrize("lever_m", [0.2, 1.3, 3.7, 7.9, 13.1])
def test_the_derivative_is_that_of_the_turn(lever_m: float) -> None:
    track, stamps, _ = driven(3.0)
    body = track.body
    _, by_lever = body.at(stamps, lever_m)
    more, less = body.at(stamps, lever_m + 1e-4)[0], body.at(stamps, lever_m - 1e-4)[0]
    assert by_lever == pytest.approx((more - less) / 2e-4, abs=1e-6)
    assert lever_m < LEVERS_M[-1]


@pytest.mark.parametrize("backwards", [False, True], ids=["forwards", "reversing"])
@pytest.mark.parametrize("rate_hz", [10.0, 2.0])
@pytest.mark.parametrize(("lever_m", "radius_m"), [(2.7, 8.0), (3.7, 12.0), (6.0, 12.0)])
def test_messages_that_begin_in_a_bend_leave_open_how_the_body_stands_in_it(
    lever_m: float, radius_m: float, rate_hz: float, backwards: bool
) -> None:
    """In a circle the body is turned by asin(lever / radius of the point's way), or will be after a while."""
    stamps = np.arange(0.0, 8.0, 1.0 / rate_hz)
    around = 5.0 * stamps / radius_m * (-1.0 if backwards else 1.0)
    point = radius_m * np.column_stack([np.sin(around), -np.cos(around)])
    track = VehicleTrack(stamps, 0, point, around, 4.6, 1.8)
    (turned, _), (begun, _) = track.body.at(stamps, lever_m), track.body.begun_at(stamps, lever_m)
    settled = np.arcsin(lever_m / radius_m)
    first, last = (-1, 0) if backwards else (0, -1)
    assert np.degrees(turned[first] + begun[first]) == pytest.approx(0.0, abs=0.1)
    assert np.degrees(np.abs(turned - begun + settled)).max() < 1.0
    assert np.degrees(np.abs([turned[last] + settled, begun[last]])).max() < 0.1 * np.degrees(settled)


@pytest.mark.parametrize("lever_m", [1.3, 3.7, 7.9])
def test_the_derivative_is_that_of_what_the_begin_leaves_open(lever_m: float) -> None:
    body, stamps = driven(3.0)[0].body, np.linspace(0.0, 4.0, 41)
    more, less = body.begun_at(stamps, lever_m + 1e-4)[0], body.begun_at(stamps, lever_m - 1e-4)[0]
    assert body.begun_at(stamps, lever_m)[1] == pytest.approx((more - less) / 2e-4, abs=1e-6)


TO_AND_FRO = ((0.0, 5.0), (4.0, 5.0), (6.0, 0.0), (6.5, 0.0), (7.5, -2.5), (10.5, -2.5), (11.5, 0.0), (12.0, 0.0))


def steered(
    lever_m: float, curvatures: tuple[tuple[float, float], ...], rate_hz: float = 10.0, last_s: float = 16.0
) -> tuple[VehicleTrack, FloatArray, FloatArray]:
    """Return the same as `driven` for a vehicle that backs up by 10 m: its rear axle's path has these curvatures.

    ``curvatures`` are (time in s, 1/m to the left), linear in between: wheels may turn while the vehicle stands.
    """
    times = np.arange(0.0, last_s, 1e-3)
    speed = np.interp(times, *np.array([*TO_AND_FRO, (13.0, 4.0)]).T)
    curvature = np.interp(times, *np.array(curvatures).T)
    yaw = np.cumsum(curvature * speed) * 1e-3
    rear = np.cumsum(speed[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw)]), axis=0) * 1e-3
    point = rear + lever_m * np.column_stack([np.cos(yaw), np.sin(yaw)])
    heading = yaw + np.arctan(lever_m * curvature)
    sent = np.arange(0, len(times), round(1e3 / rate_hz))
    return VehicleTrack(times[sent], 0, point[sent], heading[sent], 4.6, 1.8), times[sent], yaw[sent]


BEND = ((0.0, 0.0), (2.0, 0.0), (2.8, 0.1), (20.0, 0.1))
THREE_POINTS = (
    (0.0, 0.0),
    (2.0, 0.0),
    (2.8, 0.12),
    (6.0, 0.12),
    (6.5, -0.12),
    (11.5, -0.12),
    (12.0, 0.12),
    (20.0, 0.12),
)


@pytest.mark.parametrize("rate_hz", [10.0, 4.0])
@pytest.mark.parametrize("lever_m", [2.7, 3.75, 5.0])
@pytest.mark.parametrize("curvatures", [BEND, THREE_POINTS], ids=["one bend", "three-point turn"])
def test_the_body_follows_the_point_to_and_fro(
    curvatures: tuple[tuple[float, float], ...], lever_m: float, rate_hz: float
) -> None:
    track, stamps, yaw = steered(lever_m, curvatures, rate_hz)
    assert np.degrees(np.abs(track.yaw_rad - yaw)).max() > 5 * lever_m
    (turned, _), (begun, _) = track.body.at(stamps, lever_m), track.body.begun_at(stamps, lever_m)
    off = np.degrees(track.yaw_rad + turned - yaw)
    assert np.abs(off[stamps < 6.0]).max() < 0.5
    # What is not known of the body where it begins to back up has grown by exp(10 m / lever) when it drives on.
    assert (np.abs(off) < 0.5 + 1.5 * np.degrees(np.abs(begun))).all()
    assert np.abs(off).max() < 0.6 * np.degrees(np.abs(track.yaw_rad - yaw)).max()


@pytest.mark.parametrize("lever_m", [2.7, 3.75, 5.0])
def test_how_the_body_stood_at_the_beginning_tells_how_it_stands_after_backing_up(lever_m: float) -> None:
    """In a circle, in which the body has settled: what is not known of it is one number for the whole drive."""
    track, stamps, yaw = steered(lever_m, ((0.0, 0.1), (20.0, 0.1)))
    short = stamps > 4.0  # 5 m forwards, 10 m back, and on
    part = VehicleTrack(stamps[short], 0, track.xy[short], track.yaw_rad[short], 4.6, 1.8)
    (turned, _), (begun, _) = (way(stamps[short], lever_m) for way in (part.body.at, part.body.begun_at))
    off = part.yaw_rad + turned - yaw[short]
    by_begin = float(off @ begun / (begun @ begun))
    assert np.degrees(np.abs(off)).max() > 5.0
    assert 0.5 < by_begin < 1.5
    assert np.degrees(np.abs(off - by_begin * begun)).max() < 2.0


def test_positions_that_scatter_while_the_vehicle_stands_are_no_way_back() -> None:
    track, stamps, yaw = steered(3.75, BEND, last_s=6.4)
    late = np.concatenate([stamps, stamps[-1] + np.arange(1, 100) / 10.0])
    xy = np.vstack([track.xy, np.tile(track.xy[-1], (99, 1))])
    xy[len(stamps) :] += np.random.default_rng(0).normal(scale=0.1, size=(99, 2))
    heading = np.append(track.yaw_rad, np.full(99, track.yaw_rad[-1]))
    turned, _ = VehicleTrack(late, 0, xy, heading, 4.6, 1.8).body.at(late, 3.75)
    assert np.degrees(np.abs((heading + turned)[len(stamps) :] - yaw[-1])).max() < 2.0
