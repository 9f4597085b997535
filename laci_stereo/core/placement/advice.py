"""Where a result is weakest, why, and which drive would improve it."""

from __future__ import annotations

import numpy as np

from laci_stereo.core.estimation.evidence import Evidence
from laci_stereo.core.estimation.joint import JointFit
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.quality import Uncertainty


def advice(fit: JointFit, uncertainty: Uncertainty, drive: Evidence, missing_m: float = 0.0) -> str:
    """Return in words where the result is weakest, why, and what would improve it."""
    sigma_m, yaw = uncertainty.weakest
    velocity = _velocity(drive, fit.time_offsets_s[0])
    by_clock = float(np.hypot(*velocity)) * fit.time_sigmas_s[0]
    by_yaw = uncertainty.yaw_rad * float(np.sqrt((uncertainty.arms**2).sum(axis=1).mean()))
    along = abs(np.cos(yaw - np.arctan2(velocity[1], velocity[0]))) > np.sqrt(0.5)
    direction = "along the drive" if along else "across the drive"
    if along and missing_m > sigma_m:  # 0.7 of it is in the uncertainty
        why = "an end of the vehicle was never seen: the result may be shifted by as much; another vehicle shows both"
    elif along and by_clock > 0.7 * sigma_m:
        why = (
            f"the clock offset, known to {1e3 * fit.time_sigmas_s[0]:.0f} ms, cannot be told from a shift; a turn, or "
            "braking while in view, separates them"
        )
    elif (reported_m := reported_sigma_m(drive.vehicle)) > 0.7 * sigma_m:
        why = f"the CAMs' own positions are known to {reported_m:.2f} m; drives at other times average that"
    elif by_yaw > 0.7 * sigma_m:
        why = "the drive is short, so its direction is uncertain; a longer one determines the yaw"
    else:
        why = "few sides of the vehicle are seen; a drive that turns, or comes back the other way, shows the others"
    return f"weakest {direction} ({sigma_m:.2f} m): {why}"


def reported_sigma_m(vehicle: VehicleTrack) -> float:
    """Return the standard deviation of positions that the messages report; 0 if they report none."""
    return vehicle.position_sigma_m if np.isfinite(vehicle.position_sigma_m) else 0.0


def _velocity(drive: Evidence, offset_s: float) -> FloatArray:
    """Return the mean velocity in the world frame, shape (2,), m/s."""
    xy, _, known = drive.vehicle.at(drive.stamps_s + offset_s)
    ends = np.flatnonzero(known)[[0, -1]]
    passed = max(float(np.diff(drive.stamps_s[ends])[0]), 1e-3)
    mean: FloatArray = (xy[ends[1]] - xy[ends[0]]) / passed
    return mean
