"""Height of the terrain beside a road: points no higher than that do not belong to a vehicle, even above the plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.settings import Settings
from laci_stereo.core.tracking.cluster import cells_of, widened
from laci_stereo.core.tracking.static_clutter import stands


@dataclass(frozen=True)
class Land:
    """Height of the terrain above the ground plane, by cells of the ground plan.

    Attributes
    ----------
    cells : ndarray of int, shape (n,)
        Numbers of the cells as in `cells_of`, ascending.
    top_m : ndarray, shape (n,)
        Height above the plane of the highest ground in each cell and around it, including the dispersion of its points.
    cell_m : float
        Side of a cell.
    """

    cells: IntArray
    top_m: FloatArray
    cell_m: float

    def top_at(self, xy: FloatArray) -> FloatArray:
        """Return this height at places, level frame, shape (n, 2); 0 where no terrain is known above the plane."""
        if not len(self.cells):
            return np.zeros(len(xy))
        wanted = cells_of(xy, self.cell_m)
        at = np.searchsorted(self.cells, wanted).clip(max=len(self.cells) - 1)
        top_m: FloatArray = np.where(self.cells[at] == wanted, self.top_m[at], 0.0)
        return top_m


FLAT = Land(np.zeros(0, dtype=np.int64), np.zeros(0), 1.0)


def learn_land(clouds_level: Sequence[FloatArray], settings: Settings) -> Land:
    """Learn where the terrain is above the plane, from points that are too low for the background.

    It is searched where points as high as a vehicle's are seen throughout the recording, even if only in few frames.
    Vehicles may stand there in three of four frames, so the height of the ground is the lower quartile over the frames.
    Its points are assumed to scatter upwards as they do downwards, where there are no points of other objects.

    Parameters
    ----------
    clouds_level : sequence of ndarray, shape (n, 3)
        Points of whole frames from different times, level frame, metres.
    settings : Settings
    """
    cell_m = settings.background.cell_m
    low = [points[points[:, 2] <= settings.background.min_height_m] for points in clouds_level]
    frame, (x, y, z) = np.repeat(np.arange(len(low)), [len(points) for points in low]), np.concatenate(low).T
    high = z > settings.vehicle.min_height_m
    if not high.any():
        return FLAT
    xy = np.column_stack([x, y])
    stays = stands(frame[high], xy[high], len(low), settings.track.fixture_share)
    cells = cells_of(xy, cell_m)
    searched = np.isin(cells, np.unique(cells[high][stays]))
    found, cell = np.unique(cells[searched], return_inverse=True)
    frame, z = frame[searched], z[searched]
    by_frame, in_frame = np.unique(cell * len(low) + frame, return_inverse=True)
    ground_m = _quantile(by_frame // len(low), _quantile(in_frame, z, 0.5), 0.25)
    below_m = (ground_m[cell] - z).clip(0.0)
    variance = np.bincount(cell, below_m**2) / np.maximum(np.bincount(cell, below_m > 0.0), 1.0)
    around = widened(found)
    top_m = np.repeat(ground_m + settings.vehicle.ground_sigmas * np.sqrt(variance), around.shape[1])
    known, index = np.unique(around.ravel(), return_inverse=True)
    highest_m = np.zeros(len(known))
    np.maximum.at(highest_m, index, top_m)
    return Land(known, highest_m, cell_m)


def _quantile(group: IntArray, values: FloatArray, share: float) -> FloatArray:
    """Return the quantile at ``share`` of the values, shape (n,), of each group, shape (g,); groups are 0 to g - 1."""
    count = np.bincount(group)
    ordered = values[np.lexsort((values, group))]
    quantile: FloatArray = ordered[np.cumsum(count) - count + (share * count).astype(np.int64)]
    return quantile
