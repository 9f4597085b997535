"""Whether a drive is suitable for calibration, by the ground truth."""

from __future__ import annotations

import numpy as np

from laci_stereo.core.frames import FloatArray, rotate_xy
from tools.scenes.scene import Scene

GOOD_FRAMES = 40
GOOD_SIDES = 2
GOOD_TURN_DEG = 30.0
GOOD_CHANGE = 0.1
"""Change of speed relative to the largest speed of the drive."""

OBLIQUE_DEG = 10.0
"""Seen at less than this angle to its plane, a side appears a sixth of its length wide: it does not count as seen."""

SIDE_FRAMES = 10
"""A side that is seen in fewer frames, a quarter of the frames needed, does not count."""


def is_good(scene: Scene) -> bool:
    """Return whether a calibration can be expected: the sender is long in view, from two sides, and turns or brakes.

    It is in view in `GOOD_FRAMES` frames, in which `GOOD_SIDES` of its sides are seen, and it turns by `GOOD_TURN_DEG`
    or changes its speed by `GOOD_CHANGE`.
    """
    if scene.seen < GOOD_FRAMES or sides_seen(scene) < GOOD_SIDES:
        return False
    return turned_deg(scene) >= GOOD_TURN_DEG or speed_change(scene) >= GOOD_CHANGE


def sides_seen(scene: Scene) -> int:
    """Count the sides, of front, rear, left and right, that face the sensor in enough of the frames in view."""
    xy, yaw = scene.sender.track(scene.times_s[scene.in_view])
    sensor = rotate_xy(-yaw, scene.T_world_sensor[:2, 3] - xy)
    half = np.array([scene.sender.length_m, scene.sender.width_m]) / 2
    # Distance of the sensor in front of each side's plane, over its distance: the sine of the angle off the plane.
    before = np.concatenate([sensor - half, -sensor - half], axis=1) / np.linalg.norm(sensor, axis=1, keepdims=True)
    facing = before > np.sin(np.radians(OBLIQUE_DEG))
    return int((facing.sum(axis=0) >= SIDE_FRAMES).sum())


def turned_deg(scene: Scene) -> float:
    """Return the angle between the sender's extreme headings while it is in view."""
    _, yaw = scene.sender.track(scene.times_s[scene.in_view])
    return float(np.degrees(np.ptp(np.unwrap(yaw))))


def speed_change(scene: Scene) -> float:
    """Return the difference of the sender's extreme speeds while it is in view, over the larger."""
    speed = _speed_mps(scene)[scene.in_view]
    return float(np.ptp(speed) / max(float(speed.max()), 1e-9))


def _speed_mps(scene: Scene) -> FloatArray:
    # From times close to each frame: motion while out of view must not count.
    step_s = 0.01
    ahead, behind = (scene.sender.track(scene.times_s + shift)[0] for shift in (step_s, -step_s))
    speed: FloatArray = np.linalg.norm(ahead - behind, axis=1) / (2 * step_s)
    return speed
