"""Sightings moved from the level frame of one ground to that of another, or distorted, and reports on the map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from laci_stereo.core.frames import FloatArray, rotate_xy, transform, wrap
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.messages.slope import Slope
from laci_stereo.core.tracking.background import Background
from laci_stereo.core.tracking.box import Box
from laci_stereo.core.tracking.sighting import Sighting
from laci_stereo.core.tracking.tracks import Track


def transformed_xy(T_a_b: FloatArray, xy: FloatArray) -> FloatArray:
    """Map points on the ground of b, shape (n, 2), to the ground plan of a."""
    return transform(T_a_b, np.column_stack([xy, np.zeros(len(xy))]))[:, :2]


def transformed_track(T_a_b: FloatArray, track: Track) -> Track:
    """Map a track from the level frame of b to that of a."""

    def moved(sighting: Sighting) -> Sighting:
        cameras = sighting.cameras and sighting.cameras.turned(T_a_b[:3, :3])
        laid = _mapped(sighting, lambda points: transform(T_a_b, points), _laid_box(T_a_b, sighting.box))
        return replace(laid, cameras=cameras)

    return Track(tuple(map(moved, track.sightings)))


def mirrored_track(track: Track) -> Track:
    """Return a track with left and right exchanged."""
    over = np.array([1.0, -1.0, 1.0])

    def mirrored(sighting: Sighting) -> Sighting:
        box = replace(sighting.box, centre=sighting.box.centre * over[:2], yaw_rad=-sighting.box.yaw_rad)
        laid = _mapped(sighting, lambda points: points * over, box)
        cameras = sighting.cameras and sighting.cameras.turned(np.diag(over))
        return replace(laid, borders=laid.borders[::-1], begin_rad=-sighting.begin_rad, cameras=cameras)

    return Track(tuple(map(mirrored, track.sightings)))


def stretched_track(track: Track, ahead: float, aside: float) -> Track:
    """Return a track scaled by ``ahead`` along the sensor's axis, and by ``aside`` across it and vertically."""
    over = np.array([ahead, aside, aside])

    def stretched(sighting: Sighting) -> Sighting:
        laid = _mapped(sighting, lambda points: points * over, _stretched_box(sighting.box, over[:2]))
        return replace(laid, sigma_along_m=sighting.sigma_along_m * ahead)

    return Track(tuple(map(stretched, track.sightings)))


def nearer_track(track: Track, per_m: float) -> Track:
    """Return a track whose inverse distances from the sensor, on the ground plan, are larger by ``per_m``.

    Boxes keep their directions: those in view are small relative to their distance.
    """

    def by(xy: FloatArray) -> FloatArray:
        scale: FloatArray = 1.0 / np.maximum(1.0 + per_m * np.linalg.norm(xy, axis=-1, keepdims=True), 1e-3)
        return scale

    def nearer(sighting: Sighting) -> Sighting:
        box = replace(sighting.box, centre=sighting.box.centre * by(sighting.box.centre))
        laid = _mapped(sighting, lambda points: np.hstack([points[:, :2] * by(points[:, :2]), points[:, 2:]]), box)
        return replace(laid, sigma_along_m=sighting.sigma_along_m * by(sighting.points[:, :2])[:, 0] ** 2)

    return Track(tuple(map(nearer, track.sightings)))


def _mapped(sighting: Sighting, points_to: Callable[[FloatArray], FloatArray], box: Box) -> Sighting:
    """Return a sighting with another box, and with all its points, shape (n, 3), mapped."""
    return replace(
        sighting,
        points=points_to(sighting.points),
        low=replace(sighting.low, points=points_to(sighting.low.points)),
        borders=points_to(sighting.borders),
        middle=points_to(np.append(sighting.middle, 0.0)[None])[0, :2],
        box=box,
    )


def reported_on_map(vehicle: VehicleTrack) -> tuple[FloatArray, FloatArray]:
    """Return the positions of a vehicle's messages, shape (n, 2), and its yaws, shape (n,), on the map."""
    xy = vehicle.xy + rotate_xy(vehicle.yaw_rad, np.tile(vehicle.reference, (len(vehicle.xy), 1)))
    if vehicle.slope is None:
        return xy, vehicle.yaw_rad
    return vehicle.slope.on_map(xy), vehicle.slope.yaw_on_map(vehicle.yaw_rad)


def moved_vehicle(vehicle: VehicleTrack, xy: FloatArray, yaw_rad: FloatArray, slope: Slope | None) -> VehicleTrack:
    """Return a vehicle with positions and yaws as `reported_on_map` returns them, along the ground if it slopes."""
    if slope is not None:
        xy, yaw_rad = slope.along_ground(xy), slope.yaw_along_ground(yaw_rad)
    centre = xy - rotate_xy(yaw_rad, np.tile(vehicle.reference, (len(xy), 1)))
    return replace(vehicle, xy=centre, yaw_rad=yaw_rad, slope=slope)


def transformed_background(T_a_b: FloatArray, background: Background) -> Background:
    """Map a background from the level frame of b to that of a."""
    boxes = tuple(replace(static, box=_laid_box(T_a_b, static.box)) for static in background.boxes)
    return replace(background, boxes=boxes)


def _laid_box(T_a_b: FloatArray, box: Box) -> Box:
    turned = 2 * (box.yaw_rad + np.arctan2(T_a_b[1, 0], T_a_b[0, 0]))
    return replace(box, centre=transformed_xy(T_a_b, box.centre[None])[0], yaw_rad=float(wrap(turned)) / 2)


def _stretched_box(box: Box, over: FloatArray) -> Box:
    sides = rotate_xy(box.yaw_rad, np.eye(2)) * over
    sizes = np.array([box.length_m, box.width_m]) * np.linalg.norm(sides, axis=1)
    long = int(sizes.argmax())
    along = sides[long] * np.sign(sides[long, 0] or 1.0)
    return Box(box.centre * over, float(sizes[long]), float(sizes[1 - long]), float(np.arctan2(along[1], along[0])))
