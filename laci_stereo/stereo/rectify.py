"""Rectification: two raw images onto a common image plane in which disparity runs along rows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from laci_stereo.core.frames import BoolArray, FloatArray, Raster, rigid
from laci_stereo.io.stereo_calibration import Lens, StereoRig

EDGE_PX = 22
"""What lies nearer than this to where either image ends may be cut off there: two windows of 11 pixels, one in which
nothing matches because it reaches beyond the image, and one for a gap, which are that large on plain paint."""

ROUNDING_PX = 1e-3


@dataclass(frozen=True)
class View:
    """How one raw image is looked up from the rectified one.

    Attributes
    ----------
    maps : tuple of ndarray or None
        OpenCV's fixed-point maps; None where raw and rectified are the same.
    valid : ndarray of bool, shape (height, width)
        The rectified pixel lies inside the raw image.
    inner : ndarray of bool, shape (height, width)
        It lies inside by more than `EDGE_PX`, and as far from the border of the rectified image.
    """

    maps: tuple[Raster, Raster] | None
    valid: BoolArray
    inner: BoolArray

    def look_up(
        self, image: Raster, rows: slice = slice(None), columns: slice = slice(None), *, to_match: bool = False
    ) -> Raster:
        """Return a part of the rectified image.

        To be matched it is interpolated by Lanczos' kernel of four lobes, which takes eight times as long: linearly,
        fine texture moves to where the nearer pixel is, by up to 0.05 px between two images.
        """
        if self.maps is None:
            return image[rows, columns]
        how = cv2.INTER_LANCZOS4 if to_match else cv2.INTER_LINEAR
        return cv2.remap(image, self.maps[0][rows, columns], self.maps[1][rows, columns], how)


@dataclass(frozen=True)
class Rectification:
    """The common image plane of a stereo rig.

    Where the second camera stands left of the first (T positive), both rectified images are mirrored, so that
    disparity is positive as everywhere else; `rays` undo it.

    Attributes
    ----------
    left, right : View
    focal_px : float
    baseline_m : float
        Positive.
    size : tuple of int
        Width and height of the rectified images.
    rays : ndarray, shape (height, width, 3)
        Of each rectified pixel, in the sensor frame (the raw left camera), with unit depth along the rectified axis.
    T_sensor_rectified : ndarray, shape (4, 4)
        A pure rotation.
    mirrored : bool
    """

    left: View
    right: View
    focal_px: float
    baseline_m: float
    size: tuple[int, int]
    rays: FloatArray
    T_sensor_rectified: FloatArray
    mirrored: bool


def rectify(rig: StereoRig) -> Rectification:
    """Lay the common image plane through a stereo rig (Bouguet's method, by OpenCV).

    The rectified image has the raw left one's size and about its focal length; what the lens sees beyond is lost,
    what it does not see is masked by the views' ``valid``.
    """
    left_R, right_R, left_P, right_P = bouguet(rig)
    mirrored = bool(right_P[0, 3] > 0)
    focal = float(left_P[0, 0])
    width, height = rig.left.size
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rectified = np.dstack([(u - left_P[0, 2]) / focal, (v - left_P[1, 2]) / focal, np.ones_like(u)])
    rays = rectified @ left_R  # (R^T x)^T = x^T R
    return Rectification(
        left=_view(rig.left, left_R, left_P, rig.left.size, mirrored),
        right=_view(rig.right, right_R, right_P, rig.left.size, mirrored),
        focal_px=focal,
        baseline_m=float(abs(right_P[0, 3]) / focal),
        size=rig.left.size,
        rays=np.ascontiguousarray(rays[:, ::-1] if mirrored else rays),
        T_sensor_rectified=rigid(left_R.T, np.zeros(3)),
        mirrored=mirrored,
    )


def already_rectified(rig: StereoRig) -> StereoRig:
    """Return the rig of images that were rectified elsewhere.

    Where the calibration describes these, as it says; else both as the left camera without distortion, only shifted.
    """
    if rig.rectified is not None:
        return rig.rectified
    lens = replace(rig.left, distortion=np.zeros(4), model="pinhole")
    side = np.sign((rig.R_right_left.T @ rig.t_right_left_m)[0])
    return StereoRig(lens, lens, np.eye(3), np.array([side * rig.baseline_m, 0.0, 0.0]), rig.notes)


def with_right_turned(rig: StereoRig, turn_deg: tuple[float, float, float] | None) -> StereoRig:
    """Return the rig whose right camera has turned, see `StereoSettings.turn_deg`."""
    if turn_deg is None:
        return rig
    R = Rotation.from_rotvec(turn_deg, degrees=True).as_matrix()
    return replace(rig, R_right_left=R @ rig.R_right_left, t_right_left_m=R @ rig.t_right_left_m)


def undistorted(lens: Lens, points: FloatArray, R: FloatArray | None = None, P: FloatArray | None = None) -> FloatArray:
    """Return where raw pixels, shape (n, 2), lie without the lens's distortion.

    In rectified pixels by R, shape (3, 3), and P, shape (3, 4); without them as tangents about the optical axis.
    """
    raw = np.ascontiguousarray(points)[:, None]
    if lens.model == "fisheye":
        found = cv2.fisheye.undistortPoints(raw, lens.K, lens.distortion, R=R, P=P)
    else:
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-9)
        found = cv2.undistortPoints(raw, lens.K, lens.distortion, None, R, P, stop)
    return np.asarray(found[:, 0], dtype=np.float64)


def bouguet(rig: StereoRig) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the rectifying rotations, shape (3, 3), and projections, shape (3, 4), of both cameras."""
    lenses = (rig.left.K, rig.left.distortion, rig.right.K, rig.right.distortion, rig.left.size)
    # OpenCV refuses a part of a larger matrix.
    pose = (np.ascontiguousarray(rig.R_right_left), np.ascontiguousarray(rig.t_right_left_m).reshape(3, 1))
    if rig.left.model == "fisheye":
        found = cv2.fisheye.stereoRectify(*lenses, *pose, cv2.CALIB_ZERO_DISPARITY, balance=0.0)[:4]
    else:
        found = cv2.stereoRectify(*lenses, *pose, flags=cv2.CALIB_ZERO_DISPARITY, alpha=-1)[:4]
    left_R, right_R, left_P, right_P = (np.asarray(part, dtype=np.float64) for part in found)
    return left_R, right_R, left_P, right_P


def _view(lens: Lens, R: FloatArray, P: FloatArray, size: tuple[int, int], mirrored: bool) -> View:
    init = cv2.fisheye.initUndistortRectifyMap if lens.model == "fisheye" else cv2.initUndistortRectifyMap
    map_x, map_y = init(lens.K, lens.distortion, R, P[:, :3], size, cv2.CV_32FC1)
    if mirrored:
        map_x, map_y = np.ascontiguousarray(map_x[:, ::-1]), np.ascontiguousarray(map_y[:, ::-1])
    u, v = np.meshgrid(np.arange(size[0], dtype=np.float32), np.arange(size[1], dtype=np.float32))
    same = size == lens.size and max(np.abs(map_x - u).max(), np.abs(map_y - v).max()) < ROUNDING_PX
    fixed = None if same else cv2.convertMaps(map_x, map_y, cv2.CV_16SC2)
    inner = _inside(map_x, map_y, lens.size, EDGE_PX) & _inside(u, v, size, EDGE_PX)
    return View(fixed, _inside(map_x, map_y, lens.size, 0), inner)


def _inside(map_x: Raster, map_y: Raster, size: tuple[int, int], margin: int) -> BoolArray:
    first = margin - ROUNDING_PX
    right, bottom = size[0] - 1 - first, size[1] - 1 - first
    inside: BoolArray = (map_x >= first) & (map_x <= right) & (map_y >= first) & (map_y <= bottom)
    return inside
