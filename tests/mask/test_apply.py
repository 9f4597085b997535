"""Which points a mask keeps: the vehicle's, and never a part of it where the mask is wrong."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.frames import BoolArray
from laci_stereo.mask.apply import Chosen, Moving, choose, windows
from laci_stereo.mask.detect import Vehicle

FOCAL_PX, MIDDLE_PX = 1000.0, 200
HALF_WINDOW = 5

Patch = tuple[int, int, int, int, float]
"""First column and row, those after the last, and the distance in metres."""

CAR: Patch = (100, 100, 220, 160, 20.0)
BEHIND: Patch = (100, 60, 220, 100, 30.0)
WALKER: Patch = (240, 90, 255, 150, 19.0)
OTHER_CAR: Patch = (300, 90, 380, 130, 30.0)


def moving(*patches: Patch, standing: bool = True, height_m: float = 1.0, noise_m: float = 0.05) -> Moving:
    """Points in every pixel of some patches that face the camera."""
    parts = []
    for x0, y0, x1, y1, distance in patches:
        v, u = (axis.ravel() for axis in np.mgrid[y0:y1, x0:x1])
        parts.append((u, v, np.full(len(u), distance)))
    u, v, depth = (np.concatenate(part) for part in zip(*parts, strict=True))
    rays = np.column_stack([(u - MIDDLE_PX) / FOCAL_PX, (v - MIDDLE_PX) / FOCAL_PX, np.ones(len(u))])
    noise = np.full(len(u), noise_m)
    cloud = PointCloud(7, rays * depth[:, None], noise, 0.1 * noise, np.zeros(len(u), dtype=bool))
    return Moving(cloud, u, v, np.full(len(u), 10.0 if standing else 0.0), np.full(len(u), height_m), ())


def box(patch: Patch, dx: int = 0, dy: int = 0) -> Vehicle:
    x0, y0, x1, y1 = patch[:4]
    return Vehicle(np.array([x0 + dx, y0 + dy, x1 + dx, y1 + dy], dtype=float), 0.9, 2)


def as_mask(vehicle: Vehicle) -> Vehicle:
    """The same with all of the box as its mask, in a crop that is larger by 30 pixels."""
    x0, y0, x1, y1 = vehicle.box.astype(int)
    mask = np.zeros((y1 - y0 + 60, x1 - x0 + 60), dtype=bool)
    mask[30:-30, 30:-30] = True
    return replace(vehicle, mask=mask, corner=(int(x0) - 30, int(y0) - 30))


def within(frame: Moving, patch: Patch) -> BoolArray:
    x0, y0, x1, y1 = patch[:4]
    across = (frame.u >= x0) & (frame.u < x1)
    inside: BoolArray = across & (frame.v >= y0) & (frame.v < y1)
    return inside


def chosen(frame: Moving, vehicles: Sequence[Vehicle]) -> Chosen:
    return choose(frame, vehicles, HALF_WINDOW)


def test_the_vehicle_stays_and_what_is_beside_it_goes() -> None:
    frame = moving(CAR, WALKER, OTHER_CAR)
    found = chosen(frame, [box(CAR)])
    np.testing.assert_array_equal(found.keep, within(frame, CAR))
    assert found.used == (True,)
    assert found.grown == 0


def test_what_stands_behind_within_the_box_goes() -> None:
    frame = moving(CAR, BEHIND)
    larger = replace(box(CAR), box=np.array([90.0, 50.0, 230.0, 170.0]))
    np.testing.assert_array_equal(chosen(frame, [larger]).keep, within(frame, CAR))


def receding(length_m: float) -> list[Patch]:
    """Beside the car's end, a side that is all but seen along: 20 thin columns, each further away than the last."""
    return [(219 + k, 100, 220 + k, 110, CAR[4] + k / 20 * length_m) for k in range(1, 21)]


def test_a_side_that_recedes_stays() -> None:
    frame = moving(CAR, *receding(8.0))
    larger = replace(box(CAR), box=np.array([90.0, 50.0, 250.0, 170.0]))
    assert chosen(frame, [larger]).keep.all()


def test_what_bleeds_to_what_stands_behind_goes_with_it() -> None:
    behind = (240, 60, 300, 110, 30.0)
    frame = moving(CAR, *receding(9.8), behind)
    larger = replace(box(CAR), box=np.array([90.0, 50.0, 310.0, 170.0]))
    found = chosen(frame, [larger]).keep
    assert found[within(frame, CAR)].all()
    assert not found[within(frame, behind)].any()
    assert found[within(frame, (220, 100, 240, 110, 0.0))].mean() < 0.2


def test_every_vehicle_keeps_its_own_layer() -> None:
    frame = moving(CAR, OTHER_CAR, WALKER)
    found = chosen(frame, [box(CAR), box(OTHER_CAR)])
    np.testing.assert_array_equal(found.keep, within(frame, CAR) | within(frame, OTHER_CAR))


def test_of_a_mask_all_stays_to_its_edge() -> None:
    frame = moving(CAR, WALKER)
    found = chosen(frame, [as_mask(box(CAR))])
    np.testing.assert_array_equal(found.keep, within(frame, CAR))
    assert found.grown == 0


@pytest.mark.parametrize("shift", [(20, 0), (-20, 0), (0, 20), (0, -20), (14, 14), (50, 0)])
@pytest.mark.parametrize("form", ["box", "mask"])
def test_a_mask_that_is_beside_the_vehicle_cuts_nothing_off(shift: tuple[int, int], form: str) -> None:
    frame = moving(CAR, OTHER_CAR)
    wrong = box(CAR, *shift)
    found = chosen(frame, [wrong if form == "box" else as_mask(wrong)])
    np.testing.assert_array_equal(found.keep, within(frame, CAR))
    assert found.grown == 1


@pytest.mark.parametrize("shift", [(20, 0), (-20, 0), (0, 20), (0, -20), (14, 14), (50, 0)])
def test_nor_what_noise_hides_in_the_road_below_it(shift: tuple[int, int]) -> None:
    frame = moving(CAR, OTHER_CAR)
    by_noise = (frame.v >= 130) & (np.random.default_rng(0).random(len(frame.v)) < 0.5)
    low = replace(frame, above=np.where(by_noise, 1.0, frame.above))
    kept = chosen(low, [box(CAR, *shift)]).keep
    assert kept[by_noise & within(frame, CAR)].all()
    assert not kept[~within(frame, CAR)].any()


def test_a_false_box_on_a_part_of_the_vehicle_cuts_nothing_off() -> None:
    frame = moving(CAR)
    part = Vehicle(np.array([150.0, 110.0, 180.0, 150.0]), 0.9, 2)
    assert chosen(frame, [part]).keep.all()


def test_a_walker_who_touches_the_vehicle_in_the_image_is_no_part_of_it() -> None:
    """Noise of 0.5 m explains 1.4 m between any two points, but not between neighbours, which have most of it alike."""
    beside = (220, 100, 235, 160, CAR[4] - 1.4)
    frame = moving(CAR, beside, noise_m=0.5)
    found = chosen(frame, [box(CAR)])
    assert found.grown == 0
    assert not found.keep[within(frame, (226, 100, 235, 160, 0.0))].any()
    assert found.keep[within(frame, CAR)].all()


@pytest.mark.parametrize(("height_m", "grown"), [(0.4, 0), (0.6, 1)])
def test_ground_that_rises_beside_the_vehicle_is_no_part_of_it(height_m: float, grown: int) -> None:
    verge = (220, 130, 250, 160, CAR[4])
    frame = moving(CAR, verge)
    risen = replace(frame, height_m=np.where(within(frame, verge), height_m, frame.height_m))
    assert chosen(risen, [box(CAR)]).grown == grown


def test_vehicles_whose_boxes_meet_are_not_taken_for_wrong_masks() -> None:
    left, right = (100, 100, 160, 160, 20.0), (160, 100, 220, 160, 20.0)
    found = chosen(moving(left, right), [box(left), box(right)])
    assert found.keep.all()
    assert found.grown == 0


def test_a_box_in_which_nothing_moves_is_not_used() -> None:
    frame = moving(CAR)
    assert chosen(frame, [box(OTHER_CAR)]).used == (False,)
    assert not chosen(frame, []).keep.any()


def test_road_in_a_box_is_no_vehicle() -> None:
    assert chosen(moving(CAR, standing=False), [box(CAR)]).used == (False,)


SIDES = st.integers(1, 400)


@given(x=st.integers(0, 639), y=st.integers(0, 479), width=SIDES, height=SIDES, least=st.integers(1, 300))
def test_a_window_holds_what_moves_with_half_of_it_around(x: int, y: int, width: int, height: int, least: int) -> None:
    rectangle = (x, y, min(x + width, 640), min(y + height, 480))
    [(x0, y0, x1, y1)] = windows([rectangle], (640, 480), least)
    assert 0 <= x0 <= rectangle[0] < rectangle[2] <= x1 <= 640
    assert 0 <= y0 <= rectangle[1] < rectangle[3] <= y1 <= 480
    side = rectangle[2] - rectangle[0]
    assert x0 == 0 or rectangle[0] - x0 >= side // 2
    assert x0 == 0 or x1 == 640 or x1 - x0 >= least
