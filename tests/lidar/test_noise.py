from __future__ import annotations

import numpy as np
import pytest
from laci_lidar.noise import SMALLEST_SIGMA_M, estimate_angle_sigma, estimate_range_sigma

from laci_stereo.core.errors import GroundError
from laci_stereo.core.frames import FORWARD_LEFT_UP_AXES
from laci_stereo.core.settings import GroundSettings
from tests.lidar.scanner import road


def range_sigma(scans, angle=1e-3) -> float:
    return estimate_range_sigma(scans, angle, FORWARD_LEFT_UP_AXES, GroundSettings())


@pytest.mark.parametrize(
    ("sigma_m", "jitter_rad"), [(0.01, 0.0), (0.01, 2e-4), (0.03, 0.0), (0.03, 5e-4), (0.08, 0.0), (0.08, 1e-3)]
)
def test_the_noise_of_ranges_is_found_apart_from_that_of_bearings(sigma_m: float, jitter_rad: float):
    scans = [road(sigma_m=sigma_m, jitter_rad=jitter_rad, seed=seed) for seed in range(5)]
    assert range_sigma(scans) == pytest.approx(sigma_m, rel=0.25)


def test_walls_and_cars_on_the_road_do_not_matter():
    scans = []
    for seed in range(5):
        points = road(sigma_m=0.02, seed=seed)
        ranges = np.linalg.norm(points, axis=1)
        blocked = (np.abs(points[:, 1]) < 3.0) & (ranges > 15.0)
        points[blocked] *= (15.0 / ranges[blocked])[:, None]
        scans.append(points)
    assert range_sigma(scans) == pytest.approx(0.02, rel=0.25)


def test_a_perfect_scanner_is_not_believed():
    assert range_sigma([road(seed=seed) for seed in range(3)]) == SMALLEST_SIGMA_M


def test_too_few_neighbours_tell_nothing_of_the_noise_of_ranges():
    scan = road(sigma_m=0.01, step_deg=0.8)
    assert range_sigma([scan[:: max(1, len(scan) // 500)]]) is None


def test_without_ground_there_is_no_estimate():
    with pytest.raises(GroundError):
        range_sigma([np.random.default_rng(0).normal(size=(20, 3)) * 5.0])


@pytest.mark.parametrize("step_deg", [0.1, 0.2, 0.8])
def test_the_noise_of_bearings_follows_the_step(step_deg: float):
    points = road(step_deg=step_deg)
    expected = np.radians(step_deg) / np.sqrt(12.0)
    assert estimate_angle_sigma([points]) == pytest.approx(expected, rel=0.1)
    # A second return in the same direction is no step.
    assert estimate_angle_sigma([np.concatenate([points, 1.2 * points])]) == pytest.approx(expected, rel=0.1)


def test_few_points_have_no_step():
    assert estimate_angle_sigma([np.ones((2, 3))]) > 0.0
    assert estimate_angle_sigma([]) > 0.0
