"""Rectification: the laws of epipolar geometry, on rigs of every kind."""

from __future__ import annotations

import tracemalloc

import cv2
import numpy as np
import pytest

from laci_stereo.core.frames import FloatArray
from laci_stereo.stereo.rectify import EDGE_PX, Rectification, View, already_rectified, rectify
from tests.stereo.render import project
from tests.stereo.rigs import RIGS, SIZE
from tests.stereo.support import rectification, swapped

every_rig = pytest.mark.parametrize("name", RIGS)
# OpenCV's fixed-point maps hold steps of 1/32 px.
LOOK_UP_PX = 0.05


def looked_up(view: View, u: FloatArray, v: FloatArray) -> FloatArray:
    """Return the raw pixels, shape (n, 2), that belong to rectified ones; between columns by interpolation."""
    if view.maps is None:
        return np.stack([u, v], axis=-1)
    maps = cv2.convertMaps(view.maps[0], view.maps[1], cv2.CV_32FC1)
    rows = v.astype(int)
    first = np.floor(u).astype(int)
    raw = [(1 - (u - first)) * one[rows, first] + (u - first) * one[rows, first + 1] for one in maps]
    return np.stack(raw, axis=-1)


def sample(plane: Rectification, disparity: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rectified left pixels whose partners lie in the right image."""
    rng = np.random.default_rng(0)
    n = len(disparity)
    u = np.floor(rng.uniform(disparity + 1, plane.size[0] - 2, n))
    return u, np.floor(rng.uniform(0, plane.size[1], n))


@every_rig
def test_a_point_is_found_along_its_ray_and_in_the_same_row_with_its_disparity(name: str) -> None:
    rig, plane = RIGS[name], rectification(name)
    depth = np.random.default_rng(1).uniform(5.0, 80.0, 2000)
    disparity = plane.focal_px * plane.baseline_m / depth
    u, v = sample(plane, disparity)
    points = plane.rays[v.astype(int), u.astype(int)] * depth[:, None]
    left_raw = project(rig.left, points)
    right_raw = project(rig.right, points @ rig.R_right_left.T + rig.t_right_left_m)
    np.testing.assert_allclose(looked_up(plane.left, u, v), left_raw, atol=LOOK_UP_PX)
    np.testing.assert_allclose(looked_up(plane.right, u - disparity, v), right_raw, atol=LOOK_UP_PX)


@every_rig
def test_the_rectified_frame_is_the_sensor_turned(name: str) -> None:
    plane = rectification(name)
    R = plane.T_sensor_rectified[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(plane.T_sensor_rectified[:, 3], [0, 0, 0, 1])
    rectified = plane.rays.reshape(-1, 3) @ R
    np.testing.assert_allclose(rectified[:, 2], 1.0, atol=1e-9)
    along = R.T @ (-RIGS[name].R_right_left.T @ RIGS[name].t_right_left_m)
    np.testing.assert_allclose(np.abs(along), [plane.baseline_m, 0, 0], atol=1e-6)


@every_rig
def test_the_baseline_leads_to_the_right_camera(name: str) -> None:
    rig, plane = RIGS[name], rectification(name)
    np.testing.assert_allclose(plane.cameras.baseline_m, -rig.R_right_left.T @ rig.t_right_left_m, atol=1e-6)
    depth = plane.rays.reshape(-1, 3) @ plane.cameras.ahead
    np.testing.assert_allclose(depth, 1.0, atol=1e-9)


@every_rig
def test_valid_is_what_the_raw_image_holds(name: str) -> None:
    plane = rectification(name)
    v, u = (a.ravel().astype(float) for a in np.mgrid[: plane.size[1], : plane.size[0] - 1])
    for view, lens in ((plane.left, RIGS[name].left), (plane.right, RIGS[name].right)):
        raw = looked_up(view, u, v)
        inside_by = np.minimum(raw, np.array(lens.size) - 1 - raw).min(axis=1)
        valid = view.valid[:, :-1].ravel()
        assert (inside_by[valid] > -LOOK_UP_PX).all()
        assert (inside_by[~valid] < LOOK_UP_PX).all()


@every_rig
def test_inner_keeps_clear_of_every_border(name: str) -> None:
    plane = rectification(name)
    for view in (plane.left, plane.right):
        assert view.inner.any()
        assert view.valid[view.inner].all()
        border = np.ones_like(view.inner)
        border[EDGE_PX:-EDGE_PX, EDGE_PX:-EDGE_PX] = False
        assert not view.inner[border].any()


@every_rig
def test_the_cameras_can_be_exchanged(name: str) -> None:
    plane, other = rectification(name), rectify(swapped(RIGS[name]))
    assert other.mirrored != plane.mirrored
    assert other.baseline_m == pytest.approx(plane.baseline_m)


def test_an_ideal_rig_is_left_as_it_is() -> None:
    plane = rectification("ideal")
    image = np.random.default_rng(0).integers(0, 255, SIZE[::-1], dtype=np.uint8)
    np.testing.assert_array_equal(plane.left.look_up(image), image)
    np.testing.assert_array_equal(plane.right.look_up(image, slice(3, 9), slice(5, 20)), image[3:9, 5:20])
    assert plane.left.valid.all()
    assert plane.right.valid.all()


@every_rig
def test_a_part_looks_as_in_the_whole(name: str) -> None:
    view = rectification(name).right
    image = np.random.default_rng(0).integers(0, 255, SIZE[::-1], dtype=np.uint8)
    rows, columns = slice(20, 70), slice(33, 90)
    np.testing.assert_array_equal(view.look_up(image, rows, columns), view.look_up(image)[rows, columns])


@pytest.mark.parametrize("name", ["ideal", "askew", "mirrored askew"])
def test_rectified_images_are_shifted_only(name: str) -> None:
    rig = already_rectified(RIGS[name])
    plane = rectify(rig)
    assert plane.baseline_m == pytest.approx(RIGS[name].baseline_m)
    assert plane.mirrored == rectification(name).mirrored
    np.testing.assert_allclose(plane.T_sensor_rectified, np.eye(4), atol=1e-12)
    np.testing.assert_array_equal(rig.left.K, rig.right.K)
    assert not rig.left.distortion.any()
    if name == "ideal":
        assert plane.left.maps is None
        assert plane.right.maps is None


@every_rig
def test_rays_of_some_pixels_are_those_of_all(name: str) -> None:
    plane = rectification(name)
    v, u = np.random.default_rng(2).integers(0, plane.size[::-1], (100, 2)).T
    np.testing.assert_allclose(plane.rays_at(v, u), plane.rays[v, u], atol=1e-12)


def test_rectification_needs_little_memory_for_each_pixel() -> None:
    """Images may have 100 megapixels: two views hold 8 bytes each for a pixel, making them takes a few times that."""
    rig = RIGS["askew"]
    tracemalloc.start()
    plane = rectify(rig)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 40 * plane.size[0] * plane.size[1]
