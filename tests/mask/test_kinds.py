"""Every kind of output finds the bright rectangle, with a real network in the real runtime."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest

from laci_stereo.core.frames import BoolArray
from laci_stereo.mask.detect import NetworkFinder, Vehicle
from laci_stereo.mask.network import PROVIDERS, MaskOptions, Network, Provider
from laci_stereo.mask.picture import Crop
from tests.mask import graphs

BOX = (16, 8, 48, 40)
"""Left, top, right and bottom, on the networks' squares."""

PLAIN = {"color": "RGB", "resize": "stretch"}

KINDS: dict[str, tuple[Callable[[], onnx.ModelProto], dict[str, Any]]] = {
    "yolox_raw": (graphs.yolox_raw, {"output": {"strides": [8]}}),
    "yolov8_raw": (graphs.yolov8_raw, {}),
    "yolo_e2e": (graphs.yolo_e2e, {}),
    "ssd": (graphs.ssd, {"output": {"box_format": "yxyx", "normalized": True}}),
    "ssd, scores per class": (graphs.ssd_per_class, {"output": {"names": ["boxes", "scores"]}}),
    "detr": (graphs.detr, {}),
    "instance_masks": (graphs.instance_masks, {"output": {"names": ["boxes", "scores", "labels", "masks"]}}),
    "yolo_seg": (graphs.yolo_seg, {}),
    "semantic": (graphs.semantic, {}),
    "semantic, classes": (lambda: graphs.semantic(as_classes=True), {}),
}


def finder(name: str, folder: Path, provider: Provider = "cpu") -> NetworkFinder:
    make, more = KINDS[name]
    contract = {"kind": name.split(",")[0], "vehicle_ids": [1], "input": PLAIN, **more}
    return NetworkFinder(Network(MaskOptions(graphs.save(make(), folder, contract), provider=provider)))


def covered(vehicles: tuple[Vehicle, ...], side: int) -> BoolArray:
    """All pixels of the image that are in a box, or in a mask where there is one."""
    mask = np.zeros((side, side), dtype=bool)
    for vehicle in vehicles:
        x0, y0, x1, y1 = np.rint(vehicle.box).astype(int)
        if vehicle.mask is None:
            mask[y0:y1, x0:x1] = True
        else:
            (x, y), (height, width) = vehicle.corner, vehicle.mask.shape
            mask[y : y + height, x : x + width] |= vehicle.mask
    return mask


@pytest.mark.parametrize("name", KINDS)
def test_what_is_bright_is_found_where_it_is(name: str, tmp_path: Path) -> None:
    network = finder(name, tmp_path)
    picture = graphs.square(*BOX)
    [found] = network.find([Crop(0, 0, 0, picture)])
    mask = covered(found, graphs.SIDE)
    expected = picture[:, :, 0] > graphs.BRIGHT
    # Prototypes have a quarter of the resolution: their edge lies within half of their pixel.
    limit = 2 if name == "yolo_seg" else 0
    assert np.abs(mask.nonzero()[0].min() - BOX[1]) <= limit
    assert (mask != expected).sum() <= limit * 4 * (BOX[2] - BOX[0])
    assert all(vehicle.class_id == 1 and vehicle.score > 0.9 for vehicle in found)
    assert network.find([Crop(0, 0, 0, graphs.square(0, 0, 0, 0))]) == [()]


@pytest.mark.skipif(
    PROVIDERS["cuda"] not in onnxruntime.get_available_providers(), reason="this onnxruntime does not offer CUDA"
)
def test_cuda_finds_what_the_processor_finds(tmp_path: Path) -> None:
    crop = Crop(0, 0, 0, graphs.square(*BOX))
    for name in KINDS:
        [by_cpu], [by_cuda] = (finder(name, tmp_path, provider).find([crop]) for provider in ("cpu", "cuda"))
        assert len(by_cpu) == len(by_cuda) > 0
        assert (covered(by_cpu, graphs.SIDE) == covered(by_cuda, graphs.SIDE)).all()


@pytest.mark.parametrize("name", KINDS)
def test_a_crop_of_another_size_comes_back_to_its_place(name: str, tmp_path: Path) -> None:
    large = graphs.square(*(2 * value for value in BOX), side=128)
    [found] = finder(name, tmp_path).find([Crop(0, 300, 200, large)])
    boxes = np.array([vehicle.box for vehicle in found])
    if not name.startswith(("instance", "yolo_seg")):  # their boxes are the whole picture
        assert boxes[:, 0].min() == 300 + 2 * BOX[0]
        assert boxes[:, 3].max() == 200 + 2 * BOX[3]
    assert all(vehicle.mask is None or vehicle.corner == (300, 200) for vehicle in found)
    if found[0].mask is not None:
        mask = np.logical_or.reduce([vehicle.mask for vehicle in found if vehicle.mask is not None])
        assert abs(int(mask.sum()) - 4 * (BOX[2] - BOX[0]) * (BOX[3] - BOX[1])) <= 8 * 2 * (BOX[2] - BOX[0])


def test_classes_that_are_no_vehicles_are_left_out(tmp_path: Path) -> None:
    contract = {"kind": "yolov8_raw", "vehicle_ids": [0], "input": PLAIN}
    network = Network(MaskOptions(graphs.save(graphs.yolov8_raw(), tmp_path, contract)))
    assert NetworkFinder(network).find([Crop(0, 0, 0, graphs.square(*BOX))]) == [()]


def test_of_boxes_on_each_other_the_best_stays(tmp_path: Path) -> None:
    """All boxes of the yolo_seg network are the whole picture, so that one is left."""
    [found] = finder("yolo_seg", tmp_path).find([Crop(0, 0, 0, graphs.square(*BOX))])
    assert len(found) == 1
