from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.common_ground import lay, merge_grounds
from laci_stereo.core.errors import CombineError
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.frames import OPENCV_AXES, FloatArray
from laci_stereo.core.ground.box_ground import level_ground
from laci_stereo.core.ground.plane import GroundPlane
from laci_stereo.core.tracking.sighting import Low
from laci_stereo.core.tracking.tracks import Track
from tests.report.support import calibration

TILT = np.radians(15.0)
NORMAL = np.array([0.0, -np.cos(TILT), -np.sin(TILT)])
SIGMA_RAD, SIGMA_M = 0.003, 0.02


def ground(turn: FloatArray, height_m: float, scale: float = 1.0) -> GroundPlane:
    """Return a plane whose normal is off by a small turn, and which says how uncertain it is."""
    normal = NORMAL + np.cross(turn, NORMAL)
    made = level_ground(height_m, OPENCV_AXES)
    across = np.eye(3) - np.outer(NORMAL, NORMAL)
    covariance = np.zeros((4, 4))
    covariance[:3, :3] = SIGMA_RAD**2 * across
    covariance[3, 3] = SIGMA_M**2
    return replace(made, normal=normal / np.linalg.norm(normal), covariance_sensor=scale**2 * covariance)


def passage(seen: GroundPlane, name: str = "run") -> Passage:
    return replace(calibration().passages[0], ground=seen, name=name)


def drawn(count: int, rng: np.random.Generator) -> list[Passage]:
    return [
        passage(ground(SIGMA_RAD * rng.normal(size=3), 6.0 + SIGMA_M * rng.normal()), f"run {i}") for i in range(count)
    ]


@pytest.mark.slow
def test_many_grounds_are_nearer_to_the_truth_than_one() -> None:
    rng = np.random.default_rng(0)
    tilts, heights = [], []
    for _ in range(100):
        merged = merge_grounds(drawn(9, rng))
        tilts.append(np.linalg.norm(np.cross(merged.normal, NORMAL)))
        heights.append(merged.height_m - 6.0)
        assert np.linalg.norm(merged.normal) == pytest.approx(1.0)
    assert np.sqrt(np.mean(np.square(tilts))) == pytest.approx(np.sqrt(2) * SIGMA_RAD / 3, rel=0.2)
    assert np.sqrt(np.mean(np.square(heights))) == pytest.approx(SIGMA_M / 3, rel=0.2)


def test_what_errs_in_every_drive_is_not_averaged_away() -> None:
    drives = drawn(9, np.random.default_rng(1))
    one, nine = (made.covariance_level(OPENCV_AXES) for made in (drives[0].ground, merge_grounds(drives)))
    # But for the mast, which bends by a sixth of the tilt's sigma here.
    assert np.diag(nine) == pytest.approx(np.diag(one), rel=0.05)


def test_the_better_ground_counts_for_more() -> None:
    exact, vague = ground(np.zeros(3), 6.0, 0.1), ground(np.array([2 * SIGMA_RAD, 0.0, 0.0]), 6.03)
    for order in ([exact, vague], [vague, exact]):
        merged = merge_grounds([passage(each) for each in order])
        assert abs(merged.height_m - 6.0) < 0.003
        assert np.linalg.norm(np.cross(merged.normal, NORMAL)) < 0.1 * 2 * SIGMA_RAD


def test_a_sensor_that_was_moved_is_told_by_its_tilt_or_height() -> None:
    still = passage(ground(np.zeros(3), 6.0), "monday")
    for turn_rad, height_m in ((10 * SIGMA_RAD, 6.0), (0.0, 6.0 + 10 * SIGMA_M)):
        moved = passage(ground(np.array([turn_rad, 0.0, 0.0]), height_m), "tuesday")
        with pytest.raises(CombineError, match=r"moved between the drives: in tuesday .* off monday"):
            merge_grounds([still, moved])


def test_a_mast_in_the_sun_was_not_moved() -> None:
    """However sharp the grounds are: 0.1 deg is what the sun bends it."""
    sharp = [ground(np.array([turn, 0.0, 0.0]), 6.0, 1e-3) for turn in (0.0, 0.0017)]
    assert merge_grounds([passage(each) for each in sharp]).height_m == pytest.approx(6.0)


def test_all_that_was_seen_is_laid_onto_the_other_ground() -> None:
    own, other = ground(np.zeros(3), 6.0), ground(np.array([0.03, 0.0, 0.02]), 6.2)
    at = np.array([[20.0, 1.0, 0.5], [22.0, -1.0, 0.3]])
    drive = passage(own)
    first = drive.track.sightings[0]
    sighting = replace(first, points=at, low=Low(at, np.ones(2), np.ones(2)), borders=at)
    (laid,) = lay(replace(drive, track=Track((sighting,))), other, drive.world).track.sightings
    assert np.linalg.norm(laid.points - at, axis=1).min() > 0.1  # higher, and tilted
    assert laid.low.points == pytest.approx(laid.points)
    assert laid.borders == pytest.approx(laid.points)
