"""A LiDAR's lane check without paint: kerbs are steps in the ground, walls stand upright."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from laci_lidar.check import check_scans, see_scans
from laci_lidar.kerbs import SPARSEST_M, find_kerbs
from laci_lidar.scan import Scan
from laci_lidar.surroundings import Surroundings
from laci_lidar.walls import THICK_M, find_walls
from scipy.spatial.transform import Rotation

from laci_stereo.check.lanes import LaneCheck
from laci_stereo.check.placed import Placed
from laci_stereo.check.sections import sections_of
from laci_stereo.core.frames import FloatArray, rigid, rotation_z, transform
from laci_stereo.io.maps.lane_map import LaneLine, LaneMap
from tests.check.support import CLAIMED, line, moved_by, shift, turn_about
from tests.lidar.scanner import Listed, listed
from tools.scenes.geometry import Body, Material, RayCaster
from tools.scenes.shapes import box
from tools.scenes.world import standing, still

HEIGHT_M, KERB_M, SCANS = 5.0, 0.12, 6
CENTRE = np.array([0.0, 5.0, 0.0])
KERBS = tuple(
    line((30.0 * x, 4.0 * y), (4.0 * x, 4.0 * y), (4.0 * x, 30.0 * y), kind="curbstone", name=f"kerb {x:.0f} {y:.0f}")
    for x in (-1.0, 1.0)
    for y in (-1.0, 1.0)
)
"""Of a crossing; the scanner stands behind the kerbs of one corner."""

WALLS = (
    line((6.0, 12.0), (16.0, 12.0), kind="wall", name="north"),
    line((-7.0, 6.0), (-7.0, 18.0), kind="fence", name="west"),
    line((-16.0, -8.0), (-6.5, -8.0), kind="wall", name="south"),
    line((16.0, -2.0), (16.0, 8.0), kind="wall", name="east"),
    line((-4.0, 20.0), (5.0, 20.0), kind="wall", name="far"),
    line((-18.0, -4.0), (-18.0, 6.0), kind="guard_rail", name="rail"),
)


def T_world_scanner() -> FloatArray:
    return rigid(rotation_z(0.7), np.array([8.0, -7.0, HEIGHT_M]))


def solid(name: str, low: Sequence[float], high: Sequence[float]) -> Body:
    return standing(name, box(low, high, Material.WALL), np.zeros(2), 0.0, 0.0)


def ground(kerb_m: float) -> list[Body]:
    road = solid("road", (-60.0, -60.0, -1.0), (60.0, 60.0, 0.0))
    blocks = [
        solid("block", (min(4 * x, 60 * x), min(4 * y, 60 * y), -0.5), (max(4 * x, 60 * x), max(4 * y, 60 * y), kerb_m))
        for x in (-1, 1)
        for y in (-1, 1)
    ]
    return [road, *blocks] if kerb_m > 0.0 else [road]


def walls(high_m: float) -> list[Body]:
    """Return walls whose faces towards the scanner are the map's lines."""
    return [
        solid("north", (6.0, 12.0, 0.0), (16.0, 12.3, high_m)),
        solid("west", (-7.3, 6.0, 0.0), (-7.0, 18.0, high_m)),
        solid("south", (-16.0, -8.3, 0.0), (-6.5, -8.0, high_m)),
        solid("east", (16.0, -2.0, 0.0), (16.3, 8.0, high_m)),
        solid("far", (-4.0, 20.0, 0.0), (5.0, 20.3, high_m)),
        solid("rail", (-18.3, -4.0, 0.4), (-18.0, 6.0, 0.8)),
    ]


def scanned(*bodies: list[Body]) -> Listed:
    """Cast 64 layers at what is there at one time after another: 2 cm of noise along the beam."""
    down, around = np.radians(np.linspace(3.0, 40.0, 64)), np.radians(np.arange(0.0, 360.0, 0.2))
    down, around = (each.ravel() for each in np.meshgrid(down, around))
    rays = np.column_stack([np.cos(down) * np.cos(around), np.cos(down) * np.sin(around), -np.sin(down)])
    T, rng, scans = T_world_scanner(), np.random.default_rng(4), []
    for there in bodies:
        hits = RayCaster(there).cast(T[:3, 3], rays @ T[:3, :3].T, 0.0)
        met = np.isfinite(hits.distance_m)
        scans.append(Scan(rays[met] * (hits.distance_m + rng.normal(0.0, 0.02, len(rays)))[met, None]))
    return listed(scans)


def check(
    scans: Listed, lines: Sequence[LaneLine], T_error: FloatArray | None = None, boxes: Sequence[Sequence[float]] = ()
) -> LaneCheck:
    T = T_world_scanner() if T_error is None else T_error @ T_world_scanner()
    placed = Placed(T, CLAIMED, CENTRE, np.reshape(boxes, (-1, 6)))
    checked = check_scans(scans, placed, LaneMap(tuple(lines), ()))
    assert checked is not None
    return checked.check


@cache
def crossing(kerb_m: float = KERB_M) -> Listed:
    return scanned(*[ground(kerb_m)] * SCANS)


@cache
def yard(high_m: float = 1.5) -> Listed:
    return scanned(*[ground(0.0) + walls(high_m)] * SCANS)


SEEN = [pytest.param(crossing, KERBS, id="kerbs"), pytest.param(yard, WALLS, id="walls")]


@pytest.mark.parametrize(("scans", "lines"), SEEN)
def test_truth_passes(scans: Callable[[], Listed], lines: Sequence[LaneLine]) -> None:
    found = check(scans(), lines)
    assert found.judgement.outcome == "pass", found.judgement
    assert found.lines_found == len(found.lines)
    assert found.residual_m < SPARSEST_M / np.sqrt(12.0)  # of a section, by the spacing of points
    assert np.linalg.norm(found.error.value[:2]) < 0.02
    assert abs(np.degrees(found.error.value[2])) < 0.05


@pytest.mark.parametrize(("scans", "lines"), SEEN)
@pytest.mark.parametrize("eighth", [0, *(pytest.param(eighth, marks=pytest.mark.slow) for eighth in range(1, 8))])
def test_shift_of_30_cm_fails_and_is_measured(
    scans: Callable[[], Listed], lines: Sequence[LaneLine], eighth: int
) -> None:
    east, north = 0.3 * np.cos(eighth * np.pi / 4), 0.3 * np.sin(eighth * np.pi / 4)
    found = check(scans(), lines, shift(east, north))
    assert found.judgement.outcome == "fail", found.judgement
    assert found.error.value[:2] == pytest.approx([east, north], abs=0.03)


@pytest.mark.parametrize(("scans", "lines"), SEEN)
@pytest.mark.parametrize("degrees", [-0.5, pytest.param(0.5, marks=pytest.mark.slow)])
def test_turn_of_half_a_degree_is_seen(scans: Callable[[], Listed], lines: Sequence[LaneLine], degrees: float) -> None:
    T_error = turn_about(T_world_scanner()[:2, 3], degrees)
    found = check(scans(), lines, T_error)
    assert found.judgement.outcome != "pass", found.judgement
    assert np.degrees(found.error.value[2]) == pytest.approx(degrees, abs=0.1)
    assert found.error.value[:2] == pytest.approx(moved_by(T_error, found.error.centre), abs=0.03)


@pytest.mark.slow
def test_turn_of_half_a_degree_fails_by_kerbs() -> None:
    for degrees in (-0.5, 0.5):
        T_error = turn_about(T_world_scanner()[:2, 3], degrees)
        assert check(crossing(), KERBS, T_error).judgement.outcome == "fail"


@pytest.mark.slow
@pytest.mark.parametrize("kerb_m", [0.04, 0.2])
def test_kerbs_may_be_low_or_high(kerb_m: float) -> None:
    found = check(crossing(kerb_m), KERBS)
    assert found.judgement.outcome == "pass", found.judgement
    assert check(crossing(kerb_m), KERBS, shift(0.3, 0.0)).judgement.outcome == "fail"


@pytest.mark.parametrize(("scans", "lines"), [(yard, KERBS), (crossing, WALLS)])
@pytest.mark.parametrize("T_error", [np.eye(4), pytest.param(shift(0.3, 0.2), marks=pytest.mark.slow)])
def test_what_is_not_there_is_not_found(
    scans: Callable[[], Listed], lines: Sequence[LaneLine], T_error: FloatArray
) -> None:
    """A map with kerbs where only walls are, and one with walls where only kerbs are."""
    found = check(scans(), lines, T_error)
    assert found.judgement.outcome == "cannot tell"
    assert len(found.lines) >= 3
    assert found.lines_found == 0


@pytest.mark.slow
def test_border_that_is_no_step_tells_nothing() -> None:
    """Unlike a curbstone: a map's border of a road may be grass."""
    grass = [line((x, -30.0), (x, 30.0), kind="road_border") for x in (-3.0, -2.0, -1.0, 1.0, 2.0, 3.0)]
    assert check(crossing(), [*KERBS, *grass]).judgement.outcome == "pass"
    stones = [line((x, -30.0), (x, 30.0), kind="curbstone") for x in (-3.0, -2.0, -1.0, 1.0, 2.0, 3.0)]
    assert check(crossing(), [*KERBS, *stones]).judgement.outcome == "cannot tell"


def test_kerb_that_faces_away_is_found_before_its_shadow() -> None:
    """Behind the corner where the scanner stands no point is on the face, and none on the road for 0.3 m."""
    placed = Placed(T_world_scanner(), CLAIMED, CENTRE, np.zeros((0, 6)))
    near = [line((4.0, -30.0), (4.0, -12.0), kind="curbstone"), line((12.0, -4.0), (30.0, -4.0), kind="curbstone")]
    see = see_scans(crossing(0.2), placed, near)
    sections = sections_of(near, placed.origin[:2], see.kinds)
    traces = see(sections)
    sure = traces.evidence.max(axis=1) >= 1.0
    assert sure.sum() > 10
    best = traces.sigmas.argmax(axis=1)
    left_m = traces.left_m[np.arange(len(best)), best][sure]
    assert abs(np.median(left_m)) < 0.03
    assert np.quantile(np.abs(left_m), 0.9) < 0.08


def test_vehicle_that_passes_is_no_wall() -> None:
    still_there = ground(0.0) + walls(1.5)
    with_lorry = [*still_there, solid("lorry", (-8.0, -1.5, 0.2), (2.0, 1.0, 2.4))]
    side = line((-8.0, -1.5), (2.0, -1.5), kind="wall", name="side")
    found = check(scanned(*[still_there] * (SCANS - 1), with_lorry), [*WALLS, side])
    assert [each.id for each in found.lines if not each.found] == ["side"]
    parked = check(scanned(*[with_lorry] * SCANS), [*WALLS, side])
    assert [each.found for each in parked.lines if each.id == "side"] == [True]


def test_wall_is_seen_above_ground_that_rises() -> None:
    """Rings of points on sloping land beside it are no wall."""
    tilted = rigid(Rotation.from_euler("x", 3.0, degrees=True).as_matrix(), np.array([0.0, 0.0, 0.3]))
    land = Body("land", box((-60.0, -60.0, -0.5), (60.0, 60.0, 0.0), Material.GRASS), still(tilted), static=True)
    assert check(scanned(*[[land]] * SCANS), WALLS).lines_found == 0
    assert check(scanned(*[[land, *walls(3.0)]] * SCANS), WALLS).lines_found == len(WALLS)


@pytest.mark.slow
def test_heights_do_not_depend_on_where_the_world_begins() -> None:
    """Turned with its map, the world gives the turned answer."""
    T = turn_about(np.array([3.0, -2.0]), 50.0)
    turned = [
        line(*map(tuple, transform(T, np.column_stack([each.xy, np.zeros(3)]))[:, :2].tolist()), kind=each.kind)
        for each in KERBS
    ]
    plain, other = check(crossing(), KERBS, shift(0.2, -0.1)), check(crossing(), turned, T @ shift(0.2, -0.1))
    expected = T[:2, :2] @ plain.error.value[:2]
    assert other.error.value[:2] == pytest.approx(expected, abs=0.02)
    assert other.judgement.outcome == plain.judgement.outcome


def test_walls_that_are_background_are_seen() -> None:
    """As in every result: what stands is a box of the background, which does not hide itself."""
    boxes = [(11.0, 12.0, 11.0, 0.6, 0.0, 1.5), (-7.0, 12.0, 0.6, 13.0, 0.0, 1.5), (16.0, 3.0, 0.6, 11.0, 0.0, 1.5)]
    plain, boxed = (check(yard(), WALLS, boxes=each) for each in ((), boxes))
    assert [(each.id, each.found_m) for each in boxed.lines] == [(each.id, each.found_m) for each in plain.lines]


ONE_LINE = sections_of([line((0.0, -8.0), (0.0, 8.0), kind="wall")], np.zeros(2), ("wall",))


def strewn(low: Sequence[float], high: Sequence[float], noise_m: float) -> Surroundings:
    """Return points all over a box, off by noise in height, of three scans."""
    rng = np.random.default_rng(6)
    points = rng.uniform(low, high, (40_000, 3)) + noise_m * rng.normal(size=(40_000, 3)) * [0.0, 0.0, 1.0]
    return Surroundings(points, np.full(len(points), np.nan), np.arange(len(points)) % 3)


@pytest.mark.parametrize(("noise_m", "in_view"), [(0.002, True), (0.2, False)])
def test_ground_on_which_a_kerb_would_be_missed_is_out_of_view(noise_m: float, in_view: bool) -> None:
    placed = Placed(T_world_scanner(), CLAIMED, CENTRE, np.zeros((0, 6)))
    traces = find_kerbs(strewn((-2.0, -9.0, 0.0), (2.0, 9.0, 0.0), noise_m), placed, ONE_LINE)
    assert np.mean(np.isfinite(traces.cell_m)) == pytest.approx(float(in_view), abs=0.1)
    assert np.mean(traces.evidence.max(axis=1) == 1.0) < 0.1


def test_ground_that_slopes_is_no_kerb() -> None:
    placed = Placed(T_world_scanner(), CLAIMED, CENTRE, np.zeros((0, 6)))
    flat = strewn((-2.0, -9.0, 0.0), (2.0, 9.0, 0.0), 0.002)
    slope = np.outer(flat.points[:, 0], [0.0, 0.0, 0.08])
    traces = find_kerbs(replace(flat, points=flat.points + slope), placed, ONE_LINE)
    assert np.isfinite(traces.cell_m).all()
    assert not traces.evidence.any()


@pytest.mark.parametrize(("half_m", "found"), [(0.05, True), (2.0, False)])
def test_leaves_all_around_are_no_wall(half_m: float, found: bool) -> None:
    placed = Placed(T_world_scanner(), CLAIMED, CENTRE, np.zeros((0, 6)))
    traces = find_walls(strewn((-half_m, -9.0, 0.4), (half_m, 9.0, 1.6), 0.0), placed, ONE_LINE)
    assert ((traces.evidence.max(axis=1) == 1.0) == found).all()


@pytest.mark.parametrize(("scans", "lines", "loose_m"), [(crossing, KERBS, 0.0), (yard, WALLS, THICK_M)])
def test_how_thick_walls_are_is_in_the_doubt(
    scans: Callable[[], Listed], lines: Sequence[LaneLine], loose_m: float
) -> None:
    sigmas_m = [each.sigma_m for each in check(scans(), lines).lines]
    assert all(sigma_m is not None and loose_m < sigma_m < loose_m + SPARSEST_M for sigma_m in sigmas_m)
