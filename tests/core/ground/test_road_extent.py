from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.frames import FORWARD_LEFT_UP_AXES as AXES
from laci_stereo.core.frames import FloatArray, along_line, rigid
from laci_stereo.core.ground.road_extent import HALF_VEHICLE_M, REACH_M, Road, places, prolonged, road_along
from laci_stereo.core.settings import GroundSettings
from laci_stereo.core.tracking.tracks import Track
from tests.core.tracks import sighting

HEIGHT_M, SIGMA_M = 6.0, 0.02
WAY_Y_M = 15.0
T_LEVEL_SENSOR = rigid(np.eye(3), np.array([0.0, 0.0, HEIGHT_M]))


def way() -> FloatArray:
    return np.column_stack([np.arange(-15.0, 15.0, 0.5), np.full(60, WAY_Y_M)])


def cloud(height_of: FloatArray, xy: FloatArray, sigma_m: float = SIGMA_M) -> PointCloud:
    """Return points at some heights, with the noise of ranges."""
    rng = np.random.default_rng(0)
    points = np.column_stack([xy, height_of - HEIGHT_M])
    points *= 1.0 + rng.normal(0.0, sigma_m, len(points))[:, None] / np.linalg.norm(points, axis=1)[:, None]
    noise = np.full(len(points), sigma_m)
    return PointCloud(0, points, noise, 0.01 * noise, np.zeros(len(points), dtype=bool))


def plan(step_m: float, half_m: float = 12.0) -> FloatArray:
    x, y = np.meshgrid(np.arange(-20.0, 20.0, step_m), np.arange(WAY_Y_M - half_m, WAY_Y_M + half_m, step_m))
    return np.column_stack([x.ravel(), y.ravel()])


@pytest.mark.parametrize("kerb_m", [0.06, 0.12])
@pytest.mark.parametrize("half_m", [2.0, pytest.param(4.0, marks=pytest.mark.slow)])
def test_a_road_ends_at_its_kerbs(half_m: float, kerb_m: float) -> None:
    xy = plan(0.2)
    beyond = np.abs(xy[:, 1] - WAY_Y_M) - half_m
    # The pavement falls by 2.5 % towards the road.
    height = np.where(beyond > 0.0, kerb_m + 0.025 * beyond, 0.0)
    road = road_along(way(), [cloud(height, xy)], T_LEVEL_SENSOR, AXES, np.zeros(3), GroundSettings())
    assert road is not None
    surface = road.found
    assert half_m - 0.5 < np.abs(surface.cells.left_m).max() < half_m + 0.5


def test_a_low_kerb_with_a_pavement_behind_it_ends_a_road_with_a_crown() -> None:
    """The road falls to the kerb and the pavement rises from it, so a surface that bends up fits both."""
    xy = plan(0.2)
    left_m = xy[:, 1] - WAY_Y_M
    beyond = -left_m - 5.4
    road = -0.018 * np.abs(left_m - 1.5)
    height = np.where(beyond > 0.0, -0.018 * 6.9 + 0.045 + 0.03 * beyond, road)
    road = road_along(way(), [cloud(height, xy, 0.05)], T_LEVEL_SENSOR, AXES, np.zeros(3), GroundSettings())
    assert road is not None
    surface = road.found
    assert 4.0 < -surface.cells.left_m.min() < 5.4
    value, covariance, _ = surface.plane()
    assert abs(value[2]) < 3.0 * np.sqrt(covariance[2, 2])
    assert np.degrees(abs(value[2])) < 0.2


@pytest.mark.slow
@pytest.mark.parametrize(("fall", "sigma_m"), [(0.04, 0.02), (0.06, 0.05), (0.05, 0.1)])
@pytest.mark.parametrize("half_m", [4.0, 4.25])
def test_a_verge_with_level_land_behind_it_is_no_other_side_of_a_crown(
    half_m: float, fall: float, sigma_m: float
) -> None:
    xy = plan(0.25)
    height = -fall * (WAY_Y_M - half_m - xy[:, 1]).clip(0.0, 2.0)
    road = road_along(way(), [cloud(height, xy, sigma_m)], T_LEVEL_SENSOR, AXES, np.zeros(3), GroundSettings())
    assert road is not None
    surface = road.found
    assert -surface.cells.left_m.min() < half_m + 0.5
    value, covariance, _ = surface.plane()
    assert value[1:] @ np.linalg.solve(covariance[1:, 1:], value[1:]) < 9.0
    assert np.degrees(np.linalg.norm(value[1:])) < 0.2


@pytest.mark.parametrize(
    ("fall", "sigma_m"),
    [(0.03, 0.1), *(pytest.param(*each, marks=pytest.mark.slow) for each in ((0.05, 0.1), (0.04, 0.02), (0.06, 0.05)))],
)
def test_verges_in_different_directions_are_both_left_out(fall: float, sigma_m: float) -> None:
    """One is beside the way, one across a corner: no single edge is in front of both, and land follows on either."""
    xy = plan(0.25)
    beside_m = WAY_Y_M - 4.0 - xy[:, 1]
    corner_m = (xy[:, 0] + xy[:, 1] - WAY_Y_M) / np.sqrt(2.0) - 11.6
    height = -fall * np.maximum(beside_m, corner_m).clip(0.0, 2.0)
    road = road_along(way(), [cloud(height, xy, sigma_m)], T_LEVEL_SENSOR, AXES, np.zeros(3), GroundSettings())
    assert road is not None
    surface = road.found
    x, y = surface.cells.xy.T
    assert y.min() > WAY_Y_M - 4.5
    assert ((x + y - WAY_Y_M) / np.sqrt(2.0)).max() < 11.6 + 0.5
    value, covariance, _ = surface.plane()
    assert value[1:] @ np.linalg.solve(covariance[1:, 1:], value[1:]) < 9.0


def crossing(rng: np.random.Generator, askew_rad: float) -> PointCloud:
    """Two roads with crowns and kerbs that cross: each point is as high as the nearer crown makes it."""
    fall, crown_m, at_m, sigma_m, half_m = rng.uniform([0.012, 1.2, -12.0, 0.01, 3.5], [0.025, 2.2, 12.0, 0.04, 7.0])
    xy = plan(0.4) + rng.uniform(-0.2, 0.2, 2)
    across = np.array([[0.0, np.cos(askew_rad)], [1.0, np.sin(askew_rad)]])
    away_m = np.abs((xy - [at_m, WAY_Y_M + crown_m]) @ across).min(axis=1)
    height = np.where(away_m > half_m, 0.08, 0.0) - fall * away_m.clip(0.0, half_m)
    waves = 0.004 * np.sin(xy @ rng.normal(0.0, 0.3, 2) + rng.uniform(0.0, 2.0 * np.pi))
    return cloud(height + waves, xy, sigma_m)


def tilt_of_crossing(seed: int, askew_deg: float) -> tuple[float, float]:
    """Return how far the road of one is tilted, degrees, and the chi-square of its slopes."""
    scan = crossing(np.random.default_rng(seed), np.radians(askew_deg))
    road = road_along(way(), [scan], T_LEVEL_SENSOR, AXES, np.zeros(3), GroundSettings())
    assert road is not None
    value, covariance, _ = road.found.plane()
    doubt = covariance + road.apart()
    return float(np.degrees(np.linalg.norm(value[1:]))), value[1:] @ np.linalg.solve(doubt[1:, 1:], value[1:])


@pytest.mark.slow
@pytest.mark.parametrize(("askew_deg", "seeds"), [(0.0, 4), *((at, 16) for at in (0.0, 15.0, 45.0))])
def test_roads_that_cross_are_level_where_both_fall_from_their_crowns(askew_deg: float, seeds: int) -> None:
    tilts_deg, squares = np.transpose([tilt_of_crossing(seed, askew_deg) for seed in range(seeds)])
    assert np.median(tilts_deg) < 0.1
    # Where the mouth of one of them passes for an edge it is tilted more, but not without doubt.
    assert squares.max() < 3.0**2
    # The mean of 16 chi-squares of two degrees of freedom: 2.0 +- 0.5.
    assert np.mean(squares) < 3.5


@pytest.mark.slow
@pytest.mark.parametrize("turned_rad", [part * np.pi / 16 for part in range(4)])
def test_a_verge_of_a_road_that_the_way_turns_into_does_not_tilt_it(turned_rad: float) -> None:
    """It is straight, and the way is not; which direction that is in the sensor's frame does not matter."""
    turn = np.array([[np.cos(turned_rad), -np.sin(turned_rad)], [np.sin(turned_rad), np.cos(turned_rad)]])
    at_rad = np.arange(0.0, np.pi / 2, 0.08)
    turning = [-4.0, 11.0] + 5.75 * np.column_stack([np.cos(at_rad), np.sin(at_rad)])
    before = np.column_stack([np.full(10, 1.75), np.arange(6.0, 11.0, 0.5)])
    behind = np.column_stack([np.arange(-4.5, -9.0, -0.5), np.full(9, 16.75)])
    x, y = np.meshgrid(np.arange(-9.0, 18.0, 0.2), np.arange(6.0, 22.0, 0.2))
    xy = np.column_stack([x.ravel(), y.ravel()])
    xy = xy[(xy[:, 1] > 12.5) | (np.abs(xy[:, 0]) < 3.5)]
    verge = -0.045 * np.clip(xy[:, 1] - 18.5, 0.0, 2.0)
    turned = np.concatenate([before, turning, behind]) @ turn.T
    road = road_along(turned, [cloud(verge, xy @ turn.T)], T_LEVEL_SENSOR, AXES, np.zeros(3), GroundSettings())
    assert road is not None
    value, covariance, _ = road.found.plane()
    assert value[1:] @ np.linalg.solve(covariance[1:, 1:], value[1:]) < 3.0**2
    assert np.degrees(np.linalg.norm(value[1:])) < 0.15


@pytest.mark.slow
def test_an_even_square_is_road_as_far_as_it_is_looked_at() -> None:
    xy = plan(0.2, 22.0)
    road = road_along(way(), [cloud(np.zeros(len(xy)), xy)], T_LEVEL_SENSOR, AXES, np.zeros(3), GroundSettings())
    assert road is not None
    surface = road.found
    assert surface.cells.left_m.min() < -0.9 * REACH_M
    assert surface.cells.left_m.max() > 0.9 * REACH_M


@pytest.mark.slow
def test_what_all_points_err_by_alike_does_not_hide_the_road() -> None:
    # A quarter of 0.4 m is common to all heights: the road is known to 4 cm by it, but no part of it against another.
    xy = plan(0.05)
    road = road_along(way(), [cloud(np.zeros(len(xy)), xy, 0.4)], T_LEVEL_SENSOR, AXES, np.zeros(3), GroundSettings())
    assert road is not None
    surface = road.found
    assert surface.cells.left_m.max() - surface.cells.left_m.min() > REACH_M


@pytest.mark.slow
def test_what_stands_on_the_way_is_no_road() -> None:
    xy = plan(0.2)
    on_way = (np.abs(xy[:, 1] - WAY_Y_M) < HALF_VEHICLE_M) & (xy[:, 0] > 2.0)
    scan = cloud(np.where(on_way, 0.5, 0.0), xy)
    road = road_along(way(), [scan], T_LEVEL_SENSOR, AXES, np.zeros(3), GroundSettings())
    assert road is not None
    assert np.abs(road.found.cells.z).max() < 0.1


def test_rings_of_a_scan_are_not_as_steep_as_its_lines_of_sight() -> None:
    # One ring of a noisy scanner passes along the way: across it only its noise tells a slope, that of the rays.
    azimuth = np.linspace(np.radians(45.0), np.radians(135.0), 4000)
    xy = 15.0 / np.sin(azimuth)[:, None] * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    rng = np.random.default_rng(0)
    points = np.column_stack([xy, np.full(len(xy), -HEIGHT_M)])
    points *= 1.0 + rng.normal(0.0, 0.1, len(points))[:, None] / np.linalg.norm(points, axis=1)[:, None]
    noise = np.full(len(points), 0.1)
    scan = PointCloud(0, points, noise, 1e-3 * noise, np.zeros(len(points), dtype=bool))
    road = road_along(way(), [scan], T_LEVEL_SENSOR, AXES, np.zeros(3), GroundSettings())
    assert road is not None
    value, covariance, _ = road.found.plane()
    assert abs(value[2]) < 0.05  # the rays fall by 0.4
    assert np.sqrt(covariance[2, 2]) > abs(value[2]) / 3


def test_road_is_followed_from_one_ring_of_a_scanner_to_the_next() -> None:
    """One ring tells no slope, so that the next one may be off by as much as roads fall by."""
    x, ring_m = np.meshgrid(np.arange(-20.0, 20.0, 0.05), 1.2 * np.arange(-4, 5))
    xy = np.column_stack([x.ravel(), WAY_Y_M + ring_m.ravel()])
    scan = cloud(0.02 * ring_m.ravel(), xy)
    road = road_along(way(), [scan], T_LEVEL_SENSOR, AXES, np.zeros(3), GroundSettings())
    assert road is not None
    left_m = road.found.cells.left_m
    assert left_m.max() - left_m.min() > 9.0
    value, covariance, _ = road.found.plane()
    off = value[1:] - [0.0, 0.02]
    assert off @ np.linalg.solve(covariance[1:, 1:], off) < 3.0**2
    assert np.degrees(np.linalg.norm(off)) < 0.15


def test_the_lane_below_a_vehicle_is_road_however_noisy_it_is_seen() -> None:
    rng = np.random.default_rng(1)
    xy = plan(0.4, 1.2)
    xy = (xy + rng.uniform(-0.1, 0.1, xy.shape))[rng.uniform(size=len(xy)) < 0.5]
    road = road_along(way(), [cloud(np.zeros(len(xy)), xy, 0.3)], T_LEVEL_SENSOR, AXES, np.zeros(3), GroundSettings())
    assert road is not None
    assert np.ptp(road.found.cells.xy[:, 0]) > 25.0
    value, covariance, _ = road.found.plane()
    assert value[1:] @ np.linalg.solve(covariance[1:, 1:], value[1:]) < 3.0**2


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("seed", [20, 24, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (22, 29, 35))])
def test_what_a_few_steep_places_would_make_of_all_the_land_moves_nothing_out_of_sight(seed: int) -> None:
    """Far from them their plane is above the sensor, where nothing can be seen."""
    rng = np.random.default_rng(seed)
    sensor_m = rng.uniform(1.0, 4.0)
    near = np.column_stack([rng.uniform(-3.0, 3.0, 400), WAY_Y_M + rng.uniform(-1.2, 1.2, 400)])
    far = np.column_stack([rng.uniform(-15.0, 15.0, 600), WAY_Y_M + rng.uniform(-20.0, 20.0, 600)])
    along, bent, across = rng.uniform([-0.1, -0.05, -0.2], [0.1, 0.05, 0.2])
    steep = along * near[:, 0] + bent * near[:, 0] ** 2 + across * (near[:, 1] - WAY_Y_M)
    land = rng.uniform(-0.5, 0.5) + rng.uniform(-0.03, 0.03) * (far[:, 1] - WAY_Y_M)
    points = np.column_stack([np.concatenate([near, far]), np.concatenate([steep, land]) - sensor_m])
    noise = np.full(len(points), 0.03)
    scan = PointCloud(0, points, noise, 0.01 * noise, np.zeros(len(points), dtype=bool))
    low = rigid(np.eye(3), np.array([0.0, 0.0, sensor_m]))
    road = road_along(way(), [scan], low, AXES, np.zeros(3), GroundSettings())
    assert road is None or np.isfinite(road.found.plane()[0]).all()


def test_an_offset_of_disparities_shows_a_level_road_as_a_plane_whatever_its_texture() -> None:
    """It lifts what is seen by what goes with the depth, with much noise in a third of it and little elsewhere."""
    rng = np.random.default_rng(5)
    xy, per_m = plan(0.15), 0.001
    depth_m, left_m = WAY_Y_M + 25.0 + xy[:, 0], xy[:, 1] - WAY_Y_M
    noise = 4.0 * per_m * depth_m * np.where(left_m > 4.0, 3.0, 1.0)
    height = per_m * depth_m + 0.1 * noise * rng.normal(size=len(xy))
    away_m = np.hypot(depth_m, left_m)
    points = np.column_stack([depth_m, left_m, np.full(len(xy), -HEIGHT_M)]) * (1.0 - height / HEIGHT_M)[:, None]
    noise *= away_m / HEIGHT_M  # along the line of sight
    scan = PointCloud(0, points, noise, 1e-3 * noise, np.zeros(len(points), dtype=bool), window_rad=0.003)
    straight = np.column_stack([np.arange(22.0, 58.0, 0.5), np.zeros(72)])
    road = road_along(straight, [scan], T_LEVEL_SENSOR, AXES, np.zeros(3), GroundSettings())
    assert road is not None
    value, covariance, _ = road.found.plane()
    assert value[1:] == pytest.approx([per_m, 0.0], abs=per_m / 3)
    # Nothing tells that it is the camera's and not the road's: it is a quarter of the usual noise, which is shared.
    assert covariance[1, 1] > per_m**2
    common = road.found.cells.sigma_m / road.found.cells.xy[:, 0]
    assert common == pytest.approx(np.full(len(common), 4.0 * per_m), rel=0.05)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("window_rad", [0.0, 0.003])
def test_where_nothing_is_seen_there_is_no_road(window_rad: float) -> None:
    xy = plan(0.2)
    scan = replace(cloud(np.zeros(len(xy)), xy), window_rad=window_rad)
    beyond = way() + np.array([0.0, 200.0])
    assert road_along(beyond, [scan], T_LEVEL_SENSOR, AXES, np.zeros(3), GroundSettings()) is None
    few = scan[np.arange(0, len(xy), 700)]
    assert road_along(way(), [few], T_LEVEL_SENSOR, AXES, np.zeros(3), GroundSettings()) is None


def test_a_vehicle_that_waits_is_at_one_place() -> None:
    xs = [*np.arange(0.0, 10.0, 0.5), *[10.0] * 50, *np.arange(10.0, 20.0, 0.5)]
    found = places(Track(tuple(sighting(0.1 * i, np.array([x, 3.0])) for i, x in enumerate(xs))))
    assert len(found) == pytest.approx(40, abs=2)
    assert np.abs(found[:, 1] - 3.0).max() <= 0.25
    assert np.diff(found[:, 0]).max() < 0.6


@pytest.mark.parametrize("rate_hz", [10.0, 30.0, 100.0])
@pytest.mark.parametrize("speed_mps", [1.0, 3.0, 8.0])
def test_boxes_that_jump_by_more_than_the_vehicle_moves_are_one_path(speed_mps: float, rate_hz: float) -> None:
    stamps = np.arange(0.0, 30.0 / speed_mps, 1.0 / rate_hz)
    jumps = np.random.default_rng(0).normal(0.0, 0.3, (len(stamps), 2))
    true = np.column_stack([speed_mps * stamps, np.full(len(stamps), 3.0)])
    found = places(Track(tuple(map(sighting, stamps.tolist(), true + jumps))))
    assert np.abs(found[:, 1] - 3.0).max() < 0.5
    assert np.ptp(found[:, 0]) > 26.0
    assert np.diff(np.sort(found[:, 0])).max() < 1.0
    assert along_line(found)[-1] < 1.2 * 30.0


def test_a_fast_vehicle_was_everywhere_between_two_frames_but_not_where_it_was_hidden() -> None:
    xs = [*np.arange(0.0, 21.0, 2.0), *np.arange(35.0, 50.0, 2.0)]
    found = places(Track(tuple(sighting(0.1 * i, np.array([x, 3.0])) for i, x in enumerate(xs))))
    between = np.diff(found[:, 0])
    assert np.sort(between)[-1] == pytest.approx(15.0, abs=2.0)
    assert np.sort(between)[-2] < 1.0


def test_where_frames_are_seldom_a_vehicle_was_everywhere_between_them() -> None:
    found = places(Track(tuple(sighting(float(i), np.array([8.0 * i, 3.0])) for i in range(9))))
    assert np.diff(found[:, 0]).max() < 0.6
    assert np.ptp(found[:, 0]) == pytest.approx(64.0, abs=1.0)
    assert len(places(Track((sighting(0.0, np.array([5.0, 3.0])),)))) == 1


def there_and_back(first_x: float, turn_x: float, last_x: float, aside_m: float) -> FloatArray:
    """Return the places of who drives there at `WAY_Y_M`, and back so far aside of that."""
    there = [(x, WAY_Y_M) for x in np.arange(first_x, turn_x, 0.5)]
    back = [(x, WAY_Y_M + aside_m) for x in np.arange(turn_x, last_x, -0.5)]
    return places(Track(tuple(sighting(0.1 * i, np.array(at)) for i, at in enumerate(there + back))))


def test_who_comes_back_over_the_own_way_was_there_once() -> None:
    found = there_and_back(0.0, 12.0, -20.0, 0.7)
    assert len(found) == pytest.approx(2 * 32, abs=8)
    assert np.diff(np.sort(found[:, 0])).max() < 3.0
    other_lane = there_and_back(0.0, 12.0, -20.0, 3.5)
    assert len(other_lane) == pytest.approx(2 * 44, abs=8)


def test_what_a_surface_is_torn_between_stays_in_doubt_once_an_edge_is_taken_for_one() -> None:
    # A road of 8 m whose far half falls by 3 % more: behind a crown, or on a verge that is as wide as a lane.
    xy = plan(0.25)
    left_m = xy[:, 1] - WAY_Y_M
    height = -0.03 * (left_m - 2.0).clip(0.0, 4.0) + 0.05 * (left_m > 6.0) + 0.1 * (left_m < -2.0)
    road = road_along(way(), [cloud(height, xy)], T_LEVEL_SENSOR, AXES, np.zeros(3), GroundSettings())
    assert road is not None
    value, covariance, _ = road.found.plane()
    assert Road((road.found,)).apart() == pytest.approx(np.zeros((3, 3)))
    doubt = covariance + road.apart()
    for slopes in ((0.0, 0.0), (0.0, -0.015)):  # with a verge, and with a crown
        off = value[1:] - slopes
        assert off @ np.linalg.solve(doubt[1:, 1:], off) < 3.0**2
    assert value[1:] @ np.linalg.solve(covariance[1:, 1:], value[1:]) > 3.0**2  # which nothing else would tell


def beyond(way: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what comes 30 m before and after a straight way along x, half a metre aside of it, as messages may be."""
    out_m = np.arange(0.0, 30.0, 2.0)
    aside = np.full(len(out_m), WAY_Y_M + 0.5)
    return np.column_stack([way[0, 0] - out_m, aside]), np.column_stack([way[-1, 0] + out_m, aside])


@pytest.mark.parametrize(("length_m", "more_m"), [(8.0, 8.0), (40.0, REACH_M)])
def test_a_way_goes_on_as_far_as_it_is_long_and_no_farther_than_road_is_looked_for(
    length_m: float, more_m: float
) -> None:
    x = np.arange(0.0, length_m + 0.1, 0.5)
    seen = np.column_stack([x, np.full(len(x), WAY_Y_M)])
    found = prolonged(seen, *beyond(seen))
    assert found[0] == pytest.approx([-more_m, WAY_Y_M], abs=0.6)
    assert found[-1] == pytest.approx([length_m + more_m, WAY_Y_M], abs=0.6)
    assert np.diff(along_line(found)).max() < 0.6
    nothing = seen[:1]
    assert (prolonged(seen, nothing, nothing) == seen).all()
    # Who backs over the own way was there once.
    assert len(prolonged(seen, nothing, seen[::-1])) == pytest.approx(len(seen), abs=6)


def test_road_that_is_seen_only_before_and_behind_where_the_vehicle_was_is_found() -> None:
    """A ring of a scanner meets the vehicle where the road below it is between two rings."""
    seen, xy = way()[20:40], plan(0.2, 6.0)
    xy = xy[np.abs(xy[:, 0]) > 7.0]
    scan, settings = cloud(0.01 * xy[:, 0] - 0.02 * (xy[:, 1] - WAY_Y_M), xy), GroundSettings()
    assert road_along(seen, [scan], T_LEVEL_SENSOR, AXES, np.zeros(3), settings) is None
    road = road_along(prolonged(seen, *beyond(seen)), [scan], T_LEVEL_SENSOR, AXES, np.zeros(3), settings)
    assert road is not None
    value, covariance, _ = road.found.plane()
    off = value[1:] - [0.01, -0.02]
    assert off @ np.linalg.solve(covariance[1:, 1:], off) < 3.0**2
    assert np.degrees(np.linalg.norm(off)) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("half_m", [3.25, 5.0])
def test_a_road_of_which_both_kerbs_are_seen_has_no_other_side(half_m: float) -> None:
    """Nothing of the land is seen: a level strip may be one side of a crowned road then, unless kerbs bound it."""
    xy = plan(0.25)
    beyond_m = np.abs(xy[:, 1] - WAY_Y_M - 1.5) - half_m
    doubts_deg = []
    for kept in (beyond_m < 2.0, beyond_m < 0.0):
        scan = cloud(np.where(beyond_m > 0.0, 0.1, 0.0)[kept], xy[kept])
        road = road_along(way(), [scan], T_LEVEL_SENSOR, AXES, np.zeros(3), GroundSettings())
        assert road is not None
        value, covariance, _ = road.found.plane()
        assert value[1:] @ np.linalg.solve(covariance[1:, 1:], value[1:]) < 3.0**2
        doubts_deg.append(np.degrees(np.sqrt(covariance[2, 2])))
    assert doubts_deg[0] < 0.7 * doubts_deg[1]
