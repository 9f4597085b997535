"""How much of a vehicle's length was seen, compared with what its messages report.

Where an end of it was never seen, what was seen may be another part of it. Where a detector's boxes are longer than the
messages report, the position that these refer to may be another place along it. Either way the result may be off along
the drive.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from laci_stereo.core.association.pieces import LEAST_UNSEEN_M, unseen_m
from laci_stereo.core.estimation.drive_prior import CONTRADICTED
from laci_stereo.core.estimation.evidence import Evidence
from laci_stereo.core.estimation.joint import JointFit
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.robust import NORMAL
from laci_stereo.core.settings import JointSettings


@dataclass(frozen=True)
class SeenLength:
    """What was seen of the length of the vehicle of one drive.

    Attributes
    ----------
    vehicle : VehicleTrack
    missing_m : mapping of str to float
        Length of each end that was never seen, by the end's name.
    longer_m : float
        By how much a detector's boxes are longer than the messages report; 0 where that is no surprise.
    """

    vehicle: VehicleTrack
    missing_m: Mapping[str, float]
    longer_m: float

    @property
    def lacking_m(self) -> float:
        """Length of the longer end that was never seen; 0 if there is none."""
        return max(self.missing_m.values(), default=0.0)

    @property
    def shift_m(self) -> float:
        """By how much the vehicle's middle shifts, relative to the reported position, if it is as long as its boxes."""
        return abs(self.vehicle.reference[0]) / self.vehicle.length_m * self.longer_m

    @property
    def lacks(self) -> str:
        """Which end was never seen, in words."""
        ends = " and ".join(f"the {end} {end_m:.1f} m" for end, end_m in self.missing_m.items())
        return f"{ends} of the vehicle's {self.vehicle.length_m:.1f} m were never seen, although its side was"

    @property
    def objections(self) -> list[str]:
        """What follows for the result, in words; empty where the vehicle was seen as its messages report it."""
        found = []
        if self.missing_m:
            found.append(
                f"{self.lacks}: what was seen may be another part of it, or its length wrong, and the position off by "
                "as much along the path"
            )
        if self.longer_m:
            told_m = self.vehicle.length_m
            told = "was assumed" if self.vehicle.guessed_m[0] else "its messages report"
            found.append(
                f"the vehicle's boxes are {told_m + self.longer_m:.1f} m long in the median, and {told} {told_m:.1f} "
                f"m: if the boxes are right, the position is off by {self.shift_m:.2f} m along the drive"
            )
        return found


def seen_length(drive: Evidence, match: PlanarMatch, time_offset_s: float) -> SeenLength:
    """Return what was seen of the length of a drive's vehicle, from a level frame that is placed by ``match``."""
    least_m = LEAST_UNSEEN_M + 3.0 * drive.vehicle.guessed_m[0]
    ends_m = dict(zip(("rear", "front"), unseen_m(drive, match, time_offset_s), strict=True))
    missing_m = {end: end_m for end, end_m in ends_m.items() if end_m > least_m}
    return SeenLength(drive.vehicle, missing_m, _longer_m(drive))


def seen_lengths(fit: JointFit, drives: Sequence[Evidence]) -> list[SeenLength]:
    """Return what was seen of the length of each drive's vehicle.

    Where the messages' positions are those of another place along the vehicle, that explains what seems to be missing.
    """
    found = []
    for drive, offset_s, corrections in zip(drives, fit.time_offsets_s, fit.corrections, strict=True):
        length = seen_length(drive, fit.match, offset_s)
        elsewhere = any(each.what == "ahead" and each.contradicts for each in corrections)
        found.append(replace(length, missing_m={}) if elsewhere else length)
    return found


def with_uncertainty_along(fit: JointFit, drives: Sequence[Evidence], lengths: Sequence[SeenLength]) -> JointFit:
    """Return a fit whose uncertainty along its drives includes that it is off, with a probability of one half.

    It may be off by what was never seen of a vehicle, and by what its boxes are too long.
    One vehicle that was seen as its messages report it determines where the parts of the others are.
    """
    off_m = min(each.lacking_m for each in lengths), min(each.shift_m for each in lengths)
    poses = [drive.vehicle.at(drive.stamps_s + s) for drive, s in zip(drives, fit.time_offsets_s, strict=True)]
    yaw = np.concatenate([yaw[known] for _, yaw, known in poses])
    along = np.stack([np.cos(yaw), np.sin(yaw)])
    covariance = fit.covariance.copy()
    covariance[1:, 1:] += float(np.square(off_m).sum()) / 2.0 * (along @ along.T) / max(len(yaw), 1)
    return replace(fit, covariance=covariance)


def _longer_m(drive: Evidence) -> float:
    """Return by how much a detector's boxes are longer than the vehicle by its messages; 0 where that is no surprise.

    One box's error of length counts as the error that all share, in addition to that of what the messages report.
    """
    if len(drive.points) or not len(drive):
        return 0.0
    longer_m = -drive.lacking_m[:, 0]
    median_m = float(np.median(longer_m))
    scatter_m = NORMAL * float(np.median(np.abs(longer_m - median_m)))
    sigma_m = math.hypot(scatter_m, JointSettings.size_sigma_m, drive.vehicle.guessed_m[0])
    return median_m if median_m > CONTRADICTED * sigma_m else 0.0
