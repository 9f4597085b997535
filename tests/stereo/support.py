"""Rendered recordings, and the truth about them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray, Raster
from laci_stereo.io.images import StereoPair
from laci_stereo.io.rig.stereo_rig import StereoRig
from laci_stereo.stereo.rectify import Rectification, rectify
from tests.stereo.render import Box, Mounting, View, expose, render, trace, turned
from tests.stereo.rigs import RIGS

MOUNTING = Mounting(height_m=6.0, tilt_deg=22.0, roll_deg=1.0)
WALL = Box(45.0, 0.0, length_m=0.5, width_m=120.0, height_m=20.0, seed=11, grey=150.0)
PARKED = Box(24.0, -7.0, yaw_rad=0.3, seed=12, grey=90.0)
STATIC = (WALL, PARKED)
NEAR = Box(14.0, -1.5, yaw_rad=0.6, seed=3, grey=60.0)
FAR = Box(19.0, 2.5, yaw_rad=0.6, seed=3, grey=60.0)
PERIOD_NS = 100_000_000


@dataclass(frozen=True)
class Truth:
    """Of each pixel of the rectified left image: disparity, owner as in `View`, and whether the right camera sees it.

    Where there is nothing, the disparity is 0.
    """

    disparity: FloatArray
    owner: IntArray
    seen: BoolArray


@lru_cache(maxsize=32)
def views(name: str, mover: Box | None = None, static: tuple[Box, ...] = STATIC) -> tuple[View, View]:
    """Render the scene, with or without a box that moves, as the rig of this name sees it."""
    return render(RIGS[name], MOUNTING, static if mover is None else (*static, mover), samples=1)


@lru_cache(maxsize=len(RIGS))
def rectification(name: str) -> Rectification:
    return rectify(RIGS[name])


def truth(name: str, boxes: Sequence[Box], mounting: Mounting = MOUNTING) -> Truth:
    rig, plane = RIGS[name], rectification(name)
    shape = plane.rays.shape[:2]
    eye = np.array([0.0, 0.0, mounting.height_m])
    rays = turned(plane.rays.reshape(-1, 3), mounting.R_road_left)
    depth, owner = trace(eye, rays, boxes)
    points = eye + rays * depth[:, None]
    other_eye = mounting.to_road(-rig.R_right_left.T @ rig.t_right_left_m)
    to_point, _ = trace(other_eye, points - other_eye, boxes)
    with np.errstate(divide="ignore"):
        disparity = np.where(depth > 0, plane.focal_px * plane.baseline_m / depth, 0.0)
    u_right = np.arange(shape[1]) - disparity.reshape(shape)
    inside = (u_right >= 0) & (u_right <= shape[1] - 1)
    seen = inside & ((depth > 0) & (to_point > 0.999)).reshape(shape)
    return Truth(disparity.reshape(shape), owner.reshape(shape), seen)


def exposed(
    frames: Sequence[tuple[View, View]], seed: int = 0, gains: Sequence[float] = (), bits: int = 8, colour: bool = False
) -> list[tuple[Raster, Raster]]:
    rng = np.random.default_rng(seed)
    gains = gains or [1.0] * len(frames)
    return [
        (expose(left, rng, gain, bits, colour), expose(right, rng, gain, bits, colour))
        for (left, right), gain in zip(frames, gains, strict=True)
    ]


def write_pairs(folder: Path, frames: Sequence[tuple[Raster, Raster]]) -> list[StereoPair]:
    """Write frames as a recording does."""
    pairs = []
    for number, images in enumerate(frames):
        stamp = 1_700_000_000_000_000_000 + number * PERIOD_NS
        paths = [folder / side / f"{stamp}.png" for side in ("left", "right")]
        for path, image in zip(paths, images, strict=True):
            path.parent.mkdir(parents=True, exist_ok=True)
            assert cv2.imwrite(str(path), image)
        pairs.append(StereoPair(stamp, *paths))
    return pairs


def off_surfaces(cloud: PointCloud, boxes: Sequence[Box], mounting: Mounting = MOUNTING) -> FloatArray:
    """Return how far points are from the nearest surface, in their standard deviations."""
    points = mounting.to_road(cloud.points)
    distance = np.minimum.reduce([np.abs(points[:, 2]), *(box.distance(points) for box in boxes)])
    off: FloatArray = distance / np.hypot(cloud.sigma_along_m, cloud.sigma_across_m)
    return off


def standing(cloud: PointCloud, mounting: Mounting = MOUNTING) -> PointCloud:
    """Return what is above the road by more than its noise."""
    return cloud[mounting.to_road(cloud.points)[:, 2] > np.maximum(0.3, 2 * cloud.sigma_along_m)]


def swapped(rig: StereoRig) -> StereoRig:
    """Return the rig whose first camera is the second one of another."""
    R = rig.R_right_left.T
    return StereoRig(rig.right, rig.left, R, -R @ rig.t_right_left_m)


def robust_std(values: FloatArray) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))
