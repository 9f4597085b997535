"""A drive's own parameters: what is known of them before its points are looked at, and what they correct."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.estimation import gloss
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.robust import TAIL
from laci_stereo.core.settings import JointSettings
from laci_stereo.core.vehicle import outline

CLOCK, HEADING, LEVER, BEGIN = range(4)
SHAPE = slice(4, 4 + len(outline.SHAPE))
PARTIAL = SHAPE.stop
GLOSS = slice(PARTIAL + 1, PARTIAL + 1 + len(gloss.EXPECTED))
GROWTH = GLOSS.stop
KNOTS = GROWTH + 2
"""A drive's own parameters: clock offset, heading error, heading lever, how the body stood when the messages began, the
shape, how partial a detector's boxes are, how glossy the body is with any paint and with its own, by how much each of
two borders grows, and the knots of the positions' errors, of all x and then of all y."""

LASTING = (HEADING, LEVER, *range(SHAPE.start, SHAPE.stop), *range(GLOSS.start, GLOSS.stop))
"""Of these, what is the sender's and its vehicle's in all drives that they make."""

HEADING_LEVER = 0.4
"""The point whose direction of motion is told, ahead of the rear axle, over the vehicle's length, with a standard
deviation of as much: 0 for a body's own yaw, 0.8 for the direction in which the front moves."""

BEGIN_SIGMA = 1.0
"""Where messages begin in a bend a vehicle may have been in it for long (-1), or just entered it (1), or left one."""

PARTIAL_MEAN, PARTIAL_SIGMA = 0.5, 0.5
"""A box that lacks a part of the vehicle's size may be the visible part of it (1), or well centred but small (0)."""

BORDER_SIGMA = 12**-0.5
"""A match is the body's, or what is behind it, as soon as a part of its window is on the body, or not before all of it
is: so a border is seen half a window farther out or in, or anywhere between (a uniform distribution's). By so much, in
windows, it is off on average, and in each place."""

LEAST_TOLD = 0.5
"""Of the variance of the clocks' offset, what the points are taken to tell at least."""

OPTICS = ("depth", "breadth")
"""What of a stereo camera's points is corrected, along its axis and across it, each as a share: their product with a
wrong focal length, which cancels out across the axis, or with a wrong baseline."""

CORRECTED = ("clock", "heading", "ahead", "left", "length", "width")
"""What of the messages is corrected: clock [s], heading [rad], where on the vehicle the position is, its size [m]."""


@dataclass(frozen=True)
class Correction:
    """Something that the messages, or a stereo calibration, tell and the points contradict.

    Attributes
    ----------
    what : str
        One of `CORRECTED` or of `OPTICS`, or ``nearer``.
    value, sigma : float
        The correction, and the standard deviation that was to be expected.
    after : float
        The standard deviation that is left.
    """

    what: str
    value: float
    sigma: float
    after: float

    @property
    def surprise(self) -> float:
        """By how many standard deviations it is off.

        Clocks that the points hardly tell are corrected little, however wrong they are: the variance of a correction is
        what was to be expected less what is left. Points that err together leave more than they should.
        """
        told = max(1.0 - (self.after / self.sigma) ** 2, LEAST_TOLD) if self.what == "clock" else 1.0
        return abs(self.value) / (self.sigma * float(np.sqrt(told)))


class DrivePrior:
    """What is known of a drive's own parameters beforehand.

    Parameters
    ----------
    vehicle : VehicleTrack
    drift : ndarray, shape (k, k)
        Covariance of the positions' errors at the knots, along x as along y.
    clock_sigma_s : float
    settings : JointSettings

    Attributes
    ----------
    mean : ndarray, shape (own,)
    drift : ndarray, shape (k, k)
    sigmas : ndarray, shape (6,)
        Standard deviation of each of `CORRECTED`.
    """

    def __init__(self, vehicle: VehicleTrack, drift: FloatArray, clock_sigma_s: float, settings: JointSettings) -> None:
        length_m, width_m = vehicle.length_m, vehicle.width_m
        self.drift = drift
        self.mean = np.zeros(KNOTS + 2 * len(drift))
        self.mean[LEVER] = HEADING_LEVER * length_m
        self.mean[SHAPE], shape_sigma = outline.expected_shape(width_m)
        self.mean[PARTIAL], self.mean[GLOSS] = PARTIAL_MEAN, gloss.EXPECTED
        self._told_sigmas = np.array(
            [
                clock_sigma_s,
                np.radians(settings.heading_sigma_deg),
                settings.lever_sigma_m,
                settings.lever_sigma_m,
                *np.hypot(settings.size_sigma_m, vehicle.guessed_m),
            ]
        )
        # An error of the length moves the side that the position does not refer to.
        fixed = np.clip(0.5 + vehicle.reference[0] / length_m, 0.0, 1.0)
        self._ways = np.zeros((4, len(outline.SHAPE)))
        self._ways[0, :2] = 1.0, -1.0
        self._ways[1, 3] = 1.0
        self._ways[2, :2] = 1.0 - fixed, fixed
        self._ways[3, 2] = 0.5
        self._otherwise = np.zeros((len(self.mean), len(self.mean)))
        self._otherwise[LEVER, LEVER] = (HEADING_LEVER * length_m) ** 2
        self._otherwise[BEGIN, BEGIN] = BEGIN_SIGMA**2
        self._otherwise[SHAPE, SHAPE] = np.diag(shape_sigma**2)
        self._otherwise[PARTIAL, PARTIAL] = PARTIAL_SIGMA**2
        self._otherwise[GLOSS, GLOSS] = np.diag(np.square(gloss.SIGMA))
        growth = range(GROWTH, KNOTS)
        self._otherwise[growth, growth] = BORDER_SIGMA**2
        middle = KNOTS + len(drift)
        self._otherwise[KNOTS:middle, KNOTS:middle] = self._otherwise[middle:, middle:] = drift
        self._corrected = _corrected(len(self.mean))
        self.sigmas = self._sigmas_of(self._covariance(self._told_sigmas**2))

    def precision(self, own: FloatArray | None = None) -> FloatArray:
        """Return the precision, shape (own, own), about the mean.

        What senders get wrong they sometimes get wrong by far, so beyond some sigma the cost of a correction grows
        with it and no longer with its square (Huber 1964). Below, points that err together must not pull the messages
        with them.

        Parameters
        ----------
        own : ndarray, shape (own,)
            The parameters, if they are known.
        """
        wide = np.ones(len(CORRECTED))
        if own is not None:
            wide = np.maximum(1.0, np.abs(self._corrected @ (own - self.mean) / self.sigmas) / TAIL)
        return np.asarray(np.linalg.inv(self._covariance(self._told_sigmas**2 * wide)), dtype=np.float64)

    def corrections(self, own: FloatArray, covariance: FloatArray) -> tuple[Correction, ...]:
        """Return by how much the messages had to be corrected, against what was to be expected.

        Parameters
        ----------
        own : ndarray, shape (own,)
            The drive's own parameters.
        covariance : ndarray, shape (own, own)
        """
        values = self._corrected @ (own - self.mean)
        return tuple(
            Correction(what, float(value), float(sigma), float(after))
            for what, value, sigma, after in zip(
                CORRECTED, values, self.sigmas, self._sigmas_of(covariance), strict=True
            )
        )

    def _covariance(self, variances: FloatArray) -> FloatArray:
        """Return the covariance if these are the variances of what messages tell."""
        covariance: FloatArray = self._otherwise.copy()
        covariance[CLOCK, CLOCK], covariance[HEADING, HEADING] = variances[:2]
        covariance[SHAPE, SHAPE] += (self._ways.T * variances[2:]) @ self._ways
        return covariance

    def _sigmas_of(self, covariance: FloatArray) -> FloatArray:
        sigmas: FloatArray = np.sqrt(np.einsum("ij,jk,ik->i", self._corrected, covariance, self._corrected))
        return sigmas


def _corrected(own: int) -> FloatArray:
    """Return what each of `CORRECTED` is of a drive's own parameters, shape (6, own)."""
    by = np.zeros((len(CORRECTED), own))
    by[0, CLOCK] = by[1, HEADING] = 1.0
    by_shape = by[:, SHAPE]
    by_shape[2, :2] = 0.5, -0.5
    by_shape[3, 3] = 1.0
    by_shape[4, :2] = 1.0
    by_shape[5, 2] = 2.0
    return by
