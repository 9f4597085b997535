"""A LiDAR's lane check: paint is where more light comes back."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from laci_lidar.check import check_scans
from laci_lidar.cli import cli
from laci_lidar.folder import ScanFolder
from laci_lidar.scans import open_scans

from laci_stereo.check.images import Checked
from laci_stereo.check.placed import Placed
from laci_stereo.core.frames import FloatArray, rigid, rotation_z, transform
from laci_stereo.io.maps.lane_map import LaneMap
from laci_stereo.io.result.calibration_file import to_document
from tests.check.support import CENTRE, CLAIMED, CROSSING, Painted, shift, turn_about
from tests.io.support import with_utm
from tests.report.page_support import PROVENANCE
from tests.report.support import calibration

HEIGHT_M = 5.0
LANES = LaneMap(CROSSING, ())


def T_world_scanner() -> FloatArray:
    return rigid(rotation_z(1.2), np.array([1.0, 2.0, HEIGHT_M]))


def scan(rng: np.random.Generator, painted: Painted) -> FloatArray:
    """Cast 128 layers at the road; x, y, z, intensity, shape (n, 4): 2 cm of noise along the beam."""
    down, around = np.radians(np.linspace(5.0, 60.0, 128)), np.radians(np.arange(0.0, 360.0, 0.15))
    down, around = (each.ravel() for each in np.meshgrid(down, around))
    rays = np.column_stack([np.cos(down) * np.cos(around), np.cos(down) * np.sin(around), -np.sin(down)])
    exact = HEIGHT_M / np.sin(down)
    points = rays * exact[:, None]
    paint = painted.is_paint(transform(T_world_scanner(), points)[:, :2])
    intensity = np.where(paint, 60.0, 20.0) + rng.normal(0.0, 4.0, len(points))
    noisy = points + rays * rng.normal(0.0, 0.02, len(points))[:, None]
    return np.column_stack([noisy, np.clip(intensity, 0.0, None)])


def write(folder: Path, painted: Painted, columns: int = 4) -> Path:
    rng = np.random.default_rng(2)
    for number in range(3):
        np.save(folder / f"{1_700_000_000_000_000_000 + number * 100_000_000}.npy", scan(rng, painted)[:, :columns])
    return folder


@cache
def scans_in(folder: Path) -> ScanFolder:
    opened = open_scans(folder)
    assert isinstance(opened, ScanFolder)
    return opened


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("scans"), Painted())


def check(folder: Path, T_error: FloatArray) -> Checked | None:
    placed = Placed(T_error @ T_world_scanner(), CLAIMED, CENTRE, np.zeros((0, 6)))
    return check_scans(scans_in(folder), placed, LANES)


def test_truth_passes(recording: Path) -> None:
    checked = check(recording, np.eye(4))
    assert checked is not None
    assert checked.check.judgement.outcome == "pass", checked.check.judgement
    assert checked.check.residual_m < 0.03
    assert checked.check.residual_px is None
    assert checked.picture.ndim == 3


@pytest.mark.parametrize(
    ("T_error", "east_m", "north_m"), [(shift(0.3, 0.0), 0.3, 0.0), (shift(-0.2, 0.22), -0.2, 0.22)]
)
def test_shift_fails_and_is_measured(recording: Path, T_error: FloatArray, east_m: float, north_m: float) -> None:
    checked = check(recording, T_error)
    assert checked is not None
    assert checked.check.judgement.outcome == "fail", checked.check.judgement
    assert checked.check.error.value[:2] == pytest.approx([east_m, north_m], abs=0.03)


def test_turn_fails_and_is_measured(recording: Path) -> None:
    checked = check(recording, turn_about(np.zeros(2), 0.6))
    assert checked is not None
    assert checked.check.judgement.outcome == "fail"
    assert np.degrees(checked.check.error.value[2]) == pytest.approx(0.6, abs=0.1)


def test_height_of_the_road_moves_nothing_sideways(recording: Path) -> None:
    """Unlike a camera: a sensor that hangs 10 cm lower than thought still sees paint where it is."""
    lower = rigid(np.eye(3), np.array([0.0, 0.0, 0.1]))
    checked = check(recording, lower)
    assert checked is not None
    assert checked.check.judgement.outcome == "pass"
    assert np.linalg.norm(checked.check.error.value[:2]) < 0.03


def test_scans_without_intensity_tell_nothing(tmp_path: Path) -> None:
    assert check(write(tmp_path, Painted(), columns=3), np.eye(4)) is None


def write_result(folder: Path, T: FloatArray) -> Path:
    document = to_document(calibration(), PROVENANCE)
    document["sensor"]["kind"] = "lidar"
    document["T_world_sensor"] = T.tolist()
    document["covariance"] = CLAIMED.tolist()
    document["covariance_centre_world"] = CENTRE.tolist()
    document["background_boxes"] = []
    path = folder / "calibration.json"
    path.write_text(json.dumps(with_utm(document)))
    return path


def write_map(folder: Path) -> Path:
    world = calibration().world
    features = []
    for line in CROSSING:
        positions = world.to_geodetic(line.xy)[:, ::-1].tolist()
        geometry = {"type": "LineString", "coordinates": positions}
        features.append({"type": "Feature", "properties": {"type": line.kind}, "geometry": geometry})
    path = folder / "lanes.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


def run(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, ["check", *map(str, arguments)])


@pytest.mark.parametrize(("T_error", "code", "verdict"), [(np.eye(4), 0, "PASS"), (shift(0.3, 0.1), 1, "FAIL")])
def test_command_tells_right_from_wrong(
    recording: Path, tmp_path: Path, T_error: FloatArray, code: int, verdict: str
) -> None:
    result = write_result(tmp_path, T_error @ T_world_scanner())
    picture = tmp_path / "check.png"
    ended = run(result, recording, "--map", write_map(tmp_path), "--picture", picture)
    assert ended.exit_code == code, ended.output
    assert verdict in ended.output
    assert picture.stat().st_size > 0


def test_command_refuses_scans_without_intensity(tmp_path: Path) -> None:
    bare = tmp_path / "scans"
    bare.mkdir()
    write(bare, Painted(), columns=3)
    result = write_result(tmp_path, T_world_scanner())
    ended = run(result, bare, "--map", write_map(tmp_path), "--picture", tmp_path / "check.png")
    assert "intensity" in str(ended.exception)
