"""Roads that slope."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.combine import combine
from laci_stereo.core.frames import FloatArray, invert, transform
from laci_stereo.core.messages.cam import CENTRE, FRONT, CamLog, ReferencePoint, VehicleTrack, vehicle_track
from laci_stereo.core.messages.slope import slope_of
from laci_stereo.core.result import Calibration
from laci_stereo.core.tracking.reframing import moved_vehicle, reported_on_map
from laci_stereo.core.world import World
from tests.simulated import (
    EPOCH_NS,
    LEFT_TURN,
    STRAIGHT,
    SYDNEY,
    ULM,
    Drive,
    Place,
    Scene,
    cam_log,
    car,
    lidar,
    scene,
    together,
)

TURN = Drive((0.0, 0.0), 200.0, ((30.0, 0.0), (20.0, 90.0), (20.0, 0.0)), ((0.0, 8.0),))
AHEAD = Drive((0.0, 0.0), 20.0, ((80.0, 0.0),), ((0.0, 8.0),))


def tilted(log: CamLog, place: Place, percent: float, towards_deg: float, pivot: FloatArray) -> CamLog:
    """Lay a drive on a slope: what was along the ground becomes shorter on the map, and higher uphill."""
    world = World.around(place.latitude_deg, place.longitude_deg)
    uphill = direction(towards_deg)
    angle = np.arctan(percent / 100)
    xy = world.from_geodetic(log.latitude_deg, log.longitude_deg)
    up_m = (xy - pivot) @ uphill
    latitude, longitude = world.to_geodetic(shortened(xy, percent, towards_deg, pivot)).T
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


def direction(yaw_deg: float) -> FloatArray:
    return np.array([np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))])


def shortened(xy: FloatArray, percent: float, towards_deg: float, pivot: FloatArray) -> FloatArray:
    """Return where places along the ground are on the map."""
    uphill = direction(towards_deg)
    return xy + (np.cos(np.arctan(percent / 100)) - 1.0) * ((xy - pivot) @ uphill)[:, None] * uphill


def on_ground(log: CamLog, world: World, reference: ReferencePoint = CENTRE) -> VehicleTrack:
    """Return a drive along the ground, as its own altitudes tell it."""
    track = vehicle_track(log, world, EPOCH_NS, reference)
    xy, yaw_rad = reported_on_map(track)
    return moved_vehicle(track, xy, yaw_rad, None if track.altitude_m is None else slope_of([(xy, track.altitude_m)]))


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
    on_level, on_slope = (on_ground(log, world) for log in (level, sloping))
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
    slope = on_ground(sloping, World.around(ULM.latitude_deg, ULM.longitude_deg)).slope
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
    _, sloping = drive_on(ULM, AHEAD, 6.0, 20.0)
    slope = on_ground(sloping, World.around(ULM.latitude_deg, ULM.longitude_deg)).slope
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


@pytest.mark.parametrize("percent", [0.0, 6.0])
@pytest.mark.parametrize("step_m", [-3.0, -0.7, 0.7, 1.0, 20.0])
@pytest.mark.parametrize("at", [30, 40, 60])
@pytest.mark.parametrize("noise_m", [0.0, 0.03])
def test_altitudes_that_step_tell_the_slope_before_and_after(
    percent: float, step_m: float, at: int, noise_m: float
) -> None:
    xy = np.column_stack([np.linspace(0.0, 60.0, 80), np.zeros(80)])
    altitude_m = 560.37 + percent / 100 * xy[:, 0] + np.random.default_rng(at).normal(0.0, noise_m, 80)
    altitude_m[at:] += step_m
    slope = slope_of([(xy, altitude_m.round(2))])
    assert slope is not None
    assert slope.gradient[0] == pytest.approx(percent / 100, abs=3 * np.sqrt(slope.covariance[0, 0]))
    assert np.sqrt(slope.covariance[0, 0]) < 0.005


@pytest.mark.parametrize("percent", [6.0, 10.0])
def test_altitudes_in_whole_metres_have_no_steps(percent: float) -> None:
    xy = np.column_stack([np.linspace(0.0, 60.0, 80), np.zeros(80)])
    slope = slope_of([(xy, (560.3 + percent / 100 * xy[:, 0]).round())])
    assert slope is not None
    assert slope.gradient[0] == pytest.approx(percent / 100, abs=3 * np.sqrt(slope.covariance[0, 0]))
    assert np.sqrt(slope.covariance[0, 0]) < 0.02


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
    assert on_ground(level, World.around(ULM.latitude_deg, ULM.longitude_deg)).slope is None


def test_what_is_along_the_ground_lies_where_it_was_told_on_the_map() -> None:
    _, sloping = drive_on(ULM, TURN, 10.0, 130.0)
    world = World.around(ULM.latitude_deg, ULM.longitude_deg)
    track = vehicle_track(sloping, world, EPOCH_NS, FRONT)
    laid = on_ground(sloping, world, FRONT)
    assert np.abs(laid.xy - track.xy).max() > 0.05
    assert laid.slope is not None
    xy, yaw_rad = reported_on_map(laid)
    assert xy == pytest.approx(world.from_geodetic(sloping.latitude_deg, sloping.longitude_deg), abs=1e-6)
    assert yaw_rad == pytest.approx(track.yaw_rad, abs=1e-12)
    on_ground_3d = np.column_stack([laid.xy, np.zeros(len(laid.xy))])
    assert transform(laid.slope.T_enu_world, on_ground_3d)[:, :2] == pytest.approx(laid.slope.on_map(laid.xy), abs=1e-9)
    assert moved_vehicle(laid, xy, yaw_rad, None).xy == pytest.approx(track.xy, abs=1e-6)


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


PERCENT, TOWARDS_DEG = 8.0, -55.0
"""Along the straight ways of what follows."""


def approaching() -> tuple[Scene, FloatArray]:
    """Return a drive that is recorded over 300 m, of which the last 40 are seen, and these, metres in the scene."""
    lead_m = 14.0 * 20.0 + 2.0 * 13.5
    speeds = ((0.0, 20.0), (14.0, 20.0), (16.0, 7.0))
    drive = Drive((30.0, 15.0 + lead_m), -90.0, ((8.0 + lead_m, 0.0), (11.0, -90.0)), speeds)
    made = scene(drive, lidar(32, 160), last_s=22.0, frames_hz=5.0)
    return made, made.recording.movers[0].drive.at(np.arange(16.5, 21.5, 0.1))[0]


def misplaced(found: Calibration, made: Scene, xy: FloatArray, true_utm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how far off on the map places on the ground are by ``T_utm_sensor``, and by ``T_enu_sensor``."""
    sensor = transform(invert(made.recording.T_world_sensor), np.column_stack([xy, np.zeros(len(xy))]))
    T_enu_sensor = found.T_world_sensor if found.T_enu_sensor is None else found.T_enu_sensor
    rigid_utm, exact = transform(found.T_utm_sensor, sensor)[:, :2], transform(T_enu_sensor, sensor)[:, :2]
    return rigid_utm - true_utm, found.world.to_utm(exact) - true_utm


@pytest.mark.slow
@pytest.mark.parametrize("log", ["untold", "plane", "hill"])
def test_places_in_view_are_right_on_the_map_whatever_the_road_does_before(log: str) -> None:
    made, seen = approaching()  # at 14 s 27 m of the straight are left before it brakes into the view
    world = World.around(made.place.latitude_deg, made.place.longitude_deg)
    seen_world = world.from_utm(made.place.to_utm(seen))
    messages = tilted(made.messages, made.place, PERCENT, TOWARDS_DEG, seen_world.mean(axis=0))
    before_m = 240.0 - 20.0 * (messages.stamps_ns - EPOCH_NS) / 1e9
    if log == "hill":
        messages = replace(messages, altitude_m=messages.altitude_m + 0.12 * np.maximum(before_m, 0.0))
    elif log == "untold":
        messages = replace(messages, altitude_m=np.full(len(messages), np.nan))
    found = calibrate(made.recording, messages)
    true_utm = world.to_utm(shortened(seen_world, PERCENT, TOWARDS_DEG, seen_world.mean(axis=0)))
    rigid, exact = misplaced(found, made, seen, true_utm)
    assert np.linalg.norm(rigid.mean(axis=0)) < 0.03
    from_middle_m = np.linalg.norm(seen - seen.mean(axis=0), axis=1)
    assert (np.linalg.norm(rigid, axis=1) < 0.03 + from_middle_m * (PERCENT / 100) ** 2 / 2).all()
    if log != "untold":
        assert found.slope is not None
        assert found.slope.pivot == pytest.approx(found.centre_world[:2], abs=1e-9)
        assert found.slope.steepness == pytest.approx(PERCENT / 100, abs=3e-3)
        assert np.linalg.norm(exact, axis=1).max() < 0.02
        ground_utm = found.world.to_utm(found.centre_world[None, :2])[0]
        centre_sensor = transform(invert(found.T_world_sensor), found.centre_world[None])
        assert transform(found.T_utm_sensor, centre_sensor)[0, :2] == pytest.approx(ground_utm, abs=1e-6)


def on_one_slope(made: Scene, told: bool, towards_deg: float) -> CamLog:
    world = World.around(made.place.latitude_deg, made.place.longitude_deg)
    pivot = world.from_utm(made.place.to_utm(np.zeros((1, 2))))[0]
    messages = tilted(made.messages, made.place, PERCENT, towards_deg, pivot)
    return messages if told else replace(messages, altitude_m=np.full(len(messages), np.nan))


def check_on_one_slope(found: Calibration, logs: dict[int, CamLog], towards_deg: float) -> None:
    """Hold all drives of a result against where their messages are on the map, and against each other's ground."""
    assert found.slope is not None
    assert len(found.passages) == 2
    for each in found.passages:
        assert each.vehicle.slope is not None
        assert each.vehicle.slope.pivot == pytest.approx(found.centre_world[:2], abs=1e-9)
        assert each.vehicle.slope.gradient == pytest.approx(PERCENT / 100 * direction(towards_deg), abs=0.025)
        assert np.array_equal(each.vehicle.slope.gradient, found.slope.gradient)
        log = logs[each.station_id]
        on_map = found.world.from_geodetic(log.latitude_deg, log.longitude_deg)
        assert reported_on_map(each.vehicle)[0] == pytest.approx(on_map, abs=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("told", [(True, False), (False, True)])
def test_drives_with_and_without_altitudes_lie_along_one_ground(told: tuple[bool, bool]) -> None:
    passages, logs = [], {}
    for number, (drive, has) in enumerate(zip((LEFT_TURN, STRAIGHT), told, strict=True)):
        made = scene(drive, lidar(32, 160), frames_hz=5.0, seed=number)
        log = on_one_slope(made, has, TOWARDS_DEG)
        logs[42 + number] = log = replace(log, station_id=log.station_id + number)
        (passage,) = calibrate(made.recording, log).passages
        epoch_ns = passage.vehicle.epoch_ns + number * 86_400_000_000_000
        passages.append(replace(passage, name=f"{number}", vehicle=replace(passage.vehicle, epoch_ns=epoch_ns)))
    found = combine(passages).calibration
    check_on_one_slope(found, logs, TOWARDS_DEG)
    world = World.around(made.place.latitude_deg, made.place.longitude_deg)
    places = world.from_utm(made.place.to_utm(made.recording.movers[0].drive.at(np.arange(1.0, 5.0, 0.5))[0]))
    pivot = world.from_utm(made.place.to_utm(np.zeros((1, 2))))[0]
    true_utm = world.to_utm(shortened(places, PERCENT, TOWARDS_DEG, pivot))
    _, exact = misplaced(found, made, made.recording.movers[0].drive.at(np.arange(1.0, 5.0, 0.5))[0], true_utm)
    assert np.linalg.norm(exact, axis=1).max() < 0.05


@pytest.mark.slow
def test_senders_with_and_without_altitudes_lie_along_one_ground() -> None:
    made = scene(STRAIGHT, lidar(32, 160), frames_hz=5.0, seed=5)
    cars = car(STRAIGHT), car(Drive((25.5, -16.0), 90.0, speeds=((0.0, 6.0),)), 4.6, 1.85)
    logs = {42 + i: cam_log(made.place, each, 6.0, station=42 + i) for i, each in enumerate(cars)}
    logs = {station: on_one_slope(replace(made, messages=log), station == 43, 90.0) for station, log in logs.items()}
    found = calibrate(replace(made.recording, movers=cars), together(list(logs.values())))
    check_on_one_slope(found, logs, 90.0)
