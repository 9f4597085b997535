"""Recordings of rendered scenes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.frames import FloatArray, Raster
from laci_stereo.io.images import StereoPair
from laci_stereo.io.stereo_calibration import StereoRig
from tests.stereo.render import Box, Mounting, View, expose, render

MOUNTING = Mounting(height_m=6.0, tilt_deg=22.0, roll_deg=1.0)
WALL = Box(45.0, 0.0, length_m=0.5, width_m=120.0, height_m=20.0, seed=11, grey=150.0)
PARKED = Box(24.0, -7.0, yaw_rad=0.3, seed=12, grey=90.0)
STATIC = (WALL, PARKED)
PERIOD_NS = 100_000_000


def write_pairs(folder: Path, frames: Sequence[tuple[Raster, Raster]], suffix: str = ".png") -> list[StereoPair]:
    """Write frames as a recording does."""
    pairs = []
    for number, images in enumerate(frames):
        stamp = 1_700_000_000_000_000_000 + number * PERIOD_NS
        paths = [folder / side / f"{stamp}{suffix}" for side in ("left", "right")]
        for path, image in zip(paths, images, strict=True):
            path.parent.mkdir(parents=True, exist_ok=True)
            assert cv2.imwrite(str(path), image)
        pairs.append(StereoPair(stamp, *paths))
    return pairs


def exposed(
    views: Sequence[tuple[View, View]], seed: int = 0, gains: Sequence[float] = (), bits: int = 8, colour: bool = False
) -> list[tuple[Raster, Raster]]:
    rng = np.random.default_rng(seed)
    gains = gains or [1.0] * len(views)
    return [
        (expose(left, rng, gain, bits, colour), expose(right, rng, gain, bits, colour))
        for (left, right), gain in zip(views, gains, strict=True)
    ]


def drive(
    rig: StereoRig, movers: Sequence[Box | None], mounting: Mounting = MOUNTING, static: Sequence[Box] = STATIC
) -> list[tuple[View, View]]:
    """Render a scene through which a box moves; without one where it is None."""
    rest = render(rig, mounting, static)
    return [rest if mover is None else render(rig, mounting, [*static, mover]) for mover in movers]


def off_surfaces(cloud: PointCloud, boxes: Sequence[Box], mounting: Mounting = MOUNTING) -> FloatArray:
    """Return how far points are from the nearest surface, in their standard deviations along the line of sight."""
    points = mounting.to_road(cloud.points)
    distance = np.minimum.reduce([np.abs(points[:, 2]), *(box.distance(points) for box in boxes)])
    off: FloatArray = distance / np.hypot(cloud.sigma_along_m, cloud.sigma_across_m)
    return off


def box_points(cloud: PointCloud, above_m: float = 0.3, mounting: Mounting = MOUNTING) -> PointCloud:
    """Return what stands above the road."""
    return cloud[mounting.to_road(cloud.points)[:, 2] > np.maximum(above_m, 2 * cloud.sigma_along_m)]
