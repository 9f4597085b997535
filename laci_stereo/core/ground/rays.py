"""Points as rays from the sensor, and the planes that the rays meet.

For a ray with unit direction e and range rho, the plane ``normal . p + height = 0`` reads ``1 / rho = m . e`` with ``m
= -normal / height``. Every plane that does not pass through the sensor has one such m, which has the length 1 / height
and points from the sensor towards the plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.errors import GroundError
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray
from laci_stereo.core.settings import GroundSettings

# Gate in standard deviations: 0.3 % of Gaussian noise lies beyond three.
GATE = 3.0
# Side of a cube on the unit sphere, 0.6 deg: narrower than a car or a pavement at any range, and still only tens of
# thousands of cubes in any field of view.
_BEARING = 0.01


@dataclass(frozen=True)
class Rays:
    """Points as rays from the sensor's origin.

    Attributes
    ----------
    directions : ndarray, shape (n, 3)
        Unit vectors in the sensor frame.
    range_m, sigma_along_m, sigma_bearing_rad : ndarray, shape (n,)
        Range, its standard deviation, and the standard deviation of the direction.
    growth : float
        Exponent p in sigma_along ~ range^p, with which the noise is computed at the range that a plane predicts.
        Weights computed at the measured range would favour points that are measured too near by chance.
    window_rad : float
        Side of a camera's square matching window: points in one window share their noise. 0 for a scanner.
    """

    directions: FloatArray
    range_m: FloatArray
    sigma_along_m: FloatArray
    sigma_bearing_rad: FloatArray
    growth: float
    window_rad: float = 0.0

    def __len__(self) -> int:
        return len(self.range_m)

    def __getitem__(self, keep: BoolArray | IntArray) -> Rays:
        return Rays(
            self.directions[keep],
            self.range_m[keep],
            self.sigma_along_m[keep],
            self.sigma_bearing_rad[keep],
            self.growth,
            self.window_rad,
        )

    @property
    def points(self) -> FloatArray:
        """Points in the sensor frame, metres, shape (n, 3)."""
        return self.directions * self.range_m[:, None]

    def sigma_of_inverse(self, inverse: FloatArray) -> FloatArray:
        """Return the standard deviation of 1 / range due to noise along the rays, at a predicted ``inverse`` > 0."""
        sigma: FloatArray = self.sigma_along_m * (self.range_m * inverse) ** -self.growth * inverse**2
        return sigma

    def variance_of_inverse(self, inverse: FloatArray, m: FloatArray) -> FloatArray:
        """Return the first-order variance of 1 / range - m . e; ``inverse`` > 0 is the 1 / range that m predicts."""
        across_squared = np.maximum(m @ m - inverse**2, 0.0) * self.sigma_bearing_rad**2
        variance: FloatArray = self.sigma_of_inverse(inverse) ** 2 + across_squared
        return variance

    def heights_above(self, planes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the points' heights above planes m of shape (k, 3), and their variances, each of shape (k, n).

        The variances hold at the measured range.
        """
        length = np.linalg.norm(planes, axis=1, keepdims=True)
        heights = (1.0 - planes @ self.points.T) / length
        across = (self.sigma_bearing_rad * self.range_m) ** 2
        variance = (planes / length @ self.directions.T) ** 2 * (self.sigma_along_m**2 - across) + across
        return heights, variance


def as_rays(
    points: FloatArray,
    sigma_along_m: FloatArray,
    sigma_across_m: FloatArray,
    settings: GroundSettings,
    window_rad: float = 0.0,
) -> Rays:
    """Check a cloud and convert it to rays; the parameters are those of `fit_ground`.

    Raises
    ------
    GroundError
        If the arrays have the wrong shape, if there are too few points, or if a value is not finite or not positive.
    """
    points, along, across = (np.asarray(a, dtype=np.float64) for a in (points, sigma_along_m, sigma_across_m))
    if points.ndim != 2 or points.shape[1] != 3:
        raise GroundError(f"shape of the points: {points.shape} found, (n, 3) needed")
    for name, sigma in (("along", along), ("across", across)):
        if sigma.shape != (len(points),):
            raise GroundError(f"shape of sigma_{name}_m: {sigma.shape} found, ({len(points)},) needed")
    if len(points) < settings.min_points:
        raise GroundError(f"number of points: {len(points)} found, at least {settings.min_points} needed")
    ranges = np.linalg.norm(points, axis=1)
    for name, values, good, needed in (
        ("points", points, np.isfinite(ranges), "finite coordinates"),
        ("points", points, ranges != 0.0, "a range above 0 m"),
        ("sigma_along_m", along, np.isfinite(along) & (along > 0.0), "finite values above 0 m"),
        ("sigma_across_m", across, np.isfinite(across) & (across >= 0.0), "finite values of at least 0 m"),
    ):
        if not good.all():
            first = int(np.argmin(good))
            raise GroundError(f"{name}: {values[first]} found at index {first}, {needed} needed")
    return Rays(points / ranges[:, None], ranges, along, across / ranges, _noise_growth(ranges, along), window_rad)


def _noise_growth(range_m: FloatArray, sigma_along_m: FloatArray) -> float:
    """Return the exponent p of sigma_along ~ range^p, in [0, 2]: 2 for a stereo camera, 0 for a LiDAR."""
    x = np.log(range_m)
    x -= x.mean()
    spread = float(x @ x)
    if spread == 0.0:
        return 0.0
    return float(np.clip(x @ np.log(sigma_along_m) / spread, 0.0, 2.0))


def random_part(rays: Rays, size: int) -> Rays:
    """Return a random subset of ``size`` rays, the same subset each time; all rays if there are no more."""
    if len(rays) <= size:
        return rays
    return rays[np.sort(np.random.default_rng(0).choice(len(rays), size, replace=False))]


def one_per_bearing(rays: Rays) -> Rays:
    """Keep one random ray per small cube on the unit sphere, so that dense parts of the view do not dominate."""
    order = np.random.default_rng(0).permutation(len(rays))
    cubes = np.floor((rays.directions[order] + 1.0) / _BEARING).astype(np.int64)
    _, first = np.unique(cubes @ [1, 1_000, 1_000_000], return_index=True)
    return rays[order[first]]
