"""The joint estimate of all parameters of some drives: the priors, and the descents to the optimum.

Gauss-Newton descents from several starts, with a mixture for the noise of each point (`mixture`). Angles and positions
are those of the level frame in the world frame.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from laci_stereo.core.estimation.drive_likelihood import Fitness
from laci_stereo.core.estimation.drive_model import DriveModel
from laci_stereo.core.estimation.drive_prior import LASTING, Correction
from laci_stereo.core.estimation.drive_rows import FIRST_OWN, Chosen, Rows
from laci_stereo.core.estimation.evidence import Evidence
from laci_stereo.core.estimation.recordings import Recordings
from laci_stereo.core.estimation.residual_scatter import Blocks, grown
from laci_stereo.core.estimation.scanner_turn import Turn
from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.settings import JointSettings

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

FREE, HELD = (1.0, 100.0), (1e-6, 1e-6)
"""A priori standard deviations of yaw, rad, and position, m, about the start: of a transform that is sought, which only
keep the equations regular, and of one that is given."""


@dataclass(frozen=True)
class Solved:
    """The optimum of all p parameters.

    Attributes
    ----------
    x : ndarray, shape (p,)
    covariance, precision : ndarray, shape (p, p)
        Posterior covariance, and the precision of the priors there.
    by_prior : ndarray, shape (3, p)
        By how much one standard deviation of each error of the priors moves yaw and position. These
        errors are uncorrelated (Cholesky).
    fitness : tuple of Fitness
        Of each drive.
    chosen : tuple of Chosen
        The points of each drive that were compared with the outline.
    """

    x: FloatArray
    covariance: FloatArray
    precision: FloatArray
    by_prior: FloatArray
    fitness: tuple[Fitness, ...]
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


class Problem:
    """The models of all drives over one parameter vector: the sensor's parameters, followed by each drive's own.

    The sensor's are those of `drive_rows`. Yaw and position are sought, or `HELD` at ``begin``.
    """

    def __init__(
        self,
        drives: Sequence[Evidence],
        begin: FloatArray,
        centre: FloatArray,
        settings: JointSettings,
        turn: Turn,
        stations: Sequence[int] | None = None,
        pose_sigmas: tuple[float, float] = FREE,
    ) -> None:
        self.settings, self.turn = settings, turn
        self._given = drives, begin, centre, stations, pose_sigmas
        self.models = [DriveModel(drive, centre, settings, turns=turn.possible) for drive in drives]
        self.recordings = Recordings(self.models, stations)
        ends = FIRST_OWN + np.cumsum([0, *(len(model.prior.mean) for model in self.models)])
        self.own = [slice(int(a), int(b)) for a, b in pairwise(ends)]
        self.size = int(ends[-1])
        self.clocks = [own.start for own in self.own]
        # The knots of the position errors are each drive's last parameters: all x first, then all y.
        lasts = [(own.stop, len(model.knots)) for model, own in zip(self.models, self.own, strict=True)]
        self.knots = [np.concatenate([end - after * n + np.arange(n) for end, n in lasts]) for after in (2, 1)]
        self.drifts = self.recordings.drifts(settings)
        self.senders = np.linalg.inv(self.recordings.senders)
        # The range bias is the error that the noise of all points shares.
        yaw_rad, place_m = pose_sigmas
        sigmas = [yaw_rad, place_m, place_m, settings.bias_noise_share, turn.sigma]
        sigmas += [settings.optics_sigma, settings.optics_sigma, settings.apart_sigma_s]
        self._sensors = np.zeros((self.size, self.size))
        self._sensors[range(FIRST_OWN), range(FIRST_OWN)] = np.array(sigmas) ** -2.0
        self.mean = np.concatenate([begin, [turn.mean, 0.0, 0.0, 0.0], *(model.prior.mean for model in self.models)])
        self._precision = self.precision_at(None)

    def expecting(self, settings: JointSettings, turn: Turn | None = None) -> Problem:
        """Return the same problem with other priors, and perhaps of another rotation of the scanner."""
        drives, begin, centre, stations, pose_sigmas = self._given
        return Problem(drives, begin, centre, settings, turn or self.turn, stations, pose_sigmas)

    def precision_at(self, x: FloatArray | None) -> FloatArray:
        """Return the precision of the priors at ``x``, on which their heavy tails depend; None: within these limits."""
        precision: FloatArray = self._sensors.copy()
        for model, own in zip(self.models, self.own, strict=True):
            precision[own, own] = model.prior.precision(None if x is None else x[own])
        clocks = np.ix_(self.clocks, self.clocks)
        precision[clocks] = self.recordings.clocks(np.diag(precision[clocks]))
        for knots in self.knots:
            precision[np.ix_(knots, knots)] = self.drifts
        # With a square root of each drive's precision, any two drives are correlated as `Recordings.senders` says.
        lasting = [own.start + np.array(LASTING) for own in self.own]
        roots = [np.linalg.cholesky(precision[np.ix_(index, index)]).T for index in lasting]
        for (i, one), (j, other) in product(enumerate(lasting), repeat=2):
            precision[np.ix_(one, other)] = self.senders[i, j] * roots[i].T @ roots[j]
        return precision

    def prior_errors(self) -> list[FloatArray]:
        """Return the errors of the priors of each drive, in standard deviations, by independent ones that all share.

        Rows of a drive's matrix are the errors of its parameters as in `Solved.by_prior`; its rows, and those of
        another drive's, are as correlated as their errors.
        """
        prior = np.asarray(np.linalg.inv(self._precision), dtype=np.float64)
        root = np.linalg.cholesky(prior)
        return [np.linalg.solve(np.linalg.cholesky(prior[np.ix_(each, each)]), root[each]) for each in self._places()]

    def at_rest(self, offsets: Sequence[float]) -> FloatArray:
        """Return the vector with every parameter at its prior mean, except the clock offsets."""
        x: FloatArray = self.mean.copy()
        x[self.clocks] = offsets
        return x

    def best_of(self, starts: Sequence[FloatArray]) -> FloatArray:
        """Descend from rough starts with decreasing softening, and return the most likely end; only the best are kept.

        Starts that reach the same place continue as one.
        """
        descents = [_Descent(x, self.rows_at(x), self._first_shares(), self._precision, -np.inf) for x in starts]
        for soft in SOFTENING_M[:FIRST_STEPS]:
            descents = self._distinct(self._step(descent, soft) for descent in descents)
        descents = [replace(descent, shares=self._first_shares()) for descent in descents[:FOLLOWED]]
        for soft in SOFTENING_M[FIRST_STEPS:]:
            descents = self._distinct(self._step(descent, soft) for descent in descents)
        return descents[0].x

    def _first_shares(self) -> list[FloatArray]:
        return [model.likelihood.first_shares() for model in self.models]

    def _step(self, at: _Descent, softening_m: float) -> _Descent:
        """Take a step at this softening, and return the place reached with its log-posterior."""
        fitness = self._weigh(at.rows, softening_m, at.shares)
        curvature, gradient = self._derivatives(at.x, fitness, self._precision)
        x = at.x - np.linalg.solve(curvature, gradient)
        rows, shares = self.rows_at(x), [fit.shares for fit in fitness]
        likely = sum(likely for likely, _ in self._settle(rows, softening_m, shares))
        return _Descent(x, rows, shares, curvature, likely + self.log_prior(x, self._precision))

    @staticmethod
    def _distinct(descents: Iterable[_Descent]) -> list[_Descent]:
        """Return the most likely descent at each place, in descending order of their log-posteriors."""
        kept: list[_Descent] = []
        for descent in sorted(descents, key=lambda descent: -descent.log_likely):
            if all((descent.x - other.x) @ other.curvature @ (descent.x - other.x) > TOGETHER for other in kept):
                kept.append(descent)
        return kept

    def settled(self, drive: int, solved: Solved, rows: Rows) -> float:
        """Return the log-likelihood of some points of a drive, with the fractions of the mixture that fit them."""
        likely, shares = 0.0, solved.fitness[drive].shares
        for _ in range(SETTLING):
            likely, shares = self.models[drive].likelihood.settle(rows, 0.0, shares)
        return likely

    def corrections(self, solved: Solved) -> list[tuple[DriveModel, tuple[Correction, ...]]]:
        """Return each drive's model, with the corrections to its messages."""
        return [
            (model, model.prior.corrections(solved.x[own], solved.covariance[own, own]))
            for model, own in zip(self.models, self.own, strict=True)
        ]

    def solve(self, x: FloatArray, converged: float = CONVERGED) -> Solved:
        """Descend from a nearby start to the optimum; after each descent the points on the wall are selected again."""
        shares: Sequence[FloatArray] = self._first_shares()
        for _ in range(ROUNDS):
            chosen = [model.choose(x[own]) for model, own in zip(self.models, self._places(), strict=True)]
            rows: Sequence[Rows] = self.rows_at(x, chosen)
            for _ in range(SETTLING):
                shares = [settled for _, settled in self._settle(rows, 0.0, shares)]
            before = x
            x, rows, shares = self._climb(x, rows, shares, chosen, converged)
            fitness, precision = self._weigh(rows, 0.0, shares), self.precision_at(x)
            information = precision + self._sum_of(fit.information for fit in fitness)
            if (x - before) @ information @ (x - before) < converged:
                break
        inverse = np.asarray(np.linalg.inv(information), dtype=np.float64)
        covariance = self._covariance(inverse, precision, fitness, rows)
        by_prior: FloatArray = np.linalg.solve(np.linalg.cholesky(np.linalg.inv(precision)), inverse[:, :3]).T
        return Solved(x, covariance, precision, by_prior, tuple(fitness), tuple(chosen))

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
            fitness, precision = self._weigh(rows, 0.0, shares), self.precision_at(x)
            curvature, gradient = self._derivatives(x, fitness, precision)
            step = np.linalg.solve(curvature, gradient)
            size = float(step @ curvature @ step)
            while pace**2 * size >= converged:
                after = self.rows_at(x - pace * step, chosen)
                prior = self.log_prior(x - pace * step, precision) - self.log_prior(x, precision)
                if self._gain(after, rows, fitness, shares) + prior > 0.0:
                    break
                pace /= 4.0
            else:
                break
            x, rows, shares = x - pace * step, after, [fit.shares for fit in fitness]
            pace = min(1.0, 2.0 * pace)
        return x, rows, shares

    def _gain(
        self, rows: Sequence[Rows], before: Sequence[Rows], fitness: Sequence[Fitness], shares: Sequence[FloatArray]
    ) -> float:
        """Return the gain in log-likelihood of a place over the one before."""
        drives = zip(self.models, rows, before, fitness, shares, strict=True)
        return sum(
            model.likelihood.gain(now, then, fit.log_likelihoods, share) for model, now, then, fit, share in drives
        )

    def log_prior(self, x: FloatArray, precision: FloatArray) -> float:
        """Return the log prior density of a place, up to a constant that only depends on the precision."""
        away = x - self.mean
        return -float(away @ precision @ away) / 2

    def _places(self) -> list[IntArray]:
        """Return the indices of each drive's parameters in the vector: the sensor's, then the drive's own."""
        return [np.r_[:FIRST_OWN, own] for own in self.own]

    def rows_at(self, x: FloatArray, chosen: Sequence[Chosen] | None = None) -> list[Rows]:
        """Return each drive's distances from the outline, of the chosen points or of those on the wall there."""
        points: Sequence[Chosen | None] = chosen or [None] * len(self.models)
        drives = zip(self.models, self._places(), points, strict=True)
        return [model.rows(x[index], of_drive) for model, index, of_drive in drives]

    def _weigh(self, rows: Sequence[Rows], soft: float, shares: Sequence[FloatArray]) -> list[Fitness]:
        """Return the fitness of each drive."""
        drives = zip(self.models, rows, shares, strict=True)
        return [model.likelihood.weigh(distances, soft, share) for model, distances, share in drives]

    def _settle(
        self, rows: Sequence[Rows], soft: float, shares: Sequence[FloatArray]
    ) -> list[tuple[float, FloatArray]]:
        """Return each drive's log-likelihood and its fractions of the mixture."""
        drives = zip(self.models, rows, shares, strict=True)
        return [model.likelihood.settle(distances, soft, share) for model, distances, share in drives]

    def _derivatives(
        self, x: FloatArray, fitness: Sequence[Fitness], precision: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return curvature and gradient of the negative log-posterior."""
        gradient = precision @ (x - self.mean)
        for index, fit in zip(self._places(), fitness, strict=True):
            gradient[index] += fit.gradient
        return precision + self._sum_of(fit.curvature for fit in fitness), gradient

    def _sum_of(self, parts: Iterable[FloatArray]) -> FloatArray:
        """Return the sum of square matrices, one per drive, over the sensor's parameters and the drive's own."""
        total: FloatArray = np.zeros((self.size, self.size))
        for part, index in zip(parts, self._places(), strict=True):
            total[np.ix_(index, index)] += part
        return total

    def _covariance(
        self, inverse: FloatArray, precision: FloatArray, fitness: Sequence[Fitness], rows: Sequence[Rows]
    ) -> FloatArray:
        """Return the covariance of all parameters, at least as large as the dispersion of the residuals implies.

        Where the residuals of successive frames agree more than the model expects, the covariance grows in that
        direction. It also includes the errors that persist from frame to frame, which the estimate may have followed
        throughout.
        """
        parts = [Blocks(index, *fit.by_block()) for index, fit in zip(self._places(), fitness, strict=True)]
        lasting = self._sum_of(
            model.likelihood.lasting(distances, fit)
            for model, distances, fit in zip(self.models, rows, fitness, strict=True)
        )
        return grown(inverse, precision, parts) + inverse @ lasting @ inverse
