from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as effort
from hypothesis import strategies as st

from laci_stereo.core.errors import GroundError
from laci_stereo.core.frames import FORWARD_LEFT_UP_AXES, Axes, FloatArray, IntArray
from laci_stereo.core.ground.box_ground import (
    LEVEL_SIGMA_RAD,
    Unlike,
    elsewhere_below,
    level_ground,
    plane_below,
    unlike_origin,
)
from laci_stereo.core.ground.box_heights import BOX_HEIGHT_SIGMA_M, OBJECT_SIGMA_M
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


@dataclass(frozen=True)
class Lanes:
    """Objects on two straight lanes 3.5 m apart, on a level road 5 m below the sensor, each with an error of its own.

    With ``turns`` every second object turns off to the left, so that it drives across the lanes, too.
    """

    per_lane: int
    error_m: float
    turns: bool = False
    noise_m: float = 0.05
    boxes: int = 60

    def fitted(self, seed: int) -> tuple[float, float, float]:
        """Return the error of the slope across the lanes, rad, its standard deviation, and the error in height, m."""
        rng = np.random.default_rng(seed)
        points = np.concatenate([self._object(index, rng) for index in range(2 * self.per_lane)])
        objects = np.split(np.arange(len(points)), 2 * self.per_lane)
        plane = plane_below(points, np.zeros(len(points)), objects, FORWARD_LEFT_UP_AXES, SETTINGS)
        sigma = float(np.sqrt(plane.covariance_level(FORWARD_LEFT_UP_AXES)[0, 0]))
        return float(plane.normal[1]), sigma, plane.height_m - ABOVE_M

    def _object(self, index: int, rng: np.random.Generator) -> FloatArray:
        x = np.linspace(8.0, 48.0, self.boxes)
        y = np.full(self.boxes, 3.5 * (index % 2))
        if self.turns and index % 2:
            y = y + (x - 28.0).clip(0.0)
        z = -ABOVE_M + self.error_m * rng.normal() + self.noise_m * rng.normal(size=self.boxes)
        return np.column_stack([x, y, z])


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


@pytest.mark.parametrize("per_lane", [1, 2, 4])
def test_errors_that_objects_keep_are_in_the_tilt_across_their_lanes(per_lane: int) -> None:
    """Whatever they are, up to twice what is assumed: by detectors of their own, each of another error."""
    errors_m = np.linspace(0.0, 2.0 * OBJECT_SIGMA_M, 60)
    found = [Lanes(per_lane, error_m).fitted(seed)[:2] for seed, error_m in enumerate(errors_m.tolist())]
    normalised = np.array([error / sigma for error, sigma in found])
    assert np.sqrt((normalised**2).mean()) < 1.27  # the rms of 60 normal deviates exceeds it once in 500 times
    assert np.mean(np.abs(normalised) > 3.0) < 0.05


@pytest.mark.parametrize("per_lane", [1, 2, 4])
def test_a_detector_without_such_errors_pays_at_most_what_is_assumed(per_lane: int) -> None:
    sigma = np.median([Lanes(per_lane, 0.0).fitted(seed)[1] for seed in range(5)])
    # The error of one lane's objects against the other's, a lane's width apart.
    assumed = OBJECT_SIGMA_M * np.sqrt(2.0 / per_lane) / 3.5
    assert sigma < 1.1 * assumed if per_lane == 1 else sigma < 0.7 * assumed


def test_a_turn_tells_the_tilt_whatever_objects_keep() -> None:
    found = np.array([Lanes(2, 0.3, turns=True).fitted(seed) for seed in range(20)])
    assert np.degrees(np.abs(found[:, 0]).max()) < 0.3
    assert np.sqrt(((found[:, 0] / found[:, 1]) ** 2).mean()) < 1.45  # of 20 normal deviates, once in 250 times


def test_lanes_that_errors_of_objects_leave_untold_are_refused() -> None:
    with pytest.raises(GroundError, match=r"standard deviation of the tilt .* at most 3 deg needed; record more"):
        Lanes(2, 0.15).fitted(1)
