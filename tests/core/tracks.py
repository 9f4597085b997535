"""Tracks made by hand."""

from __future__ import annotations

import numpy as np

from laci_stereo.core.box import Box
from laci_stereo.core.cam import VehicleTrack
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.sighting import Flaw, Sighting
from laci_stereo.core.tracking import Track
from tests.simulated import Drive

DRIVE = Drive((10.0, -20.0), 80.0, ((15.0, 0.0), (16.0, 90.0)), ((0.0, 8.0),))
"""Straight on, then a left turn."""


def sighting(
    stamp_s: float,
    xy: FloatArray,
    count: int = 200,
    flaw: Flaw | None = None,
    size: tuple[float, float] = (4.4, 1.8),
    yaw_rad: float = 0.0,
    sigma_m: float = 0.0,
) -> Sighting:
    box = Box(np.asarray(xy, dtype=np.float64), *size, yaw_rad)
    points = np.column_stack([box.corners(), np.ones(4)])
    noise = np.full(4, sigma_m)
    return Sighting(stamp_s, stamp_s, points, noise, noise, count, box.centre, box, flaw, sigma_m)


def track(stamps_s: FloatArray, xy: FloatArray, **of_each: object) -> Track:
    return Track(tuple(sighting(float(t), at, **of_each) for t, at in zip(stamps_s, xy, strict=True)))  # type: ignore[arg-type]


def vehicle(drive: Drive = DRIVE, last_s: float = 8.0, size: tuple[float, float] = (4.4, 1.8)) -> VehicleTrack:
    """The true track in the world, by messages at 10 Hz."""
    stamps = np.arange(-1.0, last_s + 1.0, 0.1) + 0.03
    xy, yaw = drive.at(stamps)
    return VehicleTrack(stamps, 0, xy, yaw, *size)
