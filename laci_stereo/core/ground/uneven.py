"""The uncertainty of the ground plane due to the unevenness of the road.

ISO 8608 gives the spectrum of a road's height as G (n / n0)^-2 over the wave number n, with n0 = 0.1 / m. A random
field with the covariance u^2 exp(-distance / l) has the spectrum u^2 / (pi^2 l n^2) for waves shorter than a few l, so
it models such a road if u^2 = pi^2 l n0^2 G. Where the noise is small enough, u is estimated from the heights; where it
is not, the prior for paved roads dominates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import FloatArray
from laci_stereo.core.robust import STUDENT
from laci_stereo.core.tracking.cluster import cells_of

# Correlation length l: a road falls from its crown to its gutter, so heights are correlated over about half its width.
REACH_M = 7.0
N0_PER_M = 0.1
# u of class B, a good paved road: G = 64e-6 m^3.
CLASS_B_M = float(np.sqrt(np.pi**2 * REACH_M * N0_PER_M**2 * 64e-6))
# u of class C, the most uneven class of paved roads by ISO 8608; a larger value indicates more than one surface.
ONE_SURFACE_M = 2.0 * CLASS_B_M
# Classes from B on, in steps of half a class; each class has four times the G of the previous one. Paved roads are of
# class A to C, which is taken as one standard deviation.
_CLASSES = np.arange(-3.0, 3.1, 0.5)
_TRIED_M = CLASS_B_M * 2.0**_CLASSES
# The noise is not known exactly either: factors of its variance, all equally likely a priori.
_NOISES = 2.0 ** np.arange(-2.0, 2.1, 0.5)
# Number of patches, each of which is then much smaller than the visible ground.
_PATCHES = 100
# Number of places along the side of a square that represent the whole side.
_ALONG_SIDE = 4
# Scale of Student's t in units of a Gaussian's variance: the c for which the mean of 5 z^2 / (4 c + z^2) over a
# standard Gaussian z is 1, so that the variance of heights without outliers is estimated without bias.
_SCALE = 0.69


@dataclass(frozen=True)
class Patches:
    """Means over square patches of the plane.

    Attributes
    ----------
    place_m : ndarray, shape (k, 2)
        Position on the plane, in axes along the squares' sides.
    side_m : float
        Side of each square.
    height_m, variance_m2 : ndarray, shape (k,)
        Mean height above the plane, and its variance due to noise.
    lift : ndarray, shape (k, 3)
        Derivative of m with respect to the height of each patch.
    slope_m : ndarray, shape (k, 3)
        Negative derivative of each patch's height above the plane with respect to m.
    """

    place_m: FloatArray
    side_m: float
    height_m: FloatArray
    variance_m2: FloatArray
    lift: FloatArray
    slope_m: FloatArray


def patches_of(
    m: FloatArray,
    direction: FloatArray,
    area_m2: FloatArray,
    residual: FloatArray,
    variance: FloatArray,
    weight: FloatArray,
    gain: FloatArray,
) -> Patches:
    """Group cells of the ground into patches.

    Parameters
    ----------
    m : ndarray, shape (3,)
        The plane, see `laci_stereo.core.ground.rays`.
    direction : ndarray, shape (n, 3)
        Mean direction of each cell's rays.
    area_m2 : ndarray, shape (n,)
        Area of each cell on the plane.
    residual, variance : ndarray, shape (n,)
        Mean of measured minus predicted 1 / range in each cell, and its variance due to noise.
    weight : ndarray, shape (n,)
        Weight of each cell from 0 to 1, 0 where a cell is not ground.
    gain : ndarray, shape (n, 3)
        Derivative of m with respect to each cell's residual.
    """
    ground = weight > 0.0
    direction, residual, gain = direction[ground], residual[ground], gain[ground]
    variance, weight = variance[ground], weight[ground]
    inverse = direction @ m
    per_metre = np.linalg.norm(m) * inverse
    normal = -m / np.linalg.norm(m)
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(normal)))], normal)
    x /= np.linalg.norm(x)
    place_m = direction @ np.stack([x, np.cross(normal, x)], axis=1) / inverse[:, None]
    side_m = np.sqrt(area_m2[ground].sum() / _PATCHES)
    patch = np.unique(cells_of(place_m, side_m), return_inverse=True)[1].reshape(-1)
    share = weight / variance * per_metre**2
    total = np.bincount(patch, share)

    def sums(columns: FloatArray) -> FloatArray:
        return np.stack([np.bincount(patch, column) for column in columns.T], axis=1)

    return Patches(
        place_m=sums(share[:, None] * place_m) / total[:, None],
        side_m=float(side_m),
        height_m=np.bincount(patch, share * residual / per_metre) / total,
        variance_m2=np.bincount(patch, weight * share) / total**2,
        lift=sums(gain * per_metre[:, None]),
        slope_m=sums(direction * (share / per_metre)[:, None]) / total[:, None],
    )


def covariance_of_unevenness(patches: Patches) -> FloatArray:
    """Return the covariance of m due to unevenness, shape (3, 3), averaged over the posterior of the unevenness."""
    together = _common(patches.place_m, patches.side_m)
    # In units of the noise, and without the components that a plane absorbs; modes of the unevenness are independent.
    per_sigma = 1.0 / np.sqrt(patches.variance_m2)
    plane = np.linalg.qr(per_sigma[:, None] * patches.slope_m)[0]
    left = np.eye(len(plane)) - plane @ plane.T
    size, mode = np.linalg.eigh(left @ (per_sigma[:, None] * together * per_sigma) @ left)
    squared = ((per_sigma * patches.height_m) @ left @ mode) ** 2
    variance = _NOISES[:, None] + (_TRIED_M[:, None] ** 2 * np.maximum(size, 0.0))[:, None]
    cost = np.sum(np.log(variance) + (STUDENT + 1.0) * np.log1p(squared / (STUDENT * _SCALE * variance)), axis=2)
    log_likely = -0.5 * (cost + _CLASSES[:, None] ** 2)
    likely = np.exp(log_likely - log_likely.max()).sum(axis=1)
    covariance: FloatArray = likely @ _TRIED_M**2 / likely.sum() * patches.lift.T @ together @ patches.lift
    return covariance


def _common(place_m: FloatArray, side_m: float) -> FloatArray:
    """Return the correlation of means over squares, shape (k, k): that of points, averaged over places in both squares.

    A mean suppresses waves that are shorter than its square. If it were treated as the height of a point, its
    smoothness would make the road appear more even than it is.
    """
    # Of the n^2 pairs of n places along a side, n - |d| are d steps apart.
    steps = np.arange(1 - _ALONG_SIDE, _ALONG_SIDE)
    share = (_ALONG_SIDE - np.abs(steps)) / _ALONG_SIDE**2
    apart = place_m - place_m[:, None]
    common = np.zeros(apart.shape[:2])
    for i, share_x in zip(steps, share, strict=True):
        for j, share_y in zip(steps, share, strict=True):
            offset = apart + side_m / _ALONG_SIDE * np.array([i, j])
            common += share_x * share_y * np.exp(-np.linalg.norm(offset, axis=2) / REACH_M)
    return common
