"""How high the land is beside a road: what is as low as that is no vehicle, though it is above the road's plane."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from laci_stereo.core.cluster import cells_of, widened
from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.settings import Settings
from laci_stereo.core.static_clutter import stands


@dataclass(frozen=True)
class Land:
    """Up to where points are the ground's.

    Attributes
    ----------
    cells : ndarray of int, shape (n,)
        In order, as `cells_of` numbers them.
    top_m : ndarray, shape (n,)
        Of the highest ground in each and around it, above the plane, its scatter included.
    cell_m : float
    """

    cells: IntArray
    top_m: FloatArray
    cell_m: float

    def top_at(self, xy: FloatArray) -> FloatArray:
        """Return the same of places, level frame, shape (n, 2); 0 where nothing is known to be above the plane."""
        if not len(self.cells):
            return np.zeros(len(xy))
        wanted = cells_of(xy, self.cell_m)
        at = np.searchsorted(self.cells, wanted).clip(max=len(self.cells) - 1)
        top_m: FloatArray = np.where(self.cells[at] == wanted, self.top_m[at], 0.0)
        return top_m


FLAT = Land(np.zeros(0, dtype=np.int64), np.zeros(0), 1.0)


def learn_land(clouds_level: Sequence[FloatArray], settings: Settings) -> Land:
    """Learn where the ground is above the plane, from what is too low for the background.

    It is looked for where something as high as a vehicle's points is seen all the time, however seldom. Vehicles may
    stand there in three of four frames; so the ground is where a quarter of the frames has it, and it scatters upwards
    as it does downwards, where nothing else is.

    Parameters
    ----------
    clouds_level : sequence of ndarray, shape (n, 3)
        Whole frames, level frame, metres; from different times.
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
    its = np.isin(cells, np.unique(cells[high][stays]))
    found, cell = np.unique(cells[its], return_inverse=True)
    frame, z = frame[its], z[its]
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
    """Return which of its values, shape (n,), that share of each group is below, shape (g,); groups are numbered."""
    count = np.bincount(group)
    ordered = values[np.lexsort((values, group))]
    quantile: FloatArray = ordered[np.cumsum(count) - count + (share * count).astype(np.int64)]
    return quantile
