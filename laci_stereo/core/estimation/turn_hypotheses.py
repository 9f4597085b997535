"""The estimate for each way in which a scanner may rotate that does not report the points' times, and their mixture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from laci_stereo.core.estimation.drive_rows import SWEEP
from laci_stereo.core.estimation.evidence import Evidence
from laci_stereo.core.estimation.mistakes import CLEARLY, MISTAKEN, others_agree
from laci_stereo.core.estimation.problem import Problem, Solved
from laci_stereo.core.estimation.residual_scatter import without_prior
from laci_stereo.core.estimation.scanner_turn import FIXED, TURNS
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.settings import UNKNOWN_CLOCK_S, JointSettings, with_turn


@dataclass(frozen=True)
class Turned:
    """The estimate of all parameters for one rotation of the scanner, and the log-evidence of that rotation."""

    turn: float
    x: FloatArray
    covariance: FloatArray
    log_probability: float


def turns_of(problem: Problem, solved: Solved, *, unset: bool) -> tuple[list[Turned], JointSettings]:
    """Condition the solution on each rotation, and return the priors: with unknown clocks if these were never set.

    Parameters
    ----------
    problem : Problem
    solved : Solved
    unset : bool
        Unset clocks are a possible mistake. They are preferred if their evidence is clearly larger than that of the
        rotations, and if the priors allow for all other corrections.
    """
    settings = problem.settings
    by_any = [_turned(problem, solved, turn, settings.clock_sigma_s) for turn in TURNS]
    if not unset:
        return by_any, settings
    free = replace(settings, clock_sigma_s=UNKNOWN_CLOCK_S)
    by_free = [_turned(problem, solved, turn, free.clock_sigma_s) for turn in TURNS]
    if _log_sum(by_free) + np.log(MISTAKEN) > _log_sum(by_any) + CLEARLY:
        likeliest = max(by_free, key=lambda estimate: estimate.log_probability)
        if others_agree(problem, replace(solved, x=likeliest.x, covariance=likeliest.covariance), {"clock"}):
            return by_free, free
    return by_any, settings


def _turned(problem: Problem, solved: Solved, turn: float, known_s: float) -> Turned:
    """Condition the solution, in which the rotation has a normal prior, on one rotation and on the prior of the clocks.

    The likelihood of rotation and clock offsets is the posterior divided by the prior; the evidence of a rotation is
    the mean of that likelihood over the prior of rotation and clock offsets.
    """
    index = np.array([SWEEP, *problem.clocks])
    covariance = solved.covariance[np.ix_(index, index)]
    before, found = solved.precision[np.ix_(index, index)], np.linalg.inv(covariance)
    information, pull = without_prior(found - before, found @ solved.x[index] - before @ problem.mean[index])
    clocks = clock_sigmas_s([model.drive for model in problem.models], known_s, turn)
    prior = block_diag(FIXED**-2.0, problem.recordings.clocks(np.array(clocks) ** -2.0))
    mean = np.array([turn, *np.zeros(len(clocks))])
    after, sum_pull = prior + information, prior @ mean + pull
    at = np.linalg.solve(after, sum_pull)
    evidence = (sum_pull @ at - mean @ prior @ mean + np.linalg.slogdet(prior)[1] - np.linalg.slogdet(after)[1]) / 2
    gain = np.linalg.solve(covariance, solved.covariance[index]).T
    x = solved.x + gain @ (at - solved.x[index])
    left = solved.covariance + gain @ (np.linalg.inv(after) - covariance) @ gain.T
    return Turned(turn, x, left, float(evidence + np.log(TURNS[turn])))


def clock_sigmas_s(drives: Sequence[Evidence], known_s: float, turn: float) -> list[float]:
    """Return the prior standard deviation of each drive's clock offset for this rotation of the scanner."""
    return [with_turn(known_s, drive.turn_s) if turn else known_s for drive in drives]


def _log_sum(turned: Sequence[Turned]) -> float:
    """Return the log of the sum of the evidence of several rotations."""
    return float(np.logaddexp.reduce([estimate.log_probability for estimate in turned]))


def among(turned: Sequence[Turned], likeliest: Turned, solved: Solved) -> tuple[Solved, float]:
    """Return the solution for the most likely rotation, with the covariance of the mixture of all, and its probability.

    The covariance includes the other rotations' covariances and their differences, weighted by their probabilities.
    """
    log_sum = _log_sum(turned)
    probabilities = np.exp([estimate.log_probability - log_sum for estimate in turned])
    off = np.array([estimate.x - likeliest.x for estimate in turned])
    within = [solved.covariance if estimate is likeliest else estimate.covariance for estimate in turned]
    covariance = np.tensordot(probabilities, within, 1) + (off.T * probabilities) @ off
    return replace(solved, covariance=covariance), float(probabilities.max())
