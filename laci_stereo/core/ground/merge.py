"""Local coordinates of ground planes of one sensor: two components of the normal, and the height."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from laci_stereo.core.frames import FloatArray
from laci_stereo.core.ground.plane import GroundPlane


@dataclass(frozen=True)
class Chart:
    """Local coordinates of planes near a reference plane.

    Attributes
    ----------
    ground : GroundPlane
        The reference plane.
    across : ndarray, shape (3, 2)
        Two orthogonal unit vectors in the reference plane, sensor frame, as columns.
    """

    ground: GroundPlane
    across: FloatArray

    @staticmethod
    def around(ground: GroundPlane) -> Chart:
        """Return a chart with two orthogonal axes in the reference plane ``ground``."""
        one = _unit(np.cross(ground.normal, np.eye(3)[int(np.abs(ground.normal).argmin())]))
        return Chart(ground, np.column_stack([one, np.cross(ground.normal, one)]))

    def values(self, planes: Sequence[GroundPlane]) -> FloatArray:
        """Return the coordinates of n planes, shape (n, 3): components of the normal along ``across``, and height."""
        return np.array([[*(plane.normal @ self.across), plane.height_m] for plane in planes])

    def covariance(self, plane: GroundPlane) -> FloatArray:
        """Return the covariance of a plane's coordinates, shape (3, 3)."""
        # A rotation of the coordinates by r moves the normal by normal x r; see `GroundPlane`.
        by = np.zeros((3, 4))
        by[:2, :3] = self.across.T @ np.cross(plane.normal, np.eye(3)).T
        by[2, 3] = 1.0
        covariance: FloatArray = by @ plane.covariance_sensor @ by.T
        return covariance

    def plane(self, value: FloatArray, covariance: FloatArray) -> GroundPlane:
        """Return the plane with the given coordinates and covariance; its support is that of the reference plane."""
        normal = _unit(self.ground.normal + self.across @ (value[:2] - self.ground.normal @ self.across))
        to_turn = np.zeros((4, 3))
        to_turn[:3, :2] = np.cross(self.across.T, normal).T
        to_turn[3, 2] = 1.0
        sensor = to_turn @ covariance @ to_turn.T
        return replace(self.ground, normal=normal, height_m=float(value[2]), covariance_sensor=sensor)


def _unit(vector: FloatArray) -> FloatArray:
    unit: FloatArray = vector / np.linalg.norm(vector)
    return unit
