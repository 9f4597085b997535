"""Roads that slope."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.cam import CENTRE, CamLog, vehicle_track
from laci_stereo.core.frames import FloatArray, transform
from laci_stereo.core.slope import slope_of
from laci_stereo.core.world import World
from tests.simulated import EPOCH_NS, LEFT_TURN, SYDNEY, ULM, Drive, Place, cam_log, car, lidar, scene

TURN = Drive((0.0, 0.0), 200.0, ((30.0, 0.0), (20.0, 90.0), (20.0, 0.0)), ((0.0, 8.0),))
STRAIGHT = Drive((0.0, 0.0), 20.0, ((80.0, 0.0),), ((0.0, 8.0),))


def tilted(log: CamLog, place: Place, percent: float, towards_deg: float, pivot: FloatArray) -> CamLog:
    """Lay a drive on a slope: what was along the ground becomes shorter on the map, and higher uphill."""
    world = World.around(place.latitude_deg, place.longitude_deg)
    uphill = np.array([np.cos(np.radians(towards_deg)), np.sin(np.radians(towards_deg))])
    angle = np.arctan(percent / 100)
    xy = world.from_geodetic(log.latitude_deg, log.longitude_deg)
    up_m = (xy - pivot) @ uphill
    east_north = xy + (np.cos(angle) - 1.0) * up_m[:, None] * uphill
    latitude, longitude = world.to_geodetic(east_north).T
    yaw = world.yaw_from_heading(log.heading_deg, log.latitude_deg, log.longitude_deg)
    ahead = np.column_stack([np.cos(yaw), np.sin(yaw)])
    shorter = ahead + (np.cos(angle) - 1.0) * (ahead @ uphill)[:, None] * uphill
    turned = np.arctan2(shorter[:, 1], shorter[:, 0]) - np.arctan2(ahead[:, 1], ahead[:, 0])
    return replace(
        log,
        latitude_deg=latitude,
        longitude_deg=longitude,
        heading_deg=log.heading_deg - np.degrees(turned),
        altitude_m=(560.0 + np.sin(angle) * up_m).round(2),
    )


def drive_on(place: Place, drive: Drive, percent: float, towards_deg: float) -> tuple[CamLog, CamLog]:
    """Return the messages of a drive on the level, and of the same on a slope."""
    level = cam_log(place, car(drive), 8.0, reference=(0.0, 0.0), rounded=False)
    world = World.around(place.latitude_deg, place.longitude_deg)
    pivot = world.from_geodetic(level.latitude_deg, level.longitude_deg).mean(axis=0)
    return level, tilted(level, place, percent, towards_deg, pivot)


@pytest.mark.parametrize("place", [ULM, SYDNEY], ids=["Ulm", "Sydney"])
@pytest.mark.parametrize("percent", [3.0, 10.0])
@pytest.mark.parametrize("towards_deg", [0.0, 130.0])
def test_distances_are_those_along_the_ground(place: Place, percent: float, towards_deg: float) -> None:
    level, sloping = drive_on(place, TURN, percent, towards_deg)
    world = World.around(place.latitude_deg, place.longitude_deg)
    on_level, on_slope = (vehicle_track(log, world, EPOCH_NS, CENTRE) for log in (level, sloping))
    assert on_level.slope is None
    assert on_slope.slope is not None
    off = on_slope.slope.gradient - percent / 100 * np.array(
        [np.cos(np.radians(towards_deg)), np.sin(np.radians(towards_deg))]
    )
    assert off @ np.linalg.solve(on_slope.slope.covariance, off) < 9.0
    apart = [track.xy[-1] - track.xy[0] for track in (on_level, on_slope)]
    missing_m = np.linalg.norm(apart[0]) * percent**2 / 2e4
    assert apart[1] == pytest.approx(apart[0], abs=max(0.1 * missing_m, 2e-3))
    assert on_slope.yaw_rad == pytest.approx(on_level.yaw_rad, abs=1e-3)


def test_up_is_against_gravity() -> None:
    _, sloping = drive_on(ULM, TURN, 8.0, 70.0)
    slope = vehicle_track(sloping, World.around(ULM.latitude_deg, ULM.longitude_deg), EPOCH_NS, CENTRE).slope
    assert slope is not None
    uphill = np.array([np.cos(np.radians(70.0)), np.sin(np.radians(70.0))])
    ahead = np.append(slope.pivot + 100.0 * uphill, 0.0)
    up = transform(slope.T_enu_world, ahead[None])[0]
    angle = np.arctan(0.08)
    assert up[2] == pytest.approx(100.0 * np.sin(angle), abs=0.1)
    assert up[:2] == pytest.approx(slope.pivot + 100.0 * np.cos(angle) * uphill, abs=0.1)
    R = slope.T_enu_world[:3, :3]
    assert np.allclose(R @ R.T, np.eye(3))
    on_map = slope.along_ground(up[None, :2])[0]
    assert on_map == pytest.approx(ahead[:2], abs=1e-9)


def test_a_straight_drive_tells_the_slope_along_it_only() -> None:
    _, sloping = drive_on(ULM, STRAIGHT, 6.0, 20.0)
    slope = vehicle_track(sloping, World.around(ULM.latitude_deg, ULM.longitude_deg), EPOCH_NS, CENTRE).slope
    assert slope is not None
    across = np.array([-np.sin(np.radians(20.0)), np.cos(np.radians(20.0))])
    assert np.sqrt(across @ slope.covariance @ across) == pytest.approx(0.025, rel=0.1)


@pytest.mark.parametrize("seed", range(10))
def test_a_level_road_is_seldom_taken_for_a_slope(seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy = np.column_stack([np.linspace(0.0, 60.0, 80), 3.0 * np.sin(np.linspace(0.0, 2.0, 80))])
    wandering = 0.04 * np.repeat(rng.normal(size=8), 10)
    slope = slope_of([(xy, 230.0 + wandering + rng.normal(0.0, 0.01, 80))])
    assert slope is not None
    assert slope.steepness == 0.0
    assert np.array_equal(slope.T_enu_world, np.eye(4))
    assert np.array_equal(slope.along_ground(xy), xy)


@pytest.mark.parametrize("percent", [3.0, 8.0])
@pytest.mark.parametrize(
    ("wrong", "off_m"),
    [(slice(40, 41), -560.0), (slice(0, 1), 560.0), (slice(0, 5), -20.0), (slice(75, 80), 1.0), (slice(38, 42), 3.0)],
)
def test_altitudes_that_do_not_follow_from_the_others_count_for_nothing(
    percent: float, wrong: slice, off_m: float
) -> None:
    rng = np.random.default_rng(0)
    xy = np.column_stack([np.linspace(0.0, 60.0, 80), np.zeros(80)])
    altitude_m = 560.0 + percent / 100 * xy[:, 0] + rng.normal(0.0, 0.02, 80)
    altitude_m[wrong] += off_m
    slope = slope_of([(xy, altitude_m)])
    assert slope is not None
    assert slope.gradient[0] == pytest.approx(percent / 100, abs=3 * np.sqrt(slope.covariance[0, 0]))
    assert np.sqrt(slope.covariance[0, 0]) < 0.002


def test_each_receivers_altitudes_count_from_a_height_of_its_own() -> None:
    xy = np.column_stack([np.linspace(0.0, 40.0, 40), np.zeros(40)])
    farther = xy + np.array([60.0, 0.0])
    slope = slope_of([(xy, 560.0 + 0.05 * xy[:, 0]), (farther, 512.0 + 0.05 * farther[:, 0])])
    assert slope is not None
    assert slope.gradient == pytest.approx([0.05, 0.0], abs=1e-3)


def test_a_receiver_that_tells_nonsense_does_no_harm() -> None:
    xy = np.column_stack([np.linspace(0.0, 60.0, 60), np.zeros(60)])
    nonsense = np.array([0.0, 9000.0, -400.0])
    slope = slope_of([(xy, 560.0 + 0.05 * xy[:, 0]), (xy[:3], nonsense)])
    assert slope is not None
    assert slope.gradient == pytest.approx([0.05, 0.0], abs=1e-3)


@pytest.mark.parametrize(
    ("told", "way_m", "noise_m"),
    [(slice(3, 4), 60.0, 0.0), (slice(0, 2), 60.0, 0.0), (slice(0, 80), 5.0, 0.02), (slice(0, 80), 60.0, 3.0)],
    ids=["one", "two", "on a short way", "noisy"],
)
def test_altitudes_that_would_not_show_a_slope_tell_no_level_road(told: slice, way_m: float, noise_m: float) -> None:
    rng = np.random.default_rng(0)
    xy = np.column_stack([np.linspace(0.0, way_m, 80), np.zeros(80)])
    altitude_m = np.full(80, np.nan)
    altitude_m[told] = 560.0 + rng.normal(0.0, noise_m, 80)[told]
    assert slope_of([(xy, altitude_m)]) is None


def test_without_altitudes_nothing_is_known() -> None:
    level, _ = drive_on(ULM, TURN, 5.0, 0.0)
    track = vehicle_track(level, World.around(ULM.latitude_deg, ULM.longitude_deg), EPOCH_NS, CENTRE)
    assert track.slope is None


@pytest.mark.slow
def test_a_sensor_above_a_slope() -> None:
    made = scene(LEFT_TURN, lidar())
    world = World.around(made.place.latitude_deg, made.place.longitude_deg)
    messages = made.messages
    pivot = world.from_geodetic(messages.latitude_deg, messages.longitude_deg).mean(axis=0)
    level = calibrate(made.recording, messages)
    found = calibrate(made.recording, tilted(messages, made.place, 8.0, 30.0, pivot))
    # Along the ground everything is as on the level; at 20 m from the pivot 6 cm would be missing else.
    assert found.T_utm_sensor[:3] == pytest.approx(level.T_utm_sensor[:3], abs=0.01)
    T_enu_sensor = found.T_enu_sensor
    assert T_enu_sensor is not None
    # What is upright on the slope leans by its angle.
    normal = T_enu_sensor[:3, :3] @ found.T_world_sensor[:3, :3].T @ np.array([0.0, 0.0, 1.0])
    assert np.arccos(normal[2]) == pytest.approx(np.arctan(0.08), abs=3e-3)
    assert level.T_enu_sensor is None
