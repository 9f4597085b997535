"""What several drives have in common: the sensor's clock, their sender, and what all receivers err by at one time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from laci_stereo.core.estimation.drive_model import DriveModel
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.messages.receiver import ALIKE, decay, in_time
from laci_stereo.core.settings import JointSettings

SENDER_S, SENDER_SHARE = 0.005, 0.5
"""Of what is not known of the clocks' offset, each sender's own part, one standard deviation: GNSS sets their clocks to
far better, but what they tell is a position that was worked out some milliseconds earlier, and stamped as well as their
software does. It is no more than half of the offset's own: who knows that better knows how senders stamp."""

CLOCK_S = 3600.0
"""So long the sensor's clock errs alike: NTP takes the better part of an hour for a step, at the rate at which it asks
to begin with (Mills 2011, "Computer Network Time Synchronization"), and an offset of 1 s that nothing corrects changes
by 0.3 ms in a second, more than any crystal drifts."""

SAME = 0.99
"""Of the variance of what is a sender's own, how it stamps, where its antenna is and its vehicle's shape, what is the
same in all of its drives: stamps are whole milliseconds, and loads make half a centimetre. It keeps equations regular,
too."""

APART_S = 1e12
"""Drives of which nothing is known have nothing in common: they are 30 000 years apart."""


class Recordings:
    """When several drives were, and whose.

    Parameters
    ----------
    models : sequence of DriveModel
    stations : sequence of int or None
        The sender of each drive. None: they have nothing in common.
    """

    def __init__(self, models: Sequence[DriveModel], stations: Sequence[int] | None = None) -> None:
        vehicles = [model.drive.vehicle for model in models]
        begins_s = APART_S * np.arange(len(models))
        if stations is not None:
            begins_s = np.array([(each.epoch_ns - vehicles[0].epoch_ns) / 1e9 for each in vehicles])
        self.stations = range(len(models)) if stations is None else tuple(stations)
        self._models = models
        self._knots_s = [begin_s + model.knots_s for begin_s, model in zip(begins_s, models, strict=True)]

    @property
    def senders(self) -> FloatArray:
        """How what is each sender's own is correlated from drive to drive, shape (drives, drives)."""
        alike: FloatArray = np.where(np.equal.outer(self.stations, self.stations), SAME, 0.0)
        np.fill_diagonal(alike, 1.0)
        return alike

    def clocks(self, precision: FloatArray) -> FloatArray:
        """Return the precision of the drives' clock offsets, shape (drives, drives).

        Parameters
        ----------
        precision : ndarray, shape (drives,)
            What each drive by itself has beforehand.
        """
        variance = 1.0 / precision
        own = np.minimum(SENDER_S**2, SENDER_SHARE**2 * variance)
        at_s = np.array([knots_s.mean() for knots_s in self._knots_s])
        sensors = np.exp(-(((at_s[:, None] - at_s) / CLOCK_S) ** 2) / 2.0)
        covariance = sensors * _outer(np.sqrt(variance - own)) + self.senders * _outer(np.sqrt(own))
        tied: FloatArray = np.linalg.inv(np.asarray(covariance, dtype=np.float64))
        return tied

    def drifts(self, settings: JointSettings) -> FloatArray:
        """Return the precision of the errors of positions at all drives' knots, on either axis, shape (k, k)."""
        counts = [len(knots_s) for knots_s in self._knots_s]
        station = np.repeat(self.stations, counts)
        sigma_m = np.repeat([model.sigma_m for model in self._models], counts)
        at_s, at_m = np.concatenate(self._knots_s), np.concatenate(self._ways())
        own = np.equal.outer(station, station)
        alike = np.where(own, decay(at_s, at_m, settings), ALIKE * in_time(at_s, settings))
        precision: FloatArray = np.linalg.inv(np.asarray(_outer(sigma_m) * alike, dtype=np.float64))
        return precision

    def _ways(self) -> list[FloatArray]:
        """Return where on its sender's way each drive's knots are; from drive to drive it goes straight at least."""
        ways: list[FloatArray] = [model.knots_m for model in self._models]
        last: dict[int, int] = {}
        for i in np.argsort([knots_s[0] for knots_s in self._knots_s]).tolist():
            if (before := last.get(self.stations[i])) is not None:
                (_, left), (come, _) = self._models[before].ends, self._models[i].ends
                ways[i] = ways[i] - ways[i][0] + ways[before][-1] + float(np.linalg.norm(come - left))
            last[self.stations[i]] = i
        return ways


def _outer(values: FloatArray) -> FloatArray:
    product: FloatArray = np.outer(values, values)
    return product
