"""How well a drive fits: the likelihood of its points' distances from the outline, and its derivatives."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from laci_stereo.core.estimation import mixture
from laci_stereo.core.estimation.drive_prior import CLOCK, LAG
from laci_stereo.core.estimation.drive_rows import BIAS, FIRST_OWN, SWEEP, Rows
from laci_stereo.core.estimation.effective_samples import SAME_ERROR_M, blocks_of
from laci_stereo.core.estimation.evidence import Evidence
from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.settings import JointSettings
from laci_stereo.core.vehicle import outline

_CLOCK, _LAG = FIRST_OWN + CLOCK, FIRST_OWN + LAG

GRAZING = 0.3
"""Least cosine of the angle of incidence in the likelihood of ranges: where a line of sight grazes a corner, not its
angle but the noise of the outline determines how ranges differ, about sqrt(2 x 0.03 m / 0.5 m)."""


@dataclass(frozen=True)
class Fitness:
    """How well a drive fits, at one point in the space of the p parameters.

    Attributes
    ----------
    jacobian, precision : ndarray, shape (n, p) and (n,)
        Derivatives of each point's distance, and its precision, from which the information is computed.
    curvature : ndarray, shape (p, p)
        Of the negative log-likelihood. It uses velocities at the moment itself, and so takes the messages' noise for a
        manoeuvre that would determine the clock offset.
    gradient : ndarray, shape (p,)
        Of the negative log-likelihood.
    scores : ndarray, shape (n, p)
        Contribution of each point to the gradient.
    block : ndarray of int, shape (n,)
        Block of time that each point belongs to.
    log_likelihoods : ndarray, shape (n,)
        Log-likelihoods of the distances.
    log_likelihood : float
        Log-likelihood of all ranges, comparable only with that of the same points.
    shares : ndarray
        Fractions of the mixture, see `mixture.Mixture`.
    weight, squares : float
        Expected number of points of the surface, and the sum of their squared distances.
    explained, rows : float
        Expected number of points that the outline explains, and the number of all points.
    frames : int
        Number of frames with points of the surface.
    """

    jacobian: FloatArray
    precision: FloatArray
    curvature: FloatArray
    gradient: FloatArray
    scores: FloatArray
    block: IntArray
    log_likelihoods: FloatArray
    log_likelihood: float
    shares: FloatArray
    weight: float
    squares: float
    explained: float
    rows: float
    frames: int

    @property
    def information(self) -> FloatArray:
        """The information about the parameters, shape (p, p)."""
        information: FloatArray = (self.jacobian * self.precision[:, None]).T @ self.jacobian
        return information

    def by_block(self) -> tuple[FloatArray, FloatArray]:
        """Return the sum of scores, shape (b, p), and the information, shape (b, p, p), of each of b blocks of time."""
        block = np.unique(self.block, return_inverse=True)[1].reshape(-1)
        count, size = int(block.max(initial=-1)) + 1, self.scores.shape[1]
        scores = np.zeros((count, size))
        np.add.at(scores, block, self.scores)
        parts = [np.flatnonzero(block == one) for one in range(count)]
        told = [(self.jacobian[part] * self.precision[part, None]).T @ self.jacobian[part] for part in parts]
        return scores, np.array(told).reshape(-1, size, size)


class DriveLikelihood:
    """The likelihood of one drive's distances.

    Parameters
    ----------
    drive : Evidence
    hat : ndarray, shape (m, k)
        Fraction of each knot's position error that each frame has.
    settings : JointSettings
    """

    def __init__(self, drive: Evidence, hat: FloatArray, settings: JointSettings) -> None:
        self.drive = drive
        self.hat = hat
        self.settings = settings
        self.block = blocks_of(drive, settings.block_s)

    def first_shares(self) -> FloatArray:
        """Return the initial fractions of the mixture: of each frame's faces, then of the borders over all frames."""
        of_borders = [mixture.first_shares(outline.BORDERS)] if self.drive.has_borders else []
        return np.concatenate([mixture.first_shares(len(self.drive) * outline.FACES), *of_borders])

    def mixed(self, rows: Rows, distance: FloatArray, sigma: FloatArray, shares: FloatArray) -> mixture.Mixture:
        """Weigh distances by their possible sources, separately for faces and borders.

        The mixtures are separate, since what occludes a border is not what lies behind a face.

        Parameters
        ----------
        rows : Rows
            The rows that the distances belong to.
        distance, sigma : ndarray, shape (n,)
            Distances and their standard deviations.
        shares : ndarray
            Fractions, ordered as in the result of `first_shares`.
        """
        parts = [
            mixture.weigh(distance[part], sigma[part], group, fractions, rows.share[part])
            for part, group, fractions in self._kinds(rows, shares)
        ]
        names = [field.name for field in fields(mixture.Mixture)]
        return mixture.Mixture(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def _log_likelihoods(self, rows: Rows, distance: FloatArray, shares: FloatArray) -> FloatArray:
        """Return the log-likelihood of distances of rows, shape (n,), as defined by `mixed`."""
        sigma = np.sqrt(rows.variance)
        return np.concatenate(
            [
                mixture.log_likelihood(distance[part], sigma[part], group, fractions)
                for part, group, fractions in self._kinds(rows, shares)
            ]
        )

    def _kinds(self, rows: Rows, shares: FloatArray) -> tuple[tuple[slice, IntArray, FloatArray], ...]:
        """Return the rows of faces and those of borders, each with the rows' groups and the groups' fractions."""
        faces, count = len(self.drive) * outline.FACES, int((rows.face < outline.FACES).sum())
        of_faces = slice(count), rows.frame[:count] * outline.FACES + rows.face[:count], shares[: faces + 1]
        of_borders = slice(count, None), rows.face[count:] - outline.FACES, shares[faces + 1 :]
        return (of_faces, of_borders) if self.drive.has_borders else (of_faces,)

    def weigh(self, rows: Rows, softening_m: float, shares: FloatArray) -> Fitness:
        """Return how well the drive fits, given its distances at some parameters.

        The gradient, of shape (FIRST_OWN + own,), treats the noise and the angles of incidence as constants: if they
        were free to change, a side would rotate away from the sensor until its points fit, as their distances are
        shorter than their ranges.

        Parameters
        ----------
        rows : Rows
        softening_m : float
            Standard deviation that is added to the noise.
        shares : ndarray
            Fractions of the mixture, see `mixture.Mixture`.
        """
        sigma, mixed = self._softened(rows, softening_m, shares)
        weight = rows.share * mixed.surface / (sigma * mixed.growth) ** 2
        jacobian = self._by_all(rows)
        pull = mixed.slope * rows.share
        now = jacobian.copy()
        now[:, _CLOCK] = rows.by_time
        now[:, _LAG] = rows.by_lag
        now[:, SWEEP] = rows.by_time * rows.late_s
        scores = now * pull[:, None]
        of_outline = rows.face < outline.FACES
        surface, behind = mixed.surface * of_outline, mixed.behind * of_outline
        held = np.bincount(rows.frame, surface, len(self.drive)) > 1.0
        return Fitness(
            jacobian=jacobian,
            precision=weight,
            curvature=(now * weight[:, None]).T @ now,
            gradient=scores.sum(axis=0),
            scores=scores,
            block=self.block[rows.frame],
            log_likelihoods=mixed.log_likelihood,
            log_likelihood=_of_ranges(rows, mixed),
            shares=mixed.shares,
            weight=float(surface.sum()),
            squares=float((surface * rows.distance**2).sum()),
            explained=float((surface + behind).sum()),
            rows=float(of_outline.sum()),
            frames=int(held.sum()),
        )

    def settle(self, rows: Rows, softening_m: float, shares: FloatArray) -> tuple[float, FloatArray]:
        """Return the log-likelihood of all ranges and the new fractions of the mixture: a small part of `weigh`."""
        _, mixed = self._softened(rows, softening_m, shares)
        return _of_ranges(rows, mixed), mixed.shares

    def _softened(self, rows: Rows, softening_m: float, shares: FloatArray) -> tuple[FloatArray, mixture.Mixture]:
        sigma = np.sqrt(rows.variance + softening_m**2)
        return sigma, self.mixed(rows, rows.distance, sigma, shares)

    def lasting(self, rows: Rows, fitness: Fitness) -> FloatArray:
        """Return the covariance of the gradient, shape (p, p), due to matching errors that persist from frame to frame.

        The error that the points on one side of a frame share decays with the distance travelled. Its correlation
        within a frame is included in the points' weights.
        """
        size = fitness.jacobian.shape[1]
        total: FloatArray = np.zeros((size, size))
        if self.drive.window_rad == 0.0 or not len(self.drive.points):
            return total
        way = self.drive.way_m
        alike = np.exp(-np.abs(way[:, None] - way) / SAME_ERROR_M) - np.eye(len(way))
        pulls = fitness.jacobian * (fitness.precision * fitness.jacobian[:, BIAS])[:, None]
        for side in range(outline.SIDES):
            on_side = rows.face == side
            by_frame = np.zeros((len(way), size))
            np.add.at(by_frame, rows.frame[on_side], pulls[on_side])
            total += by_frame.T @ alike @ by_frame
        return self.settings.shared_variance_share * total

    def gain(self, rows: Rows, before: Rows, likely_before: FloatArray, shares: FloatArray) -> float:
        """Return the gain in log-likelihood of the ranges over the previous rows.

        Noise and angles of incidence are held at their previous values. The gain is the quantity whose gradient `weigh`
        returns. It is summed over the points for which the messages determine the vehicle's place both times and which
        stay on their side: where a point changes sides, the likelihood jumps, which no derivative describes.

        Parameters
        ----------
        rows, before : Rows
            Rows at the new and at the previous parameters.
        likely_before : ndarray, shape (n,)
            The `Fitness.log_likelihoods` of the previous rows.
        shares : ndarray
            Fractions of the mixture with which these were weighed.
        """
        if not np.array_equal(rows.point, before.point):
            _, now, then = np.intersect1d(rows.point, before.point, assume_unique=True, return_indices=True)
            rows, before, likely_before = rows[now], before[then], likely_before[then]
        same = rows.face == before.face
        rows, before, likely_before = rows[same], before[same], likely_before[same]
        hit = before.cos > 0.0
        distance = rows.distance * np.where(hit, before.cos, 1.0) / np.where(hit, rows.cos, 1.0)
        likely = self._log_likelihoods(before, distance, shares)
        return float(before.share @ (likely - likely_before))

    def _by_all(self, rows: Rows) -> FloatArray:
        """Append the derivatives by the knots: a bias of the messages' positions shifts the vehicle in the world."""
        hat = self.hat[rows.frame]
        return np.hstack([rows.jacobian, rows.jacobian[:, 1:2] * hat, rows.jacobian[:, 2:3] * hat])


def _of_ranges(rows: Rows, mixed: mixture.Mixture) -> float:
    return float((rows.share * (mixed.log_likelihood + np.log(np.maximum(rows.cos, GRAZING)))).sum())
