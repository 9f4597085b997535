"""Where a calibration says that its sensor is, and by how much its errors move what lies on the ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, rotate_xy


@dataclass(frozen=True)
class Placed:
    """A sensor's place as a calibration claims it.

    Attributes
    ----------
    T_world_sensor : ndarray, shape (4, 4)
    covariance : ndarray, shape (6, 6)
        Of (rotation vector, rad; translation, m), applied on the left in the world frame about ``centre_world``.
    centre_world : ndarray, shape (3,)
    boxes : ndarray, shape (n, 6)
        The static background, world: centre x and y, length, width, yaw, height.
    """

    T_world_sensor: FloatArray
    covariance: FloatArray
    centre_world: FloatArray
    boxes: FloatArray

    @property
    def origin(self) -> FloatArray:
        """Where the sensor is, world, shape (3,)."""
        return self.T_world_sensor[:3, 3]

    def hidden(self, xy: FloatArray) -> BoolArray:
        """Tell which points of the ground, shape (n, 2), world, a box of the background hides from the sensor."""
        hidden = np.zeros(len(xy), dtype=bool)
        for box in self.boxes:
            hidden |= _behind(self.origin, xy, box)
        return hidden

    def lengthening(self, xy: FloatArray) -> FloatArray:
        """Return by how much points of the ground, shape (n, 2), seem to move if they are a metre higher than thought.

        Returns
        -------
        ndarray, shape (n, 2)
            Metres on the ground, away from the sensor.
        """
        moved: FloatArray = (xy - self.origin[:2]) / self.origin[2]
        return moved

    def jacobian(self, xy: FloatArray) -> FloatArray:
        """Return the derivative, shape (n, 2, 6), of where ground points, shape (n, 2), are put by the six of the pose.

        A point that is lifted off the ground is seen where its ray meets the ground.
        """
        arm = np.column_stack([xy, np.zeros(len(xy))]) - self.centre_world
        moved = np.zeros((len(xy), 3, 6))
        for axis in range(3):
            moved[:, :, axis] = np.cross(np.eye(3)[axis], arm)
            moved[:, axis, 3 + axis] = 1.0
        along = self.lengthening(xy)
        return moved[:, :2] + along[:, :, None] * moved[:, 2:, :]


def _behind(eye: FloatArray, xy: FloatArray, box: FloatArray) -> BoolArray:
    """Tell for which ground points the line of sight passes through a box (slabs in the box's own axes)."""
    centre, half, yaw_rad, height_m = box[:2], box[2:4] / 2, float(box[4]), float(box[5])
    start = rotate_xy(-yaw_rad, eye[:2] - centre)
    step = rotate_xy(-yaw_rad, xy - centre) - start
    with np.errstate(divide="ignore", invalid="ignore"):
        one, other = (-half - start) / step, (half - start) / step
    enter = np.fmax.reduce(np.minimum(one, other), axis=1)
    leave = np.fmin.reduce(np.maximum(one, other), axis=1)
    # The line of sight falls from the eye's height at 0 to the ground at 1; below the box's top only its last part is.
    below_top = 1.0 - height_m / eye[2] if eye[2] > 0 else 0.0
    enter = np.maximum(enter, below_top)
    through: BoolArray = (enter < np.minimum(leave, 1.0)) & (leave > 0.0)
    return through
