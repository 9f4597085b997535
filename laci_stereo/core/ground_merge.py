"""Ground planes of one sensor as vectors near the first one: two components of the normal, and the height."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from laci_stereo.core.frames import FloatArray
from laci_stereo.core.ground import GroundPlane


@dataclass(frozen=True)
class Chart:
    """Coordinates of planes near one plane.

    Attributes
    ----------
    ground : GroundPlane
    across : ndarray, shape (3, 2)
        Two unit vectors along it, sensor frame.
    """

    ground: GroundPlane
    across: FloatArray

    @staticmethod
    def around(ground: GroundPlane) -> Chart:
        """Lay two axes into a plane."""
        one = _unit(np.cross(ground.normal, np.eye(3)[int(np.abs(ground.normal).argmin())]))
        return Chart(ground, np.column_stack([one, np.cross(ground.normal, one)]))

    def values(self, planes: Sequence[GroundPlane]) -> FloatArray:
        """Return (normal along ``across``, height) of n planes, shape (n, 3)."""
        return np.array([[*(plane.normal @ self.across), plane.height_m] for plane in planes])

    def covariance(self, plane: GroundPlane) -> FloatArray:
        """Return the covariance of such a vector, shape (3, 3)."""
        # A turn by r moves the normal by normal x r; see `fit_ground`.
        by = np.zeros((3, 4))
        by[:2, :3] = self.across.T @ np.cross(plane.normal, np.eye(3)).T
        by[2, 3] = 1.0
        covariance: FloatArray = by @ plane.covariance_sensor @ by.T
        return covariance

    def plane(self, value: FloatArray, covariance: FloatArray) -> GroundPlane:
        """Return the plane with these coordinates; its support is that of the chart's."""
        normal = _unit(self.ground.normal + self.across @ (value[:2] - self.ground.normal @ self.across))
        to_turn = np.zeros((4, 3))
        to_turn[:3, :2] = np.cross(self.across.T, normal).T
        to_turn[3, 2] = 1.0
        sensor = to_turn @ covariance @ to_turn.T
        return replace(self.ground, normal=normal, height_m=float(value[2]), covariance_sensor=sensor)


def _unit(vector: FloatArray) -> FloatArray:
    unit: FloatArray = vector / np.linalg.norm(vector)
    return unit
