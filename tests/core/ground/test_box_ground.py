from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as effort
from hypothesis import strategies as st

from laci_stereo.core.frames import FORWARD_LEFT_UP_AXES, Axes, FloatArray, IntArray
from laci_stereo.core.ground.box_ground import (
    BOX_HEIGHT_SIGMA_M,
    LEVEL_SIGMA_RAD,
    Unlike,
    elsewhere_below,
    level_ground,
    unlike_origin,
)
from laci_stereo.core.settings import GroundSettings

SETTINGS = GroundSettings()
ABOVE_M = 5.0
HEIGHTS = (1.5, 1.5, 2.5, 3.2, 1.6, 3.0, 1.4, 2.6)


@dataclass(frozen=True)
class Parade:
    """Objects that drive past on lanes of their own, on a plane that falls by 5 % ahead and rises by 2 % to the left.

    Attributes
    ----------
    bottoms, middles : ndarray, shape (n, 3)
        The boxes' points, sensor frame.
    half_m : ndarray, shape (n,)
        Half of the boxes' heights.
    objects : list of ndarray
        The rows of each object.
    """

    bottoms: FloatArray
    middles: FloatArray
    half_m: FloatArray
    objects: list[IntArray]

    def unlike(self, points: FloatArray, *above_m: FloatArray) -> Unlike | None:
        return unlike_origin(points, (above_m[0], above_m[1]), self.objects, FORWARD_LEFT_UP_AXES, SETTINGS)


def parade(heights: tuple[float, ...] = HEIGHTS, seed: int = 0, noise_m: float = 0.05, boxes: int = 30) -> Parade:
    rng = np.random.default_rng(seed)
    n = len(heights) * boxes
    x = np.repeat(10.0 + 3.0 * np.arange(len(heights)), boxes)
    y = np.tile(np.linspace(-15.0, 15.0, boxes), len(heights))
    bottoms = np.column_stack([x, y, -ABOVE_M - 0.05 * x + 0.02 * y]) + noise_m * rng.normal(size=(n, 3))
    half_m = np.repeat(heights, boxes) / 2
    middles = bottoms + half_m[:, None] * [0.0, 0.0, 1.0]
    return Parade(bottoms, middles, half_m, np.split(np.arange(n), len(heights)))


@given(st.integers(0, 10_000))
@effort(max_examples=20, deadline=None)
def test_the_wrong_point_of_boxes_of_different_heights_is_told(seed: int) -> None:
    made = parade(seed=seed)
    no_m = np.zeros(len(made.half_m))
    assert made.unlike(made.middles, made.half_m, no_m) is None
    assert made.unlike(made.bottoms, no_m, made.half_m) is None
    for wrong in (made.unlike(made.bottoms, made.half_m, no_m), made.unlike(made.middles, no_m, made.half_m)):
        assert wrong is not None
        assert wrong.given_m > 4 * wrong.other_m


def test_unknown_heights_tell_nothing() -> None:
    made = parade()
    half_m, no_m = made.half_m.copy(), np.zeros(len(made.half_m))
    half_m[::3] = np.nan
    assert made.unlike(made.middles, no_m, half_m) is not None
    assert made.unlike(made.bottoms, no_m, half_m) is None
    assert made.unlike(made.middles, no_m, np.full(len(half_m), np.nan)) is None


@pytest.mark.parametrize("seed", range(10))
def test_heights_that_a_detector_errs_about_do_not_tell_the_point(seed: int) -> None:
    """Among vehicles of one height, the plane below the boxes' middles is exact without their heights."""
    made = parade((1.5,) * 8, noise_m=0.0)
    errs = np.repeat(BOX_HEIGHT_SIGMA_M * np.random.default_rng(seed).normal(size=8), 30)
    assert made.unlike(made.middles, made.half_m + errs / 2, np.zeros(240)) is None


def test_no_single_object_tells_the_point() -> None:
    made = parade((1.5,) * 8, noise_m=0.01)
    half_m = made.half_m.copy()
    half_m[made.objects[3]] = 2.5
    assert made.unlike(made.middles, half_m, np.zeros(240)) is None


def test_few_objects_or_few_boxes_tell_nothing() -> None:
    for made in (parade(HEIGHTS[:3]), parade(boxes=9)):
        assert made.unlike(made.bottoms, made.half_m, np.zeros(len(made.half_m))) is None


def test_a_point_that_no_ground_is_below_is_no_answer() -> None:
    made = parade()
    above = made.bottoms * [1.0, 1.0, -1.0]
    assert made.unlike(above, made.half_m, np.zeros(len(made.half_m))) is None


@pytest.mark.parametrize(
    ("into", "name"),
    [
        ([[1, 0, 0], [0, -1, 0], [0, 0, -1]], "z down"),
        ([[1, 0, 0], [0, 0, -1], [0, 1, 0]], "y down"),
        ([[0, 0, -1], [0, 1, 0], [1, 0, 0]], "y forward, x down"),
    ],
)
def test_axes_that_have_a_ground_are_named(into: list[list[int]], name: str) -> None:
    made = parade()
    R = np.array(into, dtype=np.float64)
    arguments = made.half_m, made.objects, FORWARD_LEFT_UP_AXES, SETTINGS
    assert elsewhere_below(made.middles, *arguments) == ""
    assert elsewhere_below(made.middles @ R.T, *arguments) == f"there is a ground with --axes '{name}'"


def test_the_doubt_of_a_vertical_axis_is_the_tilts() -> None:
    for axes in (FORWARD_LEFT_UP_AXES, Axes((0.0, 0.0, 1.0), (0.0, -1.0, 0.0))):
        by_bubble, doubted = level_ground(5.0, axes), level_ground(5.0, axes, 0.05)
        assert np.sqrt(np.diag(by_bubble.covariance_level(axes))[:2]) == pytest.approx([LEVEL_SIGMA_RAD] * 2)
        assert np.sqrt(np.diag(doubted.covariance_level(axes))) == pytest.approx([0.05, 0.05, 0.05])
