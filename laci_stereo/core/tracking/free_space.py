"""Places that a sensor sees through: nothing stands there, even where the ground behind is too far away to be seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, IntArray
from laci_stereo.core.tracking.cluster import cells_of

MOST_POINTS = 20_000
"""Largest number of a frame's rays that are examined: some of them pass a place of half a metre up to 50 m away."""


@dataclass(frozen=True)
class Places:
    """Cells of the ground plan in which an object stands at times.

    Attributes
    ----------
    cells : ndarray of int, shape (n,)
        Numbers of the cells, ascending; see `cells_of`.
    xy : ndarray, shape (n, 2)
        Mean of the points in each cell, level frame.
    low_m, high_m : ndarray, shape (n,)
        Lower and upper quartile of the heights of its points.
    """

    cells: IntArray
    xy: FloatArray
    low_m: FloatArray
    high_m: FloatArray


def places_of(points: FloatArray, cells: IntArray, cell_m: float) -> Places:
    """Return the position and heights of the points in given cells.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Points of all standing objects, of all frames, level frame.
    cells : ndarray of int
        Numbers of the cells, each of which has a point.
    cell_m : float
        Side of a cell.
    """
    number = cells_of(points[:, :2], cell_m)
    inside = np.isin(number, cells)
    points, number = points[inside], number[inside]
    order = np.lexsort((points[:, 2], number))
    points, number = points[order], number[order]
    found, first, count = np.unique(number, return_index=True, return_counts=True)
    xy = np.add.reduceat(points[:, :2], first) / count[:, None] if len(found) else np.zeros((0, 2))
    return Places(found, xy, points[first + count // 4, 2], points[first + 3 * count // 4, 2])


def seen_through(points: FloatArray, height_m: float, places: Places, cell_m: float) -> IntArray:
    """Return the cells that a ray crosses, at the heights of the object that stands there at times, and ends beyond.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Points of one frame, level frame.
    height_m : float
        Height of the sensor above the frame's origin.
    places : Places
    cell_m : float
        Side of a cell.
    """
    points = points[:: max(1, len(points) // MOST_POINTS)]
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    order = np.argsort(azimuth)
    azimuth, far_m = azimuth[order], np.hypot(points[order, 0], points[order, 1])
    slope = (points[order, 2] - height_m) / np.maximum(far_m, 1e-9)
    away_m, towards = np.hypot(*places.xy.T), np.arctan2(places.xy[:, 1], places.xy[:, 0])
    # Only rays through the middle half of a cell count; they are repeated for a second turn, for cells straight behind.
    width = np.arctan2(cell_m / 4, away_m)
    around, start = np.append(azimuth, azimuth + 2 * np.pi), towards - width
    start = np.where(start < -np.pi, start + 2 * np.pi, start)
    first, last = np.searchsorted(around, start), np.searchsorted(around, start + 2 * width)
    place = np.repeat(np.arange(len(first)), last - first)
    ray = (np.arange(len(place)) - np.repeat(np.cumsum(last - first) - last, last - first)) % len(points)
    above_m = height_m + slope[ray] * away_m[place]
    crossed = (far_m[ray] > away_m[place] + cell_m) & _between(above_m, places, place)
    cells: IntArray = places.cells[np.unique(place[crossed])]
    return cells


def _between(above_m: FloatArray, places: Places, place: IntArray) -> BoolArray:
    between: BoolArray = (above_m > places.low_m[place]) & (above_m < places.high_m[place])
    return between
