"""Update of a stereo calibration: pitch and roll of the right camera since then, from the rows of its images.

The word turn stands for a small rotation, as in `StereoSettings.turn_deg`; yaw is a turn about the camera's y axis.

Screws settle, and bars bend in the sun: a turn of a fiftieth of a degree moves rows by a third of a pixel, at which
every disparity on a slanted edge is wrong already. Rows determine pitch and roll to a thousandth of a degree, and these
are corrected. Rows do not determine yaw, which shifts all disparities alike; it is likely to be as large, and is
therefore reported.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias

import numpy as np

from laci_stereo.check.rig_images import fit_of, flat_images, match_images, swapped_images
from laci_stereo.check.rig_matches import PairMatches
from laci_stereo.check.rig_verdict import WARN_PX, Fit, contradictions, exposures_apart, outcome_of
from laci_stereo.core.errors import ImageError, RigError
from laci_stereo.core.frames import FloatArray
from laci_stereo.io.images import StereoPair
from laci_stereo.io.rig.stereo_rig import StereoRig
from laci_stereo.stereo.rectify import Rectification, with_right_turned

TurnDeg: TypeAlias = tuple[float, float, float]
"""See `StereoSettings.turn_deg`."""

NO_TURN: TurnDeg = (0.0, 0.0, 0.0)

LEAST_PX, SURELY = 0.05, 3.0
"""Row errors below `LEAST_PX`, and turns below `SURELY` standard deviations, are not corrected: a matcher's own bias is
as large."""

LOOKS = 2
"""Number of iterations: the turn is estimated to first order, which leaves a hundredth of a turn of one degree."""

MOST_LOOKS = 3
"""Largest number of times that a drive is used to estimate the right camera's yaw, each of which takes a run. Each
reduces the error to about a tenth."""

SAID_AT_M = 30.0
"""Distance for which the possible depth error is reported."""


@dataclass(frozen=True)
class RightTurn:
    """Rotation of the right camera since its calibration.

    Attributes
    ----------
    turn_deg : tuple of float, or None
        As in `StereoSettings.turn_deg`.
    off_px : float
        Shift of all disparities by a yaw as large as the estimated turn.
    left_px : float
        Standard deviation of the disparity shift that remains after a drive has determined the yaw; 0 if none has, or
        only roughly.
    looks : int
        Number of times that a drive was used to estimate the yaw.
    by_rows, doubts, failures : tuple of str
        What was corrected, the objections to the calibration that remain, and what makes the images unusable.
    fits : callable, or None
        Evaluates the matches under a given turn; None if there is no turn.
    """

    turn_deg: TurnDeg | None = None
    off_px: float = 0.0
    left_px: float = 0.0
    looks: int = 0
    by_rows: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    failures: tuple[str, ...] = ()
    fits: Callable[[TurnDeg], Fit] | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """What was corrected, including the yaw from the drive."""
        if not self.looks or self.turn_deg is None:
            return self.by_rows
        said = f"by the drive, the right camera has yawed by {self.turn_deg[1]:+.3f} deg"
        return (*self.by_rows, f"stereo calibration: {said}; this is compensated, too")

    def sideways(self, plane: Rectification, per_m: float, after_per_m: float) -> RightTurn:
        """Return the turn with its yaw increased so that inverse depths, 1/m, change by ``per_m``.

        ``after_per_m`` is the standard deviation of the estimate; 0 if unknown.

        Inverse depth is disparity over focal length and baseline, and a yaw in radians shifts disparities by the focal
        length times it. Off the middle rows it also moves rows, as a roll does: pitch and roll are therefore estimated
        again.
        """
        pitch, yaw, roll = self.turn_deg or NO_TURN
        turn_deg = pitch, yaw + float(np.degrees(plane.baseline_m * per_m)) * (-1.0 if plane.mirrored else 1.0), roll
        if self.fits is not None:
            turn_deg, _ = _evened(self.fits, turn_deg)
        left_px = plane.focal_px * plane.baseline_m * after_per_m
        return replace(self, turn_deg=turn_deg, left_px=left_px, looks=self.looks + 1)


def find_turn(rig: StereoRig, pairs: Sequence[StereoPair]) -> RightTurn:
    """Estimate the right camera's pitch and roll from matches in some pairs; ``rig`` is that of the images as they are.

    Raises
    ------
    RigError
        If left and right are swapped, or the images are rectified already.
    """
    try:
        matches = match_images(pairs).matches
    except ImageError:
        return RightTurn()  # the caller reads all images and reports what is wrong
    fits = partial(_fit_turned, rig, matches)
    turn_deg, fit = _evened(fits, NO_TURN)
    if fit.judged is None:
        return RightTurn()
    against = contradictions(fit, fit.judged)
    if outcome_of(against) == "fail" and (mistakes := [*swapped_images(rig, matches), *flat_images(rig, matches)]):
        raise RigError(f"{pairs[0].left.parent}: {mistakes[0].text}")
    unusable = [finding for finding in exposures_apart(fit) if finding.outcome == "fail"]
    failures = tuple(f"stereo images: {finding.text}" for finding in unusable)
    doubts = tuple(f"stereo calibration: {finding.text}" for finding in against if finding not in unusable)
    found = RightTurn(doubts=doubts, failures=failures)
    if turn_deg == NO_TURN:
        return found
    words, turn_rad = _in_words(fits(NO_TURN), turn_deg), float(np.radians(np.linalg.norm(turn_deg)))
    off_px = fit.points.focal_px * turn_rad
    if off_px <= WARN_PX:
        by_rows = (f"{words}; this is compensated",)
        return replace(found, turn_deg=turn_deg, off_px=off_px, by_rows=by_rows, fits=fits)
    doubt = (
        f"{words}; this is compensated, but a yaw of the same size, which only the drive can show, would put what is "
        f"{SAID_AT_M:.0f} m away {SAID_AT_M**2 * turn_rad / rig.baseline_m:.1f} m nearer or farther: calibrate the "
        "cameras again"
    )
    return replace(found, turn_deg=turn_deg, off_px=off_px, doubts=(doubt, *doubts), fits=fits)


def _fit_turned(rig: StereoRig, matches: Sequence[PairMatches], turn_deg: TurnDeg) -> Fit:
    return fit_of(with_right_turned(rig, turn_deg), matches)


def _evened(fits: Callable[[TurnDeg], Fit], turn_deg: TurnDeg) -> tuple[TurnDeg, Fit]:
    """Return a turn with pitch and roll corrected so that rows agree, and the evaluation of the matches under it."""
    fit = fits(turn_deg)
    for _ in range(LOOKS):
        step = _step_rad(fit)
        if step is None:
            break
        up_deg, about_deg = np.degrees(step).tolist()
        turn_deg = turn_deg[0] + up_deg, turn_deg[1], turn_deg[2] + about_deg
        fit = fits(turn_deg)
    return turn_deg, fit


def _step_rad(fit: Fit) -> FloatArray | None:
    """Return the correction of pitch and roll, shape (2,), rad; None if it is insignificant or undetermined."""
    if fit.judged is None:
        return None
    rows = fit.judged.rows_turn
    surely = (np.abs(rows.angles_rad) > SURELY * rows.sigma_rad).any()
    return rows.angles_rad if surely and rows.effect_px > LEAST_PX else None


def _in_words(before: Fit, turn_deg: TurnDeg) -> str:
    assert before.judged is not None
    pitch, _, roll = turn_deg
    return (
        f"stereo calibration: matched points lie {before.judged.rows_turn.effect_px:.2f} px off their row, as the "
        f"right camera has pitched by {pitch:+.3f} deg and rolled by {roll:+.3f} deg since"
    )
