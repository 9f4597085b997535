"""Scans as a monitor takes them: section by section, from folders that grow, as their calibration says."""

from __future__ import annotations

import json
import shutil
import time
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from laci_lidar.errors import ScanError
from laci_lidar.monitor import LidarFrames, stored_settings
from laci_lidar.monitor_command import monitor
from laci_lidar.settings import LidarSettings, Sweep

from laci_stereo.commands.importing import import_command
from laci_stereo.core.errors import CalibrationFileError
from laci_stereo.core.frames import Axes
from laci_stereo.monitor.frames import STILL_S
from tests.lidar.support import write_folder
from tests.monitor.support import WORLD, Traffic, drive, gone_through, one_by_one, plan

SETTINGS = LidarSettings(range_sigma_m=0.02, angle_sigma_rad=5e-4)


@pytest.fixture(scope="module")
def truth() -> Traffic:
    return one_by_one(drive(0.2), drive(0.2))


@pytest.fixture(scope="module")
def scans(truth: Traffic, tmp_path_factory: pytest.TempPathFactory) -> Path:
    clouds = [truth.frame(number).points.astype(np.float32) for number in range(len(truth.stamps_ns))]
    columns = [dict(zip("xyz", cloud.T, strict=True)) | {"intensity": np.ones(len(cloud))} for cloud in clouds]
    return write_folder(tmp_path_factory.mktemp("lidar") / "scans", columns, "npy", truth.stamps_ns.tolist())


def test_folder_tells_what_the_scanner_saw(truth: Traffic, scans: Path, tmp_path: Path) -> None:
    frames = LidarFrames(scans, None, SETTINGS)
    monitor = gone_through(frames, plan(truth), tmp_path / "out")  # type: ignore[arg-type]
    found = monitor.state.tally.strips["1"]
    assert found.along == 2
    assert found.offset_m == pytest.approx(0.2, abs=0.06)


def test_unreadable_scan_is_an_empty_frame_and_counted(scans: Path, truth: Traffic, tmp_path: Path) -> None:
    folder = shutil.copytree(scans, tmp_path / "scans")
    victim = sorted(folder.iterdir())[30]
    victim.write_bytes(victim.read_bytes()[:100])
    frames = LidarFrames(folder, None, SETTINGS)
    frames.refresh(0)
    scene = frames.learn(range(0, 100, 1))
    clouds = list(scene.section(range(25, 35)))
    assert [len(cloud) > 0 for cloud in clouds] == [number != 30 for number in range(25, 35)]
    assert [cloud.stamp_ns for cloud in clouds] == truth.stamps_ns[25:35].tolist()
    assert scene.unusable == 1


def test_growing_folder_gives_what_is_whole(scans: Path, truth: Traffic, tmp_path: Path) -> None:
    folder = tmp_path / "scans"
    folder.mkdir()
    frames = LidarFrames(folder, None, SETTINGS, follow=True)
    frames.refresh(0)
    assert len(frames.stamps_ns) == 0
    files = sorted(scans.iterdir())
    for part in (files[:10], files[10:20]):
        for file in part:
            shutil.copy(file, folder / file.name)
        known = len(frames.stamps_ns)
        frames.refresh(0)
        assert len(frames.stamps_ns) == known
        time.sleep(STILL_S)
        frames.refresh(0)
    assert frames.stamps_ns.tolist() == truth.stamps_ns[:20].tolist()
    # Those of a checkpoint are known to be whole.
    again = LidarFrames(folder, None, SETTINGS, follow=True)
    again.refresh(15)
    assert len(again.stamps_ns) == 15
    assert again.identity == frames.identity


def test_only_a_folder_is_followed(tmp_path: Path) -> None:
    bag = tmp_path / "scans.mcap"
    bag.write_bytes(b"")
    with pytest.raises(ScanError, match="no folder"):
        LidarFrames(bag, None, SETTINGS, follow=True)


def test_settings_are_those_of_the_calibration(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    axes = Axes((0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    for sweep in (Sweep("middle", "ccw", 20.0), "none", None):
        asked = LidarSettings(range_sigma_m=0.03, sweep=sweep, accumulate=5, axes=axes)
        path.write_text(json.dumps({"config": {"lidar": asdict(asked)}}))
        found = stored_settings(path, workers=3)
        assert found == LidarSettings(range_sigma_m=0.03, sweep=sweep, axes=axes, workers=3)
    path.write_text(json.dumps({"config": {}}))
    with pytest.raises(CalibrationFileError, match=r"calibration\.json: config\.lidar"):
        stored_settings(path, workers=0)


def test_an_imported_calibration_is_monitored_as_scans_are_by_default(
    scans: Path, truth: Traffic, tmp_path: Path
) -> None:
    (tmp_path / "T.txt").write_text("\n".join(" ".join(map(repr, map(float, row))) for row in truth.T_world_sensor))
    (tmp_path / "map.csv").write_text("id,x,y\na,570022,5364040\na,570022,5363960\n")
    origin, zone = ",".join(map(str, WORLD.origin_utm)), ("--kind", "lidar", "--crs", WORLD.crs)
    taken = CliRunner().invoke(
        import_command, [str(tmp_path / "T.txt"), *zone, "--origin", origin, "--out", str(tmp_path / "imported")]
    )
    assert taken.exit_code == 0, taken.exception
    asked = (tmp_path / "imported", scans, "--map", tmp_path / "map.csv", "--out", tmp_path / "out")
    ran = CliRunner().invoke(monitor, list(map(str, asked)))
    assert ran.exit_code == 0, ran.exception
    assert "was imported and does not say how scans are read; taken is x forward, z up" in ran.stderr
    assert json.loads((tmp_path / "out" / "monitor.json").read_text())["passages"] == 2
