"""Whether a log's latitude and longitude are exchanged, judged by the heading and speed that its messages report."""

from __future__ import annotations

import numpy as np

from laci_stereo.core.frames import FloatArray
from laci_stereo.core.messages.cam import MAX_GAP_S, METRES_PER_DEG, CamLog
from laci_stereo.core.messages.headings import MOVING_MPS

_FEWEST_STEPS = 5
_DISAGREES = 0.25
_AGREES = 0.1


def look_exchanged(log: CamLog) -> bool:
    """Return whether positions move as heading and speed say only if latitude and longitude are exchanged.

    False where the log cannot decide it: no speeds, no motion, or motion that fits neither order.
    """
    as_given, exchanged = _motion_errors(log)
    if len(as_given) < _FEWEST_STEPS:
        return False
    return bool(np.median(as_given) > _DISAGREES and np.median(exchanged) < _AGREES)


def _motion_errors(log: CamLog) -> FloatArray:
    """Return the motion's relative deviation from the reported velocity: as given and exchanged, shape (2, n)."""
    log = log[np.isfinite(log.latitude_deg) & np.isfinite(log.longitude_deg)]
    log = log[np.lexsort((log.stamps_ns, log.station_id))]
    # The step between two stations' messages is no motion.
    step_s = np.where(np.diff(log.station_id) == 0, np.diff(log.stamps_ns) / 1e9, 0.0)
    speed = (log.speed_mps[1:] + log.speed_mps[:-1]) / 2
    heading = np.radians(log.heading_deg[1:])
    # Comparisons with NaN are False, which drops missing values.
    usable = (step_s > 0) & (step_s <= MAX_GAP_S) & (speed >= MOVING_MPS) & np.isfinite(heading)
    sent = np.stack([np.sin(heading), np.cos(heading)])
    errors, reversing = [], []
    for latitude, longitude in ((log.latitude_deg, log.longitude_deg), (log.longitude_deg, log.latitude_deg)):
        east = np.diff(longitude)[usable] * np.cos(np.radians(latitude[1:][usable]))
        moved = METRES_PER_DEG * np.stack([east, np.diff(latitude)[usable]]) / (step_s * speed)[usable]
        errors.append(np.linalg.norm(moved - sent[:, usable], axis=0))
        reversing.append(np.linalg.norm(moved + sent[:, usable], axis=0))
    # Some drives in reverse look like forward drives with exchanged coordinates.
    return np.stack([np.minimum(errors[0], reversing[0]), errors[1]])
