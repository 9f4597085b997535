"""A tractor and its semi-trailer, 16.5 m together: the tractor's rear axle follows a drive."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.messages.cam import CamLog
from tests.simulated import ULM, Drive, Mover, Place, Scene, Solid, cam_log, scene

LENGTH_M, WIDTH_M, FRONT_M = 16.5, 2.5, 5.0
HITCH_M, DRAWBAR_M = 0.6, 7.8
CAB = Solid((3.9, 0.0), 0.0, 2.2, WIDTH_M, 0.4, 3.2)
TANKS = Solid((0.9, 0.0), 0.0, 3.8, 2.3, 0.3, 1.0)
"""And wheels: what the tractor has behind its cab, below the trailer."""

BOX = Solid((2.5, 0.0), 0.0, 13.6, WIDTH_M, 1.0, 3.8)
WHOLE = Solid((0.0, 0.0), 0.0, LENGTH_M, WIDTH_M, 0.4, 3.8)
STEP_S = 0.01


@dataclass(frozen=True)
class Behind(Drive):
    """The motion of the trailer's axle: it does not slip, and its kingpin is the tractor's."""

    def at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        time, yaw = self._towed
        now = np.interp(times_s, time, yaw)
        return self._hitch(times_s) - rotate_xy(now, np.tile([DRAWBAR_M, 0.0], (len(now), 1))), now

    def _hitch(self, times_s: FloatArray) -> FloatArray:
        xy, yaw = super().at(times_s)
        return xy + rotate_xy(yaw, np.tile([HITCH_M, 0.0], (len(yaw), 1)))

    @cached_property
    def _towed(self) -> tuple[FloatArray, FloatArray]:
        time = np.arange(-8.0, 20.0, STEP_S)
        yaw = [float(np.radians(self.yaw_deg))]
        for x, y in np.diff(self._hitch(time), axis=0).tolist():
            yaw.append(yaw[-1] + (y * np.cos(yaw[-1]) - x * np.sin(yaw[-1])) / DRAWBAR_M)
        return time, np.array(yaw)


def behind(drive: Drive) -> Behind:
    return Behind(drive.start, drive.yaw_deg, drive.legs, drive.speeds, drive.start_s)


def fold(drive: Drive, times_s: FloatArray) -> FloatArray:
    """Return the angle between tractor and trailer."""
    return drive.at(times_s)[1] - behind(drive).at(times_s)[1]


def messages(drive: Drive, last_s: float, rate_hz: float = 10.0, place: Place = ULM) -> CamLog:
    return cam_log(place, Mover(drive, (WHOLE,)), last_s, rate_hz, reference=(FRONT_M, 0.0))


def articulated(drive: Drive, last_s: float = 6.0, yaw_deg: float = 35.0) -> Scene:
    made = scene(drive, last_s=last_s, yaw_deg=0.0)
    movers = (Mover(drive, (CAB, TANKS)), Mover(behind(drive), (BOX,)))
    recording = replace(made.recording, movers=movers).turned(float(np.radians(yaw_deg)))
    return Scene(made.place, recording, messages(recording.movers[0].drive, last_s))
