"""The headings of messages that report to drive backwards: of the body, where they were those of the motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray
from laci_stereo.core.messages.cam import CamLog
from laci_stereo.core.messages.headings import REVERSING_MPS


def turned_back(log: CamLog, backward: BoolArray) -> tuple[CamLog, list[str]]:
    """Turn headings by 180 deg where driveDirection is backward and they point where the vehicle moves.

    That is what a CAM's heading is (EN 302 637-2). Some senders report the body's instead: what holds for most of a
    station's messages is taken for all of them. A station that would reverse faster than anybody does is not believed.
    The log may be in any order; the notes have one line for each station that drives backwards.
    """
    heading_deg, notes = log.heading_deg.copy(), []
    for station in np.unique(log.station_id[backward]):
        its = np.flatnonzero(log.station_id == station)
        its = its[np.argsort(log.stamps_ns[its], kind="stable")]
        back = backward[its]
        told = f"station {station}: {np.count_nonzero(back)} messages with driveDirection backward"
        speeds = log.speed_mps[its[back]]
        fast_mps = float(np.median(speeds[np.isfinite(speeds)])) if np.isfinite(speeds).any() else 0.0
        if fast_mps > REVERSING_MPS:
            notes.append(f"{told}, at {fast_mps:.1f} m/s: not believed, needed are at most {REVERSING_MPS:g} m/s")
        elif _along_motion(log[its])[back].sum() > 0.0:
            heading_deg[its[back]] = (heading_deg[its[back]] + 180.0) % 360.0
            notes.append(f"{told}: their headings are those of the motion, and turned by 180 deg to be the body's")
        else:
            notes.append(f"{told}: their headings are the body's")
    return replace(log, heading_deg=heading_deg), notes


def _along_motion(log: CamLog) -> FloatArray:
    """Return the cosines between the headings and the motion of one station's positions, shape (n,); 0 if unknown."""
    latitude, longitude, heading = map(np.radians, (log.latitude_deg, log.longitude_deg, log.heading_deg))
    row = np.arange(len(log))
    before, after = np.maximum(row - 1, 0), np.minimum(row + 1, len(log) - 1)
    north = latitude[after] - latitude[before]
    east = (longitude[after] - longitude[before]) * np.cos(latitude)
    moved = np.hypot(north, east)
    cosines: FloatArray = np.nan_to_num(
        (north * np.cos(heading) + east * np.sin(heading)) / np.where(moved > 0.0, moved, np.nan)
    )
    return cosines
