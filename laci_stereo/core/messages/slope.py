"""The slope of the road, estimated from the altitudes of drives, and its effect on distances on the map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from laci_stereo.core.frames import FloatArray, rigid
from laci_stereo.core.robust import NORMAL

ALONG_SIGMA, ACROSS_SIGMA = 0.10, 0.025
"""Prior standard deviations of the slope along and across a road: 10 % along it is steep; across it falls by 2.5 % to
drain. A road is taken as level only if the altitudes would show a slope of the latter size along it."""

ALTITUDE_SIGMA_M = 0.05
"""Least standard deviation of an altitude relative to those around it: that of receivers with corrections."""

HEIGHT_SIGMA_M = 1000.0
"""Prior standard deviation of the offset of a receiver's altitudes: nothing is known about it."""

STRETCH_M = 10.0
"""Correlation length of the errors of altitudes along the path."""

FALSE_ALARM = 0.003
"""Probability that a level road is mistaken for a slope: three standard deviations."""

HUBER, TUKEY = 1.345, 4.685
"""Tuning constants in standard deviations, with 95 % of the efficiency of least squares without outliers (Huber 1981,
Tukey)."""

HUBER_STEPS, TUKEY_STEPS = 30, 10
"""Numbers of reweighting steps: each Huber step reduces the influence of outliers at least by a factor, from hundreds
of metres down to a few standard deviations."""


@dataclass(frozen=True)
class Slope:
    """A ground plane, sloping or level.

    The world's x and y are true distances along the ground. On the map, which is horizontal, distances uphill are
    shorter by the cosine of the slope's angle: 7 cm in 60 m at 5 %. Both agree at ``pivot``.

    Attributes
    ----------
    gradient : ndarray, shape (2,)
        Metres of altitude per metre on the map, towards grid east and north; 0 where the road is level.
    covariance : ndarray, shape (2, 2)
        Covariance of the gradient.
    pivot : ndarray, shape (2,)
        Position in the world: the middle of the vehicle's track, once that is known.
    """

    gradient: FloatArray
    covariance: FloatArray
    pivot: FloatArray

    @property
    def steepness(self) -> float:
        """The tangent of the slope's angle."""
        return float(np.hypot(*self.gradient))

    @property
    def _longer(self) -> float:
        """Ratio of a distance along the ground, straight uphill, to the same distance on the map."""
        return float(np.hypot(1.0, self.steepness))

    def along_ground(self, xy_map: FloatArray) -> FloatArray:
        """Return positions along the ground, shape (n, 2), from those on the map, shape (n, 2), metres."""
        rise = (xy_map - self.pivot) @ self.gradient
        along: FloatArray = xy_map + rise[:, None] * self.gradient / (1.0 + self._longer)
        return along

    def on_map(self, xy_ground: FloatArray) -> FloatArray:
        """Return positions on the map, shape (n, 2), from those along the ground, shape (n, 2), metres."""
        rise = (xy_ground - self.pivot) @ self.gradient
        on_map: FloatArray = xy_ground - rise[:, None] * self.gradient / (self._longer * (1.0 + self._longer))
        return on_map

    def yaw_along_ground(self, yaw_map_rad: FloatArray) -> FloatArray:
        """Return yaws along the ground from those on the map, shape (n,), without changing how they are unwrapped."""
        return self._turned(yaw_map_rad, self.along_ground)

    def yaw_on_map(self, yaw_ground_rad: FloatArray) -> FloatArray:
        """Return yaws on the map from those along the ground, shape (n,), without changing how they are unwrapped."""
        return self._turned(yaw_ground_rad, self.on_map)

    def _turned(self, yaw_rad: FloatArray, lay: Callable[[FloatArray], FloatArray]) -> FloatArray:
        ahead = np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad)])
        laid = lay(self.pivot + ahead) - self.pivot
        beside = ahead[:, 0] * laid[:, 1] - ahead[:, 1] * laid[:, 0]
        yaw: FloatArray = yaw_rad + np.arcsin(beside / np.linalg.norm(laid, axis=1))
        return yaw

    @property
    def T_enu_world(self) -> FloatArray:
        """The transform, shape (4, 4), into grid east, grid north and up against gravity, with the world's origin.

        It rotates about the pivot, where z is 0 on the ground. Points on the ground are mapped to their positions on
        the map.
        """
        R = np.eye(3)
        R[:2, :2] -= np.outer(self.gradient, self.gradient) / (self._longer * (1.0 + self._longer))
        R[:2, 2], R[2, :2], R[2, 2] = -self.gradient / self._longer, self.gradient / self._longer, 1.0 / self._longer
        pivot = np.append(self.pivot, 0.0)
        return rigid(R, pivot - R @ pivot)


def slope_of(drives: Sequence[tuple[FloatArray, FloatArray]]) -> Slope | None:
    """Return the slope of the ground below the given drives, 0 if it is level; None if their altitudes leave it open.

    A drive determines the slope along itself; across it the prior remains, unless the drive turns. The altitudes of
    each receiver have an offset of their own, and outliers are given a small weight (Huber), then none (Tukey).

    Parameters
    ----------
    drives : sequence of (ndarray, shape (n, 2); ndarray, shape (n,))
        Positions of each drive, metres on the map, and the altitudes there, metres; NaN where not reported.
    """
    told = [(xy[known], z[known]) for xy, z in drives if (known := np.isfinite(z)).any()]
    if not told:
        return None
    xy, z = (np.concatenate(each) for each in zip(*told, strict=True))
    counts = [len(each) for _, each in told]
    drive = np.repeat(np.arange(len(told)), counts)
    driven_m = np.array([np.linalg.norm(np.diff(each, axis=0), axis=1).sum() for each, _ in told])
    worth = np.minimum(1.0, np.maximum(driven_m / STRETCH_M, 1.0) / counts)[drive]
    spare = float(worth.sum()) - len(told) - 1.0  # beyond the receivers' offsets and the slope along
    if spare <= 0.0:
        return None
    pivot = xy.mean(axis=0)
    _, _, axes = np.linalg.svd(np.concatenate([each - each.mean(axis=0) for each, _ in told]), full_matrices=False)
    rows = np.column_stack([xy - pivot, np.eye(len(told))[drive]])
    prior = np.eye(rows.shape[1]) / HEIGHT_SIGMA_M**2
    prior[:2, :2] = axes.T @ np.diag([ALONG_SIGMA**-2, ACROSS_SIGMA**-2]) @ axes
    z = z - np.array([np.median(each) for _, each in told])[drive]
    weight = worth
    for step in range(HUBER_STEPS + TUKEY_STEPS):
        solution, _ = _solved(rows, z, weight / ALTITUDE_SIGMA_M**2, prior)
        rest = np.abs(z - rows @ solution)
        spread = NORMAL * float(np.median(rest))
        off = rest / max(ALTITUDE_SIGMA_M, spread)
        kept = HUBER / np.maximum(off, HUBER) if step < HUBER_STEPS else np.maximum(1.0 - (off / TUKEY) ** 2, 0.0) ** 2
        weight = worth * kept
    sigma = max(ALTITUDE_SIGMA_M, spread * np.sqrt(worth.sum() / spare))
    solution, covariance = _solved(rows, z, weight / sigma**2, prior)
    gradient, covariance = solution[:2], covariance[:2, :2]
    surely = chdtri(2, FALSE_ALARM)
    if gradient @ np.linalg.solve(covariance, gradient) < surely:
        if surely * (axes[0] @ covariance @ axes[0]) > ACROSS_SIGMA**2:
            return None
        gradient = np.zeros(2)
    return Slope(gradient, covariance, pivot)


def _solved(rows: FloatArray, z: FloatArray, weight: FloatArray, prior: FloatArray) -> tuple[FloatArray, FloatArray]:
    covariance: FloatArray = np.linalg.inv(rows.T @ (weight[:, None] * rows) + prior)
    return covariance @ rows.T @ (weight * z), covariance
