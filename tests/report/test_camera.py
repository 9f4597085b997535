from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from laci_stereo.core.frames import FloatArray, invert, rigid, transform
from laci_stereo.io.rig.stereo_rig import Lens, Model
from laci_stereo.report.camera import FOLD_STEP_DEG, NEAR_M, Camera

K = np.array([[900.0, 0.0, 640.0], [0.0, 880.0, 350.0], [0.0, 0.0, 1.0]])
BARREL = np.array([-0.3, 0.0, 0.0, 0.0, 0.0])
RATIONAL = np.array([0.4, 0.1, 1e-3, -2e-3, 0.01, 0.7, 0.2, 0.03])
LENSES = {
    "plain": Lens(K, np.zeros(4), (1280, 720), "pinhole"),
    "barrel": Lens(K, np.array([-0.25, 0.06, 1e-3, -5e-4, 0.0]), (1280, 720), "pinhole"),
    "rational": Lens(K, RATIONAL, (1280, 720), "pinhole"),
    "fisheye": Lens(0.5 * K, np.array([0.05, -0.01, 0.002, 0.0]), (1280, 720), "fisheye"),
}
T_CAMERA_WORLD = rigid(Rotation.from_euler("xyz", [-105, 3, 40], degrees=True).as_matrix(), np.array([1.0, 5.0, 3.0]))


def camera(distortion: FloatArray, model: Model = "pinhole") -> Camera:
    """Stand in the world's origin and look along z."""
    return Camera(Lens(K, distortion, (1280, 720), model), np.eye(4))


def by_opencv(lens: Lens, points_world: FloatArray, T_camera_world: FloatArray) -> FloatArray:
    rotation = cv2.Rodrigues(T_camera_world[:3, :3])[0]
    project = cv2.fisheye.projectPoints if lens.model == "fisheye" else cv2.projectPoints
    pixels, _ = project(points_world[:, None], rotation, T_camera_world[:3, 3], lens.K, lens.distortion)
    return np.asarray(pixels).reshape(-1, 2)


@pytest.mark.parametrize("name", LENSES)
@given(seed=st.integers(0, 1000))
@settings(max_examples=10, deadline=None)
def test_points_in_view_are_where_opencv_puts_them(name: str, seed: int) -> None:
    lens = LENSES[name]
    rng = np.random.default_rng(seed)
    depth = rng.uniform(1.0, 80.0, 50)
    ray = rng.uniform(-0.6, 0.6, (50, 2))
    points = transform(invert(T_CAMERA_WORLD), np.column_stack([ray * depth[:, None], depth]))
    pixels = Camera(lens, T_CAMERA_WORLD).project(points)
    np.testing.assert_allclose(pixels, by_opencv(lens, points, T_CAMERA_WORLD), atol=1e-6)


@pytest.mark.parametrize("name", LENSES)
def test_nothing_is_seen_behind_the_camera(name: str) -> None:
    behind = np.array([[0.0, 0.0, -5.0], [1.0, -2.0, -30.0], [0.0, 0.0, 0.0], [3.0, 3.0, NEAR_M / 2]])
    assert np.isnan(Camera(LENSES[name], np.eye(4)).project(behind)).all()


def test_a_line_through_the_cameras_back_is_cut_off_before_it_comes_out_on_the_other_side() -> None:
    below = np.array([[1.0, 2.0, 20.0], [1.0, 2.0, -20.0]])
    (piece,) = camera(np.zeros(5)).project_line(below)
    # All that is in front lies right of and below the principal point; without the clip it would flip over.
    assert (piece > K[:2, 2]).all()
    assert piece[0] == pytest.approx(K[:2, 2] + [45.0, 88.0])
    assert piece[-1, 1] > 720
    assert (np.diff(piece, axis=0) > 0).all()


def test_only_what_is_in_front_is_drawn_of_a_line_that_leaves_and_returns() -> None:
    line = np.array([[-1.0, 0.0, 5.0], [-1.0, 0.0, -5.0], [1.0, 0.0, -5.0], [1.0, 0.0, 5.0]])
    left, right = camera(np.zeros(5)).project_line(line)
    assert (left[:, 0] < K[0, 2]).all()
    assert (right[:, 0] > K[0, 2]).all()


def test_a_line_behind_the_camera_is_not_drawn() -> None:
    assert camera(np.zeros(5)).project_line(np.array([[0.0, 1.0, -1.0], [5.0, 1.0, -50.0]])) == []


@pytest.mark.parametrize(("k1", "towards_middle"), [(-0.2, -1), (0.0, 0), (0.2, 1)])
def test_distortion_bends_a_straight_line(k1: float, towards_middle: int) -> None:
    # Barrel distortion bulges: the middle of a line above the centre lies farther out than its ends.
    line = np.array([[-3.0, -1.5, 10.0], [3.0, -1.5, 10.0]])
    (piece,) = camera(np.array([k1, 0.0, 0.0, 0.0, 0.0])).project_line(line)
    ends = (piece[0, 1] + piece[-1, 1]) / 2
    bend = piece[len(piece) // 2, 1] - ends
    expected = 880.0 * -0.15 * (k1 * 0.15**2 - k1 * (0.3**2 + 0.15**2))
    assert bend == pytest.approx(expected, abs=1e-6)
    assert np.sign(round(bend, 6)) == towards_middle


@pytest.mark.parametrize(("model", "fold"), [("pinhole", 1 / np.sqrt(0.9)), ("fisheye", np.tan(1 / np.sqrt(0.9)))])
def test_nothing_is_seen_where_the_distortion_folds_back(model: Model, fold: float) -> None:
    # r (1 - 0.3 r^2) is largest at r = 1 / sqrt(0.9); beyond r = 1.8 it would be on the other side of the image.
    distorted = camera(BARREL if model == "pinhole" else np.array([-0.3, 0.0, 0.0, 0.0]), model)
    step = np.radians(1.5 * FOLD_STEP_DEG)
    around = np.linspace(0.0, 2 * np.pi, 50)
    for angle, seen in ((np.arctan(fold) - step, True), (np.arctan(fold) + step, False)):
        ring = np.column_stack([np.tan(angle) * np.cos(around), np.tan(angle) * np.sin(around), np.ones(50)])
        assert (np.isfinite(distorted.project(ring)).all(axis=1) == seen).all()


def test_what_is_far_aside_does_not_come_back_into_the_image() -> None:
    aside = np.array([[20.0, 3.0, 8.0], [60.0, 3.0, 8.0]])
    raw = by_opencv(camera(BARREL).lens, aside, np.eye(4))
    assert (raw[0] < K[:2, 2]).any()  # by the polynomial alone it would be on the wrong side
    assert camera(BARREL).project_line(aside) == []


def test_a_lens_without_distortion_has_no_fold() -> None:
    wide = np.array([[np.tan(np.radians(88.0)), 0.0, 1.0]])
    assert np.isfinite(camera(np.zeros(5)).project(wide)).all()


def test_a_line_of_many_kilometres_is_drawn_where_it_is_in_view() -> None:
    line = np.array([[-50_000.0, 1.0, 20.0], [50_000.0, 1.0, 20.0]])
    (piece,) = camera(np.zeros(5)).project_line(line)
    assert piece[:, 0].min() < 0
    assert piece[:, 0].max() > 1280
    np.testing.assert_allclose(piece[:, 1], 350.0 + 880.0 / 20.0)


def test_a_line_is_drawn_up_to_the_near_plane() -> None:
    (piece,) = camera(np.zeros(5)).project_line(np.array([[0.05, 0.0, 0.3], [0.05, 0.0, -0.3]]))
    np.testing.assert_allclose(piece, K[:2, 2] + [[900.0 * 0.05 / 0.3, 0.0], [900.0 * 0.05 / NEAR_M, 0.0]])
