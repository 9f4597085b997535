"""Clusters of points on the ground plan: what stands or drives there."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.settings import ClusterSettings

ONE_COLUMN = 2**32
"""Difference between the numbers of two cells that are neighbours along x; along y it is one."""


def cells_of(xy: FloatArray, cell_m: float) -> IntArray:
    """Return the number of the square cell that each point, shape (n, 2), lies in, shape (n,)."""
    index = np.floor(xy / cell_m).astype(np.int64)
    numbers: IntArray = index[:, 0] * ONE_COLUMN + index[:, 1]
    return numbers


def cluster(xy: FloatArray, settings: ClusterSettings) -> list[IntArray]:
    """Group points by density (DBSCAN; Ester et al., KDD 1996).

    Points are first counted in cells, which are then weighed, so the cost depends on the area that is covered and not
    on the sensor's density.

    Parameters
    ----------
    xy : ndarray, shape (n, 2)
        Level frame, metres.
    settings : ClusterSettings

    Returns
    -------
    list of ndarray of int
        Indices into ``xy``, the cluster with most points first.
    """
    if len(xy) == 0:
        return []
    packed, cell_of_point, counts = np.unique(cells_of(xy, settings.cell_m), return_inverse=True, return_counts=True)
    column = (packed + ONE_COLUMN // 2) // ONE_COLUMN
    cells = np.column_stack([column, packed - column * ONE_COLUMN])
    labels = _dbscan(cells, counts, settings.reach_m / settings.cell_m, settings.min_points)[cell_of_point]
    order = np.argsort(labels, kind="stable")
    starts = np.searchsorted(labels[order], np.arange(labels.max() + 2))
    groups = [order[first:last] for first, last in pairwise(starts)]
    return sorted(groups, key=len, reverse=True)


def _dbscan(cells: IntArray, counts: IntArray, reach: float, min_points: int) -> IntArray:
    """Return the cluster of each cell, shape (n,); -1 is noise.

    Dense cells within reach of one another belong together, and so do those within reach of a dense one.
    """
    one, other = KDTree(cells).query_pairs(reach, output_type="ndarray").T
    n = len(cells)
    around = counts + np.bincount(one, counts[other], n) + np.bincount(other, counts[one], n)
    is_dense = around >= min_points
    linked = is_dense[one] & is_dense[other]
    links = coo_array((np.ones(linked.sum(), dtype=bool), (one[linked], other[linked])), shape=(n, n))
    component = connected_components(links, directed=False)[1]
    labels = np.full(n, -1, dtype=np.int64)
    labels[is_dense] = np.unique(component[is_dense], return_inverse=True)[1]
    for border, dense in ((one, other), (other, one)):
        reached = is_dense[dense] & ~is_dense[border]
        labels[border[reached]] = labels[dense[reached]]
    return labels
