"""Frames that a recorder wrote again with a later stamp: the vehicle seems to be stationary, and then jumps ahead."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.tracking.sighting import Sighting
from laci_stereo.core.tracking.tracks import Track

SAME_M = 1e-3
"""With noise of centimetres, ten points are all within this distance of where they were before once in a billion
times."""

DRIVES_M = 0.05
"""A vehicle that moves by more than this from one frame to the next is seen to move."""

MOST_LATE_S = 0.005
"""Frames that are on average older than their stamps by this matter: half of the offset of synchronised clocks."""


def repeats_of(track: Track, vehicle: VehicleTrack, time_offset_s: float) -> tuple[str, ...]:
    """Return an objection if sightings of a vehicle were repeated with other stamps while it drove on."""
    pairs = [pair for pair in pairwise(track.sightings) if _same(*pair)]
    stamps_s = np.array([[one.stamp_s for one in pair] for pair in pairs]).reshape(-1, 2) + time_offset_s
    (before, _, known), (after, _, still_known) = (vehicle.at(stamps) for stamps in stamps_s.T)
    drives = known & still_known & (np.linalg.norm(after - before, axis=1) > DRIVES_M)
    late_s = float(np.diff(stamps_s)[drives].sum()) / max(len(track.sightings), 1)
    if late_s < MOST_LATE_S:
        return ()
    told = (
        f"in {np.count_nonzero(drives)} of {len(track.sightings)} frames the vehicle is seen exactly as in the frame "
        "before, although it drives on: old frames have new times; needed is each frame once, with its own time"
    )
    return (told,)


def _same(one: Sighting, other: Sighting) -> bool:
    """Return whether two sightings are of the same data; motion compensation leaves heights unchanged."""
    if one.count != other.count or one.points.shape != other.points.shape:
        return False
    if not len(one.points):
        return bool(np.array_equal(one.middle, other.middle))
    return bool(np.abs(one.points[:, 2] - other.points[:, 2]).max() < SAME_M)
