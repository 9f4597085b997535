from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from laci_stereo.core.errors import MatchError
from laci_stereo.core.frames import rotate_xy, wrap
from laci_stereo.core.matching import PlanarMatch, match_track
from laci_stereo.core.settings import MatchSettings
from tests.core.tracks import DRIVE, TRUTH

STAMPS = np.arange(0.0, 6.0, 0.1)

angles = st.floats(-np.pi, np.pi)
shifts = st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)).map(np.array)
motions = st.builds(PlanarMatch, angles, shifts)


@given(motions)
def test_a_rigid_motion_is_recovered(motion: PlanarMatch) -> None:
    level = DRIVE.at(STAMPS)[0]
    found = match_track(level, motion(level))
    assert abs(float(wrap(found.yaw_rad - motion.yaw_rad))) < 1e-9
    assert found(level) == pytest.approx(motion(level), abs=1e-6)


@given(motions, motions, st.integers(0, 1000))
@settings(max_examples=50)
def test_equivariance(of_level: PlanarMatch, of_world: PlanarMatch, seed: int) -> None:
    level = DRIVE.at(STAMPS)[0]
    world = TRUTH(level) + np.random.default_rng(seed).normal(0.0, 0.5, level.shape)
    found = match_track(level, world)
    moved = match_track(of_level(level), of_world(world))
    assert moved(of_level(level)) == pytest.approx(of_world(found(level)), abs=1e-6)
    assert abs(float(wrap(moved.yaw_rad - found.yaw_rad - of_world.yaw_rad + of_level.yaw_rad))) < 1e-9


def test_the_yaw_is_the_circular_mean_of_the_difference_angles() -> None:
    # About +-180 deg, where an ordinary mean would be 0.
    level = np.array([[10.0, 0.0], [20.0, 0.0], [0.0, 0.0]])
    world = np.array([rotate_xy(np.radians(179.0), level[0]), rotate_xy(np.radians(-177.0), level[1]), [0.0, 0.0]])
    found = match_track(level, world)
    assert np.degrees(found.yaw_rad) % 360.0 == pytest.approx(181.0)
    assert found.shift == pytest.approx((world - rotate_xy(found.yaw_rad, level)).mean(axis=0))


def test_short_vectors_are_left_out() -> None:
    level = np.array([[20.0, 0.0], [10.0, 0.0], [4.9, 0.0], [0.0, 0.0]])
    world = TRUTH(level)
    exact = match_track(level, world)
    world[2] = TRUTH(np.array([[0.0, 4.9]]))[0]
    assert match_track(level, world).yaw_rad == pytest.approx(exact.yaw_rad, abs=1e-12)
    turned = match_track(level, world, MatchSettings(min_vector_m=4.0))
    assert float(wrap(turned.yaw_rad - exact.yaw_rad)) > 0.1


def test_a_vector_that_is_short_in_one_of_the_tracks_is_left_out() -> None:
    level = np.array([[20.0, 0.0], [0.0, 3.0], [0.0, 0.0]])
    world = np.array([[20.0, 0.0], [6.0, 0.0], [0.0, 0.0]])
    assert match_track(level, world).yaw_rad == 0.0


@pytest.mark.parametrize("count", [0, 1, 2, 10])
def test_too_short(count: int) -> None:
    xy = np.column_stack([np.linspace(0.0, 4.5, count), np.zeros(count)])
    with pytest.raises(MatchError, match=r"at most \d\.\d m away from its last position.*needed are 10\.0 m"):
        match_track(xy, xy)
