"""The static background: what stands in the frames in which nothing moves, as boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from laci_stereo.core.box import Box, fit_box
from laci_stereo.core.cluster import cluster
from laci_stereo.core.errors import BackgroundError, BoxError
from laci_stereo.core.frames import BoolArray, FloatArray
from laci_stereo.core.settings import BackgroundSettings, BoxSettings, ClusterSettings


@dataclass(frozen=True)
class BackgroundBox:
    """Something static.

    Attributes
    ----------
    box : Box
        On the ground plan of the level frame.
    height_m : float
    """

    box: Box
    height_m: float


@dataclass(frozen=True)
class Background:
    """Everything static that is higher than theta_g.

    Attributes
    ----------
    boxes : tuple of BackgroundBox
    quiet_frames : int
        Frames without a moving object that it was learnt from; 0 means that it was learnt from what stays.
    margin_m : float
    """

    boxes: tuple[BackgroundBox, ...]
    quiet_frames: int
    margin_m: float

    def covers(self, xy: FloatArray) -> BoolArray:
        """Tell which points, level frame, shape (n, 2), lie in a background box."""
        covered = np.zeros(len(xy), dtype=bool)
        for static in self.boxes:
            covered |= static.box.contains(xy, self.margin_m)
        return covered


def learn_background(
    clouds_level: Sequence[FloatArray],
    settings: BackgroundSettings | None = None,
    clusters: ClusterSettings | None = None,
    boxes: BoxSettings | None = None,
) -> Background:
    """Learn the static background from whole frames (paper section III-B).

    What is occupied in at least half of the frames stays. Frames in which nothing of a vehicle's size stands
    elsewhere are quiet, and all that is seen in a quiet frame is background, foliage that comes and goes included.
    No frame needs to be quiet.

    Parameters
    ----------
    clouds_level : sequence of ndarray, shape (n, 3)
        Level frame, metres; from different times.
    settings, clusters, boxes
        Of the three stages.

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
    stays = _Occupancy.over(standing, settings.cell_m)
    quiet = [not _moving(points[~stays.near(points[:, :2])], clusters) for points in standing]
    static = [
        points if is_quiet else points[stays.near(points[:, :2])]
        for points, is_quiet in zip(standing, quiet, strict=True)
    ]
    found = _boxes(np.concatenate(static), settings, clusters, boxes or BoxSettings())
    return Background(tuple(found), sum(quiet), settings.margin_m)


def _standing(points: FloatArray, settings: BackgroundSettings) -> FloatArray:
    return points[(points[:, 2] > settings.min_height_m) & (points[:, 2] < settings.max_height_m)]


@dataclass(frozen=True)
class _Occupancy:
    """Cells of the ground plan that are occupied in at least half of the frames, and their neighbours."""

    first: FloatArray
    cell_m: float
    stays: BoolArray

    @classmethod
    def over(cls, frames: Sequence[FloatArray], cell_m: float) -> _Occupancy:
        everything = np.concatenate(frames)[:, :2]
        if len(everything) == 0:
            return cls(np.zeros(2), cell_m, np.zeros((1, 1), dtype=bool))
        first = np.floor(everything.min(axis=0) / cell_m)
        shape = np.floor(everything.max(axis=0) / cell_m) - first + 1
        counts = np.zeros(shape.astype(int), dtype=np.int32)
        for points in frames:
            cells = np.unique((np.floor(points[:, :2] / cell_m) - first).astype(int), axis=0)
            counts[cells[:, 0], cells[:, 1]] += 1
        # The outline of what stays falls on either side of a cell's border from frame to frame.
        return cls(first, cell_m, binary_dilation(2 * counts >= len(frames), np.ones((3, 3), dtype=bool)))

    def near(self, xy: FloatArray) -> BoolArray:
        cells = (np.floor(xy / self.cell_m) - self.first).astype(int)
        near: BoolArray = self.stays[cells[:, 0], cells[:, 1]] if len(xy) else np.zeros(0, dtype=bool)
        return near


def _moving(points: FloatArray, clusters: ClusterSettings) -> bool:
    """Tell whether there is something as large as the narrowest side of a car."""
    return any(np.ptp(points[group, :2], axis=0).max() >= 1.0 for group in cluster(points[:, :2], clusters))


def _boxes(
    points: FloatArray, settings: BackgroundSettings, clusters: ClusterSettings, boxes: BoxSettings
) -> list[BackgroundBox]:
    found: list[BackgroundBox] = []
    for group in cluster(points[:, :2], clusters):
        found += _tight_boxes(points[group], settings, boxes)
    return found


def _tight_boxes(points: FloatArray, settings: BackgroundSettings, boxes: BoxSettings) -> list[BackgroundBox]:
    """Fit a box; where points cover too little of it, halve them along it and try again."""
    try:
        box = fit_box(points[:, :2], boxes)
    except BoxError:
        return []
    along = (points[:, :2] - box.centre) @ np.array([np.cos(box.yaw_rad), np.sin(box.yaw_rad)])
    across = (points[:, :2] - box.centre) @ np.array([-np.sin(box.yaw_rad), np.cos(box.yaw_rad)])
    cells = np.unique(np.floor(np.column_stack([along, across]) / settings.cell_m), axis=0)
    covered = len(cells) * settings.cell_m**2
    area = max(box.length_m, settings.cell_m) * max(box.width_m, settings.cell_m)
    longer, extent = (along, box.length_m) if box.length_m >= box.width_m else (across, box.width_m)
    if covered >= settings.tight_share * area or extent <= settings.smallest_box_m:
        return [BackgroundBox(box, float(points[:, 2].max()))]
    return _tight_boxes(points[longer < 0], settings, boxes) + _tight_boxes(points[longer >= 0], settings, boxes)
