"""The lane check of a result that has just been found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from laci_stereo.check.images import Checked
from laci_stereo.check.lanes import LaneCheck
from laci_stereo.check.placed import Placed
from laci_stereo.core.result import Calibration
from laci_stereo.io.calibration_file import boxes_in_world

Checking: TypeAlias = Callable[[Calibration], Checked | None]
"""Holds the map against what one kind of sensor saw; None without a map, or where the sensor cannot see lines."""


def not_checked(_calibration: Calibration) -> Checked | None:
    """Check nothing: there is no map, or the sensor cannot see lines."""
    return None


def placed_by(calibration: Calibration) -> Placed:
    """Return where a result puts its sensor."""
    boxes = np.array(boxes_in_world(calibration)).reshape(-1, 6)
    return Placed(calibration.T_world_sensor, calibration.covariance, calibration.centre_world, boxes)


def beside_map(calibration: Calibration, check: LaneCheck) -> Calibration:
    """Let the verdict say that a map contradicts the result: a warning, as either may be the one that is wrong.

    Maps may be in another datum (ETRS89 is 0.7 m from what receivers give), or of a road that was painted anew.
    """
    if check.judgement.outcome != "fail":
        return calibration
    reason = f"the map contradicts it, so one of them is wrong: {'; '.join(check.judgement.reasons)}"
    return replace(calibration, quality=calibration.quality.doubted(reason))
