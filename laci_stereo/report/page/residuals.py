"""Residuals of each drive: its points relative to the vehicle's outline, and the corrections to its messages."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.estimation.drive_model import DriveModel
from laci_stereo.core.estimation.drive_prior import Correction
from laci_stereo.core.estimation.evidence import evidence_of
from laci_stereo.core.estimation.joint import start_at
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.estimation.problem import COMPARED, HELD, Problem
from laci_stereo.core.estimation.scanner_turn import FIXED, Turn
from laci_stereo.core.frames import FloatArray, IntArray, rotate_xy
from laci_stereo.core.settings import JointSettings
from laci_stereo.core.vehicle import outline

MOST_ROWS = 5_000
"""Number of points to which a drive is thinned, up to a factor of two: more would take longer and show the same."""

SIDES = ("rear", "front", "right side", "left side")


@dataclass(frozen=True)
class Laid:
    """The points of a drive in the vehicle's frame, by the calibration and the corrected messages.

    Attributes
    ----------
    stamps_s : ndarray, shape (n,)
        Stamp of each point's frame.
    xy_vehicle : ndarray, shape (n, 2)
        Metres; x ahead and y to the left of the box's centre.
    distance_m : ndarray, shape (n,)
        Distance from the outline, positive outside; the bias of a side with specular reflection is subtracted.
    face : ndarray of int, shape (n,)
        Side that the line of sight meets: 0 rear, 1 front, 2 right, 3 left. Points whose line of sight misses the
        vehicle are left out.
    surface : ndarray, shape (n,)
        Probability that the point belongs to the outline, and not to an object behind or beside it.
    """

    stamps_s: FloatArray
    xy_vehicle: FloatArray
    distance_m: FloatArray
    face: IntArray
    surface: FloatArray


@dataclass(frozen=True)
class Fit:
    """A drive's own parameters and residuals, given the transform.

    Attributes
    ----------
    laid : Laid or None
        None where no line of sight meets the outline, or where there are no points, as with a detector's boxes.
    corrections : tuple of Correction
        Estimated corrections to the drive's messages.
    """

    laid: Laid | None
    corrections: tuple[Correction, ...]


def fit_drive(passage: Passage, settings: JointSettings) -> Fit | None:
    """Estimate the corrections to a drive's messages, given the transform, and compute its points' residuals.

    If the transform is that of the joint estimate, the corrections are too: minimising over some of the parameters,
    with the others fixed at the joint minimum, gives the joint minimum.

    Parameters
    ----------
    passage : Passage
        A drive whose match contains the transform.
    settings : JointSettings
        The settings of the estimate.

    Returns
    -------
    Fit or None
        None where the messages never determine the vehicle's position.
    """
    drive = evidence_of(passage.track, passage.vehicle, passage.ground.height_m).thinned(MOST_ROWS)
    if not len(drive):
        return None
    centre = drive.middles.mean(axis=0)
    turn = Turn(passage.turn, FIXED)
    problem = Problem([drive], start_at(passage.match, centre), centre, settings, turn, pose_sigmas=HELD)
    solved = problem.solve(problem.best_of([problem.at_rest([passage.time_offset_s])]), COMPARED)
    ((model, corrections),) = problem.corrections(solved)
    laid = _lay(model, solved.x, solved.fitness[0].shares) if len(drive.points) else None
    return Fit(laid if laid is not None and len(laid.face) else None, corrections)


def _lay(model: DriveModel, x: FloatArray, shares: FloatArray) -> Laid:
    rows = model.rows(x)
    surface = model.likelihood.mixed(rows, rows.distance, np.sqrt(rows.variance), shares).surface
    of_outline = rows.face < outline.FACES
    rows = rows[of_outline]
    return Laid(model.drive.stamps_s[rows.frame], model.wall(x).xy, rows.distance, rows.face, surface[of_outline])


@dataclass(frozen=True)
class CentreOffsets:
    """Offsets of the sensor's box centres from the vehicle's by the messages, along its axes, shape (n,) each."""

    stamps_s: FloatArray
    ahead_m: FloatArray
    left_m: FloatArray


def centre_offsets(passage: Passage) -> CentreOffsets:
    """Compare the box centres with the messages, both without corrections other than the clock offset."""
    stamps_s = passage.track.stamps_s
    xy, yaw, known = passage.vehicle.at(stamps_s + passage.time_offset_s)
    offsets = rotate_xy(-yaw, passage.match(passage.track.centres) - xy)[known]
    return CentreOffsets(stamps_s[known], offsets[:, 0], offsets[:, 1])


def median_by_frame(stamps_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return each frame's stamp, shape (m,), and the quartiles of its values, shape (m, 3)."""
    frames, index = np.unique(stamps_s, return_inverse=True)
    quartiles = [np.quantile(values[index == number], [0.25, 0.5, 0.75]) for number in range(len(frames))]
    return frames, np.array(quartiles).reshape(-1, 3)
