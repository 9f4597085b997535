"""A stereo calibration brought up to date: how far the right camera has turned since, by the rows of its images.

Screws settle, and bars bend in the sun: a turn by a fiftieth of a degree moves rows by a third of a pixel, where every
disparity on a slanted edge is wrong already. Rows tell it to a thousandth of a degree, and it is taken back. What they
do not tell is a turn sideways, which shifts all disparities alike; it is likely to be as large, and so is said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from laci_stereo.check.rig_images import fit_of, flat_images, match_images, swapped_images
from laci_stereo.check.rig_verdict import WARN_PX, Fit, contradictions, outcome_of
from laci_stereo.core.errors import ImageError, RigError
from laci_stereo.core.frames import FloatArray
from laci_stereo.io.images import StereoPair
from laci_stereo.io.rig import StereoRig
from laci_stereo.stereo.rectify import turned

LEAST_PX, SURELY = 0.05, 3.0
"""Rows that are off by less, or by less than so many standard deviations, are left as they are: a matcher's own bias is
as large."""

LOOKS = 2
"""The turn is found to first order; what a turn of a degree leaves then is a hundredth of that."""

SAID_AT_M = 30.0
"""How far away things are of which it is said how far they may be off."""


@dataclass(frozen=True)
class RightTurn:
    """How far the right camera has turned since it was calibrated.

    Attributes
    ----------
    turn_deg : tuple of float, or None
        As in `StereoSettings.turn_deg`.
    notes, doubts : tuple of str
        What was done about it, and what is wrong with the calibration all the same.
    """

    turn_deg: tuple[float, float] | None = None
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()


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
    before = fit = fit_of(rig, matches)
    turn_deg: tuple[float, float] | None = None
    for _ in range(LOOKS):
        step = _step_rad(fit)
        if step is None:
            break
        pitch, roll = np.degrees(step) + (turn_deg or (0.0, 0.0))
        turn_deg = float(pitch), float(roll)
        fit = fit_of(turned(rig, turn_deg), matches)
    if not fit.covers or fit.shown is None:
        return RightTurn()
    against = contradictions(fit, fit.shown)
    if outcome_of(against) == "fail":
        for mistake in (*swapped_images(rig, matches), *flat_images(rig, matches)):
            raise RigError(f"{pairs[0].left.parent}: {mistake.text}")
    doubts = tuple(f"stereo calibration: {finding.text}" for finding in against)
    if turn_deg is None:
        return RightTurn(None, (), doubts)
    said = _in_words(before, turn_deg)
    off_px = fit.points.focal_px * float(np.radians(np.hypot(*turn_deg)))
    if off_px <= WARN_PX:
        return RightTurn(turn_deg, (f"{said}; that is taken into account",), doubts)
    off_m = SAID_AT_M**2 * float(np.radians(np.hypot(*turn_deg))) / rig.baseline_m
    doubt = (
        f"{said}; that is taken into account, but a turn sideways by as much would not show, and put what is "
        f"{SAID_AT_M:.0f} m away {off_m:.1f} m nearer or farther: calibrate the cameras again"
    )
    return RightTurn(turn_deg, (), (doubt, *doubts))


def _step_rad(fit: Fit) -> FloatArray | None:
    """Return the turn that is to be taken back, about x and z, shape (2,); None if it is none, or cannot be told."""
    if not fit.covers or fit.shown is None:
        return None
    rows = fit.shown.rows_turn
    surely = (np.abs(rows.angles_rad) > SURELY * rows.sigma_rad).any()
    return rows.angles_rad if surely and rows.effect_px > LEAST_PX else None


def _in_words(before: Fit, turn_deg: tuple[float, float]) -> str:
    assert before.shown is not None
    pitch, roll = turn_deg
    return (
        f"stereo calibration: partners lie {before.shown.rows_turn.effect_px:.2f} px beside their row, as the right "
        f"camera has turned by {pitch:+.3f} deg up or down and {roll:+.3f} deg about its line of sight since"
    )
