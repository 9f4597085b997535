"""A right camera that has turned since it was calibrated: rows tell it, and it is taken back."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from laci_stereo.check.rig_images import Matched, fit_of, match_images
from laci_stereo.check.rig_turn import LEAST_PX, RightTurn, find_turn
from laci_stereo.core.errors import RigError
from laci_stereo.core.frames import invert, transform
from laci_stereo.core.settings import GroundSettings, JointSettings, Settings
from laci_stereo.io.images import StereoPair
from laci_stereo.io.result.calibration_file import to_document, to_text
from laci_stereo.io.result.stored_calibration import read_calibration
from laci_stereo.io.rig.stereo_rig import StereoRig
from laci_stereo.run import Options, prepare
from laci_stereo.stereo.rectify import rectify, with_right_turned
from laci_stereo.stereo.settings import StereoSettings
from tests.cli_support import DEMONSTRATION, run
from tests.io.rig_writers import opencv_entries, write_storage
from tests.report.page_support import PROVENANCE
from tests.report.support import calibration
from tests.stereo.rigs import RIGS
from tests.stereo.support import exposed, swapped, views, write_pairs

KINDS = ("five", "askew", "fisheye", "mirrored askew")
LARGE, SMALL = (0.3, 0.0, -0.2), (0.03, 0.0, -0.02)
"""Turns in degrees: rows are off by two pixels, and by 0.2."""

Recorded = Callable[[str], Sequence[StereoPair]]


@cache
def matched(pairs: tuple[StereoPair, ...]) -> Matched:
    return match_images(pairs)


@pytest.fixture(autouse=True, scope="module")
def matched_once() -> Iterator[None]:
    """Images are matched once for all the calibrations that they are held against."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("laci_stereo.check.rig_turn.match_images", lambda pairs: matched(tuple(pairs)))
        yield


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    @lru_cache(maxsize=len(KINDS))
    def pairs(name: str) -> Sequence[StereoPair]:
        return write_pairs(tmp_path_factory.mktemp("pairs"), exposed([views(name)], seed=1) * 2)

    return pairs


def stale(rig: StereoRig, turn_deg: tuple[float, float, float]) -> StereoRig:
    """Return the rig as it was calibrated before its right camera turned to where it is."""
    back = Rotation.from_rotvec(turn_deg, degrees=True).inv().as_matrix()
    return replace(rig, R_right_left=back @ rig.R_right_left, t_right_left_m=back @ rig.t_right_left_m)


def write(path: Path, rig: StereoRig) -> Path:
    return write_storage(path, opencv_entries(rig))


@pytest.mark.parametrize("turn_deg", [LARGE, SMALL])
@pytest.mark.parametrize("name", KINDS)
def test_a_turn_is_found_and_taken_back(recorded: Recorded, name: str, turn_deg: tuple[float, float, float]) -> None:
    rig, pairs = stale(RIGS[name], turn_deg), recorded(name)
    found = find_turn(rig, pairs)
    assert found.turn_deg is not None
    assert np.abs(np.subtract(found.turn_deg, turn_deg)).max() < 0.01
    after = fit_of(with_right_turned(rig, found.turn_deg), matched(tuple(pairs)).matches)
    assert after.shown is not None
    assert after.shown.rows_turn.effect_px < LEAST_PX
    said, unsaid = (found.doubts, found.notes) if turn_deg == LARGE else (found.notes, found.doubts)
    assert [len(said), len(unsaid)] == [1, 0]
    assert ("a yaw of the same size, which only the drive can show," in said[0]) == (turn_deg == LARGE)


@pytest.mark.parametrize("name", KINDS)
def test_a_calibration_that_fits_is_left_as_it_is(recorded: Recorded, name: str) -> None:
    assert find_turn(RIGS[name], recorded(name)) == RightTurn()


def test_what_no_turn_explains_is_a_doubt(recorded: Recorded) -> None:
    rig = RIGS["five"]
    longer = replace(rig, right=replace(rig.right, K=rig.right.K * [[1.03, 1.0, 1.0], [1.0, 1.03, 1.0], [1.0] * 3]))
    doubts = find_turn(longer, recorded("five")).doubts
    assert any("no rotation of a camera explains it" in doubt for doubt in doubts), doubts


@pytest.mark.parametrize("name", ["askew", "fisheye"])
def test_a_swapped_pair_is_refused(recorded: Recorded, name: str) -> None:
    exchanged = [StereoPair(pair.stamp_ns, pair.right, pair.left) for pair in recorded(name)]
    with pytest.raises(RigError, match="the images of left and right are swapped"):
        find_turn(RIGS[name], exchanged)


def test_images_that_are_rectified_already_are_refused(tmp_path: Path) -> None:
    plane = rectify(RIGS["five"])
    (left, right), *_ = exposed([views("five")], seed=1)
    flat = write_pairs(tmp_path, [(plane.left.look_up(left), plane.right.look_up(right))] * 2)
    with pytest.raises(RigError, match="With --rectified the calibration fits"):
        find_turn(RIGS["five"], flat)


def test_images_that_show_nothing_tell_nothing(tmp_path: Path) -> None:
    grey = np.full((360, 480), 128, dtype=np.uint8)
    assert find_turn(RIGS["five"], write_pairs(tmp_path, [(grey, grey)] * 2)) == RightTurn()


def test_where_nothing_has_turned_settings_are_as_asked(recording: Path) -> None:
    joint, ground = JointSettings(bias_noise_share=0.7), GroundSettings(shared_noise_share=0.4)
    asked = Options(core=Settings(joint=joint, ground=ground))
    config = prepare(*(recording / name for name in ("left", "right", "cam.csv")), asked).provenance.config
    assert config == asked.config()


@pytest.mark.slow
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_stale_calibration_gives_what_the_right_one_does(tmp_path: Path, mirrored: bool) -> None:
    """Rows tell two of its angles, the drive the third; the result keeps them, so that a monitor of it sees alike."""
    left, right, cam = (DEMONSTRATION / name for name in ("left", "right", "cam.csv"))
    rig = prepare(left, right, cam).recording.rig
    if mirrored:
        left, right, rig = right, left, swapped(rig)
    fresh = prepare(left, right, cam, Options(stereo=write(tmp_path / "fresh.yaml", rig)))
    assert fresh.recording.rectification.mirrored == mirrored
    turn_deg = (0.05, 0.03, 0.02)
    job = prepare(left, right, cam, Options(stereo=write(tmp_path / "stale.yaml", stale(rig, turn_deg))))
    one, result = fresh.run().calibration, job.run()
    other, provenance = result.calibration, result.job.provenance
    middles = np.array([[*sighting.middle, 0.0] for sighting in one.drive.track.sightings])
    on_road = transform(one.T_utm_sensor @ invert(one.T_level_sensor), middles)
    off_m = np.linalg.norm(transform(other.T_utm_sensor @ invert(one.T_utm_sensor), on_road) - on_road, axis=1)
    assert np.sqrt((off_m**2).mean()) < 3.0 * other.quality.track_xy_sigma_m
    assert other.quality.track_xy_sigma_m < 2.0 * one.quality.track_xy_sigma_m
    assert other.quality.verdict == "warn"
    assert any("the right camera has pitched by +0.0" in reason for reason in other.quality.reasons)
    assert any("by the drive, the right camera has yawed by +0.0" in note for note in provenance.notes)
    kept = replace(PROVENANCE, config=provenance.config)
    (tmp_path / "calibration.json").write_text(to_text(to_document(calibration(), kept)))
    found_deg = read_calibration(tmp_path).turn_deg
    assert found_deg is not None
    assert found_deg[::2] == pytest.approx(turn_deg[::2], abs=0.002)
    assert found_deg[1] == pytest.approx(turn_deg[1], abs=0.02)
    assert Options(camera=StereoSettings(turn_deg=found_deg)).config()["stereo"] == provenance.config["stereo"]


@pytest.mark.slow
def test_what_only_the_drive_tells_of_a_turn_is_printed_once(tmp_path: Path) -> None:
    left, right, cam = (DEMONSTRATION / name for name in ("left", "right", "cam.csv"))
    rig = prepare(left, right, cam).recording.rig
    stereo = write(tmp_path / "stale.yaml", stale(rig, (0.05, 0.03, 0.02)))
    ran = run([*map(str, ("calibrate", left, right, cam, "--stereo", stereo, "--out", tmp_path / "out"))], tmp_path)
    notes = [line for line in ran.err.splitlines() if line.startswith("note: ")]
    assert any("by the drive, the right camera has yawed" in note for note in notes)
    assert len(set(notes)) == len(notes)
