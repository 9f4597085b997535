"""What the unevenness of the road leaves unknown of the ground plane.

ISO 8608 gives the spectrum of a road's height as G (n / n0)^-2 over the wave number n, with n0 = 0.1 / m. A random
field with the covariance u^2 exp(-distance / l) has the spectrum u^2 / (pi^2 l n^2) for waves shorter than some l, so
it is such a road where u^2 = pi^2 l n0^2 G. How uneven the road is shows where the noise lets it show; where it does
not, what is known of paved roads speaks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import FloatArray

# l: a road falls from its crown to its gutter, so its height is common to about as much as half its width.
REACH_M = 7.0
# Class B, a good paved road: G = 64e-6 m^3.
CLASS_B_M = float(np.sqrt(np.pi**2 * REACH_M * 0.1**2 * 64e-6))
# A paved road of class C by ISO 8608 is as uneven; what is more so is more than one surface.
ONE_SURFACE_M = 2.0 * CLASS_B_M
# With each class G is four times as large. Paved roads are of class A to C, which is taken as one standard deviation.
_CLASSES = np.arange(-3.0, 3.1, 0.5)
_TRIED_M = CLASS_B_M * 2.0**_CLASSES
# So many patches are each much smaller than what is in view.
_PATCHES = 100
# Degrees of freedom that let one patch in twenty be an outlier.
_STUDENT = 4.0


@dataclass(frozen=True)
class Patches:
    """Means over square patches of the plane.

    Attributes
    ----------
    place_m : ndarray, shape (k, 2)
        Position on the plane.
    height_m, variance_m2 : ndarray, shape (k,)
        Mean height above the plane, and its variance through noise.
    lift : ndarray, shape (k, 3)
        What 1 m more of height of the patch adds to m.
    slope_m : ndarray, shape (k, 3)
        What more of m takes from the patch's height.
    """

    place_m: FloatArray
    height_m: FloatArray
    variance_m2: FloatArray
    lift: FloatArray
    slope_m: FloatArray


def patches_of(
    m: FloatArray,
    direction: FloatArray,
    area_m2: FloatArray,
    residual: FloatArray,
    precision: FloatArray,
    gain: FloatArray,
) -> Patches:
    """Gather cells of the ground in patches.

    Parameters
    ----------
    m : ndarray, shape (3,)
        The plane, see `laci_stereo.core.ground_rays`.
    direction : ndarray, shape (n, 3)
        Of each cell's rays.
    area_m2 : ndarray, shape (n,)
        Of each cell on the plane.
    residual, precision : ndarray, shape (n,)
        Of each cell: mean of 1 / range beyond the plane's, and the inverse of its variance, 0 where it is not ground.
    gain : ndarray, shape (n, 3)
        What more of a cell's residual adds to m.
    """
    ground = precision > 0.0
    direction, residual, precision, gain = direction[ground], residual[ground], precision[ground], gain[ground]
    inverse = direction @ m
    per_metre = np.linalg.norm(m) * inverse
    normal = -m / np.linalg.norm(m)
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(normal)))], normal)
    x /= np.linalg.norm(x)
    place_m = direction @ np.stack([x, np.cross(normal, x)], axis=1) / inverse[:, None]
    side_m = np.sqrt(area_m2[ground].sum() / _PATCHES)
    square = np.floor(place_m / side_m).astype(np.int64)
    square -= square.min(axis=0)
    patch = np.unique(square @ [square[:, 1].max() + 1, 1], return_inverse=True)[1].reshape(-1)
    weight = precision * per_metre**2
    total = np.bincount(patch, weight)

    def sums(columns: FloatArray) -> FloatArray:
        return np.stack([np.bincount(patch, column) for column in columns.T], axis=1)

    return Patches(
        place_m=sums(weight[:, None] * place_m) / total[:, None],
        height_m=np.bincount(patch, weight * residual / per_metre) / total,
        variance_m2=1.0 / total,
        lift=sums(gain * per_metre[:, None]),
        slope_m=sums(direction * (weight / per_metre)[:, None]) / total[:, None],
    )


def covariance_of_unevenness(patches: Patches) -> FloatArray:
    """Return what the unevenness adds to the covariance of m, shape (3, 3): the mean over what is likely of it."""
    x, y = patches.place_m.T
    together = np.exp(-np.hypot(x - x[:, None], y - y[:, None]) / REACH_M)
    # In units of the noise, and without what a plane can take up; modes of the unevenness are independent.
    per_sigma = 1.0 / np.sqrt(patches.variance_m2)
    plane = np.linalg.qr(per_sigma[:, None] * patches.slope_m)[0]
    left = np.eye(len(x)) - plane @ plane.T
    size, mode = np.linalg.eigh(left @ (per_sigma[:, None] * together * per_sigma) @ left)
    squared = ((per_sigma * patches.height_m) @ left @ mode) ** 2
    variance = 1.0 + _TRIED_M[:, None] ** 2 * np.maximum(size, 0.0)
    cost = np.sum(np.log(variance) + (_STUDENT + 1.0) * np.log1p(squared / (_STUDENT * variance)), axis=1)
    log_likely = -0.5 * (cost + _CLASSES**2)
    likely = np.exp(log_likely - log_likely.max())
    covariance: FloatArray = likely @ _TRIED_M**2 / likely.sum() * patches.lift.T @ together @ patches.lift
    return covariance
