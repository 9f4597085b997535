"""A drive's own parameters: their priors, and the corrections to the messages that follow from them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.estimation import gloss
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.robust import TAIL
from laci_stereo.core.settings import JointSettings
from laci_stereo.core.vehicle import outline

CLOCK, HEADING, LAG, LEVER, BEGIN = range(5)
SHAPE = slice(5, 5 + len(outline.SHAPE))
PARTIAL = SHAPE.stop
GLOSS = slice(PARTIAL + 1, PARTIAL + 1 + len(gloss.EXPECTED))
GROWTH = GLOSS.stop
KNOTS = GROWTH + 2
"""Indices of a drive's own parameters: clock offset, heading error, lag of the heading, heading lever, initial angle of
the body when the messages began, shape, how partial a detector's boxes are, strength of specular reflection for any
paint and the difference of the vehicle's own paint, growth of each of two borders, and from `KNOTS` on the position
errors at the knots, all x first, then all y."""

LASTING = (HEADING, LAG, LEVER, *range(SHAPE.start, SHAPE.stop), *range(GLOSS.start, GLOSS.stop))
"""The parameters that a sender and its vehicle have in common in all of their drives."""

HEADING_LEVER = 0.4
"""Prior mean, and standard deviation, of the distance from the rear axle to the point ahead of it whose direction of
motion is reported as heading, over the vehicle's length: 0 for the body's own yaw, 0.8 for the direction in which the
front moves."""

BEGIN_SIGMA = 1.0
"""Standard deviation of the initial angle of the body: where messages begin in a bend, the vehicle may have been in it
for long (-1), or have just entered it (1), or have left one."""

PARTIAL_MEAN, PARTIAL_SIGMA = 0.5, 0.5
"""Prior of how partial a detector's boxes are: a box smaller than the vehicle may be its visible part (1), or centred
on the vehicle but too small (0)."""

BORDER_SIGMA = 12**-0.5
"""Standard deviation of a border's growth, in matching windows, both on average over a drive and at each place.

A match is assigned to the body, or to what is behind it, as soon as a part of its window is on the body, or not before
all of it is: the border is seen half a window too far out, too far in, or anywhere between (a uniform distribution)."""

LEAST_TOLD = 0.5
"""Least fraction of the clock offset's prior variance by which the points are assumed to reduce it."""

OPTICS = ("depth", "breadth")
"""Corrections to a stereo camera's points along its axis and across it, each relative: a wrong focal length scales only
depths, since it cancels out across the axis; a wrong baseline scales both."""

CONTRADICTED = 4.0
"""Number of standard deviations beyond which a correction contradicts the messages."""

CORRECTED = ("clock", "heading", "lag", "ahead", "left", "length", "width")
"""Corrections to the messages: clock [s], heading [rad], lag of the heading behind the position [s], place of the
reported position on the vehicle, size [m]."""


@dataclass(frozen=True)
class Correction:
    """A correction to something that the messages report, or a stereo calibration states, and the points contradict.

    Attributes
    ----------
    what : str
        One of `CORRECTED` or of `OPTICS`, or ``nearer``.
    value, sigma : float
        The correction, and its prior standard deviation.
    after : float
        Its posterior standard deviation.
    """

    what: str
    value: float
    sigma: float
    after: float

    @property
    def surprise(self) -> float:
        """The size of the correction in standard deviations that it has if the prior is right.

        The variance of a correction is the prior variance less the posterior variance: a clock offset that the points
        hardly determine is corrected little, however wrong it is. For clocks the posterior variance is therefore
        subtracted, within `LEAST_TOLD`: where points have a shared error, it is larger than it should be.
        """
        told = max(1.0 - (self.after / self.sigma) ** 2, LEAST_TOLD) if self.what == "clock" else 1.0
        return abs(self.value) / (self.sigma * float(np.sqrt(told)))

    @property
    def contradicts(self) -> bool:
        """Whether it is no correction any more, but a contradiction."""
        return self.surprise > CONTRADICTED


class DrivePrior:
    """The prior of a drive's own parameters.

    Parameters
    ----------
    vehicle : VehicleTrack
    drift : ndarray, shape (k, k)
        Covariance of the position errors at the knots, the same along x and along y.
    clock_sigma_s : float
        Standard deviation of the clock offset.
    settings : JointSettings

    Attributes
    ----------
    mean : ndarray, shape (own,)
        Prior mean.
    drift : ndarray, shape (k, k)
    sigmas : ndarray, shape (7,)
        Prior standard deviation of each of `CORRECTED`.
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
                settings.heading_lag_s,
                settings.lever_sigma_m,
                settings.lever_sigma_m,
                *np.hypot(settings.size_sigma_m, vehicle.guessed_m),
            ]
        )
        # An error of the length shifts the end that is farther from the reference point.
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
        """Return the precision of the prior, shape (own, own).

        Errors of senders are sometimes very large, so that beyond `TAIL` standard deviations the cost of a correction
        grows linearly and no longer quadratically (Huber 1964). Below that, the cost stays quadratic, since points with
        a shared error must not pull the messages with them.

        Parameters
        ----------
        own : ndarray, shape (own,)
            The parameters at which the precision is evaluated; None: within that limit.
        """
        wide = np.ones(len(CORRECTED))
        if own is not None:
            wide = np.maximum(1.0, np.abs(self._corrected @ (own - self.mean) / self.sigmas) / TAIL)
        return np.asarray(np.linalg.inv(self._covariance(self._told_sigmas**2 * wide)), dtype=np.float64)

    def corrections(self, own: FloatArray, covariance: FloatArray) -> tuple[Correction, ...]:
        """Return the corrections to the messages, with their prior and posterior standard deviations.

        Parameters
        ----------
        own : ndarray, shape (own,)
            The drive's own parameters.
        covariance : ndarray, shape (own, own)
            Their posterior covariance.
        """
        values = self._corrected @ (own - self.mean)
        return tuple(
            Correction(what, float(value), float(sigma), float(after))
            for what, value, sigma, after in zip(
                CORRECTED, values, self.sigmas, self._sigmas_of(covariance), strict=True
            )
        )

    def _covariance(self, variances: FloatArray) -> FloatArray:
        """Return the covariance of the prior for these variances of `CORRECTED`."""
        covariance: FloatArray = self._otherwise.copy()
        errors = range(CLOCK, LAG + 1)
        covariance[errors, errors] = variances[: LAG + 1]
        covariance[SHAPE, SHAPE] += (self._ways.T * variances[LAG + 1 :]) @ self._ways
        return covariance

    def _sigmas_of(self, covariance: FloatArray) -> FloatArray:
        sigmas: FloatArray = np.sqrt(np.einsum("ij,jk,ik->i", self._corrected, covariance, self._corrected))
        return sigmas


def _corrected(own: int) -> FloatArray:
    """Return the linear map from a drive's own parameters to `CORRECTED`, shape (7, own)."""
    by = np.zeros((len(CORRECTED), own))
    by[0, CLOCK] = by[1, HEADING] = by[2, LAG] = 1.0
    by_shape = by[:, SHAPE]
    by_shape[3, :2] = 0.5, -0.5
    by_shape[4, 3] = 1.0
    by_shape[5, :2] = 1.0
    by_shape[6, 2] = 2.0
    return by
