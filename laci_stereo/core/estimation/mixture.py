"""What a distance from the outline can come from: the surface, something behind it, or anything else."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from laci_stereo.core.frames import FloatArray, IntArray

ELSEWHERE_M = 5.0
"""What belongs to neither lies anywhere within a cluster, which spans about the length of a car."""

MIN_DEPTH_M, MAX_DEPTH_M = 0.05, 3.0
TRUST = 20.0
"""What is particular to a side in one frame is held at the whole drive's as if by so many independent points. There are
never more than a few, since they have much of their noise in common: a frame whose noise may pass for what is behind
the surface is free to shift it."""

MOST_GROWTH = 4.0
"""By so much may the noise of a side be larger than was told: where little can be matched, neighbours fill in."""

_LOG_ROOT_TAU = 0.5 * np.log(2.0 * np.pi)


@dataclass(frozen=True)
class Mixture:
    """The weighed distances.

    Attributes
    ----------
    surface, behind : ndarray, shape (n,)
        Probability of each that it is of the surface, or of something behind it.
    slope : ndarray, shape (n,)
        Derivative of the negative log-likelihood by the distance [1/m].
    log_likelihood : ndarray, shape (n,)
        Beyond that of what lies elsewhere.
    growth : ndarray, shape (n,)
        By how much the noise was taken for larger than was told.
    shares : ndarray, shape (groups + 1, 3)
        Of points behind and elsewhere in each group, and by how much its noise is larger than was told, for the next
        iteration; the last row holds the mean depth behind.
    """

    surface: FloatArray
    behind: FloatArray
    slope: FloatArray
    log_likelihood: FloatArray
    growth: FloatArray
    shares: FloatArray


def first_shares(groups: int) -> FloatArray:
    """Return the shares to begin with."""
    shares = np.tile([0.2, 0.05, 1.0], (groups + 1, 1))
    shares[-1] = 0.5
    return shares


@dataclass(frozen=True)
class _Sources:
    """How likely distances are from each source, as logarithms, shape (3, n), and from any; and what tells that."""

    logs: FloatArray
    total: FloatArray
    sigma: FloatArray
    growth: FloatArray
    depth: float
    argument: FloatArray
    tail: FloatArray


def _sources(distance: FloatArray, sigma: FloatArray, group: IntArray, shares: FloatArray) -> _Sources:
    depth = float(shares[-1, 0])
    behind, elsewhere, growth = shares[group].T
    sigma = sigma * growth
    z = distance / sigma
    argument = -(z + sigma / depth)
    tail = log_ndtr(argument)
    log_surface = -0.5 * z**2 - np.log(sigma) - _LOG_ROOT_TAU
    log_behind = distance / depth + 0.5 * (sigma / depth) ** 2 - np.log(depth) + tail
    logs = np.stack(
        [
            np.log(np.maximum(1.0 - behind - elsewhere, 1e-6)) + log_surface,
            np.log(behind) + log_behind,
            np.log(elsewhere) - np.log(ELSEWHERE_M),
        ]
    )
    highest = logs.max(axis=0)
    total = highest + np.log(np.exp(logs - highest).sum(axis=0))
    return _Sources(logs, total, sigma, growth, depth, argument, tail)


def log_likelihood(distance: FloatArray, sigma: FloatArray, group: IntArray, shares: FloatArray) -> FloatArray:
    """Return how likely distances are, shape (n,), as `weigh` has it."""
    likely: FloatArray = _sources(distance, sigma, group, shares).total + np.log(ELSEWHERE_M)
    return likely


def weigh(
    distance: FloatArray, sigma: FloatArray, group: IntArray, shares: FloatArray, worth: FloatArray | None = None
) -> Mixture:
    """Weigh distances by what they can come from, one step of expectation maximisation.

    A point of the surface is off by Gaussian noise. A line of sight that meets a window, a gap or a recess, or a match
    that bleeds to the road behind, ends an exponentially distributed depth behind the surface, with the same noise.
    Taking that for symmetric noise would pull the outline away from the sensor; trimming it, towards it.

    Parameters
    ----------
    distance, sigma : ndarray, shape (n,)
        Positive outside, metres.
    group : ndarray of int, shape (n,)
        Points that share their shares: one side in one frame.
    shares : ndarray, shape (groups + 1, 3)
        See `Mixture`.
    worth : ndarray, shape (n,)
        As how many independent points each counts for its group's shares; None: one.
    """
    sources = _sources(distance, sigma, group, shares)
    sigma, depth, growth, total = sources.sigma, sources.depth, sources.growth, sources.total
    z = distance / sigma
    of_surface, of_behind, of_elsewhere = np.exp(sources.logs - total)
    hazard = np.exp(-0.5 * sources.argument**2 - _LOG_ROOT_TAU - sources.tail)
    slope = of_surface * z / sigma + of_behind * (hazard / sigma - 1.0 / depth)
    depths = sigma * hazard - distance - sigma**2 / depth
    groups = len(shares) - 1
    worth = np.ones(len(distance)) if worth is None else worth
    update = np.empty_like(shares)
    for column, (each, most, counts) in enumerate(
        ((of_behind, 0.9, worth), (of_elsewhere, 0.5, np.ones(len(distance))))
    ):
        pooled = np.bincount(group, counts * each, groups) + TRUST * (each.mean() if len(each) else 0.1)
        update[:-1, column] = np.clip(pooled / (np.bincount(group, counts, groups) + TRUST), 1e-3, most)
    squares = of_surface * (z * growth) ** 2
    usual = squares.sum() / max(float(of_surface.sum()), 1e-9)
    variance = np.bincount(group, worth * squares, groups) + TRUST * usual
    variance /= np.bincount(group, worth * of_surface, groups) + TRUST
    update[:-1, 2] = np.sqrt(variance).clip(1.0, MOST_GROWTH)
    mean_depth = (of_behind * depths).sum() / max(float(of_behind.sum()), 1e-9)
    update[-1] = np.clip(mean_depth, MIN_DEPTH_M, MAX_DEPTH_M)
    return Mixture(of_surface, of_behind, slope, total + np.log(ELSEWHERE_M), growth, update)
