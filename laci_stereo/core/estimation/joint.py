"""The default estimator: the visible outline, registered on the vehicle of the messages in all frames at once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Set
from dataclasses import dataclass, field, replace
from itertools import pairwise, product

import numpy as np
from scipy.linalg import block_diag

from laci_stereo.core.errors import MatchError
from laci_stereo.core.estimation.drive_model import (
    BIAS,
    BY_OPTICS,
    FIRST_OWN,
    SWEEP,
    Chosen,
    DriveModel,
    Fitness,
    Rows,
)
from laci_stereo.core.estimation.drive_prior import LASTING, OPTICS, Correction
from laci_stereo.core.estimation.evidence import Evidence
from laci_stereo.core.estimation.recordings import Recordings
from laci_stereo.core.estimation.residual_scatter import Blocks, grown
from laci_stereo.core.frames import FloatArray, IntArray, rotate_xy, wrap
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.settings import UNKNOWN_CLOCK_S, JointSettings, with_turn

SOFTENING_M = (0.8, 0.5, 0.3, 0.2, 0.12, 0.08, 0.05)
"""Extra standard deviation in the first iterations: from beyond the error of a box's centre down to the noise."""

FIRST_STEPS, FOLLOWED = 3, 4
"""After so many steps a good start is within half a metre, so that the best few of all are followed further."""

TOGETHER = 0.1
"""Squared distance, in standard deviations at that softness, within which two starts have come to one place: by a third
of one they are on the same hill."""

MAX_ITERATIONS = 40
ROUNDS = 3
SETTLING = 3
"""So often the shares of the mixture are taken anew before the first step, which would else be one of the shares."""

CONVERGED = 1e-4
"""Squared step, in standard deviations, at which the iteration ends: a hundredth of the error that is claimed."""

COMPARED = 1e-2
"""The same where only likelihoods are compared, or another descent begins: a tenth of the error that is claimed."""

START_YAWS_DEG = (-4.0, 0.0, 4.0)
SHIFTS_M = ((0.0, 0.0), (-0.9, -0.9), (-0.9, 0.9), (0.9, -0.9), (0.9, 0.9))
"""Starts around the paper's match: its yaw leans on one box and is a few degrees off at most; its position is off by
half of what of the vehicle is not seen, which is half a car's width across and somewhat more along it."""

TURNS = {0.0: 0.5, 1.0: 0.25, -1.0: 0.25}
"""How a scanner that does not tell the points' times turns, counter-clockwise, and how likely that is beforehand: as
often as not it does not turn, or its points were brought to the scan's stamp before they were written."""

FIXED = 1e-3
"""Standard deviation of a turn that is taken for known: it keeps the equations regular."""

FREE_M = 100.0
"""Standard deviation of the position about the start, which only keeps the equations regular."""

COARSE_ROWS, ROUGH_ROWS = 1500, 3000
"""Points that compare the starts, of which a few per frame and side say which is best; and those of a rough estimate,
of which one in ten choices of half as many lost a vehicle among false masks to a stranger."""

FINE_ROWS, MATCHED_ROWS = 40_000, 10_000
"""Points that are registered in the end, of all drives, and of each that a matcher saw at least. What points on one
side of a frame have in common makes any number of them weigh as much as four; but a matcher's windows see of a car only
what they are laid on, and with a quarter of these, which ones moved a result by a third of its doubt."""

HELD_ROWS = 3000
"""Of each that a scanner saw at least; and of what is registered only to hold it against something else, a half of a
drive or one of several."""

WRONG_OPTICS = 0.03
"""By such a share a focal length is off that was read from another matrix, such as the raw image's, or a baseline that
was measured from outside."""

MISTAKEN, WRONG_HEADING_DEG = 0.02, 10.0
"""One sender in fifty is set up wrongly: its positions may then be of any place on the vehicle, its headings as far off
as one that is told of another part of it, such as a cab in a bend, or by a magnet, and its clock not set. So is one
stereo camera in fifty, whose calibration is another's, or another mode's."""

CLEARLY = float(np.log(10.0))
"""Log odds by which clocks were not set, where a scanner that turns would explain the same less well."""

LATE = 2.0
"""Clocks that seem to be no farther apart than so many standard deviations are taken for set."""

SURELY, TURNED_RAD = 4.0, np.radians(30.0)
"""It is so only if what is found is beyond so many of its own standard deviations, of both of the optics together: four
of some fifty calibrations that were right were found to be wrong by three. And where on the vehicle positions are, only
a turn tells, in which half of a length is off by half of that. Straight on the noise of headings looks so."""


@dataclass(frozen=True)
class Turn:
    """What is known beforehand of how a scanner turns while it takes a scan, counter-clockwise.

    Attributes
    ----------
    mean, sigma : float
        In turns per turn of the scanner: 1 where it turns so, 0 where it does not, or the points' times are known.
    """

    mean: float
    sigma: float

    @property
    def possible(self) -> bool:
        """Whether it may turn."""
        return self.mean != 0.0 or self.sigma > FIXED


NO_TURN, ANY_TURN = Turn(0.0, FIXED), Turn(0.0, 1.0)


@dataclass(frozen=True)
class JointFit:
    """The outcome of the joint estimate.

    Attributes
    ----------
    match : PlanarMatch
        From the level into the world frame.
    time_offsets_s : tuple of float
        Of each drive: to be added to the sensor's stamps to get the messages' time.
    covariance : ndarray, shape (3, 3)
        Of (yaw [rad], x, y [m]) of the world, about ``centre_level``.
    centre_level : ndarray, shape (2,)
        The middle of the vehicle's points.
    time_sigmas_s : tuple of float
    corrections : tuple of tuple of Correction
        Of each drive's messages.
    optics : tuple of Correction
        Of a stereo calibration, `OPTICS`, where it was not taken for right.
    residual_rms_m : float
        Of the points that the outline explains.
    frames : int
        That have such points.
    standing : int
        Frames that were left out, since the vehicle stood there in enough others.
    explained : float
        Share of the points that the outline explains, at the surface or behind it.
    bodies : tuple of VehicleTrack
        Of each drive: what its messages tell, with the yaw of the vehicle's body instead of its motion's.
    turn : float
        How the scanner turns while it takes a scan: 1 counter-clockwise, -1 clockwise, 0 not at all or the points'
        times are known.
    turn_probability : float
        Of that, by what the points tell.
    settings : JointSettings
        What was taken as known: less than was given, where messages are mistaken.
    perhaps_unset : Correction or None
        Of a clock, if none was set. That is likelier than what was taken as known, but not sure.
    nearer : Correction or None
        By how much inverse distances, 1/m, are larger than a matcher has it, whose disparities all err alike.
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
        """Return the mean square, shape (2, 2), by which wrong optics lay places of the level frame, (n, 2), wrongly.

        What is measured is laid where it is in the middle only.
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
    """Estimate yaw, position, and of each drive clock offset, shape, gloss, GNSS and heading errors, growth of borders.

    Where a scanner does not tell the points' times, how it turns is estimated too, taken for the likeliest of what it
    can be, and the result is as uncertain as the others are different and likely.

    Parameters
    ----------
    drives : sequence of Evidence
        Of one sensor, in its level frame.
    start : PlanarMatch
        Within some degrees and a vehicle's width.
    time_offsets_s : sequence of float
        Where the search for each drive's clock offset begins; None is 0.
    settings : JointSettings
    stations : sequence of int
        The sender of each drive: what has it in common, and the time at which it was, is in `Recordings`. None: they
        have nothing in common.
    close : bool
        The start is what each of the drives says by itself, within its doubt: no other is tried.
    mistakes : bool
        Messages may be mistaken by more than the settings allow.

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
    """Something that may be wrong by far.

    Attributes
    ----------
    what : frozenset of str
        The corrections that it shows by.
    settings : JointSettings
        What is to be expected then.
    log_wider : float
        By how much more room there is for these corrections then, as a logarithm.
    alone : bool
        It is only if it leaves nothing else that the messages do not allow for.
    """

    what: frozenset[str]
    settings: JointSettings
    log_wider: float = 0.0
    alone: bool = False


def _mistaken(problem: _Problem, x: FloatArray) -> tuple[FloatArray, JointSettings, Correction | None]:
    """Return what is to be expected if something is surely mistaken, and then likeliest, and where the search goes on.

    If nothing is, that is where it began, and what was expected before; and the offset of a clock that is perhaps.
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
    """Return what may be wrong by far.

    Headings are not the drive's, or positions those of another place on the vehicle than was said, which only a turn
    tells; a stereo camera has another focal length or baseline; or a clock was not set, if some seem to be apart or
    would not seem so. To take small errors of much else for it is likelier the nearer it is to none, and downhill from
    there.
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
    # Where disparities may all be off, as by a camera that has turned, other optics would only look so.
    if any(drive.window_rad for drive in drives) and settings.bias_noise_share <= JointSettings.bias_noise_share:
        optics = replace(settings, optics_sigma=WRONG_OPTICS)
        likely.append(_Mistake(frozenset(OPTICS), optics))
    apart_s = float(np.abs(solved.x[problem.clocks]).max())
    # How exact a detector's boxes are is told by how they scatter, to which a clock that is off adds: what is found
    # while clocks are taken for set never seems to contradict that.
    boxes = not any(len(drive.points) for drive in drives)
    if not problem.turn.possible and (boxes or apart_s > LATE * settings.clock_sigma_s):
        unset = replace(settings, clock_sigma_s=UNKNOWN_CLOCK_S)
        wider = unset.clock_sigma_s / settings.clock_sigma_s
        likely.append(_Mistake(frozenset({"clock"}), unset, len(drives) * np.log(wider), alone=True))
    return likely


def _likelier_by(one: _Problem, solved: _Solved, other: _Problem, its: _Solved) -> float:
    """Return by how much likelier the points are by another solution than by one, as a logarithm.

    Which points meet an upright outline is not the same for both: those are compared that both place, of what one of
    them registers and of what the other does, on average.
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
    """What a drive's points tell of what its messages say.

    Attributes
    ----------
    match : PlanarMatch
        From the level into the world frame.
    corrections : tuple of Correction
    knots_s : ndarray, shape (k,)
    information : ndarray, shape (2 k, 2 k)
        Of the errors of the positions at the knots, first of all x, then of all y, whatever was expected of these. A
        motion as a whole is left open.
    pull : ndarray, shape (2 k,)
        The information times the errors that are found.
    """

    match: PlanarMatch
    corrections: tuple[Correction, ...]
    knots_s: FloatArray
    information: FloatArray
    pull: FloatArray


def fit_roughly(
    drive: Evidence, start: PlanarMatch, time_offset_s: float = 0.0, settings: JointSettings | None = None
) -> RoughFit:
    """Estimate the same of one drive from some of its points and few starts, in a tenth of the time.

    Parameters and errors are those of `fit_jointly`.
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
    # Where residuals scatter by more than the model has it, less than nothing would be left.
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
    """Return starts around the first one: turned and shifted along and across the mean direction of view."""
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
    """Where a start has come to: the distances there, and what came out of the step that led there.

    ``log_likely`` is how likely the place is, as a logarithm, at that step's softness.
    """

    x: FloatArray
    rows: Sequence[Rows]
    shares: Sequence[FloatArray]
    curvature: FloatArray
    log_likely: float


class _Problem:
    """All drives' models over one vector: yaw, x, y, range bias and turn of the sensor, then each drive's own."""

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
        # The knots of the positions' errors are each drive's last: first of all x, then of all y.
        lasts = [(own.stop, len(model.knots_s)) for model, own in zip(self.models, self.own, strict=True)]
        self.knots = [np.concatenate([end - after * n + np.arange(n) for end, n in lasts]) for after in (2, 1)]
        self.drifts = self.recordings.drifts(settings)
        self.senders = np.linalg.inv(self.recordings.senders)
        # Yaw and position are as good as free; the range bias is what all points' noise has in common.
        self.precision = np.zeros((self.size, self.size))
        first = [1.0, FREE_M**-2, FREE_M**-2, settings.bias_noise_share**-2, turn.sigma**-2]
        first += [settings.optics_sigma**-2] * 2
        self.precision[range(FIRST_OWN), range(FIRST_OWN)] = first
        self.mean = np.concatenate([begin, [turn.mean, 0.0, 0.0], *(model.prior.mean for model in self.models)])
        self.loosen(None)

    def expecting(self, settings: JointSettings) -> _Problem:
        """Return the same where something else is to be expected."""
        drives, begin, centre, stations = self._given
        return _Problem(drives, begin, centre, settings, self.turn, stations)

    def loosen(self, x: FloatArray | None) -> None:
        """Weigh the priors by how far the drives' own parameters are from them, if these are known."""
        for model, own in zip(self.models, self.own, strict=True):
            self.precision[own, own] = model.prior.precision(None if x is None else x[own])
        clocks = np.ix_(self.clocks, self.clocks)
        self.precision[clocks] = self.recordings.clocks(np.diag(self.precision[clocks]))
        for knots in self.knots:
            self.precision[np.ix_(knots, knots)] = self.drifts
        # A square root of what each drive knows of its sender, so that any two are correlated by as much as is said.
        lasting = [own.start + np.array(LASTING) for own in self.own]
        roots = [np.linalg.cholesky(self.precision[np.ix_(its, its)]).T for its in lasting]
        for (i, one), (j, other) in product(enumerate(lasting), repeat=2):
            self.precision[np.ix_(one, other)] = self.senders[i, j] * roots[i].T @ roots[j]

    def at_rest(self, offsets: Sequence[float]) -> FloatArray:
        """Return the vector with every correction at its prior's mean, but for the clocks."""
        x: FloatArray = self.mean.copy()
        x[self.clocks] = offsets
        return x

    def best_of(self, starts: Sequence[FloatArray]) -> FloatArray:
        """Approach from rough starts, from those that come closest all the way, and return the likeliest end.

        Starts that come together go on as one.
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
        """Take a step at some softness, and tell how likely the place is that is reached."""
        curvature, gradient, fitness = self._sum(at.x, at.rows, softening_m, at.shares)
        x = at.x - np.linalg.solve(curvature, gradient)
        rows, shares = self.rows_at(x), [each.shares for each in fitness]
        likely = sum(each.log_likelihood for each in self._sum(x, rows, softening_m, shares)[2])
        return _Descent(x, rows, shares, curvature, likely + self._log_prior(x))

    @staticmethod
    def _apart(found: Iterable[_Descent]) -> list[_Descent]:
        """Return the likeliest of those that are in one place, the likeliest of all first."""
        kept: list[_Descent] = []
        for each in sorted(found, key=lambda descent: -descent.log_likely):
            if all((each.x - other.x) @ other.curvature @ (each.x - other.x) > TOGETHER for other in kept):
                kept.append(each)
        return kept

    def settled(self, drive: int, solved: _Solved, rows: Rows) -> float:
        """Return how likely some points of a drive are, as a logarithm, with the mixture's shares that suit them."""
        model, fitness = self.models[drive], solved.fitness[drive]
        for _ in range(SETTLING):
            fitness = model.weigh(rows, 0.0, fitness.shares)
        return fitness.log_likelihood

    def log_room_of(self, solved: _Solved) -> float:
        """Return how likely what was found is beforehand, as a logarithm, and how much room it leaves the optics.

        The room of other mistakes is in what `_mistakes` says: what they leave is far less than what was expected.
        """
        self.loosen(solved.x)
        after = np.linalg.slogdet(solved.covariance[BY_OPTICS, BY_OPTICS])[1] / 2
        return self._log_prior(solved.x) + float(after - 2.0 * np.log(self.settings.optics_sigma))

    def tells(self, solved: _Solved, mistake: _Mistake) -> bool:
        """Tell whether some correction is not only possible, but surely there."""
        if mistake.alone and not self.only(solved, mistake.what):
            return False
        if mistake.what.issuperset(OPTICS):  # both together: a wrong baseline shows in both
            found, covariance = solved.x[BY_OPTICS], solved.covariance[BY_OPTICS, BY_OPTICS]
            return float(found @ np.linalg.solve(covariance, found)) > SURELY**2
        return any(
            each.what in mistake.what and abs(each.value) > SURELY * each.after
            for model, its in self.corrections(solved)
            if "ahead" not in mistake.what or _turned_rad(model.drive) > TURNED_RAD
            for each in its
        )

    def late(self, solved: _Solved, known_s: float) -> Correction | None:
        """Return a drive's clock that seems to be off by more than was known of it, and than is known now, if any."""
        clocks = (each for _, its in self.corrections(solved) for each in its if each.what == "clock")
        return next((each for each in clocks if abs(each.value) > LATE * max(known_s, each.after)), None)

    def only(self, solved: _Solved, what: Set[str]) -> bool:
        """Tell whether the messages allow for all corrections but these."""
        return all(
            each.surprise <= SURELY for _, its in self.corrections(solved) for each in its if each.what not in what
        )

    def corrections(self, solved: _Solved) -> list[tuple[DriveModel, tuple[Correction, ...]]]:
        """Return each drive, and by how much its messages had to be corrected."""
        return [
            (model, model.prior.corrections(solved.x[own], solved.covariance[own, own]))
            for model, own in zip(self.models, solved.own, strict=True)
        ]

    def solve(self, x: FloatArray, converged: float = CONVERGED) -> _Solved:
        """Descend to the end from a start nearby; which points are on the wall is told anew after each time."""
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
        """Return the likeliest place near a start, with the distances and the shares there.

        Points at corners change sides, beyond which what a step promises does not hold; so a step that leads to a less
        likely place is shortened.
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
        """Return by how much likelier a place is than the one before."""
        drives = zip(self.models, rows, held, fitness, shares, strict=True)
        points = sum(
            model.gain(its, as_were, fits.log_likelihoods, share) for model, its, as_were, fits, share in drives
        )
        return points + self._log_prior(x) - self._log_prior(before)

    def _log_prior(self, x: FloatArray) -> float:
        away = x - self.mean
        return -float(away @ self.precision @ away) / 2

    def _places(self) -> list[IntArray]:
        """Return where in the vector each drive's parameters are."""
        return [np.r_[:FIRST_OWN, own] for own in self.own]

    def rows_at(self, x: FloatArray, chosen: Sequence[Chosen] | None = None) -> list[Rows]:
        each_chosen: Sequence[Chosen | None] = chosen or [None] * len(self.models)
        each = zip(self.models, self._places(), each_chosen, strict=True)
        return [model.rows(x[index], some) for model, index, some in each]

    def _sum(
        self, x: FloatArray, rows: Sequence[Rows], soft: float, shares: Sequence[FloatArray]
    ) -> tuple[FloatArray, FloatArray, list[Fitness]]:
        """Return curvature and gradient of the negative log-likelihood, and how well each drive fits."""
        gradient = self.precision @ (x - self.mean)
        fitness = []
        for model, index, its, share in zip(self.models, self._places(), rows, shares, strict=True):
            each = model.weigh(its, soft, share)
            gradient[index] += each.gradient
            fitness.append(each)
        return self._with_prior([each.curvature for each in fitness]), gradient, fitness

    def _with_prior(self, parts: Sequence[FloatArray]) -> FloatArray:
        """Add up what the priors and each drive tell."""
        total: FloatArray = self.precision + self._sum_of(parts)
        return total

    def _sum_of(self, parts: Iterable[FloatArray]) -> FloatArray:
        """Add up square matrices, one per drive, of the sensor's parameters and the drive's own."""
        total = np.zeros_like(self.precision)
        for part, index in zip(parts, self._places(), strict=True):
            total[np.ix_(index, index)] += part
        return total

    def _covariance(self, inverse: FloatArray, fitness: Sequence[Fitness], rows: Sequence[Rows]) -> FloatArray:
        """Return the covariance of all parameters, no smaller than the residuals' scatter says.

        Where residuals of successive frames agree more than the model has it, the covariance grows in that direction;
        and by what lasts from frame to frame, which the estimate may have followed all the way.
        """
        parts = [Blocks(index, *each.by_block()) for index, each in zip(self._places(), fitness, strict=True)]
        lasting = self._sum_of(
            model.lasting(its, each) for model, its, each in zip(self.models, rows, fitness, strict=True)
        )
        return grown(inverse, self.precision, parts) + inverse @ lasting @ inverse


@dataclass(frozen=True)
class _Turned:
    """What was found of all parameters if the scanner turns so, and how likely that is."""

    turn: float
    x: FloatArray
    covariance: FloatArray
    log_probability: float


def _turns_of(problem: _Problem, solved: _Solved, *, unset: bool) -> tuple[list[_Turned], JointSettings]:
    """Condition what was found on each turn, and return what is known then: of clocks nothing, if these were not set.

    Parameters
    ----------
    problem : _Problem
    solved : _Solved
    unset : bool
        They may not be set, if that explains clearly more than turns do, and leaves nothing else that the messages do
        not allow for.
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
    """Condition what was found with any turn, a normal distribution, on one, and on how well clocks are known.

    What the points tell of turn and clocks is what was found, less what was expected; the evidence of a turn is the
    mean of that over what the turn lets expect.
    """
    index = np.array([SWEEP, *problem.clocks])
    covariance = solved.covariance[np.ix_(index, index)]
    before, found = problem.precision[np.ix_(index, index)], np.linalg.inv(covariance)
    # Where residuals scatter by more than the model has it, less than nothing would be left.
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
    """Return how well each drive's clock offset is known, if the scanner turns so."""
    return [with_turn(known_s, drive.turn_s) if turn else known_s for drive in drives]


def _log_sum(turned: Sequence[_Turned]) -> float:
    """Return how likely any of them is, as a logarithm."""
    return float(np.logaddexp.reduce([each.log_probability for each in turned]))


def _among(turned: Sequence[_Turned], likeliest: _Turned, solved: _Solved) -> tuple[_Solved, float]:
    """Make what was solved with the likeliest turn as uncertain as the others are different, uncertain, and likely.

    Return how likely it is as well.
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
    """Return by how much depths and breadths had to be corrected."""
    by = np.array([[1.0, 1.0], [0.0, 1.0]])  # depths by focal length and baseline, breadths by the latter
    values, after = by @ solved.x[BY_OPTICS], np.sqrt(np.diag(by @ solved.covariance[BY_OPTICS, BY_OPTICS] @ by.T))
    return tuple(
        Correction(what, float(value), WRONG_OPTICS, float(left))
        for what, value, left in zip(OPTICS, values, after, strict=True)
    )


def _nearer(solved: _Solved, drives: Sequence[Evidence], settings: JointSettings) -> Correction | None:
    """Return by how much inverse distances have to be corrected: what all points' noise has in common, as one of all.

    The noise of a distance r is r^2 times that of its inverse, which is a disparity's but for a constant.
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
