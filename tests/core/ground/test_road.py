from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from laci_stereo.core.cloud import PointCloud, PointCloudSource
from laci_stereo.core.errors import GroundError
from laci_stereo.core.frames import Axes, FloatArray, invert, rigid, transform
from laci_stereo.core.ground.merge import Chart
from laci_stereo.core.ground.plane import GroundPlane, fit_farther_ground, fit_ground, fit_ground_beside
from laci_stereo.core.ground.road import _seen_from, road_ground, standing
from laci_stereo.core.ground.road_extent import places, road_along
from laci_stereo.core.ground.road_surface import FALL
from laci_stereo.core.observe import Observation, observe
from laci_stereo.core.settings import GroundSettings, Settings
from laci_stereo.core.tracking.reframing import transformed_xy
from laci_stereo.core.tracking.tracks import Track
from tests.core.tracks import sighting
from tools.scenes.scene import SensorKind, draw_scene, errors_of
from tools.scenes.seeing import see

AXES = Axes(forward=(1.0, 0.0, 0.0), up=(0.0, 0.0, 1.0))
HEIGHT_M, SIGMA_M = 6.0, 0.02
ROAD_HALF_M = 7.0
"""The vehicle drives along y = 15 m, in the middle of a road that is 14 m wide."""
ROAD_Y_M = 15.0
HALF_FALL_DEG = float(np.degrees(FALL)) / 2.0


def seen(land_slope: float) -> PointCloud:
    """Return rays to a level road with land on either side of it that falls in one direction, as a LiDAR sees it."""
    rng = np.random.default_rng(0)
    ray = rays(np.arange(-80.0, 81.0, 0.5), np.arange(6.0, 45.0, 0.4), rng)
    # The land: z = slope (y - road); so the ray's height -H + slope ... is linear in the range.
    land = (HEIGHT_M + land_slope * ROAD_Y_M) / (land_slope * ray[:, 1] - ray[:, 2])
    road = -HEIGHT_M / ray[:, 2]
    on_road = np.abs(road * ray[:, 1] - ROAD_Y_M) < ROAD_HALF_M
    return measured(ray, np.where(on_road, road, land), rng)


def seen_beside(above_m: float) -> PointCloud:
    """Return rays to a road that is so far above level land on either side of it."""
    rng = np.random.default_rng(0)
    ray = rays(np.arange(-80.0, 81.0, 0.5), np.arange(6.0, 45.0, 0.4), rng)
    road, land = -HEIGHT_M / ray[:, 2], -(HEIGHT_M + above_m) / ray[:, 2]
    return measured(ray, np.where(np.abs(road * ray[:, 1] - ROAD_Y_M) < ROAD_HALF_M, road, land), rng)


def seen_from_a_verge(slope: float, edge_m: float) -> PointCloud:
    """Return rays to a level road, and to a bank that falls to its edge from below the sensor."""
    rng = np.random.default_rng(0)
    ray = rays(np.arange(40.0, 140.0, 0.5), np.arange(12.0, 60.0, 0.4), rng)
    bank = (HEIGHT_M - slope * edge_m) / (-ray[:, 2] - slope * ray[:, 1])
    road = -HEIGHT_M / ray[:, 2]
    return measured(ray, np.where(road * ray[:, 1] < edge_m, bank, road), rng)


def rays(azimuth_deg: FloatArray, down_deg: FloatArray, rng: np.random.Generator) -> FloatArray:
    azimuth, down = (angle.ravel() for angle in np.meshgrid(np.radians(azimuth_deg), np.radians(down_deg)))
    azimuth, down = (angle + rng.uniform(-0.003, 0.003, angle.size) for angle in (azimuth, down))
    return np.column_stack([np.cos(down) * np.cos(azimuth), np.cos(down) * np.sin(azimuth), -np.sin(down)])


def measured(ray: FloatArray, range_m: FloatArray, rng: np.random.Generator) -> PointCloud:
    kept = (range_m > 3.0) & (range_m < 50.0)
    points = ray[kept] * (range_m[kept] + rng.normal(0.0, SIGMA_M, kept.sum()))[:, None]
    noise = np.full(len(points), SIGMA_M)
    return PointCloud(0, points, noise, 0.1 * noise, np.zeros(len(points), dtype=bool))


def fitted(cloud: PointCloud) -> GroundPlane:
    return fit_ground(cloud.points, cloud.sigma_along_m, cloud.sigma_across_m, AXES.up)


def way() -> FloatArray:
    return places(
        Track(tuple(sighting(0.1 * i, np.array([x, ROAD_Y_M])) for i, x in enumerate(np.arange(-20.0, 30.0, 1.0))))
    )


def tilt_deg(ground: GroundPlane) -> float:
    return float(np.degrees(np.arccos(min(1.0, ground.normal[2]))))


def tilt_sigma_deg(ground: GroundPlane) -> float:
    covariance: FloatArray = ground.covariance_level(AXES)[:2, :2]
    return float(np.degrees(np.sqrt(np.linalg.eigvalsh(covariance)[-1])))


@pytest.mark.parametrize("land_slope", [-0.05, pytest.param(0.05, marks=pytest.mark.slow)])
def test_land_is_not_taken_for_the_road(land_slope: float) -> None:
    cloud = seen(land_slope)
    ground = fitted(cloud)
    assert tilt_deg(ground) > 2.0
    road = road_ground([cloud], AXES, ground, way(), GroundSettings())
    # A road is up to a degree higher on one side: as much of the land looks like it.
    assert tilt_deg(road) < 0.3
    assert tilt_deg(road) < 2.0 * tilt_sigma_deg(road)
    assert road.height_m == pytest.approx(HEIGHT_M, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("slope", [0.04, 0.1])
@pytest.mark.parametrize("edge_m", [12.0, 13.0])
def test_a_bank_within_reach_of_the_way_is_not_taken_for_the_road(slope: float, edge_m: float) -> None:
    # Within 8 m of the way most of what is seen is the bank, within 2 m the road.
    cloud = seen_from_a_verge(slope, edge_m)
    ground = fitted(cloud)
    assert tilt_deg(ground) > 2.0
    road = road_ground([cloud], AXES, ground, way(), GroundSettings())
    assert tilt_deg(road) < tilt_deg(ground) / 3
    assert tilt_deg(road) < 2.0 * tilt_sigma_deg(road)
    assert tilt_sigma_deg(road) < np.degrees(FALL)


@pytest.mark.slow
def test_a_ground_that_is_the_road_stays() -> None:
    cloud = seen(0.0)
    ground = fitted(cloud)
    kept = road_ground([cloud], AXES, ground, way(), GroundSettings())
    assert np.degrees(np.linalg.norm(kept.normal - ground.normal)) < 0.02
    assert kept.height_m == pytest.approx(ground.height_m, abs=0.005)
    assert tilt_deg(ground) < 0.05
    assert tilt_sigma_deg(kept) < 0.05


@pytest.mark.slow
def test_a_narrow_road_that_few_layers_see_is_told_from_the_land() -> None:
    rng = np.random.default_rng(0)
    ray = rays(np.arange(20.0, 160.0, 0.5), np.arange(8.0, 26.0, 2.0), rng)
    slope, kerb_m, edge_m = 0.04, 0.06, 22.0
    land = (HEIGHT_M - kerb_m - slope * edge_m) / (-ray[:, 2] - slope * ray[:, 1])
    road = -HEIGHT_M / ray[:, 2]
    beyond = np.where(road * ray[:, 1] < edge_m + 7.0, road, np.inf)
    cloud = measured(ray, np.where(road * ray[:, 1] < edge_m, land, beyond), rng)
    lane = places(Track(tuple(sighting(0.1 * i, np.array([i - 20.0, edge_m + 1.75])) for i in range(50))))
    assert tilt_deg(fitted(cloud)) > 2.0
    ground = road_ground([cloud], AXES, fitted(cloud), lane, GroundSettings())
    assert tilt_deg(ground) < 0.3
    assert tilt_deg(ground) < 2.0 * tilt_sigma_deg(ground)


@pytest.mark.parametrize("crown", [0.01, 0.025])
def test_the_side_of_the_crown_that_is_seen_is_not_taken_for_the_road(crown: float) -> None:
    lane = places(Track(tuple(sighting(0.1 * i, np.array([i - 20.0, ROAD_Y_M - 1.75])) for i in range(50))))
    cloud = crowned(crown, far_side=False)
    assert tilt_deg(fitted(cloud)) == pytest.approx(np.degrees(crown), abs=0.05)
    ground = road_ground([cloud], AXES, fitted(cloud), lane, GroundSettings())
    assert tilt_deg(ground) < 3.0 * tilt_sigma_deg(ground)
    assert tilt_sigma_deg(ground) > HALF_FALL_DEG


@pytest.mark.slow
@pytest.mark.parametrize("crown", [0.01, 0.025])
def test_both_sides_of_the_crown_tell_the_road(crown: float) -> None:
    # Most of what is seen is on the near side.
    lane = places(Track(tuple(sighting(0.1 * i, np.array([i - 20.0, ROAD_Y_M - 1.75])) for i in range(50))))
    cloud = crowned(crown, far_side=True)
    ground = road_ground([cloud], AXES, fitted(cloud), lane, GroundSettings())
    assert tilt_deg(ground) < 3.0 * tilt_sigma_deg(ground)
    assert tilt_deg(ground) < 0.2
    assert tilt_sigma_deg(ground) < 0.2


@pytest.mark.parametrize("seed", [0, *(pytest.param(each, marks=pytest.mark.slow) for each in (1, 2))])
def test_a_crown_that_is_seen_from_aside_does_not_tilt_the_road(seed: int) -> None:
    """Its sides are nearer and farther than a plane on which they would be seen in the same direction."""
    rng = np.random.default_rng(seed)
    fall, kerb_m, half_m = 0.02, 0.08, 3.5
    ray = rays(np.arange(30.0, 150.0, 0.5), np.arange(6.0, 45.0, 0.4), rng)
    near, far = both_sides(ray, fall)
    road, pavement = np.where(near * ray[:, 1] < ROAD_Y_M, near, far), (HEIGHT_M - kerb_m) / -ray[:, 2]
    cloud = measured(ray, np.where(np.abs(pavement * ray[:, 1] - ROAD_Y_M) > half_m, pavement, road), rng)
    lane = places(Track(tuple(sighting(0.1 * i, np.array([0.4 * i - 8.0, ROAD_Y_M - 2.0])) for i in range(40))))
    T_level_sensor = rigid(np.eye(3), np.array([0.0, 0.0, HEIGHT_M]))
    along = road_along(lane, [cloud], T_level_sensor, AXES, np.zeros(3), GroundSettings())
    assert along is not None
    plane, covariance, _ = along.found.plane()
    off = plane[1:]
    assert off @ np.linalg.solve(covariance[1:, 1:], off) < 4.0
    assert np.degrees(np.linalg.norm(off)) < 0.06


def both_sides(ray: FloatArray, fall: float) -> list[FloatArray]:
    """Return how far along rays the nearer and the farther side of a crown at `ROAD_Y_M` are."""
    return [(HEIGHT_M + way * fall * ROAD_Y_M) / (way * fall * ray[:, 1] - ray[:, 2]) for way in (1.0, -1.0)]


def crowned(fall: float, *, far_side: bool) -> PointCloud:
    """Return rays to a road that falls from its crown to both sides; a hedge on the crown may hide the farther one.

    Then a lane and its shoulder are seen: of what is wider, few roads have as much on one side of a crown.
    """
    rng = np.random.default_rng(0)
    ray = rays(np.arange(30.0, 150.0, 0.5), np.arange(6.0, 45.0, 0.4), rng)
    near, far = both_sides(ray, fall)
    beyond = np.where((far * ray[:, 1] < ROAD_Y_M + 4.0) & far_side, far, np.inf)
    lane = np.where((near * ray[:, 1] > ROAD_Y_M - 5.0) | far_side, near, np.inf)
    return measured(ray, np.where(near * ray[:, 1] < ROAD_Y_M, lane, beyond), rng)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensor", "seed"),
    [
        # The pavement beside who backs out of a yard: taken for a steep crown, it put the ground 0.6 deg off.
        ("stereo_05", 70048),
        ("stereo_10", 70048),
        # A strip of 6 m, seen by lasers of which each errs by 1 cm: one ring passed for a crown, 1.3 deg at 7 sigma.
        ("lidar_8", 71007),
        # On the first ground a stranger on land behind the road fits best: its way became the road, 0.9 deg at 5 sigma.
        ("stereo_10", 70032),
        # The same, on a pavement 4 m beside the sender's way, 12 cm higher: 2.5 deg at 12 sigma.
        ("lidar_8", 75009),
        # Land that is nearly even with the road was taken for it: 0.4 and 0.5 deg at 5 and 9 sigma.
        ("lidar_16", 80018),
        ("lidar_16", 80042),
        # The sender was seen in two pieces, so that nobody was on a road: 0.3 deg at 17 sigma.
        ("lidar_8", 81004),
        # A surface that bent up at a kerb of 5 cm took the pavement for road, step by step: 1.0 deg at 3 sigma.
        ("lidar_8", 84004),
        # A strip that looked level from one plane and like a crown from the next.
        ("lidar_8", 80065),
    ],
)
def test_what_is_beside_the_road_or_passes_for_it_does_not_tilt_it(sensor: SensorKind, seed: int) -> None:
    off_rad, covariance = tilted(sensor, seed)
    assert off_rad @ np.linalg.solve(covariance, off_rad) < 9.0
    assert np.degrees(np.linalg.norm(off_rad)) < 1.0


@pytest.mark.parametrize("looks", [(2.0, -1.0, 2.0, -1.0, 2.0), (2.0, None, 2.0, None, 2.0), (2.0, 0.0, 2.0, 0.0, 2.0)])
def test_whichever_look_is_right_is_within_the_doubt(
    looks: tuple[float | None, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each look finds the road so many degrees off the ground, or not at all, which leaves the ground."""
    ground = fitted(seen(0.0))
    chart = Chart.around(ground)
    (value,) = chart.values([ground])
    across = np.array([1.0, 0.0, 0.0])
    exact = np.diag(np.square([np.radians(0.05), np.radians(0.05), 0.01]))

    def plane(deg: float) -> GroundPlane:
        return chart.plane(value + np.radians(deg) * across, exact)

    left = iter(looks)

    def look(*_: object) -> tuple[GroundPlane, GroundPlane, GroundPlane] | None:
        deg, surely = next(left), chart.plane(value, 1e-6 * exact)
        return None if deg is None else (plane(deg), surely, surely)

    monkeypatch.setattr("laci_stereo.core.ground.road._seen_from", look)
    road = road_ground([], AXES, ground, way(), GroundSettings())
    (found,), sigma_rad = chart.values([road]), np.sqrt(chart.covariance(road)[0, 0])
    assert next(left, None) is None  # all were looked at
    for deg in (each or 0.0 for each in looks):
        assert abs(found[0] - value[0] - np.radians(deg)) < 2.0 * sigma_rad


@pytest.mark.slow
@pytest.mark.parametrize(("sensor", "seed", "times"), [("lidar_8", 84006, 1), ("lidar_8", 84009, 2)])
def test_a_recording_is_observed_again_only_where_the_road_is_far_from_the_ground(
    sensor: SensorKind, seed: int, times: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    grounds: list[GroundPlane] = []

    def counted(source: PointCloudSource, *known: Any) -> Observation:
        seen = observe(source, *known)
        grounds.append(seen.ground)
        return seen

    for module in ("laci_stereo.core.observe", "tools.scenes.seeing"):
        monkeypatch.setattr(f"{module}.observe", counted)
    scene = draw_scene(seed, sensor)
    watched = see(scene, "simulated")
    found = watched.observation
    assert len(grounds) == times
    assert (found.ground.normal != grounds[0].normal).any()
    # Whether observed again or laid onto the road, the sender is where it was in that frame.
    first = watched.locate(Settings()).drive.track.sightings[0]
    at = transform(scene.T_world_sensor @ invert(found.T_level_sensor), first.points)
    xy, _ = scene.sender.track(np.array([first.stamp_s]) + scene.times_s[0])
    assert np.abs(at[:, :2] - xy).max() < scene.sender.length_m
    assert -0.1 < at[:, 2].min() < at[:, 2].max() < scene.vehicle.height_m + 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("apart_m", "is_seen"), [(1.1, True), (1.3, False)])
def test_how_far_a_road_may_be_counts_from_the_ground(apart_m: float, is_seen: bool) -> None:
    """And not from where it is looked at, half of that above it."""
    cloud = seen(0.0)
    road = fitted(cloud)
    ground, found = (replace(road, height_m=road.height_m - share * apart_m) for share in (1.0, 0.5))
    along = transformed_xy(found.T_level_sensor(AXES) @ invert(road.T_level_sensor(AXES)), way())
    assert (_seen_from(found, ground, [cloud], AXES, along, GroundSettings()) is not None) == is_seen


@pytest.mark.slow
@pytest.mark.parametrize("seed", [75005])
def test_a_road_that_never_settles_may_be_any_that_was_found(seed: int) -> None:
    """Eight layers on a strip of 2 m: from one plane it is level, from the next it passes a crown, 2 deg off."""
    off_rad, covariance = tilted("lidar_8", seed)
    assert off_rad @ np.linalg.solve(covariance, off_rad) < 9.0
    assert np.degrees(np.sqrt(np.linalg.eigvalsh(covariance)[-1])) > 0.5


def tilted(sensor: SensorKind, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return by how much the ground of a scene is turned about the level axes, and the covariance of that."""
    scene = draw_scene(seed, sensor, verges=False)
    observation = see(scene, "simulated").observation
    true_up = observation.T_level_sensor[:3, :3] @ scene.T_utm_sensor[2, :3]
    covariance: FloatArray = observation.ground.covariance_level(observation.axes)[:2, :2]
    return np.cross(true_up, [0.0, 0.0, 1.0])[:2], covariance


def test_what_moves_is_left_out_of_its_frame_alone() -> None:
    cloud = seen(0.0)
    T_level_sensor = fitted(cloud).T_level_sensor(AXES)
    clouds = [replace(cloud, stamp_ns=stamp_ns) for stamp_ns in (1_000_000_000, 1_100_000_000)]
    at = np.array([3.0, ROAD_Y_M])
    moving, still = standing(clouds, T_level_sensor, {1_000_000_000: [sighting(0.1, at).box]})
    assert len(still) == len(cloud)
    assert 0 < len(moving) < len(cloud)
    away = np.abs(moving.points[:, :2] - at)
    assert ((away > [4.4 / 2 + 0.9, 1.8 / 2 + 0.9]).any(axis=1)).all()


def test_where_no_road_is_seen_the_doubt_grows() -> None:
    cloud = seen(0.05)
    ground = fitted(cloud)
    away = places(Track(tuple(sighting(0.1 * i, np.array([-90.0 + i, -90.0])) for i in range(20))))
    kept = road_ground([cloud], AXES, ground, away, GroundSettings())
    assert kept.normal == pytest.approx(ground.normal)
    assert kept.height_m == pytest.approx(ground.height_m)
    assert tilt_sigma_deg(kept) > HALF_FALL_DEG


@pytest.mark.parametrize("slope", [0.04, 0.12])
@pytest.mark.parametrize("edge_m", [10.0, 12.0])
def test_the_road_behind_a_bank_is_found_by_what_is_farther_away(slope: float, edge_m: float) -> None:
    cloud = seen_from_a_verge(slope, edge_m)
    assert tilt_deg(fitted(cloud)) > 2.0  # the bank fills more of the view
    road = fit_farther_ground(cloud.points, cloud.sigma_along_m, cloud.sigma_across_m, AXES.up)
    assert tilt_deg(road) < 0.05
    assert road.height_m == pytest.approx(HEIGHT_M, abs=0.02)


@pytest.mark.parametrize("above_m", [-0.4, 0.4, 0.8])
def test_the_road_beside_land_is_found_by_what_is_not_on_it(above_m: float) -> None:
    cloud = seen_beside(above_m)
    land = fitted(cloud)
    assert land.height_m == pytest.approx(HEIGHT_M + above_m, abs=0.05)
    within_m = (0.0, 1.2) if above_m > 0.0 else (-1.2, 0.0)
    road = fit_ground_beside(cloud.points, cloud.sigma_along_m, cloud.sigma_across_m, land, within_m)
    assert road.height_m == pytest.approx(HEIGHT_M, abs=0.02)
    assert tilt_deg(road) < 0.05
    with pytest.raises(GroundError):
        fit_ground_beside(cloud.points, cloud.sigma_along_m, cloud.sigma_across_m, land, (-within_m[1], -within_m[0]))


@pytest.mark.slow
def test_a_sender_on_a_road_above_the_land_is_found() -> None:
    """The land is the ground at first, 0.3 m below a road that is one obstacle then, with all that drives on it."""
    scene = draw_scene(81279, "lidar_32")
    found = see(scene, "simulated").locate(Settings())
    errors = errors_of(found, scene)
    assert found.quality.frames_used > 60
    assert max(errors.sigma_ratio, errors.rotation_ratio) < 3.0
