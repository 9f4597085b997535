"""The benchmark's detector of the truth sees vehicles where they are, and spoilt ones where they are not."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from laci_stereo.mask.apply import choose
from laci_stereo.mask.picture import Crop
from laci_stereo.mask.stage import VehicleMask
from laci_stereo.stereo.recording import StereoRecording
from laci_stereo.stereo.rectify import rectify
from tests.mask.test_recording import TrueBoxes, frames
from tests.stereo.rigs import RIGS
from tools.bench_mask import (
    CLOSE,
    FACTORS,
    SHIFT_PX,
    MatchedOnce,
    Row,
    Simulated,
    TrueDetector,
    TrueSegmenter,
    everything,
    false,
    missing,
    read_rows,
    right,
    shifted,
    small_and_calm,
    write_rows,
)
from tools.bench_mask import true_boxes as projected_boxes
from tools.scenes.disparity import StereoCamera
from tools.scenes.scene import draw_scene


@pytest.fixture(scope="module")
def simulated() -> Simulated:
    return Simulated(draw_scene(3, "stereo_05", **FACTORS))


def middle_frame(simulated: Simulated) -> int:
    seen = np.flatnonzero(simulated.scene.in_view)
    return int(seen[len(seen) // 2])


@pytest.mark.slow
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


def test_true_outlines_hold_vehicles_and_nothing_else(simulated: Simulated) -> None:
    index = middle_frame(simulated)
    frame = simulated.moving(index)
    found = [each for part in TrueSegmenter(simulated.scene, simulated.shown, 0).find(frame.crops) for each in part]
    of_vehicle = simulated.is_vehicle(index)
    drawn = np.zeros(of_vehicle.shape, dtype=bool)
    for vehicle in found:
        assert vehicle.mask is not None
        (x0, y0), (height, width) = vehicle.corner, vehicle.mask.shape
        drawn[y0 : y0 + height, x0 : x0 + width] |= vehicle.mask
    core = cv2.erode(of_vehicle.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    assert core.sum() > 100
    assert drawn[core].mean() > 0.9
    assert not drawn[cv2.dilate(of_vehicle.astype(np.uint8), np.ones((9, 9), np.uint8)) == 0].any()


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


@pytest.mark.slow
@pytest.mark.parametrize("masked", [False, True])
def test_frames_matched_once_are_those_of_the_recording(masked: bool, tmp_path: Path) -> None:
    pairs = frames("ideal", tmp_path)
    recording = StereoRecording(pairs, RIGS["ideal"])
    once = MatchedOnce.of(recording)
    if masked:
        recording.mask, once.mask = (VehicleMask(TrueBoxes("ideal", pairs), "truth") for _ in range(2))
    assert len(once) == len(recording)
    assert once.span_ns == recording.span_ns
    for _ in range(2):  # they can be had again
        for found, expected in zip(once, recording, strict=True):
            assert found.stamp_ns == expected.stamp_ns
            np.testing.assert_array_equal(found.points, expected.points)
        for found, expected in zip(once.survey(), recording.survey(), strict=True):
            np.testing.assert_array_equal(found.points, expected.points)


@pytest.mark.slow
def test_rendered_scenes_are_smaller_and_their_trees_stand_still() -> None:
    scene = draw_scene(1, "stereo_05", **CLOSE)
    small = small_and_calm(scene)
    assert sum(not body.static for body in small.bodies) >= 1 + len(scene.others)
    assert all(body.static for body in small.bodies if body.name.startswith(("tree", "hedge")))
    assert any(not body.static for body in small.bodies if body.name.startswith("shrub"))
    assert isinstance(small.sensor, StereoCamera)
    assert isinstance(scene.sensor, StereoCamera)
    field = [np.array(camera.size_px) / camera.focal_px for camera in (small.sensor, scene.sensor)]
    np.testing.assert_allclose(field[0], field[1], rtol=2e-3)


def test_what_a_run_has_left_is_read_again(tmp_path: Path) -> None:
    rows = [Row(3, "without", "SceneError: none"), Row(4, "with", "", 3.25, 0.5, 1.5, 0.25, 10, 2, 1, 0)]
    write_rows(tmp_path / "rows.csv", rows)
    assert repr(read_rows(tmp_path / "rows.csv")) == repr(rows)  # NaN is not itself
