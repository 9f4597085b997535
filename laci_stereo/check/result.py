"""Lane check of a calibration that has just been estimated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from laci_stereo.check.lanes import LaneCheck
from laci_stereo.check.placed import Placed
from laci_stereo.core.result import Calibration
from laci_stereo.io.result.calibration_file import boxes_in_world


def placed_by(calibration: Calibration) -> Placed:
    """Return the pose of the sensor according to a result."""
    boxes = np.array(boxes_in_world(calibration)).reshape(-1, 6)
    return Placed(calibration.T_world_sensor, calibration.covariance, calibration.centre_world, boxes)


def beside_map(calibration: Calibration, check: LaneCheck) -> Calibration:
    """Return the result with a warning if a map contradicts it, because either of them may be wrong.

    Maps may have another datum (ETRS89 differs by 0.7 m from that of receivers), or show a road before it was
    repainted.
    """
    if check.judgement.outcome != "fail":
        return calibration
    reason = f"the map contradicts it, so one of them is wrong: {'; '.join(check.judgement.reasons)}"
    return replace(calibration, quality=calibration.quality.doubted(reason))
