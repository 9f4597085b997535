"""Application of a vehicle mask to a frame: vehicles' points are kept, masks that cut through a vehicle corrected."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray
from laci_stereo.core.settings import BackgroundSettings, ClusterSettings, VehicleSettings
from laci_stereo.mask.detect import Vehicle
from laci_stereo.mask.picture import Crop

GROUND_SIGMAS = VehicleSettings.ground_sigmas
LEAST_POINTS = VehicleSettings.min_points
"""The core's own thresholds: significance of a point above the road, and least number of points of a vehicle."""

NOT_GROUND_M = BackgroundSettings.min_height_m
"""Height above the road from which a point is no kerb, lawn or verge; the road itself is known better than that."""

GAP_M = ClusterSettings.reach_m
"""A larger gap in distance separates objects behind the vehicle from it, as it separates clusters in the core."""

THIN_SHARE = 0.05
"""Fraction of the fullest distance bin below which a bin only holds points that bleed between two surfaces.

This applies only if there is a second surface. Points that trail off without reaching one belong to the vehicle: to a
side seen at grazing incidence.
"""

BRIDGED_PX = 3
"""Widest gap within a surface: narrower gaps are pixels that happened not to match."""

NOISE_SIGMAS = 3.0

CUT_SHARE = VehicleSettings.max_edge_share
"""If this fraction of a surface lies outside the mask, the mask cuts it off, as the border of the field of view
does."""


@dataclass(frozen=True)
class Moving:
    """The moving points of a frame, according to the background test, with their pixels.

    Attributes
    ----------
    cloud : PointCloud
    u, v : ndarray of int, shape (n,)
        Column and row of each point in the rectified left image.
    above : ndarray, shape (n,)
        Difference between a point's disparity and the road's at that pixel, in standard deviations.
    height_m : ndarray, shape (n,)
        Height above the road.
    crops : tuple of Crop
        Parts of the rectified left image, in colour: each change with some of its surroundings.
    """

    cloud: PointCloud
    u: IntArray
    v: IntArray
    above: FloatArray
    height_m: FloatArray
    crops: tuple[Crop, ...]


@dataclass(frozen=True)
class Chosen:
    """The points of a frame that are kept.

    Attributes
    ----------
    keep : ndarray of bool, shape (n,)
    used : tuple of bool
        For each vehicle, whether something moves in it.
    grown : int
        Number of vehicles whose mask cut through moving points, which was corrected.
    """

    keep: BoolArray
    used: tuple[bool, ...]
    grown: int


def choose(moving: Moving, vehicles: Sequence[Vehicle], half_window_px: int) -> Chosen:
    """Select the points that belong to vehicles.

    Of the points in a box or mask, those in the dominant layer of distance of the points above the road are kept. A box
    is no outline and is first enlarged by half of the matcher's window. A mask is used unchanged: points that bleed
    across its edge are removed by the layer, and a shrunken mask would lack the vehicle's own borders, 0.3 m and more
    at a distance of 30 m. If the vehicle's largest surface continues beyond the mask's edge, at heights that exclude
    ground, the mask is wrong; then every surface that it touches is kept as a whole, with the points at road level
    beneath it. Whether the surface continues is decided with surfaces as small as the noise allows, what is kept with
    surfaces as large as it allows: a correct mask cuts off a pedestrian beside the vehicle, a wrong mask cuts off
    nothing.

    Parameters
    ----------
    moving : Moving
    vehicles : sequence of Vehicle
    half_window_px : int
        Half of the matcher's window.
    """
    keep = np.zeros(len(moving.cloud), dtype=bool)
    if not vehicles:
        return Chosen(keep, (), 0)
    hulls = [_hull(vehicle, moving, half_window_px) for vehicle in vehicles]
    standing = moving.above > GROUND_SIGMAS
    surface, piece = _surfaces(moving, standing), _surfaces(moving, standing, 2 * half_window_px + 1)
    anyone = np.logical_or.reduce([hull.wide for hull in hulls])
    used, grown = [], 0
    for hull in hulls:
        layer = _layer(moving, hull.inside & standing)
        used.append(layer is not None)
        if layer is None:
            continue
        keep |= hull.inside & layer
        held = hull.inside & layer & standing
        own = (piece == np.bincount(piece[held]).argmax()) & (moving.height_m > NOT_GROUND_M)
        if int((own & ~anyone).sum()) > CUT_SHARE * int((own & hull.inside).sum()):
            whole = np.isin(surface, surface[held]) & (hull.wide | ~anyone)
            keep |= whole | (layer & ~standing & (hull.wide | ~anyone) & _beneath(moving, whole, half_window_px))
            grown += 1
    return Chosen(keep, tuple(used), grown)


@dataclass(frozen=True)
class _Hull:
    """For a vehicle, which points lie inside its outline, and which inside or within half a window of its edge."""

    inside: BoolArray
    wide: BoolArray


def _hull(vehicle: Vehicle, moving: Moving, half_window_px: int) -> _Hull:
    if vehicle.mask is None:  # a box is enlarged by the width of bleeding; the layer removes points that bleed
        x0, y0, x1, y1 = vehicle.box + half_window_px * np.array([-1, -1, 1, 1])
        near = (moving.u >= x0) & (moving.u < x1) & (moving.v >= y0) & (moving.v < y1)
        return _Hull(near, near)
    padded = cv2.copyMakeBorder(vehicle.mask.astype(np.uint8), *(half_window_px,) * 4, cv2.BORDER_CONSTANT)
    window = np.ones((2 * half_window_px + 1,) * 2, np.uint8)
    u = moving.u - vehicle.corner[0] + half_window_px
    v = moving.v - vehicle.corner[1] + half_window_px
    within = (u >= 0) & (v >= 0) & (u < padded.shape[1]) & (v < padded.shape[0])
    u, v = np.where(within, u, 0), np.where(within, v, 0)
    return _Hull(within & (padded[v, u] > 0), within & (cv2.dilate(padded, window)[v, u] > 0))


def _beneath(moving: Moving, surface: BoolArray, half_window_px: int) -> BoolArray:
    """Return which points of the frame lie in the columns of a surface, and not above its top row."""
    u, top = moving.u[surface], moving.v[surface].min()
    beside = (moving.u < u.min() - half_window_px) | (moving.u > u.max() + half_window_px)
    beneath: BoolArray = ~beside & (moving.v >= top)
    return beneath


def _layer(moving: Moving, inside: BoolArray) -> BoolArray | None:
    """Return which points of the frame are in the dominant distance layer of a hull; None if it has too few points."""
    if int(inside.sum()) < LEAST_POINTS:
        return None
    distance = _distance(moving)
    noise_m = NOISE_SIGMAS * float(np.median(moving.cloud.sigma_along_m[inside]))
    width = max(GAP_M, noise_m)
    start = float(distance[inside].min())
    number = np.floor((distance - start) / width).astype(np.int64)
    counts = np.bincount(number[inside])
    first = last = int(counts.argmax())
    full = counts >= max(THIN_SHARE * counts.max(), 1)
    while first > 0 and full[first - 1]:
        first -= 1
    while last + 1 < len(full) and full[last + 1]:
        last += 1
    trail = int(np.append(counts[last + 1 :], 0).argmin())  # bins up to the next empty one
    if not full[last + 1 : last + 1 + trail].any():
        last += trail
    nearest = start + first * width - np.where(inside, 0.0, noise_m)  # points at road level may be nearer
    layer: BoolArray = (distance >= nearest) & (number <= last)
    return layer


def _distance(moving: Moving) -> FloatArray:
    distance: FloatArray = np.linalg.norm(moving.cloud.points, axis=1)
    return distance


def _surfaces(moving: Moving, standing: BoolArray, window_px: int | None = None) -> IntArray:
    """Return the index of the surface to which each point belongs, shape (n,); 0 for none.

    Adjacent pixels lie on one surface if their noise explains the difference of their distances. With ``window_px``,
    only the noise that they do not share counts: two windows k pixels apart share all but k of their columns, which
    leaves a fraction k / ``window_px`` of the variance of the difference.
    """
    numbers = np.zeros(len(standing), dtype=np.int64)
    points = np.flatnonzero(standing)
    if not len(points):
        return numbers
    u, v = moving.u[points] - moving.u[points].min(), moving.v[points] - moving.v[points].min()
    distance, sigma = _distance(moving)[points], moving.cloud.sigma_along_m[points]
    at = np.full((int(v.max()) + 1 + BRIDGED_PX, int(u.max()) + 1 + BRIDGED_PX), -1, dtype=np.int64)
    at[v, u] = np.arange(len(points))
    pairs = []
    for step in range(1, BRIDGED_PX + 1):
        sigmas = NOISE_SIGMAS * min(1.0, step / window_px if window_px else 1.0) ** 0.5
        for neighbour in (at[v + step, u], at[v, u + step]):
            point = np.flatnonzero(neighbour >= 0)
            neighbour = neighbour[point]
            near = np.abs(distance[point] - distance[neighbour]) <= sigmas * np.hypot(sigma[point], sigma[neighbour])
            pairs.append((point[near], neighbour[near]))
    point, neighbour = (np.concatenate(part) for part in zip(*pairs, strict=True))
    links = coo_array((np.ones(len(point), dtype=bool), (point, neighbour)), shape=(len(points), len(points)))
    numbers[points] = connected_components(links, directed=False)[1] + 1
    return numbers


def windows(
    rectangles: Iterable[tuple[int, int, int, int]], size: tuple[int, int], least_px: int
) -> list[tuple[int, int, int, int]]:
    """Return the rectangles to crop from an image: what moves, with a margin of half of its size on each side.

    Detectors need the surroundings of a car.

    Parameters
    ----------
    rectangles : iterable of tuple of int
        First column and row, and last column and row plus one.
    size : tuple of int
        Width and height of the image.
    least_px : int
        Least side of a crop; shorter sides are extended to this within the image.

    Returns
    -------
    list of tuple of int
        In the same form as the rectangles.
    """
    found = []
    for x0, y0, x1, y1 in rectangles:
        around_x, around_y = (max(side // 2, (least_px - side + 1) // 2) for side in (x1 - x0, y1 - y0))
        found.append(
            (max(x0 - around_x, 0), max(y0 - around_y, 0), min(x1 + around_x, size[0]), min(y1 + around_y, size[1]))
        )
    return found
