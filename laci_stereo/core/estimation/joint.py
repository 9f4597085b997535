"""The default estimator: registers the visible outline on the vehicle that the messages report, in all frames at once.

One maximum-a-posteriori estimate solves for yaw, position and the sensor's systematic errors together with each drive's
own parameters (`drive_prior`). Angles and positions are those of the level frame in the world frame. In what follows a
scanner is a LiDAR and a matcher is the stereo matching, whose points are correlated within its windows; "log" is the
natural logarithm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from laci_stereo.core.errors import MatchError
from laci_stereo.core.estimation.drive_prior import OPTICS, Correction
from laci_stereo.core.estimation.drive_rows import APART, BIAS, BY_OPTICS
from laci_stereo.core.estimation.evidence import Evidence
from laci_stereo.core.estimation.mistakes import WRONG_OPTICS, Rival, likely_mistakes
from laci_stereo.core.estimation.problem import COMPARED, CONVERGED, Problem, Solved
from laci_stereo.core.estimation.residual_scatter import without_prior
from laci_stereo.core.estimation.scanner_turn import FIXED, Turn, turn_of
from laci_stereo.core.estimation.turn_hypotheses import among, clock_sigmas_s, turns_of
from laci_stereo.core.frames import FloatArray, rotate_xy, wrap
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.settings import JointSettings

START_YAWS_DEG = (-4.0, 0.0, 4.0)
SHIFTS_M = ((0.0, 0.0), (-0.9, -0.9), (-0.9, 0.9), (0.9, -0.9), (0.9, 0.9))
"""Yaw offsets and shifts of the starts around the paper's match: its yaw depends on the last box and is a few degrees
off at most; its position is off by half of the unseen part of the vehicle, which is half a car's width across the car
and somewhat more along it."""

COARSE_ROWS, ROUGH_ROWS = 1500, 3000
"""Number of points with which the starts are compared, of which a few per frame and side suffice to find the best one;
and number of points of a rough estimate. With half as many points of a rough estimate, one selection in ten mistook a
stranger for a vehicle among false masks."""

FINE_ROWS, MATCHED_ROWS = 40_000, 10_000
"""Points used in the final registration: over all drives together, and at least per drive of a stereo camera.

Errors that the points on one side of a frame share limit their weight to that of four independent points, however many
there are. Stereo matching windows, however, sample only parts of a car: with a quarter of this number, the choice of
points moved a result by a third of its standard deviation."""

HELD_ROWS = 3000
"""Least number of points per drive of a scanner in the final registration. Also the number of points of an estimate
that is only compared with another one, such as that of half a drive or of one drive of several."""


@dataclass(frozen=True)
class JointFit:
    """The result of the joint estimate.

    Attributes
    ----------
    match : PlanarMatch
        Transform from the level frame to the world frame.
    time_offsets_s : tuple of float
        Clock offset of each drive: to be added to the sensor's stamps to get the messages' time.
    covariance : ndarray, shape (3, 3)
        Covariance of (yaw [rad], x, y [m]) in the world frame, about ``centre_level``.
    centre_level : ndarray, shape (2,)
        Mean position of the vehicle (`Evidence.middles`) over all frames of all drives, level frame.
    time_sigmas_s : tuple of float
        Standard deviations of the clock offsets.
    corrections : tuple of tuple of Correction
        Corrections to the messages of each drive.
    optics : tuple of Correction
        Corrections to a stereo calibration, `OPTICS`; empty where it was taken as correct.
    residual_rms_m : float
        Root mean square distance of the points that the mixture attributes to the surface.
    frames : int
        Number of frames that have such points.
    standing : int
        Number of frames that were left out because the vehicle is stationary there in enough others.
    explained : float
        Fraction of the points that the outline explains: points at its surface or behind it.
    bodies : tuple of VehicleTrack
        For each drive the track that its messages report, with the yaw of the vehicle's body instead of the direction
        of motion.
    turn : float
        Rotation of the scanner while it takes a scan: 1 counter-clockwise, -1 clockwise, 0 none, or the points' times
        are known.
    turn_probability : float
        Posterior probability of that rotation.
    apart : Correction or None
        Time from the left to the right images of a stereo camera, s; None where these are of one moment.
    settings : JointSettings
        The priors that were used: wider than those given where a mistake was found in the messages or the calibration.
    perhaps_unset : Correction or None
        The clock offset of a drive, if clocks that were never set are more likely than the priors that were used but
        the estimate is not significant, or if they are an alternative to wrong `optics` or to images of different
        moments, which look alike. The covariance includes what the position would be with it.
    perhaps_optics : bool
        Wrong optics would explain the points about as well as the time between left and right images, and the
        covariance includes what the position would be with them.
    nearer : Correction or None
        Correction to be added to all inverse distances of a matcher, 1/m: the error that all disparities share.
    drives : tuple of Evidence
        The drives as they were used, with fewer points; empty by the paper's method.
    by_prior : ndarray, shape (3, p)
        How errors of the priors move yaw and position, see `Solved`.
    """

    match: PlanarMatch
    time_offsets_s: tuple[float, ...]
    covariance: FloatArray
    centre_level: FloatArray
    time_sigmas_s: tuple[float, ...]
    corrections: tuple[tuple[Correction, ...], ...]
    residual_rms_m: float
    frames: int
    explained: float = 1.0
    bodies: tuple[VehicleTrack, ...] = ()
    turn: float = 0.0
    turn_probability: float = 1.0
    standing: int = 0
    optics: tuple[Correction, ...] = ()
    apart: Correction | None = None
    settings: JointSettings = field(default_factory=JointSettings)
    perhaps_unset: Correction | None = None
    perhaps_optics: bool = False
    nearer: Correction | None = None
    drives: tuple[Evidence, ...] = ()
    by_prior: FloatArray = field(default_factory=lambda: np.zeros((3, 0)))

    def moved_to(self, place: FloatArray) -> FloatArray:
        """Return by what the errors of yaw, x and y at a place of the level frame follow from those at the centre."""
        arm = rotate_xy(self.match.yaw_rad, place - self.centre_level)
        moved: FloatArray = np.eye(3)
        moved[1:, 0] = -arm[1], arm[0]
        return moved

    def covariance_about(self, place: FloatArray) -> FloatArray:
        """Return the covariance of yaw, x and y, shape (3, 3), about a place of the level frame, shape (2,)."""
        moved = self.moved_to(place)
        covariance: FloatArray = moved @ self.covariance @ moved.T
        covariance[1:, 1:] += self.covariance_by_optics(place[None])
        return covariance

    def covariance_by_optics(self, places: FloatArray) -> FloatArray:
        """Return the mean squared displacement of places in the level frame, (n, 2), by wrong `optics`, shape (2, 2).

        It is given along the axes of the world frame. A wrong focal length or baseline scales the places about the
        centre of the drives, where the estimate puts them correctly.
        """
        if not self.optics:
            return np.zeros((2, 2))
        shares = np.array([each.value**2 + each.after**2 for each in self.optics])
        squares = ((places - self.centre_level) ** 2).mean(axis=0) * shares
        axes = rotate_xy(self.match.yaw_rad, np.eye(2))
        by_optics: FloatArray = (axes.T * squares) @ axes
        return by_optics


def fit_jointly(
    drives: Sequence[Evidence],
    start: PlanarMatch,
    time_offsets_s: Sequence[float] | None = None,
    settings: JointSettings | None = None,
    *,
    stations: Sequence[int] | None = None,
    close: bool = False,
    mistakes: bool = True,
) -> JointFit:
    """Estimate yaw and position, and each drive's clock offset, shape, gloss, message errors and growth of borders.

    The gloss is that of specular reflection, the message errors are those of positions (GNSS) and headings. Where a
    scanner does not report the points' times, its rotation is estimated as well: the result is that of the most likely
    rotation, and its covariance includes how far the results of the other rotations differ, weighted by their
    probabilities.

    Parameters
    ----------
    drives : sequence of Evidence
        Drives past one sensor, in its level frame.
    start : PlanarMatch
        Initial transform, correct to within some degrees and a vehicle's width.
    time_offsets_s : sequence of float
        Initial clock offset of each drive; None stands for 0.
    settings : JointSettings
    stations : sequence of int
        The sender of each drive. `Recordings` derives from it, and from the drives' times, which errors are correlated
        between drives. None: the drives are independent.
    close : bool
        The start is the estimate of each drive by itself and correct to within its uncertainty: no other start is
        tried.
    mistakes : bool
        The messages may be wrong by more than the settings allow.

    Raises
    ------
    MatchError
        If no point of any drive can be used.
    """
    settings = settings or JointSettings()
    offsets = [0.0] * len(drives) if time_offsets_s is None else list(time_offsets_s)
    used = [drive for drive in drives if len(drive)]
    if not used:
        raise MatchError("0 points of the vehicle while its CAMs report its position; needed are some in 10 frames")
    centre = np.concatenate([drive.middles for drive in used]).mean(axis=0)
    begin = start_at(start, centre)
    turn = turn_of(drives)
    least = MATCHED_ROWS if any(drive.window_rad for drive in drives) else HELD_ROWS
    most = max(FINE_ROWS // len(drives), least)
    fine, coarse = ([drive.thinned(rows) for drive in drives] for rows in (most, COARSE_ROWS // len(drives)))
    thinned = Problem(coarse, begin, centre, settings, turn, stations)
    best = thinned.at_rest(offsets) if close else thinned.best_of(_starts(thinned, offsets, SHIFTS_M))
    given = settings
    rivals: tuple[Rival, ...] = ()
    if mistakes:
        best, settings, rivals = likely_mistakes(thinned, best)
    problem = Problem(fine, begin, centre, settings, turn, stations)
    solved, rotation, probability = problem.solve(best, COMPARED if turn.possible else CONVERGED), 0.0, 1.0
    if turn.possible:
        turned, settings = turns_of(problem, solved, unset=mistakes)
        likeliest = max(turned, key=lambda estimate: estimate.log_probability)
        rotation = likeliest.turn
        problem = problem.expecting(settings, Turn(rotation, FIXED))
        solved, probability = among(turned, likeliest, problem.solve(likeliest.x))
    clocks_s = clock_sigmas_s(drives, given.clock_sigma_s, rotation)
    expected = [np.append(clock_s, m.prior.sigmas[1:]) for clock_s, m in zip(clocks_s, thinned.models, strict=True)]
    optics = _optics(solved) if settings.optics_sigma >= WRONG_OPTICS else ()
    # A rival that was accepted in the end is in the estimate.
    by_sensor = optics or settings.apart_sigma_s > given.apart_sigma_s
    unset = settings.clock_sigma_s == given.clock_sigma_s and (settings is given or by_sensor)
    rivals = tuple(rival for rival in rivals if (unset if rival.clock else not optics))
    points = sum(fitness.rows for fitness in solved.fitness)
    return JointFit(
        match=_match(solved, centre),
        time_offsets_s=tuple(solved.x[problem.clocks].tolist()),
        covariance=_with_rivals(solved.covariance[:3, :3], solved.x, rivals),
        centre_level=centre,
        time_sigmas_s=tuple(np.sqrt(np.diag(solved.covariance)[problem.clocks]).tolist()),
        corrections=tuple(
            tuple(replace(each, sigma=float(sigma)) for each, sigma in zip(corrections, sigmas, strict=True))
            for (_, corrections), sigmas in zip(problem.corrections(solved), expected, strict=True)
        ),
        residual_rms_m=_residual_rms_m(solved),
        frames=sum(fitness.frames for fitness in solved.fitness),
        explained=sum(fitness.explained for fitness in solved.fitness) / max(1, points),
        bodies=tuple(model.body(solved.x[own]) for model, own in zip(problem.models, problem.own, strict=True)),
        turn=rotation,
        turn_probability=probability,
        standing=sum(map(len, drives)) - sum(map(len, fine)),
        optics=optics,
        apart=_apart(solved, settings) if settings.apart_sigma_s > JointSettings.apart_sigma_s else None,
        settings=settings,
        perhaps_unset=next((rival.clock for rival in rivals if rival.clock), None),
        perhaps_optics=any(rival.clock is None for rival in rivals),
        nearer=_nearer(solved, drives, settings),
        drives=tuple(fine),
        by_prior=solved.by_prior,
    )


@dataclass(frozen=True)
class RoughFit:
    """An estimate from some points of one drive, and what it says about the errors of the messages' positions.

    Attributes
    ----------
    match : PlanarMatch
        Transform from the level frame to the world frame.
    corrections : tuple of Correction
        Corrections to the messages.
    knots_s : ndarray, shape (k,)
        Times of the knots of the position errors.
    information : ndarray, shape (2 k, 2 k)
        Information of the points about the position errors at the knots, all x first, then all y, without their prior.
        A rigid motion of the whole drive remains undetermined.
    pull : ndarray, shape (2 k,)
        The information times the estimated errors.
    """

    match: PlanarMatch
    corrections: tuple[Correction, ...]
    knots_s: FloatArray
    information: FloatArray
    pull: FloatArray


def fit_roughly(drive: Evidence, start: PlanarMatch, time_offset_s: float, settings: JointSettings) -> RoughFit:
    """Return the estimate of `fit_jointly` for one drive from a subset of its points and few starts.

    It takes a tenth of the time. Parameters and errors are those of `fit_jointly`.
    """
    if not len(drive):
        raise MatchError("0 points of the vehicle while its CAMs report its position; needed are some in 10 frames")
    centre = drive.middles.mean(axis=0)
    begin, turn = start_at(start, centre), turn_of([drive])
    problem = Problem([drive.thinned(ROUGH_ROWS)], begin, centre, settings, turn)
    solved = problem.solve(problem.best_of(_starts(problem, [time_offset_s], [(0.0, 0.0)])))
    (model,), (own,) = problem.models, problem.own
    knots = slice(own.stop - 2 * len(model.knots), own.stop)
    prior = np.asarray(np.linalg.inv(np.kron(np.eye(2), model.prior.drift)), dtype=np.float64)
    posterior = np.asarray(np.linalg.inv(solved.covariance[knots, knots]), dtype=np.float64)
    information, pull = without_prior(posterior - prior, posterior @ solved.x[knots])
    return RoughFit(
        match=_match(solved, centre),
        corrections=model.prior.corrections(solved.x[own], solved.covariance[own, own]),
        knots_s=model.knots.at_s,
        information=information,
        pull=pull,
    )


def start_at(start: PlanarMatch, centre: FloatArray) -> FloatArray:
    """Return the first parameters at a start: yaw, x and y of ``centre``, and range bias."""
    return np.array([start.yaw_rad, *start(centre[None])[0], 0.0])


def _starts(problem: Problem, offsets: Sequence[float], shifts_m: Sequence[tuple[float, float]]) -> list[FloatArray]:
    """Return starts around the first one: rotated, and shifted along the axes of the world frame."""
    found = []
    for turn_deg, shift in product(START_YAWS_DEG, shifts_m):
        x = problem.at_rest(offsets)
        x[0] += np.radians(turn_deg)
        x[1:3] += shift
        found.append(x)
    return found


def _match(solved: Solved, centre: FloatArray) -> PlanarMatch:
    yaw = float(wrap(solved.x[0]))
    return PlanarMatch(yaw, solved.x[1:3] - rotate_xy(yaw, centre))


def _with_rivals(covariance: FloatArray, x: FloatArray, rivals: Sequence[Rival]) -> FloatArray:
    """Return the covariance of yaw and position, shape (3, 3), where another estimate is as likely.

    Errors of points are correlated in ways that no model knows all of, so that likelihoods do not tell two hypotheses
    apart which both explain the points clearly better than none: each has a probability of one half.
    """
    widened: FloatArray = covariance.copy()
    for rival in rivals:
        off = rival.x[:3] - x[:3]
        off[0] = wrap(off[0])
        widened += np.outer(off, off) / 2.0
    return widened


def _optics(solved: Solved) -> tuple[Correction, ...]:
    """Return the corrections of depths and breadths."""
    by = np.array([[1.0, 1.0], [0.0, 1.0]])  # depths by focal length and baseline, breadths by the latter
    values, after = by @ solved.x[BY_OPTICS], np.sqrt(np.diag(by @ solved.covariance[BY_OPTICS, BY_OPTICS] @ by.T))
    return tuple(
        Correction(what, float(value), WRONG_OPTICS, float(left))
        for what, value, left in zip(OPTICS, values, after, strict=True)
    )


def _apart(solved: Solved, settings: JointSettings) -> Correction:
    """Return the time from the left to the right images."""
    after = float(np.sqrt(solved.covariance[APART, APART]))
    return Correction("apart", float(solved.x[APART]), settings.apart_sigma_s, after)


def _nearer(solved: Solved, drives: Sequence[Evidence], settings: JointSettings) -> Correction | None:
    """Return the correction of inverse distances: the part that the noise of all points shares, for a typical point.

    The noise of a distance r is r^2 times that of its inverse, which is proportional to the disparity.
    """
    noise_per_m = [
        drive.sigma_along_m / (ground_m * np.hypot(ground_m, drive.height_m - drive.points[:, 2]))
        for drive in drives
        if drive.window_rad
        for ground_m in [np.linalg.norm(drive.points[:, :2], axis=1)]
    ]
    if not noise_per_m:
        return None
    scale = float(np.median(np.concatenate(noise_per_m)))
    after = float(np.sqrt(solved.covariance[BIAS, BIAS]))
    return Correction("nearer", scale * float(solved.x[BIAS]), scale * settings.bias_noise_share, scale * after)


def _residual_rms_m(solved: Solved) -> float:
    squares = sum(fitness.squares for fitness in solved.fitness)
    return float(np.sqrt(squares / max(sum(fitness.weight for fitness in solved.fitness), 1e-9)))
