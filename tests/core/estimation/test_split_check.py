from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.result import Calibration
from tests.simulated import CURVE, LEFT_TURN, STRAIGHT, Recording, lidar, scene

DRIVES = {"straight": STRAIGHT, "turn": LEFT_TURN, "curve": CURVE}
MOVED_S = 2.6


@dataclass(frozen=True)
class Moved(Recording):
    """A recording of a sensor that something turns about its mast on the way."""

    turn_deg: float = 0.0

    def __iter__(self) -> Iterator[PointCloud]:
        T = self.T_world_sensor.copy()
        c, s = np.cos(np.radians(self.turn_deg)), np.sin(np.radians(self.turn_deg))
        T[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) @ T[:3, :3]
        plain = Recording(**{name: getattr(self, name) for name in Recording.__dataclass_fields__})
        after = replace(plain, T_world_sensor=T)
        return ((after if at_s > MOVED_S else plain).frame(i) for i, at_s in enumerate(self.times_s.tolist()))


@cache
def found(name: str, turn_deg: float) -> tuple[Calibration, float]:
    """Calibrate, and return by how much the yaw is off what the sensor had in the beginning, degrees."""
    made = scene(DRIVES[name], lidar(32, 160))
    fields = {field: getattr(made.recording, field) for field in Recording.__dataclass_fields__}
    one = calibrate(Moved(**fields, turn_deg=turn_deg), made.messages)
    R = one.T_utm_sensor[:3, :3] @ made.recording.T_world_sensor[:3, :3].T
    return one, float(np.degrees(np.arctan2(R[1, 0], R[0, 0])))


@pytest.mark.slow
@pytest.mark.parametrize("name", DRIVES)
def test_the_halves_of_a_drive_agree(name: str) -> None:
    one, off_deg = found(name, 0.0)
    assert one.quality.verdict == "pass"
    assert abs(off_deg) < 3.0 * one.quality.yaw_sigma_deg


@pytest.mark.slow
@pytest.mark.parametrize("name", DRIVES)
def test_a_sensor_that_is_moved_while_it_records_is_told_and_doubted_by_as_much(name: str) -> None:
    one, off_deg = found(name, 1.0)
    assert one.quality.verdict != "pass"
    assert any("the sensor was moved meanwhile" in reason for reason in one.quality.reasons)
    assert abs(off_deg) < 3.0 * one.quality.yaw_sigma_deg
    assert abs(off_deg - 1.0) < 3.0 * one.quality.yaw_sigma_deg
