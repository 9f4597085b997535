"""Roadside stereo cameras: their lenses, relative pose, mounting, and calibration file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from laci_stereo.core.frames import FloatArray, rigid
from laci_stereo.io.rig.stereo_rig import Lens, StereoRig
from laci_stereo.stereo.rectify import with_right_turned

BASELINES_M = (0.2, 0.5, 1.0)

SIZES = ((960, 600), (1024, 768), (1280, 720), (1280, 960))
"""Widths and heights of images, pixels."""

HEIGHT_M = (3.0, 15.0)
"""Mounting heights."""

FOLDED_PX = 0.05
"""A lens folds over within the image if the round trip of a pixel through its ray errs by more than this."""


def rays(lens: Lens, pixels: FloatArray) -> FloatArray:
    """Return the viewing rays of raw pixels.

    Parameters
    ----------
    lens : Lens
    pixels : ndarray, shape (n, 2)
        Integers are the centres of pixels.

    Returns
    -------
    ndarray, shape (n, 3)
        Unit vectors in the camera's frame, z forward.
    """
    until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-10)
    undistort = cv2.fisheye.undistortPoints if lens.model == "fisheye" else cv2.undistortPoints
    flat = undistort(pixels.reshape(-1, 1, 2).astype(np.float64), lens.K, lens.distortion, criteria=until)
    directions = np.column_stack([flat.reshape(-1, 2), np.ones(len(pixels))])
    unit: FloatArray = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return unit


def project(lens: Lens, points: FloatArray) -> FloatArray:
    """Return the raw pixels, shape (n, 2), of points in the camera's frame, shape (n, 3)."""
    of_lens = (np.zeros(3), np.zeros(3), lens.K, lens.distortion)
    if lens.model == "fisheye":
        pixels = cv2.fisheye.projectPoints(points.reshape(-1, 1, 3), *of_lens)[0]
    else:
        pixels = cv2.projectPoints(points.reshape(-1, 1, 3), *of_lens)[0]
    return np.asarray(pixels, dtype=np.float64).reshape(-1, 2)


def looking(position: FloatArray, yaw_rad: float, tilt_rad: float, roll_rad: float = 0.0) -> FloatArray:
    """Return ``T_world_camera``, shape (4, 4), of a camera (x right, y down, z forward).

    Parameters
    ----------
    position : ndarray, shape (3,)
        In the world, metres.
    yaw_rad, tilt_rad, roll_rad : float
        Counter-clockwise from the world's x; downwards; clockwise from the camera's own point of view.
    """
    cy, sy, ct, st = np.cos(yaw_rad), np.sin(yaw_rad), np.cos(tilt_rad), np.sin(tilt_rad)
    forward = np.array([ct * cy, ct * sy, -st])
    right = np.array([sy, -cy, 0.0])
    upright = np.column_stack([right, np.cross(forward, right), forward])
    return rigid(upright @ Rotation.from_rotvec([0.0, 0.0, roll_rad]).as_matrix(), position)


def random_mount(rng: np.random.Generator, target: FloatArray, distance_m: float) -> FloatArray:
    """Draw the pose of a camera beside the road that looks at a point on the ground.

    Parameters
    ----------
    rng : Generator
    target : ndarray, shape (2,)
        In the world, metres.
    distance_m : float
        Horizontal distance from the target.

    Returns
    -------
    ndarray, shape (4, 4)
        ``T_world_left``.
    """
    height = rng.uniform(*HEIGHT_M)
    yaw = rng.uniform(-np.pi, np.pi)
    position = np.array([*(target - distance_m * np.array([np.cos(yaw), np.sin(yaw)])), height])
    # Fitters aim by eye: a few degrees beside the point, and hardly ever level.
    aside, down, roll = np.radians(rng.normal(0.0, (3.0, 2.0, 1.5)))
    return looking(position, yaw + aside, np.arctan2(height, distance_m) + down, roll)


def random_rig(rng: np.random.Generator) -> StereoRig:
    """Draw a stereo camera."""
    size = SIZES[rng.integers(len(SIZES))]
    baseline = float(rng.choice(BASELINES_M))
    # Fields of view of 45 to 80 degrees: narrower lenses do not cover a crossing, wider ones do not resolve a car at 40
    # m.
    focal = size[0] / 2 / np.tan(np.radians(rng.uniform(45.0, 80.0)) / 2)
    return raw_rig(rng, size, focal, baseline)


def raw_rig(rng: np.random.Generator, size: tuple[int, int], focal_px: float, baseline_m: float) -> StereoRig:
    """Draw two lenses of the same kind, mounted about as accurately as two screws allow."""
    strength = rng.choice([0.0, 0.3, 1.0])
    left = _lens(rng, size, focal_px, strength)
    right = _lens(rng, size, focal_px * rng.uniform(0.98, 1.02), strength)
    R = Rotation.from_rotvec(np.radians(rng.normal(0.0, 0.5, 3))).as_matrix()
    centre = baseline_m * np.array([1.0, *rng.normal(0.0, 0.01, 2)])
    return StereoRig(left, right, R, -R @ centre)


def mistold(
    rig: StereoRig, focal_error: float, baseline_error: float, turned_deg: tuple[float, float, float]
) -> StereoRig:
    """Return a rig as described by a wrong calibration, see `tools.scenes.disparity.StereoCamera`."""
    longer = np.diag([1.0 + focal_error, 1.0 + focal_error, 1.0])
    left, right = (replace(lens, K=lens.K @ longer) for lens in (rig.left, rig.right))
    pitch, yaw, roll = turned_deg
    before = with_right_turned(rig, (-pitch, -yaw, -roll))
    return replace(before, left=left, right=right, t_right_left_m=before.t_right_left_m * (1.0 + baseline_error))


def _lens(rng: np.random.Generator, size: tuple[int, int], focal_px: float, strength: float) -> Lens:
    """Draw a lens with barrel distortion up to the given strength; 1 is a cheap wide lens, 0 an ideal one."""
    width, height = size
    middle = (np.array([width, height]) - 1) / 2 + rng.normal(0.0, 0.01 * width, 2)
    K = np.array([[focal_px, 0.0, middle[0]], [0.0, focal_px * rng.normal(1.0, 1e-3), middle[1]], [0.0, 0.0, 1.0]])
    while True:
        k1 = rng.uniform(-0.4, 0.05)
        distortion = strength * np.array([k1, 0.4 * k1**2 + rng.normal(0.0, 0.01), *rng.normal(0.0, 5e-4, 2), 0.0])
        lens = Lens(K, distortion, size, "pinhole")
        if not _folds(lens):
            return lens


def _folds(lens: Lens) -> bool:
    """Return whether two rays reach the same pixel, as with a polynomial that turns back before the corner."""
    u, v = np.meshgrid(np.linspace(0, lens.size[0] - 1, 9), np.linspace(0, lens.size[1] - 1, 9))
    pixels = np.column_stack([u.ravel(), v.ravel()])
    return bool(np.abs(project(lens, rays(lens, pixels)) - pixels).max() > FOLDED_PX)


def write_calibration(path: Path, rig: StereoRig) -> None:
    """Write a rig as OpenCV's stereo calibration in YAML."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", rig.left.size[0])
    storage.write("image_height", rig.left.size[1])
    for number, lens in ((1, rig.left), (2, rig.right)):
        storage.write(f"K{number}", lens.K)
        storage.write(f"D{number}", lens.distortion.reshape(1, -1))
    storage.write("R", rig.R_right_left)
    storage.write("T", rig.t_right_left_m.reshape(3, 1))
    storage.release()
