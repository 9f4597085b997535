"""Edges of a road that were not detected at first, so that the surface behind them was mistaken for road.

A kerb that noise hides has a pavement behind it, which rises from the road so that it drains to the road. In the
country a verge is flush with the road and falls away from it, to a ditch or to the terrain, and only this fall shows
where the road ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import FloatArray, IntArray

ON_WAY_M = 0.75
"""Half of the width that the vehicle itself covered along its path: most vehicles are at least 1.5 m wide."""

LANES_M = 7.0
"""Edges and crowns are searched within two lanes of the path; no road is narrower than one lane."""

TOWARDS_RAD = np.pi / 8 * np.arange(16)
"""Directions in which straight edges are searched, relative to that of the path."""

_AWAY_M = np.arange(0.0, LANES_M + 0.1, 0.5)
_BESIDE_M = ON_WAY_M + np.append(_AWAY_M, np.inf)
_PLACES = len(TOWARDS_RAD) * len(_AWAY_M) + len(_BESIDE_M) ** 2 - 1
"""Number of places of an edge. It is straight, at one of the distances `_AWAY_M` beyond the path in one of the
directions `TOWARDS_RAD`, or it runs beside the path at one of the distances `_BESIDE_M`, on one side or on both. All
places are equally likely."""

VERGES_M = (1.5, 2.5)
"""Least and largest width of a verge; `EDGES` have the mean."""

_VERGE_M = sum(VERGES_M) / 2

_LIKELY = (0.1, 0.3)
"""Prior probabilities of an undetected kerb and of a verge. Most kerbs are detected: one road in ten has a kerb that is
not. Verges are not detected as such: three roads in ten are assumed to have one."""


@dataclass(frozen=True)
class Edges:
    """Prior of edges.

    Attributes
    ----------
    likely : ndarray, shape (edges,)
        Probability of each edge; the first one is "no edge".
    mean, sigma : ndarray, shape (edges, 2)
        Mean and standard deviation of the two parameters of the surface behind each edge; see `behind_edges`.
    """

    likely: FloatArray
    mean: FloatArray
    sigma: FloatArray

    def __len__(self) -> int:
        return len(self.likely)

    def only(self, chosen: IntArray) -> Edges:
        """Return "no edge" and the edges ``chosen``: an edge without cells behind it is equivalent to no edge."""
        likely = self.likely[chosen]
        return Edges(
            np.append(1.0 - likely.sum(), likely),
            np.concatenate([self.mean[:1], self.mean[chosen]]),
            np.concatenate([self.sigma[:1], self.sigma[chosen]]),
        )


NO_EDGE = Edges(np.ones(1), np.zeros((1, 2)), np.ones((1, 2)))

EDGES = Edges(
    np.repeat([1.0 - sum(_LIKELY), *np.divide(_LIKELY, _PLACES)], (1, _PLACES, _PLACES)),
    np.repeat([(0.0, 0.0), (0.08, 0.02), (-0.06, 0.0)], (1, _PLACES, _PLACES), axis=0),
    np.repeat([(1.0, 1.0), (0.04, 0.02), (0.02, 0.03)], (1, _PLACES, _PLACES), axis=0),
)
"""No edge, a kerb at each place, and a verge at each place. Kerbs are 3 to 15 cm high, and pavements rise from them by
up to 3 % to drain to the road. Verges fall by 6 to 12 % (RAL 2012), away from roads that fall by up to 2.5 % or rise,
and thus by 2 to 10 % more than the road. The terrain behind verges rises or falls."""


def towards(along_rad: float) -> FloatArray:
    """Return unit vectors of the directions in which straight edges are searched, shape (2, 16).

    ``along_rad`` is the direction of the path. Most roads cross one another at right angles, so that edges run along
    the path or across it.
    """
    angle = along_rad + TOWARDS_RAD
    return np.stack([np.cos(angle), np.sin(angle)])


def behind_edges(left_m: FloatArray, beyond_m: FloatArray) -> FloatArray:
    """Return the derivatives of places' heights by the two parameters of each of `EDGES`, shape (n, edges, 2).

    The parameters of a kerb are its height and the slope behind it, with the derivatives 1 and the distance behind the
    kerb. Those of a verge are its slope and that of the terrain behind it, with the distances on the verge and beyond
    it.

    Parameters
    ----------
    left_m : ndarray, shape (n,)
        Distances of the places to the left of the path.
    beyond_m : ndarray, shape (n, 16)
        Distances of the places beyond the path in each direction of `towards`.
    """
    straight = (beyond_m[:, :, None] - _AWAY_M).reshape(len(left_m), -1)
    left, right = left_m[:, None, None] - _BESIDE_M[:, None], -left_m[:, None, None] - _BESIDE_M
    along = np.maximum(left, right).reshape(len(left_m), -1)[:, :-1]  # the last place is an edge on neither side
    behind_m = np.column_stack([straight, along]).clip(0.0)
    raised = np.zeros((len(left_m), 1 + 2 * _PLACES, 2))
    kerbs, verges = np.split(raised[:, 1:], 2, axis=1)
    kerbs[:, :, 0], kerbs[:, :, 1] = behind_m > 0.0, behind_m
    verges[:, :, 0] = behind_m.clip(max=_VERGE_M)
    verges[:, :, 1] = behind_m - verges[:, :, 0]
    return raised
