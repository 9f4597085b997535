"""A recording of a rendered scene: what is seen, where it lies, and what is refused."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.errors import ImageError, RigError, SettingError
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.subsampling import spread
from laci_stereo.io.images import StereoPair
from laci_stereo.stereo.recording import LOOK_FRAMES, QUIET_FRAMES, StereoRecording
from laci_stereo.stereo.settings import StereoSettings
from tests.stereo.render import Box, Mounting, View, render
from tests.stereo.rigs import RIGS, SIZE
from tests.stereo.support import (
    FAR,
    MOUNTING,
    NEAR,
    STATIC,
    exposed,
    off_surfaces,
    standing,
    swapped,
    truth,
    views,
    write_pairs,
)

CUT = Box(14.0, -7.0, yaw_rad=0.3, seed=3, grey=60.0)
MOVERS = (None, None, NEAR, None, None, FAR, None, None, CUT, None, None, None)
FEW_MOVERS = (None, NEAR, None, None, CUT, None, None)
EMPTY = [number for number, mover in enumerate(MOVERS) if mover is None]


def frames(name: str, movers: Sequence[Box | None] = MOVERS) -> list[tuple[View, View]]:
    return [views(name, mover) for mover in movers]


def record(folder: Path, name: str = "ideal", **options: object) -> list[StereoPair]:
    return write_pairs(folder, exposed(frames(name), **options))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def ideal(tmp_path_factory: pytest.TempPathFactory) -> list[StereoPair]:
    return record(tmp_path_factory.mktemp("ideal"))


@pytest.fixture(scope="module")
def recording(ideal: list[StereoPair]) -> StereoRecording:
    return StereoRecording(ideal, RIGS["ideal"])


@pytest.fixture(scope="module")
def clouds(recording: StereoRecording) -> list[PointCloud]:
    return list(recording)


def is_cut(name: str, mover: Box) -> bool:
    """Tell whether the border of the rectified image cuts a mover."""
    mine = truth(name, (*STATIC, mover)).owner == len(STATIC) + 1
    return bool(mine[:, [0, -1]].any() or mine[[0, -1]].any())


def assert_shows_the_movers(
    clouds: Sequence[PointCloud], movers: Sequence[Box | None] = MOVERS, name: str = "ideal"
) -> None:
    """Check that there are points on the movers, where they are, and none without one."""
    for cloud, mover in zip(clouds, movers, strict=True):
        if mover is None:
            assert len(cloud) == 0
            continue
        box = standing(cloud)
        assert len(box) > 0.7 * len(cloud) > 500
        assert cloud.at_edge.mean() > 0.02 if is_cut(name, mover) else not cloud.at_edge.any()
        off = off_surfaces(box, [mover])
        assert np.median(off) < 1.0
        assert np.mean(off > 3) < 0.02
        assert np.mean(off_surfaces(cloud, [mover]) > 3) < 0.02


@pytest.mark.parametrize(
    "name", [*(pytest.param(name, marks=pytest.mark.slow) for name in ("askew", "mirrored askew")), "fisheye"]
)
def test_every_rig_sees_the_same_scene(name: str, tmp_path: Path) -> None:
    pairs = write_pairs(tmp_path, exposed(frames(name, FEW_MOVERS)))
    recording = StereoRecording(pairs, RIGS[name])
    assert_shows_the_movers(list(recording), FEW_MOVERS, name)
    assert_is_whole(next(iter(recording.survey())))


def assert_is_whole(cloud: PointCloud) -> None:
    assert len(cloud) > 0.5 * SIZE[0] * SIZE[1] / 4 * 0.8
    off = off_surfaces(cloud, STATIC)
    assert np.median(off) < 1.0
    assert np.mean(off > 3) < 0.02
    points = MOUNTING.to_road(cloud.points)
    near = np.abs(points[:, 2]) < 3 * cloud.sigma_along_m
    assert abs(np.median(points[near & (points[:, 0] < 20), 2])) < 0.01
    assert np.ptp(points[:, 0]) > 30


def test_a_frame_holds_what_moves_and_nothing_else(clouds: list[PointCloud]) -> None:
    assert_shows_the_movers(clouds)


def test_noise_is_along_the_line_of_sight(clouds: list[PointCloud]) -> None:
    near, far = clouds[2], clouds[5]
    assert np.median(far.sigma_along_m) > 1.3 * np.median(near.sigma_along_m)
    for cloud in (near, far):
        assert (cloud.sigma_across_m < cloud.sigma_along_m).all()
        assert np.isfinite(cloud.points).all()


def test_clouds_tell_the_angle_of_a_matched_window(recording: StereoRecording, clouds: list[PointCloud]) -> None:
    rays = recording.rectification.rays[SIZE[1] // 2, SIZE[0] // 2 :][: recording.settings.refine_window_px + 1]
    cos = rays[0] @ rays[-1] / np.linalg.norm(rays[0]) / np.linalg.norm(rays[-1])
    seen = [cloud.window_rad for cloud in clouds if len(cloud)]
    assert seen == pytest.approx([np.arccos(cos)] * len(seen), rel=0.01)


def test_the_survey_is_of_whole_quiet_frames_and_of_the_whole_recording(
    recording: StereoRecording, ideal: list[StereoPair]
) -> None:
    survey = list(recording.survey())
    stamps = [cloud.stamp_ns for cloud in survey]
    assert stamps == sorted(stamps)
    quiet = {ideal[number].stamp_ns for number in EMPTY}
    assert len(quiet & set(stamps)) >= min(QUIET_FRAMES, len(quiet))
    assert {ideal[0].stamp_ns, ideal[-1].stamp_ns} <= set(stamps)
    for cloud in survey:
        if cloud.stamp_ns in quiet:
            assert_is_whole(cloud)


def test_it_can_be_read_again(recording: StereoRecording, clouds: list[PointCloud]) -> None:
    for again, cloud in zip(recording, clouds, strict=True):
        assert again.stamp_ns == cloud.stamp_ns
        np.testing.assert_array_equal(again.points, cloud.points)
        np.testing.assert_array_equal(again.sigma_along_m, cloud.sigma_along_m)


def test_the_number_of_workers_does_not_matter(ideal: list[StereoPair], clouds: list[PointCloud]) -> None:
    for other, cloud in zip(StereoRecording(ideal, RIGS["ideal"], StereoSettings(workers=1)), clouds, strict=True):
        np.testing.assert_array_equal(other.points, cloud.points)


def test_it_says_what_it_is(recording: StereoRecording, ideal: list[StereoPair]) -> None:
    assert recording.kind == "stereo"
    assert len(recording) == len(ideal)
    assert recording.span_ns == (ideal[0].stamp_ns, ideal[-1].stamp_ns)


@pytest.mark.parametrize(
    ("bits", "colour"),
    [(8, True), *(pytest.param(*each, marks=pytest.mark.slow) for each in ((12, False), (16, True)))],
)
def test_depth_and_colour_of_the_images_do_not_matter(bits: int, colour: bool, tmp_path: Path) -> None:
    recording = StereoRecording(record(tmp_path, bits=bits, colour=colour), RIGS["ideal"])
    assert_shows_the_movers(list(recording))
    drawn = recording.reader.colour(recording.pairs[0].left)
    assert drawn.shape == (SIZE[1], SIZE[0], 3)
    assert drawn.dtype == np.uint8
    assert 60 < drawn.mean() < 180


def test_a_dark_first_image_does_not_tell_how_deep_the_others_are(tmp_path: Path) -> None:
    gains = [0.2, *[1.0] * (len(MOVERS) - 1)]
    pairs = write_pairs(tmp_path, exposed(frames("ideal"), gains=gains, bits=12))
    dark, bright = (cv2.imread(str(pair.left), cv2.IMREAD_UNCHANGED) for pair in pairs[:2])
    assert dark.max() < 2**10 < 2**11 < bright.max()
    recording = StereoRecording(pairs, RIGS["ideal"])
    list(recording)
    assert recording.reader.eight_bit.bits == 12
    assert abs(recording.reader.read(pairs[1].left).astype(float) - bright * (255 / 4095)).max() <= 0.5
    assert recording.reader.remarks() == ()


def test_images_that_are_brighter_than_those_looked_at_are_told(tmp_path: Path) -> None:
    """Of 40 pairs two, between those that are looked at first."""
    skipped = sorted(set(range(40)) - set(spread(range(40), LOOK_FRAMES)))[:2]
    gains = [1.0 if number in skipped else 0.2 for number in range(40)]
    pairs = write_pairs(tmp_path, exposed([views("ideal", None)] * 40, gains=gains, bits=12))
    recording = StereoRecording(pairs, RIGS["ideal"])
    list(recording)
    (remark,) = recording.reader.remarks()
    assert remark.startswith(f"{pairs[skipped[0]].left}: the brightest pixel is ")
    assert "none is above 1023, which is taken for white; 4 images are like it" in remark


def test_images_that_are_rectified_need_no_rectification(ideal: list[StereoPair], clouds: list[PointCloud]) -> None:
    crooked = replace(RIGS["ideal"], R_right_left=RIGS["askew"].R_right_left)
    recording = StereoRecording(ideal, crooked, StereoSettings(rectified=True))
    for other, cloud in zip(recording, clouds, strict=True):
        np.testing.assert_allclose(other.points, cloud.points, rtol=1e-6)


def test_the_light_of_the_whole_scene_is_no_mover(tmp_path: Path) -> None:
    gains = [1.0 if number % 2 else 0.7 for number in range(len(MOVERS))]
    assert_shows_the_movers(list(StereoRecording(record(tmp_path, gains=gains), RIGS["ideal"])))


def test_a_lorry_beside_the_camera_is_found(tmp_path: Path) -> None:
    lorry = Box(9.0, 0.5, 0.1, length_m=6.0, width_m=2.5, height_m=4.0, seed=5, grey=60.0)
    shown = [views("ideal", lorry if number == 3 else None) for number in range(8)]
    cloud = list(StereoRecording(write_pairs(tmp_path, exposed(shown)), RIGS["ideal"]))[3]
    heights = MOUNTING.to_road(cloud.points)[:, 2]
    roof = (heights > 3.8) & (heights < 4.2)
    assert roof.sum() > 0.8 * (np.abs(MOUNTING.to_road(shown[3][0].points)[..., 2] - 4.0) < 1e-6).sum()
    assert np.mean(off_surfaces(cloud, [lorry]) > 3) < 0.02


def test_disparities_of_the_user_are_searched_and_no_others(ideal: list[StereoPair]) -> None:
    plane = StereoRecording(ideal, RIGS["ideal"]).rectification
    only = StereoSettings(disparities=(12, 27))
    depth = np.concatenate([cloud.points[:, 2] for cloud in StereoRecording(ideal, RIGS["ideal"], only)])
    disparity: FloatArray = plane.focal_px * plane.baseline_m / depth
    assert disparity.min() > 11
    assert disparity.max() < 28
    with pytest.raises(SettingError, match=rf"10\.\.{SIZE[0]}; needed is less than the images' width"):
        StereoRecording(ideal, RIGS["ideal"], StereoSettings(disparities=(10, SIZE[0])))


def test_a_frame_that_cannot_be_read_is_skipped_and_named(tmp_path: Path) -> None:
    pairs = record(tmp_path)
    os.truncate(pairs[4].left, 500)
    pairs[5].right.unlink()
    recording = StereoRecording(pairs, RIGS["ideal"])
    clouds = list(recording)
    assert [cloud.stamp_ns for cloud in clouds] == [pair.stamp_ns for pair in pairs]
    assert len(clouds[5]) == 0
    assert len(clouds[2]) > 1000
    assert set(recording.reader.skipped) == {pairs[4].left, pairs[5].right}
    assert all(len(reason.splitlines()) == 1 for reason in recording.reader.skipped.values())


@pytest.mark.parametrize("wrong", ["cut off", "another size"])
def test_more_than_a_fifth_of_bad_frames_is_an_error(wrong: str, tmp_path: Path) -> None:
    pairs = record(tmp_path)
    small = render(replace(RIGS["ideal"], left=replace(RIGS["ideal"].left, size=(40, 30))), MOUNTING, [])
    for number in (0, 5, 7):
        if wrong == "cut off":
            os.truncate(pairs[number].left, 500)
        else:
            written = write_pairs(tmp_path / "small", exposed([small]))[0]
            pairs[number].left.write_bytes(written.left.read_bytes())
    with pytest.raises(ImageError, match=r"3 of 12 frames are unusable; needed are at least 80% usable ones"):
        list(StereoRecording(pairs, RIGS["ideal"]))


def test_frames_are_counted_once_and_no_images_of_others(tmp_path: Path) -> None:
    """The left images of two frames cannot be read, nor the right image of any: of the other ten, ten are unusable."""
    pairs = record(tmp_path)
    for path in (*(pair.left for pair in pairs[:2]), *(pair.right for pair in pairs)):
        os.truncate(path, 500)
    with pytest.raises(ImageError, match="10 of 10 frames are unusable"):
        list(StereoRecording(pairs, RIGS["ideal"]).survey())


def test_a_background_of_the_users_choice_is_used(ideal: list[StereoPair], clouds: list[PointCloud]) -> None:
    chosen = [ideal[number] for number in EMPTY[:6]]
    recording = StereoRecording(ideal, RIGS["ideal"], background=chosen)
    assert {cloud.stamp_ns for cloud in recording.survey()} <= {pair.stamp_ns for pair in chosen}
    assert_shows_the_movers(list(recording))


def exchanged(pairs: Sequence[StereoPair]) -> list[StereoPair]:
    return [StereoPair(pair.stamp_ns, pair.right, pair.left) for pair in pairs]


@pytest.mark.parametrize("mistake", ["folders", "direction of T"])
def test_cameras_that_are_exchanged_are_said_to_be_so(mistake: str, ideal: list[StereoPair]) -> None:
    rig = RIGS["ideal"]
    wrong = StereoRecording(exchanged(ideal), rig) if mistake == "folders" else StereoRecording(ideal, swapped(rig))
    with pytest.raises(RigError, match=r"with the cameras exchanged \d+% would: are the folders swapped"):
        list(wrong.survey())


def test_cameras_and_calibration_may_both_be_exchanged(ideal: list[StereoPair]) -> None:
    mirrored = StereoRecording(exchanged(ideal), swapped(RIGS["ideal"]))
    assert mirrored.rectification.mirrored
    cloud = list(mirrored)[2]
    # The sensor is the other camera now, one baseline to the right.
    moved = replace(cloud, points=cloud.points + np.array([RIGS["ideal"].baseline_m, 0.0, 0.0]))
    assert len(cloud) > 1000
    assert np.mean(off_surfaces(moved, [NEAR]) > 3) < 0.02


def test_pictures_of_two_different_places_are_refused(tmp_path: Path) -> None:
    lefts = exposed([views("ideal")] * 4)
    turned_round = [(left[::-1].copy(), left[::-1].copy()) for left, _ in lefts]
    pairs = write_pairs(tmp_path, [(left, other) for (left, _), (other, _) in zip(lefts, turned_round, strict=True)])
    with pytest.raises(RigError, match="is the calibration another rig's, or stale"):
        list(StereoRecording(pairs, RIGS["ideal"]).survey())


def test_half_of_sky_is_no_mismatch(tmp_path: Path) -> None:
    level = Mounting(height_m=6.0, tilt_deg=3.0)
    sky = render(RIGS["ideal"], level, [])
    assert np.mean(sky[0].owner < 0) > 0.4
    survey = list(StereoRecording(write_pairs(tmp_path, exposed([sky] * 4)), RIGS["ideal"]).survey())
    assert len(survey) == 4
    assert np.mean(off_surfaces(survey[0], [], level) > 4) < 0.02


def test_disparities_beyond_those_of_the_matcher_are_refused(ideal: list[StereoPair]) -> None:
    rig = RIGS["ideal"]
    wide = replace(rig, left=replace(rig.left, size=(4096, 2160)), right=replace(rig.right, size=(4096, 2160)))
    StereoRecording(ideal, wide, StereoSettings(disparities=(0, 2031)))
    with pytest.raises(SettingError, match=r"0\.\.2032; needed are at most 2031"):
        StereoRecording(ideal, wide, StereoSettings(disparities=(0, 2032)))


def test_no_disparity_beyond_those_of_the_matcher_is_searched(
    recording: StereoRecording, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert recording.whole_region().largest > 40
    monkeypatch.setattr("laci_stereo.stereo.recording.LARGEST_PX", 40)
    assert recording.whole_region().largest == 40


def test_survey_of_large_images_is_matched_smaller(recording: StereoRecording, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = next(iter(recording.survey()))
    monkeypatch.setattr("laci_stereo.stereo.recording.SURVEY_PIXELS", SIZE[0] * SIZE[1] // 4)
    small = next(iter(recording.survey()))
    assert len(small) == pytest.approx(len(whole) / 4, rel=0.2)
    assert np.median(off_surfaces(small, STATIC)) < 1.0
    assert np.median(small.sigma_along_m) > np.median(whole.sigma_along_m)
    assert small.window_rad == pytest.approx(2 * whole.window_rad)
    heights = [MOUNTING.to_road(cloud.points)[:, 2] for cloud in (small, whole)]
    road_m = [np.median(z[np.abs(z) < 0.3]) for z in heights]
    assert road_m[0] == pytest.approx(road_m[1], abs=0.01)
