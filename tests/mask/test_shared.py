"""Real detectors on a recording with its truth, where they are at hand."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import laci_stereo
from laci_stereo.mask.network import MaskOptions
from laci_stereo.run import Options

SHARED = Path(__file__).resolve().parents[3] / "shared"
CROSSING, MODELS = SHARED / "data" / "crossing", SHARED / "models"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (CROSSING.exists() and MODELS.exists()), reason=f"{SHARED} has no recording and no models"),
]


@pytest.mark.parametrize(
    ("model", "grey"),
    [("yolox_nano_at1152x640", False), ("yolox_nano_416", False), ("yolox_nano_at1152x640", True)],
)
def test_a_real_detector_keeps_the_result_right(model: str, grey: bool, tmp_path: Path) -> None:
    folder = as_grey(tmp_path) if grey else CROSSING
    options = Options(mask=MaskOptions(MODELS / f"{model}.onnx"), stereo=CROSSING / "stereo.yaml")
    found = laci_stereo.calibrate(folder / "left", folder / "right", CROSSING / "cam.csv", options).calibration
    truth = json.loads((CROSSING / "truth.json").read_text())
    T_true = np.array(truth["stereo"]["T_world_camera_utm"])
    track = np.array(truth["vehicle_centres_utm"])[:, 1:]
    ground = np.column_stack([track, np.zeros(len(track)), np.ones(len(track))])
    ground = ground[np.linalg.norm(track - T_true[:2, 3], axis=1) < 60]
    placed = ground @ np.linalg.inv(T_true).T @ found.T_utm_sensor.T
    assert np.sqrt(((placed - ground)[:, :2] ** 2).sum(axis=1).mean()) < 0.10
    turned = found.T_utm_sensor[:3, :3] @ T_true[:3, :3].T
    assert np.degrees(np.arccos(np.clip((np.trace(turned) - 1) / 2, -1, 1))) < 0.15


def as_grey(folder: Path) -> Path:
    for side in ("left", "right"):
        (folder / side).mkdir()
        for path in (CROSSING / side).iterdir():
            image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            if image is not None:
                cv2.imwrite(str(folder / side / f"{path.stem}.png"), image)
    return folder
