"""A simulated box detector: the exact boxes of all moving objects of a scene, with noise, and with some missing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.detections import DetectionLog
from laci_stereo.core.frames import Axes, FloatArray, IntArray, invert, transform
from tools.scenes.scene import Scene, own_axes
from tools.scenes.traffic import Mover

REACH_M = 60.0


@dataclass(frozen=True)
class DetectorFlaws:
    """Errors of the boxes: standard deviations, and the fraction of boxes that are missing.

    ``size_share`` is the error, as a fraction of the size, that all boxes of one object share.
    """

    position_m: float = 0.1
    yaw_deg: float = 2.0
    size_m: float = 0.1
    missing: float = 0.2
    size_share: float = 0.05


def detect(scene: Scene, flaws: DetectorFlaws | None = None) -> DetectionLog:
    """Return the boxes, without track numbers, of all movers in the field of view within `REACH_M`, hidden or not."""
    flaws = flaws or DetectorFlaws()
    rng = np.random.default_rng([scene.seed, 13])
    movers = (scene.sender, *scene.others)
    parts = [_boxes(scene, mover, flaws, rng) for mover in movers]
    stamps = np.concatenate([scene.stamps_ns[frames] for frames, _ in parts])
    values = np.concatenate([boxes for _, boxes in parts])
    order = np.argsort(stamps, kind="stable")
    points, yaw, size = values[:, :3], values[:, 3], values[:, 4:]
    unknown = np.full(len(stamps), np.nan)
    nobody = np.full(len(stamps), -1)
    return DetectionLog(stamps, points, size[:, 2] / 2, yaw, size[:, 0], size[:, 1], nobody, unknown)[order]


def _boxes(
    scene: Scene, mover: Mover, flaws: DetectorFlaws, rng: np.random.Generator
) -> tuple[IntArray, FloatArray]:  # fmt: skip
    """Return the frames of a mover's boxes, and (x, y, z, yaw, length, width, height), shape (n, 7)."""
    n = len(scene.times_s)
    height_m = float(mover.mesh.vertices[:, 2].max())
    poses = np.stack([mover.pose(time_s) for time_s in scene.times_s.tolist()])
    middles = poses[:, :3, 3] + poses[:, :3, 2] * height_m / 2
    points = transform(invert(scene.T_world_sensor), middles)
    seen = scene.sensor.sees(transform(invert(own_axes(scene)), points)) & (np.linalg.norm(points, axis=1) < REACH_M)
    seen &= rng.random(n) >= flaws.missing
    yaw = yaw_about(scene.axes, poses[:, :3, 0] @ scene.T_world_sensor[:3, :3])
    size = np.array([mover.length_m, mover.width_m, height_m]) * (1.0 + flaws.size_share * rng.normal(size=3))
    size = size + flaws.size_m * rng.normal(size=(n, 3))
    points = points + flaws.position_m * rng.normal(size=(n, 3))
    yaw = yaw + np.radians(flaws.yaw_deg) * rng.normal(size=n)
    return np.flatnonzero(seen), np.column_stack([points, yaw, np.maximum(size, 0.05)])[seen]


def yaw_about(axes: Axes, ahead: FloatArray) -> FloatArray:
    """Return the yaw of vectors in the sensor frame, shape (n, 3), as `DetectionLog` defines it."""
    upright = int(np.argmax(np.abs(axes.up)))
    zero = np.eye(3)[1 if upright == 0 else 0]
    aside = np.cross(np.eye(3)[upright], zero)
    yaw: FloatArray = np.arctan2(ahead @ aside, ahead @ zero)
    return yaw
