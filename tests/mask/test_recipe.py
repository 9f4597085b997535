"""The recipe of docs/vehicle_mask.md, from a network of one's own to a calibration with it."""

from __future__ import annotations

import json
import re
import signal
import time
from pathlib import Path

import cv2
import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from laci_stereo.mask.contract import read_contract
from tests.cli_support import Ran, document_in, refusal, run, running
from tests.mask import graphs

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "calib_data"
RECIPE = ROOT / "docs" / "vehicle_mask.md"
RED = 0.25
"""By how much red is above the mean of green and blue on the demonstration's car, of 1."""


def red_segmenter(folder: Path) -> Path:
    """A network of one convolution, for pictures of any size: class 1 is what is red."""
    weight = np.zeros((2, 3, 1, 1), dtype=np.float32)
    weight[1, :, 0, 0] = [1.0, -0.5, -0.5]
    graph = helper.make_graph(
        [helper.make_node("Conv", ["images", "weight", "bias"], ["logits"])],
        "red",
        [helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, 3, "height", "width"])],
        [helper.make_tensor_value_info("logits", TensorProto.FLOAT, [1, 2, "height", "width"])],
        [numpy_helper.from_array(weight, "weight"), numpy_helper.from_array(np.array([RED, 0], np.float32), "bias")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.checker.check_model(model)
    path = folder / "mine.onnx"
    path.write_bytes(model.SerializeToString())
    return path


def laci(folder: Path, *arguments: object) -> Ran:
    return run([str(argument) for argument in arguments], folder)


def contract_of_the_recipe() -> str:
    """The contract that the recipe prints for such a network."""
    blocks = re.findall(r"```json\n(.*?)```", RECIPE.read_text(encoding="utf-8"), re.DOTALL)
    [found] = [block for block in blocks if '"semantic"' in block]
    return found


def test_every_contract_in_the_recipe_is_one(tmp_path: Path) -> None:
    blocks = re.findall(r"```json\n(.*?)```", RECIPE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) >= 2
    for block in blocks:
        path = tmp_path / "c.json"
        path.write_text(block)
        read_contract(path)


@pytest.mark.slow
def test_a_network_of_ones_own_from_looking_to_calibrating(tmp_path: Path) -> None:
    model = red_segmenter(tmp_path)
    (tmp_path / "mine.contract.json").write_text(contract_of_the_recipe())
    looked = laci(tmp_path, "mask", model, DATA / "left", "--out", tmp_path / "look", "--every", "10")
    assert looked.code == 0
    pictures = sorted((tmp_path / "look").iterdir())
    assert len(pictures) == 5
    assert all(cv2.imread(str(picture)).shape == (720, 1280, 3) for picture in pictures)
    assert len(re.findall(r"^\d+\.jpg +\d+ +\d", looked.out, re.MULTILINE)) == 5
    out = tmp_path / "out"
    inputs = [DATA / name for name in ("left", "right", "cam.csv")]
    done = laci(tmp_path, "calibrate", *inputs, "--out", out, "-q", "--vehicle-mask", model)
    assert done.code == 0, done
    document = document_in(out)
    truth = np.array(json.loads((DATA / "truth.json").read_text())["stereo"]["T_world_camera_utm"])
    found = np.array(document["T_utm_sensor"])
    assert np.linalg.norm(found[:2, 3] - truth[:2, 3]) < 0.2
    angle = np.degrees(np.arccos(np.clip((np.trace(found[:3, :3] @ truth[:3, :3].T) - 1) / 2, -1, 1)))
    assert angle < 0.15
    assert len(document["inputs"][str(model)]) == 64
    assert any("points" in note and "dropped" in note for note in document["notes"])
    page = (out / "report.html").read_text()
    assert "vehicle mask: of " in page
    kept, dropped = map(int, re.findall(r"points (\d+) were kept and (\d+) dropped", page)[0])
    assert min(kept, dropped) > 0
    assert page.count('data-layer="mask"') == 1
    assert page.count('data-layer="dropped"') == 1


@pytest.mark.slow
def test_interrupted_it_says_what_is_written(tmp_path: Path) -> None:
    model = graphs.save(graphs.yolov8_raw(), tmp_path, {"kind": "yolov8_raw", "vehicle_ids": [1]})
    images, out = tmp_path / "left", tmp_path / "look"
    images.mkdir()
    for number in range(3000):
        name = f"{1700000000000000000 + number * 100000000}.png"
        if number == 0:
            cv2.imwrite(str(images / name), graphs.square(8, 8, 40, 40, side=64))
        else:
            (images / name).symlink_to(images / "1700000000000000000.png")
    with running(["mask", str(model), str(images), "--out", str(out)], tmp_path) as process:
        while process.poll() is None and len(list(out.glob("*.jpg"))) < 3:
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    written = len([path for path in out.iterdir() if path.suffix == ".jpg"])
    told = re.search(rf"interrupted; (\d+) of 3000 pictures are in {out}", said)
    assert told is not None, said
    assert int(told[1]) in (written - 1, written)  # the signal may fall between a picture and its count


@pytest.mark.slow
def test_pictures_are_not_replaced_unasked(tmp_path: Path) -> None:
    contract = {"kind": "yolov8_raw", "vehicle_ids": [1]}
    model = graphs.save(graphs.yolov8_raw(), tmp_path, contract)
    images = tmp_path / "left"
    images.mkdir()
    cv2.imwrite(str(images / "1700000000000000000.png"), graphs.square(8, 8, 40, 40, side=64))
    (images / "1700000000100000000.png").write_bytes(b"no image")
    out = tmp_path / "look"
    first = laci(tmp_path, "mask", model, images, "--out", out)
    assert first.code == 0, first
    assert "Vehicles in 1 of 1 images" in first.out
    refusal(laci(tmp_path, "mask", model, images, "--out", out), 2, "exists already")
    assert laci(tmp_path, "mask", model, images, "--out", out, "--overwrite").code == 0
    refusal(laci(tmp_path, "mask", model, images, "--out", model), 2, "net.onnx: cannot be made", "needed is a folder")
