"""Three-dimensional lines in the world that are drawn into images: ground grid, vehicles' boxes, background boxes."""

from __future__ import annotations

import numpy as np

from laci_stereo.core.frames import FloatArray, transform
from laci_stereo.core.result import Calibration
from laci_stereo.core.tracking.sighting import Sighting
from laci_stereo.report.drawn import (
    T_world_level,
    background_corners,
    drives_of,
    on_ground,
    plan_in_world,
    sender_box,
    sighting_at,
)

GRID_M = 10.0
GRID_AHEAD = np.arange(0.0, 61.0, GRID_M)
GRID_ASIDE_M = 40.0
"""Spacing of the ground grid's lines, their distances ahead of the sensor, and the grid's extent to either side. The
grid ends where its squares look like flat lines."""

NOMINAL_HEIGHT_M = 1.5
"""Height assumed for a vehicle without points, that of a passenger car: messages do not contain it."""

HIGHEST_SHARE = 0.98
"""The roof of a sighting's box is this quantile of its points' heights: single points above it are mismatches."""

HEADING_M = 2.0
"""Length ahead of the box of the line that marks its front."""

BOX_EDGES = [(i, (i + 1) % 4) for i in range(4)] + [(i + 4, (i + 1) % 4 + 4) for i in range(4)]
BOX_EDGES += [(i, i + 4) for i in range(4)]


def ground_grid(calibration: Calibration) -> list[FloatArray]:
    """Return the lines of a grid on the ground from the point below the sensor ahead, world, shape (2, 3) each."""
    aside = np.arange(-GRID_ASIDE_M, GRID_ASIDE_M + GRID_M / 2, GRID_M)
    ends = [((x, aside[0], 0.0), (x, aside[-1], 0.0)) for x in GRID_AHEAD]
    ends += [((GRID_AHEAD[0], y, 0.0), (GRID_AHEAD[-1], y, 0.0)) for y in aside]
    T = T_world_level(calibration)
    return [transform(T, np.array(end)) for end in ends]


def grid_places(calibration: Calibration) -> FloatArray:
    """Return the points on the ground straight ahead of the sensor at `GRID_AHEAD`, world, shape (n, 3)."""
    axis = on_ground(np.column_stack([GRID_AHEAD, np.zeros(len(GRID_AHEAD))]))
    return transform(T_world_level(calibration), axis)


def vehicle_edges(calibration: Calibration, stamp_s: float) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return the edges of the vehicles' boxes at a time of the sensor's clock, world, shape (2, 3) each.

    Returns
    -------
    sent : list of ndarray
        Boxes by the messages, each with a line that points ahead; empty where the messages do not determine a position.
    seen : list of ndarray
        Boxes by the sensor; empty where it has no sighting with that stamp.
    """
    sent_edges: list[FloatArray] = []
    seen_edges: list[FloatArray] = []
    for drive in drives_of(calibration):
        sent, seen = sender_box(drive, stamp_s), sighting_at(drive, stamp_s)
        height_m = NOMINAL_HEIGHT_M if seen is None else seen_height(seen)
        if sent is not None:
            ahead_m = [0.5 * sent.length_m, 0.5 * sent.length_m + HEADING_M]
            nose = sent.centre + np.outer(ahead_m, _direction(sent.yaw_rad))
            sent_edges += [*box_edges(sent.corners(), height_m), on_ground(nose)]
        if seen is not None:
            seen_edges += box_edges(plan_in_world(drive, seen.box.corners()), height_m)
    return sent_edges, seen_edges


def background_edges(calibration: Calibration) -> list[FloatArray]:
    """Return the edges of the background's boxes, world, shape (2, 3) each."""
    boxes = zip(background_corners(calibration), calibration.drive.background.boxes, strict=True)
    return [edge for corners, static in boxes for edge in box_edges(corners, static.height_m)]


def box_edges(corners: FloatArray, height_m: float) -> list[FloatArray]:
    """Return the twelve edges, shape (2, 3) each, of an upright box on four corners on the ground, shape (4, 2)."""
    points = np.concatenate([on_ground(corners), on_ground(corners) + np.array([0.0, 0.0, height_m])])
    return [points[list(edge)] for edge in BOX_EDGES]


def seen_height(seen: Sighting) -> float:
    """Return the height of a vehicle's roof above the ground, metres."""
    return float(np.quantile(seen.points[:, 2], HIGHEST_SHARE)) if len(seen.points) else NOMINAL_HEIGHT_M


def _direction(yaw_rad: float) -> FloatArray:
    return np.array([np.cos(yaw_rad), np.sin(yaw_rad)])
