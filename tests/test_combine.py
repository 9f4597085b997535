"""Results of several drives made one, through Python and through the installed command."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from jsonschema import Draft202012Validator

from laci_stereo.combine import CombineOptions, combine
from laci_stereo.core.errors import EvidenceError
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.io.result.calibration_file import schema
from laci_stereo.io.result.evidence_file import read_evidence, write_evidence
from laci_stereo.match import match
from tests.cli_support import document_in, refusal, refused, run, run_installed
from tests.detections import cam_rows, detection_rows, traffic
from tests.passages import misplaced, off_by, passages, recorded, save, with_passage

NOT_CALIBRATED, UNUSABLE = 1, 2


@dataclass(frozen=True)
class Site:
    """A folder with results."""

    root: Path

    @property
    def out(self) -> Path:
        return self.root / "all"

    def document(self) -> dict[str, Any]:
        return document_in(self.out)

    def lay(self, number: int, passage: Passage | None = None) -> str:
        """Write the result of a drive, perhaps with another drive in its evidence."""
        found = recorded()[number][1]
        save(found if passage is None else with_passage(found, passage), self.root / f"run{number}")
        return f"run{number}"

    def arguments(self, runs: Sequence[str], *options: str) -> list[str]:
        return ["combine", *runs, "--out", "all", *options]

    def refused(self, code: int, runs: Sequence[str], *words: str) -> None:
        refused(lambda: run(self.arguments(runs), self.root), self.root, code, *words)


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path)


def test_the_command_writes_a_whole_result(site: Site) -> None:
    runs = [site.lay(number) for number in range(3)]
    ran = run_installed(site.arguments(runs), site.root)
    assert ran.code == 0, ran
    assert sorted(path.name for path in site.out.iterdir()) == [
        "calibration.json",
        "evidence.npz",
        "report.html",
        "topdown.png",
    ]
    document = site.document()
    Draft202012Validator(schema()).validate(document)
    assert document["method"] == "joint"
    assert document["sensor"] == {"name": "mast 7", "kind": "lidar", "frame": "as in the scans"}
    assert document["inputs"] == {
        f"{name}/evidence.npz": hashlib.sha256((site.root / name / "evidence.npz").read_bytes()).hexdigest()
        for name in runs
    }
    for name, station in zip(runs, (42, 43, 44), strict=True):
        assert any(
            note.startswith(f"{name}: station {station}, ") and "clock offset" in note for note in document["notes"]
        )
        assert f"note: {name}: station {station}, " in ran.err
    assert "and 2 more drives" in ran.out
    assert "3 drives from 3 results, 0 left out" in ran.out
    truth = recorded()[0][0].recording.T_world_sensor
    assert document["height_m"] == pytest.approx(truth[2, 3], abs=0.01)
    assert document["quality"]["track_xy_sigma_m"] < min(found.quality.track_xy_sigma_m for _, found in recorded())
    assert cv2.imread(str(site.out / "topdown.png")) is not None
    refusal(run(site.arguments(runs), site.root), UNUSABLE, "holds a result already", "--overwrite")
    assert "needed is another --out" in run(site.arguments(["all"], "--overwrite"), site.root).err
    assert site.document() == document
    (site.root / "all").rename(site.root / "before")
    again = run(site.arguments(["before"], "--overwrite", "--name", "mast 8", "-q"), site.root)
    assert (again.code, again.out, again.err) == (0, "", "")
    replaced = site.document()
    assert replaced["sensor"]["name"] == "mast 8"
    assert np.array(replaced["T_utm_sensor"]) == pytest.approx(np.array(document["T_utm_sensor"]), abs=2e-3)


def test_a_drive_that_contradicts_the_others_is_named_and_left_out(site: Site) -> None:
    runs = [site.lay(0), site.lay(1, off_by(passages()[1], -0.6, 0.8)), site.lay(2)]
    ran = run(site.arguments(runs), site.root)
    assert ran.code == 0, ran
    assert "note: run1 left out: it alone is " in ran.err
    assert "3 drives from 3 results, 1 left out" in ran.out
    document = site.document()
    assert any(note.startswith("run1 left out: ") and "sigma" in note for note in document["notes"])
    assert len(document["inputs"]) == 3


@pytest.mark.parametrize(
    ("times", "verdict", "code"),
    [*(pytest.param(*each, marks=pytest.mark.slow) for each in ((1.1, "pass", 0), (0.5, "warn", 0))), (0.2, "fail", 1)],
)
def test_the_verdict_is_by_the_limits_that_are_asked_for(site: Site, times: float, verdict: str, code: int) -> None:
    runs = [site.lay(0)]
    assert run(site.arguments(runs), site.root).code == 0
    sigma_m = site.document()["quality"]["track_xy_sigma_m"]
    limit = f"{times * sigma_m:.5f}"
    ran = run(site.arguments(runs, "--overwrite", "--max-sigma-m", limit), site.root)
    assert ran.code == code, ran
    quality = site.document()["quality"]
    assert quality["verdict"] == verdict
    assert any("the limit is" in reason for reason in quality["reasons"]) == (verdict != "pass")


@pytest.mark.slow
@pytest.mark.slow
def test_a_result_that_fails_and_what_was_objected_to_it_are_not_forgotten(site: Site) -> None:
    doubted = replace(passages()[1], objections=("the box is a dog's",), by_chance="it may be a stranger's")
    runs = [site.lay(0), site.lay(1, doubted)]
    assert run(site.arguments(runs[:1], "--max-sigma-m", "0.0001"), site.root).code == NOT_CALIBRATED
    (site.root / "all").rename(site.root / "failed")
    alone = run(site.arguments([runs[1]]), site.root)
    for objection in ("the box is a dog's", "it may be a stranger's"):
        assert objection in alone.out
    ran = run(site.arguments(["failed", runs[1]], "--overwrite"), site.root)
    assert ran.code == 0, ran
    assert "note: failed: by itself, its verdict is fail" in ran.err.splitlines()
    # Another drive shows that it is no stranger, but not what the box is of.
    quality = site.document()["quality"]
    assert quality["verdict"] == "warn"
    assert "run1: the box is a dog's" in quality["reasons"]
    assert not any("stranger" in reason for reason in quality["reasons"])


def test_what_cannot_be_combined_is_refused(site: Site) -> None:
    runs = [site.lay(0), site.lay(1, off_by(passages()[1], 1.0, 0.0))]
    site.refused(NOT_CALIBRATED, runs, "not calibrated: no majority of the 2 drives (run0, run1)")
    ground = passages()[0].ground
    moved = site.lay(2, replace(passages()[2], ground=replace(ground, height_m=ground.height_m - 0.3)))
    site.refused(NOT_CALIBRATED, [runs[0], moved], "the sensor was moved between the drives: in run2", "-0.300 m")
    site.refused(UNUSABLE, [runs[0], "run0/evidence.npz"], "run0/evidence.npz: is the same drive as run0")
    site.refused(UNUSABLE, [runs[0], "nowhere"], "nowhere does not exist")
    save(recorded()[1][1], site.root / "radar", kind="detections")
    site.refused(UNUSABLE, [runs[0], "radar"], "radar: the sensor's kind is detections; needed is lidar as in run0")


def test_frames_that_differ_are_not_combined(site: Site) -> None:
    runs = [site.lay(0), site.lay(1)]
    evidence = site.root / "run1" / "evidence.npz"
    kept = read_evidence(evidence)
    write_evidence(evidence, replace(kept, frame="turned"))
    site.refused(UNUSABLE, runs, "run1: the sensor's frame is 'turned'; needed is 'as in the scans' as in run0")


def test_what_is_of_two_sensors_is_named_so(site: Site) -> None:
    ground = passages()[2].ground
    runs = [site.lay(0), site.lay(2, replace(passages()[2], ground=replace(ground, height_m=ground.height_m - 0.3)))]
    evidence = site.root / runs[1] / "evidence.npz"
    write_evidence(evidence, replace(read_evidence(evidence), name="mast 8"))
    site.refused(NOT_CALIBRATED, runs, "was moved", "are these one sensor? They are named mast 7, mast 8")


def test_how_frames_were_read_is_kept(site: Site) -> None:
    """Checks and monitors read others by it."""
    runs = [site.lay(0), site.lay(2)]
    path = site.root / "run0" / "calibration.json"
    document = json.loads(path.read_text(encoding="utf-8"))
    document["config"]["lidar"] = {"accumulate": 3}
    path.write_text(json.dumps(document))
    assert run(site.arguments([f"{one}/calibration.json" for one in runs]), site.root).code == 0
    made = site.document()
    assert made["config"]["lidar"] == {"accumulate": 3}
    assert made["config"]["method"] == "joint"


def test_damaged_evidence_is_refused(site: Site) -> None:
    runs = [site.lay(0), site.lay(1)]
    path = site.root / "run1" / "evidence.npz"
    path.write_bytes(path.read_bytes()[:-100])
    site.refused(UNUSABLE, runs, "run1/evidence.npz is damaged")
    path.unlink()
    site.refused(UNUSABLE, runs, "run1: no evidence.npz is with it")


def test_no_result_is_no_command(site: Site) -> None:
    refusal(run(["combine"], site.root), UNUSABLE, "RUN")
    with pytest.raises(EvidenceError, match="0 results"):
        combine([])


def test_from_python(site: Site) -> None:
    runs = [site.root / site.lay(number) for number in (0, 2)]
    result = combine(runs, CombineOptions(name="mast 9"))
    assert misplaced(result.calibration)[0] < 0.03
    assert result.job.provenance.name == "mast 9"
    assert "mast 9" in result.summary


def test_the_result_of_a_detector_is_kept_too(tmp_path: Path) -> None:
    made = traffic(100)
    detection_rows(made, track_ids=True).write(tmp_path / "detections.csv")
    cam_rows(made.messages).write(tmp_path / "cam.csv")
    found = match(tmp_path / "detections.csv", tmp_path / "cam.csv")
    found.save(tmp_path / "radar")
    again = combine([tmp_path / "radar"])
    assert again.calibration.T_utm_sensor == pytest.approx(found.calibration.T_utm_sensor, abs=1e-3)
    assert again.job.provenance.kind == "detections"


def test_every_result_is_read_and_belongs_to_its_evidence(site: Site) -> None:
    runs = [site.lay(0), site.lay(1)]
    second = site.root / "run1" / "calibration.json"
    second.write_bytes((site.root / "run0" / "calibration.json").read_bytes())
    site.refused(UNUSABLE, runs, "run1/calibration.json: places the sensor elsewhere than evidence.npz")
    second.write_text("{")
    site.refused(UNUSABLE, runs, "run1/calibration.json is no JSON")
