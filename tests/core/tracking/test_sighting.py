from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.cloud import Cameras, PointCloud, empty_cloud
from laci_stereo.core.frames import FloatArray, invert, planar, rotate_xy, transform
from laci_stereo.core.settings import Settings, VehicleSettings
from laci_stereo.core.tracking.background import Background, BackgroundBox, learn_background
from laci_stereo.core.tracking.box import Box
from laci_stereo.core.tracking.sighting import KEPT_LOW, KEPT_POINTS, Sighting, dense, find_vehicles, together
from laci_stereo.core.tracking.tracks import Track
from tests.simulated import (
    EPOCH_NS,
    LEFT_TURN,
    Drive,
    Mover,
    Recording,
    Scene,
    Sensor,
    Solid,
    car,
    lidar,
    pedestrian,
    scene,
    stereo,
)

NOTHING = Background((), 0, 0.3)
KINDS = pytest.mark.parametrize("sensor", [lidar(), stereo()], ids=["lidar", "stereo"])


def standing(x: float, y: float, yaw_deg: float = 0.0) -> Drive:
    return Drive((x, y), yaw_deg, speeds=((0.0, 0.0),))


def T_level_sensor(recording: Recording) -> FloatArray:
    forward = recording.T_world_sensor[:3, :3] @ np.array(recording.axes.forward)
    yaw = float(np.arctan2(forward[1], forward[0]))
    return invert(planar(yaw, recording.T_world_sensor[:2, 3])) @ recording.T_world_sensor


def found(made: Scene, background: Background = NOTHING, frame: int = 0, **vehicle: float) -> list[Sighting]:
    settings = Settings(vehicle=replace(VehicleSettings(), **vehicle))
    recording = made.recording
    return find_vehicles(recording.frame(frame), 0.5, T_level_sensor(recording), background, settings)


def alone(drive: Drive, sensor: Sensor | None = None, others: tuple[Mover, ...] = ()) -> Scene:
    """One vehicle on a bare road, seen along x."""
    return scene(drive, sensor, last_s=0.5, others=others, static=(), yaw_deg=0.0)


def behind_the_side_m(points: FloatArray, yaw_deg: float) -> FloatArray:
    """How far behind the sides points are that are seen where these are, from 0.35 to 0.6 m up, along the ray."""
    at, sensor = np.array([17.0, 1.0]), np.array([0.0, 0.0, 6.0])
    xy, origin = (rotate_xy(-np.radians(yaw_deg), each - at) for each in (points[:, :2], np.zeros((len(points), 2))))
    ray = xy - origin
    half = np.array([4.4, 1.8]) / 2
    enter = ((np.sign(origin) * half - origin) / ray).max(axis=1)
    place = origin + enter[:, None] * ray
    z = sensor[2] + enter * (points[:, 2] - sensor[2])
    meets = (np.abs(place) < half + 1e-6).all(axis=1) & (z > 0.35) & (z < 0.6)
    behind_m: FloatArray = ((1.0 - enter) * np.linalg.norm(points - sensor, axis=1))[meets]
    return behind_m


@KINDS
@pytest.mark.parametrize("yaw_deg", [0.0, 30.0, 90.0, 135.0])
def test_a_vehicle_is_found_where_it_is(sensor: Sensor, yaw_deg: float) -> None:
    (only,) = found(alone(standing(17.0, 1.0, yaw_deg), sensor))
    assert only.flaw is None
    assert only.stamp_s == 0.5
    # No centre of what is visible is farther away than half of the vehicle's diagonal.
    assert np.linalg.norm(only.box.centre - [17.0, 1.0]) < np.hypot(4.4, 1.8) / 2
    assert np.linalg.norm(only.middle - [17.0, 1.0]) < np.hypot(4.4, 1.8) / 2
    assert only.box.contains(np.array([17.0, 1.0]), 1.5)
    assert only.box.length_m < 4.4 + 6 * only.sigma_m


@KINDS
def test_the_road_is_removed(sensor: Sensor) -> None:
    made = alone(standing(17.0, 1.0), sensor)
    (only,) = found(made)
    assert only.points[:, 2].min() > VehicleSettings().min_height_m
    assert len(only.points) == min(only.count, KEPT_POINTS)
    assert found(replace(made, recording=replace(made.recording, movers=()))) == []


def test_points_within_their_noise_of_the_road_are_removed() -> None:
    noisy = stereo(sigma_px=1.0)
    made = alone(standing(17.0, 1.0), noisy)
    bare = replace(made, recording=replace(made.recording, movers=()))
    assert found(bare, max_sigma_m=1e9) == []
    assert found(bare, max_sigma_m=1e9, ground_sigmas=0.0) != []


@pytest.mark.slow
def test_where_noise_hides_a_side_in_the_road_its_farther_half_is_kept_as_well() -> None:
    half, whole, sigmas = [], [], []
    for yaw_deg in np.arange(0.0, 360.0, 30.0):
        drive = standing(17.0, 1.0, yaw_deg)
        exact, noisy = (found(alone(drive, stereo(columns=640, sigma_px=noise)))[0] for noise in (0.1, 1.0))
        assert not len(exact.low.points)
        half.append(behind_the_side_m(noisy.points, yaw_deg))
        whole.append(behind_the_side_m(np.concatenate([noisy.points, noisy.low.points]), yaw_deg))
        sigmas.append(np.median(noisy.sigma_along_m))
    of_half, of_whole, sigma_m = np.concatenate(half), np.concatenate(whole), np.median(sigmas)
    assert np.mean(of_half) < -0.5 * sigma_m
    assert len(of_whole) > 100
    assert abs(np.mean(of_whole)) < 3.0 * sigma_m / np.sqrt(len(of_whole))
    assert np.std(of_whole) == pytest.approx(sigma_m, rel=0.2)


@pytest.mark.parametrize("sigma_px", [0.5, pytest.param(1.0, marks=pytest.mark.slow)])
def test_however_much_of_the_road_noise_raises_a_cluster_keeps_points(sigma_px: float) -> None:
    """And as large a share of itself as of that road."""
    sightings = found(alone(standing(17.0, 1.0), stereo(columns=1280, sigma_px=sigma_px)))
    least = VehicleSettings().min_points
    assert all(len(each.points) >= min(each.count, least) for each in sightings)
    vehicle = max(sightings, key=lambda each: each.count)
    assert vehicle.count > 100 * least
    assert least < len(vehicle.points) <= KEPT_POINTS
    assert len(vehicle.low.points) <= KEPT_LOW
    assert len(vehicle.points) == KEPT_POINTS or len(vehicle.low.points) == KEPT_LOW


@KINDS
def test_the_background_is_removed(sensor: Sensor) -> None:
    made = scene(standing(20.0, -1.0), sensor, last_s=0.5, yaw_deg=0.0)
    empty = replace(made.recording, movers=())
    T = T_level_sensor(empty)
    background = learn_background([transform(T, cloud.points) for cloud in empty.survey()], 6.0)
    largest = found(made, background)[0]
    assert np.linalg.norm(largest.box.centre - [20.0, -1.0]) < 2.4
    assert found(made)[0].count > 2 * largest.count


@KINDS
def test_cut_by_the_border_of_the_field_of_view(sensor: Sensor) -> None:
    ys = np.arange(6.0, 34.0, 0.5)
    flaws = [tuple(sighting.flaw for sighting in found(alone(standing(18.0, y, 90.0), sensor))) for y in ys]
    # Inside, on the border for about its length, outside.
    names = [flaw for i, flaw in enumerate(flaws) if i == 0 or flaw != flaws[i - 1]]
    assert names == [(None,), ("cut",), ()]
    assert 4.0 <= flaws.count(("cut",)) * 0.5 <= 6.0


CAMERA = stereo(columns=320, window_px=11)


@pytest.mark.parametrize("yaw_deg", [0.0, 30.0, 90.0, 135.0])
def test_the_borders_of_a_vehicle_are_within_half_a_window_of_where_they_are(yaw_deg: float) -> None:
    (only,) = found(alone(standing(17.0, 1.0, yaw_deg), CAMERA))
    corners = rotate_xy(np.radians(yaw_deg), np.array([(2.2, 0.9), (2.2, -0.9), (-2.2, 0.9), (-2.2, -0.9)]))
    bearings = np.arctan2(corners[:, 1] + 1.0, corners[:, 0] + 17.0)
    seen = np.arctan2(only.borders[:, 1], only.borders[:, 0])
    assert seen == pytest.approx([bearings.min(), bearings.max()], abs=CAMERA.window_rad / 2)
    assert only.borders[:, 2].max() < 0.9


def beside(extra: FloatArray, background: Background = NOTHING) -> Sighting:
    """Return a car seen from behind, 12 m away, with some more points, shape (n, 3), level frame."""
    recording = alone(standing(12.0, 0.0), CAMERA).recording
    cloud, T = recording.frame(0), T_level_sensor(recording)
    count, near = len(extra), int(np.linalg.norm(transform(T, cloud.points)[:, :2] - [9.8, 0.0], axis=1).argmin())
    more = PointCloud(
        cloud.stamp_ns,
        np.concatenate([cloud.points, transform(invert(T), extra)]),
        np.append(cloud.sigma_along_m, np.full(count, cloud.sigma_along_m[near])),
        np.append(cloud.sigma_across_m, np.full(count, cloud.sigma_across_m[near])),
        np.append(cloud.at_edge, np.zeros(count, dtype=bool)),
        window_rad=cloud.window_rad,
    )
    return find_vehicles(more, 0.5, T, background, Settings())[0]


def test_neither_mirrors_nor_a_stray_point_are_borders() -> None:
    plain = beside(np.zeros((0, 3)))
    mirrors = np.array([(11.0, side * y, z) for side in (-1, 1) for y in (0.95, 1.0, 1.1) for z in (0.95, 1.0, 1.1)])
    stray = np.array([(9.9, -1.3, 0.4), (9.9, 1.4, 0.5)])
    for extra in (mirrors, stray):
        more = beside(extra)
        assert more.count == plain.count + len(extra)  # they are of the cluster
        assert more.borders == pytest.approx(plain.borders)


def test_a_border_that_the_background_may_cover_is_not_known() -> None:
    hedge = np.array([(10.0, y, z) for y in (1.2, 1.3, 1.4) for z in np.arange(0.3, 1.5, 0.1)])
    grown = Background((BackgroundBox(Box(np.array([10.0, 1.5]), 2.0, 0.8, 0.0), 1.5),), 1, 0.0)
    known = [np.isfinite(beside(hedge, background).borders[:, 0]).tolist() for background in (NOTHING, grown)]
    assert known == [[True, True], [True, False]]


def test_borders_are_a_cameras() -> None:
    """Of a scanner's next beams nobody knows what they would have met."""
    (only,) = found(alone(standing(17.0, 1.0), lidar()))
    assert np.isnan(only.borders).all()


def test_where_the_field_of_view_ends_no_border_is_known() -> None:
    """A vehicle drives out of it to the left: its right border is seen until the end."""
    seen = [found(alone(standing(18.0, y, 90.0), CAMERA)) for y in (6.0, 9.0, 11.0, 13.0)]
    known = [tuple(np.isfinite(sighting.borders[:, 0])) for (sighting, *_) in filter(None, seen)]
    assert list(dict.fromkeys(known)) == [(True, True), (True, False)]


def test_the_cameras_are_turned_into_the_level_frame() -> None:
    recording = alone(standing(17.0, 1.0), stereo()).recording
    cloud, T = recording.frame(0), T_level_sensor(recording)
    (bare,) = find_vehicles(cloud, 0.5, T, NOTHING, Settings())
    cameras = Cameras(np.array([0.5, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))  # OpenCV's axes
    (seen,) = find_vehicles(replace(cloud, cameras=cameras), 0.5, T, NOTHING, Settings())
    assert bare.cameras is None
    assert seen.cameras is not None
    np.testing.assert_allclose(seen.cameras.baseline_m, 0.5 * T[:3, 0], atol=1e-12)
    np.testing.assert_allclose(seen.cameras.ahead, T[:3, 2], atol=1e-12)
    assert Track((seen,)).cameras is seen.cameras


def test_of_two_pieces_the_outer_borders_are_those_of_both() -> None:
    first, second = (found(alone(standing(17.0, y), CAMERA))[0] for y in (0.0, 2.5))
    for one, other in ((first, second), (second, first)):
        both = together(one, other, Settings()).borders
        assert (both == [first.borders[0], second.borders[1]]).all()
        cut = replace(first, borders=np.array([[np.nan] * 3, first.borders[1]]))
        known = np.isfinite(together(*((cut, other) if one is first else (one, cut)), Settings()).borders[:, 0])
        assert known.tolist() == [False, True]


def test_far() -> None:
    near, far = (found(alone(standing(x, 0.0), stereo()))[0] for x in (25.0, 45.0))
    assert near.flaw is None
    assert far.flaw == "far"
    assert far.sigma_m > VehicleSettings().max_sigma_m > near.sigma_m > 0.1


def test_too_far_to_be_looked_at() -> None:
    assert found(alone(standing(60.0, 0.0), stereo())) == []


def test_thin() -> None:
    (few,) = found(alone(standing(20.0, 0.0), lidar(layers=32, columns=60)), min_points=40)
    assert few.flaw == "thin"
    assert 10 <= few.count < 40
    (walker,) = found(alone(standing(-50.0, 0.0), others=(pedestrian(standing(12.0, 0.0)),)))
    assert walker.flaw == "thin"
    assert walker.count >= VehicleSettings().min_points


def test_what_hangs_over_the_road_is_no_vehicle() -> None:
    sign = Mover(standing(20.0, 0.0, 45.0), (Solid((0.0, 0.0), 0.0, 4.0, 4.0, 4.1, 5.5),))
    assert sum(cloud_heights(alone(standing(-50.0, 0.0), others=(sign,))) > 4.0) > 100
    assert found(alone(standing(-50.0, 0.0), others=(sign,))) == []


def cloud_heights(made: Scene) -> FloatArray:
    return transform(T_level_sensor(made.recording), made.recording.frame(0).points)[:, 2]


def test_the_largest_comes_first() -> None:
    made = alone(standing(15.0, 0.0), others=(car(standing(25.0, 6.0)), pedestrian(standing(20.0, -5.0))))
    counts = [sighting.count for sighting in found(made)]
    assert len(counts) == 3
    assert counts == sorted(counts, reverse=True)


@pytest.mark.parametrize("turn", [0.7, 2.0, -2.5])
def test_a_turned_scene_gives_the_same_sightings(turn: float) -> None:
    made = scene(LEFT_TURN, last_s=2.0, yaw_deg=0.0, static=())
    turned = replace(made, recording=made.recording.turned(turn))
    for one, other in zip(found(made, frame=12), found(turned, frame=12), strict=True):
        assert one.box.centre == pytest.approx(other.box.centre, abs=1e-6)
        assert one.count == other.count


def test_an_empty_frame() -> None:
    assert find_vehicles(empty_cloud(EPOCH_NS), 0.0, np.eye(4), NOTHING, Settings()) == []


def test_dense_drops_what_is_strewn_behind_and_keeps_the_sides() -> None:
    rng = np.random.default_rng(0)
    side = np.column_stack([rng.uniform(0.0, 4.4, 400), rng.normal(0.0, 0.05, 400)])
    strewn = rng.uniform([0.0, 0.5], [4.4, 4.0], (60, 2))
    xy = rotate_xy(0.4, np.concatenate([side, strewn])) + np.array([30.0, -20.0])
    keep = dense(xy, VehicleSettings())
    assert keep[:400].mean() > 0.95
    assert keep[400:].mean() < 0.1


def test_dense_keeps_the_few_points_of_a_sparse_scanner() -> None:
    xy = np.column_stack([np.linspace(0.0, 4.4, 12), np.zeros(12)])
    assert dense(xy, VehicleSettings()).all()
