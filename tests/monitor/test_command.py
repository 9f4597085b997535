"""The monitor as a user runs it: files, exit codes, signals, folders that grow."""

from __future__ import annotations

import json
import shutil
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import pytest

from laci_stereo.monitor.frames import STILL_S, Arrivals
from tests.cli_support import Ran, Site, refusal, run, running, snapshot
from tests.mask import graphs

FILES = {"histogram.png", "monitor.json", "objects.csv", "objects.json", "state.json"}
LAPS = 8
LAP_NS = 12_000_000_000


@dataclass(frozen=True)
class Calibrated:
    """A small recording and its calibration."""

    site: Site

    def arguments(self, out: Path, *options: str | Path, left: Path | None = None) -> list[str]:
        left = left or self.site.left
        right = left.parent / "right"
        stereo, lane_map = ("--stereo", self.site.stereo), ("--map", self.site.root / "map.osm")
        return [str(one) for one in ("monitor", self.site.out, left, right, "--out", out, *stereo, *lane_map, *options)]

    def monitor(self, out: Path, *options: str | Path, left: Path | None = None) -> Ran:
        return run(self.arguments(out, *options, left=left), self.site.root)


@pytest.fixture(scope="module")
def calibrated(calibrated_site: tuple[Site, str]) -> Calibrated:
    return Calibrated(calibrated_site[0])


def document(out: Path) -> dict[str, Any]:
    read: dict[str, Any] = json.loads((out / "monitor.json").read_text())
    return read


def contents(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in out.iterdir()}


def test_recording_is_counted_once_and_no_other_goes_on_from_it(calibrated: Calibrated, tmp_path: Path) -> None:
    out = tmp_path / "monitor"
    ran = calibrated.monitor(out)
    assert ran.code == 0, ran
    assert {path.name for path in out.iterdir()} == FILES
    figures = document(out)
    assert figures["passages"] == 1
    assert figures["recording"]["frames"] == len(list(calibrated.site.left.iterdir()))
    assert figures["off_road_share"] == pytest.approx(0.0, abs=0.02)
    assert figures["reference"] == "lanes"
    # The car comes on one lane, turns left, and leaves on another.
    assert {lane["id"] for lane in figures["lanes"]} <= {"273", "411"}
    assert all(lane["passages_against"] == 0 for lane in figures["lanes"])
    assert all(abs(lane["offset_left_m"]) < 0.6 for lane in figures["lanes"])
    assert sum(count for *_, count in figures["histogram"]["cells"]) == figures["positions"]
    assert cv2.imread(str(out / "histogram.png")).shape == (1000, 1600, 3)
    assert "1 passage" in ran.out
    assert 5 <= len(ran.out.splitlines()) <= 12
    before = contents(out)
    again = calibrated.monitor(out)
    assert (again.code, again.out) == (0, ran.out)
    assert "goes on after frame" in again.err
    assert contents(out) == before
    state = json.loads((out / "state.json").read_text())
    state["identity"]["calibration"] = "0" * 64
    (out / "state.json").write_text(json.dumps(state))
    refusal(calibrated.monitor(out), 2, "state.json", "calibration is 0000", "--overwrite")
    refusal(calibrated.monitor(out, "--overwrite", left=tmp_path / "none"), 2, "none", "does not exist")
    assert (out / "objects.csv").read_bytes() == before["objects.csv"]


def test_folder_with_something_else_is_left_alone(calibrated: Calibrated, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    refusal(calibrated.monitor(tmp_path, "--overwrite"), 2, "mine.txt", "no part of a monitor")
    refusal(calibrated.monitor(tmp_path / "out", "--idle", "3"), 2, "--idle", "--follow")
    assert snapshot(tmp_path).keys() == {"mine.txt"}


def test_what_ends_before_a_checkpoint_leaves_nothing(calibrated: Calibrated, tmp_path: Path) -> None:
    """Left and right swapped is found out when the first frames are matched."""
    for side, other in (("left", "right"), ("right", "left")):
        (tmp_path / side).symlink_to(calibrated.site.root / other)
    before = snapshot(tmp_path)
    refusal(calibrated.monitor(tmp_path / "out", left=tmp_path / "left"), 2, "are the folders swapped")
    assert snapshot(tmp_path) == before
    (tmp_path / "mine").mkdir()
    refusal(calibrated.monitor(tmp_path / "mine", left=tmp_path / "left"), 2, "are the folders swapped")
    assert list((tmp_path / "mine").iterdir()) == []


def test_a_pause_that_is_no_number_is_refused(calibrated: Calibrated, tmp_path: Path) -> None:
    refusal(calibrated.monitor(tmp_path / "out", "--follow", "--idle", "nan"), 2, "--idle", "nan is not a number")


@pytest.mark.slow
def test_another_contract_of_the_mask_is_another_monitor(calibrated: Calibrated, tmp_path: Path) -> None:
    model = graphs.save(graphs.yolov8_raw(), tmp_path, {"kind": "yolov8_raw", "vehicle_ids": [1]})
    out = tmp_path / "out"
    assert calibrated.monitor(out, "-q", "--vehicle-mask", model).code == 0
    assert calibrated.monitor(out, "-q", "--vehicle-mask", model).code == 0
    contract = {"kind": "yolov8_raw", "vehicle_ids": [0]}
    model.with_suffix(".contract.json").write_text(json.dumps(contract))
    refusal(calibrated.monitor(out, "-q", "--vehicle-mask", model), 2, "the checkpoint's mask contract is")


def repeated(site: Site, root: Path, laps: int) -> Path:
    """Lay the recording out several times, one lap after the other."""
    for side in (site.left, site.right):
        (root / side.name).mkdir()
        for lap in range(laps):
            for path in side.iterdir():
                (root / side.name / f"{int(path.stem) + lap * LAP_NS}{path.suffix}").symlink_to(path)
    return root / "left"


@pytest.mark.slow
def test_killed_for_good_it_ends_the_same(calibrated: Calibrated, tmp_path: Path) -> None:
    left = repeated(calibrated.site, tmp_path, LAPS)
    assert calibrated.monitor(tmp_path / "whole", "-q", left=left).code == 0
    out = tmp_path / "killed"
    for seconds in (0.3, 4.0, 6.0, 8.0):
        with running(calibrated.arguments(out, "-q", left=left), calibrated.site.root) as process:
            time.sleep(seconds)
            process.send_signal(signal.SIGKILL)
            process.wait()
    assert calibrated.monitor(out, "-q", left=left).code == 0
    assert contents(out) == contents(tmp_path / "whole")
    assert document(out)["passages"] == LAPS


@pytest.mark.slow
def test_folder_that_grows_is_followed(calibrated: Calibrated, tmp_path: Path) -> None:
    site, out = calibrated.site, tmp_path / "monitor"
    names = sorted(path.name for path in site.left.iterdir())
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
    with running(calibrated.arguments(out, "--follow", "--idle", "3", left=tmp_path / "left"), site.root) as process:
        for name in names[:-1]:
            for side in ("left", "right"):
                shutil.copy(site.root / side / name, tmp_path / side / name)
        whole = (site.left / names[-1]).read_bytes()
        shutil.copy(site.right / names[-1], tmp_path / "right" / names[-1])
        with (tmp_path / "left" / names[-1]).open("wb") as stream:
            for part in range(4):  # is still being written for longer than it takes to look twice
                stream.write(whole[part * len(whole) // 4 : (part + 1) * len(whole) // 4])
                stream.flush()
                time.sleep(0.7 * STILL_S)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 0, said
    figures = document(out)
    assert figures["recording"]["frames"] == len(names)
    assert figures["recording"]["unusable_frames"] == 0
    # The same as if all had been there from the start.
    assert calibrated.monitor(tmp_path / "at_once", "-q").code == 0
    assert (out / "objects.csv").read_bytes() == (tmp_path / "at_once" / "objects.csv").read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_signal_ends_following_with_outputs(calibrated: Calibrated, tmp_path: Path, name: str) -> None:
    out = tmp_path / "monitor"
    with running(calibrated.arguments(out, "--follow"), calibrated.site.root) as process:
        assert process.stderr is not None
        assert "frames so far" in process.stderr.readline()
        process.send_signal(getattr(signal, name))
        _, said = process.communicate(timeout=60)
    assert process.returncode == 0, said
    assert {path.name for path in out.iterdir()} == FILES


def wait_for(path: Path) -> None:
    for _ in range(6000):
        if path.exists():
            return
        time.sleep(0.01)
    raise AssertionError(f"{path} was not written in a minute")


@pytest.mark.slow
def test_interrupted_before_a_checkpoint_it_leaves_nothing(calibrated: Calibrated, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with running(calibrated.arguments(out), calibrated.site.root) as process:
        wait_for(out / "objects.csv")
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert "interrupted; nothing was written" in said
    assert not out.exists()


@pytest.mark.slow
def test_interrupted_it_says_how_to_go_on(calibrated: Calibrated, tmp_path: Path) -> None:
    left, out = repeated(calibrated.site, tmp_path, LAPS), tmp_path / "out"
    with running(calibrated.arguments(out, left=left), calibrated.site.root) as process:
        wait_for(out / "state.json")
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "the same command goes on from there" in said


def test_only_files_that_are_still_are_whole(tmp_path: Path) -> None:
    arrivals, frames = Arrivals(), [(tmp_path / f"{i}.png", tmp_path / f"{i}.right.png") for i in range(3)]
    for files in frames:
        for file in files:
            file.write_bytes(b"12")
    assert arrivals.whole(frames, 10.0) == 0
    assert arrivals.whole(frames, 10.0 + STILL_S / 2) == 0
    frames[1][1].write_bytes(b"123")
    # Those behind a file that grows wait with it, for frames go in order.
    assert arrivals.whole(frames, 10.0 + STILL_S) == 1
    assert arrivals.whole(frames[1:], 10.0 + 1.5 * STILL_S) == 0
    assert arrivals.whole(frames[1:], 10.0 + 2 * STILL_S) == 2
    frames[2][0].unlink()
    assert Arrivals().whole(frames[2:], 20.0) == 0
