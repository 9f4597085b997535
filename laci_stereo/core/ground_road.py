"""The ground where vehicles drive: the road, and not the land, the verge or the pavement beside it.

The plane that most of the view speaks for need not be the road's, which may be a narrow strip in it. Once something has
driven through the scene it is known where the road is: below its wheels.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from laci_stereo.core.box import Box
from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.frames import Axes, FloatArray, invert, transform
from laci_stereo.core.ground import GroundPlane, check_support
from laci_stereo.core.ground_merge import Chart
from laci_stereo.core.reframing import transformed_xy
from laci_stereo.core.road_extent import road_along
from laci_stereo.core.road_surface import FALL, OTHER, height_of
from laci_stereo.core.settings import GroundSettings

log = logging.getLogger(__name__)

APART = np.geomspace((0.015, FALL / 8.0, FALL / 8.0), OTHER, 5)
"""Height and slopes of a ground, from the road's, standard deviations, shape (5, 3). The first are those of a ground
that is the road's: its view may show one side of the crown more than the other, by an eighth of all, and as much of the
height of a crown of 4 m to either side. The last are those of land. In between is what is partly road, or land that is
nearly even with it; as nobody knows how nearly, each doubling is as likely (Jeffreys 1946)."""

OPEN = 10.0
"""What the crown leaves open of the road it leaves open of the ground, which sees the same side of it: by so many times
that, the ground tells nothing of it."""

PASSES, SETTLED = 5, 0.1
"""What is far above a plane is not looked at from it, so the road is looked at again from its own, until that moves by
less than a third of its doubt, squared here. Where it goes on moving, it may be any that was found, and the ground if a
look comes back to that."""

FARTHEST = 4.0
"""What is farther from the ground than land is from roads, by so many standard deviations, is something else: it falls
by 11 %, or is 1.2 m higher."""

ROOM_M = 1.0
"""What moves is left out with so much around it: boxes lack what is not seen."""


def road_ground(
    survey: Sequence[PointCloud], axes: Axes, ground: GroundPlane, way: FloatArray, settings: GroundSettings
) -> GroundPlane:
    """Return the plane of the road around the way of a vehicle: what is seen of it, and of the ground as a whole.

    The ground tells the road's plane as far as it may be that plane, by `APART`. Where no road is seen, nobody knows
    whether the ground is one, or only one side of it.

    Parameters
    ----------
    survey : sequence of PointCloud
        Without what moves.
    axes : Axes
    ground : GroundPlane
    way : ndarray, shape (n, 2)
        Of a vehicle, in the level frame of this ground; see `places`.
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
    """Return clouds without what is in or near what moves in their frames.

    Parameters
    ----------
    survey : sequence of PointCloud
    T_level_sensor : ndarray, shape (4, 4)
    boxes : mapping of int to sequence of Box
        Of what moves, in the level frame, by the frame's stamp.
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
    """Return the plane of the road along a way on a ground, looked at in the level frame of what was found of it.

    It is there three times: with its doubt, with what of that the crown leaves open, and with what edges that may be
    none add to it. None if no road is seen near the ground.
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
    """Return the road's plane, from the ground's, and its covariance, as the road and the ground tell together.

    Parameters
    ----------
    off : ndarray, shape (3,)
        What is seen of the road, from the ground.
    of_road : ndarray, shape (3, 3)
        Its covariance.
    cases, land : ndarray, shape (3, 3)
        How far the ground may be from the road's plane, in cases that are as likely as one another beforehand. What is
        seen of the road holds that of land already.
    """
    # A road that is bent much is known less well than beforehand, and tells nothing then, but not less.
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
    """Return the covariance, in a chart, of a height and two slopes with some standard deviations, shape (3, 3)."""
    covariance: FloatArray = (by_plane * np.square(sigmas)) @ by_plane.T
    return covariance


def _by_plane(chart: Chart, axes: Axes, place: FloatArray) -> FloatArray:
    """Return what changes coordinates in a chart by height, at a place in the level frame, and slopes, shape (3, 3)."""
    across = chart.ground.T_level_sensor(axes)[:2, :3] @ chart.across
    by = np.zeros((3, 3))
    by[:2, 1:] = -across.T
    by[2] = -1.0, *place
    return by
