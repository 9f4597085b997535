"""Points of a road, averaged in square cells of the ground plan, and means of the cells over patches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from laci_stereo.core.columns import Columns
from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.tracking.cluster import cells_of

CELL_M = 0.5
"""Side of a cell."""

LASER_RAD = float(np.radians(0.2))
"""Points within this elevation interval were measured by one laser of a scanner: few scanners have layers closer to one
another."""

_PATCHES = 100
"""Largest number of patches: so many means contain as much information as all cells, since the heights of an uneven
road are correlated over several metres."""


@dataclass(frozen=True)
class Cells(Columns):
    """Means of the points in square cells of the ground plan along a vehicle's path.

    Attributes
    ----------
    xy : ndarray, shape (n, 2)
        Position in the level frame, metres.
    z, variance : ndarray, shape (n,)
        Height, and the variance of its noise that is independent of the other cells.
    sigma_m : ndarray, shape (n,)
        Standard deviation of the noise of one point's height, a fraction of which is an error shared by all points: for
        a camera this is the effect of an offset of all disparities, proportional to depth.
    left_m : ndarray, shape (n,)
        Distance to the left of the path.
    piece : ndarray of int, shape (n,)
        Index of the piece of the path; each side of a piece has an index of its own.
    sight : ndarray, shape (n, 2)
        Azimuth and elevation of the line of sight, in units of the matching window: points in one window share all of
        their noise. A scanner's windows are too narrow to contain two cells.
    layer : ndarray, shape (n,)
        Elevation in the sensor frame at which a scanner sees the cell, in units of `LASER_RAD`; NaN for a camera.
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
        """Whether the cells are seen by a camera, which has no lasers."""
        return bool(np.isnan(self.layer).any())


@dataclass(frozen=True)
class Patches:
    """Precision-weighted means of cells over patches.

    Attributes
    ----------
    xy : ndarray, shape (m, 2)
        Mean position in the level frame, metres.
    size_m2 : ndarray, shape (m,)
        Mean squared distance of the patch's points from ``xy``.
    z, variance : ndarray, shape (m,)
        Height, and the variance of its noise apart from the errors that all points, or all points of a laser, share.
    sigma_m : ndarray, shape (m,)
        As in `Cells`.
    sight : ndarray, shape (m, 2)
        As in `Cells`.
    lasers : ndarray, shape (m, k)
        Weight of each laser's error in the patch: half-way between two elevations, both have half of the variance.
    share : scipy.sparse.csr_array, shape (m, n)
        Weight of each cell in each patch: multiplied by any quantity of the cells, it gives the means over patches.
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
        """Merge cells into square patches, at most `_PATCHES` of them."""
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
        """Return the root mean square distance between the points of one patch and those of another, shape (m, m).

        The covariance of the patches' heights is a function of this distance, not of that between their positions: the
        mean over a patch is smoother than the height at a place in it. A covariance that is a mixture of Gaussians of
        the distance remains one, and is therefore still positive definite.
        """
        square_m2 = ((self.xy[:, None] - self.xy) ** 2).sum(axis=2) + self.size_m2[:, None] + self.size_m2
        apart_m: FloatArray = np.sqrt(square_m2)
        return apart_m

    def best_plane(self, origin: FloatArray, blurred_m: float) -> tuple[FloatArray, FloatArray]:
        """Return the linear maps to the best-fitting plane: its height at an origin and its slopes along x and y.

        Each cell is blurred over a square that has the slopes of the road's model, since least squares over a line do
        not determine the slope across it.

        Parameters
        ----------
        origin : ndarray, shape (2,)
            Level frame, metres.
        blurred_m : float
            Side of this square.

        Returns
        -------
        by_heights : ndarray, shape (3, m)
            Derivative of the plane by the height of each patch.
        by_slopes : ndarray, shape (3, 2)
            Derivative of the plane by the model's slopes.
        """
        count = np.diff(self.share.indptr)
        flat = np.column_stack([np.ones(len(count)), self.xy - origin])
        wide = count.sum() * blurred_m**2 / 12.0 * np.eye(3)[:, 1:]
        square = (flat.T * count) @ flat
        square[:, 1:] += wide
        return np.linalg.solve(square, flat.T * count), np.linalg.solve(square, wide)

    def noise(self, shared_noise_share: float) -> FloatArray:
        """Return the covariance of the heights due to noise, shape (m, m).

        Parameters
        ----------
        shared_noise_share : float
            Fraction of each point's standard deviation that is an error shared by all points; a second error of this
            size is shared by all points of one laser.
        """
        overlap = np.maximum(0.0, 1.0 - np.abs(self.sight[:, None] - self.sight)).prod(axis=2)
        shared = shared_noise_share**2 * np.outer(self.sigma_m, self.sigma_m)
        alone = np.sqrt(np.outer(self.variance, self.variance)) * overlap
        noise: FloatArray = alone + shared * (1.0 + self.lasers @ self.lasers.T)
        return noise


def _patch(xy: FloatArray) -> IntArray:
    """Return the index of the patch of each place, shape (n,)."""
    side_m = 1.0
    while True:
        patch: IntArray = np.unique(cells_of(xy, side_m), return_inverse=True)[1].reshape(-1)
        if patch.max() < _PATCHES:
            return patch
        side_m *= 1.2


def _lasers(cells: Cells) -> FloatArray:
    """Return the weight of each laser in each cell, shape (n, k); half-way between two, both have half the variance."""
    if cells.by_camera:
        return np.zeros((len(cells), 0))
    low = np.floor(cells.layer)
    number, upper, row = (low - low.min()).astype(np.int64), cells.layer - low, np.arange(len(cells))
    belongs = np.zeros((len(cells), number.max() + 2))
    belongs[row, number], belongs[row, number + 1] = np.sqrt(1.0 - upper), np.sqrt(upper)
    return belongs
