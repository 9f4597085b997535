"""Correlations between several drives: the sensor's clock, the sender, and the errors of all receivers at one time."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from scipy.sparse.csgraph import connected_components

from laci_stereo.core.estimation.drive_model import DriveModel
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.messages.receiver import ALIKE, decay, in_time
from laci_stereo.core.settings import JointSettings

SENDER_S, SENDER_SHARE = 0.005, 0.5
"""Standard deviation of the part of the clock offset that is each sender's own, and the largest fraction of the
offset's standard deviation that it may be. GNSS sets the senders' clocks far better, but the positions that they report
were computed some milliseconds earlier, and are stamped only as well as their software does. The part is at most half
of the offset's own standard deviation: whoever knows the offset better also knows how senders stamp."""

CLOCK_S = 3600.0
"""Correlation time of the sensor's clock error: NTP takes the better part of an hour for a step, at its initial polling
rate (Mills 2011, "Computer Network Time Synchronization"). An offset of 1 s that nothing corrects changes by 0.3 ms in
a second, more than any crystal drifts."""

LASTING_CLOCK = 0.5
"""Fraction of the variance of the sensor's clock error that is the same in all recordings: the delay from a measurement
to its stamp, which its electronics and driver make, is no error of the clock's, and no clock corrects it. Either may
dominate, so that each counts as half."""

LASTING_PLACE = 0.25
"""Fraction of the variance of positions that is the same for all receivers on all days: the coordinates of the base
stations, the realisation of the reference frame, and what a fleet measures of its antennas' places. It is half of the
standard deviation: beyond it no number of drives makes a result more certain."""

SENDERS, SAME_SIZE = 0.25, 0.5
"""Correlations of the own parameters of any two senders, and of two whose vehicles have the same size. How a size and a
reference point are measured, and what all cars have that the expected outline has not, is half of the standard
deviation, as of positions. Vehicles of the same size are at even odds one under two pseudonyms (stations change theirs,
ETSI TS 102 940), or of one model."""

SAME = 0.99
"""Correlation, between the drives of one sender, of its own parameters: its stamping delay, its antenna's place and its
vehicle's shape. Stamps are whole milliseconds, and loads shift the body by half a centimetre. Below 1, it also keeps
the equations regular."""

APART_S = 1e12
"""Time between drives about which nothing is known, 30 000 years, so that they are uncorrelated."""


class Recordings:
    """The times and senders of several drives, and the correlations that follow from them.

    Parameters
    ----------
    models : sequence of DriveModel
    stations : sequence of int or None
        The sender of each drive. None: the drives are uncorrelated.
    """

    def __init__(self, models: Sequence[DriveModel], stations: Sequence[int] | None = None) -> None:
        vehicles = [model.drive.vehicle for model in models]
        begins_s = APART_S * np.arange(len(models))
        if stations is not None:
            begins_s = np.array([(each.epoch_ns - vehicles[0].epoch_ns) / 1e9 for each in vehicles])
        self.stations = range(len(models)) if stations is None else tuple(stations)
        self._together = stations is not None
        # Sizes that nobody reports are no sign. Widths are corrected for mirrors, which those of one model are alike.
        sizes = [(each.length_m, each.width_m) if stations and not each.guessed_m[0] else None for each in vehicles]
        self._sizes = [i if size is None else sizes.index(size) for i, size in enumerate(sizes)]
        self._models = models
        self._knots_s = [begin_s + model.knots.at_s for begin_s, model in zip(begins_s, models, strict=True)]

    @cached_property
    def senders(self) -> FloatArray:
        """The correlation of the senders' own parameters between drives, shape (drives, drives).

        Vehicles count as of one size also by way of a third one: a station that reports two sizes is alike to those of
        either, and only with classes of this kind the matrix is positive definite.
        """
        others = SENDERS if self._together else 0.0
        same = np.equal.outer(self.stations, self.stations)
        _, size = connected_components(same | np.equal.outer(self._sizes, self._sizes), directed=False)
        alike: FloatArray = np.where(np.equal.outer(size, size), SAME_SIZE, others)
        alike[same] = SAME
        np.fill_diagonal(alike, 1.0)
        return alike

    def clocks(self, precision: FloatArray) -> FloatArray:
        """Return the prior precision of the drives' clock offsets, shape (drives, drives).

        Parameters
        ----------
        precision : ndarray, shape (drives,)
            Prior precision of each drive's offset by itself.
        """
        variance = 1.0 / precision
        own = np.minimum(SENDER_S**2, SENDER_SHARE**2 * variance)
        at_s = np.array([knots_s.mean() for knots_s in self._knots_s])
        passing = np.exp(-(((at_s[:, None] - at_s) / CLOCK_S) ** 2) / 2.0)
        sensors = self._lasting(LASTING_CLOCK, passing)
        covariance = sensors * _outer(np.sqrt(variance - own)) + self.senders * _outer(np.sqrt(own))
        tied: FloatArray = np.linalg.inv(np.asarray(covariance, dtype=np.float64))
        return tied

    def log_clock_volume(self, sigma_s: float) -> float:
        """Return the log of the volume of the drives' clock offsets a priori, each with this standard deviation."""
        precision = self.clocks(np.full(len(self._models), sigma_s**-2))
        return -float(np.linalg.slogdet(precision)[1]) / 2

    def drifts(self, settings: JointSettings) -> FloatArray:
        """Return the prior precision of the position errors at all drives' knots, (k, k), for x as for y."""
        counts = [len(knots_s) for knots_s in self._knots_s]
        station = np.repeat(self.stations, counts)
        sigma_m = np.repeat([model.sigma_m for model in self._models], counts)
        at_s, at_m = np.concatenate(self._knots_s), np.concatenate(self._ways())
        own = np.equal.outer(station, station)
        alike = np.where(own, decay(at_s, at_m, settings), ALIKE * in_time(at_s, settings))
        alike = self._lasting(LASTING_PLACE, alike)
        precision: FloatArray = np.linalg.inv(np.asarray(_outer(sigma_m) * alike, dtype=np.float64))
        return precision

    def _lasting(self, share: float, passing: FloatArray) -> FloatArray:
        """Return the correlation of errors of which a share lasts, given that of the others."""
        if not self._together:
            return passing
        lasting: FloatArray = share + (1.0 - share) * passing
        return lasting

    def _ways(self) -> list[FloatArray]:
        """Return how far along its sender's path each drive's knots are, with a straight line between two drives."""
        ways: list[FloatArray] = [model.knots.at_m for model in self._models]
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
