"""Clusters of points on the ground plan: the objects that stand or move there."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.settings import ClusterSettings

ONE_COLUMN = 2**32
"""Difference between the numbers of two cells that are neighbours along x; along y the difference is one."""


def cells_of(xy: FloatArray, cell_m: float) -> IntArray:
    """Return the number of the square cell that each point, shape (n, 2), lies in, shape (n,)."""
    index = np.floor(xy / cell_m).astype(np.int64)
    numbers: IntArray = index[:, 0] * ONE_COLUMN + index[:, 1]
    return numbers


def widened(cells: IntArray) -> IntArray:
    """Return the numbers of each cell and the eight around it, shape (n, 9)."""
    step = np.array([-1, 0, 1])
    around: IntArray = cells.reshape(-1, 1) + (ONE_COLUMN * step[:, None] + step).ravel()
    return around


def cluster(xy: FloatArray, settings: ClusterSettings) -> list[IntArray]:
    """Group points by density (DBSCAN; Ester et al., KDD 1996).

    Points are first counted in cells, which are then clustered with these counts as weights, so the cost depends on the
    covered area and not on the sensor's density.

    Parameters
    ----------
    xy : ndarray, shape (n, 2)
        Points on the ground plan of the level frame, metres.
    settings : ClusterSettings

    Returns
    -------
    list of ndarray of int
        Indices into ``xy`` of each cluster's points, the cluster with most points first.
    """
    if len(xy) == 0:
        return []
    packed, cell_of_point, counts = np.unique(cells_of(xy, settings.cell_m), return_inverse=True, return_counts=True)
    column = (packed + ONE_COLUMN // 2) // ONE_COLUMN
    cells = np.column_stack([column, packed - column * ONE_COLUMN])
    labels = _dbscan(cells, counts, settings)[cell_of_point]
    order = np.argsort(labels, kind="stable")
    starts = np.searchsorted(labels[order], np.arange(labels.max() + 2))
    groups = [order[first:last] for first, last in pairwise(starts)]
    return sorted(groups, key=len, reverse=True)


def _dbscan(cells: IntArray, counts: IntArray, settings: ClusterSettings) -> IntArray:
    """Return the index of each cell's cluster, shape (n,); -1 is noise."""
    # Imported late, as it takes half of the start-up time: a mistyped argument should be reported without this delay.
    from sklearn.cluster import DBSCAN

    found = DBSCAN(eps=settings.reach_m / settings.cell_m, min_samples=settings.min_points)
    labels: IntArray = found.fit_predict(cells.astype(np.float64), sample_weight=counts)
    return labels
