"""Drives of three vehicles past one small scanner, calibrated one by one, and their results in folders."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from laci_stereo.combine import Origin
from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.frames import FloatArray, invert, planar, transform
from laci_stereo.core.messages.cam import CamLog
from laci_stereo.core.result import Calibration
from laci_stereo.io.result.calibration_file import Provenance
from laci_stereo.job import Result
from tests.once import found_once
from tests.simulated import LEFT_TURN, RIGHT_TURN, STRAIGHT, Drive, Recording, Scene, cam_log, car, lidar, scene

DRIVES = ((LEFT_TURN, 4.4, 1.8), (RIGHT_TURN, 4.1, 1.75), (STRAIGHT, 4.8, 1.9))
STATIONS = (42, 43, 44)
DAY_NS = 86_400_000_000_000


@cache
def recorded() -> tuple[tuple[Scene, Calibration], ...]:
    """The road and the sensor are the same; days, vehicles, ways and noise are not."""
    return found_once("drives", _recorded)


def _recorded() -> tuple[tuple[Scene, Calibration], ...]:
    found = []
    for number, (drive, length, width) in enumerate(DRIVES):
        made = scene(drive, lidar(32, 160), frames_hz=5.0, seed=number)
        vehicle = car(made.vehicle.drive, length, width)
        messages = cam_log(made.place, vehicle, 6.0, station=STATIONS[number])
        made = replace(made, recording=replace(made.recording, movers=(vehicle,)), messages=messages)
        one = calibrate(made.recording, messages)
        epoch_ns = one.drive.vehicle.epoch_ns + number * DAY_NS
        own = replace(one.drive, vehicle=replace(one.drive.vehicle, epoch_ns=epoch_ns))
        found.append((made, replace(one, passages=(own,))))
    return tuple(found)


def passages() -> list[Passage]:
    return [replace(found.passages[0], name=f"run {number}") for number, (_, found) in enumerate(recorded())]


ONCOMING = Drive((25.5, -16.0), 90.0, speeds=((0.0, 6.0),))


def meeting(late_s: float = 0.0, other: Drive = ONCOMING) -> tuple[Recording, list[CamLog], FloatArray]:
    """Let a car on a straight road meet another one, at steady speeds, and both send by a clock that is late.

    Returns what is recorded, the messages of either (stations 42 and 43), and where the sensor is, UTM.
    """
    made = scene(STRAIGHT, lidar(32, 160), frames_hz=5.0, seed=5)
    cars = car(STRAIGHT), car(other, 4.6, 1.85)
    logs = [cam_log(made.place, vehicle, 6.0, station=STATIONS[number]) for number, vehicle in enumerate(cars)]
    late = [replace(log, stamps_ns=log.stamps_ns + round(1e9 * late_s)) for log in logs]
    truth: FloatArray = made.place.to_utm(made.recording.T_world_sensor[None, :2, 3])[0]
    return replace(made.recording, movers=cars), late, truth


def off_by(passage: Passage, x_m: float, y_m: float) -> Passage:
    """Return a drive whose messages put the vehicle elsewhere; it alone fits there as well as where it was."""
    shift = np.array([x_m, y_m])
    vehicle = replace(passage.vehicle, xy=passage.vehicle.xy + shift)
    return replace(passage, vehicle=vehicle, match=replace(passage.match, shift=passage.match.shift + shift))


def ahead(passage: Passage, by_m: float) -> Passage:
    """Return a drive whose messages tell the position of a place that is so far ahead on the vehicle."""
    vehicle = passage.vehicle
    shift = by_m * np.column_stack([np.cos(vehicle.yaw_rad), np.sin(vehicle.yaw_rad)])
    return replace(passage, vehicle=replace(vehicle, xy=vehicle.xy + shift))


def with_passage(calibration: Calibration, passage: Passage) -> Calibration:
    """Return a result that keeps this drive."""
    T_level_sensor = passage.ground.T_level_sensor(passage.axes)
    T_world_sensor = planar(passage.match.yaw_rad, passage.match.shift) @ T_level_sensor
    return replace(
        calibration,
        passages=(passage, *calibration.others),
        T_world_sensor=T_world_sensor,
        T_level_sensor=T_level_sensor,
    )


def misplaced(found: Calibration) -> tuple[float, float]:
    """Return by how much objects on the ways of all vehicles are misplaced, RMS in metres, and the angle, degrees."""
    made = recorded()[0][0]
    xy = np.concatenate([scene.vehicle.drive.at(one.drive.track.stamps_s)[0] for scene, one in recorded()])
    sensor = transform(invert(made.recording.T_world_sensor), np.column_stack([xy, np.zeros(len(xy))]))
    off: FloatArray = transform(found.T_utm_sensor, sensor)[:, :2] - made.place.to_utm(xy)
    R = found.T_world_sensor[:3, :3] @ made.recording.T_world_sensor[:3, :3].T
    angle = float(np.degrees(np.arccos(np.clip((np.trace(R) - 1.0) / 2.0, -1.0, 1.0))))
    return float(np.sqrt((off**2).sum(axis=1).mean())), angle


def save(calibration: Calibration, out: Path, kind: str = "lidar") -> Path:
    """Write a result folder as a calibrating command does."""
    provenance = Provenance(name="mast 7", kind=kind, frame="as in the scans", inputs={}, config={})
    return Result(calibration, Origin(provenance, "", None, ())).save(out)
