import re
from dataclasses import asdict, replace

import cv2
import numpy as np
import pytest

pytest.importorskip("embreex")

from laci_stereo.core.settings import Settings
from tools.bench_scenes import METHODS, Job, jobs_of, missing, run
from tools.scenes.runs import Run, beyond, read_runs, recorded, table
from tools.scenes.scene import draw_scene, errors_of
from tools.scenes.seeing import reopened, see
from tools.scenes.write import write_images

DONE = Run("lidar_16", "joint", 1, good=True, verdict="pass", track_xy_cm=3.0, rotation_deg=0.1)
DONE = replace(DONE, sigma_ratio=1.0, rotation_ratio=0.5)


def cells(runs):
    return [cell.strip() for cell in table(runs).splitlines()[2].split("|")[1:-1]]


@pytest.mark.slow
def test_one_scene_is_seen_once_for_both_methods():
    runs = run(Job("detections", 9004, METHODS), {"density": 0.2})
    assert [one.method for one in runs] == list(METHODS)
    assert len({(one.seed, one.seen, one.good, one.draw_s, one.observe_s) for one in runs}) == 1
    assert all(one.seen >= 40 for one in runs)
    # Boxes good to 10 cm, some 90 of them.
    assert runs[METHODS.index("joint")].track_xy_cm < 20.0


def test_an_impossible_scene_is_no_refusal():
    runs = run(Job("lidar_16", 0, METHODS), {"drive": "roundabout", "layout": "cross"})
    assert not any(one.drawn for one in runs)
    assert cells([*runs, replace(DONE, method=runs[0].method)])[2:4] == ["1", "0/1 0%"]


def test_what_fails_or_is_refused_counts_as_refused_and_its_errors_do_not():
    runs = [
        DONE,
        replace(DONE, seed=2, sigma_ratio=4.0, track_xy_cm=5.0, verdict="warn"),
        replace(
            DONE, seed=3, good=False, refused="verdict fail: x", verdict="fail", track_xy_cm=900.0, sigma_ratio=9.0
        ),
        Run("lidar_16", "joint", 4, good=True, refused="TrackError: x"),
        replace(DONE, seed=5, sigma_ratio=6.0, track_xy_cm=7.0, rotation_ratio=5.5),
    ]
    found = cells(runs)
    assert found[2:8] == ["5", "2/5 40%", "1/4 25%", "3 (2)", "1/3 33%", "1/3 33%"]
    assert found[8] == "5.0"
    assert found[10] == "7.0"
    assert found[14] == "1/3 33%"
    assert beyond(runs) == ("  lidar_16 joint: 2 (xy 4.0, rotation 0.5, warn), 5 (xy 6.0, rotation 5.5, pass)")


def test_runs_survive_their_file_and_an_interruption(tmp_path):
    path = tmp_path / "scenes.csv"
    before = [DONE, Run("lidar_16", "paper", 1, refused='MatchError: "a, b"\n')]
    coming = recorded(iter([[replace(DONE, seed=2)], [replace(DONE, seed=3)]]), path, before)
    next(coming)
    # Interrupted here: what has come stands in the file.
    assert [one.seed for one in read_runs(path)] == [1, 1, 2]
    coming.close()
    for one, other in zip(read_runs(path), [*before, replace(DONE, seed=2)], strict=True):
        assert str(asdict(one)) == str(asdict(other))
    whole = path.read_text()
    path.write_text(whole[:-20])
    assert [one.seed for one in read_runs(path)] == [1, 1]


def test_only_what_is_missing_is_run_again():
    jobs = jobs_of(["lidar_16", "stereo_05"], range(5, 7), METHODS, rendered=1)
    assert [(job.sensor, job.seed, job.way) for job in jobs] == [
        ("lidar_16", 5, "simulated"),
        ("lidar_16", 6, "simulated"),
        ("stereo_05_rendered", 5, "rendered"),
        ("stereo_05", 6, "simulated"),
    ]
    assert {job.kind for job in jobs} == {"lidar_16", "stereo_05"}
    there = [replace(DONE, seed=5, method=method) for method in METHODS] + [replace(DONE, seed=6)]
    left = missing(jobs, there)
    assert left[0] == Job("lidar_16", 6, tuple(name for name in METHODS if name != "joint"))
    assert left[1:] == jobs[2:]


def test_sensors_in_turn_share_the_seeds():
    jobs = jobs_of(["lidar_16", "stereo_05"], range(5, 10), METHODS, rendered=0, in_turn=True)
    assert sorted((job.seed, job.sensor) for job in jobs) == [
        (5, "lidar_16"),
        (6, "stereo_05"),
        (7, "lidar_16"),
        (8, "stereo_05"),
        (9, "lidar_16"),
    ]


@pytest.mark.slow
def test_rendered_images_are_the_frames_of_the_scene(tmp_path):
    scene = draw_scene(3, "stereo_05", density=0.0, parked=0)
    small = replace(scene.sensor, size_px=(96, 64), focal_px=80.0)
    scene = replace(scene, sensor=small)
    write_images(scene, tmp_path, step=60)
    images = reopened(tmp_path)
    assert [pair.stamp_ns for pair in images.pairs] == scene.stamps_ns[::60].tolist()
    assert images.rig.left.size == small.size_px
    assert images.rectification.baseline_m == pytest.approx(small.baseline_m, rel=0.01)
    assert images.rectification.focal_px == pytest.approx(small.focal_px, rel=0.2)
    first, later = (cv2.imread(str(pair.left), cv2.IMREAD_GRAYSCALE).astype(np.float64) for pair in images.pairs[:2])
    assert first.shape == (64, 96)
    assert np.abs(first - later).max() > 10.0  # something has moved


@pytest.mark.slow
@pytest.mark.parametrize(
    ("job", "factors"),
    [
        pytest.param(Job("lidar_32", 150073, ("joint",)), {}, id="a pavement where the last rings leave the road"),
        pytest.param(Job("stereo_05", 31029, ("joint",)), {"vehicles": 4}, id="reversing between two gaps of the log"),
        pytest.param(Job("lidar_32", 300030, ("joint",)), {}, id="the cab and the trailer of a lorry that folds"),
        pytest.param(
            Job("stereo_10", 610007, ("joint",)), {"vehicle": "trailer"}, id="a lorry's cab ahead of its trailer"
        ),
    ],
)
def test_scenes_that_were_wrong_by_more_than_ten_sigma(job: Job, factors: dict[str, object]) -> None:
    (one,) = run(job, factors)
    assert not one.refused
    assert max(one.sigma_ratio, one.rotation_ratio) < 3.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("job", "stations"), [(Job("lidar_16", 600012, ("joint",)), 1), (Job("stereo_05", 600003, ("joint",)), 2)]
)
def test_clocks_that_nobody_set_are_a_warning_where_other_senders_are_seen(job: Job, stations: int) -> None:
    (one,) = run(job, {"clock_offset_s": 0.2, "stations": stations})
    assert one.sigma_ratio > 5.0
    assert one.verdict == "warn"


@pytest.mark.slow
def test_a_road_in_hills_is_the_ground_of_who_drives_on_it() -> None:
    (one,) = run(Job("lidar_16", 700077, ("joint",)), {})  # 28 % of the view support the best plane
    assert not one.refused
    assert max(one.sigma_ratio, one.rotation_ratio) < 3.0


@pytest.mark.slow
def test_what_drives_above_the_land_altogether_is_on_another_ground() -> None:
    """The road is a metre above most of what is seen, and background; another car on it was taken for the sender."""
    (one,) = run(Job("lidar_64", 300188, ("joint",)), {})
    assert not one.refused
    assert one.track_xy_cm < 15.0
    assert one.track_z_cm < 10.0
    assert one.sigma_ratio < 3.0


@pytest.mark.slow
def test_a_trailer_whose_cab_is_seen_only_when_it_is_not_is_no_pass() -> None:
    """It backs up, and articulates meanwhile; its front was taken for the cab's, 3.4 m off."""
    (one,) = run(Job("lidar_16", 610004, ("joint",)), {"vehicle": "trailer"})
    assert one.refused or one.verdict == "warn" or one.sigma_ratio < 3.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("error", "told"),
    [
        pytest.param({}, "", id="right"),
        pytest.param(
            {"focal_error": 0.03}, r"depths are [23]\.\d \+- \d\.\d % smaller .* focal length", id="focal length"
        ),
        pytest.param({"baseline_error": -0.03}, r"widths [23]\.\d \+- \d\.\d % larger: .* baseline", id="baseline"),
    ],
)
def test_a_stereo_calibration_that_is_wrong_is_a_warning(error: dict[str, float], told: str) -> None:
    scene = draw_scene(320106, "stereo_10", **error)
    quality = see(scene, "simulated").locate(Settings()).quality
    assert quality.verdict == ("warn" if told else "pass")
    assert re.search(told, "; ".join(quality.reasons))


@pytest.mark.slow
@pytest.mark.parametrize("apart_s", [0.0015, -0.003])
def test_images_of_different_moments_are_a_warning_and_undone(apart_s: float) -> None:
    scene = draw_scene(300019, "stereo_10", apart_s=apart_s)
    found = see(scene, "simulated").locate(Settings())
    words = r"by the drive, the right images are (\d\.\d) \+- (\d\.\d) ms (later|earlier) than the left ones"
    (told,) = (one for reason in found.quality.reasons if (one := re.match(words, reason)))
    assert abs(float(told[1]) - 1e3 * abs(apart_s)) < 3.0 * float(told[2]) + 0.05
    assert told[3] == ("later" if apart_s > 0.0 else "earlier")
    assert errors_of(found, scene).sigma_ratio < 3.0


@pytest.mark.slow
def test_a_black_glossy_car_is_no_wrong_calibration() -> None:
    scene = draw_scene(300016, "stereo_02")
    found = see(scene, "simulated").locate(Settings())
    assert "calibration" not in "; ".join(found.quality.reasons)
    assert errors_of(found, scene).sigma_ratio < 3.0
