"""Crowns of roads: the lines from which roads fall to both sides for drainage.

A crown runs along the vehicle's path, or the path crosses it, as in a turn and around a roundabout's island. Where two
roads cross, both have a crown, and the nearer of the two determines the height of a place. Terms: the *fall* is the
slope of a road away from its crown; a *straight* crown is a line in one of the directions of `_ACROSS_RAD`; a *pair* is
made of the crowns of two roads that cross.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.ground.road_edges import LANES_M, TOWARDS_RAD, towards

_ALONG_M = np.arange(-LANES_M, LANES_M + 0.1, 0.125)
"""Distances to the left of the path of crowns that run along it, within two lanes; all are equally likely."""

_CROSSED = (0.0, 0.15, 0.325, 0.5, 0.675, 0.85, 1.0)
"""Positions of straight crowns, which the path may cross, as the fraction of the visible road on one side of the crown.
If the visible road is no wider than two lanes, all of it may be on one side; each lane more halves the probability of
this, as the road itself may be that wide, or the mouth of another road may be visible as well."""

_LANE_M = LANES_M / 2

_PAST_END = 0.1
"""Factor of the probability of a crown along the path beyond the place where the road was seen to end; it is not zero,
since the kerb of an island is not the road's edge."""

_ACROSS_RAD = TOWARDS_RAD[: len(TOWARDS_RAD) // 2]
"""Directions across straight crowns, relative to that of the path: each crown has two, of which one suffices."""

_LEFT = len(_ACROSS_RAD) // 2
"""Index of the direction to the left of the path: across that one of two crossing roads which runs along the path."""

_CROSSING = np.array([0, 1, 2, -2, -1]) % len(_ACROSS_RAD)
"""Indices of the directions across the other road: along the path, and oblique by one and two steps to either side."""

_CROSSING_LIKELY = np.repeat([0.9, 0.1 / 4], [1, 4])
"""Prior probabilities of `_CROSSING`. Roads are to cross at 72 to 108 deg (RAL 2012); one crossing in ten is older than
this rule, and its oblique directions are equally likely."""

_SEEN = (0.1, 0.9)
"""Crowns of crossing roads are searched between these fractions of the visible road: with almost nothing on one side of
it a crown is not determined, and the few cells there, such as a pavement where the last rings of a scanner leave the
road, would decide alone."""

_APART_M, _SQUARES = 1.0, 16
"""Side of the squares in which crossings are searched, and the number of the most likely squares that are kept."""

_WITHIN_M = _APART_M * ((np.arange(4) + 0.5) / 4 - 0.5)
"""Coordinates of places in such a square, relative to its centre, along either side: a crown that is off by their
spacing makes the road 5 mm too high or too low."""


@dataclass(frozen=True)
class Crowns:
    """Hypotheses about the crown: exactly one single crown or one pair exists.

    Attributes
    ----------
    towards : ndarray, shape (2, directions)
        Unit vectors across straight crowns.
    at_m : ndarray, shape (k, directions)
        Distances of the straight crowns from the origin in each direction.
    crossing : ndarray of int, shape (pairs,)
        Index of the direction across one of the two roads of each pair; the other road runs along the path.
    pairs_m : ndarray, shape (pairs, 2)
        Distances of the two crowns of each pair from the origin: in that direction, and to the left of the path.
    likely : ndarray, shape (crowns,)
        Probability of each hypothesis, in the order used by all methods: crowns along the path, straight ones, pairs.
    """

    towards: FloatArray
    at_m: FloatArray
    crossing: IntArray
    pairs_m: FloatArray
    likely: FloatArray

    @staticmethod
    def of_road(off: FloatArray, along_rad: float, ends_m: tuple[float, float] = (-np.inf, np.inf)) -> Crowns:
        """Return the crowns of one road, with even odds between one along the path and a straight one.

        Within each kind the prior is uniform, apart from crowns beyond an end of the road and at an end of what is
        seen.

        Parameters
        ----------
        off : ndarray, shape (n, 2)
            Positions of the visible road relative to the origin.
        along_rad : float
            Direction of the path.
        ends_m : tuple of float
            Distances to the left of the path at which the road was seen to end on its right and on its left.
        """
        directions = towards(along_rad)[:, : len(_ACROSS_RAD)]
        at_m = np.quantile(off @ directions, _CROSSED, axis=0)
        straight = np.ones_like(at_m)
        straight[[0, -1]] = 0.5 ** ((at_m[-1] - at_m[0] - LANES_M).clip(0.0) / _LANE_M)
        right_m, left_m = ends_m
        straight[0, _LEFT] *= _PAST_END if np.isfinite(right_m) else 1.0
        straight[-1, _LEFT] *= _PAST_END if np.isfinite(left_m) else 1.0
        along = np.where((right_m < _ALONG_M) & (left_m > _ALONG_M), 1.0, _PAST_END)
        kinds = along / along.sum(), straight.ravel() / straight.sum()
        none = np.zeros(0, dtype=np.int64)
        return Crowns(directions, at_m, none, np.zeros((0, 2)), np.concatenate(kinds) / 2)

    def and_crossings(self, off: FloatArray, evidence: Callable[[FloatArray], FloatArray]) -> Crowns:
        """Return these crowns and pairs anywhere in the visible road; the pairs are as likely as either kind of crown.

        Parameters
        ----------
        off : ndarray, shape (n, 2)
            Positions of the visible road relative to the origin.
        evidence : callable
            Takes the heights that each of some pairs adds to these positions per unit fall, shape (n, pairs), and
            returns the log-likelihood with each pair, shape (pairs,).
        """
        at_m = off @ self.towards
        low, high = np.quantile(at_m, _SEEN, axis=0)
        places = [np.arange(start + _APART_M / 2, end, _APART_M) for start, end in zip(low, high, strict=True)]
        squares = [np.stack(np.meshgrid(places[way], places[_LEFT]), axis=-1).reshape(-1, 2) for way in _CROSSING]
        counts = [len(square) for square in squares]
        crossing, squares_m = np.repeat(_CROSSING, counts), np.concatenate(squares)
        likely = np.repeat(_CROSSING_LIKELY / np.maximum(counts, 1), counts)
        best = np.argsort(evidence(-_nearer_m(at_m, crossing, squares_m)) + np.log(likely))[-_SQUARES:]

        within = np.stack(np.meshgrid(_WITHIN_M, _WITHIN_M), axis=-1).reshape(-1, 2)
        each_m = squares_m[best, None] + within
        each = evidence(-_nearer_m(at_m, np.repeat(crossing[best], len(within)), each_m.reshape(-1, 2)))
        told = each.reshape(len(best), len(within))
        # The most likely place represents its square, with the average evidence of the places in it.
        pairs_m = each_m[np.arange(len(best)), told.argmax(axis=1)]
        share = np.exp(told - told.max(axis=1, keepdims=True)).mean(axis=1)
        likely = np.append(self.likely * 2.0, likely[best] * share) / 3.0
        return replace(self, crossing=crossing[best], pairs_m=pairs_m, likely=likely)

    def other_sides(self, tilts: FloatArray, off: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Return the part of the tilts that exists only because more is seen of one side of a crown than of the other.

        The plane of the road on which the path lies is the one midway between both falls, however much is seen of each
        side. A crown that the path crosses, and each crown of a pair, may have no other side; see `_likely`.

        Parameters
        ----------
        tilts : ndarray, shape (2, crowns)
            Slopes of the visible road per unit fall from each crown.
        off : ndarray, shape (n, 2)
            Positions of the visible road relative to the origin.

        Returns
        -------
        list of pairs of ndarray, shape (2, crowns) and (crowns,)
            These slopes, and the probability that the crown has another side: first across the only road or the first
            of two crossing roads, then across the second.
        """
        at_m = off @ self.towards
        low_m, high_m = at_m.min(axis=0), at_m.max(axis=0)
        along, straight, pairs = np.split(tilts, [len(_ALONG_M), len(_ALONG_M) + self.at_m.size], axis=1)

        def likely(way: IntArray, place_m: FloatArray) -> FloatArray:
            return _likely(place_m, low_m[way], high_m[way])

        every, left = np.tile(np.arange(len(low_m)), len(self.at_m)), np.full_like(self.crossing, _LEFT)
        across, across_first, across_second = (self.towards[:, way] for way in (every, self.crossing, left))
        one = across * (across * straight).sum(axis=0)
        of_one = np.where(every == _LEFT, 1.0, likely(every, self.at_m.ravel()))
        # If roads cross obliquely, the tilt is decomposed into the directions across the two of them.
        first = across_first * _cross(pairs, across_second) / _cross(across_first, across_second)
        of_first, of_second = likely(self.crossing, self.pairs_m[:, 0]), likely(left, self.pairs_m[:, 1])
        lone = along.shape[1] + straight.shape[1]
        return [
            (np.concatenate([along, one, first], axis=1), np.concatenate([np.ones(along.shape[1]), of_one, of_first])),
            (np.pad(pairs - first, ((0, 0), (lone, 0))), np.pad(of_second, (lone, 0))),
        ]

    def raised(self, off: FloatArray, left_m: FloatArray) -> FloatArray:
        """Return the height that each crown adds to places per unit fall, shape (n, crowns).

        Parameters
        ----------
        off : ndarray, shape (n, 2)
            Positions of the places relative to the origin.
        left_m : ndarray, shape (n,)
            Distances of the places to the left of the path.
        """
        at_m = off @ self.towards
        straight = (at_m[:, None] - self.at_m).reshape(len(off), -1)
        one = np.abs(np.column_stack([left_m[:, None] - _ALONG_M, straight]))
        return -np.concatenate([one, _nearer_m(at_m, self.crossing, self.pairs_m)], axis=1)


def _likely(at_m: FloatArray, low_m: FloatArray, high_m: FloatArray) -> FloatArray:
    """Return the probability that both sides of a crown are as wide as the wider visible one.

    The road is visible from ``low_m`` to ``high_m``. Each lane by which the road would then be wider than its visible
    part, and than two lanes, halves the probability.
    """
    wide_m = 2.0 * np.maximum(at_m - low_m, high_m - at_m)
    likely: FloatArray = 0.5 ** ((wide_m - np.maximum(high_m - low_m, LANES_M)).clip(0.0) / _LANE_M)
    return likely


def _cross(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the cross products of vectors of shape (2, n)."""
    product: FloatArray = one[0] * other[1] - one[1] * other[0]
    return product


def _nearer_m(at_m: FloatArray, crossing: IntArray, pairs_m: FloatArray) -> FloatArray:
    """Return the distance of places from the nearer crown of each pair, shape (n, pairs).

    ``at_m``, shape (n, directions), are the places' distances from the origin in each direction.
    """
    aside: FloatArray = np.abs(at_m[:, crossing] - pairs_m[:, 0])
    return np.minimum(aside, np.abs(at_m[:, [_LEFT]] - pairs_m[:, 1]), out=aside)
