"""The static background: boxes around the objects that do not move.

A frame is *quiet* if nothing of a vehicle's size is seen in it besides the objects that stay.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from laci_stereo.core.errors import BackgroundError, BoxError
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray
from laci_stereo.core.settings import BackgroundSettings, BoxSettings, ClusterSettings, VehicleSettings
from laci_stereo.core.tracking.box import Box, fit_box
from laci_stereo.core.tracking.cluster import cells_of, cluster, widened
from laci_stereo.core.tracking.free_space import places_of, seen_through

BACKGROUND_FRAMES = 20
"""Number of whole frames, spread over a recording, that the background is learnt from: a vehicle is at the same place
in few of them. Frames in quick succession would show it at one place in several."""


@dataclass(frozen=True)
class BackgroundBox:
    """A static object.

    Attributes
    ----------
    box : Box
        Box on the ground plan of the level frame.
    height_m : float
        Height of its highest point.
    """

    box: Box
    height_m: float


@dataclass(frozen=True)
class Background:
    """All static objects higher than theta_g.

    Attributes
    ----------
    boxes : tuple of BackgroundBox
    quiet_frames : int
        Number of quiet frames that the background was learnt from; with 0, it was learnt only from what stays in most
        frames.
    margin_m : float
        Margin by which boxes are enlarged before points are tested against them.
    """

    boxes: tuple[BackgroundBox, ...]
    quiet_frames: int
    margin_m: float

    def covers(self, xy: FloatArray) -> BoolArray:
        """Return which points, level frame, shape (n, 2), lie in a background box, shape (n,)."""
        order = np.argsort(xy[:, 0])
        ordered, inside = xy[order], np.zeros(len(xy), dtype=bool)
        first, last = np.searchsorted(ordered[:, 0], self._between_x.T)
        for static, begin, end in zip(self.boxes, first.tolist(), last.tolist(), strict=True):
            inside[begin:end] |= static.box.contains(ordered[begin:end], self.margin_m)
        covered = np.empty_like(inside)
        covered[order] = inside
        return covered

    @cached_property
    def _between_x(self) -> FloatArray:
        """Least and largest x of each box, with a tolerance for margin and rounding, shape (n, 2)."""
        x = np.array([static.box.corners()[:, 0] for static in self.boxes]).reshape(-1, 4)
        reach_m = math.sqrt(2.0) * self.margin_m + 1e-6
        return np.column_stack([x.min(axis=1) - reach_m, x.max(axis=1) + reach_m])


def learn_background(
    clouds_level: Sequence[FloatArray],
    height_m: float,
    settings: BackgroundSettings | None = None,
    clusters: ClusterSettings | None = None,
    boxes: BoxSettings | None = None,
) -> Background:
    """Learn the static background from whole frames (paper section III-B).

    Cells that are occupied in at least half of the frames stay, unless they are seen to be empty, or are seen through,
    in more than a tenth of the frames: there traffic queues. Frames in which no other object of a vehicle's size stands
    are quiet, and cells that are occupied in two quiet frames are background too, such as foliage that comes and goes.
    No frame needs to be quiet.

    Parameters
    ----------
    clouds_level : sequence of ndarray, shape (n, 3)
        Points of whole frames from different times, level frame, metres.
    height_m : float
        Height of the sensor above the level frame's origin.
    settings, clusters, boxes
        Settings of the three stages.

    Raises
    ------
    BackgroundError
        If there are no frames.
    """
    settings = settings or BackgroundSettings()
    clusters = clusters or ClusterSettings()
    if not clouds_level:
        raise BackgroundError("the survey has 0 whole frames; needed is at least 1 to learn the background from")
    standing = [_standing(points, settings) for points in clouds_level]
    occupied = [np.unique(cells_of(points[:, :2], settings.cell_m)) for points in standing]
    stays = _staying(clouds_level, height_m, standing, occupied, settings)
    elsewhere = [points[~_near(stays, points, settings)] for points in standing]
    quiet = [not _moving(points, clusters) for points in elsewhere]
    at_rest = [cells for cells, is_quiet in zip(occupied, quiet, strict=True) if is_quiet]
    known = np.union1d(stays, _in_at_least(min(2, len(at_rest)), at_rest))
    static = [
        points[_near(known if is_quiet else stays, points, settings)]
        for points, is_quiet in zip(standing, quiet, strict=True)
    ]
    found = _boxes(np.concatenate(static), settings, clusters, boxes or BoxSettings())
    return Background(tuple(found), sum(quiet), settings.margin_m)


def _standing(points: FloatArray, settings: BackgroundSettings) -> FloatArray:
    return points[(points[:, 2] > settings.min_height_m) & (points[:, 2] < settings.max_height_m)]


def _empty(points: FloatArray, through: IntArray, occupied: IntArray, settings: BackgroundSettings) -> IntArray:
    """Return the cells in and around which ground is seen and nothing stands, and those that are seen through."""
    ground = points[np.abs(points[:, 2]) <= settings.min_height_m, :2]
    free = np.setdiff1d(_widened(cells_of(ground, settings.cell_m)), _widened(occupied), assume_unique=True)
    return np.union1d(free, np.setdiff1d(through, occupied))


def _staying(
    clouds: Sequence[FloatArray],
    height_m: float,
    standing: Sequence[FloatArray],
    occupied: Sequence[IntArray],
    settings: BackgroundSettings,
) -> IntArray:
    """Return the cells that are occupied in at least half of the frames and empty in no more than a tenth."""
    often = _in_at_least((len(clouds) + 1) // 2, occupied)
    at_times = np.setdiff1d(often, _in_at_least(len(clouds), occupied))
    places = places_of(np.concatenate(standing), at_times, settings.cell_m)
    empty = [
        _empty(points, seen_through(points, height_m, places, settings.cell_m), cells, settings)
        for points, cells in zip(clouds, occupied, strict=True)
    ]
    return np.setdiff1d(often, _in_at_least(len(clouds) // 10 + 1, empty))


def _in_at_least(count: int, frames: Sequence[IntArray]) -> IntArray:
    """Return the cells that are in at least ``count`` frames."""
    if not frames:
        return np.zeros(0, dtype=np.int64)
    cells, counts = np.unique(np.concatenate(frames), return_counts=True)
    return cells[counts >= count]


def _widened(cells: IntArray) -> IntArray:
    """Return the cells and the eight around each, in ascending order and without duplicates."""
    return np.unique(widened(np.unique(cells)))


def _near(cells: IntArray, points: FloatArray, settings: BackgroundSettings) -> BoolArray:
    """Return which points are in one of the cells or next to it: outlines fall on either side of a cell's border."""
    return np.isin(cells_of(points[:, :2], settings.cell_m), _widened(cells))


def _moving(points: FloatArray, clusters: ClusterSettings) -> bool:
    """Return whether there is a cluster as large as the narrowest side of a car."""
    return any(
        np.ptp(points[group, :2], axis=0).max() >= VehicleSettings.min_extent_m
        for group in cluster(points[:, :2], clusters)
    )


def _boxes(
    points: FloatArray, settings: BackgroundSettings, clusters: ClusterSettings, boxes: BoxSettings
) -> list[BackgroundBox]:
    found: list[BackgroundBox] = []
    for group in cluster(points[:, :2], clusters):
        found += _tight_boxes(points[group], settings, boxes)
    return found


def _tight_boxes(points: FloatArray, settings: BackgroundSettings, boxes: BoxSettings) -> list[BackgroundBox]:
    """Return a box around points; if they cover too little of it, halve them along its longer side and fit again."""
    try:
        box = fit_box(points[:, :2], boxes)
    except BoxError:
        return []
    along = (points[:, :2] - box.centre) @ np.array([np.cos(box.yaw_rad), np.sin(box.yaw_rad)])
    across = (points[:, :2] - box.centre) @ np.array([-np.sin(box.yaw_rad), np.cos(box.yaw_rad)])
    cells = np.unique(cells_of(np.column_stack([along, across]), settings.cell_m))
    covered = len(cells) * settings.cell_m**2
    area = max(box.length_m, settings.cell_m) * max(box.width_m, settings.cell_m)
    longer, extent = (along, box.length_m) if box.length_m >= box.width_m else (across, box.width_m)
    if covered >= settings.tight_share * area or extent <= settings.smallest_box_m:
        return [BackgroundBox(box, float(points[:, 2].max()))]
    return _tight_boxes(points[longer < 0], settings, boxes) + _tight_boxes(points[longer >= 0], settings, boxes)
