"""How well each drive fits: its points laid on the vehicle's outline, and what of its messages had to be corrected."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core import outline
from laci_stereo.core.drive_model import BIAS, FIRST_OWN, DriveModel
from laci_stereo.core.drive_prior import CLOCK, Correction
from laci_stereo.core.evidence import evidence_of
from laci_stereo.core.frames import FloatArray, IntArray, rotate_xy
from laci_stereo.core.joint import SOFTENING_M
from laci_stereo.core.passage import Passage
from laci_stereo.core.settings import JointSettings

MOST_ROWS = 5_000
"""Points that are laid on the outline, or up to twice as many: more would say the same, later."""

NEAR_M = 0.3
"""The transform is known, so what is left to find moves the outline by less than this."""

ITERATIONS = 12
CLOSE = 0.01
"""Squared step, in standard deviations, at which the iteration ends: a tenth of a sigma is not to be seen."""

SIDES = ("rear", "front", "right side", "left side")


@dataclass(frozen=True)
class Laid:
    """The points of a drive, laid on its vehicle by the calibration and the corrected messages.

    Attributes
    ----------
    stamps_s : ndarray, shape (n,)
        Of each point's frame.
    xy_vehicle : ndarray, shape (n, 2)
        Metres; x ahead and y to the left of the box's centre.
    distance_m : ndarray, shape (n,)
        From the outline, positive outside; what a side that mirrors is off by is taken out here.
    face : ndarray of int, shape (n,)
        The side that the line of sight meets: 0 rear, 1 front, 2 right, 3 left, 4 passed by.
    surface : ndarray, shape (n,)
        Probability that the point is of the outline, and not of what is behind or beside it.
    """

    stamps_s: FloatArray
    xy_vehicle: FloatArray
    distance_m: FloatArray
    face: IntArray
    surface: FloatArray

    @property
    def rms_m(self) -> float:
        """Of the points of the outline."""
        return float(np.sqrt((self.surface * self.distance_m**2).sum() / max(float(self.surface.sum()), 1e-9)))


@dataclass(frozen=True)
class Fit:
    """What is a drive's own, where its transform is known.

    Attributes
    ----------
    laid : Laid or None
        None where there are no points of the outline, as from a detector.
    corrections : tuple of Correction
    """

    laid: Laid | None
    corrections: tuple[Correction, ...]


def fit_drive(passage: Passage, settings: JointSettings) -> Fit | None:
    """Find what of a drive's messages has to be corrected, given the transform, and lay its points on the outline.

    Where the transform is the joint estimate's, so is the rest: the best of a part of the parameters, with the others
    held at the best of all, is the best of all.

    Parameters
    ----------
    passage : Passage
        With the transform in its match.
    settings : JointSettings
        Those of the estimate.

    Returns
    -------
    Fit or None
        None where the messages never tell where the vehicle is.
    """
    drive = evidence_of(passage.track, passage.vehicle, passage.ground.height_m).thinned(MOST_ROWS)
    if not len(drive):
        return None
    centre = drive.middles.mean(axis=0)
    model = DriveModel(drive, centre, settings, turns=passage.turn != 0.0)
    x, shares, covariance = _solve(model, passage, centre)
    if not np.isfinite(x).all():
        return None
    laid = _lay(model, x, shares) if len(drive.points) else None
    return Fit(
        laid if laid is not None and len(laid.face) else None, model.prior.corrections(x[FIRST_OWN:], covariance)
    )


def _solve(model: DriveModel, passage: Passage, centre: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return all parameters, of which yaw, x and y are held, the mixture's shares, and the covariance of the own."""
    prior = model.prior
    x = np.concatenate(
        [[passage.match.yaw_rad], passage.match(centre[None])[0], [0.0, passage.turn, 0.0, 0.0], prior.mean]
    )
    x[FIRST_OWN + CLOCK] = passage.time_offset_s
    shares = model.shares()
    free = np.r_[BIAS, FIRST_OWN : len(x)]  # the optics are the stereo calibration's, as the points are
    precision = np.zeros((len(free), len(free)))
    precision[0, 0] = model.settings.bias_noise_share**-2
    pace, step = 1.0, np.zeros(len(free))
    for soft in (*[soft for soft in SOFTENING_M if soft <= NEAR_M], *[0.0] * ITERATIONS):
        fitness = model.weigh(model.rows(x), soft, shares)
        shares = fitness.shares
        precision[1:, 1:] = prior.precision(x[FIRST_OWN:])
        curvature = fitness.curvature[np.ix_(free, free)] + precision
        gradient = fitness.gradient[free] + precision @ (x[free] - np.append(0.0, prior.mean))
        before, step = step, np.linalg.solve(curvature, gradient)
        pace *= 0.5 if before @ curvature @ step < 0.0 else 1.0  # points at corners change sides, and it swings
        step = pace * step
        x[free] -= step
        if soft == 0.0 and step @ curvature @ step < CLOSE:
            break
    information = fitness.information[np.ix_(free, free)] + precision
    return x, shares, np.asarray(np.linalg.inv(information), dtype=np.float64)[1:, 1:]


def _lay(model: DriveModel, x: FloatArray, shares: FloatArray) -> Laid:
    rows = model.rows(x)
    surface = model.mixed(rows, rows.distance, np.sqrt(rows.variance), shares).surface
    of_outline = rows.face < outline.FACES
    rows = rows[of_outline]
    return Laid(model.drive.stamps_s[rows.frame], model.wall(x).xy, rows.distance, rows.face, surface[of_outline])


@dataclass(frozen=True)
class Apart:
    """How far the boxes' centres by the sensor are from where the messages put them.

    Attributes
    ----------
    stamps_s : ndarray, shape (n,)
    ahead_m, left_m : ndarray, shape (n,)
        Of the sensor's, in the vehicle's axes.
    """

    stamps_s: FloatArray
    ahead_m: FloatArray
    left_m: FloatArray


def centres_apart(passage: Passage) -> Apart:
    """Hold the boxes' centres, as they are, against the messages, as they are."""
    stamps_s = passage.track.stamps_s
    xy, yaw, known = passage.vehicle.at(stamps_s + passage.time_offset_s)
    apart = rotate_xy(-yaw, passage.match(passage.track.centres) - xy)[known]
    return Apart(stamps_s[known], apart[:, 0], apart[:, 1])


def median_by_frame(stamps_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return each frame's stamp, shape (m,), and the quartiles of its values, shape (m, 3)."""
    frames, index = np.unique(stamps_s, return_inverse=True)
    quartiles = [np.quantile(values[index == number], [0.25, 0.5, 0.75]) for number in range(len(frames))]
    return frames, np.array(quartiles).reshape(-1, 3)
