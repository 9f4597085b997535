"""Motion compensation: moves a vehicle's points, measured one after the other, to their places at one time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from laci_stereo.core.errors import BoxError
from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.settings import Settings, TrackSettings
from laci_stereo.core.tracking.sighting import Sighting, box_around
from laci_stereo.core.tracking.tracks import GATE, Track

WINDOW_S = 1.0
"""Time before and after a sighting over which a vehicle's acceleration is taken as constant."""

TURN_RADIUS_M = 5.0
"""Radius of the tightest turn of a passenger car's middle: turning circles have a diameter of at least 10 m."""

NEGLIGIBLE_M = 0.005
"""Motion between a sighting's points that is ignored: far less than the deviation of bodies from any outline."""


def deskewed(track: Track, settings: Settings) -> Track:
    """Move the points of every sighting to their places at its stamp.

    A scanner measures the two ends of a near car up to 20 ms apart, and scans that are combined into one frame are
    tenths of a second apart, in which a car moves by metres and turns. The motion about each sighting is a path with
    constant acceleration, fitted to the middles of the sightings within `WINDOW_S`.

    Parameters
    ----------
    track : Track
    settings : Settings

    Returns
    -------
    Track
        The track; its sightings no longer have times of points.
    """
    if all(sighting.late_s is None for sighting in track.sightings):
        return track
    stamps_s = np.array([sighting.stamp_s for sighting in track.sightings])
    middles = np.array([sighting.middle for sighting in track.sightings])
    moved = []
    for sighting in track.sightings:
        near = np.abs(stamps_s - sighting.stamp_s) <= WINDOW_S
        velocity, acceleration = motion(stamps_s[near] - sighting.stamp_s, middles[near], settings.track)
        moved.append(_still(sighting, velocity, acceleration, settings))
    return Track(tuple(moved))


def motion(late_s: FloatArray, xy: FloatArray, settings: TrackSettings) -> tuple[FloatArray, FloatArray]:
    """Return velocity and acceleration at time 0, shape (2,) each.

    Parameters
    ----------
    late_s : ndarray, shape (n,)
        Times in seconds.
    xy : ndarray, shape (n, 2)
        Positions of the vehicle at these times, metres.
    settings : TrackSettings
    """
    powers = np.column_stack([np.ones_like(late_s), late_s, late_s**2 / 2])
    # The jitter is two standard deviations of a middle; the limits of speed and acceleration are three.
    sigmas = np.array([np.inf, settings.max_speed_mps / GATE, settings.max_acceleration_mps2 / GATE])
    information = powers.T @ powers / (settings.jitter_m / 2) ** 2 + np.diag(sigmas**-2)
    _, velocity, acceleration = np.linalg.solve(information, powers.T @ xy / (settings.jitter_m / 2) ** 2)
    return velocity, acceleration


def _still(sighting: Sighting, velocity: FloatArray, acceleration: FloatArray, settings: Settings) -> Sighting:
    """Return a sighting as if all of its points had been measured at its stamp."""
    late_s, sighting = sighting.late_s, replace(sighting, late_s=None)
    speed = float(np.hypot(*velocity))
    if late_s is None or speed * np.abs(late_s).max() < NEGLIGIBLE_M:
        return sighting
    turning = (velocity[0] * acceleration[1] - velocity[1] * acceleration[0]) / speed**2
    turning = np.clip(turning, -speed / TURN_RADIUS_M, speed / TURN_RADIUS_M)
    way = late_s[:, None] * velocity + late_s[:, None] ** 2 / 2 * acceleration
    points = sighting.points.copy()
    points[:, :2] = sighting.middle + rotate_xy(-turning * late_s, points[:, :2] - sighting.middle - way)
    try:
        box = box_around(points, settings)
    except BoxError:
        return sighting
    return replace(sighting, points=points, middle=np.median(points[:, :2], axis=0), box=box)
