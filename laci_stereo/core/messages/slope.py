"""The slope of the road, estimated from the altitudes of drives, and its effect on distances on the map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from laci_stereo.core.frames import FloatArray, rigid
from laci_stereo.core.robust import NORMAL, TUKEY

ALONG_SIGMA, ACROSS_SIGMA = 0.10, 0.025
"""Prior standard deviations of the slope along and across a road: 10 % along it is steep; across it falls by 2.5 % to
drain. A road is taken as level only if the altitudes would show a slope of the latter size along it."""

ALTITUDE_SIGMA_M = 0.05
"""Least standard deviation of an altitude relative to those around it: that of receivers with corrections."""

HEIGHT_SIGMA_M = 1000.0
"""Prior standard deviation of the offset of a receiver's altitudes: nothing is known about it."""

STRETCH_M = 10.0
"""Correlation length of the errors of altitudes along the path."""

STEEPEST = 3.0 * ALONG_SIGMA
"""Steepest slope between two messages; what altitudes change beyond that and their noise is a step of the receiver's,
as when it changes to another solution."""

STEP_SIGMAS = 4.0
"""Least size of such a step, in standard deviations of the difference of two altitudes."""

FALSE_ALARM = 0.003
"""Probability that a level road is mistaken for a slope: three standard deviations."""

HUBER = 1.345
"""Tuning constant in standard deviations, for 95 % efficiency on normal noise (Huber 1981)."""

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
    each receiver have an offset of their own, another one after each step, and outliers are given a small weight
    (Huber), then none (Tukey).

    Parameters
    ----------
    drives : sequence of (ndarray, shape (n, 2); ndarray, shape (n,))
        Positions of each drive, metres on the map, and the altitudes there, metres; NaN where not reported.
    """
    told = [part for xy, z in drives if (known := np.isfinite(z)).any() for part in _parted(xy[known], z[known])]
    if not told:
        return None
    xy, z = (np.concatenate(each) for each in zip(*told, strict=True))
    counts = [len(each) for _, each in told]
    drive = np.repeat(np.arange(len(told)), counts)
    driven_m = np.array([np.linalg.norm(np.diff(each, axis=0), axis=1).sum() for each, _ in told])
    worth = np.minimum(1.0, np.maximum(driven_m / STRETCH_M, 1.0) / counts)[drive]
    spare = float(worth.sum()) - len(told) - 1.0  # beyond the offsets and the slope along
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


def _parted(xy: FloatArray, z: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
    """Divide a drive, positions of shape (n, 2) and altitudes of shape (n,), where its altitudes step.

    What comes back from an excursion of less than `STRETCH_M` belongs to what was before.
    """
    way_m = np.append(0.0, np.linalg.norm(np.diff(xy, axis=0), axis=1).cumsum())
    noise_m = max(np.sqrt(2.0) * ALTITUDE_SIGMA_M, NORMAL * float(np.median(np.abs(np.diff(z)))) if len(z) > 1 else 0.0)
    least_m = _digit_m(z) + STEP_SIGMAS * noise_m  # two rounded values are apart by up to one digit more
    part = np.zeros(len(z), dtype=int)
    ends: list[int] = []  # the last message of each part
    for new in range(len(z)):
        near = [end for end in ends if end == new - 1 or way_m[new] - way_m[end] < STRETCH_M]
        fits = [end for end in near if abs(z[new] - z[end]) <= least_m + STEEPEST * (way_m[new] - way_m[end])]
        part[new] = part[max(fits)] if fits else len(ends)
        ends[part[new] : part[new] + 1] = [new]
    return [(xy[part == each], z[part == each]) for each in range(len(ends))]


def _digit_m(z: FloatArray) -> float:
    """Return the value of the last decimal digit to which altitudes are rounded, from 1 m down to 1 mm."""
    digits = (digit for digit in (1.0, 0.1, 0.01) if np.allclose(z / digit, np.rint(z / digit), 0.0, 1e-3))
    return next(digits, 1e-3)


def _solved(rows: FloatArray, z: FloatArray, weight: FloatArray, prior: FloatArray) -> tuple[FloatArray, FloatArray]:
    covariance: FloatArray = np.linalg.inv(rows.T @ (weight[:, None] * rows) + prior)
    return covariance @ rows.T @ (weight * z), covariance
