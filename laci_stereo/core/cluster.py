"""Clusters of points on the ground plan: what stands or drives there."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from sklearn.cluster import DBSCAN

from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.settings import ClusterSettings


def cluster(xy: FloatArray, settings: ClusterSettings) -> list[IntArray]:
    """Group points by density (DBSCAN; Ester et al., KDD 1996).

    Points are first counted in cells, which DBSCAN then weighs, so the cost depends on the area that is covered and
    not on the sensor's density.

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
    cells, cell_of_point, counts = np.unique(
        np.floor(xy / settings.cell_m).astype(np.int64), axis=0, return_inverse=True, return_counts=True
    )
    found = DBSCAN(eps=settings.reach_m / settings.cell_m, min_samples=settings.min_points)
    labels = found.fit_predict(cells.astype(np.float64), sample_weight=counts)[cell_of_point.ravel()]
    order = np.argsort(labels, kind="stable")
    starts = np.searchsorted(labels[order], np.arange(labels.max() + 2))
    groups = [order[first:last] for first, last in pairwise(starts)]
    return sorted(groups, key=len, reverse=True)
