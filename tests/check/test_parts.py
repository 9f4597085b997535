"""What the lane check is made of, each against what is known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from laci_stereo.check.align import align
from laci_stereo.check.fit import Offsets, PlanarError, covariance_of, fit_planar
from laci_stereo.check.placed import Placed
from laci_stereo.check.profiles import OFFSETS_M, STEP_M, Profiles, profiles_in_image
from laci_stereo.check.ridges import find_stripes
from laci_stereo.check.sections import Sections, sections_of
from laci_stereo.check.texture import noise_of
from laci_stereo.check.verdict import Evidence, judge
from laci_stereo.core.frames import FloatArray, rigid, rotate_xy, transform
from laci_stereo.report.camera import Camera
from tests.check.support import CENTRE, CLAIMED, CROSSING, LENS, line, looking_north


def placed(boxes: FloatArray | None = None) -> Placed:
    return Placed(looking_north(), CLAIMED, CENTRE, np.zeros((0, 6)) if boxes is None else boxes)


def ground_seen(T_world_camera: FloatArray, directions: FloatArray) -> FloatArray:
    rays = directions @ T_world_camera[:3, :3].T
    return (T_world_camera[:3, 3] - T_world_camera[2, 3] / rays[:, 2:] * rays)[:, :2]


def test_jacobian_is_how_what_is_seen_moves_on_the_ground() -> None:
    here = placed()
    xy = np.array([[0.0, 10.0], [-8.0, 25.0], [6.0, 40.0]])
    directions = transform(np.linalg.inv(here.T_world_sensor), np.column_stack([xy, np.zeros(3)]))
    assert ground_seen(here.T_world_sensor, directions) == pytest.approx(xy)
    step = 1e-6
    for axis in range(6):
        six = step * np.eye(6)[axis]
        about = rigid(np.eye(3), CENTRE)
        moved = about @ rigid(Rotation.from_rotvec(six[:3]).as_matrix(), six[3:]) @ np.linalg.inv(about)
        change = (ground_seen(moved @ here.T_world_sensor, directions) - xy) / step
        assert here.jacobian(xy)[:, :, axis] == pytest.approx(change, rel=1e-3, abs=1e-3)


def test_hidden_is_what_a_sight_line_through_a_box_ends_at() -> None:
    rng = np.random.default_rng(3)
    boxes = np.array([[2.0, 14.0, 6.0, 2.0, 0.4, 3.0], [-10.0, 25.0, 1.0, 8.0, -1.0, 8.0]])
    xy = rng.uniform([-25.0, 3.0], [25.0, 50.0], (2000, 2))
    share = np.linspace(0.0, 1.0, 4000)
    expected = np.zeros(len(xy), dtype=bool)
    eye = placed().origin
    for number, point in enumerate(xy):
        sight = eye + share[:, None] * (np.append(point, 0.0) - eye)
        for box in boxes:
            own = rotate_xy(-box[4], sight[:, :2] - box[:2])
            expected[number] |= bool(((np.abs(own) < box[2:4] / 2).all(axis=1) & (sight[:, 2] < box[5])).any())
    assert 100 < expected.sum() < 1900
    differing = np.flatnonzero(placed(boxes).hidden(xy) != expected)
    assert len(differing) <= 4  # sight lines that graze an edge between two samples


def test_sections_cover_a_line_and_look_to_its_left() -> None:
    sections = sections_of([line((0.0, 0.0), (10.0, 0.0), (10.0, 6.3))], np.zeros(2))
    assert len(sections) == 16
    assert sections.left[0] == pytest.approx([0.0, 1.0])
    assert sections.left[-1] == pytest.approx([-1.0, 0.0])
    assert np.einsum("ij,ij->i", sections.left, sections.ahead) == pytest.approx(np.zeros(16), abs=1e-12)


def test_long_line_is_cut_where_nobody_can_see_it() -> None:
    assert len(sections_of([line((-5000.0, 3.0), (5000.0, 3.0))], np.zeros(2))) < 200


@pytest.mark.parametrize("width_m", [0.10, 0.15, 0.25, 0.5])
@pytest.mark.parametrize("at_m", [-0.613, 0.0, 0.117])
def test_middle_of_a_stripe_is_found_between_samples(width_m: float, at_m: float) -> None:
    fine = np.arange(-1.6, 1.6, 1e-3)
    bright = 80.0 + 100.0 * (np.abs(fine - at_m) < width_m / 2)
    profile = np.array([bright[np.abs(fine - offset) < 0.02].mean() for offset in OFFSETS_M])
    rows = np.tile(profile, (6, 1)) + np.random.default_rng(0).normal(0.0, 1.0, (6, len(profile)))
    stripes = find_stripes(Profiles(rows, np.full(6, 0.02), True), np.zeros(6, dtype=np.int64))
    best = int(stripes.sigmas[2].argmax())
    assert stripes.evidence[2, best] == 1.0
    assert stripes.left_m[2, best] == pytest.approx(at_m, abs=0.01)


def test_wide_paint_is_looked_for_where_thin_paint_melts_into_the_road() -> None:
    camera, road = Camera(LENS, np.linalg.inv(looking_north())), np.full((600, 800), 90, dtype=np.uint8)
    farthest_m = []
    for kind, width_m in (("line_thin", 0.12), ("line_thick", 0.25), ("stop_line", 0.30)):
        across = sections_of([line((-2.0, y), (2.0, y), kind=kind) for y in np.arange(8.0, 50.0)], np.zeros(2))
        profiles = profiles_in_image(road, camera, across)
        seen = np.isfinite(profiles.values).all(axis=1)
        assert profiles.cell_m[seen].max() == pytest.approx(width_m, rel=0.1)
        farthest_m.append(across.xy[seen, 1].max())
    assert farthest_m == sorted(set(farthest_m))


def test_step_is_no_stripe() -> None:
    rng = np.random.default_rng(1)
    rows = 80.0 + 100.0 * (OFFSETS_M > 0.2) + rng.normal(0.0, 1.0, (8, len(OFFSETS_M)))
    stripes = find_stripes(Profiles(rows, np.full(8, 0.02), True), np.zeros(8, dtype=np.int64))
    assert stripes.evidence.max() < 1.0


def test_what_is_looked_for_is_not_its_own_noise() -> None:
    """Not even where little but it is seen."""
    at, felt = 40, 13
    response = np.random.default_rng(3).normal(size=(6, len(OFFSETS_M)))
    response += 100.0 * np.clip(1.0 - np.abs(np.arange(len(OFFSETS_M)) - at) / felt, 0.0, 1.0)
    response[:, :18] = response[:, 67:] = np.nan
    noise = noise_of(response, np.zeros(6, dtype=np.int64), felt * STEP_M, np.zeros(6))
    assert 0.3 < noise[:, at].min() < noise[:, at].max() < 3.0


def stripes_at(offsets_m: FloatArray) -> FloatArray:
    return 1.0 * (np.abs(OFFSETS_M - offsets_m[:, None]) < 0.05)


@pytest.mark.parametrize(("east", "north", "turn"), [(0.0, 0.0, 0.0), (0.6, -0.4, 0.01), (-0.2, 0.8, -0.015)])
def test_alignment_is_found(east: float, north: float, turn: float) -> None:
    sections = sections_of(CROSSING, np.zeros(2))
    arm = sections.xy - sections.xy.mean(axis=0)
    moved = np.array([east, north]) + turn * np.column_stack([-arm[:, 1], arm[:, 0]])
    wanted = np.einsum("ij,ij->i", moved, sections.left)
    found = align(stripes_at(wanted), np.full(len(sections), 0.06), sections)
    assert found.offsets(sections) == pytest.approx(wanted, abs=0.12)
    assert not found.rivals


def test_alignment_has_a_rival_where_everything_is_there_twice() -> None:
    sections = sections_of(CROSSING, np.zeros(2))
    along = np.einsum("ij,j->i", sections.left, [0.5, 0.5])
    both = np.maximum(stripes_at(along), stripes_at(-along))
    assert align(both, np.full(len(sections), 0.06), sections).rivals[0].share > 0.9


def test_rivals_are_unlike_each_other() -> None:
    sections = sections_of(CROSSING, np.zeros(2))
    shifts = np.array([[0.5, 0.5], [-0.5, -0.5], [0.5, -0.5]])
    everywhere = np.maximum.reduce([stripes_at(sections.left @ shift) for shift in shifts])
    found = align(everywhere, np.full(len(sections), 0.06), sections)
    places = np.array([found.shift, *(rival.shift for rival in found.rivals)])
    assert sorted(np.linalg.norm(shifts[:, None] - places, axis=2).min(axis=1)) == pytest.approx([0.0] * 3, abs=0.12)


def test_planar_error_is_as_uncertain_as_it_says() -> None:
    """Offsets drawn from what is assumed of map, road and calibration give chi-squares of three degrees of freedom."""
    rng = np.random.default_rng(11)
    here, sections = placed(), sections_of(CROSSING, np.zeros(2))
    still = Offsets(sections, np.zeros(len(sections)), np.full(len(sections), 0.03), np.zeros(len(sections)))
    claimed = np.einsum("ij,ijk->ik", sections.left, here.jacobian(sections.xy))
    whole = covariance_of(still, here, 0.05) + claimed @ CLAIMED @ claimed.T
    draws = rng.multivariate_normal(np.zeros(len(sections)), whole, 400)
    found = [fit_planar(Offsets(sections, each, still.cell_m, still.loose_m), here, 0.05).chi_square for each in draws]
    assert np.mean(found) == pytest.approx(3.0, abs=5 * np.sqrt(6.0 / 400))
    assert np.mean(np.array(found) > chi2.isf(0.05, 3)) < 0.10


def test_planar_error_is_recovered() -> None:
    here, sections = placed(), sections_of(CROSSING, np.zeros(2))
    value = np.array([0.2, -0.1, 0.004])
    arm = sections.xy - sections.xy.mean(axis=0)
    moved = value[:2] + value[2] * np.column_stack([-arm[:, 1], arm[:, 0]])
    left_m = np.einsum("ij,ij->i", moved, sections.left)
    error = fit_planar(Offsets(sections, left_m, np.full(len(sections), 0.03), np.zeros(len(sections))), here, 0.05)
    assert error.value == pytest.approx(value, rel=0.02, abs=1e-4)


def test_open_direction_is_as_uncertain_as_the_search_is_wide() -> None:
    parallel = sections_of([line((x, 5.0), (x, 45.0)) for x in (-3.0, 3.0)], np.zeros(2))
    still = Offsets(parallel, np.zeros(len(parallel)), np.full(len(parallel), 0.03), np.zeros(len(parallel)))
    sigma = np.sqrt(np.diag(fit_planar(still, placed(), 0.05).covariance))
    assert sigma[0] < 0.1
    assert sigma[1] == pytest.approx(1.0, rel=0.01)


def test_sections_can_be_chosen() -> None:
    sections = sections_of(CROSSING, np.zeros(2))
    chosen = sections[sections.line == 2]
    assert isinstance(chosen, Sections)
    assert set(chosen.line.tolist()) == {2}


def test_what_is_open_in_one_direction_is_no_shift_that_way() -> None:
    """Far off along the only direction that nothing tells, and a little, but surely, off in the others."""
    covariance = np.diag([0.9, 0.01, 1e-4]) ** 2
    open_ = PlanarError(np.zeros(2), np.array([0.38, 0.04, 5e-4]), covariance, 100.0 * covariance)
    assert judge(Evidence(5, 5, 0.0), open_).outcome == "cannot tell"
    told = PlanarError(np.zeros(2), np.array([0.04, 0.38, 5e-4]), covariance, 100.0 * covariance)
    assert judge(Evidence(5, 5, 0.0), told).outcome == "fail"


@pytest.mark.parametrize(("sigma_rad", "outcome"), [(0.02, "cannot tell"), (1e-4, "fail")])
def test_a_turn_that_nothing_tells_is_no_turn(sigma_rad: float, outcome: str) -> None:
    covariance = np.diag([0.01, 0.01, sigma_rad]) ** 2
    turned = PlanarError(np.zeros(2), np.array([0.04, 0.0, 0.015]), covariance, 1e5 * covariance)
    assert judge(Evidence(5, 5, 0.0), turned).outcome == outcome
