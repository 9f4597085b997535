"""The point of a detector's boxes, seen from above, that their positions are of."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from laci_stereo.core.frames import FloatArray, dot_xy, perpendicular
from laci_stereo.core.tracking.tracks import Track

BoxPoint = Literal["centre", "front", "rear", "near-end", "near-corner"]
"""The centre of a box, the middle of its front or rear, the middle of the end that is nearer to the sensor, or the
nearest corner."""


def to_centre(xy: FloatArray, ahead: FloatArray, length: FloatArray, width: FloatArray, point: BoxPoint) -> FloatArray:
    """Return the vectors from a point of each box to its centre, shape (n, 2).

    From the nearer end, and the nearest corner, the box extends away from the sensor. Where the sensor is beside the
    box, either end may be meant, and the same is assumed.

    Parameters
    ----------
    xy : ndarray, shape (n, 2)
        The points on the ground plan of the level frame, metres.
    ahead : ndarray, shape (n, 2)
        Direction in which each box's front is; not of unit length.
    length, width : ndarray, shape (n,)
        Sizes of the boxes, metres.
    point : BoxPoint
        What the points are of each box.
    """
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    left = perpendicular(ahead)
    none = np.zeros(len(xy))
    away, aside = np.sign(dot_xy(xy, ahead)), np.sign(dot_xy(xy, left))
    forward, leftward = {
        "centre": (none, none),
        "front": (none - 1.0, none),
        "rear": (none + 1.0, none),
        "near-end": (away, none),
        "near-corner": (away, aside),
    }[point]
    vectors: FloatArray = (forward * length / 2)[:, None] * ahead + (leftward * width / 2)[:, None] * left
    return vectors


def recentred(track: Track, point: BoxPoint) -> Track:
    """Return a track whose boxes' centres were in truth another point of them; their fronts are where they move to."""
    boxes = [sighting.box for sighting in track.sightings]
    xy, yaw = np.array([box.centre for box in boxes]), np.array([box.yaw_rad for box in boxes])
    ahead = np.column_stack([np.cos(yaw), np.sin(yaw)])
    if len(xy) > 1:
        ahead = ahead * np.where(dot_xy(np.gradient(xy, axis=0), ahead) < 0.0, -1.0, 1.0)[:, None]
    length, width = np.array([[box.length_m, box.width_m] for box in boxes]).T
    centres = xy + to_centre(xy, ahead, length, width, point)
    return Track(
        tuple(
            replace(sighting, middle=centre, box=replace(sighting.box, centre=centre))
            for sighting, centre in zip(track.sightings, centres, strict=True)
        )
    )
