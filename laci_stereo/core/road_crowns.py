"""Crowns of roads, from which they fall to both sides so that they drain.

One runs along the way, or the way crosses it, as in a turn and around a roundabout's island. Where two roads cross,
both have one, and each place is as high as the nearer of them makes it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.road_edges import LANES_M, TOWARDS_RAD, towards

_ALONG_M = np.arange(-LANES_M, LANES_M + 0.1, 0.125)
"""How far to the left of the way a crown along it is, within two lanes: all are as likely."""

_CROSSED = (0.0, 0.15, 0.325, 0.5, 0.675, 0.85, 1.0)
"""Crowns that the way crosses are straight: which shares of what is seen are on one side of one. Of what is no wider
than two lanes that may be all; for each lane more that is half as likely, as the road is so wide, or another one's
mouth is seen as well."""

_LANE_M = LANES_M / 2

_PAST_END = 0.1
"""Beyond where a road was seen to end, along the way, a crown is as much less likely: the kerb of an island is none of
the road's."""

_ACROSS_RAD = TOWARDS_RAD[: len(TOWARDS_RAD) // 2]
"""Directions across straight crowns, from that of the way: each crown has two, of which one is enough."""

_LEFT = len(_ACROSS_RAD) // 2
"""That to the left of the way, across one of two roads that cross."""

_CROSSING = np.array([0, 1, 2, -2, -1]) % len(_ACROSS_RAD)
"""Those across the other: along the way, and askew by one and two steps to either side."""

_CROSSING_LIKELY = np.repeat([0.9, 0.1 / 4], [1, 4])
"""Roads are to cross at 72 to 108 deg (RAL 2012); one crossing in ten is older than that. All others are as likely."""

_SEEN = (0.1, 0.9)
"""Between these shares of what is seen roads cross: with next to nothing on one side of it, a crown tells nothing, and
the little that is there, such as a pavement where the last rings of a scanner leave the road, would tell all."""

_APART_M, _SQUARES = 1.0, 16
"""How large the squares are in which crossings are looked for, and in how many of them, the likeliest, one is."""

_WITHIN_M = _APART_M * ((np.arange(4) + 0.5) / 4 - 0.5)
"""Places in such a square, along either side of it: where the crown is off by as much as one of them is from the next,
the road is 5 mm too high or too low."""


@dataclass(frozen=True)
class Crowns:
    """Where crowns may be: one of them is there, or one pair.

    Attributes
    ----------
    towards : ndarray, shape (2, directions)
        Unit vectors across straight crowns.
    at_m : ndarray, shape (k, directions)
        How far from the origin in each direction these are.
    crossing : ndarray of int, shape (pairs,)
        Where two roads cross: the direction across one of them; the other is along the way.
    pairs_m : ndarray, shape (pairs, 2)
        How far from the origin in that direction, and to the left of the way, their crowns are.
    likely : ndarray, shape (crowns,)
        Probability of each: of those along the way, of straight ones, and of pairs.
    """

    towards: FloatArray
    at_m: FloatArray
    crossing: IntArray
    pairs_m: FloatArray
    likely: FloatArray

    @staticmethod
    def of_road(off: FloatArray, along_rad: float, ends_m: tuple[float, float] = (-np.inf, np.inf)) -> Crowns:
        """Return those of one road: one that is along the way is as likely as a straight one, and all of each kind are.

        Parameters
        ----------
        off : ndarray, shape (n, 2)
            What is seen of it, from the origin.
        along_rad : float
            Direction of the way.
        ends_m : tuple of float
            How far to the left of the way the road was seen to end on its right and on its left.
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
        """Return the same and pairs, anywhere in what is seen: they are as likely as either kind of one road's.

        Parameters
        ----------
        off : ndarray, shape (n, 2)
            What is seen.
        evidence : callable
            Takes by how much each of some pairs raises that if roads fall by 1, shape (n, pairs), and returns how
            likely it is with each, as a logarithm.
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
        # The likeliest place stands for its square, with as much evidence as its places have on average.
        pairs_m = each_m[np.arange(len(best)), told.argmax(axis=1)]
        share = np.exp(told - told.max(axis=1, keepdims=True)).mean(axis=1)
        likely = np.append(self.likely * 2.0, likely[best] * share) / 3.0
        return replace(self, crossing=crossing[best], pairs_m=pairs_m, likely=likely)

    def other_sides(self, tilts: FloatArray, off: FloatArray) -> list[tuple[FloatArray, FloatArray]]:
        """Return what of the tilts there is only since more was seen of one side of a crown than of the other.

        The plane of the road that the way is on is the one between both of its falls, however much is seen of each. A
        crown that the way crosses, and both where roads cross, may have no other side; see `_likely`.

        Parameters
        ----------
        tilts : ndarray, shape (2, crowns)
            Slopes of what is seen if roads fall by 1 from each crown.
        off : ndarray, shape (n, 2)
            What is seen, from the origin.

        Returns
        -------
        list of pairs of ndarray, shape (2, crowns) and (crowns,)
            Across the first of the roads that cross, or the only one, and across the second: such slopes, and how
            likely the other side is there.
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
        # Of roads that cross askew, each has the part of the tilt that the other's direction does not make up.
        first = across_first * _cross(pairs, across_second) / _cross(across_first, across_second)
        of_first, of_second = likely(self.crossing, self.pairs_m[:, 0]), likely(left, self.pairs_m[:, 1])
        lone = along.shape[1] + straight.shape[1]
        return [
            (np.concatenate([along, one, first], axis=1), np.concatenate([np.ones(along.shape[1]), of_one, of_first])),
            (np.pad(pairs - first, ((0, 0), (lone, 0))), np.pad(of_second, (lone, 0))),
        ]

    def raised(self, off: FloatArray, left_m: FloatArray) -> FloatArray:
        """Return how high each makes places if roads fall by 1, shape (n, crowns).

        Parameters
        ----------
        off : ndarray, shape (n, 2)
            From the origin.
        left_m : ndarray, shape (n,)
            How far to the left of the way they are.
        """
        at_m = off @ self.towards
        straight = (at_m[:, None] - self.at_m).reshape(len(off), -1)
        one = np.abs(np.column_stack([left_m[:, None] - _ALONG_M, straight]))
        return -np.concatenate([one, _nearer_m(at_m, self.crossing, self.pairs_m)], axis=1)


def _likely(at_m: FloatArray, low_m: FloatArray, high_m: FloatArray) -> FloatArray:
    """Return how likely both sides of a crown are as wide as the wider one of what is seen, from low to high.

    Each lane that the road had to be wider for that than it was seen, and than two lanes, makes it half as likely.
    """
    wide_m = 2.0 * np.maximum(at_m - low_m, high_m - at_m)
    likely: FloatArray = 0.5 ** ((wide_m - np.maximum(high_m - low_m, LANES_M)).clip(0.0) / _LANE_M)
    return likely


def _cross(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the cross products of vectors of shape (2, n)."""
    product: FloatArray = one[0] * other[1] - one[1] * other[0]
    return product


def _nearer_m(at_m: FloatArray, crossing: IntArray, pairs_m: FloatArray) -> FloatArray:
    """Return how far places, `at_m` in each direction, are from the nearer crown of each pair, shape (n, pairs)."""
    aside: FloatArray = np.abs(at_m[:, crossing] - pairs_m[:, 0])
    return np.minimum(aside, np.abs(at_m[:, [_LEFT]] - pairs_m[:, 1]), out=aside)
