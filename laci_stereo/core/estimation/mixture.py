"""The mixture model of distances from the outline: from its surface, from something behind it, or from anything else.

The fractions of the mixture are estimated per group of points, which is one side in one frame. The noise of a group may
be larger than stated by a factor, its growth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from laci_stereo.core.frames import FloatArray, IntArray

ELSEWHERE_M = 5.0
"""Width of the uniform distribution of points that are neither from the surface nor from behind it: they lie anywhere
in a cluster, which is about as long as a car."""

MIN_DEPTH_M, MAX_DEPTH_M = 0.05, 3.0
TRUST = 20.0
"""Number of independent points as which the whole drive's fractions count in the estimate of one group's. A group never
has more than a few independent points, since their noise is correlated: a frame in which noise can pass for something
behind the surface is free to shift it."""

MOST_GROWTH = 4.0
"""Largest factor by which the noise of a side may exceed the stated noise: where little can be matched, values are
filled in from neighbours."""

_LOG_ROOT_TAU = 0.5 * np.log(2.0 * np.pi)


@dataclass(frozen=True)
class Mixture:
    """The weighted distances.

    Attributes
    ----------
    surface, behind : ndarray, shape (n,)
        Probability of each that it is from the surface, or from something behind it.
    slope : ndarray, shape (n,)
        Derivative of the negative log-likelihood by the distance [1/m].
    log_likelihood : ndarray, shape (n,)
        Log-likelihood ratio over a distance from anywhere else.
    growth : ndarray, shape (n,)
        Factor by which the stated noise was multiplied.
    shares : ndarray, shape (groups + 1, 3)
        For the next iteration: in each group the fractions of points behind the surface and elsewhere, and the factor
        by which its noise exceeds the stated noise; the last row holds the mean depth behind the surface, metres.
    """

    surface: FloatArray
    behind: FloatArray
    slope: FloatArray
    log_likelihood: FloatArray
    growth: FloatArray
    shares: FloatArray


def first_shares(groups: int) -> FloatArray:
    """Return the initial fractions, factors and depth, shape (groups + 1, 3), see `Mixture`."""
    shares = np.tile([0.2, 0.05, 1.0], (groups + 1, 1))
    shares[-1] = 0.5
    return shares


@dataclass(frozen=True)
class _Sources:
    """Log-likelihoods of distances by source, shape (3, n), and in total, with the quantities used to compute them."""

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
    """Return the log-likelihood of distances, shape (n,), as defined by `Mixture`."""
    likely: FloatArray = _sources(distance, sigma, group, shares).total + np.log(ELSEWHERE_M)
    return likely


def weigh(
    distance: FloatArray, sigma: FloatArray, group: IntArray, shares: FloatArray, worth: FloatArray | None = None
) -> Mixture:
    """Weigh distances by their possible sources, in one step of expectation maximisation.

    A point from the surface has Gaussian noise. A line of sight that meets a window, a gap or a recess, or a match that
    bleeds into the road behind, ends at an exponentially distributed depth behind the surface, with the same noise.
    Treating this as symmetric noise would pull the outline away from the sensor; trimming it, towards it.

    Parameters
    ----------
    distance, sigma : ndarray, shape (n,)
        Distances, positive outside the outline, and their stated standard deviations, metres.
    group : ndarray of int, shape (n,)
        Groups of points with common fractions: one side in one frame.
    shares : ndarray, shape (groups + 1, 3)
        See `Mixture`.
    worth : ndarray, shape (n,)
        Number of independent points as which each point counts for its group's fractions; None: one.
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
