from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.errors import BackgroundError
from laci_stereo.core.frames import FloatArray, invert, planar, transform
from laci_stereo.core.settings import BackgroundSettings
from laci_stereo.core.tracking.background import Background, BackgroundBox, learn_background
from laci_stereo.core.tracking.box import Box
from tests.simulated import (
    LEFT_TURN,
    STOP_AND_GO,
    STRAIGHT,
    Drive,
    Mover,
    Recording,
    Scene,
    Sensor,
    Solid,
    lidar,
    pedestrian,
    scene,
    shrub,
    stereo,
)

HEIGHT_M = 6.0
SENSORS = [lidar(), stereo()]
KINDS = pytest.mark.parametrize("sensor", SENSORS, ids=["lidar", "stereo"])


def clouds_level(recording: Recording) -> list[FloatArray]:
    """The survey in the true level frame."""
    return [transform(T_level_sensor(recording), cloud.points) for cloud in recording.survey()]


def T_level_sensor(recording: Recording) -> FloatArray:
    forward = recording.T_world_sensor[:3, :3] @ np.array(recording.axes.forward)
    return (
        invert(planar(np.arctan2(forward[1], forward[0]), recording.T_world_sensor[:2, 3])) @ recording.T_world_sensor
    )


def learnt(made: Scene) -> Background:
    return learn_background(clouds_level(made.recording), HEIGHT_M)


def on_drive(made: Scene, width: float = 0.6) -> FloatArray:
    """Points all over the vehicle's path in the level frame, where it is well in view."""
    xy, yaw = made.vehicle.drive.at(made.recording.times_s)
    across = np.column_stack([-np.sin(yaw), np.cos(yaw)])
    path = np.concatenate([xy + offset * across for offset in (-width / 2, 0.0, width / 2)])
    T = T_level_sensor(made.recording) @ invert(made.recording.T_world_sensor)
    level = transform(T, np.column_stack([path, np.zeros(len(path))]))[:, :2]
    return level[np.abs(np.arctan2(level[:, 1], level[:, 0])) < np.radians(45.0)]


def visible(solid: Solid, made: Scene) -> FloatArray:
    """What is seen of a solid that stands alone, level frame."""
    cloud = clouds_level(replace(made.recording, movers=(), static=(solid,), surveyed=1))[0]
    return cloud[cloud[:, 2] > 0.6][:, :2]


@KINDS
@pytest.mark.parametrize(
    ("start_s", "quiet"),
    [(8.0, "first"), (-9.0, "last"), (2.5, "both"), (0.0, "few")],
)
def test_the_road_stays_free_and_the_houses_are_known(sensor: Sensor, start_s: float, quiet: str) -> None:
    made = scene(replace(STRAIGHT, start_s=start_s), sensor, last_s=10.0)
    background = learnt(made)
    assert not background.covers(on_drive(made)).any()
    assert background.quiet_frames >= 3
    found = np.concatenate(clouds_level(replace(made.recording, movers=())))
    standing = found[(found[:, 2] > 0.6) & (found[:, 2] < 3.9) & (np.hypot(found[:, 0], found[:, 1]) < 25.0)]
    assert background.covers(standing[:, :2]).mean() > 0.97


@KINDS
def test_no_frame_is_quiet(sensor: Sensor) -> None:
    made = scene(LEFT_TURN, sensor)
    background = learnt(made)
    assert background.quiet_frames == 0
    assert not background.covers(on_drive(made)).any()
    parked = made.recording.static[3]
    assert background.covers(visible(parked, made)).mean() > 0.9


@KINDS
@pytest.mark.parametrize("stands_s", [1.5, 3.0, 6.0])
def test_a_vehicle_that_waits_and_goes_is_no_background(sensor: Sensor, stands_s: float) -> None:
    starts = ((0.0, 0.0), (stands_s, 0.0), (stands_s + 1.0, 8.0))
    made = scene(Drive((22.0, 6.0), -90.0, speeds=starts), sensor, last_s=8.0)
    assert not learnt(made).covers(on_drive(made)).any()


def test_a_queue_at_a_traffic_light_is_no_background() -> None:
    # Three cars wait one after the other at the same place: it is taken in most of the frames, but not always.
    cars = [
        replace(scene(STOP_AND_GO).recording.movers[0], drive=replace(STOP_AND_GO, start_s=start))
        for start in (0.0, 4.0)
    ]
    made = scene(replace(STOP_AND_GO, start_s=8.0), others=cars, last_s=14.0, yaw_deg=0.0)
    assert not learnt(made).covers(on_drive(made)).any()


@KINDS
def test_a_parked_car_is_background(sensor: Sensor) -> None:
    made = scene(STRAIGHT, sensor)
    points = visible(made.recording.static[3], made)
    assert len(points) > 50
    assert learnt(made).covers(points).mean() > 0.95


def test_an_l_shaped_building_does_not_cover_the_street() -> None:
    wings = (Solid((32.0, 0.0), 0.0, 2.0, 24.0, 0.0, 8.0), Solid((23.0, 11.0), 0.0, 16.0, 2.0, 0.0, 8.0))
    frames = clouds_level(replace(scene(static=wings, yaw_deg=0.0).recording, movers=()))
    background = learn_background(frames, HEIGHT_M)
    yard = np.stack(np.meshgrid(np.linspace(16.0, 29.5, 20), np.linspace(-10.0, 8.5, 20)), axis=-1).reshape(-1, 2)
    # A piece as small as a box may be fills the very corner.
    street = yard[np.any(yard < [28.0, 7.0], axis=1)]
    assert not background.covers(street).any()
    assert background.covers(np.concatenate([frame[frame[:, 2] > 0.6, :2] for frame in frames])).mean() > 0.97


def test_boxes_lie_where_the_solids_are() -> None:
    made = scene(static=(Solid((20.0, 3.0), 20.0, 5.0, 2.0, 0.0, 2.0),), yaw_deg=0.0)
    only = max(
        learn_background(clouds_level(replace(made.recording, movers=())), HEIGHT_M).boxes,
        key=lambda static: static.box.length_m,
    )
    assert only.box.centre == pytest.approx([20.0, 3.0], abs=0.3)
    assert sorted([only.box.length_m, only.box.width_m]) == pytest.approx([2.0, 5.0], abs=0.3)
    assert np.degrees(only.box.yaw_rad) == pytest.approx(20.0, abs=2.0)
    assert only.height_m == pytest.approx(2.0, abs=0.1)


def test_a_shrub_that_flickers_in_quiet_frames_is_background() -> None:
    made = scene(replace(STRAIGHT, start_s=8.0), others=[shrub((20.0, -4.0), 0.4, 0.6)], last_s=10.0)
    mover = made.recording.movers[1]
    xy, yaw = mover.drive.at(np.zeros(1))
    assert learnt(made).covers(visible(mover.parts[0].moved(xy[0], yaw[0]), made)).mean() > 0.9


def test_who_walks_by_in_quiet_frames_is_no_background() -> None:
    walk = pedestrian(Drive((18.0, -9.0), 90.0, speeds=((0.0, 1.4),)))
    made = scene(replace(STRAIGHT, start_s=9.0), others=[walk], last_s=12.0)
    xy, _ = made.recording.movers[1].drive.at(made.recording.times_s)
    T = T_level_sensor(made.recording) @ invert(made.recording.T_world_sensor)
    background = learnt(made)
    assert background.quiet_frames >= 4
    covered = background.covers(transform(T, np.column_stack([xy, np.zeros(len(xy))]))[:, :2])
    assert covered.mean() < 0.1


def test_noise_far_below_and_far_away_changes_nothing() -> None:
    frames = clouds_level(scene().recording)
    rng = np.random.default_rng(0)
    noisy = [
        np.concatenate([frame, rng.uniform(-1.0, 1.0, (20, 3)) * [1e6, 1e6, 5.0], rng.uniform(-50, -1, (300, 3))])
        for frame in frames
    ]
    here = np.concatenate(frames)
    here = here[here[:, 0] < 45.0, :2]
    same = learn_background(frames, HEIGHT_M).covers(here) == learn_background(noisy, HEIGHT_M).covers(here)
    assert same.mean() > 0.995


def test_an_empty_survey() -> None:
    with pytest.raises(BackgroundError, match="0 whole frames"):
        learn_background([], HEIGHT_M)


def test_a_bare_road_has_no_background() -> None:
    made = scene(static=())
    background = learn_background(clouds_level(replace(made.recording, movers=())), HEIGHT_M)
    assert background.boxes == ()
    assert background.quiet_frames == len(clouds_level(made.recording))
    assert not background.covers(on_drive(made)).any()


def test_margin() -> None:
    made = scene(static=(Solid((20.0, 0.0), 0.0, 5.0, 2.0, 0.0, 2.0),), yaw_deg=0.0)
    frames = clouds_level(replace(made.recording, movers=()))
    edge = visible(made.recording.static[0], made).min(axis=0) - [0.5, 0.0]
    for margin, covered in ((0.3, False), (0.7, True)):
        background = learn_background(frames, HEIGHT_M, BackgroundSettings(margin_m=margin))
        assert background.covers(np.array([[edge[0], 0.0]]))[0] == covered


def test_a_bus_that_hardly_leaves_its_place_is_no_background_where_the_road_behind_is_not_seen() -> None:
    made = scene(Drive((21.0, 6.0), -90.0, speeds=((0.0, 1.8),)), lidar(layers=16), last_s=10.0)
    bus = Mover(made.vehicle.drive, (Solid((0.0, 0.0), 0.0, 11.0, 2.5, 0.3, 3.0),))
    recording = replace(made.recording, movers=(bus,), surveyed=20)
    background = learn_background(clouds_level(recording), HEIGHT_M)
    assert not background.covers(on_drive(replace(made, recording=recording), 2.4)).any()
    empty = clouds_level(replace(recording, movers=()))[0]
    standing = empty[(empty[:, 2] > 0.6) & (empty[:, 2] < 3.9)]
    assert background.covers(standing[:, :2]).mean() > 0.97


@pytest.mark.parametrize("margin_m", [0.0, 0.3])
def test_what_is_covered_is_what_lies_in_any_box(margin_m: float) -> None:
    rng = np.random.default_rng(0)
    boxes = [
        Box(rng.uniform(-20.0, 20.0, 2), float(length), float(length) * 0.4, float(rng.uniform(-1.57, 1.57)))
        for length in rng.uniform(0.1, 12.0, 15)
    ]
    edges = [(one.corners() - one.centre) * (1.0 + side) + one.centre for one in boxes for side in (-1e-9, 1e-3)]
    xy = np.concatenate([rng.uniform(-25.0, 25.0, (5000, 2)), *edges])
    background = Background(tuple(BackgroundBox(box, 2.0) for box in boxes), 0, margin_m)
    covered = np.any([box.contains(xy, margin_m) for box in boxes], axis=0)
    assert 0 < covered.sum() < len(xy)
    assert np.array_equal(background.covers(xy), covered)
    assert not Background((), 0, margin_m).covers(xy).any()
