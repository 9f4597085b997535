"""Detection of stationary objects, which are at one place all the time, even if they are rarely seen there."""

from __future__ import annotations

from itertools import product

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, IntArray

PLACE_M = 0.5
"""Side of the cells: a stationary object is seen again in the same cell or in the next one, since its middle wanders
with the points that are hit."""

PARTS = 3
"""Number of equal parts of a recording in each of which a stationary object must be seen; a waiting vehicle leaves
before the end, or came after the beginning."""


def stands(number: IntArray, xy: FloatArray, count: int, share: float) -> BoolArray:
    """Return which sightings are of stationary objects, shape (n,).

    Around a stationary sighting, in its cell or the next ones, a given fraction of the frames of each part of the
    recording, but at least two frames, must have a sighting.

    Parameters
    ----------
    number : ndarray of int, shape (n,)
        Index of the frame of each sighting.
    xy : ndarray, shape (n, 2)
        Positions of the sightings, metres; at least one.
    count : int
        Number of all frames.
    share : float
        That fraction of the frames.
    """
    cells = np.floor((xy - xy.min(axis=0)) / PLACE_M).astype(np.int64) + 1
    columns = int(cells[:, 1].max()) + 2
    around = np.array([i * columns + j for i, j in product((-1, 0, 1), repeat=2)])
    place = cells @ np.array([columns, 1])
    # A frame counts once for a place, however many sightings it has there.
    seen = np.unique((place[:, None] + around) * count + number[:, None])
    places, index = np.unique(seen // count, return_inverse=True)
    frames_in = np.bincount(np.arange(count) * PARTS // count, minlength=PARTS)
    times = np.bincount(index * PARTS + seen % count * PARTS // count, minlength=len(places) * PARTS)
    often: BoolArray = (times.reshape(-1, PARTS) >= np.maximum(share * frames_in, 2)).all(axis=1)
    standing: BoolArray = often[np.searchsorted(places, place)]
    return standing
