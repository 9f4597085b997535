"""The knots of the slowly varying errors of a drive's reported positions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.estimation.evidence import Evidence
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.messages.receiver import KNOTS_PER_TIME
from laci_stereo.core.settings import JointSettings


@dataclass(frozen=True)
class Knots:
    """Places along a drive's course at which its position errors are estimated; between them the errors are linear.

    Attributes
    ----------
    at_s, at_m : ndarray, shape (k,)
        Time, and distance travelled.
    hat : ndarray, shape (m, k)
        Fraction of each knot's error that each frame has.
    """

    at_s: FloatArray
    at_m: FloatArray
    hat: FloatArray

    def __len__(self) -> int:
        return len(self.at_s)


def knots_of(drive: Evidence, settings: JointSettings) -> Knots:
    """Return knots that are uniformly spaced in the time and the distance in which position errors change."""
    passed_s = drive.stamps_s - drive.stamps_s[:1]
    course = drive.way_m / settings.bias_way_m + passed_s / settings.bias_time_s
    end = max(float(course.max(initial=0.0)), 1e-3)
    count = max(2, int(np.ceil(end * KNOTS_PER_TIME)) + 1)
    at = np.linspace(0.0, end, count)
    hat = np.maximum(0.0, 1.0 - np.abs(course[:, None] - at) / at[1])
    if not len(drive):
        return Knots(np.zeros(count), np.zeros(count), hat)
    # The last frame is extended to the end of the course, so that no two knots have the same time even in a drive of
    # one frame.
    stays_s, until = (end - course[-1:]) * settings.bias_time_s, np.append(course, end)
    at_s = np.interp(at, until, np.append(drive.stamps_s, drive.stamps_s[-1:] + stays_s))
    return Knots(at_s, np.interp(at, until, np.append(drive.way_m, drive.way_m[-1:])), hat)
