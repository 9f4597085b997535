"""The ground where vehicles drive: the road, and not the land, the verge or the pavement beside it.

The plane that most of the view speaks for need not be the road's, which may be a narrow strip in it. Once something has
driven through the scene it is known where the road is: below its wheels.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree
from scipy.special import chdtri

from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.errors import GroundError
from laci_stereo.core.frames import Axes, FloatArray, IntArray, dot_xy, transform, turned
from laci_stereo.core.ground import GroundPlane, fit_ground
from laci_stereo.core.ground_merge import Chart
from laci_stereo.core.ground_uneven import ONE_SURFACE_M
from laci_stereo.core.settings import GroundSettings
from laci_stereo.core.tracking import Track

log = logging.getLogger(__name__)

REACHES_M = (3.0, 5.0, 8.0)
"""So far beside a way there is road: the lane, a lane and a half, or a carriageway of two lanes."""

STEP_M = 0.5

LANE_M = 3.5
"""Of a lane, and of the one beside it."""

LOWER_M = 0.1
"""A kerb is higher."""

SEEN_SHARE = 1.0 / 3.0
"""A side of the way is seen where as much of it is seen as this share of the other: of a road that falls to both sides,
a plane through three parts of one and one of the other has half of the fall."""

FALSE_ALARM = 0.05
"""Probability that a ground is replaced although it is the road: that costs accuracy, and to take land for the road
costs more."""

FALL_RAD = float(np.arctan(0.025)) / np.sqrt(3.0)
"""How a road falls to either side of its crown, so that it drains: by anything up to 2.5 %, one standard deviation. Of
a plane that nothing else was held against nobody knows which side it is of, or whether of both."""

CROWN_RAD = FALL_RAD / 2.0
"""By how much a lane may be tilted against its carriageway: a strip that is wider than the lane has less than half."""


def road_ground(
    survey: Sequence[PointCloud], axes: Axes, ground: GroundPlane, track: Track, settings: GroundSettings
) -> GroundPlane:
    """Hold a ground against the road around the way of a vehicle.

    Where the road is one even surface and another plane than the ground, by more than a lane and its carriageway are,
    it is returned in its place. Otherwise the ground stays, and its doubt grows by what the road differs from it, or,
    where that is not known, by what a lane and its carriageway do. It is known by the narrowest strip: what is wider
    than the road is mostly land. And it is not known where only one side of the way is seen, which may be all on one
    side of the crown.

    Parameters
    ----------
    survey : sequence of PointCloud
    axes : Axes
    ground : GroundPlane
    track : Track
        Of a vehicle, in the level frame of this ground.
    settings : GroundSettings
    """
    way = _places(track)
    chart = Chart.around(ground)
    fall = _turned_by(FALL_RAD, chart, ground, axes, way.mean(axis=0))
    crown = (CROWN_RAD / FALL_RAD) ** 2 * fall
    whole = chart.covariance(ground)
    points, along_m, across_m = (
        np.concatenate([getattr(cloud, name) for cloud in survey])
        for name in ("points", "sigma_along_m", "sigma_across_m")
    )
    level = transform(ground.T_level_sensor(axes), points)
    away_m, nearest = map(np.asarray, cKDTree(way).query(level[:, :2], distance_upper_bound=max(REACHES_M)))
    strips = {}
    for reach_m in REACHES_M:
        near = away_m < reach_m
        strip = _strip(points[near], along_m[near], across_m[near], axes, settings)
        if strip is not None:
            strips[reach_m] = strip
    road = _widest(strips.values(), chart, crown)
    if road is not None and _differ(ground, road, chart, crown):
        log.info("ground: the road is another plane, %.3f m below the sensor", road.height_m)
        return chart.plane(chart.values([road])[0], chart.covariance(road) + fall)
    share, narrowest = 1.0, strips.get(REACHES_M[0])
    if narrowest is not None and _both_sides(way, level, away_m, nearest):
        value, of_road = chart.values([ground, narrowest])
        share = min(1.0, float(np.linalg.norm((of_road - value)[:2])) / CROWN_RAD)
    doubt = whole + share**2 * fall
    return replace(ground, covariance_sensor=chart.plane(chart.values([ground])[0], doubt).covariance_sensor)


def _places(track: Track) -> FloatArray:
    """Return where a vehicle was, level frame, shape (n, 2), in turn, each place once, however long it stood there."""
    cells = np.floor(np.array([sighting.box.centre for sighting in track.sightings]) / STEP_M)
    first = np.sort(np.unique(cells, axis=0, return_index=True)[1])
    return (cells[first] + 0.5) * STEP_M


def _both_sides(way: FloatArray, level: FloatArray, away_m: FloatArray, nearest: IntArray) -> bool:
    """Tell whether road is seen on both sides of a way: where the next lane would be, to its left and to its right.

    Parameters
    ----------
    way : ndarray, shape (m, 2)
        In turn.
    level : ndarray, shape (n, 3)
        What is seen.
    away_m, nearest : ndarray, shape (n,)
        How far each of it is from the way, and from which place of it.
    """
    number, lane = np.arange(len(way)), round(LANE_M / STEP_M)
    along = way[np.minimum(number + lane, len(way) - 1)] - way[np.maximum(number - lane, 0)]
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-9)[:, None]
    road = (away_m < 1.5 * LANE_M) & (np.abs(level[:, 2]) < LOWER_M)
    xy, at = level[road, :2], nearest[road]
    left = dot_xy(turned(along[at]), xy - way[at])
    beside = np.abs(left) > LANE_M / 2
    found = np.unique(np.column_stack([np.floor(xy[beside] / STEP_M), left[beside] > 0.0]), axis=0)
    on_left = float(found[:, 2].sum())
    fewer, more = sorted([on_left, len(found) - on_left])
    return bool(fewer > SEEN_SHARE * more)


def _strip(
    points: FloatArray, sigma_along_m: FloatArray, sigma_across_m: FloatArray, axes: Axes, settings: GroundSettings
) -> GroundPlane | None:
    """Return the plane of what is near the way, where that is one even surface."""
    try:
        road = fit_ground(points, sigma_along_m, sigma_across_m, axes.up, settings)
    except GroundError as error:
        log.debug("road along the way: %s", error)
        return None
    return road if road.unevenness_m <= ONE_SURFACE_M else None


def _widest(strips: Iterable[GroundPlane], chart: Chart, crown: FloatArray) -> GroundPlane | None:
    """Return the widest strip that is the same plane as the narrower ones: a raised pavement may pass for a slope."""
    widest = None
    for strip in strips:
        if widest is not None and _differ(widest, strip, chart, crown):
            break
        widest = strip
    return widest


def _differ(one: GroundPlane, other: GroundPlane, chart: Chart, crown: FloatArray) -> bool:
    """Tell whether two planes are farther apart than their doubt, and a lane and its carriageway, explain."""
    value, of_other = chart.values([one, other])
    off = of_other - value
    covariance = chart.covariance(one) + chart.covariance(other) + crown
    return bool(off @ np.linalg.solve(covariance, off) > chdtri(3, FALSE_ALARM))


def _turned_by(angle_rad: float, chart: Chart, ground: GroundPlane, axes: Axes, middle: FloatArray) -> FloatArray:
    """Return the covariance of a plane that is turned by some angle about the middle of the way, in the chart."""
    R = ground.T_level_sensor(axes)[:3, :3]
    by = np.zeros((3, 2))
    for axis in range(2):
        by[:2, axis] = chart.across.T @ np.cross(ground.normal, R[axis])
    by[2] = -middle[1], middle[0]
    covariance: FloatArray = angle_rad**2 * by @ by.T
    return covariance
