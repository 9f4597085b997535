from __future__ import annotations

import numpy as np
import pytest

from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.settings import Settings
from laci_stereo.core.tracking.background import Background
from laci_stereo.core.tracking.land import FLAT, learn_land
from laci_stereo.core.tracking.sighting import find_vehicles

FRAMES, NOISE_M, SENSOR_M = 20, 0.03, 6.0
SETTINGS = Settings()


def land_seen(height_m: float, seen: float, rng: np.random.Generator) -> FloatArray:
    """Points of a frame: a road, and a rise of which a share is seen, 6 to 16 m to its left."""
    x, y = (each.ravel() for each in np.meshgrid(np.arange(10.0, 40.0, 0.3), np.arange(-5.0, 16.0, 0.3)))
    z = np.where(y > 6.0, height_m, 0.0) + NOISE_M * rng.normal(size=len(x))
    return np.column_stack([x, y, z])[(y < 6.0) | (rng.random(len(x)) < seen)]


def body(x: float, y: float) -> FloatArray:
    """The near side and the rear of a car, from its sills upwards."""
    along, up = (each.ravel() for each in np.meshgrid(np.arange(0.0, 4.4, 0.1), np.arange(0.3, 1.3, 0.1)))
    side = np.column_stack([x + along, np.full(len(along), y), up])
    return np.vstack([side, side[along < 1.8][:, [1, 0, 2]] + (x - y, y - x, 0.0)])


def clusters(points: FloatArray, clouds: list[FloatArray] | None) -> int:
    level = np.full(len(points), 0.02)
    cloud = PointCloud(
        0, points - (0.0, 0.0, SENSOR_M), sigma_along_m=level, sigma_across_m=level, at_edge=np.zeros(len(points), bool)
    )
    T = np.eye(4)
    T[2, 3] = SENSOR_M
    land = FLAT if clouds is None else learn_land(clouds, SETTINGS)
    return len(find_vehicles(cloud, 0.0, T, Background((), 0, 0.3), SETTINGS, land))


@pytest.mark.parametrize("seen", [1.0, 0.1])
@pytest.mark.parametrize("height_m", [0.22, 0.3, 0.45])
def test_land_as_high_as_a_vehicles_sill_is_no_vehicle(height_m: float, seen: float) -> None:
    rng = np.random.default_rng(1)
    clouds = [land_seen(height_m, seen, rng) for _ in range(FRAMES)]
    frame = np.vstack([land_seen(height_m, seen, rng), body(20.0, 0.0)])
    assert clusters(frame, clouds) == 1
    if seen == 1.0:
        assert clusters(frame, None) > 1


@pytest.mark.parametrize("beside", [0.0, 0.3])
def test_land_hides_nothing_of_vehicles_that_pass_or_wait(beside: float) -> None:
    rng = np.random.default_rng(2)
    passing = [np.vstack([land_seen(beside, 1.0, rng), body(10.0 + 1.2 * one, 0.0)]) for one in range(FRAMES)]
    waiting = [land_seen(beside, 1.0, rng) for _ in range(FRAMES)]
    waiting = [np.vstack([points, body(20.0, 0.0)]) if one % 3 else points for one, points in enumerate(waiting)]
    road = np.array([[x, y] for x in np.arange(12.0, 34.0, 0.4) for y in (-2.0, 0.1, 1.0)])
    for clouds in (passing, waiting):
        assert learn_land(clouds, SETTINGS).top_at(road).max() < SETTINGS.vehicle.min_height_m


def test_a_lane_whose_surface_is_not_seen_is_no_land() -> None:
    rng = np.random.default_rng(3)
    bare = [points[points[:, 1] > 6.0] for points in (land_seen(0.0, 1.0, rng) for _ in range(FRAMES))]
    passed = [np.vstack([points, body(10.0 + 1.2 * one, 0.0)]) for one, points in enumerate(bare)]
    assert not learn_land(passed, SETTINGS).top_at(np.array([[x, 0.1] for x in np.arange(12.0, 34.0, 0.4)])).any()
