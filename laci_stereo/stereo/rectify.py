"""Rectification: projects two raw images onto a common image plane in which disparity runs along rows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from laci_stereo.core.cloud import Cameras
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray, Raster, rigid
from laci_stereo.io.rig.stereo_rig import Lens, StereoRig

EDGE_PX = 22
"""Distance from the border of either image within which an object may be cut off. It is two windows of 11 pixels: one
in which nothing matches because it reaches beyond the image, and one for gaps in the disparity, which are that large on
plain paint."""

ROUNDING_PX = 1e-3


@dataclass(frozen=True)
class View:
    """The mapping from rectified pixels to one raw image.

    Attributes
    ----------
    maps : tuple of ndarray or None
        OpenCV's fixed-point maps; None if the raw and the rectified image are identical.
    valid : ndarray of bool, shape (height, width)
        The pixel lies inside the raw image.
    inner : ndarray of bool, shape (height, width)
        The pixel lies at least `EDGE_PX` inside the raw image and the rectified image.
    """

    maps: tuple[Raster, Raster] | None
    valid: BoolArray
    inner: BoolArray

    def look_up(
        self, image: Raster, rows: slice = slice(None), columns: slice = slice(None), *, to_match: bool = False
    ) -> Raster:
        """Return a part of the rectified image.

        For matching, it is interpolated with Lanczos' kernel of four lobes, which takes eight times as long. Linear
        interpolation moves fine texture towards the nearer pixel, by up to 0.05 px between two images.
        """
        if self.maps is None:
            return image[rows, columns]
        how = cv2.INTER_LANCZOS4 if to_match else cv2.INTER_LINEAR
        return cv2.remap(image, self.maps[0][rows, columns], self.maps[1][rows, columns], how)


@dataclass(frozen=True)
class Rectification:
    """The common image plane of a stereo rig.

    If the second camera is left of the first (T positive), both rectified images are mirrored, so that disparity is
    positive as usual; `rays_at` accounts for this.

    Attributes
    ----------
    left, right : View
    focal_px : float
    baseline_m : float
        Positive.
    size : tuple of int
        Width and height of the rectified images.
    centre_px : tuple of float
        Principal point, before any mirroring.
    T_sensor_rectified : ndarray, shape (4, 4)
        A pure rotation.
    mirrored : bool
    """

    left: View
    right: View
    focal_px: float
    baseline_m: float
    size: tuple[int, int]
    centre_px: tuple[float, float]
    T_sensor_rectified: FloatArray
    mirrored: bool

    def rays_at(self, v: IntArray, u: IntArray) -> FloatArray:
        """Return the directions of rectified pixels in the sensor frame (the raw left camera), shape (..., 3).

        They have unit depth along the rectified optical axis.

        Parameters
        ----------
        v, u : ndarray of int
            Rows and columns, of one shape.
        """
        u = self.size[0] - 1 - u if self.mirrored else u
        off = ((at - middle) / self.focal_px for at, middle in zip((u, v), self.centre_px, strict=True))
        rays: FloatArray = np.stack([*off, np.ones(u.shape)], axis=-1) @ self.T_sensor_rectified[:3, :3].T
        return rays

    @property
    def rays(self) -> FloatArray:
        """The directions of all pixels, shape (height, width, 3): 24 bytes for each of up to 100 million."""
        return self.rays_at(*np.mgrid[: self.size[1], : self.size[0]])

    @property
    def cameras(self) -> Cameras:
        """The two cameras, sensor frame."""
        right, _, ahead = self.T_sensor_rectified[:3, :3].T
        return Cameras((-self.baseline_m if self.mirrored else self.baseline_m) * right, ahead)


def rectify(rig: StereoRig) -> Rectification:
    """Compute the common image plane of a stereo rig (Bouguet's method, OpenCV's implementation).

    The rectified images have the raw left one's size and approximately its focal length. What a lens sees beyond them
    is lost; rectified pixels outside a raw image are masked by the views' ``valid``.
    """
    left_R, right_R, left_P, right_P = bouguet(rig)
    mirrored = bool(right_P[0, 3] > 0)
    focal = float(left_P[0, 0])
    return Rectification(
        left=_view(rig.left, left_R, left_P, rig.left.size, mirrored),
        right=_view(rig.right, right_R, right_P, rig.left.size, mirrored),
        focal_px=focal,
        baseline_m=float(abs(right_P[0, 3]) / focal),
        size=rig.left.size,
        centre_px=(float(left_P[0, 2]), float(left_P[1, 2])),
        T_sensor_rectified=rigid(left_R.T, np.zeros(3)),
        mirrored=mirrored,
    )


def already_rectified(rig: StereoRig) -> StereoRig:
    """Return the rig for images that have been rectified already.

    This is the calibration's own description of the rectified images. Without one, both cameras have the left camera's
    matrix without distortion and differ only by the baseline.
    """
    if rig.rectified is not None:
        return rig.rectified
    lens = replace(rig.left, distortion=np.zeros(4), model="pinhole")
    side = np.sign((rig.R_right_left.T @ rig.t_right_left_m)[0])
    return StereoRig(lens, lens, np.eye(3), np.array([side * rig.baseline_m, 0.0, 0.0]), rig.notes)


def with_right_turned(rig: StereoRig, turn_deg: tuple[float, float, float] | None) -> StereoRig:
    """Return the rig with its right camera rotated as `StereoSettings.turn_deg` says."""
    if turn_deg is None:
        return rig
    R = Rotation.from_rotvec(turn_deg, degrees=True).as_matrix()
    return replace(rig, R_right_left=R @ rig.R_right_left, t_right_left_m=R @ rig.t_right_left_m)


def undistorted(lens: Lens, points: FloatArray, R: FloatArray | None = None, P: FloatArray | None = None) -> FloatArray:
    """Return the positions of raw pixels, shape (n, 2), without lens distortion.

    They are in rectified pixels if R, shape (3, 3), and P, shape (3, 4), are given, else tangents of the angles from
    the optical axis.
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
    # OpenCV rejects views into a larger matrix.
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
    u, v = np.arange(size[0], dtype=np.float32)[None], np.arange(size[1], dtype=np.float32)[:, None]
    same = size == lens.size and max(np.abs(map_x - u).max(), np.abs(map_y - v).max()) < ROUNDING_PX
    fixed = None if same else cv2.convertMaps(map_x, map_y, cv2.CV_16SC2)
    inner = _inside(map_x, map_y, lens.size, EDGE_PX) & _inside(u, v, size, EDGE_PX)
    return View(fixed, _inside(map_x, map_y, lens.size, 0), inner)


def _inside(map_x: Raster, map_y: Raster, size: tuple[int, int], margin: int) -> BoolArray:
    first = margin - ROUNDING_PX
    right, bottom = size[0] - 1 - first, size[1] - 1 - first
    inside: BoolArray = (map_x >= first) & (map_x <= right) & (map_y >= first) & (map_y <= bottom)
    return inside
