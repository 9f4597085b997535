"""Hypotheses of mistakes in the messages or in a stereo calibration, by far more than the settings allow."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from laci_stereo.core.estimation.drive_prior import LAG, OPTICS, Correction
from laci_stereo.core.estimation.drive_rows import APART, BASELINE, FOCAL
from laci_stereo.core.estimation.evidence import Evidence
from laci_stereo.core.estimation.problem import COMPARED, Problem, Solved
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.settings import UNKNOWN_CLOCK_S, JointSettings

WRONG_OPTICS = 0.03
"""A priori relative standard deviation of a wrong focal length or baseline: this is the error of a focal length that
was read from another matrix, such as the raw image's, or of a baseline that was measured on the outside of the
camera."""

UNTRIGGERED_S = 0.005
"""Standard deviation of the time between left and right images that no common trigger exposes. Cameras that run freely
are apart by up to half a frame period, tens of milliseconds, of which no vehicle remains in one place; software that
starts both exposures leaves some milliseconds."""

MISTAKEN, WRONG_HEADING_DEG = 0.02, 10.0
"""A priori probability of a mistake in a sender's set-up, one in fifty, and the standard deviation of its headings
then.

The positions of such a sender may refer to any place on the vehicle, its clock may not be set, and its headings may be
as far off as those of another part of the vehicle, such as a cab in a bend, or as a magnetic compass. One stereo camera
in fifty likewise has the calibration of another camera, or of another mode."""

CLEARLY = float(np.log(10.0))
"""Least log odds for a mistake that is not significant, and for clocks that were never set where a scanner's rotation
is the alternative that explains the same delays less well."""

LATE = 2.0
"""Clocks whose estimated offset is at most this many standard deviations are taken as synchronised. An offset that the
points hardly determine is estimated close to its prior, which `Correction.surprise` takes into account."""

SURELY, TURNED_RAD = 4.0, np.radians(30.0)
"""A mistake is accepted only if the correction exceeds the first number of its own posterior standard deviations; for
focal length and baseline together, if their Mahalanobis distance does: with 3, four of about fifty correct stereo
calibrations were found to be wrong. A wrong place of the reference point on the vehicle is only determined in a turn of
at least the second number, in which an error of half the vehicle's length moves the position by half of that error; on
a straight drive the noise of the headings looks like it."""

IN_TURNS = frozenset({"ahead", "left", "lag"})
"""Corrections that only a turn determines."""

LAGGING_S = 0.2
"""Standard deviation of the lag of headings that are not of the same moment as the positions: those of filtered
positions, or of a direction of motion that waits for the next epoch, which in some receivers is 0.2 s later."""


OPTICS_OFF, APART_OFF = frozenset(OPTICS), frozenset({"apart"})
"""The mistakes of a stereo camera, by the corrections in which they show."""

OF_SENSOR = dict(zip((*OPTICS, "apart"), (FOCAL, BASELINE, APART), strict=True))
"""The sensor's parameters by the mistakes in which they show."""


@dataclass(frozen=True)
class Mistake:
    """A hypothesis that something is wrong by far more than the settings allow.

    Attributes
    ----------
    what : frozenset of str
        The corrections in which it shows.
    settings : JointSettings
        The priors under this hypothesis.
    log_wider : float
        Log ratio by which the prior volume of these corrections is larger under this hypothesis.
    alone : bool
        The hypothesis only holds if the priors allow for all other corrections.
    least_log_odds : float
        Log odds above which the hypothesis need not be significant. They are finite where its prior is centred on no
        mistake and the volume of its posterior is known: its standard deviations are then right in any case.
    """

    what: frozenset[str]
    settings: JointSettings
    log_wider: float = 0.0
    alone: bool = False
    least_log_odds: float = np.inf


@dataclass(frozen=True)
class Rival:
    """Another estimate that explains the points: with clocks that were never set, or with other optics.

    Attributes
    ----------
    x : ndarray, shape (p,)
        All parameters.
    clock : Correction or None
        The clock offset of one drive; None: it is one with other optics.
    """

    x: FloatArray
    clock: Correction | None = None


@dataclass(frozen=True)
class _Likely:
    """A mistake that is likelier than none by its log odds, and the estimate with the priors of its hypothesis."""

    mistake: Mistake
    problem: Problem
    solved: Solved
    log_odds: float


def likely_mistakes(problem: Problem, x: FloatArray) -> tuple[FloatArray, JointSettings, tuple[Rival, ...]]:
    """Return the start, the priors, and the rivals of the mistakes that are more likely than none.

    The most likely mistake is accepted first, and the others are then looked for beside it. Start and priors are those
    given where there is none. Clocks that were perhaps never set, beside none of the other mistakes, are a rival with
    log odds above `CLEARLY`, whether their offset is significant or not. Of wrong optics and images of different
    moments, which look alike, the latter are accepted unless the former are clearly more likely, as they take one
    number to explain the same; the former are their rival then, unless they are clearly less likely.
    """
    likeliest, rivals = _likeliest_mistake(problem, problem.solve(x, COMPARED))
    while likeliest:
        x, problem = likeliest.solved.x, likeliest.problem
        likeliest, _ = _likeliest_mistake(problem, likeliest.solved)
    return x, problem.settings, tuple(rivals)


def _likeliest_mistake(problem: Problem, solved: Solved) -> tuple[_Likely | None, list[Rival]]:
    """Return the mistake that is accepted first, if any is, and its rivals and those of no mistake."""
    likely: list[_Likely] = []
    rivals = []
    for mistake in _mistakes(problem, solved):
        if mistake.settings == problem.settings:
            continue
        wider = problem.expecting(mistake.settings)
        corrected = wider.solve(solved.x, COMPARED)
        least, unset = 0.0 if _is_significant(wider, corrected, mistake) else mistake.least_log_odds, None
        if "clock" in mistake.what and others_agree(wider, corrected, mistake.what):
            unset = _late_clock(wider, corrected, problem.settings.clock_sigma_s)
        if np.isinf(least) and not unset:
            continue
        log_occam_factor = _log_occam_factor(wider, corrected) - _log_occam_factor(problem, solved) - mistake.log_wider
        log_odds = float(np.log(MISTAKEN)) + log_occam_factor + _log_likelihood_ratio(problem, solved, wider, corrected)
        if unset and log_odds > CLEARLY:
            rivals.append(Rival(corrected.x, unset))
        if log_odds > max(least, 0.0):
            likely.append(_Likely(mistake, wider, corrected, log_odds))
    if not likely:
        return None, rivals
    likeliest = max(likely, key=lambda found: found.log_odds)
    alike = {found.mistake.what: found for found in likely if found.log_odds > likeliest.log_odds - CLEARLY}
    if likeliest.mistake.what in (OPTICS_OFF, APART_OFF) and alike.keys() >= {OPTICS_OFF, APART_OFF}:
        rivals.append(Rival(alike[OPTICS_OFF].solved.x))
        likeliest = alike[APART_OFF]
    return likeliest, rivals


def _mistakes(problem: Problem, solved: Solved) -> list[Mistake]:
    """Return the hypotheses of mistakes that the drives could reveal.

    These are: headings that are not those of the drive, which a detector's boxes reveal only in a turn; headings that
    are older than the positions beside them, or a reference point at another place on the vehicle than was reported,
    both of which only a turn determines; another focal length or baseline of a stereo camera, or left and right images
    of different moments; and a clock that was never set, if some clocks seem to be apart or could not seem so. Small
    errors of many other parameters are a more likely explanation the smaller a mistake is; from such a solution the
    path to the mistake leads downhill, so that a descent from there finds it.
    """
    settings, drives = problem.settings, [model.drive for model in problem.models]
    senders = len(set(problem.recordings.stations))
    # The variance of a detector's boxes is estimated from their dispersion: an estimate with wrong clocks, which add to
    # it, never seems to contradict it, and likelihoods only compare as if errors of successive boxes were independent.
    boxes = not any(len(drive.points) for drive in drives)
    turned = any(_turned_rad(drive) > TURNED_RAD for drive in drives)
    likely = []
    # On a straight drive boxes show a wrong heading only as a shift to the side, as their own errors do.
    if turned or not boxes:
        heading = replace(settings, heading_sigma_deg=WRONG_HEADING_DEG)
        wider = heading.heading_sigma_deg / settings.heading_sigma_deg
        likely.append(Mistake(frozenset({"heading"}), heading, senders * np.log(wider)))
    if turned:
        place = replace(settings, lever_sigma_m=max(drive.vehicle.length_m for drive in drives) / 2)
        wider = place.lever_sigma_m / settings.lever_sigma_m
        likely.append(Mistake(frozenset({"ahead", "left"}), place, 2 * senders * np.log(wider)))
        likely.append(
            Mistake(
                frozenset({"lag"}),
                replace(settings, heading_lag_s=LAGGING_S),
                least_log_odds=np.inf if boxes else CLEARLY,
            )
        )
    # Where all disparities may be off, as after one camera has rotated relative to the other, a wrong focal length or
    # baseline would only seem to be found.
    if any(drive.window_rad for drive in drives) and settings.bias_noise_share <= JointSettings.bias_noise_share:
        optics = replace(settings, optics_sigma=WRONG_OPTICS)
        likely.append(Mistake(OPTICS_OFF, optics))
    if any(drive.cameras for drive in drives) and settings.apart_sigma_s < UNTRIGGERED_S:
        apart = replace(settings, apart_sigma_s=UNTRIGGERED_S)
        likely.append(Mistake(APART_OFF, apart, least_log_odds=CLEARLY))
    if not problem.turn.possible and (boxes or any(clock.surprise > LATE for clock in _clocks(problem, solved))):
        unset = replace(settings, clock_sigma_s=UNKNOWN_CLOCK_S)
        before, after = (problem.recordings.log_clock_volume(each.clock_sigma_s) for each in (settings, unset))
        likely.append(Mistake(frozenset({"clock"}), unset, after - before, alone=True))
    return likely


def _log_likelihood_ratio(problem: Problem, solved: Solved, wider: Problem, corrected: Solved) -> float:
    """Return the log-likelihood ratio of the points under a solution with a mistake over one without.

    The two solutions select different points, as different lines of sight meet an upright part of the outline. For the
    selection of each solution, the points that both can place are compared; the result is the mean of the two.
    """
    gains = []
    for chosen in (solved.chosen, corrected.chosen):
        drives = zip(problem.rows_at(solved.x, chosen), wider.rows_at(corrected.x, chosen), strict=True)
        for i, (before, after) in enumerate(drives):
            _, kept, moved = np.intersect1d(before.point, after.point, assume_unique=True, return_indices=True)
            gains.append(wider.settled(i, corrected, after[moved]) - problem.settled(i, solved, before[kept]))
    return sum(gains) / 2


def _log_occam_factor(problem: Problem, solved: Solved) -> float:
    """Return the log prior density of the solution, plus a log ratio of posterior to prior volume (MacKay 1992).

    The volume is that of the sensor's parameters and of the lags of headings, which are exact unless a hypothesis says
    otherwise. The prior volume of other mistakes is in `Mistake.log_wider`: their posterior volumes are far
    smaller than the prior ones.
    """
    exact = np.array([*OF_SENSOR.values(), *(own.start + LAG for own in problem.own)])
    before, after = np.linalg.inv(solved.precision), solved.covariance
    volumes = [np.linalg.slogdet(covariance[np.ix_(exact, exact)])[1] / 2 for covariance in (after, before)]
    return problem.log_prior(solved.x, solved.precision) + float(volumes[0] - volumes[1])


def _is_significant(problem: Problem, solved: Solved, mistake: Mistake) -> bool:
    """Tell whether a correction of this mistake is significant."""
    if mistake.alone and not others_agree(problem, solved, mistake.what):
        return False
    if of_sensor := [index for what, index in OF_SENSOR.items() if what in mistake.what]:
        # Together: a baseline affects both.
        found, covariance = solved.x[of_sensor], solved.covariance[np.ix_(of_sensor, of_sensor)]
        return float(found @ np.linalg.solve(covariance, found)) > SURELY**2
    return any(
        correction.what in mistake.what and abs(correction.value) > SURELY * correction.after
        for model, corrections in problem.corrections(solved)
        if not mistake.what & IN_TURNS or _turned_rad(model.drive) > TURNED_RAD
        for correction in corrections
    )


def _clocks(problem: Problem, solved: Solved) -> list[Correction]:
    """Return the correction of each drive's clock offset."""
    corrections = chain.from_iterable(found for _, found in problem.corrections(solved))
    return [correction for correction in corrections if correction.what == "clock"]


def _late_clock(problem: Problem, solved: Solved, known_s: float) -> Correction | None:
    """Return a drive's clock offset that exceeds both its prior and its posterior uncertainty by far, or None."""
    late = (clock for clock in _clocks(problem, solved) if abs(clock.value) > LATE * max(known_s, clock.after))
    return next(late, None)


def others_agree(problem: Problem, solved: Solved, what: Set[str]) -> bool:
    """Tell whether all corrections but these agree with their priors."""
    corrections = chain.from_iterable(found for _, found in problem.corrections(solved))
    return all(correction.surprise <= SURELY for correction in corrections if correction.what not in what)


def _turned_rad(drive: Evidence) -> float:
    _, yaw, known = drive.vehicle.at(drive.stamps_s)
    return float(np.ptp(yaw[known])) if known.any() else 0.0
