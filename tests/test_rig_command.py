from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result
from scipy.spatial.transform import Rotation

from laci_stereo.check.rig_images import Matched, RigCheck, check_rig, match_images, scaled
from laci_stereo.check.rig_turn import find_turn
from laci_stereo.commands.rig import rig as rig_command
from laci_stereo.core.frames import Raster
from laci_stereo.io.images import StereoPair
from laci_stereo.io.result.calibration_file import to_document, to_text
from laci_stereo.io.result.stored_calibration import read_calibration
from laci_stereo.io.rig.stereo_rig import StereoRig
from laci_stereo.run import Options, prepare
from laci_stereo.stereo.rectify import rectify
from laci_stereo.stereo.settings import StereoSettings
from tests.cli_support import DEMONSTRATION, refusal, run, run_installed
from tests.io.images import png_bomb
from tests.io.rig_writers import opencv_entries, ros, write_storage
from tests.report.page_support import PROVENANCE
from tests.report.support import calibration
from tests.stereo.render import Box, expose
from tests.stereo.rigs import RIGS
from tests.stereo.support import STATIC, exposed, views, write_pairs

KINDS = ("five", "askew", "fisheye", "mirrored askew")
AXES = {"x": "in pitch", "y": "in yaw", "z": "in roll"}
DRIVER = Box(13.0, -1.0, yaw_rad=0.2, seed=3, grey=110.0)
SPEED_M = 0.5
"""Of the moving box from one frame to the next."""


@lru_cache(maxsize=len(RIGS))
def images(name: str) -> tuple[Raster, Raster]:
    return exposed([views(name)], seed=1)[0]


def pairs(folder: Path, name: str) -> list[StereoPair]:
    return write_pairs(folder, [images(name)] * 2)


@pytest.fixture(scope="module")
def matched(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Matched]:
    @lru_cache(maxsize=len(RIGS))
    def matched_as(name: str) -> Matched:
        return match_images(pairs(tmp_path_factory.mktemp("pairs"), name))

    return matched_as


def check_rig_images(rig: StereoRig, found: Sequence[StereoPair]) -> RigCheck:
    return check_rig(rig, match_images(found))


def turned(rig: StereoRig, axis: str, degrees: float) -> StereoRig:
    """Return the rig whose right camera is turned about an axis of its own."""
    R = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return replace(rig, R_right_left=R @ rig.R_right_left, t_right_left_m=R @ rig.t_right_left_m)


def said(check: RigCheck) -> str:
    return "; ".join(finding.text for finding in check.findings)


@pytest.mark.parametrize(
    "name", [*KINDS[1:3], *(pytest.param(each, marks=pytest.mark.slow) for each in (KINDS[0], KINDS[3]))]
)
def test_the_right_calibration_passes(matched: Callable[[str], Matched], name: str) -> None:
    check = check_rig(RIGS[name], matched(name))
    assert (check.outcome, check.findings, check.skipped) == ("pass", (), ())
    assert check.fit is not None
    parallax = check.fit.parallax
    assert parallax is not None
    assert len(check.fit.points) > 500
    assert parallax.noise_px < 0.2
    assert (np.abs(parallax.turn.angles_rad) < 3 * parallax.turn.sigma_rad).all()


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("axis", AXES)
def test_a_camera_that_has_turned_is_found_and_named(matched: Callable[[str], Matched], name: str, axis: str) -> None:
    """The images are of a right camera that has rotated by +0.3 deg since it was calibrated."""
    check = check_rig(turned(RIGS[name], axis, -0.3), matched(name))
    assert check.outcome == ("warn" if axis == "y" else "fail")  # a yaw hardly moves rows
    assert check.fit is not None
    assert check.fit.parallax is not None
    turn = check.fit.parallax.turn
    expected = np.radians([0.3 if each == axis else 0.0 for each in AXES])
    assert (np.abs(turn.angles_rad - expected) < 3 * turn.sigma_rad).all()
    assert np.degrees(np.abs(turn.angles_rad - expected)).max() < 0.05
    if axis != "y":
        assert f"stale, or of another camera; the right camera has rotated by +0.30 deg {AXES[axis]}" in said(check)


@pytest.mark.parametrize("gain", [0.6, 1.3])
def test_cameras_that_expose_differently(tmp_path: Path, gain: float) -> None:
    rng = np.random.default_rng(5)
    left, right = (expose(view, rng, each) for view, each in zip(views("five"), (1.0, gain), strict=True))
    check = check_rig_images(RIGS["five"], write_pairs(tmp_path, [(left, right)]))
    assert check.outcome == "pass"
    assert check.fit is not None
    assert check.fit.parallax is not None
    assert check.fit.parallax.noise_px < 0.1
    assert len(check.fit.points) > 500


def test_a_large_turn_sideways_fails(matched: Callable[[str], Matched]) -> None:
    """It shifts disparities, by 360 px per radian, and in the corners rows."""
    check = check_rig(turned(RIGS["five"], "y", -1.0), matched("five"))
    assert check.outcome == "fail"
    assert "the right camera has yawed by +1.0" in said(check)


def test_points_beyond_infinity_are_named(matched: Callable[[str], Matched]) -> None:
    check = check_rig(turned(RIGS["ideal"], "y", -2.0), matched("ideal"))
    assert "points lie beyond infinity" in said(check)
    assert "swapped" not in said(check)


@pytest.mark.parametrize("name", ["askew", "fisheye"])
def test_a_swapped_pair_is_named(tmp_path: Path, name: str) -> None:
    swapped = [StereoPair(pair.stamp_ns, pair.right, pair.left) for pair in pairs(tmp_path, name)]
    check = check_rig_images(RIGS[name], swapped)
    assert check.outcome == "fail"
    assert check.findings[0].text.startswith("the images of left and right are swapped")


def test_images_upside_down_are_named(tmp_path: Path) -> None:
    """Rotated by 180 deg, what each camera sees shifts in the other direction, as with the cameras exchanged."""
    left, right = (np.ascontiguousarray(np.rot90(image, 2)) for image in images("ideal"))
    check = check_rig_images(RIGS["ideal"], write_pairs(tmp_path, [(left, right)] * 2))
    assert check.findings[0].text.startswith("the images of left and right are swapped, or all upside down")


def test_a_wrong_focal_length_is_no_turn(matched: Callable[[str], Matched]) -> None:
    rig = RIGS["five"]
    K = rig.right.K * [[1.03], [1.03], [1.0]]
    K[:2, 2] = rig.right.K[:2, 2]
    check = check_rig(replace(rig, right=replace(rig.right, K=K)), matched("five"))
    assert check.outcome == "fail"
    assert "no rotation of a camera explains it: focal lengths, lens distortion" in said(check)


def test_images_of_another_size_are_named(matched: Callable[[str], Matched]) -> None:
    found = matched("five")
    check = check_rig(scaled(RIGS["five"], 2.0), found)
    assert check.outcome == "fail"
    assert said(check).startswith("the images are 400 x 300 pixels, the calibration is for 800 x 600")
    assert said(check).endswith("were they scaled by 0.5?; scaled to them it fits")
    larger = replace(RIGS["five"], left=replace(RIGS["five"].left, size=(640, 360)))
    check = check_rig(larger, found)
    assert (check.outcome, check.fit) == ("fail", None)
    assert said(check).endswith("640 x 360: another camera's, or cropped")


def test_a_scaled_rig_sees_the_scaled_image() -> None:
    """Half an image is what a camera of half the pixels sees: the border stays where it is."""
    whole = RIGS["five"]
    half = scaled(whole, 0.5)
    direction = np.array([0.2, -0.1, 1.0])
    pixel, half_pixel = ((lens.K @ direction)[:2] for lens in (whole.left, half.left))
    np.testing.assert_allclose((pixel + 0.5) / whole.left.size, (half_pixel + 0.5) / half.left.size)


def test_images_that_are_rectified_already_are_named(tmp_path: Path) -> None:
    plane = rectify(RIGS["five"])
    left, right = images("five")
    flat = write_pairs(tmp_path, [(plane.left.look_up(left), plane.right.look_up(right))])
    check = check_rig_images(RIGS["five"], flat)
    assert check.outcome == "fail"
    assert "are the images rectified already? With --rectified the calibration fits" in said(check)


def texture(seed: int) -> Raster:
    rough = np.random.default_rng(seed).normal(size=(300, 400)).astype(np.float32)
    smooth = cv2.GaussianBlur(rough, (0, 0), 1.5)
    return np.clip(128 + 40 * smooth / smooth.std(), 0, 255).astype(np.uint8)


def test_different_scenes_are_named(tmp_path: Path) -> None:
    frames = [(images("five")[0], texture(seed)) for seed in range(3)]
    check = check_rig_images(RIGS["five"], write_pairs(tmp_path, frames))
    assert check.outcome == "fail"
    assert said(check).startswith("in 3 of 3 pairs the images have no more in common than chance")


def test_images_without_texture_are_not_judged(tmp_path: Path) -> None:
    blank = np.full((300, 400), 128, dtype=np.uint8)
    check = check_rig_images(RIGS["five"], write_pairs(tmp_path, [(blank, blank)] * 2))
    assert check.outcome == "fail"
    assert "nothing with texture" in said(check)


def test_a_scene_that_fills_a_corner_is_not_enough(tmp_path: Path) -> None:
    left, right = (image.copy() for image in images("five"))
    for image in (left, right):
        image[:200] = 128
        image[:, :270] = 128
    check = check_rig_images(RIGS["five"], write_pairs(tmp_path, [(left, right)]))
    assert check.outcome == "warn"
    assert "of 48 parts of the image; needed are 12 to judge" in said(check)


def drive(folder: Path, steps_later: float) -> list[StereoPair]:
    """Write pairs of a box that comes nearer, the right images taken some frames later."""
    frames = []
    for number in range(2):
        places = (number, number + steps_later)
        boxes = [replace(DRIVER, x=DRIVER.x - SPEED_M * place) for place in places]
        left, right = (views("five", box, STATIC)[side] for side, box in enumerate(boxes))
        frames.append((left, right))
    return write_pairs(folder, exposed(frames, seed=2))


@pytest.mark.parametrize("later", [0.0, 0.5, pytest.param(-0.5, marks=pytest.mark.slow)])
def test_how_much_later_the_right_images_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, later: float) -> None:
    """Frames are 0.1 s apart, so half a frame is 50 ms."""
    recorded = drive(tmp_path, later)
    found = match_images(recorded)
    monkeypatch.setattr("laci_stereo.check.rig_turn.match_images", lambda _: found)
    check = check_rig(RIGS["five"], found)
    assert check.fit is not None
    assert check.fit.lag is not None
    assert check.fit.lag.seconds == pytest.approx(0.1 * later, abs=3 * check.fit.lag.sigma_s)
    assert check.fit.lag.sigma_s < 0.01
    assert check.outcome == ("fail" if later else "pass")
    assert ("ms later than the left ones" in said(check)) == bool(later)
    assert "stale" not in said(check)
    turn = find_turn(RIGS["five"], recorded)
    assert ["ms later than the left ones" in failure for failure in turn.failures] == [True] * bool(later)
    assert turn.doubts == ()


def test_images_of_different_times_are_named(tmp_path: Path) -> None:
    """Nothing but the box moves, and it is elsewhere in the right images."""
    check = check_rig_images(RIGS["five"], drive(tmp_path, -20.0))
    assert check.outcome == "fail"
    assert "left and right are of different times" in said(check)


def invoke(*arguments: object) -> Result:
    return CliRunner().invoke(rig_command, [str(argument) for argument in arguments])


def test_the_command_shows_what_was_understood(tmp_path: Path) -> None:
    pairs(tmp_path, "five")
    left, right = ros(None)(tmp_path, RIGS["five"])
    folders = (tmp_path / "left", tmp_path / "right")
    picture, figures = tmp_path / "rig.png", tmp_path / "rig.json"
    ran = invoke(*folders, "--picture", picture, "--json", figures)
    assert ran.exit_code == 0, ran.output
    for words in (f"{left} + {right}", "ROS camera_info", "400 x 300", "0.5003 m", "Verdict    PASS", "deg"):
        assert words in ran.output
    seen = cv2.imread(str(picture))
    assert seen is not None
    assert seen.shape == (300, 800, 3)
    document = json.loads(figures.read_text())
    assert document["verdict"] == "pass"
    assert document["baseline_m"] == pytest.approx(RIGS["five"].baseline_m)
    assert invoke(left, right, *folders).output == ran.output.rpartition("Written")[0]
    assert "exists already" in str(invoke(*folders, "--picture", picture).exception)


def test_one_folder_given_twice_fails(tmp_path: Path) -> None:
    """The images of one camera are everywhere in their rows, by any calibration without a turn."""
    left, _ = images("five")
    check = check_rig_images(RIGS["five"], write_pairs(tmp_path, [(left, left)] * 2))
    assert check.outcome == "fail"
    assert "left and right are the same images" in said(check)


def test_two_outputs_under_one_name_are_refused(tmp_path: Path) -> None:
    pairs(tmp_path, "five")
    out = tmp_path / "rig.png"
    ran = invoke(tmp_path / "left", tmp_path / "right", "--picture", out, "--json", out)
    assert "rig.png: is asked for twice" in str(ran.exception)
    assert not out.exists()


def test_the_command_fails_with_what_does_not_fit(tmp_path: Path) -> None:
    pairs(tmp_path, "five")
    path = write_storage(tmp_path / "old.yaml", opencv_entries(turned(RIGS["five"], "x", -0.3)))
    ran = invoke(path, tmp_path / "left", tmp_path / "right")
    assert ran.exit_code == 1
    assert "Verdict    FAIL" in ran.output


def test_images_without_times_are_paired_by_name(tmp_path: Path) -> None:
    for side, image in zip(("left", "right"), images("five"), strict=True):
        (tmp_path / side).mkdir()
        assert cv2.imwrite(str(tmp_path / side / "scene_a.png"), image)
    write_storage(tmp_path / "stereo.yaml", opencv_entries(RIGS["five"]))
    assert invoke(tmp_path / "left", tmp_path / "right").exit_code == 0


def test_images_that_are_missing_are_asked_for(tmp_path: Path) -> None:
    pairs(tmp_path, "five")
    path = write_storage(tmp_path / "stereo.yaml", opencv_entries(RIGS["five"]))
    for given in ([], [path], [path, tmp_path / "left"], [tmp_path / "left"], [path, path]):
        ended = run(arguments(*given), tmp_path)
        refusal(ended, 2, "LEFT and RIGHT, two folders of images")


def test_an_image_folder_inside_the_one_given_is_named(tmp_path: Path) -> None:
    pairs(tmp_path / "image_02", "five")
    path = write_storage(tmp_path / "stereo.yaml", opencv_entries(RIGS["five"]))
    ended = run(arguments(path, tmp_path / "image_02", tmp_path / "image_02/right"), tmp_path)
    refusal(ended, 2, "but no image", f"as in {tmp_path / 'image_02/left'}")


def test_images_of_another_size_are_told_both_sizes_of_the_calibration(matched: Callable[[str], Matched]) -> None:
    rig = RIGS["five"]
    rectified = replace(rig, left=replace(rig.left, size=(360, 270)))
    other = replace(rig, left=replace(rig.left, size=(400, 200)), rectified=rectified)
    assert "the calibration is for 400 x 200, rectified for 360 x 270" in said(check_rig(other, matched("five")))


def arguments(*given: object) -> Sequence[str]:
    return ["rig", *map(str, given)]


def test_what_cannot_be_read_is_one_line(tmp_path: Path) -> None:
    pairs(tmp_path, "five")
    entries = opencv_entries(RIGS["five"])
    entries["T"] = 1000.0 * RIGS["five"].t_right_left_m
    path = write_storage(tmp_path / "stereo.yaml", entries)
    ran = run_installed(arguments(path, tmp_path / "left", tmp_path / "right"), tmp_path)
    refusal(ran, 2, "stereo.yaml", "is 500.325 m", "millimetres")


def test_the_baseline_answers_what_unit_lengths_have(tmp_path: Path) -> None:
    """What is said of the rig, its fit and what is computed from it are those of the file in metres."""
    pairs(tmp_path, "five")
    folders = (tmp_path / "left", tmp_path / "right")
    true = RIGS["five"]
    metres = write_storage(tmp_path / "metres.yaml", opencv_entries(true))
    squares = write_storage(tmp_path / "squares.yaml", {**opencv_entries(true), "T": true.t_right_left_m / 0.0317})
    plain, told = tmp_path / "plain.json", tmp_path / "told.json"
    assert invoke(metres, *folders, "--json", plain).exit_code == 0
    ran = invoke(squares, *folders, "--json", told, "--baseline", true.baseline_m)
    assert ran.exit_code == 0, ran.output
    assert "Note       baseline 0.500325 m, as --baseline says; T, read as metres, has 15.7831 m" in ran.output
    found, wanted = (json.loads(path.read_text()) for path in (told, plain))
    assert found["t_right_left_m"] == pytest.approx(wanted["t_right_left_m"], abs=1e-12)
    assert found["fit"]["depth_sigma_m"] == pytest.approx(wanted["fit"]["depth_sigma_m"])


@pytest.mark.parametrize("baseline", ["0.01", "11", "nan", "-0.5", "two"])
def test_a_baseline_that_no_rig_has_is_one_line(tmp_path: Path, baseline: str) -> None:
    pairs(tmp_path, "five")
    write_storage(tmp_path / "stereo.yaml", opencv_entries(RIGS["five"]))
    refusal(run(arguments(tmp_path / "left", tmp_path / "right", "--baseline", baseline), tmp_path), 2, "--baseline")


@pytest.mark.slow
def test_a_result_keeps_the_baseline_that_was_told(tmp_path: Path) -> None:
    """So that a check or a monitor of it reads the same stereo calibration alike."""
    folders = [DEMONSTRATION / name for name in ("left", "right", "cam.csv")]
    rig = prepare(*folders).recording.rig
    squares = write_storage(tmp_path / "squares.yaml", {**opencv_entries(rig), "T": rig.t_right_left_m / 0.0317})
    job = prepare(*folders, Options(stereo=squares, camera=StereoSettings(baseline_m=rig.baseline_m)))
    assert job.recording.rectification.baseline_m == pytest.approx(rig.baseline_m, abs=1e-12)
    assert job.provenance.config["stereo"]["baseline_m"] == rig.baseline_m
    assert any("as --baseline says" in note for note in job.provenance.notes)
    provenance = replace(PROVENANCE, config=job.provenance.config)
    (tmp_path / "calibration.json").write_text(to_text(to_document(calibration(), provenance)))
    assert read_calibration(tmp_path).baseline_m == rig.baseline_m


@pytest.mark.slow
def test_a_calibration_of_two_files_is_calibrated_with(tmp_path: Path) -> None:
    """The demonstration's rig, written as ROS does, gives the same plane, and the result says what it is from."""
    left, right, cam = (DEMONSTRATION / name for name in ("left", "right", "cam.csv"))
    plain = prepare(left, right, cam)
    files = ros(None)(tmp_path, plain.recording.rig)
    job = prepare(left, right, cam, Options(stereo=files))
    for name in ("focal_px", "baseline_m"):
        assert getattr(job.recording.rectification, name) == pytest.approx(getattr(plain.recording.rectification, name))
    np.testing.assert_allclose(job.recording.rectification.rays, plain.recording.rectification.rays, atol=1e-9)
    assert {str(path) for path in files} < job.provenance.inputs.keys()
    assert any(note.startswith("stereo calibration: ROS camera_info") for note in job.provenance.notes)


def test_images_that_promise_gigabytes_are_one_line(tmp_path: Path) -> None:
    found = pairs(tmp_path, "five")
    write_storage(tmp_path / "stereo.yaml", opencv_entries(RIGS["five"]))
    for each in found:
        each.left.write_bytes(png_bomb(40_000, 20_000))
    ran = run(arguments(tmp_path / "left", tmp_path / "right"), tmp_path)
    refusal(ran, 2, "has 40000 x 20000 pixels; needed are at most 100 megapixels")


def test_a_pair_before_a_damaged_image_is_used(tmp_path: Path) -> None:
    found = pairs(tmp_path, "five")
    os.truncate(found[1].left, 500)
    matched = match_images(found)
    assert len(matched.matches) == 1
    assert len(matched.matches[0]) > 500
    assert [str(found[1].left) in reason for reason in matched.skipped] == [True]
    assert check_rig(RIGS["five"], matched).outcome == "pass"


def test_a_damaged_first_image_is_skipped(tmp_path: Path) -> None:
    found = pairs(tmp_path, "five")
    found[0].left.write_bytes(b"no image")
    write_storage(tmp_path / "stereo.yaml", opencv_entries(RIGS["five"]))
    ran = invoke(tmp_path / "left", tmp_path / "right")
    assert ran.exit_code == 0
    assert f"Skipped    {found[0].left} cannot be decoded" in ran.output


@pytest.mark.parametrize(("rectified", "frame"), [(False, "raw left camera"), (True, "rectified left camera")])
def test_a_result_says_which_images_its_frame_is_of(recording: Path, rectified: bool, frame: str) -> None:
    """Results of both lie a turn apart, so none may be compared or combined with the other kind."""
    folders = [recording / name for name in ("left", "right", "cam.csv")]
    job = prepare(*folders, Options(camera=StereoSettings(rectified=rectified)))
    assert job.provenance.frame.startswith(frame)
