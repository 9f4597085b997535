"""Crops in a network's input: where they lie, how they come back, and in which numbers they are told."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from laci_stereo.core.frames import Raster
from laci_stereo.mask.contract import Contract, InputSpec, Resize
from laci_stereo.mask.detect import NetworkFinder, cells_of
from laci_stereo.mask.network import MaskOptions, Network
from laci_stereo.mask.picture import Cell, Crop, place, tensor
from tests.mask import graphs

RESIZES: Sequence[Resize] = ("stretch", "letterbox_topleft", "letterbox_center")
SIDES = st.integers(1, 700)


def crop(width: int, height: int, x0: int = 0, y0: int = 0) -> Crop:
    return Crop(0, x0, y0, np.zeros((height, width, 3), dtype=np.uint8))


@given(width=SIDES, height=SIDES, x0=SIDES, y0=SIDES, resize=st.sampled_from(RESIZES))
def test_points_come_back_to_where_they_were(width: int, height: int, x0: int, y0: int, resize: Resize) -> None:
    cell = Cell(320, 64, 320, 256)
    placed = place(crop(width, height, x0, y0), cell, resize)
    inside = np.array([[0.0, 0.0], [width, height], [0.3 * width, 0.8 * height]])
    there = inside * placed.scale + placed.offset
    np.testing.assert_allclose(placed.to_image(there), inside + np.array([x0, y0]), atol=1e-6)
    assert (there >= [cell.x, cell.y]).all()
    assert (there <= [cell.x + cell.width, cell.y + cell.height]).all()
    if resize == "letterbox_topleft":
        np.testing.assert_array_equal(placed.offset, [cell.x, cell.y])


def test_letterboxes_keep_the_shape_and_pad_with_grey() -> None:
    wide = Crop(0, 0, 0, np.full((50, 100, 3), 200, dtype=np.uint8))
    for resize, first in (("letterbox_topleft", 0), ("letterbox_center", 16)):
        spec = InputSpec(resize=resize, pad=7)  # type: ignore[arg-type]
        picture = tensor([place(wide, Cell(0, 0, 64, 64), resize)], (64, 64), spec)[0, 0]  # type: ignore[arg-type]
        np.testing.assert_array_equal(picture[first : first + 32], np.full((32, 64), 200))
        assert (picture == 7).sum() == 32 * 64


def numbers(spec: InputSpec, image: Raster) -> Raster:
    return tensor([place(Crop(0, 0, 0, image), Cell(0, 0, 2, 2), "stretch")], (2, 2), spec)


def test_colours_range_layout_and_type_are_the_contracts() -> None:
    image = np.tile(np.array([10, 20, 30], dtype=np.uint8), (2, 2, 1))  # blue, green, red
    np.testing.assert_array_equal(numbers(InputSpec(color="BGR"), image)[0, :, 0, 0], [10, 20, 30])
    np.testing.assert_array_equal(numbers(InputSpec(color="RGB"), image)[0, :, 0, 0], [30, 20, 10])
    assert numbers(InputSpec(color="GRAY"), image).shape == (1, 1, 2, 2)
    last = numbers(InputSpec(layout="NHWC", dtype="uint8"), image)
    assert last.shape == (1, 2, 2, 3)
    assert last.dtype == np.uint8
    scaled = numbers(InputSpec(scale=0.1, mean=(1.0, 0.0, 0.0), std=(2.0, 1.0, 0.5), dtype="float16"), image)
    assert scaled.dtype == np.float16
    np.testing.assert_allclose(scaled[0, :, 0, 0], [1.0, 2.0, 2.0], rtol=1e-3)


def test_an_input_holds_as_many_crops_as_are_seen_well() -> None:
    def count(size: tuple[int, int], **more: tuple[int, int]) -> int:
        return len(cells_of(size, Contract("yolox_raw", (0,), InputSpec(**more))))  # type: ignore[arg-type]

    assert count((1152, 640)) == 6
    assert count((416, 416)) == 1
    assert count((200, 200)) == 1
    assert count((416, 416), crops=(2, 2)) == 4
    assert len(cells_of((1152, 640), Contract("detr", (0,)))) == 1


@pytest.mark.parametrize("resize", RESIZES)
def test_crops_that_share_an_input_keep_their_own_vehicles(resize: Resize, tmp_path: Path) -> None:
    spec = {"resize": resize, "crops": [2, 2], "pad": 20}
    contract: dict[str, object] = {"kind": "yolov8_raw", "vehicle_ids": [1], "input": spec}
    finder = NetworkFinder(Network(MaskOptions(graphs.save(graphs.yolov8_raw(), tmp_path, contract))))
    # Each is 32 x 32 with one bright square of the network's size; the fourth is dark, the fifth in a second input.
    corners = [(0, 0), (8, 16), (24, 24), None, (16, 0)]
    crops = []
    for number, corner in enumerate(corners):
        image = np.full((32, 32, 3), 20, dtype=np.uint8)
        if corner is not None:
            image[corner[1] : corner[1] + 8, corner[0] : corner[0] + 8] = 230
        crops.append(Crop(0, 100 * number, 50, image))
    found = finder.find(crops)
    assert finder.runs == 2
    for number, (corner, vehicles) in enumerate(zip(corners, found, strict=True)):
        if corner is None:
            assert vehicles == ()
            continue
        [vehicle] = vehicles
        x, y = corner[0] + 100 * number, corner[1] + 50
        np.testing.assert_allclose(vehicle.box, [x, y, x + 8, y + 8], atol=1e-4)


def test_a_crop_that_would_become_too_small_gets_an_input_of_its_own(tmp_path: Path) -> None:
    contract: dict[str, object] = {"kind": "yolov8_raw", "vehicle_ids": [1], "input": {"crops": [2, 2]}}
    finder = NetworkFinder(Network(MaskOptions(graphs.save(graphs.yolov8_raw(), tmp_path, contract))))
    finder.find([crop(32, 32), crop(65, 20), crop(32, 20)])
    assert finder.runs == 2
