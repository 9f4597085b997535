"""What drives in one recording have in common: the sensor's clock, and what all receivers err by at one time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.linalg import block_diag

from laci_stereo.core.drive_model import ALIKE, decay, in_time
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.settings import JointSettings

SENDER_S, SENDER_SHARE = 0.005, 0.5
"""Of what is not known of the clocks' offset, each sender's own part, one standard deviation: GNSS sets their clocks to
far better, but what they tell is a position that was worked out some milliseconds earlier, and stamped as well as their
software does. It is no more than half of the offset's own: who knows that better knows how senders stamp."""


class Recordings:
    """Which drives were recorded at once.

    Parameters
    ----------
    numbers : sequence of int
        The recording of each drive.
    """

    def __init__(self, numbers: Sequence[int]) -> None:
        self._same = np.equal.outer(np.array(numbers), np.array(numbers))

    @property
    def shared(self) -> bool:
        """Whether there is one with several drives."""
        return int(self._same.sum()) > len(self._same)

    def clocks(self, precision: FloatArray) -> FloatArray:
        """Return the precision of the drives' clock offsets, shape (drives, drives).

        Parameters
        ----------
        precision : ndarray, shape (drives,)
            What each drive by itself has beforehand.
        """
        variance = 1.0 / precision
        own = np.minimum(SENDER_S**2, SENDER_SHARE**2 * variance)
        sensors = np.sqrt(variance - own)
        tied: FloatArray = np.linalg.inv(self._same * np.outer(sensors, sensors) + np.diag(own))
        return tied

    def drifts(
        self,
        knots_s: Sequence[FloatArray],
        knots_m: Sequence[FloatArray],
        sigmas_m: Sequence[float],
        settings: JointSettings,
    ) -> FloatArray:
        """Return the precision of the errors of positions at all drives' knots, on either axis, shape (k, k).

        Parameters
        ----------
        knots_s, knots_m : sequence of ndarray
            When each drive's are, and where on its way.
        sigmas_m : sequence of float
            How exact each drive's positions are.
        settings : JointSettings
        """
        drive = np.repeat(np.arange(len(knots_s)), [len(each) for each in knots_s])
        sigma_m = np.array(sigmas_m)[drive]
        common = ALIKE * self._same[drive][:, drive] * in_time(np.concatenate(knots_s), settings)
        own = block_diag(*(decay(at_s, at_m, settings) for at_s, at_m in zip(knots_s, knots_m, strict=True)))
        covariance = np.outer(sigma_m, sigma_m) * np.where(np.equal.outer(drive, drive), own, common)
        precision: FloatArray = np.linalg.inv(covariance)
        return precision
