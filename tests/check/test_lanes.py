"""Right calibrations pass, wrong ones fail by what they are off, and where there is nothing to see nothing is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.check.describe import check_document, check_line, describe_check
from laci_stereo.check.lanes import check_lanes
from laci_stereo.check.placed import Placed
from laci_stereo.check.profiles import OFFSETS_M, STEP_M
from laci_stereo.check.sections import Sections
from laci_stereo.check.traces import Traces
from laci_stereo.core.frames import planar, rigid, rotate_xy
from tests.check.support import (
    BARREL,
    CENTRE,
    CLAIMED,
    CROSSING,
    LENS,
    Painted,
    line,
    looking_north,
    moved_by,
    shift,
    turn_about,
)

PAINTED = {"ideal": Painted(lens=LENS), "barrel": Painted(lens=BARREL)}


def crossing(lens_name: str = "ideal") -> Painted:
    return PAINTED[lens_name]


@pytest.mark.parametrize("lens_name", ["ideal", pytest.param("barrel", marks=pytest.mark.slow)])
def test_truth_passes_and_is_measured_as_such(lens_name: str) -> None:
    check = crossing(lens_name).check()
    assert check.judgement.outcome == "pass", check.judgement
    assert check.lines_found == len(check.lines) == len(CROSSING)
    assert check.residual_m < 0.02
    assert check.residual_px < 0.5
    assert np.linalg.norm(check.error.value[:2]) < 0.01
    assert abs(np.degrees(check.error.value[2])) < 0.03


@pytest.mark.parametrize(
    ("lens_name", "eighth"),
    [
        *(("ideal", eighth) for eighth in range(8)),
        *(pytest.param("barrel", eighth, marks=[] if eighth % 4 == 1 else pytest.mark.slow) for eighth in range(8)),
    ],
)
def test_shift_of_30_cm_fails_and_is_measured(lens_name: str, eighth: int) -> None:
    east, north = 0.3 * np.cos(eighth * np.pi / 4), 0.3 * np.sin(eighth * np.pi / 4)
    check = crossing(lens_name).check(shift(east, north))
    assert check.judgement.outcome == "fail", check.judgement
    assert check.error.value[:2] == pytest.approx([east, north], abs=0.02)
    assert abs(np.degrees(check.error.value[2])) < 0.05


@pytest.mark.parametrize("degrees", [-0.5, 0.5])
@pytest.mark.parametrize("about", [(0.0, 0.0), (0.0, 25.0)])
def test_turn_of_half_a_degree_fails_and_is_measured(degrees: float, about: tuple[float, float]) -> None:
    T_error = turn_about(np.array(about), degrees)
    check = crossing().check(T_error)
    assert check.judgement.outcome == "fail", check.judgement
    assert np.degrees(check.error.value[2]) == pytest.approx(degrees, abs=0.05)
    assert check.error.value[:2] == pytest.approx(moved_by(T_error, check.error.centre), abs=0.03)


def test_wide_claim_excuses_no_such_shift() -> None:
    unsure = CLAIMED * 100.0
    assert crossing().check(shift(0.0, 0.0), covariance=unsure).judgement.outcome == "pass"
    assert crossing().check(shift(0.33, 0.0), covariance=unsure).judgement.outcome == "fail"


@pytest.mark.slow
def test_turned_world_gives_the_turned_answer() -> None:
    yaw, error = 1.1, shift(0.2, -0.1)
    turned_lines = tuple(replace(each, xy=rotate_xy(yaw, each.xy)) for each in CROSSING)
    T = planar(yaw, np.zeros(2))
    turned = Painted(lines=turned_lines, T_world_camera=T @ looking_north())
    plain, other = crossing().check(error), turned.check(T @ error @ np.linalg.inv(T))
    assert other.error.value[:2] == pytest.approx(rotate_xy(yaw, plain.error.value[:2]), abs=0.01)
    assert other.error.value[2] == pytest.approx(plain.error.value[2], abs=3e-4)
    assert other.judgement.outcome == plain.judgement.outcome


def test_road_without_paint_tells_nothing() -> None:
    bare = Painted(beside_m=())
    for error in (shift(0.0, 0.0), shift(0.3, 0.3)):
        assert bare.check(error).judgement.outcome == "cannot tell"


def test_map_of_another_place_tells_nothing() -> None:
    elsewhere = [replace(each, xy=each.xy + np.array([500.0, 0.0])) for each in CROSSING]
    check = crossing().check(lines=elsewhere)
    assert check.judgement.outcome == "cannot tell"
    assert not check.lines


def test_map_of_another_road_tells_nothing() -> None:
    other = [line((x, 6.0), (x + 3.0, 30.0)) for x in (-9.0, -5.5, 1.2, 5.1)]
    assert crossing().check(lines=other).judgement.outcome == "cannot tell"


def test_too_few_lines_that_are_off_may_be_the_calibrations_fault() -> None:
    """Three quarters of a map of another place, and two lines that are 40 cm off."""
    elsewhere = [line((x, 6.0), (x + 3.0, 30.0)) for x in (-9.0, -5.5, 1.2, 5.1, 8.0, 10.0)]
    right, wrong = (
        crossing().check(error, lines=[*CROSSING[:2], *elsewhere]) for error in (np.eye(4), shift(0.4, 0.4))
    )
    assert {right.judgement.outcome, wrong.judgement.outcome} == {"cannot tell"}
    assert all("the calibration wrong" in check.judgement.reasons[0] for check in (right, wrong))
    assert len(right.judgement.reasons) == 1
    assert "the lines are" in wrong.judgement.reasons[1]
    assert "chi-square" in wrong.judgement.reasons[1]


def test_border_without_a_step_is_counted_in_no_total() -> None:
    border = line((-14.0, 20.5), (14.0, 20.5), kind="road_border", name="border")
    check = crossing().check(lines=[*CROSSING, border], kinds=("line_thin", "stop_line", "road_border"))
    assert "border" in {each.id for each in check.lines}
    assert check_document(check, 0.05)["lines_in_view"] == len(CROSSING)
    assert f"{len(CROSSING)} of {len(CROSSING)} lines" in check_line(check)
    assert f"{len(CROSSING)} of {len(CROSSING)} in view" in describe_check(check)


def test_lines_that_run_one_way_leave_the_shift_along_them_open() -> None:
    street = Painted(lines=tuple(line((x, 5.0), (x, 45.0)) for x in (-3.3, 0.0, 3.3)))
    along, across = street.check(shift(0.0, 0.4)), street.check(shift(0.4, 0.0))
    assert along.judgement.outcome == "cannot tell"
    assert "90 deg" in along.judgement.reasons[0]
    assert across.judgement.outcome == "fail"


def test_paint_on_both_sides_is_ambiguous() -> None:
    doubled = Painted(beside_m=(-0.3, 0.3))
    check = doubled.check()
    assert check.judgement.outcome == "cannot tell"
    assert "elsewhere" in check.judgement.reasons[0]


def test_hidden_line_is_not_missed() -> None:
    """A line whose paint is not in the image, but behind a box, is neither sought nor counted."""
    hidden = line((20.0, 40.0), (34.0, 40.0), name="hidden")
    box = np.array([[14.0, 20.0, 12.0, 2.0, 0.0, 5.5]])
    behind = replace(crossing(), boxes=box).check(lines=[*CROSSING, hidden])
    open_ = crossing().check(lines=[*CROSSING, hidden])
    assert "hidden" not in {each.id for each in behind.lines}
    assert len(behind.hidden) >= 5
    assert [each.found for each in open_.lines if each.id == "hidden"] == [False]


def test_lines_with_no_paint_of_their_own_are_no_part_of_it() -> None:
    virtual = [line((x, 6.0), (x, 40.0), kind="virtual") for x in (-1.6, 1.6)]
    assert len(crossing().check(lines=[*CROSSING, *virtual]).lines) == len(CROSSING)


def test_line_that_the_map_has_wrong_is_astray_and_spoils_nothing() -> None:
    wrong = replace(CROSSING[1], xy=CROSSING[1].xy + np.array([0.35, 0.0]), id="wrong")
    check = crossing().check(lines=[CROSSING[0], wrong, *CROSSING[2:]])
    assert {each.id for each in check.lines if each.astray or not each.found} == {"wrong"}
    assert np.linalg.norm(check.error.value[:2]) < 0.03


def test_offset_is_to_the_left_of_the_line() -> None:
    """The calibration puts everything 20 cm too far east, so paint lies right of lines that run north."""
    check = crossing().check(shift(0.2, 0.0))
    northward = [each for each in check.lines if each.id in {str((-3.3, 5.0)), str((3.3, 5.0)), str((0.0, 5.0))}]
    assert len(northward) == 3
    for each in northward:
        assert each.offset_m == pytest.approx(-0.2, abs=0.03)
        assert each.offset_px < -3.0


def test_doubt_about_the_map_widens_the_doubt() -> None:
    exact, rough = (crossing().check(map_sigma_m=sigma).error.covariance for sigma in (0.01, 0.2))
    assert np.all(np.diag(rough) > np.diag(exact))
    assert crossing().check(shift(0.2, 0.0), map_sigma_m=0.5).judgement.outcome == "cannot tell"


def test_a_few_sections_of_a_line_that_is_not_found_tell_nothing() -> None:
    """An edge of grass: where the ground bends or a walker stood, it seems to lie 1 m beside the map's line."""
    paint = [line((-15.0, y), (15.0, y), name=f"{y:.0f}") for y in (-4.0, 0.0, 4.0, 8.0)]
    edge = line((6.0, -25.0), (6.0, -5.0), kind="road_border")

    def see(sections: Sections) -> Traces:
        at = np.where(sections.line == len(paint), 1.0, 0.0)
        sigmas = 10.0 * (np.abs(OFFSETS_M - at[:, None]) < STEP_M / 2)
        sigmas[(sections.line == len(paint)) & (np.round(sections.along_m) % 5 != 0)] = 0.0
        return Traces(sigmas, np.tile(OFFSETS_M, (len(at), 1)), np.full(len(at), 0.02), np.zeros(len(at)))

    placed = Placed(rigid(np.eye(3), np.array([0.0, -10.0, 6.0])), CLAIMED, CENTRE, np.zeros((0, 6)))
    found = check_lanes([*paint, edge], placed, see, kinds=("line_thin", "road_border"))
    assert found.judgement.outcome == "cannot tell"  # the shift along the paint
    assert [each.kind for each in found.lines if not each.found] == ["road_border"]
    assert found.residual_m is not None
    assert found.residual_m < 0.01
