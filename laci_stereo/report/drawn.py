"""The parts of a calibration that pictures show, in the world frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from laci_stereo.core.frames import FloatArray, invert, transform
from laci_stereo.core.result import Calibration
from laci_stereo.core.tracking.box import Box
from laci_stereo.core.tracking.sighting import Sighting
from laci_stereo.report.lines import runs

SAME_STAMP_S = 1e-4
"""Tolerance for equal stamps, as stamps in seconds have rounding errors; no two frames are this close in time."""

TRACK_STEP_S = 0.1
"""Step at which the messages' track, a curve between messages, is sampled: at 50 km/h the length of a car's bonnet."""


def drives_of(calibration: Calibration) -> Iterator[Calibration]:
    """Yield the calibration with each of its drives as the only one, and the vehicle as estimated (`Passage.body`)."""
    for passage in calibration.passages:
        yield replace(calibration, passages=(replace(passage, vehicle=passage.body or passage.vehicle, body=None),))


def stations_of(calibration: Calibration) -> str:
    """Return the stations whose drives were used, in words."""
    numbers = [str(each.station_id) for each in calibration.passages]
    return f"station{'s' if len(numbers) > 1 else ''} {', '.join(dict.fromkeys(numbers))}"


def T_world_level(calibration: Calibration) -> FloatArray:
    """Return the transform from the level frame into the world, shape (4, 4)."""
    return calibration.T_world_sensor @ invert(calibration.T_level_sensor)


def on_ground(xy: FloatArray) -> FloatArray:
    """Return points of the ground plan, shape (n, 2), as points with z = 0, shape (n, 3)."""
    return np.column_stack([xy, np.zeros(len(xy))])


def plan_in_world(calibration: Calibration, xy_level: FloatArray) -> FloatArray:
    """Map points of the ground plan, shape (n, 2), from level to world."""
    return transform(T_world_level(calibration), on_ground(xy_level))[:, :2]


def background_corners(calibration: Calibration) -> list[FloatArray]:
    """Return the corners of the static background's boxes, world, shape (4, 2) each."""
    return [plan_in_world(calibration, static.box.corners()) for static in calibration.drive.background.boxes]


def sensor_track(calibration: Calibration) -> FloatArray:
    """Return the centres of the sensor's boxes in the frames used, of all drives, world, shape (n, 2)."""
    return plan_in_world(calibration, np.concatenate([drive.track.centres for drive in calibration.passages]))


def sender_track(calibration: Calibration) -> list[FloatArray]:
    """Return the vehicles' tracks according to their messages: pieces without gaps, world, shape (n, 2) each."""
    pieces: list[FloatArray] = []
    for vehicle in (alone.drive.vehicle for alone in drives_of(calibration)):
        first_s, last_s = vehicle.stamps_s[[0, -1]]
        xy, _, known = vehicle.at(np.append(np.arange(first_s, last_s, TRACK_STEP_S), last_s))
        pieces += [xy[run] for run in runs(known)]
    return pieces


def sender_box(calibration: Calibration, stamp_s: float) -> Box | None:
    """Return the vehicle's box according to its messages, on the ground plan of the world, with yaw to its front.

    ``stamp_s`` is a time on the sensor's clock. None where the messages do not determine the position.
    """
    vehicle = calibration.drive.vehicle
    xy, yaw_rad, known = vehicle.at(np.array([stamp_s + calibration.drive.time_offset_s]))
    return Box(xy[0], vehicle.length_m, vehicle.width_m, float(yaw_rad[0])) if known[0] else None


def sighting_at(calibration: Calibration, stamp_s: float) -> Sighting | None:
    """Return the sighting of the vehicle with this stamp; None if there is none."""
    sightings = calibration.drive.track.sightings
    nearest = min(sightings, key=lambda sighting: abs(sighting.stamp_s - stamp_s), default=None)
    return nearest if nearest is not None and abs(nearest.stamp_s - stamp_s) < SAME_STAMP_S else None


def known_stamps(calibration: Calibration) -> FloatArray:
    """Return the stamps of the sightings for which the messages determine a position, shape (n,)."""
    stamps_s = calibration.drive.track.stamps_s
    _, _, known = calibration.drive.vehicle.at(stamps_s + calibration.drive.time_offset_s)
    kept: FloatArray = stamps_s[known]
    return kept
