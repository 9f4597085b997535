"""The default estimator: registers the visible outline on the vehicle that the messages report, in all frames at once.

One maximum-a-posteriori estimate solves for yaw, position and the sensor's systematic errors together with each drive's
own parameters (`drive_prior`): Gauss-Newton descents from several starts, with a mixture for the noise of each point
(`mixture`). Angles and positions are those of the level frame in the world frame. In what follows a scanner is a LiDAR
and a matcher is the stereo matching, whose points are correlated within its windows; "log" is the natural logarithm.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass, field, replace
from itertools import pairwise, product

import numpy as np
from scipy.linalg import block_diag

from laci_stereo.core.errors import MatchError
from laci_stereo.core.estimation.drive_model import (
    BASELINE,
    BIAS,
    BY_OPTICS,
    FIRST_OWN,
    FOCAL,
    SWEEP,
    Chosen,
    DriveModel,
    Fitness,
    Rows,
)
from laci_stereo.core.estimation.drive_prior import LAG, LASTING, OPTICS, Correction
from laci_stereo.core.estimation.evidence import Evidence
from laci_stereo.core.estimation.recordings import Recordings
from laci_stereo.core.estimation.residual_scatter import Blocks, grown
from laci_stereo.core.frames import FloatArray, IntArray, rotate_xy, wrap
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.settings import UNKNOWN_CLOCK_S, JointSettings, with_turn

SOFTENING_M = (0.8, 0.5, 0.3, 0.2, 0.12, 0.08, 0.05)
"""Standard deviation that is added to the points' noise, in the first iterations: decreasing from more than the error
of a box's centre to about the noise itself."""

FIRST_STEPS, FOLLOWED = 3, 4
"""After the first number of steps a good start is within half a metre of its optimum, so that only the second number of
starts, the best ones, is followed further."""

TOGETHER = 0.1
"""Squared Mahalanobis distance, at the current softening, below which two descents are taken to have reached the same
place: a third of a standard deviation apart, they climb the same hill."""

MAX_ITERATIONS = 40
ROUNDS = 3
SETTLING = 3
"""Number of times that the fractions of the mixture are re-estimated before the first step; otherwise the first step
would only follow the change of the fractions."""

CONVERGED = 1e-4
"""Squared Mahalanobis length of the step at which the iteration ends: a hundredth of the standard deviation that is
reported."""

COMPARED = 1e-2
"""The same limit where only likelihoods are compared, or another descent follows: a tenth of the standard deviation
that is reported."""

START_YAWS_DEG = (-4.0, 0.0, 4.0)
SHIFTS_M = ((0.0, 0.0), (-0.9, -0.9), (-0.9, 0.9), (0.9, -0.9), (0.9, 0.9))
"""Yaw offsets and shifts of the starts around the paper's match: its yaw depends on the last box and is a few degrees
off at most; its position is off by half of the unseen part of the vehicle, which is half a car's width across the car
and somewhat more along it."""

TURNS = {0.0: 0.5, 1.0: 0.25, -1.0: 0.25}
"""A priori probability of each direction in which a scanner without times of the points may rotate: 1 is
counter-clockwise (factor on the delays of a counter-clockwise rotation), -1 clockwise. In half of the cases it does not
rotate (0), or its points were corrected to the scan's stamp before they were written."""

FIXED = 1e-3
"""Standard deviation of the rotation factor (`Turn`) that is taken as known: above 0, so that the equations stay
regular."""

FREE_M = 100.0
"""A priori standard deviation of the position about the start, which only keeps the equations regular."""

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

WRONG_OPTICS = 0.03
"""A priori relative standard deviation of a wrong focal length or baseline: this is the error of a focal length that
was read from another matrix, such as the raw image's, or of a baseline that was measured on the outside of the
camera."""

MISTAKEN, WRONG_HEADING_DEG = 0.02, 10.0
"""A priori probability of a mistake in a sender's set-up, one in fifty, and the standard deviation of its headings
then.

The positions of such a sender may refer to any place on the vehicle, its clock may not be set, and its headings may be
as far off as those of another part of the vehicle, such as a cab in a bend, or as a magnetic compass. One stereo camera
in fifty likewise has the calibration of another camera, or of another mode."""

CLEARLY = float(np.log(10.0))
"""Least log odds for clocks that were never set, where a scanner's rotation is the alternative that explains the same
delays less well."""

LATE = 2.0
"""Clocks whose estimated offset is at most this many standard deviations are taken as synchronised."""

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


@dataclass(frozen=True)
class Turn:
    """A priori knowledge of how a scanner rotates while it takes a scan.

    Attributes
    ----------
    mean, sigma : float
        Mean and standard deviation of the rotation factor, by which the delays of a counter-clockwise rotation are
        multiplied: 1 if it rotates counter-clockwise, -1 clockwise, 0 if it does not rotate or the points' times are
        known.
    """

    mean: float
    sigma: float

    @property
    def possible(self) -> bool:
        """Whether the scanner may rotate."""
        return self.mean != 0.0 or self.sigma > FIXED


NO_TURN, ANY_TURN = Turn(0.0, FIXED), Turn(0.0, 1.0)


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
    settings : JointSettings
        The priors that were used: wider than those given where a mistake was found in the messages or the calibration.
    perhaps_unset : Correction or None
        The clock offset of a drive, if clocks that were never set are more likely than the priors that were used but
        the estimate is not significant.
    nearer : Correction or None
        Correction to be added to all inverse distances of a matcher, 1/m: the error that all disparities share.
    """

    match: PlanarMatch
    time_offsets_s: tuple[float, ...]
    covariance: FloatArray
    centre_level: FloatArray
    time_sigmas_s: tuple[float, ...]
    corrections: tuple[tuple[Correction, ...], ...]
    residual_rms_m: float
    frames: int
    explained: float
    bodies: tuple[VehicleTrack, ...] = ()
    turn: float = 0.0
    turn_probability: float = 1.0
    standing: int = 0
    optics: tuple[Correction, ...] = ()
    settings: JointSettings = field(default_factory=JointSettings)
    perhaps_unset: Correction | None = None
    nearer: Correction | None = None

    def covariance_about(self, place: FloatArray) -> FloatArray:
        """Return the covariance of yaw, x and y, shape (3, 3), about a place of the level frame, shape (2,)."""
        arm = rotate_xy(self.match.yaw_rad, place - self.centre_level)
        moved = np.eye(3)
        moved[1:, 0] = -arm[1], arm[0]
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
    begin = _around(start, centre)
    turn = _turn_of(drives)
    least = MATCHED_ROWS if any(drive.window_rad for drive in drives) else HELD_ROWS
    most = max(FINE_ROWS // len(drives), least)
    fine, coarse = ([drive.thinned(rows) for drive in drives] for rows in (most, COARSE_ROWS // len(drives)))
    thinned = _Problem(coarse, begin, centre, settings, turn, stations)
    best = thinned.at_rest(offsets) if close else thinned.best_of(_starts(thinned, offsets, SHIFTS_M))
    told, perhaps_unset = settings, None
    if mistakes:
        best, settings, perhaps_unset = _mistaken(thinned, best)
    problem = _Problem(fine, begin, centre, settings, turn, stations)
    solved, its_turn, probability = problem.solve(best, COMPARED if turn.possible else CONVERGED), 0.0, 1.0
    if turn.possible:
        turned, settings = _turns_of(problem, solved, unset=mistakes and settings is told)
        likeliest = max(turned, key=lambda each: each.log_probability)
        problem = _Problem(fine, begin, centre, settings, Turn(likeliest.turn, FIXED), stations)
        solved, probability = _among(turned, likeliest, problem.solve(likeliest.x))
        its_turn = likeliest.turn
    clocks_s = _clock_sigmas_s(drives, told.clock_sigma_s, its_turn)
    expected = [np.append(clock_s, m.prior.sigmas[1:]) for clock_s, m in zip(clocks_s, thinned.models, strict=True)]
    standing = sum(map(len, drives)) - sum(map(len, fine))
    fit = _fit(problem, solved, centre, expected)
    optics = _optics(solved) if settings.optics_sigma >= WRONG_OPTICS else ()
    return replace(
        fit,
        optics=optics,
        turn=its_turn,
        turn_probability=probability,
        standing=standing,
        settings=settings,
        perhaps_unset=perhaps_unset if settings is told else None,
        nearer=_nearer(solved, drives, settings),
    )


@dataclass(frozen=True)
class _Mistake:
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
    """

    what: frozenset[str]
    settings: JointSettings
    log_wider: float = 0.0
    alone: bool = False


def _mistaken(problem: _Problem, x: FloatArray) -> tuple[FloatArray, JointSettings, Correction | None]:
    """Return the start, the priors, and a possible clock offset under the most likely mistake that is significant.

    Start and priors are those given where no mistake is significant and more likely than none. The clock offset is that
    of clocks which were perhaps never set: with log odds above `CLEARLY`, whether it is significant or not; else None.
    """
    here = problem.solve(x, COMPARED)
    settings, most_likelier, perhaps_unset = problem.settings, 0.0, None
    for mistake in _mistakes(problem, here):
        wider = problem.expecting(mistake.settings)
        there = wider.solve(here.x, COMPARED)
        surely, unset = wider.tells(there, mistake), None
        if "clock" in mistake.what and wider.only(there, mistake.what):
            unset = wider.late(there, problem.settings.clock_sigma_s)
        if not (surely or unset):
            continue
        log_prior = float(np.log(MISTAKEN)) - mistake.log_wider + wider.log_room_of(there) - problem.log_room_of(here)
        likelier = log_prior + _likelier_by(problem, here, wider, there)
        if unset and likelier > CLEARLY:
            perhaps_unset = unset
        if surely and likelier > most_likelier:
            most_likelier, x, settings = likelier, there.x, mistake.settings
    return x, settings, perhaps_unset


def _mistakes(problem: _Problem, solved: _Solved) -> list[_Mistake]:
    """Return the hypotheses of mistakes that the drives could reveal.

    These are: headings that are not those of the drive; headings that are older than the positions beside them, or a
    reference point at another place on the vehicle than was reported, both of which only a turn determines; another
    focal length or baseline of a stereo camera; and a clock that was never set, if some clocks seem to be apart or
    could not seem so. Small errors of many other parameters are a more likely explanation the smaller a mistake is;
    from such a solution the path to the mistake leads downhill, so that a descent from there finds it.
    """
    settings, drives = problem.settings, [model.drive for model in problem.models]
    senders = len(set(problem.recordings.stations))
    heading = replace(settings, heading_sigma_deg=WRONG_HEADING_DEG)
    wider = heading.heading_sigma_deg / settings.heading_sigma_deg
    likely = [_Mistake(frozenset({"heading"}), heading, senders * np.log(wider))]
    if any(_turned_rad(drive) > TURNED_RAD for drive in drives):
        place = replace(settings, lever_sigma_m=max(drive.vehicle.length_m for drive in drives) / 2)
        wider = place.lever_sigma_m / settings.lever_sigma_m
        likely.append(_Mistake(frozenset({"ahead", "left"}), place, 2 * senders * np.log(wider)))
        likely.append(_Mistake(frozenset({"lag"}), replace(settings, heading_lag_s=LAGGING_S)))
    # Where all disparities may be off, as after one camera has rotated relative to the other, a wrong focal length or
    # baseline would only seem to be found.
    if any(drive.window_rad for drive in drives) and settings.bias_noise_share <= JointSettings.bias_noise_share:
        optics = replace(settings, optics_sigma=WRONG_OPTICS)
        likely.append(_Mistake(frozenset(OPTICS), optics))
    apart_s = float(np.abs(solved.x[problem.clocks]).max())
    # The variance of a detector's boxes is estimated from their dispersion, to which a wrong clock adds: an estimate
    # that takes the clocks as synchronised never seems to contradict that.
    boxes = not any(len(drive.points) for drive in drives)
    if not problem.turn.possible and (boxes or apart_s > LATE * settings.clock_sigma_s):
        unset = replace(settings, clock_sigma_s=UNKNOWN_CLOCK_S)
        wider = unset.clock_sigma_s / settings.clock_sigma_s
        likely.append(_Mistake(frozenset({"clock"}), unset, len(drives) * np.log(wider), alone=True))
    return likely


def _likelier_by(one: _Problem, solved: _Solved, other: _Problem, its: _Solved) -> float:
    """Return the log-likelihood ratio of the points under another solution over one solution.

    The two solutions select different points, as different lines of sight meet an upright part of the outline. For the
    selection of each solution, the points that both can place are compared; the result is the mean of the two.
    """
    gains = []
    for chosen in (solved.chosen, its.chosen):
        here, there = one.rows_at(solved.x, chosen), other.rows_at(its.x, chosen)
        for i, (before, after) in enumerate(zip(here, there, strict=True)):
            _, mine, others = np.intersect1d(before.point, after.point, assume_unique=True, return_indices=True)
            gains.append(other.settled(i, its, after[others]) - one.settled(i, solved, before[mine]))
    return sum(gains) / 2


def _turned_rad(drive: Evidence) -> float:
    _, yaw, known = drive.vehicle.at(drive.stamps_s)
    return float(np.ptp(yaw[known])) if known.any() else 0.0


def _turn_of(drives: Sequence[Evidence]) -> Turn:
    return ANY_TURN if any(drive.turn_s for drive in drives) else NO_TURN


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


def fit_roughly(
    drive: Evidence, start: PlanarMatch, time_offset_s: float = 0.0, settings: JointSettings | None = None
) -> RoughFit:
    """Return the estimate of `fit_jointly` for one drive from a subset of its points and few starts.

    It takes a tenth of the time. Parameters and errors are those of `fit_jointly`.
    """
    if not len(drive):
        raise MatchError("0 points of the vehicle while its CAMs report its position; needed are some in 10 frames")
    centre = drive.middles.mean(axis=0)
    settings, turn = settings or JointSettings(), _turn_of([drive])
    problem = _Problem([drive.thinned(ROUGH_ROWS)], _around(start, centre), centre, settings, turn)
    solved = problem.solve(problem.best_of(_starts(problem, [time_offset_s], [(0.0, 0.0)])))
    (model,), (own,) = problem.models, problem.own
    at, prior = slice(own.stop - 2 * len(model.knots_s), own.stop), np.kron(np.eye(2), model.prior.drift)
    after = np.linalg.inv(solved.covariance[at, at])
    # Where the residuals are more dispersed than the model expects, the difference can have negative eigenvalues.
    values, vectors = np.linalg.eigh(after - np.linalg.inv(prior))
    told = vectors[:, values > 0.0]
    return RoughFit(
        match=_match(solved, centre),
        corrections=model.prior.corrections(solved.x[own], solved.covariance[own, own]),
        knots_s=model.knots_s,
        information=(vectors * np.maximum(values, 0.0)) @ vectors.T,
        pull=told @ (told.T @ (after @ solved.x[at])),
    )


def _around(start: PlanarMatch, centre: FloatArray) -> FloatArray:
    return np.array([start.yaw_rad, *start(centre[None])[0], 0.0])


def _starts(problem: _Problem, offsets: Sequence[float], shifts_m: Sequence[tuple[float, float]]) -> list[FloatArray]:
    """Return starts around the first one: rotated, and shifted along the axes of the world frame."""
    found = []
    for turn_deg, shift in product(START_YAWS_DEG, shifts_m):
        x = problem.at_rest(offsets)
        x[0] += np.radians(turn_deg)
        x[1:3] += shift
        found.append(x)
    return found


@dataclass(frozen=True)
class _Solved:
    x: FloatArray
    covariance: FloatArray
    fitness: tuple[Fitness, ...]
    own: tuple[slice, ...]
    chosen: tuple[Chosen, ...]


@dataclass(frozen=True)
class _Descent:
    """The place that the descent from a start has reached, the distances there, and the results of its last step.

    ``log_likely`` is the log-posterior of the place at the softening of that step.
    """

    x: FloatArray
    rows: Sequence[Rows]
    shares: Sequence[FloatArray]
    curvature: FloatArray
    log_likely: float


class _Problem:
    """The models of all drives over one parameter vector: the sensor's parameters, followed by each drive's own.

    The sensor's are yaw, x, y, range bias, rotation of a scanner, focal length and baseline, see `drive_model`.
    """

    def __init__(
        self,
        drives: Sequence[Evidence],
        begin: FloatArray,
        centre: FloatArray,
        settings: JointSettings,
        turn: Turn,
        stations: Sequence[int] | None = None,
    ) -> None:
        self.settings, self.turn = settings, turn
        self._given = drives, begin, centre, stations
        self.models = [DriveModel(drive, centre, settings, turns=turn.possible) for drive in drives]
        self.recordings = Recordings(self.models, stations)
        ends = FIRST_OWN + np.cumsum([0, *(len(model.prior.mean) for model in self.models)])
        self.own = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        self.size = int(ends[-1])
        self.clocks = [own.start for own in self.own]
        # The knots of the position errors are each drive's last parameters: all x first, then all y.
        lasts = [(own.stop, len(model.knots_s)) for model, own in zip(self.models, self.own, strict=True)]
        self.knots = [np.concatenate([end - after * n + np.arange(n) for end, n in lasts]) for after in (2, 1)]
        self.drifts = self.recordings.drifts(settings)
        self.senders = np.linalg.inv(self.recordings.senders)
        # Yaw and position are practically free; the range bias is the error that the noise of all points shares.
        self.precision = np.zeros((self.size, self.size))
        first = [1.0, FREE_M**-2, FREE_M**-2, settings.bias_noise_share**-2, turn.sigma**-2]
        first += [settings.optics_sigma**-2] * 2
        self.precision[range(FIRST_OWN), range(FIRST_OWN)] = first
        self.mean = np.concatenate([begin, [turn.mean, 0.0, 0.0], *(model.prior.mean for model in self.models)])
        self.loosen(None)

    def expecting(self, settings: JointSettings) -> _Problem:
        """Return the same problem with other priors."""
        drives, begin, centre, stations = self._given
        return _Problem(drives, begin, centre, settings, self.turn, stations)

    def loosen(self, x: FloatArray | None) -> None:
        """Set the precision of the priors for the drives' own parameters at ``x``, which their heavy tails depend on.

        Without ``x``, it is that at the mean.
        """
        for model, own in zip(self.models, self.own, strict=True):
            self.precision[own, own] = model.prior.precision(None if x is None else x[own])
        clocks = np.ix_(self.clocks, self.clocks)
        self.precision[clocks] = self.recordings.clocks(np.diag(self.precision[clocks]))
        for knots in self.knots:
            self.precision[np.ix_(knots, knots)] = self.drifts
        # With a square root of each drive's precision, any two drives are correlated as `Recordings.senders` says.
        lasting = [own.start + np.array(LASTING) for own in self.own]
        roots = [np.linalg.cholesky(self.precision[np.ix_(its, its)]).T for its in lasting]
        for (i, one), (j, other) in product(enumerate(lasting), repeat=2):
            self.precision[np.ix_(one, other)] = self.senders[i, j] * roots[i].T @ roots[j]

    def at_rest(self, offsets: Sequence[float]) -> FloatArray:
        """Return the vector with every parameter at its prior mean, except the clock offsets."""
        x: FloatArray = self.mean.copy()
        x[self.clocks] = offsets
        return x

    def best_of(self, starts: Sequence[FloatArray]) -> FloatArray:
        """Descend from rough starts with decreasing softening, and return the most likely end; only the best are kept.

        Starts that reach the same place continue as one.
        """
        found = [_Descent(x, self.rows_at(x), self._first_shares(), self.precision, -np.inf) for x in starts]
        for soft in SOFTENING_M[:FIRST_STEPS]:
            found = self._apart(self._step(each, soft) for each in found)
        found = [replace(each, shares=self._first_shares()) for each in found[:FOLLOWED]]
        for soft in SOFTENING_M[FIRST_STEPS:]:
            found = self._apart(self._step(each, soft) for each in found)
        return found[0].x

    def _first_shares(self) -> list[FloatArray]:
        return [model.shares() for model in self.models]

    def _step(self, at: _Descent, softening_m: float) -> _Descent:
        """Take a step at this softening, and return the place reached with its log-posterior."""
        curvature, gradient, fitness = self._sum(at.x, at.rows, softening_m, at.shares)
        x = at.x - np.linalg.solve(curvature, gradient)
        rows, shares = self.rows_at(x), [each.shares for each in fitness]
        likely = sum(each.log_likelihood for each in self._sum(x, rows, softening_m, shares)[2])
        return _Descent(x, rows, shares, curvature, likely + self._log_prior(x))

    @staticmethod
    def _apart(found: Iterable[_Descent]) -> list[_Descent]:
        """Return the most likely descent at each place, in descending order of their log-posteriors."""
        kept: list[_Descent] = []
        for each in sorted(found, key=lambda descent: -descent.log_likely):
            if all((each.x - other.x) @ other.curvature @ (each.x - other.x) > TOGETHER for other in kept):
                kept.append(each)
        return kept

    def settled(self, drive: int, solved: _Solved, rows: Rows) -> float:
        """Return the log-likelihood of some points of a drive, with the fractions of the mixture that fit them."""
        model, fitness = self.models[drive], solved.fitness[drive]
        for _ in range(SETTLING):
            fitness = model.weigh(rows, 0.0, fitness.shares)
        return fitness.log_likelihood

    def log_room_of(self, solved: _Solved) -> float:
        """Return the log prior density of the solution, plus a log ratio of posterior to prior volume.

        The volume is that of focal length, baseline and the lags of headings, which are exact unless a hypothesis says
        otherwise. The prior volume of other mistakes is in `_Mistake.log_wider`: their posterior volumes are far
        smaller than the prior ones.
        """
        self.loosen(solved.x)
        exact = np.array([FOCAL, BASELINE, *(own.start + LAG for own in self.own)])
        before, after = np.linalg.inv(self.precision), solved.covariance
        volumes = [np.linalg.slogdet(each[np.ix_(exact, exact)])[1] / 2 for each in (after, before)]
        return self._log_prior(solved.x) + float(volumes[0] - volumes[1])

    def tells(self, solved: _Solved, mistake: _Mistake) -> bool:
        """Tell whether a correction of this mistake is significant."""
        if mistake.alone and not self.only(solved, mistake.what):
            return False
        if mistake.what.issuperset(OPTICS):  # both together: a wrong baseline affects both
            found, covariance = solved.x[BY_OPTICS], solved.covariance[BY_OPTICS, BY_OPTICS]
            return float(found @ np.linalg.solve(covariance, found)) > SURELY**2
        return any(
            each.what in mistake.what and abs(each.value) > SURELY * each.after
            for model, its in self.corrections(solved)
            if not mistake.what & IN_TURNS or _turned_rad(model.drive) > TURNED_RAD
            for each in its
        )

    def late(self, solved: _Solved, known_s: float) -> Correction | None:
        """Return a drive's clock offset that exceeds both its prior and its posterior uncertainty by far, or None."""
        clocks = (each for _, its in self.corrections(solved) for each in its if each.what == "clock")
        return next((each for each in clocks if abs(each.value) > LATE * max(known_s, each.after)), None)

    def only(self, solved: _Solved, what: Set[str]) -> bool:
        """Tell whether all corrections but these agree with their priors."""
        return all(
            each.surprise <= SURELY for _, its in self.corrections(solved) for each in its if each.what not in what
        )

    def corrections(self, solved: _Solved) -> list[tuple[DriveModel, tuple[Correction, ...]]]:
        """Return each drive's model, with the corrections to its messages."""
        return [
            (model, model.prior.corrections(solved.x[own], solved.covariance[own, own]))
            for model, own in zip(self.models, solved.own, strict=True)
        ]

    def solve(self, x: FloatArray, converged: float = CONVERGED) -> _Solved:
        """Descend from a nearby start to the optimum; after each descent the points on the wall are selected again."""
        shares: Sequence[FloatArray] = self._first_shares()
        for _ in range(ROUNDS):
            chosen = [model.choose(x[own]) for model, own in zip(self.models, self._places(), strict=True)]
            rows: Sequence[Rows] = self.rows_at(x, chosen)
            for _ in range(SETTLING):
                shares = [each.shares for each in self._sum(x, rows, 0.0, shares)[2]]
            before = x
            x, rows, shares = self._climb(x, rows, shares, chosen, converged)
            fitness = self._sum(x, rows, 0.0, shares)[2]
            information = self._with_prior([each.information for each in fitness])
            if (x - before) @ information @ (x - before) < converged:
                break
        inverse = np.asarray(np.linalg.inv(information), dtype=np.float64)
        covariance = self._covariance(inverse, fitness, rows)
        return _Solved(x, covariance, tuple(fitness), tuple(self.own), tuple(chosen))

    def _climb(
        self,
        x: FloatArray,
        rows: Sequence[Rows],
        shares: Sequence[FloatArray],
        chosen: Sequence[Chosen],
        converged: float,
    ) -> tuple[FloatArray, Sequence[Rows], Sequence[FloatArray]]:
        """Return the optimum near a start, with the distances and the fractions of the mixture there.

        Points near corners change sides, beyond which the quadratic model of a step is not valid; a step that leads to
        a less likely place is therefore shortened.
        """
        pace = 1.0
        for _ in range(MAX_ITERATIONS):
            self.loosen(x)
            curvature, gradient, fitness = self._sum(x, rows, 0.0, shares)
            step = np.linalg.solve(curvature, gradient)
            size = float(step @ curvature @ step)
            while pace**2 * size >= converged:
                there = self.rows_at(x - pace * step, chosen)
                if self._gain(x - pace * step, there, x, rows, fitness, shares) > 0.0:
                    break
                pace /= 4.0
            else:
                break
            x, rows, shares = x - pace * step, there, [each.shares for each in fitness]
            pace = min(1.0, 2.0 * pace)
        return x, rows, shares

    def _gain(
        self,
        x: FloatArray,
        rows: Sequence[Rows],
        before: FloatArray,
        held: Sequence[Rows],
        fitness: Sequence[Fitness],
        shares: Sequence[FloatArray],
    ) -> float:
        """Return the gain in log-posterior of a place over the one before."""
        drives = zip(self.models, rows, held, fitness, shares, strict=True)
        points = sum(
            model.gain(its, as_were, fits.log_likelihoods, share) for model, its, as_were, fits, share in drives
        )
        return points + self._log_prior(x) - self._log_prior(before)

    def _log_prior(self, x: FloatArray) -> float:
        away = x - self.mean
        return -float(away @ self.precision @ away) / 2

    def _places(self) -> list[IntArray]:
        """Return the indices of each drive's parameters in the vector: the sensor's, then the drive's own."""
        return [np.r_[:FIRST_OWN, own] for own in self.own]

    def rows_at(self, x: FloatArray, chosen: Sequence[Chosen] | None = None) -> list[Rows]:
        each_chosen: Sequence[Chosen | None] = chosen or [None] * len(self.models)
        each = zip(self.models, self._places(), each_chosen, strict=True)
        return [model.rows(x[index], some) for model, index, some in each]

    def _sum(
        self, x: FloatArray, rows: Sequence[Rows], soft: float, shares: Sequence[FloatArray]
    ) -> tuple[FloatArray, FloatArray, list[Fitness]]:
        """Return curvature and gradient of the negative log-posterior, and the fitness of each drive."""
        gradient = self.precision @ (x - self.mean)
        fitness = []
        for model, index, its, share in zip(self.models, self._places(), rows, shares, strict=True):
            each = model.weigh(its, soft, share)
            gradient[index] += each.gradient
            fitness.append(each)
        return self._with_prior([each.curvature for each in fitness]), gradient, fitness

    def _with_prior(self, parts: Sequence[FloatArray]) -> FloatArray:
        """Return the sum of the priors' precision and each drive's information or curvature."""
        total: FloatArray = self.precision + self._sum_of(parts)
        return total

    def _sum_of(self, parts: Iterable[FloatArray]) -> FloatArray:
        """Return the sum of square matrices, one per drive, over the sensor's parameters and the drive's own."""
        total = np.zeros_like(self.precision)
        for part, index in zip(parts, self._places(), strict=True):
            total[np.ix_(index, index)] += part
        return total

    def _covariance(self, inverse: FloatArray, fitness: Sequence[Fitness], rows: Sequence[Rows]) -> FloatArray:
        """Return the covariance of all parameters, at least as large as the dispersion of the residuals implies.

        Where the residuals of successive frames agree more than the model expects, the covariance grows in that
        direction. It also includes the errors that persist from frame to frame, which the estimate may have followed
        throughout.
        """
        parts = [Blocks(index, *each.by_block()) for index, each in zip(self._places(), fitness, strict=True)]
        lasting = self._sum_of(
            model.lasting(its, each) for model, its, each in zip(self.models, rows, fitness, strict=True)
        )
        return grown(inverse, self.precision, parts) + inverse @ lasting @ inverse


@dataclass(frozen=True)
class _Turned:
    """The estimate of all parameters for one rotation of the scanner, and the log-evidence of that rotation."""

    turn: float
    x: FloatArray
    covariance: FloatArray
    log_probability: float


def _turns_of(problem: _Problem, solved: _Solved, *, unset: bool) -> tuple[list[_Turned], JointSettings]:
    """Condition the solution on each rotation, and return the priors: with unknown clocks if these were never set.

    Parameters
    ----------
    problem : _Problem
    solved : _Solved
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
        likeliest = max(by_free, key=lambda each: each.log_probability)
        if problem.only(replace(solved, x=likeliest.x, covariance=likeliest.covariance), {"clock"}):
            return by_free, free
    return by_any, settings


def _turned(problem: _Problem, solved: _Solved, turn: float, known_s: float) -> _Turned:
    """Condition the solution, in which the rotation has a normal prior, on one rotation and on the prior of the clocks.

    The likelihood of rotation and clock offsets is the posterior divided by the prior; the evidence of a rotation is
    the mean of that likelihood over the prior of rotation and clock offsets.
    """
    index = np.array([SWEEP, *problem.clocks])
    covariance = solved.covariance[np.ix_(index, index)]
    before, found = problem.precision[np.ix_(index, index)], np.linalg.inv(covariance)
    # Where the residuals are more dispersed than the model expects, the difference can have negative eigenvalues.
    values, vectors = np.linalg.eigh(found - before)
    information = (vectors * np.maximum(values, 0.0)) @ vectors.T
    told = vectors[:, values > 0.0]
    pull = told @ (told.T @ (found @ solved.x[index] - before @ problem.mean[index]))
    clocks = _clock_sigmas_s([model.drive for model in problem.models], known_s, turn)
    prior = block_diag(FIXED**-2.0, problem.recordings.clocks(np.array(clocks) ** -2.0))
    mean = np.array([turn, *np.zeros(len(clocks))])
    after, sum_pull = prior + information, prior @ mean + pull
    at = np.linalg.solve(after, sum_pull)
    evidence = (sum_pull @ at - mean @ prior @ mean + np.linalg.slogdet(prior)[1] - np.linalg.slogdet(after)[1]) / 2
    gain = np.linalg.solve(covariance, solved.covariance[index]).T
    x = solved.x + gain @ (at - solved.x[index])
    left = solved.covariance + gain @ (np.linalg.inv(after) - covariance) @ gain.T
    return _Turned(turn, x, left, float(evidence + np.log(TURNS[turn])))


def _clock_sigmas_s(drives: Sequence[Evidence], known_s: float, turn: float) -> list[float]:
    """Return the prior standard deviation of each drive's clock offset for this rotation of the scanner."""
    return [with_turn(known_s, drive.turn_s) if turn else known_s for drive in drives]


def _log_sum(turned: Sequence[_Turned]) -> float:
    """Return the log of the sum of the evidence of several rotations."""
    return float(np.logaddexp.reduce([each.log_probability for each in turned]))


def _among(turned: Sequence[_Turned], likeliest: _Turned, solved: _Solved) -> tuple[_Solved, float]:
    """Return the solution for the most likely rotation, with the covariance of the mixture of all, and its probability.

    The covariance includes the other rotations' covariances and their differences, weighted by their probabilities.
    """
    log_sum = _log_sum(turned)
    probabilities = np.exp([each.log_probability - log_sum for each in turned])
    off = np.array([each.x - likeliest.x for each in turned])
    within = [solved.covariance if each is likeliest else each.covariance for each in turned]
    covariance = np.tensordot(probabilities, within, 1) + (off.T * probabilities) @ off
    return replace(solved, covariance=covariance), float(probabilities.max())


def _match(solved: _Solved, centre: FloatArray) -> PlanarMatch:
    yaw = float(wrap(solved.x[0]))
    return PlanarMatch(yaw, solved.x[1:3] - rotate_xy(yaw, centre))


def _optics(solved: _Solved) -> tuple[Correction, ...]:
    """Return the corrections of depths and breadths."""
    by = np.array([[1.0, 1.0], [0.0, 1.0]])  # depths by focal length and baseline, breadths by the latter
    values, after = by @ solved.x[BY_OPTICS], np.sqrt(np.diag(by @ solved.covariance[BY_OPTICS, BY_OPTICS] @ by.T))
    return tuple(
        Correction(what, float(value), WRONG_OPTICS, float(left))
        for what, value, left in zip(OPTICS, values, after, strict=True)
    )


def _nearer(solved: _Solved, drives: Sequence[Evidence], settings: JointSettings) -> Correction | None:
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


def _fit(problem: _Problem, solved: _Solved, centre: FloatArray, expected: Sequence[FloatArray]) -> JointFit:
    weights = sum(each.weight for each in solved.fitness)
    squares = sum(each.squares for each in solved.fitness)
    after = np.sqrt(np.diag(solved.covariance))
    return JointFit(
        match=_match(solved, centre),
        time_offsets_s=tuple(float(solved.x[own.start]) for own in solved.own),
        covariance=solved.covariance[:3, :3],
        centre_level=centre,
        time_sigmas_s=tuple(float(after[own.start]) for own in solved.own),
        corrections=tuple(
            tuple(replace(each, sigma=float(sigma)) for each, sigma in zip(its, sigmas, strict=True))
            for (_, its), sigmas in zip(problem.corrections(solved), expected, strict=True)
        ),
        residual_rms_m=float(np.sqrt(squares / max(weights, 1e-9))),
        frames=sum(each.frames for each in solved.fitness),
        explained=sum(each.explained for each in solved.fitness) / max(1, sum(each.rows for each in solved.fitness)),
        bodies=tuple(model.body(solved.x[own]) for model, own in zip(problem.models, solved.own, strict=True)),
    )
