from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from laci_stereo.core.frames import FloatArray
from laci_stereo.core.ground.road_cells import LASER_RAD, Cells
from laci_stereo.core.ground.road_extent import evened
from laci_stereo.core.ground.road_surface import FALL, UNEVEN_M, Surface, rough, smooth

SIGMA_M = 0.01
LANE_M = 3.5
LEVEL = np.zeros(3)


def apart(n: int) -> FloatArray:
    """Return directions of which no two are in one window."""
    return np.repeat(np.arange(n, dtype=np.float64)[:, None], 2, axis=1)


def by_camera(n: int) -> FloatArray:
    return np.full(n, np.nan)


def cells(left_m: FloatArray, along_m: FloatArray, z: FloatArray, sigma_m: float = SIGMA_M) -> Cells:
    """Return cells along a straight way along x, of exact places."""
    n = len(z)
    noise = np.full(n, sigma_m)
    piece = np.zeros(n, dtype=np.int64)
    return Cells(np.column_stack([along_m, left_m]), z, noise**2, noise, left_m, piece, apart(n), by_camera(n))


def road(
    rng: np.random.Generator, beside_m: tuple[float, float], slopes: FloatArray, fall: float, crown_m: float
) -> Cells:
    """Return noisy cells of a road that is as uneven as ISO 8608's class B, from the one to the other side of a way."""
    along, left = rng.uniform(-15.0, 15.0, 400), rng.uniform(*beside_m, 400)
    away = np.hypot(along - along[:, None], left - left[:, None])
    uneven = np.linalg.cholesky(rough(away) + 1e-10 * np.eye(400)) @ rng.normal(size=400)
    z = slopes @ [along, left] - fall * np.abs(left - crown_m) + uneven + rng.normal(0.0, SIGMA_M, 400)
    return cells(left, along, z)


@pytest.mark.parametrize("crown_m", [-2.0, 1.5, 3.0])
@pytest.mark.parametrize("fall", [0.01, 0.025])
def test_the_crown_is_told_from_the_plane_where_both_sides_are_seen(fall: float, crown_m: float) -> None:
    slopes = np.array([0.01, -0.02])
    seen = road(np.random.default_rng(0), (crown_m - LANE_M, crown_m + LANE_M), slopes, fall, crown_m)
    value, covariance, by_crown = Surface(seen, 0.0, LEVEL, 0.0).plane()
    off = value[1:] - slopes
    assert off @ np.linalg.solve(covariance[1:, 1:], off) < 3.0**2
    assert np.degrees(np.sqrt(covariance[2, 2])) < 0.3
    assert by_crown[2, 2] < FALL**2 / 10


def test_one_side_of_a_crown_does_not_tell_the_plane() -> None:
    slopes, fall = np.zeros(2), 0.02
    seen = road(np.random.default_rng(0), (-5.0, 0.0), slopes, fall, 1.0)
    value, covariance, by_crown = Surface(seen, 0.0, LEVEL, 0.0).plane()
    assert abs(value[2]) < 3.0 * np.sqrt(covariance[2, 2])
    assert np.sqrt(by_crown[2, 2]) > FALL / 4
    # Along the way there is nothing to confuse it with.
    assert by_crown[1, 1] < by_crown[2, 2] / 100


def test_a_flat_road_may_be_one_side_of_a_crown_that_is_not_seen() -> None:
    value, covariance, by_crown = Surface(
        road(np.random.default_rng(0), (-3.0, 3.0), np.zeros(2), 0.0, 0.0), 0.0, LEVEL, 0.0
    ).plane()
    assert abs(value[2]) < 3.0 * np.sqrt(covariance[2, 2])
    assert np.sqrt(by_crown[2, 2]) > FALL / 4


def test_the_doubt_is_that_of_the_error_over_random_roads() -> None:
    rng = np.random.default_rng(1)
    squares = []
    for _ in range(60):
        crown_m, fall = rng.uniform(-4.0, 4.0), rng.uniform(0.0, 0.025)
        slopes, left_m, width_m = rng.normal(0.0, 0.015, 2), rng.uniform(-5.0, -1.0), rng.uniform(3.0, 9.0)
        value, covariance, _ = Surface(
            road(rng, (left_m, left_m + width_m), slopes, fall, crown_m), 0.0, LEVEL, 0.0
        ).plane()
        off = value[1:] - slopes
        squares.append(off @ np.linalg.solve(covariance[1:, 1:], off))
    # Chi-square of two degrees of freedom: mean 2. The road might be bent, and is not, so that it is less.
    assert 0.2 < np.mean(squares) < 2.0
    assert np.mean(np.array(squares) > 3.0**2) < 0.05


@pytest.mark.parametrize(("covariance", "power"), [(rough, 2.0), (smooth, 3.0)])
def test_the_spectrum_of_a_road_is_that_of_iso_8608_class_b(
    covariance: Callable[[FloatArray], FloatArray], power: float
) -> None:
    # Of G(0.1 / m) = 64e-6 m^3, and far above 1 / l = 0.011 / m it falls with a power of the wave number.
    def density(per_m: float) -> float:
        found, _ = quad(
            lambda x: 4.0 * float(covariance(np.array(x))), 0.0, np.inf, weight="cos", wvar=2 * np.pi * per_m
        )
        return float(found)

    assert density(0.1) == pytest.approx(64e-6, rel=0.03)
    assert density(0.2) / density(0.1) == pytest.approx(0.5**power, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("height_m", [0.008, 0.015, 0.03])
def test_long_waves_of_a_street_do_not_make_one_side_of_its_crown_a_verge(height_m: float) -> None:
    rng = np.random.default_rng(3)
    for _ in range(6):
        along, from_crown = rng.uniform(-40.0, 40.0, 800), rng.uniform(-6.5, 6.5, 800)
        waves = height_m * np.sin(2 * np.pi * (along / rng.uniform(40.0, 60.0) + rng.random()))
        z = waves - 0.02 * np.abs(from_crown) + rng.normal(0.0, 0.005, 800)
        seen = cells(from_crown + rng.choice([-2.2, 2.2]), along, z, 0.005)
        value, covariance, _ = Surface(seen, 0.0, LEVEL, 0.0, edges=True).plane()
        assert value[1:] @ np.linalg.solve(covariance[1:, 1:], value[1:]) < 3.0**2


def wandering(along_m: FloatArray) -> FloatArray:
    """Return how far beside its lane a vehicle, or the boxes on it, are: a quarter of a metre."""
    return 0.35 * np.sin(along_m / 5.0)


def test_a_way_that_wanders_leaves_what_a_crown_beyond_view_does_as_open_as_a_straight_one() -> None:
    rng = np.random.default_rng(11)
    along, beside = rng.uniform(-20.0, 20.0, 600), rng.uniform(-2.0, 2.5, 600)
    z, sigma_m = rng.normal(0.0, 0.002, 600), 0.002
    even, wanders = (
        Surface(evened(replace(cells(beside, along, z, sigma_m), left_m=left_m)), 0.0, LEVEL, 0.0).plane()[2]
        for left_m in (beside, beside - wandering(along))
    )
    assert np.sqrt(even[2, 2]) > FALL / 2
    assert np.sqrt(wanders[2, 2]) > 0.8 * np.sqrt(even[2, 2])


def test_the_wider_the_less_likely_is_one_side_of_a_crown_all_that_is_seen() -> None:
    """The way turns, so that only a crown that is straight may be beyond view; of two lanes to a side more is seen."""
    rng = np.random.default_rng(12)
    left, along, across = rng.uniform(-4.0, 4.0, 600), rng.uniform(-12.0, 12.0, 600), rng.uniform(0.0, 1.0, 600)
    flat = cells(left, along, rng.normal(0.0, 0.004, 600), 0.004)
    doubts = []
    for width_m in (6.5, 8.5, 10.5, 14.0):
        seen = replace(flat, xy=np.column_stack([along, width_m * across]))
        _, _, by_crown = Surface(seen, 0.0, LEVEL, 0.0).plane()
        doubts.append(np.sqrt(by_crown[2, 2]))
    assert (np.diff(doubts) < 0.0).all()
    assert doubts[1] > FALL / 8


def crossed(rng: np.random.Generator, slopes: FloatArray, fall: float, towards_rad: float, radius_m: float) -> Cells:
    """Return noisy cells around an arc of a way, which begins along x and crosses a straight crown in its middle."""
    angle = rng.uniform(-8.0, 8.0, 400) / radius_m
    left = rng.uniform(-4.0, 4.0, 400)
    xy = np.column_stack([(radius_m - left) * np.sin(angle), radius_m - (radius_m - left) * np.cos(angle)])
    away = np.linalg.norm(xy[:, None] - xy, axis=2)
    uneven = np.linalg.cholesky(rough(away) + 1e-10 * np.eye(400)) @ rng.normal(size=400)
    from_crown = xy @ [np.cos(towards_rad), np.sin(towards_rad)]
    noise = np.full(400, SIGMA_M)
    z = xy @ slopes - fall * np.abs(from_crown) + uneven + rng.normal(0.0, SIGMA_M, 400)
    return Cells(xy, z, noise**2, noise, left, np.zeros(400, dtype=np.int64), apart(400), by_camera(400))


@pytest.mark.parametrize("radius_m", [12.0, 25.0, 1e4])
@pytest.mark.parametrize("towards_deg", [0.0, 30.0, -50.0])
def test_a_crown_that_the_way_crosses_is_told_from_the_plane(towards_deg: float, radius_m: float) -> None:
    # Around a roundabout's island, or in a turn, the way crosses the crowns of others' roads.
    slopes = np.array([0.01, -0.02])
    seen = crossed(np.random.default_rng(0), slopes, 0.02, float(np.radians(towards_deg)), radius_m)
    value, covariance, _ = Surface(seen, 0.0, LEVEL, 0.0).plane()
    off = value[1:] - slopes
    assert off @ np.linalg.solve(covariance[1:, 1:], off) < 3.0**2
    assert np.degrees(np.abs(off)).max() < 0.4


def test_the_doubt_is_that_of_the_error_where_ways_cross_crowns() -> None:
    rng = np.random.default_rng(1)
    squares = []
    for _ in range(60):
        slopes, fall = rng.normal(0.0, 0.015, 2), rng.uniform(0.0, 0.025)
        seen = crossed(rng, slopes, fall, rng.uniform(-np.pi, np.pi), np.exp(rng.uniform(np.log(10.0), np.log(100.0))))
        value, covariance, _ = Surface(seen, 0.0, LEVEL, 0.0).plane()
        off = value[1:] - slopes
        squares.append(off @ np.linalg.solve(covariance[1:, 1:], off))
    assert 0.2 < np.mean(squares) < 2.0
    assert np.mean(np.array(squares) > 3.0**2) < 0.05


def test_what_all_points_share_is_in_the_doubt() -> None:
    seen = road(np.random.default_rng(0), (-LANE_M, LANE_M), np.zeros(2), 0.0, 0.0)
    alone, together = (Surface(seen, share, LEVEL, 0.0).plane()[1][0, 0] for share in (0.0, 1.0))
    assert together - alone == pytest.approx(SIGMA_M**2, rel=0.1)


def test_the_doubt_is_that_of_the_error_where_a_matcher_errs_alike_within_its_windows() -> None:
    # Far away several cells of the ground plan are in one window of a camera that hangs 5 m high.
    rng = np.random.default_rng(2)
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(12.0, 36.0, 0.5), np.arange(-4.0, 4.0, 0.5)))
    sight = np.column_stack([np.arctan2(y, x), -np.arctan2(5.0, x)]) / 0.02
    alike = np.maximum(0.0, 1.0 - np.abs(sight[:, None] - sight)).prod(axis=2)
    noise = 0.05 * (x / 25.0) ** 2
    away = np.hypot(x[:, None] - x, y[:, None] - y)
    both = noise[:, None] * noise * alike + rough(away)
    root = np.linalg.cholesky(both + 1e-8 * np.eye(len(x)))
    squares = []
    for _ in range(60):
        seen = Cells(
            np.column_stack([x, y]),
            root @ rng.normal(size=len(x)),
            noise**2,
            noise,
            y,
            np.zeros(len(x), dtype=np.int64),
            sight,
            by_camera(len(x)),
        )
        value, covariance, _ = Surface(seen, 0.0, LEVEL, 0.0).plane()
        squares.append(value[1:] @ np.linalg.solve(covariance[1:, 1:], value[1:]))
    assert 0.2 < np.mean(squares) < 2.0
    assert np.mean(np.array(squares) > 3.0**2) < 0.05


def test_a_surface_is_known_where_it_was_seen_and_less_beyond() -> None:
    seen = road(np.random.default_rng(0), (-2.0, 2.0), np.zeros(2), 0.0, 0.0)
    beside = np.array([0.0, 2.0, 4.0, 8.0])
    height, variance = Surface(seen, 0.0, LEVEL, 0.0).heights(cells(beside, np.zeros(4), np.zeros(4)))
    assert (np.diff(variance) > 0.0).all()
    assert (np.abs(height) < 3.0 * np.sqrt(variance + UNEVEN_M**2)).all()


def test_the_doubt_is_that_of_the_error_where_each_laser_of_a_scanner_errs_in_its_own_way() -> None:
    # Eight rings of a scanner 12 m high cross a strip 6 m wide: the offset of one ring could pass for a crown.
    rng = np.random.default_rng(3)
    height_m, sigma_m, share = 12.0, 0.2, 0.25
    spots = np.stack(np.meshgrid(np.arange(19.0, 25.0, 0.5), np.arange(-10.0, 10.0, 0.5)), axis=-1).reshape(-1, 2)
    n, elevation_deg = len(spots), -np.degrees(np.arctan2(height_m, np.linalg.norm(spots, axis=1)))
    laser = np.round(elevation_deg / 0.8).astype(np.int64)
    away = np.linalg.norm(spots[:, None] - spots, axis=2)
    root = np.linalg.cholesky(rough(away) + 1e-10 * np.eye(n))
    squares = []
    for _ in range(60):
        z = root @ rng.normal(size=n) + 0.1 * sigma_m * rng.normal(size=n)
        z += share * sigma_m * rng.normal(size=laser.max() - laser.min() + 1)[laser - laser.min()]
        seen = Cells(
            spots,
            z,
            np.full(n, (0.1 * sigma_m) ** 2),
            np.full(n, sigma_m),
            22.0 - spots[:, 0],
            np.zeros(n, dtype=np.int64),
            apart(n),
            0.8 * laser / np.degrees(LASER_RAD),
        )
        value, covariance, _ = Surface(seen, share, LEVEL, 0.0).plane()
        squares.append(value[1:] @ np.linalg.solve(covariance[1:, 1:], value[1:]))
    assert 0.1 < np.mean(squares) < 2.0
    assert np.mean(np.array(squares) > 3.0**2) < 0.05


@pytest.mark.slow
def test_a_low_kerb_that_was_not_noticed_does_not_tilt_the_road() -> None:
    rng = np.random.default_rng(4)
    squares, off_deg = [], []
    for _ in range(60):
        kerb_m, rises = rng.uniform(1.0, 4.0), rng.uniform(0.01, 0.03)
        along, left = rng.uniform(-8.0, 8.0, 200), rng.uniform(-2.5, 7.0, 200)
        beyond = np.maximum(left - kerb_m, 0.0)
        z = (beyond > 0.0) * 0.06 + rises * beyond + rng.normal(0.0, 0.02, 200)
        value, covariance, _ = Surface(cells(left, along, z, 0.02), 0.0, LEVEL, 0.0, edges=True).plane()
        squares.append(value[1:] @ np.linalg.solve(covariance[1:, 1:], value[1:]))
        off_deg.append(np.degrees(np.linalg.norm(value[1:])))
    # The mean of 60 chi-squares of two degrees of freedom: 2.0 +- 0.26.
    assert np.mean(squares) < 2.8
    assert np.median(off_deg) < 0.3


@pytest.mark.slow
def test_a_verge_that_is_flush_with_the_road_does_not_tilt_it() -> None:
    rng = np.random.default_rng(5)
    squares, off_deg = [], []
    for _ in range(60):
        edge_m, falls, wide_m = rng.uniform(1.0, 4.0), rng.uniform(0.03, 0.12), rng.uniform(1.5, 2.5)
        along, left = rng.uniform(-8.0, 8.0, 300), rng.uniform(-4.0, 7.0, 300)
        z = -falls * np.clip(left - edge_m, 0.0, wide_m) + rng.normal(0.0, 0.02, 300)
        value, covariance, _ = Surface(cells(left, along, z, 0.02), 0.0, LEVEL, 0.0, edges=True).plane()
        squares.append(value[1:] @ np.linalg.solve(covariance[1:, 1:], value[1:]))
        off_deg.append(np.degrees(np.linalg.norm(value[1:])))
    assert np.mean(squares) < 2.8
    assert np.median(off_deg) < 0.3


@pytest.mark.slow
def test_kerbs_along_both_sides_of_a_bend_that_noise_hides_do_not_tilt_the_road() -> None:
    # 30 m away a camera with 0.2 m between its lenses knows the heights of single cells to a kerb's height.
    rng = np.random.default_rng(7)
    squares = []
    for _ in range(60):
        left, at_rad, radius_m = rng.uniform(-9.0, 9.0, 400), rng.uniform(-0.6, 0.6, 400), 15.0
        right_m, left_m = rng.uniform(2.0, 3.5), rng.uniform(3.5, 7.0)
        outside = (left > left_m) | (left < -right_m)
        z = outside * rng.uniform(0.08, 0.14) + rng.normal(0.0, 0.08, 400)
        bent = Cells(
            (radius_m - left)[:, None] * np.column_stack([np.sin(at_rad), -np.cos(at_rad)]),
            z,
            np.full(400, 0.08**2),
            np.full(400, 0.2),
            left,
            np.zeros(400, dtype=np.int64),
            apart(400),
            by_camera(400),
        )
        value, covariance, _ = Surface(bent, 0.0, LEVEL, 0.0, edges=True).plane()
        squares.append(value[1:] @ np.linalg.solve(covariance[1:, 1:], value[1:]))
    assert np.mean(squares) < 2.8


@pytest.mark.slow
def test_a_verge_behind_one_side_of_a_crown_does_not_tilt_the_road() -> None:
    rng = np.random.default_rng(8)
    squares, off_deg = [], []
    for _ in range(60):
        fall, crown_m, edge_m = rng.uniform(0.0, 0.025), rng.uniform(-1.0, 1.0), rng.uniform(3.5, 5.0)
        along, left = rng.uniform(-12.0, 12.0, 400), rng.uniform(-5.0, 7.0, 400)
        z = -fall * np.abs(np.minimum(left, edge_m) - crown_m) + rng.normal(0.0, 0.02, 400)
        z -= rng.uniform(0.06, 0.12) * np.clip(left - edge_m, 0.0, 2.0)
        value, covariance, _ = Surface(cells(left, along, z, 0.02), 0.0, LEVEL, 0.0, edges=True).plane()
        squares.append(value[1:] @ np.linalg.solve(covariance[1:, 1:], value[1:]))
        off_deg.append(np.degrees(np.linalg.norm(value[1:])))
    assert np.mean(squares) < 2.8
    assert np.median(off_deg) < 0.3


def test_what_is_behind_an_edge_is_told_from_the_road() -> None:
    rng = np.random.default_rng(9)
    along, left = rng.uniform(-12.0, 12.0, 600), rng.uniform(-5.0, 7.0, 600)
    z = -0.1 * np.clip(left - 4.0, 0.0, 2.0) + rng.normal(0.0, 0.01, 600)
    behind = Surface(cells(left, along, z), 0.0, LEVEL, 0.0, edges=True).behind
    assert behind[left > 4.5].min() > 0.9
    assert behind[left < 3.5].max() < 0.1
    assert (Surface(cells(left, along, z), 0.0, LEVEL, 0.0).behind == 0.0).all()


def grid(along_m: tuple[float, float], left_m: tuple[float, float]) -> FloatArray:
    return np.stack(np.meshgrid(np.arange(*along_m, 0.5), np.arange(*left_m, 0.5)), axis=-1).reshape(-1, 2)


def exactly_seen(xy: FloatArray, z: FloatArray) -> tuple[Surface, FloatArray]:
    """Return the surface, and the plane that fits the heights best, least squares."""
    surface = Surface(cells(xy[:, 1], xy[:, 0], z, 0.002), 0.0, LEVEL, 0.0)
    return surface, np.linalg.lstsq(np.column_stack([np.ones(len(xy)), xy - surface.middle]), z, rcond=None)[0]


def test_the_plane_of_a_bent_road_is_the_one_that_fits_best_what_is_seen_of_it() -> None:
    """That is a corner, in whose middle the road has another slope."""
    xy = grid((-20.0, 20.0), (-6.0, 6.0))
    xy = xy[xy[:, 1] < -6.0 + 0.3 * (xy[:, 0] + 20.0)]
    surface, best = exactly_seen(xy, 0.0004 * xy[:, 0] ** 2 / 2.0)
    value, covariance, _ = surface.plane()
    assert value[0] == pytest.approx(best[0], abs=5e-4)
    assert value[1] == pytest.approx(best[1], abs=1e-4)
    assert np.sqrt(covariance[0, 0]) < 1e-3


def test_waves_that_are_seen_tilt_the_plane_that_fits_best() -> None:
    xy = grid((-20.0, 20.0), (-6.0, 6.0))
    surface, best = exactly_seen(xy, 0.01 * np.sin(2.0 * np.pi * xy[:, 0] / 60.0))
    assert surface.plane()[0][1] == pytest.approx(best[1], abs=2e-5)


def test_it_is_in_doubt_whether_another_road_goes_on_beyond_its_crown() -> None:
    """The way crosses the crown, which is seen well, so that the fall from it is known."""
    doubts = []
    for short_m in (9.0, 4.0):
        xy = grid((-short_m, 10.0), (-3.0, 3.0))
        surface, _ = exactly_seen(xy, -0.02 * np.abs(xy[:, 0]))
        doubts.append(np.sqrt(surface.plane()[2][1, 1]))
    assert doubts[1] > 0.02 * 0.2
    assert doubts[1] > 2.0 * doubts[0]


def test_a_long_road_takes_little_memory() -> None:
    """Of each cell, the heights behind a thousand edges are needed only as their means over patches."""
    along_m, left_m = (each.ravel() for each in np.meshgrid(np.arange(0.0, 200.0, 0.5), np.arange(-10.0, 10.0, 0.5)))
    long = cells(left_m, along_m, np.random.default_rng(0).normal(0.0, SIGMA_M, len(left_m)))
    tracemalloc.start()
    surface = Surface(long, 0.25, LEVEL, 0.0, edges=True)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2.5e8
    assert surface.behind.shape == (len(long),)
    assert surface.behind.max() < 0.5
