"""The sensor that CONTRIBUTING.md adds as its example, as it stands there."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from laci_stereo.core.frames import invert, transform
from tests.detections import cam_rows
from tests.simulated import lidar, scene

GUIDE = Path(__file__).parents[1] / "CONTRIBUTING.md"


@pytest.mark.slow
def test_the_example_of_a_sensor_finds_where_it_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (example,) = re.findall(r"## Adding a sensor\n.*?```python\n(.*?)```", GUIDE.read_text(encoding="utf-8"), re.DOTALL)
    assert len([line for line in example.splitlines() if line.strip()]) < 40
    made = scene(sensor=lidar(layers=48, columns=240))
    (tmp_path / "scans").mkdir()
    for cloud in made.recording:
        np.savez(tmp_path / f"scans/{cloud.stamp_ns}.npz", points=cloud.points, stamp=cloud.stamp_ns)
    cam_rows(made.messages).write(tmp_path / "cam.csv")
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    exec(compile(example, GUIDE.name, "exec"), names)
    # What is required of a LiDAR: the vehicle's way to 3 cm, the angle to 0.08 deg.
    T_true, T_utm_sensor = made.recording.T_world_sensor, names["found"].T_utm_sensor
    xy, _ = made.vehicle.drive.at(made.recording.times_s)
    seen = transform(T_utm_sensor, transform(invert(T_true), np.column_stack([xy, np.zeros(len(xy))])))
    off_m = np.linalg.norm(seen[:, :2] - made.place.to_utm(xy), axis=1)
    assert np.sqrt((off_m**2).mean()) < 0.03
    assert np.abs(seen[:, 2]).max() < 0.03
    turn = T_utm_sensor[:3, :3] @ T_true[:3, :3].T
    assert np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))) < 0.08
    assert capsys.readouterr().out.endswith(f"{names['found'].quality.verdict}\n")
