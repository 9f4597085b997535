"""Several drives past one sensor in one level frame: merging of their grounds, transformation of each drive onto it.

The drives are also moved from the map onto the ground, if their altitudes show a slope.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from laci_stereo.core.errors import CombineError
from laci_stereo.core.estimation.agreement import weighted_mean
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.frames import FloatArray, invert, planar
from laci_stereo.core.ground.merge import Chart
from laci_stereo.core.ground.plane import GroundPlane
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import MAX_GAP_S
from laci_stereo.core.messages.slope import slope_of
from laci_stereo.core.tracking.reframing import (
    moved_vehicle,
    reported_on_map,
    transformed_background,
    transformed_track,
)
from laci_stereo.core.world import World

GROUND_GATE = 5.0
"""Largest difference of two grounds in standard deviations: one of 10 000 pairs is beyond 4.6 (3 degrees of freedom),
and the covariance of a ground does not include that other parts of the road are seen each time, for example because
wheels hide it."""

SWAY_RAD = 5e-4
"""Standard deviation of the tilt of an untouched sensor from drive to drive: a steel mast 0.15 m wide and 6 m high
whose sunny side is 5 K warmer bends by 1.2e-5 / K x 5 K / 0.15 m x 6 m = 2.4 mrad, which is the extreme case."""

GROWTH_M = 1e-3
"""Standard deviation of its height from drive to drive: 6 m of steel and 15 K."""


def merge_grounds(passages: Sequence[Passage]) -> GroundPlane:
    """Return the mean of the grounds of several drives, weighted by their inverse covariances.

    The road and the sensor are the same each time, so the errors of the drives are fully correlated: the information is
    the mean of theirs, not the sum.

    Raises
    ------
    CombineError
        If two grounds differ significantly, so that the sensor was moved between them.
    """
    first = passages[0].ground
    if len(passages) == 1:
        return first
    chart = Chart.around(first)
    values = chart.values([passage.ground for passage in passages])
    sway = np.diag([SWAY_RAD, SWAY_RAD, GROWTH_M]) ** 2
    covariances = np.array([chart.covariance(passage.ground) + sway for passage in passages])
    _check_unmoved(passages, values, covariances)
    mean, covariance = weighted_mean(values, covariances)
    return chart.plane(mean, len(passages) * covariance)


def _check_unmoved(passages: Sequence[Passage], values: FloatArray, covariances: FloatArray) -> None:
    for i, j in combinations(range(len(passages)), 2):
        off = values[j] - values[i]
        sigmas = float(np.sqrt(off @ np.linalg.solve(covariances[i] + covariances[j], off)))
        if sigmas > GROUND_GATE:
            turned_deg = np.degrees(np.arcsin(min(1.0, float(np.linalg.norm(off[:2])))))
            raise CombineError(
                f"the sensor was moved between the drives: in {passages[j].name} its tilt is {turned_deg:.2f} deg and "
                f"its height {off[2]:+.3f} m off {passages[i].name} ({sigmas:.1f} sigma); needed are at most "
                f"{GROUND_GATE:g} sigma"
            )


def lay(passage: Passage, ground: GroundPlane, world: World) -> Passage:
    """Transform a drive to the level frame of another ground and the map of another world in the same UTM zone."""
    T_own_sensor = passage.ground.T_level_sensor(passage.axes)
    T_level_sensor = ground.T_level_sensor(passage.axes)
    T_level_own = T_level_sensor @ invert(T_own_sensor)
    T_own_world_level = planar(passage.match.yaw_rad, passage.match.shift) @ invert(T_level_own)
    yaw = float(np.arctan2(T_own_world_level[1, 0], T_own_world_level[0, 0]))
    shift = T_own_world_level[None, :2, 3]
    if passage.vehicle.slope is not None:
        shift = passage.vehicle.slope.on_map(shift)
    xy, yaw_rad = reported_on_map(passage.vehicle)
    return replace(
        passage,
        world=world,
        ground=ground,
        background=transformed_background(T_level_own, passage.background),
        track=transformed_track(T_level_own, passage.track),
        vehicle=moved_vehicle(passage.vehicle, _between_worlds(xy, passage.world, world), yaw_rad, None),
        match=PlanarMatch(yaw, _between_worlds(shift, passage.world, world)[0]),
    )


def _between_worlds(xy: FloatArray, own: World, world: World) -> FloatArray:
    return world.from_utm(own.to_utm(xy))


def along_ground(passages: Sequence[Passage]) -> list[Passage]:
    """Move drives from the map of one world onto their common ground, if their altitudes determine its slope."""
    slope = slope_of([_heights_in_view(passage) for passage in passages])
    if slope is None:
        return list(passages)
    return [
        replace(
            passage,
            vehicle=moved_vehicle(passage.vehicle, *reported_on_map(passage.vehicle), slope),
            match=replace(passage.match, shift=slope.along_ground(passage.match.shift[None])[0]),
        )
        for passage in passages
    ]


def _heights_in_view(passage: Passage) -> tuple[FloatArray, FloatArray]:
    """Return the positions and altitudes reported while a drive is in view: farther away the road may bend."""
    vehicle = passage.vehicle
    seen_s = np.array([sighting.stamp_s for sighting in passage.track.sightings]) + passage.time_offset_s
    near = (vehicle.stamps_s >= seen_s.min() - MAX_GAP_S) & (vehicle.stamps_s <= seen_s.max() + MAX_GAP_S)
    altitude_m = np.full(len(near), np.nan) if vehicle.altitude_m is None else vehicle.altitude_m
    return reported_on_map(vehicle)[0][near], altitude_m[near]
