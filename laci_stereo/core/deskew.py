"""Motion compensation: what was taken of a vehicle point after point, brought to where it was at one time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from laci_stereo.core.errors import BoxError
from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.settings import Settings, TrackSettings
from laci_stereo.core.sighting import Sighting, box_around
from laci_stereo.core.tracking import GATE, Track

WINDOW_S = 1.0
"""So long does a vehicle's acceleration last, ahead and back."""

TURN_RADIUS_M = 5.0
"""Of the tightest turn of a passenger car's middle: turning circles are 10 m and more."""

NEGLIGIBLE_M = 0.005
"""Less motion than this between a sighting's points is far below what bodies differ from any outline by."""


def deskewed(track: Track, settings: Settings) -> Track:
    """Move the points of every sighting to where they were at its stamp.

    A scanner takes the two ends of a near car up to 20 ms apart, and scans that are gathered into one frame are tenths
    of a second apart, in which a car moves by metres and turns. Its motion about each sighting is a path with constant
    acceleration, fitted to the middles of the sightings within `WINDOW_S`.

    Parameters
    ----------
    track : Track
    settings : Settings

    Returns
    -------
    Track
        Whose sightings have no times of points any more.
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
    """Return velocity and acceleration, shape (2,) each, at time 0 of a vehicle that was at ``xy``, shape (n, 2)."""
    powers = np.column_stack([np.ones_like(late_s), late_s, late_s**2 / 2])
    # Middles jump by twice their standard deviation at most; speed and acceleration have their limits at three sigma.
    sigmas = np.array([np.inf, settings.max_speed_mps / GATE, settings.max_acceleration_mps2 / GATE])
    information = powers.T @ powers / (settings.jitter_m / 2) ** 2 + np.diag(sigmas**-2)
    _, velocity, acceleration = np.linalg.solve(information, powers.T @ xy / (settings.jitter_m / 2) ** 2)
    return velocity, acceleration


def _still(sighting: Sighting, velocity: FloatArray, acceleration: FloatArray, settings: Settings) -> Sighting:
    """Return a sighting as it would be, had all of its points been taken at its stamp."""
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
