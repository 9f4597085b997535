"""The lines of a map with which traffic is compared: lanes' centre lines, or boundaries where there are no lanes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from laci_stereo.core.errors import MapError
from laci_stereo.core.frames import BoolArray, FloatArray, along_line
from laci_stereo.io.maps.lane_map import LaneMap
from laci_stereo.io.maps.lanelets import Lane

NO_BOUNDARIES = frozenset(
    {"stop_line", "virtual", "traffic_sign", "traffic_light", "pedestrian_marking", "zebra_marking", "symbol"}
)
"""Kinds of lines that are no boundaries along a lane."""


@dataclass(frozen=True)
class Located:
    """Positions relative to a line.

    Attributes
    ----------
    place_m : ndarray, shape (n,)
        Distance along the line.
    offset_m : ndarray, shape (n,)
        Offset to the left of the line.
    yaw_rad : ndarray, shape (n,)
        Direction of the line there, world.
    inside : ndarray of bool, shape (n,)
        Whether the position is within the strip.
    """

    place_m: FloatArray
    offset_m: FloatArray
    yaw_rad: FloatArray
    inside: BoolArray


@dataclass(frozen=True)
class Strip:
    """A strip of road along a line of the map.

    Attributes
    ----------
    id : str
    xy : ndarray, shape (n, 2)
        Points of the line, world; a lane's are in the direction of travel.
    low_m, high_m : ndarray, shape (n,)
        The strip's right and left edge at these points, metres to the left of the line.
    is_lane : bool
        Whether the line is a lane's centre line.
    one_way : bool
        Whether traffic may drive only in the line's direction.
    """

    id: str
    xy: FloatArray
    low_m: FloatArray
    high_m: FloatArray
    is_lane: bool
    one_way: bool

    @cached_property
    def _along(self) -> FloatArray:
        return along_line(self.xy)

    def locate(self, xy: FloatArray) -> Located:
        """Return where positions, shape (n, 2), world, are relative to the nearest points of the line."""
        start, step = self.xy[:-1], np.diff(self.xy, axis=0)
        squared = np.maximum((step**2).sum(axis=1), 1e-12)
        from_start = xy[:, None] - start
        share = (from_start * step).sum(axis=2) / squared
        apart = from_start - np.clip(share, 0.0, 1.0)[..., None] * step
        rows, nearest = np.arange(len(xy)), (apart**2).sum(axis=2).argmin(axis=1)
        share, along = share[rows, nearest], step[nearest]
        length = np.sqrt(squared[nearest])
        beside = from_start[rows, nearest]
        place = self._along[nearest] + np.clip(share, 0.0, 1.0) * length
        offset = (along[:, 0] * beside[:, 1] - along[:, 1] * beside[:, 0]) / length
        low, high = np.interp(place, self._along, self.low_m), np.interp(place, self._along, self.high_m)
        beyond = ((nearest == 0) & (share < 0.0)) | ((nearest == len(step) - 1) & (share > 1.0))
        inside = (offset >= low) & (offset <= high) & ~beyond
        return Located(place, offset, np.arctan2(along[:, 1], along[:, 0]), inside)


def strips_of(lane_map: LaneMap, lanes: Sequence[Lane], boundary_reach_m: float) -> tuple[Strip, ...]:
    """Return the strips of a map: its lanes, or if it has none, a strip on either side of each boundary.

    Raises
    ------
    MapError
        If the map has neither lanes nor boundaries.
    """
    if lanes:
        return tuple(_of_lane(lane) for lane in lanes)
    lines = [line for line in lane_map.lines if line.kind not in NO_BOUNDARIES]
    if not lines:
        raise MapError(f"the map has {len(lane_map.lines)} lines, but none along a lane; needed are lanes' boundaries")
    strips = []
    for line in lines:
        zero, reach = np.zeros(len(line.xy)), np.full(len(line.xy), boundary_reach_m)
        strips.append(Strip(f"{line.id} left", line.xy, zero, reach, is_lane=False, one_way=False))
        strips.append(Strip(f"{line.id} right", line.xy, -reach, zero, is_lane=False, one_way=False))
    return tuple(strips)


def _of_lane(lane: Lane) -> Strip:
    half = np.linalg.norm(lane.left - lane.right, axis=1) / 2
    return Strip(lane.id, lane.centre, -half, half, is_lane=True, one_way=lane.one_way)
