"""Verdict on a stereo calibration: whether it fits its images, and if not, what is wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from laci_stereo.check.rig_matches import Partners
from laci_stereo.check.rig_parallax import FLOOR_PX, Lag, Parallax, Turn
from laci_stereo.check.rig_points import COLUMNS, ROWS, Rectified

Outcome: TypeAlias = Literal["pass", "warn", "fail"]

WARN_PX = 3 * FLOOR_PX
"""Three standard deviations of what is allowed for as imperfect rectification; larger errors are not allowed for."""

FAIL_PX = 0.5
"""Beyond half a pixel, the adjacent row is nearer to a point's partner than the row that is searched. On an edge
inclined by 45 deg, the disparity error equals the row error."""

FEWEST_CELLS = COLUMNS * ROWS // 4
"""Least number of cells with matches: a quarter of the image, and more than twice the unknowns of a turn and a
shift."""

FEWEST_EXPECTED = 12
"""Least number of expected partners: with this expectation, a quarter or less is found by chance once in 400 times
(Poisson)."""

_AXES = ("in pitch", "in yaw", "in roll")


@dataclass(frozen=True)
class Finding:
    """An objection to a calibration, with its severity; one with the outcome "pass" is a remark."""

    outcome: Outcome
    text: str


@dataclass(frozen=True)
class Fit:
    """Evaluation of matches under a calibration.

    Attributes
    ----------
    points : Rectified
        Matches of the pairs whose two images show one scene.
    pairs, strange : int
        Number of pairs compared, and of those whose images have nothing in common.
    parallax : Parallax or None
        None if there are too few matches.
    lag : Lag or None
        None if too few points move.
    moving, still : Partners
        Counts over all pairs.
    """

    points: Rectified
    pairs: int
    strange: int
    parallax: Parallax | None
    lag: Lag | None
    moving: Partners
    still: Partners

    @property
    def shown(self) -> Parallax | None:
        """The parallax, if the images of at least half of the pairs show one scene; else None."""
        return None if 2 * self.strange > self.pairs else self.parallax

    @property
    def judged(self) -> Parallax | None:
        """The parallax, if enough parts of the image contain matches for a verdict; else None."""
        return self.shown if self.shown is not None and len(self.shown.cells.count) >= FEWEST_CELLS else None


def judge(fit: Fit) -> tuple[Finding, ...]:
    """Return the objections to a calibration; there are none if it fits.

    *fail*: disparities are unreliable. *warn*: they are worse than allowed for, or the images do not show whether they
    are.
    """
    if fit.shown is None:
        return (Finding("fail", _strangers(fit)),)
    return (*_coverage(fit, fit.shown), *contradictions(fit, fit.shown))


def contradictions(fit: Fit, shown: Parallax) -> tuple[Finding, ...]:
    """Return the objections to a calibration other than a lack of texture in the images."""
    found = [*_rows(shown), *_columns(shown, fit.points.focal_px)]
    if fit.strange:
        found.append(Finding("warn", _strangers(fit)))
    return (*found, *exposures_apart(fit))


def outcome_of(findings: tuple[Finding, ...]) -> Outcome:
    """Return the gravest outcome of some findings."""
    said = {finding.outcome for finding in findings}
    return "fail" if "fail" in said else "warn" if "warn" in said else "pass"


def graded(pixels: float) -> Outcome:
    """Return the severity of an error of rows or columns."""
    return "fail" if pixels > FAIL_PX else "warn" if pixels > WARN_PX else "pass"


def _strangers(fit: Fit) -> str:
    return (
        f"in {fit.strange} of {fit.pairs} pairs the images have no more in common than chance: left and right show "
        "different scenes, are of different times, or hold nothing with texture"
    )


def _coverage(fit: Fit, parallax: Parallax) -> list[Finding]:
    if fit.judged is not None:
        return []
    return [
        Finding(
            "warn",
            f"{len(fit.points)} matches, and enough of them in {len(parallax.cells.count)} of {COLUMNS * ROWS} parts "
            f"of the image; needed are {FEWEST_CELLS} to judge: is there texture, light and focus?",
        )
    ]


def _rows(parallax: Parallax) -> list[Finding]:
    grade = graded(parallax.systematic_px)
    if grade == "pass":
        return []
    stale = "the calibration is stale, or of another camera" if grade == "fail" else "the calibration has drifted"
    return [
        Finding(
            grade,
            f"after rectification matched points lie {parallax.systematic_px:.2f} px off their row, beyond noise; "
            f"allowed is {WARN_PX:g} px, and {FAIL_PX:g} px make disparities wrong: {stale}; "
            f"{explained(parallax.turn)}",
        )
    ]


def explained(turn: Turn) -> str:
    """Return which error of the calibration explains the parallax, in words."""
    if turn.left_over_px > WARN_PX:
        return "no rotation of a camera explains it: focal lengths, lens distortion or the image's crop do not fit"
    parts = [
        f"{np.degrees(angle):+.2f} deg {axis}"
        for angle, sigma, axis in zip(turn.angles_rad, turn.sigma_rad, _AXES, strict=True)
        if abs(angle) > 2 * sigma
    ]
    return f"the right camera has rotated by {', '.join(parts)}" if parts else "a shift of the right camera explains it"


def _columns(parallax: Parallax, focal_px: float) -> list[Finding]:
    """Judge errors along the rows, of which less is visible: yaw, and points beyond infinity."""
    found = []
    turn = parallax.turn
    off_px = focal_px * max(abs(turn.angles_rad[1]) - 3 * turn.sigma_rad[1], 0.0)
    if graded(off_px) != "pass" and turn.left_over_px <= WARN_PX:
        angle, sigma = np.degrees([turn.angles_rad[1], turn.sigma_rad[1]])
        found.append(
            Finding(
                graded(off_px),
                f"the right camera has yawed by {angle:+.2f} +- {sigma:.2f} deg, so disparities are off by "
                f"{focal_px * abs(turn.angles_rad[1]):.1f} px; allowed is {WARN_PX:g} px",
            )
        )
    if graded(parallax.behind_px) != "pass":
        found.append(
            Finding(
                graded(parallax.behind_px),
                f"points lie beyond infinity: disparities go {parallax.behind_px:.1f} px below zero, beyond noise; "
                "needed are positive ones",
            )
        )
    return found


def exposures_apart(fit: Fit) -> list[Finding]:
    """Return the objection that left and right images are not of the same moment, by the points that move."""
    expected = fit.moving.points * fit.still.matched / max(fit.still.points, 1)
    if expected >= FEWEST_EXPECTED and fit.moving.matched <= expected / 4:
        return [
            Finding(
                "fail",
                f"{fit.moving.matched} of {fit.moving.points} points that move have a partner, where {expected:.0f} "
                "were to be expected: left and right are of different times",
            )
        ]
    lag = fit.lag
    if lag is None or abs(lag.seconds) <= 3 * lag.sigma_s or graded(lag.effect_px) == "pass":
        return []
    return [
        Finding(
            graded(lag.effect_px),
            f"the right images are {1000 * lag.seconds:+.0f} +- {1000 * lag.sigma_s:.0f} ms later than the left "
            f"ones, by {lag.count} points that move and are off by {lag.effect_px:.1f} px; allowed is {WARN_PX:g} px",
        )
    ]
