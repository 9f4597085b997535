"""What is at one place all the time, however seldom it is seen there."""

from __future__ import annotations

from itertools import product

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, IntArray

PLACE_M = 0.5
"""What stands still is seen again within this distance or the next such cell: its middle wanders with what is hit."""

PARTS = 3
"""What stands is seen in each such part of a recording; a vehicle that waits leaves before the end, or came after the
beginning."""


def stands(number: IntArray, xy: FloatArray, count: int, share: float) -> BoolArray:
    """Tell around which places something is seen in this share of the frames of each part of a recording.

    Parameters
    ----------
    number : ndarray of int, shape (n,)
        Which frame each is seen in.
    xy : ndarray, shape (n, 2)
        Metres; at least one.
    count : int
        Of all frames.
    share : float
    """
    cells = np.floor((xy - xy.min(axis=0)) / PLACE_M).astype(np.int64) + 1
    columns = int(cells[:, 1].max()) + 2
    around = np.array([i * columns + j for i, j in product((-1, 0, 1), repeat=2)])
    place = cells @ np.array([columns, 1])
    # A frame counts once for a place, whatever it shows there.
    seen = np.unique((place[:, None] + around) * count + number[:, None])
    places, index = np.unique(seen // count, return_inverse=True)
    frames_in = np.bincount(np.arange(count) * PARTS // count, minlength=PARTS)
    times = np.bincount(index * PARTS + seen % count * PARTS // count, minlength=len(places) * PARTS)
    often: BoolArray = (times.reshape(-1, PARTS) >= np.maximum(share * frames_in, 2)).all(axis=1)
    standing: BoolArray = often[np.searchsorted(places, place)]
    return standing
