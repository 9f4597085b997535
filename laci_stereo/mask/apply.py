"""What a mask does to the points of a frame: those of vehicles stay, unless the mask is wrong where it cuts."""

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
"""As the core has them, for what is above the road and for what can be a vehicle at all."""

NOT_GROUND_M = BackgroundSettings.min_height_m
"""What is higher above the road is no kerb, lawn or verge, and the road itself was not found worse than that."""

GAP_M = ClusterSettings.reach_m
"""A gap in distance that is larger divides what stands behind from the vehicle, as it divides clusters in the core."""

THIN_SHARE = 0.05
"""A range of distance that holds less than this share of the fullest is what bleeds between two surfaces.

That is, if there is a second one. What trails off without leading to one is the vehicle's: a side that it grazes.
"""

BRIDGED_PX = 3
"""Gaps in a surface that are as wide are pixels that happened not to match."""

NOISE_SIGMAS = 3.0

CUT_SHARE = VehicleSettings.max_edge_share
"""So much of a surface beyond the mask's edge is cut off by it, as by the border of the field of view."""


@dataclass(frozen=True)
class Moving:
    """What moves in a frame, by the background test, with the pixels that it was seen in.

    Attributes
    ----------
    cloud : PointCloud
    u, v : ndarray of int, shape (n,)
        Column and row of each point in the rectified left image.
    above : ndarray, shape (n,)
        By how much its disparity is above the road's at that pixel, standard deviations.
    height_m : ndarray, shape (n,)
        Above the road.
    crops : tuple of Crop
        Of the rectified left image, in colour: each change, with some of what is around it.
    """

    cloud: PointCloud
    u: IntArray
    v: IntArray
    above: FloatArray
    height_m: FloatArray
    crops: tuple[Crop, ...]


@dataclass(frozen=True)
class Chosen:
    """Which points of a frame stay.

    Attributes
    ----------
    keep : ndarray of bool, shape (n,)
    used : tuple of bool
        Of each vehicle: something moves in it.
    grown : int
        Vehicles whose mask cut through what moves, and was put right.
    """

    keep: BoolArray
    used: tuple[bool, ...]
    grown: int


def choose(moving: Moving, vehicles: Sequence[Vehicle], half_window_px: int) -> Chosen:
    """Choose the points that are vehicles'.

    Of what lies in a box or mask, the dominant layer of distance among what stands above the road. A box is no outline,
    and grows by half of the matcher's window first. A mask stays as it is: what bleeds over its edge goes with the
    layer, and shrunken it would lack the vehicle's own borders, 0.3 m and more of a vehicle that is 30 m away.
    Where the vehicle's largest surface goes on beyond the mask's edge, higher than any ground, the mask is wrong, and
    every surface that it touches stays as a whole, with what is as low as the road beneath it. Whether it goes on is
    told by surfaces that are as small as noise allows, and what stays by those that are as large: a right mask cuts a
    walker off who stands beside the vehicle, and a wrong one nothing.

    Parameters
    ----------
    moving : Moving
    vehicles : sequence of Vehicle
    half_window_px : int
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
    """Of a vehicle: which points lie in it, and which in it or within half a window of its edge."""

    inside: BoolArray
    wide: BoolArray


def _hull(vehicle: Vehicle, moving: Moving, half_window_px: int) -> _Hull:
    if vehicle.mask is None:  # a hull: its edges run where the vehicle's may bleed, and what bleeds goes with the layer
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
    """Return which points, of all, are seen in the columns of a surface, and no higher up than it."""
    u, top = moving.u[surface], moving.v[surface].min()
    beside = (moving.u < u.min() - half_window_px) | (moving.u > u.max() + half_window_px)
    beneath: BoolArray = ~beside & (moving.v >= top)
    return beneath


def _layer(moving: Moving, inside: BoolArray) -> BoolArray | None:
    """Return which points, of all, are as far away as most of what stands in a hull; None if nothing does."""
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
    trail = int(np.append(counts[last + 1 :], 0).argmin())  # as far as the next empty one
    if not full[last + 1 : last + 1 + trail].any():
        last += trail
    nearest = start + first * width - np.where(inside, 0.0, noise_m)  # what is as low as the road may be nearer
    layer: BoolArray = (distance >= nearest) & (number <= last)
    return layer


def _distance(moving: Moving) -> FloatArray:
    distance: FloatArray = np.linalg.norm(moving.cloud.points, axis=1)
    return distance


def _surfaces(moving: Moving, standing: BoolArray, window_px: int | None = None) -> IntArray:
    """Return the number of the surface that each point is on, shape (n,); 0 is none.

    Neighbours in the image are on one surface if their distances differ by no more than their noise explains. With
    ``window_px``, by no more than what noise they do not have in common: two windows that are k pixels apart share all
    but k of their columns, so that of the variance of the difference k / ``window_px`` is left.
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
        for other in (at[v + step, u], at[v, u + step]):
            one = np.flatnonzero(other >= 0)
            other = other[one]
            near = np.abs(distance[one] - distance[other]) <= sigmas * np.hypot(sigma[one], sigma[other])
            pairs.append((one[near], other[near]))
    one, other = (np.concatenate(part) for part in zip(*pairs, strict=True))
    links = coo_array((np.ones(len(one), dtype=bool), (one, other)), shape=(len(points), len(points)))
    numbers[points] = connected_components(links, directed=False)[1] + 1
    return numbers


def windows(
    rectangles: Iterable[tuple[int, int, int, int]], size: tuple[int, int], least_px: int
) -> list[tuple[int, int, int, int]]:
    """Return what is to be cut out of an image: what moves, with half of its size around it.

    Detectors want to see what is beside a car.

    Parameters
    ----------
    rectangles : iterable of tuple of int
        First column and row, and those after the last.
    size : tuple of int
        Width and height of the image.
    least_px : int
        Sides that are shorter are made as long as this, within the image.

    Returns
    -------
    list of tuple of int
        As the rectangles.
    """
    found = []
    for x0, y0, x1, y1 in rectangles:
        around_x, around_y = (max(side // 2, (least_px - side + 1) // 2) for side in (x1 - x0, y1 - y0))
        found.append(
            (max(x0 - around_x, 0), max(y0 - around_y, 0), min(x1 + around_x, size[0]), min(y1 + around_y, size[1]))
        )
    return found
