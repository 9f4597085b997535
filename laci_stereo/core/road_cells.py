"""What is seen of a road, in squares of the ground plan, and its means over patches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from laci_stereo.core.cluster import cells_of
from laci_stereo.core.columns import Columns
from laci_stereo.core.frames import FloatArray, IntArray

CELL_M = 0.5
"""The side of a square."""

LASER_RAD = float(np.radians(0.2))
"""What is seen in the same elevation was measured by one laser of a scanner: few have layers closer to one another."""

_PATCHES = 100
"""So many means of cells tell as much as all cells: a road is as high where it is uneven over several metres."""


@dataclass(frozen=True)
class Cells(Columns):
    """What is seen in squares of the ground plan along a way.

    Attributes
    ----------
    xy : ndarray, shape (n, 2)
        Level frame, metres.
    z, variance : ndarray, shape (n,)
        Height, and its variance through noise that no other cell has.
    sigma_m : ndarray, shape (n,)
        Standard deviation of one point's height through noise, a share of which all points have in common: with a
        camera as an offset of all disparities would have it, in proportion to depth.
    left_m : ndarray, shape (n,)
        How far to the left of the way.
    piece : ndarray of int, shape (n,)
        Piece of the way, one number for each of its sides.
    sight : ndarray, shape (n, 2)
        Azimuth and elevation in which the sensor sees it, in windows of its matcher: what is in one has all noise in
        common. A scanner's windows are too narrow for two.
    layer : ndarray, shape (n,)
        Elevation in the sensor frame in which a scanner sees it, in `LASER_RAD`; NaN for a camera.
    """

    xy: FloatArray
    z: FloatArray
    variance: FloatArray
    sigma_m: FloatArray
    left_m: FloatArray
    piece: IntArray
    sight: FloatArray
    layer: FloatArray

    def __len__(self) -> int:
        return len(self.z)

    @property
    def by_camera(self) -> bool:
        """Whether a camera sees them, which has no lasers."""
        return bool(np.isnan(self.layer).any())


@dataclass(frozen=True)
class Patches:
    """Means over patches of cells, by their precision.

    Attributes
    ----------
    xy : ndarray, shape (m, 2)
    size_m2 : ndarray, shape (m,)
        Mean square of the distance of what is in it from there.
    z, variance : ndarray, shape (m,)
        Height, and its variance through noise that no other patch has.
    sigma_m : ndarray, shape (m,)
        As of the cells.
    sight : ndarray, shape (m, 2)
    lasers : ndarray, shape (m, k)
        How much of each laser there is: of a patch between two elevations, half of the variance of both.
    share : scipy.sparse.csr_array, shape (m, n)
        Of each cell in each patch: with it, means of anything else over patches are made.
    """

    xy: FloatArray
    size_m2: FloatArray
    z: FloatArray
    variance: FloatArray
    sigma_m: FloatArray
    sight: FloatArray
    lasers: FloatArray
    share: csr_array

    @staticmethod
    def of(cells: Cells) -> Patches:
        """Merge cells in squares, of which there are no more than tell as much as all cells."""
        patch = _patch(cells.xy)
        window = np.floor(cells.sight).astype(np.int64)
        _, alike, count = np.unique(np.column_stack([patch, window]), axis=0, return_inverse=True, return_counts=True)
        weight = 1.0 / cells.variance
        number = np.arange(len(cells))
        share = csr_array((weight / np.bincount(patch, weight)[patch], (patch, number)))
        told = np.bincount(patch, weight / count[alike.reshape(-1)])
        columns = np.column_stack([cells.xy, cells.z, cells.sigma_m, cells.sight, _lasers(cells)])
        xy, z, sigma_m, sight, lasers = np.split(share @ columns, [2, 3, 4, 6], axis=1)
        size_m2 = share @ (np.linalg.norm(cells.xy - xy[patch], axis=1) ** 2) + CELL_M**2 / 6.0
        return Patches(xy, size_m2, z[:, 0], 1.0 / told, sigma_m[:, 0], sight, lasers, share)

    def apart_m(self) -> FloatArray:
        """Return the root mean square distance of what is in one patch from what is in another, shape (m, m).

        By it, and not by the patches' own, heights of patches are alike: a mean over a patch is less uneven than a
        place in it. A covariance that is a mixture of Gaussians of the distance stays one, and so positive definite.
        """
        square_m2 = ((self.xy[:, None] - self.xy) ** 2).sum(axis=2) + self.size_m2[:, None] + self.size_m2
        apart_m: FloatArray = np.sqrt(square_m2)
        return apart_m

    def best_plane(self, origin: FloatArray, blurred_m: float) -> tuple[FloatArray, FloatArray]:
        """Return what makes the plane that fits best: its height at an origin, and its slopes along x and y.

        What is seen is blurred, with the slopes of the road's model: least squares over a line tell no slope across it.

        Parameters
        ----------
        origin : ndarray, shape (2,)
        blurred_m : float
            Over so much.

        Returns
        -------
        by_heights : ndarray, shape (3, m)
            Of the height of each patch.
        by_slopes : ndarray, shape (3, 2)
            Of the model's slopes.
        """
        count = np.diff(self.share.indptr)
        flat = np.column_stack([np.ones(len(count)), self.xy - origin])
        wide = count.sum() * blurred_m**2 / 12.0 * np.eye(3)[:, 1:]
        square = (flat.T * count) @ flat
        square[:, 1:] += wide
        return np.linalg.solve(square, flat.T * count), np.linalg.solve(square, wide)

    def noise(self, shared_noise_share: float) -> FloatArray:
        """Return the covariance, shape (m, m), of the heights through noise.

        Parameters
        ----------
        shared_noise_share : float
            Of each point's standard deviation, the part that errs for all points alike, and again for all of one laser.
        """
        overlap = np.maximum(0.0, 1.0 - np.abs(self.sight[:, None] - self.sight)).prod(axis=2)
        shared = shared_noise_share**2 * np.outer(self.sigma_m, self.sigma_m)
        alone = np.sqrt(np.outer(self.variance, self.variance)) * overlap
        noise: FloatArray = alone + shared * (1.0 + self.lasers @ self.lasers.T)
        return noise


def _patch(xy: FloatArray) -> IntArray:
    """Return the number of the patch of each place, shape (n,)."""
    side_m = 1.0
    while True:
        patch: IntArray = np.unique(cells_of(xy, side_m), return_inverse=True)[1].reshape(-1)
        if patch.max() < _PATCHES:
            return patch
        side_m *= 1.2


def _lasers(cells: Cells) -> FloatArray:
    """Return to which lasers cells belong, shape (n, k): between two elevations to both, half of the variance each."""
    if cells.by_camera:
        return np.zeros((len(cells), 0))
    low = np.floor(cells.layer)
    number, upper, row = (low - low.min()).astype(np.int64), cells.layer - low, np.arange(len(cells))
    belongs = np.zeros((len(cells), number.max() + 2))
    belongs[row, number], belongs[row, number + 1] = np.sqrt(1.0 - upper), np.sqrt(upper)
    return belongs
