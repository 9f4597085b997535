"""Frames that stand in a recording twice, the second time under a later time."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

from laci_stereo.core.association.repeated_frames import repeats_of
from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.tracking.tracks import Track
from tests.core.tracks import DRIVE, sighting, vehicle
from tests.simulated import LEFT_TURN, Recording, lidar, scene

IN_WORDS = r"in \d+ of \d+ frames the vehicle is seen exactly as in the frame before, although it drives on"


@dataclass(frozen=True)
class Polled(Recording):
    """A recording whose frames are taken at half the rate at which they are written."""

    def frame(self, index: int) -> PointCloud:
        return replace(super().frame(index - index % 2), stamp_ns=self.stamps_ns[index])


@pytest.mark.slow
def test_each_frame_twice() -> None:
    made = scene(LEFT_TURN, lidar())
    one = made.recording
    twice = Polled(one.sensor, one.T_world_sensor, one.static, one.movers, one.times_s)
    found = calibrate(twice, made.messages)
    assert found.quality.verdict == "warn"
    assert any(re.search(IN_WORDS, reason) for reason in found.quality.reasons)
    assert not any(re.search(IN_WORDS, reason) for reason in calibrate(one, made.messages).quality.reasons)


@pytest.mark.parametrize(("step_m", "says"), [(0.0, True), (1e-6, False)], ids=["held", "moved"])
def test_boxes_that_are_held(step_m: float, says: bool) -> None:
    stamps_s = np.arange(0.0, 5.0, 0.1)
    xy, yaw_rad = DRIVE.at(stamps_s - stamps_s % 0.2 + 1e-9)
    xy += np.outer(np.arange(len(xy)), [step_m, 0.0])
    none = np.zeros((0, 3))
    seen = [
        replace(sighting(float(t), at, count=1, yaw_rad=float(yaw)), points=none)
        for t, at, yaw in zip(stamps_s, xy, yaw_rad, strict=True)
    ]
    assert bool(repeats_of(Track(tuple(seen)), vehicle(), 0.0)) == says
