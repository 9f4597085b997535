"""A plane that little of the view supports is the ground only where a road is seen on it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.errors import GroundError
from laci_stereo.core.frames import FORWARD_LEFT_UP_AXES, OPENCV_AXES, FloatArray
from laci_stereo.core.ground.axes import ground_below
from laci_stereo.core.ground.plane import GroundPlane
from laci_stereo.core.ground.road import road_ground
from laci_stereo.core.ground.road_extent import places
from laci_stereo.core.settings import GroundSettings, Settings
from laci_stereo.core.tracking.tracks import Track
from tests.core.tracks import sighting
from tests.passages import recorded
from tests.simulated import LEFT_TURN, lidar, scene

AXES = FORWARD_LEFT_UP_AXES
HEIGHT_M, ROAD_Y_M, ROAD_HALF_M, SIGMA_M = 6.0, 13.0, 4.0, 0.02
TOO_LITTLE = (
    (GroundSettings(min_support_share=1.01), r"supports the best plane: \d+\.\d % found, at least 101 % needed"),
    (GroundSettings(min_cells=5000), r"cells of 0.05 rad on the best plane: \d+ found, at least 5000 needed"),
)
"""By these no plane has enough support, as if all views were of hills, or had a few rings of a scanner only."""


def bumps() -> PointCloud:
    """Return what a LiDAR sees of a level road between bumps of grass, each some metres wide and 0.5 m high or deep."""
    rng = np.random.default_rng(0)
    azimuth, down = np.meshgrid(np.radians(np.arange(-80.0, 81.0, 0.5)), np.radians(np.arange(8.0, 50.0, 0.4)))
    azimuth, down = (each.ravel() + rng.uniform(-0.003, 0.003, each.size) for each in (azimuth, down))
    ray = np.column_stack([np.cos(down) * np.cos(azimuth), np.cos(down) * np.sin(azimuth), -np.sin(down)])
    road = land = HEIGHT_M / np.sin(down)
    for _ in range(30):  # their slopes are gentler than the rays
        x, y = land * ray[:, 0], land * ray[:, 1]
        land = (HEIGHT_M - 0.5 * np.sin(x / 4.0) * np.cos(y / 5.0)) / np.sin(down)
    range_m = np.where(np.abs(road * ray[:, 1] - ROAD_Y_M) < ROAD_HALF_M, road, land)
    kept = (range_m > 3.0) & (range_m < 50.0)
    points = ray[kept] * (range_m[kept] + rng.normal(0.0, SIGMA_M, kept.sum()))[:, None]
    noise = np.full(len(points), SIGMA_M)
    return PointCloud(0, points, noise, 0.1 * noise, np.zeros(len(points), dtype=bool))


def below(cloud: PointCloud, settings: GroundSettings) -> GroundPlane:
    return ground_below(cloud.points, cloud.sigma_along_m, cloud.sigma_across_m, AXES, settings)


def driven(y_m: float) -> FloatArray:
    return places(Track(tuple(sighting(0.1 * i, np.array([x, y_m])) for i, x in enumerate(np.arange(-20.0, 30.0)))))


@pytest.mark.parametrize("strict", [TOO_LITTLE[0][0], pytest.param(TOO_LITTLE[1][0], marks=pytest.mark.slow)])
def test_a_road_between_bumps_is_the_ground_where_somebody_drives(strict: GroundSettings) -> None:
    cloud = bumps()
    ground = below(cloud, strict)
    found = road_ground([cloud], AXES, ground, driven(ROAD_Y_M), strict)
    tilt, before = (np.arccos(min(1.0, each.normal[2])) for each in (found, ground))
    assert tilt < before / 2
    assert tilt**2 < 9.0 * np.linalg.eigvalsh(found.covariance_level(AXES)[:2, :2])[-1]
    assert found.height_m == pytest.approx(HEIGHT_M, abs=0.05)


@pytest.mark.parametrize(("strict", "message"), TOO_LITTLE)
def test_where_no_road_is_seen_there_is_no_ground(strict: GroundSettings, message: str) -> None:
    ground = below(bumps(), strict)
    with pytest.raises(GroundError, match=message):
        road_ground([bumps()], AXES, ground, driven(-90.0), strict)


@pytest.mark.parametrize(("strict", "_message"), TOO_LITTLE)
def test_a_camera_s_ground_may_have_little_support_as_well(strict: GroundSettings, _message: str) -> None:
    cloud = bumps()
    R = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    found = ground_below(cloud.points @ R.T, cloud.sigma_along_m, cloud.sigma_across_m, OPENCV_AXES, strict)
    assert found.height_m == pytest.approx(below(cloud, strict).height_m, abs=0.05)


def test_a_dozen_cells_are_needed_at_least() -> None:
    cloud = bumps()
    few = np.flatnonzero(np.hypot(*(cloud.points[:, :2] - [8.0, ROAD_Y_M]).T) < 1.3)
    with pytest.raises(GroundError, match=r"\d found, at least 12 needed"):
        below(cloud[few], GroundSettings(min_support_share=0.0))


@pytest.mark.slow
@pytest.mark.parametrize(("strict", "_message"), TOO_LITTLE)
def test_where_a_road_is_seen_the_result_is_what_it_was(strict: GroundSettings, _message: str) -> None:
    made, alone = recorded()[0]
    found = calibrate(made.recording, made.messages, Settings(ground=strict))
    assert found.T_utm_sensor == pytest.approx(alone.T_utm_sensor, abs=1e-6)


@pytest.mark.parametrize(("strict", "message"), TOO_LITTLE)
def test_where_nobody_is_seen_to_drive_there_is_no_ground(strict: GroundSettings, message: str) -> None:
    made = scene(LEFT_TURN, lidar(32, 160), frames_hz=5.0)
    with pytest.raises(GroundError, match=message):
        calibrate(replace(made.recording, movers=()), made.messages, Settings(ground=strict))
