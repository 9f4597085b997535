"""The installed command from outside: what it refuses and how, what it leaves behind, what it prints and writes."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from jsonschema import Draft202012Validator

import laci_stereo
from laci_stereo.core.frames import FloatArray
from laci_stereo.run import Options, prepare
from laci_stereo.stereo.settings import StereoSettings
from tests.cli_support import (
    DEMONSTRATION,
    SMALL_LIMIT,
    Finished,
    Site,
    document_in,
    link_recording,
    refusal,
    refused,
    rewrite,
    run,
    run_installed,
    running,
    snapshot,
)

NOT_CALIBRATED, UNUSABLE, INTERRUPTED = 1, 2, 130
ETSI_EPOCH_S = 1_072_915_200

Damage = Callable[[Site], None]

posix = pytest.mark.skipif(os.name != "posix", reason="needs POSIX signals, terminals and file systems")


def images(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.jpg"))


def cut(path: Path) -> None:
    """Cut an image off, as a full disk or a lost connection does."""
    rewrite(path, path.read_bytes()[:5000])


def rows_of(path: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(path.read_text(encoding="utf-8"))))


def write_rows(path: Path, rows: list[dict[str, str]]) -> None:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    rewrite(path, text.getvalue().encode())


# ------------------------------------------------------------------------------------- folders of images


def no_left(site: Site) -> None:
    shutil.rmtree(site.left)


def empty_right(site: Site) -> None:
    shutil.rmtree(site.right)
    site.right.mkdir()


def left_is_a_file(site: Site) -> None:
    shutil.rmtree(site.left)
    site.left.write_bytes(b"no folder")


def other_times(site: Site) -> None:
    for path in images(site.right):
        path.rename(path.with_name(f"{int(path.stem) + 100 * 10**9}.jpg"))


def few_on_the_right(site: Site) -> None:
    for path in images(site.right)[5:]:
        path.unlink()


def frame_numbers(site: Site) -> None:
    for number, path in enumerate(images(site.left)):
        path.rename(path.with_name(f"{number:06d}.jpg"))


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (no_left, ("left does not exist", "needed is a folder of images")),
        (empty_right, ("right is empty", "needed are images")),
        (left_is_a_file, ("left is a file", "needed is a folder of images")),
        (other_times, ("left", "right", "0 pairs", "needed are at least half", "difference 100.0 s")),
        (few_on_the_right, ("left (24 images)", "right (5 images)", "5 pairs", "needed are at least half")),
        (frame_numbers, ("left", "'000000.jpg'", "frame numbers", "timestamps.txt")),
    ],
)
def test_folders_that_are_no_stereo_recording_are_refused(site: Site, damage: Damage, words: tuple[str, ...]) -> None:
    damage(site)
    site.refused(UNUSABLE, *words)


@pytest.mark.slow
@pytest.mark.parametrize(("later_ms", "told", "doubted"), [(0.9, False, False), (4, True, False), (30, True, True)])
def test_exposures_that_are_apart_are_told(site: Site, later_ms: float, told: bool, doubted: bool) -> None:
    """By their times; the images are of one moment, which the drive tells."""
    for path in images(site.right):
        path.rename(path.with_name(f"{int(path.stem) + round(later_ms * 1e6)}.jpg"))
    ran = site.run(*SMALL_LIMIT)
    assert ran.code == 0, ran
    words = f"left and right images are {later_ms:.1f} ms apart by their times (median; {later_ms:.1f} ms at most)"
    document = document_in(site.out)
    assert (words in ran.err) == told
    assert any(note.startswith(words) for note in document["notes"]) == told
    assert document["config"]["joint"]["apart_sigma_s"] == pytest.approx(later_ms / 1e3)
    estimate = r"by the drive, the right images are (\d\.\d) \+- (\d\.\d) ms (later|earlier) than the left ones"
    (by_drive,) = (found for note in document["notes"] if (found := re.match(estimate, note)))
    assert float(by_drive[1]) <= 3.0 * float(by_drive[2])
    assert document["quality"]["verdict"] == ("warn" if doubted else "pass")
    assert any(reason.startswith(words) for reason in document["quality"]["reasons"]) == doubted
    found = np.array(document["T_utm_sensor"])
    truth = np.array(json.loads((DEMONSTRATION / "truth.json").read_text())["stereo"]["T_world_camera_utm"])
    assert np.linalg.norm((found - truth)[:2, 3]) < 0.3


def half_missing(rng: np.random.Generator) -> FloatArray:
    return np.sort(rng.choice(0.2 * np.arange(94), 47, replace=False))


def every_fourth_missing(_: np.random.Generator) -> FloatArray:
    return 0.2 * (np.arange(47) + np.arange(47) // 3)


def released_irregularly(rng: np.random.Generator) -> FloatArray:
    return np.cumsum(rng.uniform(0.1, 0.3, 47))


def late_by(late_s: float, rng: np.random.Generator) -> FloatArray:
    return np.sort(0.2 * np.arange(47) + rng.exponential(late_s, 47))


@pytest.mark.parametrize(
    ("moments", "late_ms", "doubted"),
    [
        (half_missing, None, False),
        (every_fourth_missing, None, False),
        (released_irregularly, None, False),
        (partial(late_by, 0.002), None, False),
        (partial(late_by, 0.02), 20.0, False),
        (partial(late_by, 0.06), 60.0, True),
    ],
)
def test_times_of_arrival_are_told(
    tmp_path: Path, moments: Callable[[np.random.Generator], FloatArray], late_ms: float | None, doubted: bool
) -> None:
    """A camera that is released irregularly, or whose images are lost, has right times all the same."""
    link_recording(DEMONSTRATION, tmp_path)
    stamps_ns = 1_760_000_002_200_000_000 + np.rint(1e9 * moments(np.random.default_rng(7))).astype(np.int64)
    for folder in ("left", "right"):
        for path, stamp_ns in zip(images(tmp_path / folder), stamps_ns, strict=True):
            path.rename(path.with_name(f"new_{stamp_ns}.jpg"))
    camera = StereoSettings(turn_deg=(0.0, 0.0, 0.0))
    job = prepare(tmp_path / "left", tmp_path / "right", tmp_path / "cam.csv", Options(camera=camera))
    notes = [re.match(r"the images' times err by (\d+) ms", note) for note in job.provenance.notes]
    found = [float(words[1]) for words in notes if words]
    assert found == pytest.approx([] if late_ms is None else [late_ms], rel=0.4)
    assert bool(job.doubts) == doubted


def test_height_that_the_ground_contradicts_is_named(site: Site) -> None:
    words = (
        "not calibrated: ",
        "13.3333 to 26.6667 m below the sensor",
        "--height is 20 m, which is taken give or take",
    )
    site.refused(NOT_CALIBRATED, *words, options=("--height", "20", "--quiet"))


@pytest.mark.parametrize(("place", "name"), [(1, "x" * 300), (3, "cam.csv/deeper")])
def test_paths_that_no_file_can_have_are_refused(site: Site, place: int, name: str) -> None:
    arguments = site.arguments()
    arguments[place] = name
    refused(lambda: run(arguments, site.root), site.root, UNUSABLE, name, "needed is a")


# ------------------------------------------------------------------------------------- stereo calibration


def stereo_text(old: str, new: str) -> Damage:
    def damage(site: Site) -> None:
        site.replace_text(site.stereo, old, new)

    return damage


def stereo_content(content: bytes) -> Damage:
    def damage(site: Site) -> None:
        rewrite(site.stereo, content)

    return damage


def no_stereo(site: Site) -> None:
    site.stereo.unlink()


K1 = "K1: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ 550., 0., 319.5, 0., 550., 179.5, 0., 0., 1. ]"
IDENTITY = "[ 1., 0., 0., 0., 1., 0., 0., 0., 1. ]"
BASELINE = "[ -0.59999999999999998, 0., 0. ]"


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        pytest.param(no_stereo, ("no stereo.yaml", "needed is one", "--stereo FILE"), id="missing"),
        pytest.param(stereo_content(b""), ("stereo.yaml is empty", "needed"), id="empty"),
        pytest.param(
            stereo_text("K1:", "Q:"), ("lacks the camera matrix of the left camera", "needed is one of K1"), id="no K1"
        ),
        pytest.param(stereo_text("T:", "Q:"), ("lacks the translation between the cameras", "it holds"), id="no T"),
        pytest.param(
            stereo_text(K1, K1.replace("0., 550., 179.5", "0., 0., 179.5")),
            ("left camera's focal length is 550, 0 pixels", "needed are positive"),
            id="singular K1",
        ),
        pytest.param(
            stereo_text(IDENTITY, "[ 1., 0., 0., 0., 1., 0., 0., 0., 0. ]"),
            ("R is no rotation", "det R is 0", "needed is an orthogonal matrix with determinant 1"),
            id="singular R",
        ),
        pytest.param(
            stereo_text(BASELINE, "[ -600., 0., 0. ]"), ("baseline", "is 600 m", "0.02 to 10 m", "millimetres"), id="mm"
        ),
        pytest.param(stereo_text(BASELINE, "[ 0., 0., 0. ]"), ("baseline", "is 0 m", "0.02 to 10 m"), id="no baseline"),
        pytest.param(
            stereo_text("image_width: 640\nimage_height: 360", "image_width: 1280\nimage_height: 720"),
            ("image size is 1280 x 720", "the images are 640 x 360", "needed"),
            id="other size",
        ),
    ],
)
def test_stereo_calibrations_that_cannot_be_one_are_refused(site: Site, damage: Damage, words: tuple[str, ...]) -> None:
    damage(site)
    site.refused(UNUSABLE, str(site.root), *words)


def test_the_cameras_exchanged_are_refused_with_a_guess(site: Site) -> None:
    site.left.rename(site.root / "other")
    site.right.rename(site.left)
    (site.root / "other").rename(site.right)
    site.refused(UNUSABLE, "left", "the images of left and right are swapped", "the other way round")


def test_a_baseline_in_the_other_direction_is_refused_with_a_guess(site: Site) -> None:
    site.replace_text(site.stereo, BASELINE, "[ 0.6, 0., 0. ]")
    site.refused(UNUSABLE, "left", "or T is given in the other direction: the other way round the calibration fits")


def test_right_images_of_another_size_are_refused(site: Site) -> None:
    for path in images(site.right):
        _, content = cv2.imencode(".jpg", np.zeros((240, 320, 3), dtype=np.uint8))
        rewrite(path, content.tobytes())
    site.refused(UNUSABLE, "right", "320x240", "640x360", "at least 80%")


# ------------------------------------------------------------------------------------- damaged images


ASSUMED = (
    "the messages report no accuracy of their positions: taken as 0.02 m, that of a receiver with carrier-phase "
    "corrections; with another the result is as far off as its positions: give --cam-sigma"
)
"""What is to be said of the demonstration's messages."""


@pytest.mark.slow
def test_one_bad_image_of_many_is_skipped_counted_and_named(site: Site) -> None:
    images(site.left)[-1].unlink()
    damaged = images(site.left)[8]
    cut(damaged)
    notes = [
        "1 right images without a partner",
        ASSUMED,
        f"{damaged} is cut off after 5000 bytes (a JPEG without its end); needed is a whole image",
    ]
    ran = site.run()
    assert ran.code == 0, ran.err
    assert ran.err.splitlines() == [f"note: {note}" for note in notes]
    assert "23 image pairs" in ran.out
    assert "1 unreadable" in ran.out
    assert document_in(site.out)["notes"] == notes


@pytest.mark.slow
def test_any_image_may_be_the_damaged_one(site: Site) -> None:
    # The frame in which least moves is matched first, and it is one of the quiet ones at the beginning.
    for path in images(site.right)[:3]:
        cut(path)
    ran = site.run("--quiet")
    assert (ran.code, ran.out, ran.err) == (0, "", "")
    _, *notes = document_in(site.out)["notes"]
    assert len(notes) == 3
    assert all("is cut off after 5000 bytes" in note for note in notes)


def test_more_than_a_fifth_of_damaged_images_are_refused(site: Site) -> None:
    for path in images(site.left)[::4]:
        cut(path)
    first = images(site.left)[0].name
    site.refused(UNUSABLE, "6 of 24 frames are unusable", "at least 80%", first, "is cut off after 5000 bytes")


# ------------------------------------------------------------------------------------- messages


def cam_content(content: bytes) -> Damage:
    def damage(site: Site) -> None:
        rewrite(site.cam, content)

    return damage


def header_only(site: Site) -> None:
    rewrite(site.cam, site.cam.read_bytes().splitlines()[0] + b"\n")


def without_column(name: str) -> Damage:
    def damage(site: Site) -> None:
        write_rows(site.cam, [{k: v for k, v in row.items() if k != name} for row in rows_of(site.cam)])

    return damage


def exchanged(site: Site) -> None:
    rows = rows_of(site.cam)
    write_rows(site.cam, [{**row, "latitude": row["longitude"], "longitude": row["latitude"]} for row in rows])


def no_positions(site: Site) -> None:
    rows = rows_of(site.cam)
    write_rows(site.cam, [{**row, "latitude": "900000001", "longitude": "1800000001"} for row in rows])


def no_cam(site: Site) -> None:
    site.cam.unlink()


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        pytest.param(no_cam, ("does not exist", "needed"), id="missing"),
        pytest.param(cam_content(b""), ("is empty", "needed"), id="empty"),
        pytest.param(header_only, ("holds a header but no rows", "needed is at least one message"), id="header only"),
        pytest.param(
            without_column("latitude"),
            ("lacks the column latitude", "it holds timestamp, station_id, longitude, altitude, heading, speed"),
            id="no latitude",
        ),
        pytest.param(exchanged, ("latitude and longitude look exchanged", "9.94", "48.42"), id="exchanged"),
        pytest.param(no_positions, ("no position", "all of 99 rows", "needed are at least 2"), id="no positions"),
    ],
)
def test_logs_that_cannot_be_read_are_refused(site: Site, damage: Damage, words: tuple[str, ...]) -> None:
    damage(site)
    site.refused(UNUSABLE, str(site.cam), *words)


def shifted(site: Site, by_s: float) -> None:
    rows = rows_of(site.cam)
    write_rows(site.cam, [{**row, "timestamp": f"{float(row['timestamp']) + by_s:.3f}"} for row in rows])


@pytest.mark.parametrize(
    ("by_s", "words"),
    [
        (1000, ("1002.2 s after",)),
        (-7200, ("time zone of 2 h",)),
        (18, ("GPS time is 18 s ahead",)),
        (37, ("TAI is 37 s ahead",)),
        (5 - ETSI_EPOCH_S, ("ETSI's epoch, 2004-01-01", "add 1072915195 s")),
    ],
)
def test_a_log_of_another_time_is_refused_with_both_intervals_and_a_guess(
    site: Site, by_s: float, words: tuple[str, ...]
) -> None:
    shifted(site, by_s)
    recorded = "2025-10-09T08:53:20.000Z to 2025-10-09T08:53:29.600Z"
    line = site.refused(UNUSABLE, str(site.cam), "do not overlap", recorded, "needed", *words)
    assert ("likely" in line) == (by_s != 1000)


def standing(site: Site) -> None:
    rows = rows_of(site.cam)
    place = {name: rows[40][name] for name in ("latitude", "longitude", "heading")}
    write_rows(site.cam, [{**row, **place, "speed": "0.00"} for row in rows])


def test_a_vehicle_that_stands_still_is_not_calibrated(site: Site) -> None:
    standing(site)
    site.refused(NOT_CALIBRATED, "not calibrated", "station 4711 stands still", "0.00 m/s", "needed are 0.5 m/s")


def test_a_log_that_ends_before_the_vehicle_comes_is_refused(site: Site) -> None:
    write_rows(site.cam, [row for row in rows_of(site.cam) if float(row["timestamp"]) < 1760000002.3])
    site.refused(UNUSABLE, str(site.cam), "1 CAMs with a position", "needed are at least 2")


@pytest.mark.slow
def test_an_empty_road_is_not_calibrated(site: Site) -> None:
    for folder in (site.left, site.right):
        quiet = [path.readlink() for path in images(folder)[:4]]
        for i, path in enumerate(images(folder)):
            path.unlink()
            path.symlink_to(quiet[i % 4])
    site.refused(NOT_CALIBRATED, "not calibrated", "no vehicle was found", "needed is one that is seen in 10 frames")


# ------------------------------------------------------------------------------------- arguments


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--nonsense",), ("No such option", "--nonsense")),
        (("--stereo", "nowhere.yaml"), ("nowhere.yaml does not exist", "needed")),
        (("--background", "nonsense"), ("--background is 'nonsense'", "needed is START..END")),
        (("--background", "0..24"), ("0..24", "needed", "0..23")),
        (("--background", "x" * 300), ("x" * 300, "File name too long")),
        (("--disparities", "nonsense"), ("--disparities is 'nonsense'", "needed is MIN..MAX")),
        (("--disparities", "0..100000"), ("0..100000", "needed", "640")),
        (("--cam-reference", "nonsense"), ("--cam-reference is 'nonsense'", "needed is front, center")),
        (("--cam-reference", "9" * 20 + ",0"), ("--cam-reference is", "metres, up to 30")),
        (("--cam-sigma", "0"), ("--cam-sigma is 0.0 m", "needed is 0.001 to 100")),
        (("--cam-sigma", "nan"), ("--cam-sigma is nan m", "needed is 0.001 to 100")),
        (("--clock-sigma", "1e308"), ("--clock-sigma is 1e+308 s", "needed is 1e-06 to 60")),
        (("--clock-sigma", "nan"), ("--clock-sigma is nan s", "needed is 1e-06 to 60")),
        (("--max-sigma-m", "0"), ("--max-sigma-m is 0.0 m", "needed is a number above 0")),
        (("--max-sigma-deg", "nan"), ("--max-sigma-deg is nan deg", "needed is a number above 0")),
        (("--crs", "nonsense"), ("'nonsense'", "needed is a UTM zone such as EPSG:32632")),
        (("--height", "-1"), ("--height is -1.0 m", "needed is a number above 0")),
        (("--height", "inf"), ("--height is inf m", "needed is a number above 0")),
        (("--station", "12"), ("cam.csv", "station 12", "needed is one of 4711")),
        (("--method", "guess"), ("--method", "'guess'", "paper")),
    ],
    ids=lambda value: " ".join(value)[:40],
)
def test_arguments_that_make_no_sense_are_refused(site: Site, options: tuple[str, ...], words: tuple[str, ...]) -> None:
    site.refused(UNUSABLE, *words, options=options)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("calibrate", "left", "right"), ("Missing argument 'CAM'", "laci-stereo calibrate --help")),
        (("nonsense",), ("No such command 'nonsense'", "laci-stereo --help")),
    ],
)
def test_commands_that_make_no_sense_are_refused(
    tmp_path: Path, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    refusal(run(arguments, tmp_path), UNUSABLE, *words)


def test_help_is_no_error(tmp_path: Path) -> None:
    ran = run(("calibrate", "--help"), tmp_path)
    assert (ran.code, ran.err) == (0, "")
    assert ran.out.startswith("Usage: laci-stereo calibrate")


def test_without_arguments_it_shows_its_help(tmp_path: Path) -> None:
    ran = run((), tmp_path)
    assert (ran.code, ran.out) == (UNUSABLE, "")
    assert ran.err.startswith("Usage: laci-stereo")


# ------------------------------------------------------------------------------------- where the result goes


def earlier_result(site: Site) -> Path:
    """Put a result of the right names there; its content tells whether it was touched."""
    site.out.mkdir()
    for name in ("calibration.json", "overlay_1.png", "topdown.png"):
        (site.out / name).write_text(f"earlier {name}", encoding="utf-8")
    return site.out


def test_an_earlier_result_is_kept(site: Site) -> None:
    earlier_result(site)
    site.refused(UNUSABLE, str(site.out), "holds a result already", "--overwrite")


@pytest.mark.parametrize("options", [[], ["--overwrite"]])
def test_a_folder_of_other_things_is_never_replaced(site: Site, options: list[str]) -> None:
    site.refused(UNUSABLE, "left: holds other files", "needed", options=options, out=site.left)


def test_overwrite_replaces_nothing_but_a_result(site: Site) -> None:
    site.refused(UNUSABLE, "cam.csv: is not a folder", "needed", options=["--overwrite"], out=site.cam)
    link = site.root / "link"
    link.symlink_to(earlier_result(site))
    site.refused(UNUSABLE, "link: is not a folder", "needed", options=["--overwrite"], out=link)
    (site.out / "notes.txt").write_text("mine", encoding="utf-8")
    site.refused(UNUSABLE, str(site.out), "holds notes.txt", "needed", options=["--overwrite"])


@posix
@pytest.mark.parametrize(
    ("out", "reason"),
    [("cam.csv/new/result", "Not a directory"), ("x" * 300, "name too long")],
)
def test_places_that_cannot_be_written_are_refused(site: Site, out: str, reason: str) -> None:
    site.refused(UNUSABLE, out, "cannot be written", reason, "needed", out=site.root / out)


@posix
@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="nothing is denied to root")
def test_folders_without_permission_are_refused(site: Site) -> None:
    closed = site.root / "closed"
    closed.mkdir(mode=0o500)
    site.refused(UNUSABLE, str(closed), "cannot be written", "Permission denied", "needed", out=closed / "result")


@pytest.mark.slow
def test_overwrite_replaces_a_result_as_a_whole(site: Site) -> None:
    earlier_result(site)
    (site.out / "overlay_9.png").write_text("of a longer recording", encoding="utf-8")
    before = snapshot(site.root)
    ran = site.run("--overwrite")
    assert ran.code == 0, ran.err
    after = snapshot(site.root)
    changed = {name for name in before.keys() | after.keys() if before.get(name) != after.get(name)}
    assert all(Path(name).parts[0] == site.out.name for name in changed)
    assert document_in(site.out)["station_id"] == 4711
    assert not (site.out / "overlay_9.png").exists()


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system with room for one result, not for two."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=600k", "tmpfs", str(disk)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True, check=False).returncode != 0:
        pytest.skip("file systems cannot be mounted here")
    try:
        yield disk
    finally:
        subprocess.run(["umount", str(disk)], check=True)


@pytest.mark.slow
@posix
def test_a_full_disk_leaves_the_earlier_result(site: Site, small_disk: Path) -> None:
    shutil.copytree(earlier_result(site), small_disk / "result")
    options = ["--overwrite"]
    site.refused(UNUSABLE, "result: cannot be written (No space left", options=options, out=small_disk / "result")
    site.refused(UNUSABLE, "disk: is a mount point", "needed", out=small_disk)


@pytest.mark.slow
@posix
def test_files_that_may_not_grow_leave_the_earlier_result(site: Site) -> None:
    earlier_result(site)
    before = snapshot(site.root)
    # 64 blocks of 512 or 1024 bytes: calibration.json fits, the pictures do not.
    limited = ("/bin/sh", "-c", 'ulimit -f 64; exec "$@"', "sh")
    line = refusal(run_installed(site.arguments("--overwrite"), site.root, within=limited), UNUSABLE)
    assert "result: cannot be written (File too large)" in line
    assert snapshot(site.root) == before


# ------------------------------------------------------------------------------------- interrupts


def until_logged(words: str) -> Callable[[subprocess.Popen[str], Site], None]:
    def wait(process: subprocess.Popen[str], _: Site) -> None:
        assert process.stderr is not None
        assert any(words in line for line in process.stderr)

    return wait


def until_writing(process: subprocess.Popen[str], site: Site) -> None:
    while not list(site.root.glob(".result.*/calibration.json")):
        assert process.poll() is None
        time.sleep(0.002)


@pytest.mark.slow
@posix
@pytest.mark.parametrize(
    ("ending", "wait"),
    [
        pytest.param(signal.SIGINT, until_logged("first look"), id="Ctrl-C in the survey"),
        pytest.param(signal.SIGINT, until_logged("background"), id="Ctrl-C among the frames"),
        pytest.param(signal.SIGINT, until_writing, id="Ctrl-C while it writes"),
        pytest.param(signal.SIGTERM, until_writing, id="SIGTERM while it writes"),
    ],
)
def test_an_interrupt_ends_it_and_leaves_everything_as_it_was(
    site: Site, ending: signal.Signals, wait: Callable[[subprocess.Popen[str], Site], None]
) -> None:
    earlier_result(site)
    before = snapshot(site.root)
    with running(site.arguments("--overwrite", "--verbose"), site.root) as process:
        wait(process, site)
        process.send_signal(ending)
        out, err = process.communicate(timeout=30)
    assert (process.returncode, out) == (INTERRUPTED, "")
    lines = [line for line in err.splitlines() if line and not line.startswith("INFO: ")]
    assert lines == ["laci-stereo: interrupted; nothing was written"]
    assert snapshot(site.root) == before


# ------------------------------------------------------------------------------------- what it prints


@pytest.mark.slow
@posix
def test_progress_is_shown_on_a_terminal(site: Site) -> None:
    ours, theirs = os.openpty()
    with running(site.arguments(), site.root, stderr=theirs) as process:
        os.close(theirs)
        shown = b"".join(iter(lambda: read_terminal(ours), b"")).decode()
        out, _ = process.communicate(timeout=30)
    os.close(ours)
    assert process.returncode == 0
    assert "survey" in shown
    assert "frames" in shown
    assert "24/24" in shown
    assert out.startswith("Sensor ")


def read_terminal(terminal: int) -> bytes:
    try:
        return os.read(terminal, 4096)
    except OSError:  # Linux says so when the other end is closed
        return b""


SUMMARY = (
    "Sensor",
    "Position",
    "Height",
    "Looks",
    "Vehicle",
    "Background",
    "Fit",
    "Doubt",
    "Input",
    "Verdict",
    "Lanes",
)


def test_it_ends_with_a_summary_of_eleven_lines(demonstration: Finished) -> None:
    assert (demonstration.ran.code, demonstration.ran.err) == (0, f"note: {ASSUMED}\n")
    *summary, written = demonstration.ran.out.splitlines()
    assert tuple(line.split()[0] for line in summary) == SUMMARY
    assert written.startswith("Written    calibration: calibration.json, check.png, evidence.npz, overlay_1.png")


def test_the_result_holds_what_the_schema_and_the_readme_say(demonstration: Finished) -> None:
    names = sorted(path.name for path in demonstration.out.iterdir())
    overlays = [name for name in names if name.startswith("overlay_")]
    assert names == ["calibration.json", "check.png", "evidence.npz", *overlays, "report.html", "topdown.png"]
    assert len(overlays) >= 2
    for name in overlays:
        picture = cv2.imread(str(demonstration.out / name))
        assert picture is not None
        assert picture.shape == (720, 1280, 3)
    topdown = cv2.imread(str(demonstration.out / "topdown.png"))
    assert topdown is not None
    assert len(np.unique(topdown)) > 10
    document = document_in(demonstration.out)
    schema = Path(laci_stereo.__file__).parent / "io" / "result" / "calibration.schema.json"
    Draft202012Validator(json.loads(schema.read_text(encoding="utf-8"))).validate(document)
    assert document["notes"] == [ASSUMED]


def test_nothing_else_is_left(demonstration: Finished) -> None:
    assert [path.name for path in demonstration.out.parent.iterdir()] == ["calibration"]
    assert demonstration.out.stat().st_mode & 0o777 == 0o755


def test_the_demonstration_finds_where_the_camera_really_is(demonstration: Finished) -> None:
    document = document_in(demonstration.out)
    truth = json.loads((DEMONSTRATION / "truth.json").read_text(encoding="utf-8"))
    found = np.array(document["T_utm_sensor"])
    true = np.array(truth["stereo"]["T_world_camera_utm"])
    # The vehicle's true track as the camera sees it, brought back onto the map by what was found.
    track = np.array([[east, north, 0.0, 1.0] for _, east, north in truth["vehicle_centres_utm"]])
    apart = ((found @ np.linalg.inv(true) - np.eye(4)) @ track.T)[:2]
    quality = document["quality"]
    assert np.sqrt((apart**2).sum(axis=0).mean()) < 3.0 * quality["track_xy_sigma_m"] < 0.4
    turned = np.arccos(np.clip((np.trace(found[:3, :3] @ true[:3, :3].T) - 1) / 2, -1.0, 1.0))
    assert np.degrees(turned) < min(0.3, 3.0 * np.hypot(quality["yaw_sigma_deg"], quality["tilt_sigma_deg"]))
    assert abs(found[2, 3] - true[2, 3]) < 0.03
    assert document["height_m"] == pytest.approx(true[2, 3], abs=0.03)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere every path is text")
def test_paths_and_names_of_any_letters_are_written(recording: Path, tmp_path: Path) -> None:
    """A folder whose name is no UTF-8, as old archives have it, and a terminal that lacks a name's letters."""
    site = Site(Path(os.fsdecode(os.fsencode(tmp_path) + b"/M\xfcnchen")))
    site.root.mkdir()
    link_recording(recording, site.root)
    arguments = site.arguments("--name", "\u4ea4\u5dee\u70b9", out=tmp_path / "result")
    ran = run_installed(arguments, tmp_path, env={"PYTHONIOENCODING": "cp1252"})
    assert (ran.code, "Traceback" in ran.err) == (0, False), ran.err
    assert "\\u4ea4\\u5dee\\u70b9" in ran.out
    assert (tmp_path / "result" / "report.html").stat().st_size > 100_000


@pytest.mark.slow
def test_quiet_prints_nothing_whatever_decoders_say_and_makes_the_folders_above(site: Site) -> None:
    # Zeros in the compressed data, all markers whole: libjpeg complains and goes on.
    for path in images(site.left)[6:9]:
        content = bytearray(path.read_bytes())
        content[len(content) // 2 : len(content) // 2 + 400] = bytes(400)
        rewrite(path, bytes(content))
    ran = site.run("--quiet", out=site.root / "new" / "deep" / "result")
    assert (ran.code, ran.out, ran.err) == (0, "", "")
    assert (site.root / "new" / "deep" / "result" / "calibration.json").is_file()
