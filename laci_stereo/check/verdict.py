"""Verdict of the lane check: the lines confirm the calibration, contradict it, or are inconclusive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import chdtri, ndtri

from laci_stereo.check.align import RIVAL_SHARE
from laci_stereo.check.fit import PlanarError

Outcome = Literal["pass", "fail", "cannot tell"]

ERROR_RATE = 0.02
"""Fraction of calibrations as accurate as they claim that fail, and of those with just too large an error that pass."""

TOO_FAR_M, TOO_FAR_RAD = 0.30, np.radians(0.5)
"""Errors that a pass rules out: a tenth of a lane's width, and the angle that causes as much in 35 m."""

FEWEST_LINES = 3
"""Shift and turn are three unknowns: with fewer lines, above all short ones, nothing contradicts a wrong alignment."""

LEAST_SHARE = 1 / 2
"""Least fraction of the lines in view: if fewer are found, the map may be of another road, or the paint of a wrong
line."""

CONTRADICTION = float(chdtri(3, ERROR_RATE))
ONE_SIDED = float(-ndtri(ERROR_RATE))


@dataclass(frozen=True)
class Evidence:
    """How much was found.

    Attributes
    ----------
    in_view, found : int
        Number of lines that should be found, and number of lines found that agree with each other.
    rival : float
        How well the lines fit elsewhere, see `Alignment.share`.
    astray : int
        Number of lines found whose offsets contradict those of the others.
    """

    in_view: int
    found: int
    rival: float
    astray: int = 0


@dataclass(frozen=True)
class Judgement:
    """A verdict with its reasons as text."""

    outcome: Outcome
    reasons: tuple[str, ...]


def judge(evidence: Evidence, error: PlanarError | None) -> Judgement:
    """Return the verdict.

    *fail*: the error contradicts the covariance that the calibration claims, or reaches `TOO_FAR_M` or `TOO_FAR_RAD`,
    which no claimed uncertainty excuses. *pass*: neither, and an error of that size is ruled out. Otherwise the lines
    are inconclusive.
    """
    lacking = _lacking(evidence)
    wrong = "" if error is None else _wrong(error)
    if lacking or error is None:
        doubted = (f"if what was found is theirs, {wrong}",) if wrong else ()
        return Judgement("cannot tell", (lacking or "nothing was found near the map's lines", *doubted))
    if wrong:
        return Judgement("fail", (wrong,))
    possible = tuple(_not_ruled_out(error))
    return Judgement("cannot tell", possible) if possible else Judgement("pass", ())


def _lacking(evidence: Evidence) -> str:
    if evidence.in_view == 0:
        return "none of the map's lines that can be seen is in view"
    found = f"{evidence.found} of {evidence.in_view} lines in view were found"
    if evidence.astray:
        found += f", and {evidence.astray} more off on their own"
    why = "they may be worn, the map of another road, or the calibration wrong"
    if evidence.found < min(FEWEST_LINES, evidence.in_view):
        return f"{found}; needed are at least {FEWEST_LINES}: {why}"
    if evidence.found < FEWEST_LINES:
        return f"{found}; needed are at least {FEWEST_LINES}"
    if evidence.found < LEAST_SHARE * evidence.in_view:
        return f"{found}; needed is at least half: {why}"
    if evidence.rival >= RIVAL_SHARE:
        return "the lines fit about as well elsewhere, as on a kerb beside them"
    return ""


def _wrong(error: PlanarError) -> str:
    shift_m, turn_rad = float(np.linalg.norm(error.value[:2])), float(error.value[2])
    off = f"the lines are {100 * shift_m:.0f} cm and {np.degrees(turn_rad):+.2f} deg off"
    if error.chi_square > CONTRADICTION:
        return (
            f"{off}: chi-square is {error.chi_square:.0f}, and what the calibration claims and the map's own error "
            f"allow is {CONTRADICTION:.0f}"
        )
    # In a direction that the lines leave undetermined, the value is arbitrary, however precise the others are.
    towards = error.value[:2] / max(shift_m, 1e-9)
    sure_m = float(np.sqrt(CONTRADICTION * (towards @ error.covariance[:2, :2] @ towards)))
    sure_rad = float(np.sqrt(CONTRADICTION * error.covariance[2, 2]))
    if shift_m >= max(TOO_FAR_M, sure_m) or abs(turn_rad) >= max(TOO_FAR_RAD, sure_rad):
        return (
            f"{off}, which the calibration's own uncertainty allows, but needed are less than {100 * TOO_FAR_M:.0f} cm "
            f"and {np.degrees(TOO_FAR_RAD):.1f} deg"
        )
    return ""


def _not_ruled_out(error: PlanarError) -> list[str]:
    """Return, as text, the errors that cannot be ruled out."""
    shift_m, covariance = error.value[:2], error.covariance[:2, :2]
    towards = np.radians(np.arange(180.0))
    directions = np.column_stack([np.cos(towards), np.sin(towards)])
    found_m, sigmas_m = np.abs(directions @ shift_m), np.sqrt(((directions @ covariance) * directions).sum(axis=1))
    least = int((found_m + ONE_SIDED * sigmas_m).argmax())
    sentences = []
    if found_m[least] + ONE_SIDED * sigmas_m[least] > TOO_FAR_M:
        sentences.append(
            f"a shift of {100 * TOO_FAR_M:.0f} cm towards {least} deg, or back, is not ruled out: the lines say "
            f"{100 * found_m[least]:.0f} +- {100 * sigmas_m[least]:.0f} cm"
        )
    turn_rad, sigma_rad = float(error.value[2]), float(np.sqrt(error.covariance[2, 2]))
    if abs(turn_rad) + ONE_SIDED * sigma_rad > TOO_FAR_RAD:
        sentences.append(
            f"a turn of {np.degrees(TOO_FAR_RAD):.1f} deg is not ruled out: the lines say "
            f"{np.degrees(turn_rad):+.2f} +- {np.degrees(sigma_rad):.2f} deg"
        )
    return sentences
