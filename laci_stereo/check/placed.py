"""Pose of a sensor according to its calibration, and the displacement of ground points by errors of that pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, rotate_xy


@dataclass(frozen=True)
class Placed:
    """Pose of a sensor, with its covariance, as a calibration claims it.

    Attributes
    ----------
    T_world_sensor : ndarray, shape (4, 4)
    covariance : ndarray, shape (6, 6)
        Covariance of (rotation vector, rad; translation, m), applied on the left in the world frame about
        ``centre_world``.
    centre_world : ndarray, shape (3,)
    boxes : ndarray, shape (n, 6)
        Boxes of the static background, world: centre x and y, length, width, yaw, height.
    """

    T_world_sensor: FloatArray
    covariance: FloatArray
    centre_world: FloatArray
    boxes: FloatArray

    @property
    def origin(self) -> FloatArray:
        """Position of the sensor, world, shape (3,)."""
        return self.T_world_sensor[:3, 3]

    def hidden(self, xy: FloatArray) -> BoolArray:
        """Return which ground points, shape (n, 2), world, are hidden from the sensor by a box of the background."""
        hidden = np.zeros(len(xy), dtype=bool)
        for box in self.boxes:
            hidden |= _behind(self.origin, xy, box)
        return hidden

    def lengthening(self, xy: FloatArray) -> FloatArray:
        """Return the apparent displacement of ground points, shape (n, 2), per metre that they are higher than assumed.

        Returns
        -------
        ndarray, shape (n, 2)
            Metres on the ground per metre of height, away from the sensor.
        """
        moved: FloatArray = (xy - self.origin[:2]) / self.origin[2]
        return moved

    def jacobian(self, xy: FloatArray) -> FloatArray:
        """Return the derivatives, shape (n, 2, 6), of ground points' positions, shape (n, 2), by the pose parameters.

        A point that is moved off the ground appears where its ray meets the ground.
        """
        arm = np.column_stack([xy, np.zeros(len(xy))]) - self.centre_world
        moved = np.zeros((len(xy), 3, 6))
        for axis in range(3):
            moved[:, :, axis] = np.cross(np.eye(3)[axis], arm)
            moved[:, axis, 3 + axis] = 1.0
        along = self.lengthening(xy)
        return moved[:, :2] + along[:, :, None] * moved[:, 2:, :]


def _behind(eye: FloatArray, xy: FloatArray, box: FloatArray) -> BoolArray:
    """Return for which ground points the line of sight passes through a box (slab test in the box's own axes)."""
    centre, half, yaw_rad, height_m = box[:2], box[2:4] / 2, float(box[4]), float(box[5])
    start = rotate_xy(-yaw_rad, eye[:2] - centre)
    step = rotate_xy(-yaw_rad, xy - centre) - start
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (-half - start) / step, (half - start) / step
    enter = np.fmax.reduce(np.minimum(one, other), axis=1)
    leave = np.fmin.reduce(np.maximum(one, other), axis=1)
    # The line of sight descends from the eye at 0 to the ground at 1; only its last part is below the box's top.
    below_top = 1.0 - height_m / eye[2] if eye[2] > 0 else 0.0
    enter = np.maximum(enter, below_top)
    through: BoolArray = (enter < np.minimum(leave, 1.0)) & (leave > 0.0)
    return through
