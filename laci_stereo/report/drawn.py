"""What of a calibration the pictures show, in the world frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from laci_stereo.core.box import Box
from laci_stereo.core.frames import FloatArray, invert, transform
from laci_stereo.core.result import Calibration
from laci_stereo.core.sighting import Sighting
from laci_stereo.report.lines import runs

SAME_STAMP_S = 1e-4
"""A frame's stamp in seconds has come through floating-point numbers; no two frames are so near to each other."""

TRACK_STEP_S = 0.1
"""At 50 km/h this is the length of a car's bonnet; between messages the track is a curve."""


def drives_of(calibration: Calibration) -> Iterator[Calibration]:
    """Yield the calibration with each of its drives as its only one, and its vehicle as the estimate has it."""
    for passage in calibration.passages:
        yield replace(
            calibration,
            track=passage.track,
            vehicle=passage.body or passage.vehicle,
            body=None,
            station_id=passage.station_id,
            time_offset_s=passage.time_offset_s,
            background=passage.background,
            others=(),
        )


def stations_of(calibration: Calibration) -> str:
    """Name the senders."""
    numbers = [str(each.station_id) for each in calibration.passages]
    return f"station{'s' if len(numbers) > 1 else ''} {', '.join(dict.fromkeys(numbers))}"


def T_world_level(calibration: Calibration) -> FloatArray:
    """Return the transform from the level frame into the world, shape (4, 4)."""
    return calibration.T_world_sensor @ invert(calibration.T_level_sensor)


def on_ground(xy: FloatArray) -> FloatArray:
    """Lift points of the ground plan, shape (n, 2), into space, shape (n, 3)."""
    return np.column_stack([xy, np.zeros(len(xy))])


def plan_in_world(calibration: Calibration, xy_level: FloatArray) -> FloatArray:
    """Map points of the ground plan, shape (n, 2), from level to world."""
    return transform(T_world_level(calibration), on_ground(xy_level))[:, :2]


def background_corners(calibration: Calibration) -> list[FloatArray]:
    """Return the corners of the background's boxes, world, shape (4, 2) each."""
    return [plan_in_world(calibration, static.box.corners()) for static in calibration.background.boxes]


def sensor_track(calibration: Calibration) -> FloatArray:
    """Return the centres of the boxes that the sensor saw and that were used, world, shape (n, 2)."""
    return plan_in_world(calibration, np.concatenate([drive.track.centres for drive in calibration.passages]))


def sender_track(calibration: Calibration) -> list[FloatArray]:
    """Return where the vehicles drove as their messages tell: pieces without a gap, world, shape (n, 2) each."""
    pieces: list[FloatArray] = []
    for vehicle in (drive.vehicle for drive in drives_of(calibration)):
        first_s, last_s = vehicle.stamps_s[[0, -1]]
        xy, _, known = vehicle.at(np.append(np.arange(first_s, last_s, TRACK_STEP_S), last_s))
        pieces += [xy[run] for run in runs(known)]
    return pieces


def sender_box(calibration: Calibration, stamp_s: float) -> Box | None:
    """Return the vehicle as its messages tell it, on the ground plan of the world, with yaw to its front.

    Parameters
    ----------
    calibration : Calibration
    stamp_s : float
        Of the sensor.

    Returns
    -------
    Box or None
        None where the messages do not tell.
    """
    vehicle = calibration.vehicle
    xy, yaw_rad, known = vehicle.at(np.array([stamp_s + calibration.time_offset_s]))
    return Box(xy[0], vehicle.length_m, vehicle.width_m, float(yaw_rad[0])) if known[0] else None


def sighting_at(calibration: Calibration, stamp_s: float) -> Sighting | None:
    """Return what the sensor saw of the vehicle in the frame of that stamp, if it did."""
    sightings = calibration.track.sightings
    nearest = min(sightings, key=lambda sighting: abs(sighting.stamp_s - stamp_s), default=None)
    return nearest if nearest is not None and abs(nearest.stamp_s - stamp_s) < SAME_STAMP_S else None


def known_stamps(calibration: Calibration) -> FloatArray:
    """Return the stamps of the sightings that can be compared with the messages, shape (n,)."""
    stamps_s = calibration.track.stamps_s
    _, _, known = calibration.vehicle.at(stamps_s + calibration.time_offset_s)
    kept: FloatArray = stamps_s[known]
    return kept
