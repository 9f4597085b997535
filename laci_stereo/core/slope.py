"""Whether the road slopes, by the altitudes of a drive, and what that does to distances on the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from laci_stereo.core.frames import FloatArray, rigid

ALONG_SIGMA, ACROSS_SIGMA = 0.10, 0.025
"""What slopes are usual: 10 % along a road is steep; across it falls by 2.5 % to drain."""

ALTITUDE_SIGMA_M = 0.05
"""Of altitudes against those around them, at the least: receivers with corrections."""

STRETCH_M = 10.0
"""Altitudes nearer to one another than that err together."""

FALSE_ALARM = 0.003
"""So seldom is a level road taken for a slope: three sigma."""


@dataclass(frozen=True)
class Slope:
    """A sloping ground plane.

    The world's x and y are true along the ground. On the map, which is level, what lies uphill is nearer by the cosine
    of the slope's angle: 7 cm in 60 m at 5 %. Both agree at ``pivot``.

    Attributes
    ----------
    gradient : ndarray, shape (2,)
        Metres of altitude per metre on the map, towards grid east and north.
    covariance : ndarray, shape (2, 2)
        Of the gradient.
    pivot : ndarray, shape (2,)
        In the world: the middle of the drive.
    """

    gradient: FloatArray
    covariance: FloatArray
    pivot: FloatArray

    @property
    def steepness(self) -> float:
        """The tangent of the slope's angle."""
        return float(np.hypot(*self.gradient))

    def along_ground(self, xy_map: FloatArray) -> FloatArray:
        """Return where positions on the map, shape (n, 2), metres, are along the ground."""
        ahead = xy_map - self.pivot
        uphill = self.gradient / self.steepness
        stretch = np.hypot(1.0, self.steepness) - 1.0
        along: FloatArray = xy_map + stretch * (ahead @ uphill)[:, None] * uphill
        return along

    def yaw_along_ground(self, yaw_map_rad: FloatArray) -> FloatArray:
        """Return directions on the map, shape (n,), as they are along the ground, unwrapped as they were."""
        ahead = np.column_stack([np.cos(yaw_map_rad), np.sin(yaw_map_rad)])
        along = self.along_ground(self.pivot + ahead) - self.pivot
        beside = ahead[:, 0] * along[:, 1] - ahead[:, 1] * along[:, 0]
        yaw: FloatArray = yaw_map_rad + np.arcsin(beside / np.linalg.norm(along, axis=1))
        return yaw

    @property
    def T_enu_world(self) -> FloatArray:
        """The transform, shape (4, 4), into grid east, grid north and up against gravity, with the world's origin.

        It turns about the pivot, where z is 0 on the ground.
        """
        cos = 1.0 / np.hypot(1.0, self.steepness)
        sin = self.steepness * cos
        x, y = self.gradient / self.steepness
        from_uphill = np.array([[x, -y, 0.0], [y, x, 0.0], [0.0, 0.0, 1.0]])
        tilted = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
        R = from_uphill @ tilted @ from_uphill.T
        pivot = np.append(self.pivot, 0.0)
        return rigid(R, pivot - R @ pivot)


def slope_of(xy_map: FloatArray, altitude_m: FloatArray) -> Slope | None:
    """Return the slope of the ground below a drive; None where altitudes are not told, or tell no slope.

    A drive tells the slope along itself; across, what is usual holds unless it turns.

    Parameters
    ----------
    xy_map : ndarray, shape (n, 2)
        Metres on the map.
    altitude_m : ndarray, shape (n,)
        NaN where not told.
    """
    told = np.isfinite(altitude_m)
    if np.count_nonzero(told) < 3:
        return None
    xy, z = xy_map[told], altitude_m[told]
    pivot = xy.mean(axis=0)
    _, _, axes = np.linalg.svd(xy - pivot, full_matrices=False)
    prior = axes.T @ np.diag([ALONG_SIGMA**-2, ACROSS_SIGMA**-2]) @ axes
    ahead = np.column_stack([np.ones(len(xy)), xy - pivot])
    sigma = ALTITUDE_SIGMA_M
    driven_m = float(np.linalg.norm(np.diff(xy, axis=0), axis=1).sum())
    worth = min(1.0, max(driven_m / STRETCH_M, 1.0) / len(xy))
    for _ in range(3):  # the noise is told by what remains
        information = worth * ahead.T @ ahead / sigma**2
        information[1:, 1:] += prior
        level = np.median(z)
        solution = np.linalg.solve(information, worth * ahead.T @ (z - level) / sigma**2)
        rest = z - level - ahead @ solution
        sigma = max(ALTITUDE_SIGMA_M, 1.4826 * float(np.median(np.abs(rest))))
    gradient, covariance = solution[1:], np.linalg.inv(information)[1:, 1:]
    if gradient @ np.linalg.solve(covariance, gradient) < chdtri(2, FALSE_ALARM):
        return None
    return Slope(gradient, np.asarray(covariance, dtype=np.float64), pivot)
