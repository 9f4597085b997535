"""The check as a user runs it: exit codes, files, and the same in every run's result."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from jsonschema import Draft202012Validator

from laci_stereo.io.result.calibration_file import schema
from tests.cli_support import SMALL_LIMIT, Ran, Site, document_in, link_recording, refusal, run, run_installed, snapshot
from tests.io.support import with_utm


@dataclass(frozen=True)
class Calibrated:
    """A small recording, and what the tool made of it."""

    site: Site
    result: Path
    said: str

    @property
    def document(self) -> dict[str, Any]:
        return document_in(self.result)

    def check(self, calibration: Path, *options: str | Path) -> Ran:
        return run(["check", *map(str, (calibration, self.site.left, *options))], self.site.root)


@pytest.fixture(scope="module")
def calibrated(calibrated_site: tuple[Site, str]) -> Calibrated:
    site, said = calibrated_site
    return Calibrated(site, site.out, said)


def off_by(calibrated: Calibrated, folder: Path, east_m: float) -> Path:
    """Write the result again with the sensor put elsewhere."""
    document = calibrated.document
    T = np.array(document["T_world_sensor"])
    T[0, 3] += east_m
    document["T_world_sensor"] = T.tolist()
    path = folder / "calibration.json"
    path.write_text(json.dumps(with_utm(document)))
    return path


def test_run_with_a_map_says_whether_it_lies_on_the_road(calibrated: Calibrated) -> None:
    lanes = calibrated.document["lane_check"]
    Draft202012Validator(schema()).validate(calibrated.document)
    assert lanes["verdict"] == "pass"
    assert lanes["lines_found"] >= 0.5 * lanes["lines_in_view"]
    assert lanes["residual_px"] < 2.0
    assert "Lanes" in calibrated.said
    page = (calibrated.result / "report.html").read_text()
    assert "Does the map lie on the road?" in page
    assert cv2.imread(str(calibrated.result / "check.png")).shape == (360, 640, 3)


def test_demonstrations_stop_lines_are_where_they_are_painted(calibrated: Calibrated) -> None:
    stops = [line for line in calibrated.document["lane_check"]["lines"] if line["kind"] == "stop_line"]
    assert len(stops) == 4
    assert all(line["found"] and abs(line["offset_m"]) < 0.15 for line in stops)


def test_check_says_the_same_again(calibrated: Calibrated, tmp_path: Path) -> None:
    picture, figures = tmp_path / "check.png", tmp_path / "check.json"
    ran = calibrated.check(calibrated.result, "--picture", picture, "--json", figures)
    assert ran.code == 0, ran
    assert "PASS" in ran.out
    found, before = json.loads(figures.read_text()), calibrated.document["lane_check"]
    # The run looks at pairs only, the check at all images: their medians differ in noise.
    assert found["verdict"] == before["verdict"]
    assert found["error"]["east_m"] == pytest.approx(before["error"]["east_m"], abs=0.03)
    assert (cv2.imread(str(picture)) > 0).any()


@pytest.mark.parametrize("east_m", [-0.4, 0.4])
def test_wrong_calibration_fails(calibrated: Calibrated, tmp_path: Path, east_m: float) -> None:
    figures = tmp_path / "check.json"
    wrong = off_by(calibrated, tmp_path, east_m)
    ran = calibrated.check(wrong, "--picture", tmp_path / "check.png", "--json", figures)
    assert ran.code == 1, ran
    assert "FAIL" in ran.out
    right = calibrated.document["lane_check"]["error"]["east_m"]
    assert json.loads(figures.read_text())["error"]["east_m"] == pytest.approx(right + east_m, abs=0.05)


def test_map_far_from_the_view_cannot_tell(calibrated: Calibrated, tmp_path: Path) -> None:
    text = calibrated.site.root.joinpath("map.osm").read_text()
    elsewhere = tmp_path / "map.osm"
    elsewhere.write_text(text.replace('lat="48.42', 'lat="48.43'))
    ran = calibrated.check(calibrated.result, "--map", elsewhere, "--picture", tmp_path / "check.png")
    assert ran.code == 0, ran
    assert "CANNOT TELL: none of the map's lines that can be seen is in view" in ran.out


def test_nothing_that_stood_before_is_lost(calibrated: Calibrated, tmp_path: Path) -> None:
    picture = tmp_path / "check.png"
    picture.write_text("mine")
    refusal(calibrated.check(calibrated.result, "--picture", picture), 2, "check.png", "exists", "--overwrite")
    assert picture.read_text() == "mine"
    assert calibrated.check(calibrated.result, "--picture", picture, "--overwrite").code == 0
    assert cv2.imread(str(picture)) is not None


def test_what_is_no_error_of_a_map_is_refused(calibrated: Calibrated, tmp_path: Path) -> None:
    ran = calibrated.check(calibrated.result, "--map-sigma", "nan", "--picture", tmp_path / "check.png")
    refusal(ran, 2, "--map-sigma", "nan is not a number")


@pytest.mark.slow
def test_one_bad_image_among_many_is_left_out(calibrated: Calibrated, tmp_path: Path) -> None:
    left = Path(shutil.copytree(calibrated.site.left, tmp_path / "left"))
    min(left.iterdir()).write_bytes(b"no image")
    beside = ("--map", calibrated.site.root / "map.osm", "--stereo", calibrated.site.stereo)
    ran = run_installed(
        list(map(str, ("check", calibrated.result, left, *beside, "--picture", tmp_path / "check.png"))), tmp_path
    )
    assert ran.code == 0, ran
    assert "PASS" in ran.out


def lines_found(said: str) -> int:
    found = re.search(r"^Lines +(\d+) of", said, re.MULTILINE)
    assert found, said
    return int(found[1])


@pytest.mark.parametrize(("k1", "told_apart"), [pytest.param(-0.6, False, marks=pytest.mark.slow), (-0.9, True)])
def test_rectified_images_are_not_rectified_again(
    calibrated: Calibrated, tmp_path: Path, k1: float, told_apart: bool
) -> None:
    """By a calibration with a distortion that they do not have any more."""
    text = calibrated.site.stereo.read_text()
    storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
    entries = {name: storage.getNode(name).mat() for name in ("K1", "D1", "K2", "D2", "R", "T")}
    entries["D1"] = np.array([[k1, 0.3, 0.0, 0.0, 0.0]])
    size = [int(storage.getNode(name).real()) for name in ("image_width", "image_height")]
    out = cv2.FileStorage(str(tmp_path / "bent.yaml"), cv2.FILE_STORAGE_WRITE)
    for name, matrix in entries.items():
        out.write(name, matrix)
    for name, value in zip(("image_width", "image_height"), size, strict=True):
        out.write(name, value)
    out.release()
    options = ("--stereo", tmp_path / "bent.yaml", "--picture", tmp_path / "check.png", "--overwrite")
    again = calibrated.check(calibrated.result, *options)
    assert not (told_apart and "PASS" in again.out), again
    ran = calibrated.check(calibrated.result, "--rectified", *options)
    assert "PASS" in ran.out, ran
    assert lines_found(again.out) < 0.7 * lines_found(ran.out)


def with_kind(document: dict[str, Any]) -> None:
    document["sensor"]["kind"] = "lidar"


def without_schema(document: dict[str, Any]) -> None:
    del document["T_world_sensor"]


@pytest.mark.parametrize(("spoil", "words"), [(with_kind, ("lidar", "stereo")), (without_schema, ("T_world_sensor",))])
def test_unusable_result_is_refused(calibrated: Calibrated, tmp_path: Path, spoil: Any, words: tuple[str, ...]) -> None:
    document = calibrated.document
    spoil(document)
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(document))
    before = snapshot(tmp_path)
    refusal(calibrated.check(path, "--picture", tmp_path / "check.png"), 2, "calibration.json", *words)
    assert snapshot(tmp_path) == before


def test_what_is_missing_is_named(calibrated: Calibrated, tmp_path: Path) -> None:
    picture = ("--picture", tmp_path / "check.png")
    refusal(calibrated.check(tmp_path / "nothing.json", *picture), 2, "nothing.json")
    refusal(calibrated.check(calibrated.result, "--map", tmp_path / "no.osm", *picture), 2, "no.osm")
    lonely = tmp_path / "lonely"
    lonely.mkdir()
    link_recording(calibrated.site.left, lonely)
    ran = run(["check", str(calibrated.result), str(lonely), *map(str, picture)], tmp_path)
    refusal(ran, 2, "stereo.yaml", "--stereo")


@pytest.mark.slow
def test_run_without_a_map_says_nothing_of_lanes(calibrated: Calibrated, tmp_path: Path) -> None:
    folder = tmp_path / "recording"
    folder.mkdir()
    link_recording(calibrated.site.root, folder)
    (folder / "map.osm").unlink()
    site = Site(folder)
    ran = site.run(out=folder / "bare")
    assert ran.code == 0, ran
    document = document_in(folder / "bare")
    assert document["lane_check"] is None
    assert "Does the map lie" not in (folder / "bare" / "report.html").read_text()
    assert not (folder / "bare" / "check.png").exists()
    assert document["T_world_sensor"] == calibrated.document["T_world_sensor"]  # the lanes never enter the estimate


@pytest.mark.slow
def test_map_that_contradicts_a_result_lowers_its_verdict(calibrated: Calibrated, tmp_path: Path) -> None:
    """Whichever of them is wrong, everything that tells the verdict tells that."""
    text = calibrated.site.root.joinpath("map.osm").read_text()
    moved = tmp_path / "map.osm"
    moved.write_text(re.sub(r'lat="([0-9.]+)"', lambda found: f'lat="{float(found[1]) + 4e-6:.9f}"', text))
    out = tmp_path / "result"
    ran = calibrated.site.run("--map", moved, *SMALL_LIMIT, out=out)
    assert ran.code == 0, ran
    document = document_in(out)
    assert document["lane_check"]["verdict"] == "fail"
    assert calibrated.document["quality"]["verdict"] == "pass"
    assert document["quality"]["verdict"] == "warn"
    (reason,) = document["quality"]["reasons"]
    assert reason.startswith("the map contradicts it")
    assert document["lane_check"]["reasons"][0] in reason
    assert f"WARN: {reason}" in ran.out
    page = (out / "report.html").read_text()
    box = page[page.index("Verdict: warn") : page.index("Where the sensor stands")]
    assert "before it is clear whether it or the map is wrong" in box
    assert "the map contradicts it" in box
    assert "can be used" not in box
