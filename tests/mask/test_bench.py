"""The benchmark's detector of the truth sees vehicles where they are, and spoilt ones where they are not."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from laci_stereo.mask.apply import choose
from laci_stereo.mask.picture import Crop
from laci_stereo.stereo.rectify import rectify
from tools.bench_mask import FACTORS, SHIFT_PX, Simulated, TrueDetector, everything, false, missing, right, shifted
from tools.bench_mask import true_boxes as projected_boxes
from tools.scenes.scene import draw_scene


@pytest.fixture(scope="module")
def simulated() -> Simulated:
    return Simulated(draw_scene(3, "stereo_05", **FACTORS))


def middle_frame(simulated: Simulated) -> int:
    seen = np.flatnonzero(simulated.scene.in_view)
    return int(seen[len(seen) // 2])


def test_boxes_in_the_image_are_around_what_is_seen(simulated: Simulated) -> None:
    scene, index = simulated.scene, middle_frame(simulated)
    stamp = int(scene.stamps_ns[index])
    recording = SimpleNamespace(rectification=rectify(simulated.camera.rig))
    projected = projected_boxes(scene, recording)[stamp]  # type: ignore[arg-type]
    seen = simulated.boxes_at(index) * simulated.camera.stride
    assert len(seen) >= 1
    for box in seen:
        apart = np.abs(projected - box).max(axis=1).min()
        assert apart <= 2 * simulated.camera.stride


def test_a_true_mask_keeps_vehicles_and_drops_the_rest(simulated: Simulated) -> None:
    index = middle_frame(simulated)
    frame = simulated.moving(index)
    stamp = frame.cloud.stamp_ns
    detector = TrueDetector({stamp: simulated.boxes_at(index)}, right, 0, simulated.camera.stride)
    found = [vehicle for each in detector.find(frame.crops) for vehicle in each]
    keep = choose(frame, found, 2).keep
    of_vehicle = simulated.is_vehicle(index)[frame.v, frame.u]
    standing = frame.above > 3
    assert keep[of_vehicle & standing].mean() > 0.9
    assert of_vehicle[keep & standing].mean() > of_vehicle[standing].mean()


def test_spoilt_detectors_are_wrong_as_they_say() -> None:
    crops = [Crop(stamp, 0, 0, np.zeros((400, 600, 3), np.uint8)) for stamp in range(6)]
    boxes = {stamp: np.array([[200.0, 100.0, 400.0, 200.0]]) for stamp in range(6)}

    def seen(spoil):  # type: ignore[no-untyped-def]
        return TrueDetector(boxes, spoil, 1, 1).find(crops)

    true = np.array([each[0].box for each in seen(right)])
    assert np.abs(true - boxes[0]).max() < 40
    moved = np.array([each[0].box for each in seen(shifted)]) - true
    np.testing.assert_allclose(np.hypot(moved[:, 0], moved[:, 1]), SHIFT_PX)
    assert [len(each) for each in seen(missing)] == [0, 1, 1, 0, 1, 1]
    assert [len(each) for each in seen(false)] == [2] * 6
    assert [len(each) for each in seen(everything)] == [0, 2, 2, 0, 2, 2]
