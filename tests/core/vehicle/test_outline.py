from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from laci_stereo.core.frames import FloatArray
from laci_stereo.core.vehicle.outline import (
    CAB_M,
    ENDS_HIGHEST_M,
    HEAVY_FRONT_HIGHEST_M,
    HEAVY_HIGHEST_M,
    HIGHEST_M,
    LOWEST_M,
    MIRRORS_M,
    OVERHANGS,
    SHAPE,
    SHAPE_MEAN,
    SHARP_M,
    SIDES_HIGHEST_M,
    WAIST_M,
    WHEEL_M,
    expected_shape,
    highest_of,
    meet,
    on_the_wall,
    touch,
)
from tests.core.outlines import CORNERS, SIZE, rectangle_points

FLAT = np.append(np.zeros(len(SHAPE) - 2), [-1.0, -1.0])
"""With corners as sharp as they get."""

places = st.tuples(st.floats(6.0, 60.0), st.floats(-3.1, 3.1), st.integers(0, 1000))


def sensor(distance: float, bearing: float) -> FloatArray:
    return distance * np.array([np.cos(bearing), np.sin(bearing)])


def met(xy: FloatArray, origin: FloatArray, shape: FloatArray = FLAT, sigma: float = 0.02, z_m: float = 0.4):
    n = len(xy)
    return meet(xy, np.tile(origin, (n, 1)), np.full(n, sigma), np.full(n, 0.003), SIZE, shape, np.full(n, z_m))


def beside_axles(x: FloatArray, length_m: float = SIZE[0]) -> FloatArray:
    """Return how far places along a car's side are from where the nearer axle is expected, shape (n,), metres."""
    ends = [np.abs(sign * length_m / 2 - x) - share * length_m for sign, share in zip((1, -1), OVERHANGS, strict=True)]
    return np.abs(ends).min(axis=0)


def rounded(radius: float) -> FloatArray:
    """Return the shape of the rectangle with corners that are round by so much."""
    return np.append(FLAT[:-2], np.full(2, SHARP_M * np.log(np.expm1(radius / SHARP_M))))


@given(places)
def test_points_on_the_rectangle_are_on_it(place: tuple[float, float, int]) -> None:
    origin = sensor(place[0], place[1])
    hits = met(rectangle_points(origin, 50, np.random.default_rng(place[2])), origin)
    assert hits.distance == pytest.approx(0.0, abs=0.001)  # the sharpest corners have a radius of 1 mm
    assert hits.reach == pytest.approx(1.0, abs=0.02)


@given(places, st.floats(-0.3, 0.3))
def test_the_distance_is_measured_along_the_normal_of_the_side_that_is_met(
    place: tuple[float, float, int], off: float
) -> None:
    origin = sensor(place[0], place[1])
    exact = rectangle_points(origin, 50, np.random.default_rng(place[2]))
    sight = (exact - origin) / np.linalg.norm(exact - origin, axis=1, keepdims=True)
    hits = met(exact + off * sight, origin)
    cos = -(hits.normal * sight).sum(axis=1)
    plain = np.abs(np.abs(exact) - np.array(SIZE) / 2).max(axis=1) > 0.03  # not at a corner
    assert (cos[plain] > 0.0).all()  # what is met faces the sensor
    assert hits.distance[plain] == pytest.approx((-off * cos)[plain], abs=1e-6)
    assert (hits.face == met(exact, origin).face)[plain].all()


@given(places, st.floats(0.1, 0.5))
def test_points_on_a_round_corner_are_on_it(place: tuple[float, float, int], radius: float) -> None:
    shape = rounded(radius)
    centre = np.array(SIZE) / 2 - radius
    # A corner that the sensor sees all of, from somewhere in its own quadrant.
    bearing = 0.3 + (abs(place[1]) % 1.0)
    angle = np.linspace(0.1, np.pi / 2 - 0.1, 30)
    arc = centre + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    origin = sensor(place[0] + 10.0, bearing)
    seen = ((origin - arc) * (arc - centre)).sum(axis=1) > 0.1
    hits = met(arc[seen], origin, shape)
    assert hits.distance == pytest.approx(0.0, abs=1e-6)
    assert hits.normal == pytest.approx((arc[seen] - centre) / radius, abs=1e-5)


def test_a_line_of_sight_that_passes_by_is_as_far_off_as_the_nearest_corner() -> None:
    origin = np.array([-20.0, 0.9 + 0.25])
    (hits,) = [met(np.array([[0.0, 1.15], [-2.0, 1.15]]), origin)]
    assert (hits.face == 4).all()
    assert hits.distance == pytest.approx(0.25, abs=1e-4)
    assert hits.normal == pytest.approx(np.array([[0.0, 1.0], [0.0, 1.0]]), abs=1e-6)


@settings(max_examples=30)
@given(places)
def test_the_derivatives_by_the_shape_are_those_of_the_range(place: tuple[float, float, int]) -> None:
    rng = np.random.default_rng(place[2])
    origin = sensor(place[0], place[1])
    xy = rectangle_points(origin, 60, rng) + rng.normal(0.0, 0.02, (60, 2))
    shape = SHAPE_MEAN + rng.normal(0.0, 0.01, len(SHAPE))
    at = met(xy, origin, shape)
    # Away from the corners, where one side takes over from the other. The derivatives leave out that a side which is
    # grazed is met elsewhere once it has moved, which is much within 3 deg and where a wheel begins.
    there = origin + (xy - origin) * at.reach[:, None]
    plain = (at.face < 4) & (at.cos > 0.05) & ((np.abs(there) < 0.6 * np.array(SIZE) / 2).sum(axis=1) == 1)
    away_m = beside_axles(there[:, 0])
    plain &= (at.face < 2) | (away_m < WHEEL_M[0] - 0.05) | (away_m > WHEEL_M[1] + 0.05)
    for index in range(len(SHAPE)):
        step = 1e-5 * np.eye(len(SHAPE))[index]
        more, less = met(xy, origin, shape + step), met(xy, origin, shape - step)
        same = plain & (more.face == less.face)
        ranges = more.distance[same] / more.cos[same] - less.distance[same] / less.cos[same]
        off = ranges / 2e-5 * at.cos[same] - at.by_shape[same, index]
        assert np.mean(np.abs(off) < 0.05) > 0.9


@given(places, st.floats(-5.0, 5.0), st.floats(-1.5, 1.5))
def test_an_outline_that_is_elsewhere_on_the_vehicle_is_met_as_one_in_its_middle(
    place: tuple[float, float, int], ahead_m: float, left_m: float
) -> None:
    rng = np.random.default_rng(place[2])
    origin = sensor(place[0], place[1])
    xy = rectangle_points(origin, 40, rng) + rng.normal(0.0, 0.1, (40, 2))
    shape = SHAPE_MEAN + rng.normal(0.0, 0.01, len(SHAPE))
    moved = shape.copy()
    moved[[SHAPE.index(name) for name in ("front", "rear", "lever_y")]] += ahead_m, -ahead_m, left_m
    by = np.array([ahead_m, left_m])
    to_left = rng.random(len(xy)) < 0.5
    origins = np.tile(origin, (len(xy), 1))
    for here, there in (
        (met(xy, origin, shape), met(xy + by, origin + by, moved)),
        (touch(xy, origins, to_left, SIZE, shape), touch(xy + by, origins + by, to_left, SIZE, moved)),
    ):
        assert (there.face == here.face).mean() > 0.95  # rounding puts a ray on the other side of an edge
        same = there.face == here.face
        for name in ("distance", "variance", "normal", "by_shape", "reach", "cos", "within"):
            off = np.abs(getattr(there, name) - getattr(here, name))[same]
            assert np.quantile(off, 0.9) < 1e-6, name


def lead_m(ray: FloatArray) -> float:
    """Return by how much one corner of the rectangle lies farther to either side of a line of sight than all others."""
    reached = np.sort(CORNERS @ np.array([-ray[1], ray[0]])) / np.linalg.norm(ray)
    return float(reached[-1] - reached[-2])  # and on the other side as much


@given(places, st.floats(0.05, 0.4), st.booleans())
def test_a_line_of_sight_that_touches_is_between_those_that_meet_and_those_that_pass(
    place: tuple[float, float, int], radius: float, to_left: bool
) -> None:
    origin = sensor(place[0], place[1])
    shape = rounded(radius)
    across = np.array([-origin[1], origin[0]]) / place[0] * (-1.0 if to_left else 1.0)  # seen from the sensor
    inside, outside = 0.0, 6.0
    for _ in range(50):
        middle = (inside + outside) / 2
        passes = met((middle * across)[None], origin, shape).cos[0] == 0.0
        inside, outside = (inside, middle) if passes else (middle, outside)
    ray = inside * across - origin
    assume(lead_m(ray) > 0.1)
    for off_m in (-0.02, 0.0, 0.02):
        aside = off_m * np.array([-ray[1], ray[0]]) / np.linalg.norm(ray) * (1.0 if to_left else -1.0)
        at = origin + ray + aside
        hits = touch(at[None], origin[None], np.array([to_left]), SIZE, shape)
        assert hits.distance[0] == pytest.approx(off_m * hits.reach[0], abs=0.02 * abs(off_m) + 1e-6)


@settings(max_examples=30)
@given(places)
def test_the_derivatives_by_the_shape_are_those_of_the_lines_that_touch(place: tuple[float, float, int]) -> None:
    rng = np.random.default_rng(place[2])
    origin = np.tile(sensor(place[0], place[1]), (2, 1))
    xy, to_left = rng.normal(0.0, 1.0, (2, 2)), np.array([False, True])
    shape = SHAPE_MEAN + rng.normal(0.0, 0.01, len(SHAPE))
    shape[SHAPE.index("cab")] = 0.0
    assume(min(map(lead_m, xy - origin)) > 0.3)  # or two corners are touched at once

    def distance(at: FloatArray) -> FloatArray:
        return touch(xy, origin, to_left, SIZE, at).distance

    steps = 1e-6 * np.eye(len(SHAPE))
    slopes = np.array([(distance(shape + step) - distance(shape - step)) / 2e-6 for step in steps]).T
    assert touch(xy, origin, to_left, SIZE, shape).by_shape == pytest.approx(slopes, abs=1e-4)


@given(places)
def test_bearing_decides_the_side_whatever_the_range(place: tuple[float, float, int]) -> None:
    origin = sensor(place[0], place[1])
    exact = rectangle_points(origin, 50, np.random.default_rng(place[2]))
    ray = exact - origin
    assert (met(origin + 1.02 * ray, origin).face == met(exact, origin).face).all()


def test_noise_across_counts_where_a_side_is_grazed() -> None:
    grazed = met(np.array([[0.0, 0.9]]), np.array([40.0, 1.5]), sigma=0.5)
    faced = met(np.array([[0.0, 0.9]]), np.array([0.0, 20.0]), sigma=0.5)
    assert faced.variance[0] > 0.25
    assert grazed.variance[0] < 0.01


@given(st.floats(-0.5, 0.5), st.floats(0.0, 0.2), st.floats(0.0, 0.3))
def test_the_wall_is_chosen_by_the_ray_not_by_the_noisy_point(off: float, sigma_z: float, blur_m: float) -> None:
    # A ray that meets the outline 20 m away at 0.45 m: however far off the point was measured, the answer is the same.
    height, far, z_met = 6.0, 20.0, 0.45
    measured = far + off
    z = height + (z_met - height) * measured / far
    reach = far / measured
    hits = replace(met(np.array([[0.0, 0.9]]), np.array([0.0, 20.9])), reach=np.array([reach]))
    highest = highest_of(1.8, hits.face, np.zeros(1), matched=False)
    chosen = on_the_wall(height, np.array([z]), hits, np.array([sigma_z]), np.array([blur_m / reach]), highest)
    # Where three sigma are more than the wall's lower edge, what is lower is there as well.
    exact = 3 * sigma_z <= LOWEST_M
    above_m = z_met - LOWEST_M - (2 * sigma_z if exact else blur_m)
    assume(abs(above_m) > 1e-9)
    assert chosen[0] == (above_m > 0.0)


def test_what_passes_by_is_surely_higher_than_the_road() -> None:
    hits = met(np.array([[0.0, 2.0], [0.0, 2.0]]), np.array([20.0, 2.0]))
    assert (hits.cos == 0.0).all()
    z, nothing = np.array([0.45, 0.6]), np.zeros(2)
    chosen = on_the_wall(6.0, z, hits, np.full(2, 0.1), nothing, highest_of(1.8, hits.face, nothing, matched=False))
    assert chosen.tolist() == [False, True]


@pytest.mark.parametrize(
    ("width_m", "origin", "highest_m"),
    [
        (1.8, (12.0, 0.0), ENDS_HIGHEST_M),
        (1.8, (-12.0, 0.0), ENDS_HIGHEST_M),
        (1.8, (0.0, 12.0), SIDES_HIGHEST_M),
        (2.5, (12.0, 0.0), HEAVY_FRONT_HIGHEST_M),
        (2.5, (-12.0, 0.0), HEAVY_HIGHEST_M),
        (2.5, (0.0, 12.0), HEAVY_HIGHEST_M),
    ],
    ids=[
        "a car from ahead",
        "a car from behind",
        "a car from the left",
        "a bus from ahead",
        "a bus from behind",
        "a bus from the left",
    ],
)
def test_a_side_is_used_as_far_up_as_it_is_upright(
    width_m: float, origin: tuple[float, float], highest_m: float
) -> None:
    z = np.array([highest_m - 0.1, highest_m + 0.1])
    on_it = np.sign(origin) * np.array(SIZE) / 2
    hits = met(np.array([on_it, on_it]), np.array(origin))
    highest = highest_of(width_m, hits.face, SIZE[0] / 2 - np.full(2, on_it[0]), matched=False)
    assert on_the_wall(highest_m, z, hits, np.full(2, 0.02), np.zeros(2), highest).tolist() == [True, False]


@pytest.mark.parametrize(
    ("width_m", "ahead_m", "behind_m"),
    [(1.8, HIGHEST_M, SIDES_HIGHEST_M), (2.5, HEAVY_FRONT_HIGHEST_M, HEAVY_HIGHEST_M)],
)
def test_neither_mirrors_nor_wings_are_the_sides(width_m: float, ahead_m: float, behind_m: float) -> None:
    # Mirrors stand out of a lorry's sides at 1.6 to 2.6 m, right behind its front.
    behind = np.array([0.0, 0.5, MIRRORS_M - 0.01, MIRRORS_M + 0.01])
    found = highest_of(width_m, np.full(4, 3), behind, matched=False)
    assert found.tolist() == [ahead_m] * 3 + [behind_m]


def test_what_shows_through_windows_is_matched_farther_down() -> None:
    for width_m, same in ((1.8, False), (2.5, True)):
        scanned, matched = (highest_of(width_m, np.full(1, 2), np.full(1, 2.0), matched=each) for each in (False, True))
        assert (scanned == matched).all() == same
        assert (matched <= scanned).all()


@given(places)
def test_how_far_within_its_borders_an_outline_is_met(place: tuple[float, float, int]) -> None:
    origin = sensor(place[0], place[1])
    xy = rectangle_points(origin, 40, np.random.default_rng(place[2]))
    hits = met(xy, origin)
    ray = (xy - origin) / np.linalg.norm(xy - origin, axis=1, keepdims=True)
    aside = ray[:, :1] * (CORNERS - origin)[:, 1] - ray[:, 1:] * (CORNERS - origin)[:, 0]
    nearer = np.minimum(aside.max(axis=1), -aside.min(axis=1))
    assert hits.within == pytest.approx(np.where(hits.cos > 0.0, nearer, 0.0), abs=1e-9)
    assert met(origin + 1.02 * (xy - origin), origin).within == pytest.approx(hits.within, abs=1e-9)


def test_the_sides_of_a_cab_stand_back_and_no_others() -> None:
    origin = np.array([9.0, 12.0])
    xy = rectangle_points(origin, 300, np.random.default_rng(0))
    shape = FLAT.copy()
    shape[SHAPE.index("cab")] = 0.08
    hits, flat = met(xy, origin, shape), met(xy, origin)
    off = hits.distance - flat.distance
    beside = (flat.face == 3) & (np.abs(xy[:, 0] - SIZE[0] / 2 + CAB_M) > 0.3) & (np.abs(xy[:, 0]) < 0.45 * SIZE[0])
    of_cab = xy[:, 0] > SIZE[0] / 2 - CAB_M
    assert (beside & of_cab).any()
    assert (beside & ~of_cab).any()
    assert off[beside & of_cab] == pytest.approx(0.08, abs=0.005)
    assert off[beside & ~of_cab] == pytest.approx(0.0, abs=1e-9)


def test_only_what_is_as_wide_as_a_lorry_may_have_a_cab() -> None:
    cab = SHAPE.index("cab")
    assert [expected_shape(width)[1][cab] > 0.01 for width in (1.8, 2.1, 2.3, 2.55)] == [False, False, True, True]


def test_the_sides_of_a_car_draw_in_towards_its_sills_and_its_ends_do_not() -> None:
    origin = np.array([9.0, 12.0])
    xy = rectangle_points(origin, 300, np.random.default_rng(0))
    shape = FLAT.copy()
    shape[SHAPE.index("sill")] = 0.06
    flat = met(xy, origin)
    away_m = beside_axles(xy[:, 0])
    beside, wheel = (flat.face == 3) & (away_m > 0.5), (flat.face == 3) & (away_m < 0.15)
    for z_m, in_m in ((LOWEST_M, 0.06), ((LOWEST_M + WAIST_M) / 2, 0.03), (WAIST_M, 0.0), (0.85, 0.0)):
        hits = met(xy, origin, shape, z_m=z_m)
        off = hits.distance - flat.distance
        assert off[beside] == pytest.approx(in_m, abs=0.002)
        assert off[wheel] == pytest.approx(0.0, abs=1e-9)
        assert off[(flat.face == 1) & (hits.face == 1)] == pytest.approx(0.0, abs=1e-9)


def test_the_outline_stands_out_at_its_wheels_wherever_a_maker_puts_them() -> None:
    # Front and rear overhang, length and width of cars, metres: the axles' tyres are on the outline, doors behind it.
    sill = FLAT.copy()
    sill[SHAPE.index("sill")] = 0.06
    for length_m, front_m, rear_m in ((3.57, 0.71, 0.56), (4.28, 0.88, 0.77), (4.71, 0.79, 1.07), (4.90, 0.91, 1.0)):
        x = np.array([length_m / 2 - front_m, 0.0, rear_m - length_m / 2])
        at, origin = np.column_stack([x, np.full(3, 0.9)]), np.tile([0.0, 15.0], (3, 1))
        off = [
            meet(at, origin, np.full(3, 0.02), np.full(3, 0.003), (length_m, 1.8), each, np.full(3, LOWEST_M)).distance
            for each in (FLAT, sill)
        ]
        assert off[1] - off[0] == pytest.approx([0.0, 0.06, 0.0], abs=0.006)


def test_the_sides_of_lorries_are_upright() -> None:
    mean, sigma = (each[SHAPE.index("sill")] for each in expected_shape(2.5))
    assert abs(mean) + 3.0 * sigma < SHAPE_MEAN[SHAPE.index("sill")]


def test_a_turned_vehicle_is_met_alike() -> None:
    # The outline is symmetric: mirroring the sensor and the points mirrors the answer.
    rng = np.random.default_rng(1)
    origin = np.array([12.0, 9.0])
    xy = rectangle_points(origin, 100, rng) + rng.normal(0.0, 0.05, (100, 2))
    mirror = np.array([1.0, -1.0])
    one, other = met(xy, origin, SHAPE_MEAN), met(xy * mirror, origin * mirror, SHAPE_MEAN)
    assert one.distance == pytest.approx(other.distance)
    assert one.normal == pytest.approx(other.normal * mirror)
