"""The surface of a road along a vehicle's path: a plane with a slight curvature, a crown, and unevenness.

A lane is tilted relative to its carriageway by up to 2.5 %, so a plane through the surface near the path is not the
plane of the road. The model therefore includes the crown: where only one of its sides is seen, the fall of the road
remains as uncertain as a priori. It also includes an edge of the road, behind which the surface is no longer road. All
heights are relative to a plane that was found before.

The wanted result is the *best plane*: the least-squares plane of all of the road that a camera sees, with its bends and
waves, and midway between both falls of its crown. Heights above the road refer to this plane. It differs from the plane
of the model, which is bent, if the visible area is not rectangular or if the crown is not as modelled.

Terms: the *fall* is the slope of a road away from its crown, the *bends* are its second derivatives, its *waves* are
the unevenness, and the *even surface* is the surface without waves. The *target* quantities are the plane and bends of
the model and the best plane.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse import csr_array
from scipy.special import k1

from laci_stereo.core.frames import BoolArray, FloatArray, IntArray
from laci_stereo.core.ground.box_heights import BENT_PER_M
from laci_stereo.core.ground.road_cells import Cells, Patches
from laci_stereo.core.ground.road_crowns import Crowns
from laci_stereo.core.ground.road_edges import EDGES, LANES_M, NO_EDGE, ON_WAY_M, Edges, behind_edges, towards
from laci_stereo.core.ground.uneven import CLASS_B_M, N0_PER_M, REACH_M

FALL = 0.025 / np.sqrt(3.0)
"""Standard deviation of the fall of a road to either side of its crown, for drainage: anything up to 2.5 %."""

OTHER = (0.3, 2.0 * FALL, 2.0 * FALL)
"""Standard deviations of the height and slopes of the terrain beside a road, relative to the road's plane: it is 0.3 m
higher or lower, and its slopes are twice the fall of a road."""

_FALLS = np.arange(0.0, 0.031, 0.0025)
_FALL_LIKELY = np.append(1.0 / 3.0, np.full(len(_FALLS) - 1, 2.0 / 3.0 / (len(_FALLS) - 1)))
"""Values of the fall of a road from its crown, and their prior probabilities. One road in three has no crown, as it
falls to one side; all other falls are equally likely."""

WAVES_M = 1.0 / (2.0 * np.pi * 0.011)
"""Correlation length of a road's unevenness: ISO 8608 gives the spectrum of waves up to a length of 1 / 0.011 m; waves
longer than the visible road appear as its slope. The fall to the gutters, which limits the correlation in
`laci_stereo.core.ground.uneven`, is part of the crown here."""

UNEVEN_M = CLASS_B_M * float(np.sqrt(WAVES_M / REACH_M))
"""Standard deviation of the height of a class B road above its even surface."""

SMOOTH_M = UNEVEN_M * float(np.sqrt(2.0 / np.pi * np.hypot(1.0, 2.0 * np.pi * N0_PER_M * WAVES_M)))
"""The same standard deviation for a road that is smooth but has long waves: its spectrum equals that of ISO 8608 at the
wave number 0.1 / m."""

AREA_M, RINGS_M = LANES_M / 2, 1e4
"""Side of the square over which the visible road is blurred for the best plane: of a camera, and of a scanner. A camera
sees an area, but no road is narrower than a lane. A scanner sees rings, whose places depend on the directions of its
lasers rather than on the road, and each of which has an error of its own: its best plane is that of the model."""

_PRIOR = np.square([*OTHER, BENT_PER_M, BENT_PER_M / 2, BENT_PER_M])
_BENDS, _BEST, _CROWNS = slice(3, 6), slice(6, 9), slice(9, None)
"""Slices of the state vector of a road: after the three numbers of the plane come its bends, in both directions since
roads that cross are bent in both, the best plane without the crown, and the fall from each crown."""

_CLASSES = np.array([-1.0, 0.0, 1.0])
"""Classes of unevenness relative to class B of ISO 8608: each class doubles it, and one class is one standard
deviation."""

_AT_A_TIME = 2000
"""Number of cells of which the heights behind all edges are in memory, 16 kB each: two lanes of 70 m."""

_NEVER = 25.0
"""Difference in log-likelihood from the most likely pair of an edge and a crown beyond which a pair is ignored: all of
about 10^5 pairs together then have a probability of one in a million."""


class Surface:
    """The posterior distribution of a road's surface, given cells on it.

    The plane, the bends, the height of the surface behind an edge, and the waves are Gaussian: a Gaussian process with
    explicit basis functions (Rasmussen and Williams 2006, section 2.7). The fall and the place of the crown or crowns,
    the edge, and the kind and class of unevenness are marginalised by summation, weighted by their evidence.

    Parameters
    ----------
    cells : Cells
    shared_noise_share : float
        Fraction of each point's standard deviation that is an error shared by all points; a second error of this size
        is shared by all points of one laser.
    before : ndarray, shape (3,)
        Prior mean of the road's plane: height at the origin, and slopes, of the ground; its standard deviations are
        `OTHER`.
    along_rad : float
        Direction of the path: straight crowns and edges are searched along it, across it, and in between.
    ends_m : tuple of float
        Distances to the left of the path at which the road was seen to end on its right and on its left.
    edges : bool
        Whether cells may be behind an edge of the road, another road may cross it, and the road may be smooth with long
        waves, which the spectrum of a rough road would explain as an edge.

    Attributes
    ----------
    behind : ndarray, shape (n,)
        Probability that each cell is behind an edge.
    """

    def __init__(
        self,
        cells: Cells,
        shared_noise_share: float,
        before: FloatArray,
        along_rad: float,
        ends_m: tuple[float, float] = (-np.inf, np.inf),
        *,
        edges: bool = False,
    ) -> None:
        self.cells, self.before = cells, before
        self.middle = cells.xy.mean(axis=0)
        off = cells.xy - self.middle
        patches = Patches.of(cells)
        z = patches.z - height_of(before, patches.xy)
        own = patches.share @ _bent(off)
        noise = patches.noise(shared_noise_share) + (own * _PRIOR) @ own.T
        apart_m = patches.apart_m()
        uneven = [rough(apart_m)]
        self._crowns = Crowns.of_road(off, along_rad, ends_m)
        behind, hides, kinds = np.zeros((len(z), 1, 2)), np.zeros((len(cells), 1), dtype=bool), NO_EDGE
        if edges:
            directions, away_m = towards(along_rad), np.abs(cells.left_m)
            way_m = (off[away_m <= max(ON_WAY_M, float(away_m.min()))] @ directions).max(axis=0)
            behind, hides = _behind(patches.share, cells.left_m, off @ directions - way_m)
            in_view = np.flatnonzero(hides.any(axis=0))
            kept, kinds = np.append(0, in_view), EDGES.only(in_view)
            behind, hides = behind[:, kept], hides[:, kept]
            evidence = partial(_evidence, cho_factor(noise + uneven[0], lower=True), z)
            self._crowns = self._crowns.and_crossings(patches.xy - self.middle, evidence)
            uneven.append(smooth(apart_m))
        crowns = patches.share @ self._crowns.raised(off, cells.left_m)
        best, by_slopes = patches.best_plane(self.middle, AREA_M if cells.by_camera else RINGS_M)
        best_own = best @ own
        best_own[:, 1:3] += by_slopes
        self._by_crowns = best @ crowns
        given = [
            _given(noise + waves, z, _Asked.of(own, waves, best, best_own), crowns, self._crowns.likely, behind, kinds)
            for waves in (4.0**iso_class * each for each in uneven for iso_class in _CLASSES)
        ]
        log_likely = np.array([each.log_likely for each in given]) - 0.5 * np.tile(_CLASSES, len(uneven)) ** 2
        likely = np.exp(log_likely - np.logaddexp.reduce(log_likely))
        self._mean = likely @ np.array([each.mean for each in given])
        products = np.tensordot(likely, [each.products for each in given], 1)
        self._between = products - np.outer(self._mean, self._mean)
        self._covariance = self._between.copy()
        self._covariance[: _BEST.stop, : _BEST.stop] += np.tensordot(likely, [each.within for each in given], 1)
        self.behind: FloatArray = hides @ (likely @ np.array([each.of_edge for each in given]))

    def heights(self, cells: Cells) -> tuple[FloatArray, FloatArray]:
        """Return the height of the even surface at given cells and its variance, each of shape (n,)."""
        shapes = self._shapes(cells)
        variance = ((shapes @ self._covariance) * shapes).sum(axis=1)
        return height_of(self.before, cells.xy) + shapes @ self._mean, np.maximum(variance, 0.0)

    def plane(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the best plane of the road: its height at the middle of the cells, and its slopes along x and y.

        The slopes are those of the visible road, with its waves, and of the other side of its crown; the height is that
        of the visible road. A bent road has other slopes beyond its visible part; the covariance includes the change of
        slope over the visible part.

        Returns
        -------
        value : ndarray, shape (3,)
        covariance : ndarray, shape (3, 3)
        by_crown : ndarray, shape (3, 3)
            The part of the covariance that is due to the crown, which is not determined unless both of its sides are
            seen.
        """
        to_plane = np.zeros((3, len(self._mean)))
        to_plane[:, _BEST], to_plane[:, _CROWNS] = np.eye(3), self._by_crowns
        square = np.diag(self._between)[_CROWNS] + self._mean[_CROWNS] ** 2
        by_crown = np.zeros((3, 3))
        for tilts, likely in self._crowns.other_sides(self._by_crowns[1:], self.cells.xy - self.middle):
            to_plane[1:, _CROWNS] -= likely * tilts
            by_crown[1:, 1:] += (tilts * (square * likely * (1.0 - likely))) @ tilts.T
        covariance = to_plane @ self._covariance @ to_plane.T + by_crown
        by_crown += to_plane @ self._between @ to_plane.T
        bent = self._covariance[_BENDS, _BENDS] + np.outer(self._mean[_BENDS], self._mean[_BENDS])
        (xx, xy), (_, yy) = np.cov(self.cells.xy.T, bias=True)
        # Over (dx, dy) the slopes change by (bent_xx dx + bent_xy dy, bent_xy dx + bent_yy dy).
        covariance[1, 1] += bent[0, 0] * xx + 2.0 * bent[0, 1] * xy + bent[1, 1] * yy
        covariance[2, 2] += bent[1, 1] * xx + 2.0 * bent[1, 2] * xy + bent[2, 2] * yy
        both = bent[0, 1] * xx + (bent[0, 2] + bent[1, 1]) * xy + bent[1, 2] * yy
        covariance[1, 2] += both
        covariance[2, 1] += both
        offset = np.append(height_of(self.before, self.middle), self.before[1:])
        return offset + to_plane @ self._mean, covariance, by_crown

    def _shapes(self, cells: Cells) -> FloatArray:
        """Return the basis functions of the even surface at given places, shape (n, 9 + crowns).

        These are the plane, the bends, and the height that each crown adds per unit fall. The columns of the best plane
        are zero, since it follows from the others.
        """
        off = cells.xy - self.middle
        best = np.zeros((len(off), 3))
        return np.concatenate([_bent(off), best, self._crowns.raised(off, cells.left_m)], axis=1)


@dataclass(frozen=True)
class _Asked:
    """Prior of the target quantities for one class of unevenness: plane and bends, and the best plane.

    Attributes
    ----------
    with_heights : ndarray, shape (n, 9)
        Prior covariance of the n measured heights with the target quantities.
    prior : ndarray, shape (9, 9)
        Prior covariance of the target quantities.
    """

    with_heights: FloatArray
    prior: FloatArray

    @staticmethod
    def of(own: FloatArray, waves: FloatArray, best: FloatArray, best_own: FloatArray) -> _Asked:
        """Return the prior for a given covariance of the waves.

        Parameters
        ----------
        own : ndarray, shape (n, 6)
            Derivative of each height by plane and bends.
        waves : ndarray, shape (n, n)
            Covariance of the waves' heights.
        best : ndarray, shape (3, n)
            Derivative of the best plane by the heights.
        best_own : ndarray, shape (3, 6)
            Derivative of the best plane by plane and bends.
        """
        by_own, by_waves = own * _PRIOR, best @ waves
        corner = best_own * _PRIOR
        of_best = corner @ best_own.T + by_waves @ best.T
        return _Asked(
            np.column_stack([by_own, by_own @ best_own.T + by_waves.T]),
            np.block([[np.diag(_PRIOR), corner.T], [corner, of_best]]),
        )


@dataclass(frozen=True)
class _Given:
    """The posterior for one class of unevenness.

    Attributes
    ----------
    log_likely : float
        Log evidence of the class.
    mean, products : ndarray, shape (k,) and (k, k)
        Mean and mean products, over crowns, falls and edges, of the target quantities' expectations given these,
        followed by the fall from each crown, which is 0 if another crown exists.
    within : ndarray, shape (9, 9)
        Covariance of the target quantities about their conditional expectations, averaged over the edges.
    of_edge : ndarray, shape (edges,)
        Posterior probability of each edge.
    """

    log_likely: float
    mean: FloatArray
    products: FloatArray
    within: FloatArray
    of_edge: FloatArray


@dataclass(frozen=True)
class _Pairs:
    """The pairs of an edge and a crown that are not ruled out, with their posterior probabilities.

    Attributes
    ----------
    edge, crown : ndarray of int, shape (pairs,)
    likely, fall, square : ndarray, shape (pairs,)
        Probability of each pair, and its products with the mean and the mean square of the crown's fall.
    log_likely : float
        Log evidence of all pairs together.
    """

    edge: IntArray
    crown: IntArray
    likely: FloatArray
    fall: FloatArray
    square: FloatArray
    log_likely: float

    @staticmethod
    def of(log_level: FloatArray, linear: FloatArray, quadratic: FloatArray) -> _Pairs:
        """Sum over falls: a fall f adds ``linear f - quadratic f^2 / 2`` to the log-likelihood of a pair without one.

        Parameters
        ----------
        log_level : ndarray, shape (edges, crowns)
            Log probability of each pair with a fall of 0, up to a constant.
        linear, quadratic : ndarray, shape (edges, crowns)
        """
        # Most pairs are ruled out by an upper bound: their evidence at the most likely fall.
        likeliest = np.divide(linear, quadratic, out=np.zeros_like(linear), where=quadratic > 0.0)
        likeliest = likeliest.clip(0.0, _FALLS[-1])
        best = log_level + likeliest * (linear - quadratic * (likeliest / 2))
        edge, crown = kept = np.nonzero(best > best.max() - _NEVER)
        chance = log_level[kept][:, None] + np.log(_FALL_LIKELY)
        chance += linear[kept][:, None] * _FALLS - quadratic[kept][:, None] * (_FALLS**2 / 2)
        most = float(chance.max())
        np.exp(chance - most, out=chance)
        total = float(chance.sum())
        chance /= total
        moments = chance.sum(axis=1), chance @ _FALLS, chance @ _FALLS**2
        return _Pairs(edge, crown, *moments, most + np.log(total))


def _given(
    covariance: FloatArray,
    z: FloatArray,
    asked: _Asked,
    crowns: FloatArray,
    crown_likely: FloatArray,
    behind: FloatArray,
    edges: Edges,
) -> _Given:
    """Return the posterior, summed over falls, crowns and edges: one crown exists, and one edge or none.

    Parameters
    ----------
    covariance : ndarray, shape (n, n)
        Covariance of the heights without a crown and without an edge.
    z : ndarray, shape (n,)
        The measured heights.
    asked : _Asked
    crowns : ndarray, shape (n, crowns)
        Height that each crown adds per unit fall.
    crown_likely : ndarray, shape (crowns,)
        Prior probability of each crown.
    behind : ndarray, shape (n, edges, 2)
        Derivatives of the heights by the two parameters of each edge; see `behind_edges`.
    edges : Edges
    """
    count, known = len(edges), asked.with_heights.shape[1]
    columns = np.column_stack([asked.with_heights, crowns])
    factor, flat_behind = cho_factor(covariance, lower=True), behind.reshape(len(z), -1)
    by_z, by_columns, by_behind = np.split(
        cho_solve(factor, np.column_stack([z, columns, flat_behind])), [1, 1 + columns.shape[1]], axis=1
    )
    # The two parameters of an edge add a term of rank 2 to the covariance, which is inverted by Woodbury's identity.
    crossed = (flat_behind.T @ by_columns).reshape(count, 2, -1)
    inside = np.einsum("nei,nej->eij", behind, by_behind.reshape(behind.shape))
    precision = edges.sigma[:, :, None] ** -2 * np.eye(2)
    spread = np.linalg.inv(precision + inside)
    of_z = (flat_behind.T @ by_z).reshape(count, 2)
    off = of_z - (inside @ edges.mean[:, :, None])[:, :, 0]
    raised = edges.mean + (spread @ off[:, :, None])[:, :, 0]
    with_z = (columns.T @ by_z)[:, 0] - (raised[:, None] @ crossed)[:, 0]
    lessened = spread @ crossed
    crown_square = (crowns * by_columns[:, known:]).sum(axis=0) - (crossed * lessened)[:, :, known:].sum(axis=1)

    log_edge = np.log(edges.likely) + (edges.mean * of_z + raised * off).sum(axis=1) / 2
    log_edge += np.linalg.slogdet(spread @ precision)[1] / 2
    log_crown = np.log(crown_likely, where=crown_likely > 0.0, out=np.full_like(crown_likely, -np.inf))
    pairs = _Pairs.of(log_edge[:, None] + log_crown, with_z[:, known:], crown_square)
    edge, crown, likely, fall, square = pairs.edge, pairs.crown, pairs.likely, pairs.fall, pairs.square
    of_edge = np.bincount(edge, weights=likely, minlength=count).astype(np.float64)

    # For each pair, the conditional expectation of the target quantities is expected + by_fall * fall.
    expected = with_z[edge, :known]
    of_crown = lessened[edge, :, known + crown]
    edge_crown = crossed[edge, 0, :known] * of_crown[:, :1] + crossed[edge, 1, :known] * of_crown[:, 1:]
    by_fall = edge_crown - (asked.with_heights.T @ by_columns[:, known:]).T[crown]
    on_crown = csr_array((np.ones(len(crown)), (crown, np.arange(len(crown)))), (len(crown_likely), len(crown)))
    between = (expected.T * fall) @ by_fall
    products: FloatArray = np.diag(np.append(np.zeros(known), np.bincount(crown, square, len(crown_likely))))
    products[:known, :known] = (expected.T * likely) @ expected + between + between.T + (by_fall.T * square) @ by_fall
    products[known:, :known] = on_crown @ (expected * fall[:, None] + by_fall * square[:, None])
    products[:known, known:] = products[known:, :known].T
    explained = asked.with_heights.T @ by_columns[:, :known]
    explained -= np.tensordot(crossed[:, :, :known] * of_edge[:, None, None], lessened[:, :, :known], ((0, 1), (0, 1)))
    log_likely = pairs.log_likely - 0.5 * float(z @ by_z[:, 0]) - np.log(np.diag(factor[0])).sum()
    mean = np.append(likely @ expected + fall @ by_fall, np.bincount(crown, fall, len(crown_likely)))
    return _Given(log_likely, mean, products, asked.prior - explained, of_edge)


def _evidence(factor: tuple[FloatArray, bool], z: FloatArray, crowns: FloatArray) -> FloatArray:
    """Return the log-likelihood of heights, shape (n,), with each of the crowns, shape (crowns,), up to a constant.

    The falls are summed over. ``factor`` is the Cholesky factor of the heights' covariance without a crown, see
    `scipy.linalg.cho_factor`; ``crowns``, shape (n, crowns), are the heights that each crown adds per unit fall.
    """
    by_crowns = cho_solve(factor, crowns)
    square = (crowns * by_crowns).sum(axis=0)
    log_likely: FloatArray = np.logaddexp.reduce(
        (z @ by_crowns)[:, None] * _FALLS - square[:, None] * (_FALLS**2 / 2), axis=1
    )
    return log_likely


def rough(apart_m: FloatArray) -> FloatArray:
    """Return the covariance of the heights of a class B road as a function of their distance (any shape).

    Its spectrum falls with the square of the wave number, as in ISO 8608.
    """
    covariance: FloatArray = UNEVEN_M**2 * np.exp(-apart_m / WAVES_M)
    return covariance


def smooth(apart_m: FloatArray) -> FloatArray:
    """Return the covariance of heights of a smooth road as a function of their distance (any shape).

    Its spectrum falls with the cube of the wave number; for measured roads the powers range from 1.7 to 3.3 (Mitschke
    and Wallentowitz, Dynamik der Kraftfahrzeuge). This is Matern's covariance for the smoothness 1 (Rasmussen and
    Williams 2006, equation 4.14).
    """
    waves = np.maximum(apart_m / WAVES_M, 1e-9)
    covariance: FloatArray = SMOOTH_M**2 * waves * k1(waves)
    return covariance


def _behind(share: csr_array, left_m: FloatArray, beyond_m: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the derivatives of the patches' heights by each edge, shape (m, edges, 2), and which cells it affects.

    The derivatives of all cells of a long road would take gigabytes, so they are averaged part by part.

    Parameters
    ----------
    share : scipy.sparse.csr_array, shape (m, n)
        See `Patches`.
    left_m, beyond_m : ndarray, shape (n,) and (n, 16)
        See `behind_edges`.
    """
    behind, hides = np.zeros((share.shape[0], 2 * len(EDGES))), np.zeros((len(left_m), len(EDGES)), dtype=bool)
    by_cell = share.tocsc()
    for first in range(0, len(left_m), _AT_A_TIME):
        part = slice(first, min(first + _AT_A_TIME, len(left_m)))
        raised = behind_edges(left_m[part], beyond_m[part])
        behind += by_cell[:, part] @ raised.reshape(len(raised), -1)
        hides[part] = raised.any(axis=2)
    return behind.reshape(len(behind), -1, 2), hides


def _bent(off: FloatArray) -> FloatArray:
    """Return the basis functions of plane and bends at given places, shape (n, 6)."""
    x, y = off.T
    return np.column_stack([np.ones_like(x), x, y, x * x / 2, x * y, y * y / 2])


def height_of(plane: FloatArray, xy: FloatArray) -> FloatArray:
    """Return the heights of a plane, given by its height at the origin and two slopes, at places of shape (..., 2)."""
    height: FloatArray = plane[0] + xy @ plane[1:]
    return height
