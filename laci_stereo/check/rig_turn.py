"""A stereo calibration brought up to date: how far the right camera has turned since, by the rows of its images.

Screws settle, and bars bend in the sun: a turn by a fiftieth of a degree moves rows by a third of a pixel, where every
disparity on a slanted edge is wrong already. Rows tell it to a thousandth of a degree, and it is taken back. What they
do not tell is a turn sideways, which shifts all disparities alike; it is likely to be as large, and so is said.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeAlias

import numpy as np

from laci_stereo.check.rig_images import fit_of, flat_images, match_images, swapped_images
from laci_stereo.check.rig_matches import PairMatches
from laci_stereo.check.rig_verdict import WARN_PX, Fit, contradictions, outcome_of
from laci_stereo.core.errors import ImageError, RigError
from laci_stereo.core.frames import FloatArray
from laci_stereo.io.images import StereoPair
from laci_stereo.io.rig import StereoRig
from laci_stereo.stereo.rectify import Rectification, with_right_turned

TurnDeg: TypeAlias = tuple[float, float, float]
"""See `StereoSettings.turn_deg`."""

NO_TURN: TurnDeg = (0.0, 0.0, 0.0)

LEAST_PX, SURELY = 0.05, 3.0
"""Rows that are off by less, or by less than so many standard deviations, are left as they are: a matcher's own bias is
as large."""

LOOKS = 2
"""The turn is found to first order; what a turn of a degree leaves then is a hundredth of that."""

MOST_LOOKS = 3
"""So often a drive is asked how far the right camera has turned sideways, which takes a run each time: each leaves a
tenth or so of what the one before was off."""

SAID_AT_M = 30.0
"""How far away things are of which it is said how far they may be off."""


@dataclass(frozen=True)
class RightTurn:
    """How far the right camera has turned since it was calibrated.

    Attributes
    ----------
    turn_deg : tuple of float, or None
        As in `StereoSettings.turn_deg`.
    off_px : float
        By how much a turn sideways that is as large shifts all disparities.
    left_px : float
        By how much disparities may be off all the same after a drive has told that turn, one standard deviation; 0
        where none has, or only roughly.
    looks : int
        How often a drive was asked for it.
    by_rows, doubts : tuple of str
        What was done about it, and what is wrong with the calibration all the same.
    fits : callable, or None
        How matches lie, given a turn; None where there is none.
    """

    turn_deg: TurnDeg | None = None
    off_px: float = 0.0
    left_px: float = 0.0
    looks: int = 0
    by_rows: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    fits: Callable[[TurnDeg], Fit] | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done about it, by the drive as well."""
        if not self.looks or self.turn_deg is None:
            return self.by_rows
        said = f"by the drive the right camera has turned by {self.turn_deg[1]:+.3f} deg sideways"
        return (*self.by_rows, f"stereo calibration: {said}; that is taken into account, too")

    def sideways(self, plane: Rectification, per_m: float, after_per_m: float) -> RightTurn:
        """Return the turn by so much more that inverse depths are larger, 1/m; its standard deviation is 0 if unknown.

        Inverse depths are disparities over focal length and baseline, and a turn shifts these by the focal length. It
        moves rows as well, where they are not in the middle, as a roll does: these are looked at again.
        """
        pitch, yaw, roll = self.turn_deg or NO_TURN
        turn_deg = pitch, yaw + float(np.degrees(plane.baseline_m * per_m)) * (-1.0 if plane.mirrored else 1.0), roll
        if self.fits is not None:
            turn_deg, _ = _evened(self.fits, turn_deg)
        left_px = plane.focal_px * plane.baseline_m * after_per_m
        return replace(self, turn_deg=turn_deg, left_px=left_px, looks=self.looks + 1)


def find_turn(rig: StereoRig, pairs: Sequence[StereoPair]) -> RightTurn:
    """Find how far the right camera has turned up and about its line of sight, from matches in some pairs.

    Parameters
    ----------
    rig : StereoRig
        Of the images as they are.
    pairs : sequence of StereoPair

    Raises
    ------
    RigError
        If left and right are swapped, or the images are rectified already.
    """
    try:
        matches = match_images(pairs).matches
    except ImageError:
        return RightTurn()  # who reads all of them says what is wrong
    fits = partial(_fit_turned, rig, matches)
    turn_deg, fit = _evened(fits, NO_TURN)
    if fit.judged is None:
        return RightTurn()
    against = contradictions(fit, fit.judged)
    if outcome_of(against) == "fail" and (mistakes := [*swapped_images(rig, matches), *flat_images(rig, matches)]):
        raise RigError(f"{pairs[0].left.parent}: {mistakes[0].text}")
    doubts = tuple(f"stereo calibration: {finding.text}" for finding in against)
    if turn_deg == NO_TURN:
        return RightTurn(doubts=doubts)
    said, turn_rad = _in_words(fits(NO_TURN), turn_deg), float(np.radians(np.linalg.norm(turn_deg)))
    off_px = fit.points.focal_px * turn_rad
    if off_px <= WARN_PX:
        return RightTurn(turn_deg, off_px, by_rows=(f"{said}; that is taken into account",), doubts=doubts, fits=fits)
    doubt = (
        f"{said}; that is taken into account, but a turn sideways by as much, which only the drive tells, puts what is "
        f"{SAID_AT_M:.0f} m away {SAID_AT_M**2 * turn_rad / rig.baseline_m:.1f} m nearer or farther: calibrate the "
        "cameras again"
    )
    return RightTurn(turn_deg, off_px, doubts=(doubt, *doubts), fits=fits)


def _fit_turned(rig: StereoRig, matches: Sequence[PairMatches], turn_deg: TurnDeg) -> Fit:
    return fit_of(with_right_turned(rig, turn_deg), matches)


def _evened(fits: Callable[[TurnDeg], Fit], turn_deg: TurnDeg) -> tuple[TurnDeg, Fit]:
    """Return by which turn up and about the line of sight rows are even, given one, and how matches lie then."""
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
    """Return the turn that is to be taken back, about x and z, shape (2,); None if it is none, or cannot be told."""
    if fit.judged is None:
        return None
    rows = fit.judged.rows_turn
    surely = (np.abs(rows.angles_rad) > SURELY * rows.sigma_rad).any()
    return rows.angles_rad if surely and rows.effect_px > LEAST_PX else None


def _in_words(before: Fit, turn_deg: TurnDeg) -> str:
    assert before.judged is not None
    pitch, _, roll = turn_deg
    return (
        f"stereo calibration: partners lie {before.judged.rows_turn.effect_px:.2f} px beside their row, as the right "
        f"camera has turned by {pitch:+.3f} deg up or down and {roll:+.3f} deg about its line of sight since"
    )
