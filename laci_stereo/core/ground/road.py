"""The ground plane where vehicles drive: that of the road, not of the terrain, the verge or the pavement beside it.

The plane that most of the view supports need not be that of the road, which may be a narrow strip in the view. Once a
vehicle has driven through the scene, the place of the road is known: below its wheels.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.frames import Axes, FloatArray, invert, transform
from laci_stereo.core.ground.merge import Chart
from laci_stereo.core.ground.plane import GroundPlane, check_support
from laci_stereo.core.ground.road_extent import road_along
from laci_stereo.core.ground.road_surface import FALL, OTHER, height_of
from laci_stereo.core.settings import GroundSettings
from laci_stereo.core.tracking.box import Box
from laci_stereo.core.tracking.reframing import transformed_xy

log = logging.getLogger(__name__)

APART = np.geomspace((0.015, FALL / 8.0, FALL / 8.0), OTHER, 5)
"""Standard deviations of the height and the two slopes of the ground relative to the road's plane, shape (5, 3). The
first row is for a ground that is the road: its view may show one side of the crown more than the other, which moves its
slopes by an eighth of the fall, and its height by an eighth of that of a crown with sides of 4 m. The last row is for
terrain. The rows in between are for a ground that is partly road, or for terrain that is nearly level with the road; as
it is unknown how nearly, each doubling is equally likely (Jeffreys 1946)."""

OPEN = 10.0
"""The uncertainty that the crown causes in the road's plane is also in the ground's plane, for which the same side of
the crown was seen. Multiplied by this factor, this covariance makes the ground uninformative about the crown."""

PASSES, SETTLED = 5, 0.1
"""Largest number of passes, and the limit of convergence. Points far above the current plane are left out, so the road
is estimated again relative to its own plane, until the estimate moves by less than a third of its standard deviation;
`SETTLED` is the square of this. If it does not converge, the planes of all passes are equally likely, including that of
the ground where a pass returned to it."""

FARTHEST = 4.0
"""Largest offset of a road from the ground, in the standard deviations of `OTHER`: a surface that falls by 11 % more,
or is 1.2 m higher, is something else."""

ROOM_M = 1.0
"""Margin by which the boxes of moving objects are enlarged before their points are removed: boxes do not cover the
hidden parts of an object."""


def road_ground(
    survey: Sequence[PointCloud], axes: Axes, ground: GroundPlane, way: FloatArray, settings: GroundSettings
) -> GroundPlane:
    """Return the plane of the road around a vehicle's path, from the visible road and the ground as a whole.

    The ground is evidence of the road's plane, in that its offset from the road has the priors of `APART`. Where no
    road is seen, it is unknown whether the ground is a road, or only one side of one; the ground is then returned with
    the standard deviation of a fall in its slopes.

    Parameters
    ----------
    survey : sequence of PointCloud
        Clouds without the points of moving objects.
    axes : Axes
    ground : GroundPlane
    way : ndarray, shape (n, 2)
        Path of a vehicle, in the level frame of ``ground``; see `places`.
    settings : GroundSettings

    Raises
    ------
    GroundError
        If no road is seen, and too little of the view supports the ground.
    """
    chart = Chart.around(ground)
    by_plane = _by_plane(chart, axes, way.mean(axis=0))
    value, found = chart.values([ground])[0], ground
    offs: list[FloatArray] = [np.zeros(3)]
    doubts: list[FloatArray] = []
    for _ in range(PASSES):
        seen = _seen_from(found, ground, survey, axes, way, settings)
        if seen is None:
            log.debug("no road is seen along the way")
            check_support(ground, settings)
            off, told = np.zeros(3), chart.covariance(ground) + _spread(by_plane, (0.0, FALL, FALL))
            doubt = told
        else:
            road, by_crown, by_edges = seen
            (of_road,) = chart.values([road])
            alike = chart.covariance(ground) + OPEN * chart.covariance(by_crown)
            cases = [alike + _spread(by_plane, apart) for apart in APART[:-1]]
            off, told = _together(of_road - value, chart.covariance(road), cases, _spread(by_plane, OTHER))
            doubt = told + chart.covariance(by_edges)
        moved, found = off - offs[-1], chart.plane(value + off, doubt)
        offs.append(off)
        doubts.append(doubt)
        if moved @ np.linalg.solve(told, moved) < SETTLED:
            return found
    among = np.cov(np.transpose(offs[1:]), bias=True)
    return chart.plane(value + np.mean(offs[1:], axis=0), np.mean(doubts, axis=0) + among)


def standing(
    survey: Sequence[PointCloud], T_level_sensor: FloatArray, boxes: Mapping[int, Sequence[Box]]
) -> tuple[PointCloud, ...]:
    """Return the clouds without the points in or near the objects that move in their frames.

    Parameters
    ----------
    survey : sequence of PointCloud
    T_level_sensor : ndarray, shape (4, 4)
    boxes : mapping of int to sequence of Box
        Boxes of the moving objects, in the level frame, by the frame's stamp in nanoseconds.
    """
    found = []
    for cloud in survey:
        xy = transform(T_level_sensor, cloud.points)[:, :2]
        stands = np.ones(len(cloud), dtype=bool)
        for box in boxes.get(cloud.stamp_ns, ()):
            stands &= ~box.contains(xy, ROOM_M)
        found.append(cloud[stands])
    return tuple(found)


def _seen_from(
    found: GroundPlane,
    ground: GroundPlane,
    survey: Sequence[PointCloud],
    axes: Axes,
    way: FloatArray,
    settings: GroundSettings,
) -> tuple[GroundPlane, GroundPlane, GroundPlane] | None:
    """Return the plane of the road along a path on the ground, estimated in the level frame of the plane ``found``.

    The plane is returned three times, with different covariances: its own; the part of that which is due to the crown;
    and the additional covariance due to edges that may not be real. None is returned if no road is seen near the
    ground.
    """
    T_level_sensor, T_ground_sensor = found.T_level_sensor(axes), ground.T_level_sensor(axes)
    T_level_ground = T_level_sensor @ invert(T_ground_sensor)
    normal, origin = T_level_ground[:3, 2], T_level_ground[:3, 3]
    before = np.append(normal @ origin, -normal[:2]) / normal[2]
    road = road_along(transformed_xy(T_level_ground, way), survey, T_level_sensor, axes, before, settings)
    if road is None:
        return None
    surface = road.found
    plane, covariance, by_crown = surface.plane()
    off = plane - np.append(height_of(before, surface.middle), before[1:])
    if (np.abs(off) > FARTHEST * np.array(OTHER)).any():
        return None
    chart = Chart.around(found)
    by_plane = _by_plane(chart, axes, surface.middle)
    value = chart.values([found])[0] + by_plane @ plane
    of_road, of_crown, of_edges = (
        chart.plane(value, by_plane @ part @ by_plane.T) for part in (covariance, by_crown, road.apart())
    )
    return of_road, of_crown, of_edges


def _together(
    off: FloatArray, of_road: FloatArray, cases: Sequence[FloatArray], land: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the offset of the road's plane from the ground's, shape (3,), and its covariance, from both together.

    Parameters
    ----------
    off : ndarray, shape (3,)
        Estimated offset of the road from the ground.
    of_road : ndarray, shape (3, 3)
        Covariance of this estimate.
    cases, land : ndarray, shape (3, 3)
        Prior covariances of the offset, in cases that are equally likely a priori. The estimate of the road already
        includes the prior for terrain, ``land``.
    """
    # The posterior of a strongly bent road can be wider than its prior: it has no information then, not a negative one.
    root = np.linalg.cholesky(land)
    values, vectors = np.linalg.eigh(root.T @ np.linalg.inv(of_road) @ root - np.eye(len(off)))
    by_road = np.linalg.solve(root.T, vectors[:, values > 0.0])
    seen = (by_road * values[values > 0.0]) @ by_road.T
    told = by_road @ (vectors[:, values > 0.0].T @ root.T @ np.linalg.solve(of_road, off))
    log_likely, means, covariances = [], [], []
    for before in (*cases, land):
        covariance = np.linalg.inv(seen + np.linalg.inv(before))
        mean = covariance @ told
        log_likely.append(0.5 * (told @ mean + np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(before)[1]))
        means.append(mean)
        covariances.append(covariance)
    likely = np.exp(np.array(log_likely) - np.logaddexp.reduce(log_likely))
    mean = likely @ np.array(means)
    apart = np.array(means) - mean
    return mean, np.tensordot(likely, covariances, 1) + (apart.T * likely) @ apart


def _spread(by_plane: FloatArray, sigmas: ArrayLike) -> FloatArray:
    """Return the covariance, in a chart, of a height and two slopes with given standard deviations, shape (3, 3)."""
    covariance: FloatArray = (by_plane * np.square(sigmas)) @ by_plane.T
    return covariance


def _by_plane(chart: Chart, axes: Axes, place: FloatArray) -> FloatArray:
    """Return the derivative of chart coordinates by height and slopes at a place in the level frame, shape (3, 3)."""
    across = chart.ground.T_level_sensor(axes)[:2, :3] @ chart.across
    by = np.zeros((3, 3))
    by[:2, 1:] = -across.T
    by[2] = -1.0, *place
    return by
