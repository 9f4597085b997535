from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from laci_stereo.core.errors import BoxError
from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.settings import BoxSettings
from laci_stereo.core.tracking.box import Box, fit_box

CAR = np.array([4.4, 1.8])

angles = st.floats(-math.pi, math.pi)
sizes = st.tuples(st.floats(3.5, 12.0), st.floats(1.6, 2.55)).map(np.array)
distances = st.floats(5.0, 60.0)
boxes = st.builds(
    lambda x, y, width, longer, yaw: Box(np.array([x, y]), width + longer, width, yaw),
    st.floats(-50, 50),
    st.floats(-50, 50),
    st.floats(0.5, 3.0),
    st.floats(0.0, 10.0),
    st.floats(-math.pi / 2, 1.57),
)


def sensor_at(bearing: float, distance: float, size: FloatArray = CAR) -> FloatArray:
    """Stand so far from the outline, in the vehicle's frame."""
    direction = np.array([math.cos(bearing), math.sin(bearing)])
    with np.errstate(divide="ignore", over="ignore"):
        return direction * (np.min(size / 2 / np.abs(direction)) + distance)


def visible_sides(size: FloatArray, sensor: FloatArray) -> list[int]:
    """Front, left, rear, right."""
    return [int(i) for i in np.flatnonzero(np.concatenate([sensor > size / 2, sensor < -size / 2]))]


def side_points(size: FloatArray, side: int, where: FloatArray) -> FloatArray:
    """Points at these shares, -0.5 to 0.5, of one side."""
    xy = np.empty((len(where), 2))
    xy[:, side % 2] = size[side % 2] / 2 * (1 if side < 2 else -1)
    xy[:, 1 - side % 2] = size[1 - side % 2] * where
    return xy


def even_points(size: FloatArray, sides: list[int], per_metre: float = 15.0) -> FloatArray:
    """Points without noise, the corners among them."""
    return np.concatenate(
        [side_points(size, side, np.linspace(-0.5, 0.5, round(per_metre * size[1 - side % 2]) + 2)) for side in sides]
    )


def noisy_points(
    size: FloatArray, sensor: FloatArray, n: int, sigma_m: float, rng: np.random.Generator, fill: float = 0.0
) -> FloatArray:
    sides = visible_sides(size, sensor)
    share = np.array([size[1 - side % 2] for side in sides])
    per_side = rng.multinomial(n - round(fill * n), share / share.sum())
    parts = [side_points(size, side, rng.uniform(-0.5, 0.5, k)) for side, k in zip(sides, per_side, strict=True)]
    parts.append(rng.uniform(-0.5, 0.5, (round(fill * n), 2)) * size)
    xy = np.concatenate(parts)
    return xy + rng.normal(0.0, sigma_m, xy.shape)


def turned_by(yaw_rad: float, truth_rad: float) -> float:
    """Difference of directions, modulo 180 deg, in degrees."""
    return abs(math.degrees((yaw_rad - truth_rad + math.pi / 2) % math.pi - math.pi / 2))


def assert_same_box(found: Box, truth: Box, tolerance: float = 1e-6) -> None:
    assert found.length_m == pytest.approx(truth.length_m, abs=tolerance)
    assert found.width_m == pytest.approx(truth.width_m, abs=tolerance)
    assert found.centre == pytest.approx(truth.centre, abs=tolerance)
    assert turned_by(found.yaw_rad, truth.yaw_rad) < math.degrees(tolerance)


def yaw_errors_deg(
    n: int, sigma_m: float, *, fill: float = 0.0, known: bool = False, cars: int = 150, corner_seen: bool = False
) -> FloatArray:
    """Turn cars of many sizes in front of sensors at random, and see how far the fit is off."""
    rng = np.random.default_rng(20190827)
    errors: list[float] = []
    while len(errors) < cars:
        size = rng.uniform([3.5, 1.6], [5.2, 2.0])
        sensor = sensor_at(rng.uniform(-math.pi, math.pi), rng.uniform(5.0, 60.0), size)
        if corner_seen and len(visible_sides(size, sensor)) < 2:
            continue
        yaw = rng.uniform(-math.pi, math.pi)
        xy = noisy_points(size, sensor, n, sigma_m, rng, fill)
        box = fit_box(rotate_xy(yaw, xy), sensor_xy=rotate_xy(yaw, sensor), sigma_m=sigma_m if known else None)
        longer = (
            0.0 if len(visible_sides(size, sensor)) == 2 or sensor[0] ** 2 < sensor[1] ** 2 or fill else math.pi / 2
        )
        errors.append(turned_by(box.yaw_rad, yaw + longer))
    return np.array(errors)


@given(size=sizes, yaw=angles, bearing=angles, distance=distances)
@example(size=CAR, yaw=0.0, bearing=math.pi / 4, distance=20.0)
@example(size=CAR, yaw=math.pi / 4, bearing=math.pi / 4, distance=20.0)
@example(size=CAR, yaw=math.pi / 4, bearing=-math.pi / 4, distance=20.0)
@example(size=CAR, yaw=math.pi / 4, bearing=math.atan2(1.8, 4.4), distance=20.0)
@example(size=np.array([2.2, 2.0]), yaw=math.pi / 4, bearing=math.pi / 4, distance=60.0)
def test_two_exact_sides_give_the_exact_rectangle(
    size: FloatArray, yaw: float, bearing: float, distance: float
) -> None:
    sensor = sensor_at(bearing, distance, size)
    assume(len(visible_sides(size, sensor)) == 2)
    xy = even_points(size, visible_sides(size, sensor))
    place = np.array([31.0, -12.0])

    box = fit_box(rotate_xy(yaw, xy) + place, sensor_xy=rotate_xy(yaw, sensor) + place)

    assert_same_box(box, Box(place, size[0], size[1], yaw))


@given(size=sizes, yaw=angles, bearing=angles, distance=distances)
def test_four_exact_sides_give_the_exact_rectangle(
    size: FloatArray, yaw: float, bearing: float, distance: float
) -> None:
    xy = even_points(size, [0, 1, 2, 3])
    box = fit_box(rotate_xy(yaw, xy), sensor_xy=rotate_xy(yaw, sensor_at(bearing, distance, size)))
    assert_same_box(box, Box(np.zeros(2), size[0], size[1], yaw))


@given(side=st.integers(0, 3), yaw=angles, bearing=angles, distance=distances)
def test_one_side_gives_a_flat_box_along_it(side: int, yaw: float, bearing: float, distance: float) -> None:
    xy = even_points(CAR, [side])
    box = fit_box(rotate_xy(yaw, xy), sensor_xy=rotate_xy(yaw, sensor_at(bearing, distance)))
    along = yaw if side % 2 else yaw + math.pi / 2
    assert_same_box(box, Box(rotate_xy(yaw, xy.mean(axis=0)), CAR[1 - side % 2], 0.0, along))


@pytest.mark.parametrize("yaw_deg", [0, 17, 45, 90, 135])
@pytest.mark.parametrize("fill", [0.0, 0.3])
def test_every_bearing_of_the_sensor_finds_the_same_car(yaw_deg: int, fill: float) -> None:
    rng = np.random.default_rng(7)
    yaw = math.radians(yaw_deg)
    onto_corners = np.arctan2([1.8, 1.8, -1.8, -1.8], [4.4, -4.4, -4.4, 4.4])
    for bearing in [*np.arange(-math.pi, math.pi, math.radians(5.0)), *onto_corners]:
        sensor = sensor_at(bearing, 15.0)
        if len(visible_sides(CAR, sensor)) < 2:
            continue
        xy = noisy_points(CAR, sensor, 200, 0.02, rng, fill)
        box = fit_box(rotate_xy(yaw, xy), sensor_xy=rotate_xy(yaw, sensor))
        assert turned_by(box.yaw_rad, yaw) < 1.0
        assert box.length_m == pytest.approx(4.4, abs=0.2)
        assert box.width_m == pytest.approx(1.8, abs=0.2)


@given(turn=angles, x=st.floats(-1e3, 1e3), y=st.floats(-1e3, 1e3), seed=st.integers(0, 50))
def test_moving_the_scene_moves_the_box(turn: float, x: float, y: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    sensor = sensor_at(rng.uniform(-math.pi, math.pi), 20.0)
    xy = noisy_points(CAR, sensor, 120, 0.05, rng, fill=0.2)
    shift = np.array([x, y])

    at_rest = fit_box(xy, sensor_xy=sensor)
    moved = fit_box(rotate_xy(turn, xy) + shift, sensor_xy=rotate_xy(turn, sensor) + shift)

    expected = replace(at_rest, centre=rotate_xy(turn, at_rest.centre) + shift, yaw_rad=float(at_rest.yaw_rad + turn))
    assert_same_box(moved, expected)


@given(scale=st.floats(0.01, 100.0), seed=st.integers(0, 50))
def test_scaling_scene_and_settings_scales_the_box(scale: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    sensor = sensor_at(rng.uniform(-math.pi, math.pi), 20.0)
    xy = noisy_points(CAR, sensor, 120, 0.05, rng, fill=0.2)
    metres = BoxSettings()
    scaled = BoxSettings(
        light_bin_m=scale * metres.light_bin_m,
        bar_bin_m=scale * metres.bar_bin_m,
        line_tolerance_m=scale * metres.line_tolerance_m,
        max_tolerance_m=scale * metres.max_tolerance_m,
    )

    small = fit_box(xy, metres, sensor)
    large = fit_box(scale * xy, scaled, scale * sensor)

    expected = Box(scale * small.centre, scale * small.length_m, scale * small.width_m, small.yaw_rad)
    assert_same_box(large, expected, tolerance=1e-6 * max(scale, 1.0))


@given(order=st.permutations(range(80)), copies=st.integers(1, 3), seed=st.integers(0, 50))
def test_order_and_copies_of_the_points_do_not_matter(order: list[int], copies: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    sensor = sensor_at(rng.uniform(-math.pi, math.pi), 20.0)
    xy = noisy_points(CAR, sensor, 80, 0.05, rng, fill=0.2)
    assert_same_box(fit_box(np.tile(xy[order], (copies, 1)), sensor_xy=sensor), fit_box(xy, sensor_xy=sensor))


@pytest.mark.parametrize(("fill", "limit_deg"), [(0.0, 0.75), (0.3, 1.1)])
@pytest.mark.parametrize("n", [60, 200])
def test_yaw_of_a_seen_corner_is_within_the_target(n: int, fill: float, limit_deg: float) -> None:
    errors = yaw_errors_deg(n, 0.02, fill=fill, corner_seen=True)
    assert np.percentile(errors, 95) < limit_deg


def test_sides_behind_and_points_inside_do_not_distract_a_sparse_fit() -> None:
    rng = np.random.default_rng(11)
    errors = []
    for _ in range(300):
        sensor = sensor_at(rng.uniform(-math.pi, math.pi), 20.0)
        around = [side_points(CAR, side, rng.uniform(-0.5, 0.5, k)) for side, k in enumerate((8, 18, 8, 18))]
        xy = np.concatenate([*around, rng.uniform(-0.5, 0.5, (8, 2)) * CAR])
        errors.append(turned_by(fit_box(xy + rng.normal(0.0, 0.02, xy.shape), sensor_xy=sensor).yaw_rad, 0.0))
    assert np.percentile(errors, 99) < 4.0


@pytest.mark.parametrize("known", [False, True])
@pytest.mark.parametrize("fill", [0.0, 0.3])
def test_error_grows_with_noise_but_no_box_is_turned_over(known: bool, fill: float) -> None:
    medians = []
    for sigma_m, limit_deg in ((0.02, 1.5), (0.1, 5.0), (0.3, 15.0)):
        errors = yaw_errors_deg(200, sigma_m, fill=fill, known=known)
        medians.append(float(np.median(errors)))
        assert np.percentile(errors, 95) < limit_deg
        assert errors.max() < 35.0
    # Twice what one line through all 200 points, 4.4 m long, would reach.
    assert medians[2] < 2 * math.degrees(0.3 / (4.4 / math.sqrt(12) * math.sqrt(200)))
    assert medians == sorted(medians)


def test_noise_from_depth_alone_turns_no_box_over() -> None:
    rng = np.random.default_rng(3)
    errors = []
    for bearing in np.arange(-math.pi, math.pi, math.radians(3.0)):
        sensor = sensor_at(bearing, 25.0)
        if len(visible_sides(CAR, sensor)) < 2:
            continue
        xy = noisy_points(CAR, sensor, 200, 0.01, rng, fill=0.1)
        sight = (xy - sensor) / np.linalg.norm(xy - sensor, axis=1, keepdims=True)
        box = fit_box(xy + sight * rng.normal(0.0, 0.4, (200, 1)), sensor_xy=sensor, sigma_m=0.4)
        errors.append(turned_by(box.yaw_rad, 0.0))
    assert np.median(errors) < 3.0
    assert max(errors) < 30.0


@given(
    xy=arrays(np.float64, st.tuples(st.integers(3, 30), st.just(2)), elements=st.floats(-1e3, 1e3, width=32)),
    sensor=st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)),
)
@settings(max_examples=200)
def test_any_points_lie_in_their_box(xy: FloatArray, sensor: tuple[float, float]) -> None:
    assume((xy != xy[0]).any())
    box = fit_box(xy, sensor_xy=sensor)
    assert box.contains(xy, margin_m=1e-6).all()
    assert box.length_m >= box.width_m >= 0.0
    assert abs(box.yaw_rad) <= math.pi / 2


def test_a_far_outlier_costs_no_memory() -> None:
    xy = np.concatenate([even_points(CAR, [0, 1]), [[1e12, 1e12]]])
    assert fit_box(xy, sensor_xy=(10.0, 10.0)).length_m > 1e12


def test_a_sensor_in_the_midst_of_the_points_is_no_obstacle() -> None:
    xy = even_points(CAR, [0, 1, 2, 3])
    assert_same_box(fit_box(xy, sensor_xy=xy.mean(axis=0)), Box(np.zeros(2), 4.4, 1.8, 0.0))


@given(box=boxes)
def test_corners_span_the_box_counter_clockwise(box: Box) -> None:
    corners = box.corners()
    edges = np.roll(corners, -1, axis=0) - corners
    nexts = np.roll(edges, -1, axis=0)
    assert (edges[:, 0] * nexts[:, 1] - edges[:, 1] * nexts[:, 0] > 0).all()
    assert np.linalg.norm(edges, axis=1) == pytest.approx([box.length_m, box.width_m] * 2)
    assert corners.mean(axis=0) == pytest.approx(box.centre)
    assert turned_by(math.atan2(edges[2, 1], edges[2, 0]), box.yaw_rad) < 1e-6


@given(box=boxes, margin=st.floats(0.0, 2.0), seed=st.integers(0, 1000))
def test_contains_agrees_with_the_polygon_of_the_corners(box: Box, margin: float, seed: int) -> None:
    xy = box.centre + np.random.default_rng(seed).uniform(-9.0, 9.0, (300, 2))
    polygon = replace(box, length_m=box.length_m + 2 * margin, width_m=box.width_m + 2 * margin).corners()
    edges = np.roll(polygon, -1, axis=0) - polygon
    to_points = xy[:, None] - polygon
    left_of = edges[:, 0] * to_points[..., 1] - edges[:, 1] * to_points[..., 0]
    clear = (np.abs(left_of) > 1e-9).all(axis=1)
    assert (box.contains(xy, margin)[clear] == (left_of > 0).all(axis=1)[clear]).all()
    assert box.contains(box.corners(), margin_m=1e-9).all()
    assert not box.contains(box.corners(), margin_m=-1e-6).any()


GOOD = even_points(CAR, [0, 1])


@pytest.mark.parametrize(
    ("xy", "sensor", "sigma", "message"),
    [
        (np.zeros((0, 2)), (0.0, 0.0), None, "xy: 0 points, needed are at least 3"),
        (GOOD[:2], (0.0, 0.0), None, "xy: 2 points, needed are at least 3"),
        (np.full((9, 2), 0.1), (0.0, 0.0), None, "xy: 9 points at one place, needed are at least 2 places"),
        (np.zeros((5, 3)), (0.0, 0.0), None, r"xy: shape \(5, 3\), needed is \(n, 2\)"),
        (np.zeros(6), (0.0, 0.0), None, r"xy: shape \(6,\), needed is \(n, 2\)"),
        (np.vstack([GOOD, [[math.nan, 0.0]]]), (0.0, 0.0), None, "xy: 1 points that are not finite, needed are 0"),
        (np.vstack([GOOD, [[0.0, -math.inf]]]), (0.0, 0.0), None, "xy: 1 points that are not finite, needed are 0"),
        (GOOD, (0.0, 0.0, 0.0), None, r"sensor_xy: shape \(3,\), needed is \(2,\)"),
        (GOOD, (0.0, math.inf), None, r"sensor_xy: \(0.0, inf\), needed are finite numbers"),
        (GOOD, (0.0, 0.0), -0.1, "sigma_m: -0.1, needed is a finite number from 0"),
        (GOOD, (0.0, 0.0), math.nan, "sigma_m: nan, needed is a finite number from 0"),
    ],
)
def test_degenerate_input_is_refused_in_one_line(
    xy: FloatArray, sensor: tuple[float, ...], sigma: float | None, message: str
) -> None:
    with pytest.raises(BoxError, match=f"^{message}$"):
        fit_box(xy, sensor_xy=sensor, sigma_m=sigma)
