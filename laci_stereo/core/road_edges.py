"""Edges of a road that nothing shows at first: behind one lies what passed for road, and is none.

A kerb that noise hides has a pavement behind it, which rises to drain to the road. In the country a verge is flush with
the road and falls away from it, to a ditch or to the land, and nothing but that tells where the road ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import FloatArray, IntArray

ON_WAY_M = 0.75
"""What is so near the way the vehicle was on itself: most are 1.5 m wide at least."""

LANES_M = 7.0
"""Edges are looked for within two lanes of the way, as crowns are: roads are no narrower than one."""

TOWARDS_RAD = np.pi / 8 * np.arange(16)
"""From the way's direction, those in which straight edges are looked for."""

_AWAY_M = np.arange(0.0, LANES_M + 0.1, 0.5)
_BESIDE_M = ON_WAY_M + np.append(_AWAY_M, np.inf)
_PLACES = len(TOWARDS_RAD) * len(_AWAY_M) + len(_BESIDE_M) ** 2 - 1
"""An edge is straight, so far beyond the way in some direction, or runs so far beside it, on one side or on both. Each
of these places is as likely."""

VERGES_M = (1.5, 2.5)
"""Verges are as wide, and `EDGES` have the mean."""

_VERGE_M = sum(VERGES_M) / 2

_LIKELY = (0.1, 0.3)
"""Of kerbs and of verges. Most kerbs are noticed: one road in ten has one that is not. Verges are not noticed as such:
as many roads are taken to have one."""


@dataclass(frozen=True)
class Edges:
    """What is known of edges beforehand.

    Attributes
    ----------
    likely : ndarray, shape (edges,)
        Probability of each.
    mean, sigma : ndarray, shape (edges, 2)
        How much what is behind it is raised in each of two ways, see `behind_edges`, and its standard deviation.
    """

    likely: FloatArray
    mean: FloatArray
    sigma: FloatArray

    def __len__(self) -> int:
        return len(self.likely)

    def only(self, there: IntArray) -> Edges:
        """Return none and some of the others: with nothing behind it, an edge is as good as none."""
        likely = self.likely[there]
        return Edges(
            np.append(1.0 - likely.sum(), likely),
            np.concatenate([self.mean[:1], self.mean[there]]),
            np.concatenate([self.sigma[:1], self.sigma[there]]),
        )


NO_EDGE = Edges(np.ones(1), np.zeros((1, 2)), np.ones((1, 2)))

EDGES = Edges(
    np.repeat([1.0 - sum(_LIKELY), *np.divide(_LIKELY, _PLACES)], (1, _PLACES, _PLACES)),
    np.repeat([(0.0, 0.0), (0.08, 0.02), (-0.06, 0.0)], (1, _PLACES, _PLACES), axis=0),
    np.repeat([(1.0, 1.0), (0.04, 0.02), (0.02, 0.03)], (1, _PLACES, _PLACES), axis=0),
)
"""None, and a kerb and a verge at each place. Kerbs are 3 to 15 cm high, and pavements rise from them by up to 3 % to
drain to the road. Verges fall by 6 to 12 % (RAL 2012), away from roads that do so by up to 2.5 % or rise: by 2 to 10 %
more. The land behind them rises or falls."""


def towards(along_rad: float) -> FloatArray:
    """Return the directions in which straight edges are looked for, shape (2, 16), given one along the way.

    Roads cross one another at right angles more often than not, so that edges are along the way or across it.
    """
    angle = along_rad + TOWARDS_RAD
    return np.stack([np.cos(angle), np.sin(angle)])


def behind_edges(left_m: FloatArray, beyond_m: FloatArray) -> FloatArray:
    """Return by how much places are raised behind each of `EDGES`, in two ways, of shape (n, edges, 2).

    Behind a kerb these are its height and how far behind it they are, behind a verge how far they are on it and beyond.

    Parameters
    ----------
    left_m : ndarray, shape (n,)
        How far to the left of the way places are.
    beyond_m : ndarray, shape (n, 16)
        How far beyond it in each direction of `towards`.
    """
    straight = (beyond_m[:, :, None] - _AWAY_M).reshape(len(left_m), -1)
    left, right = left_m[:, None, None] - _BESIDE_M[:, None], -left_m[:, None, None] - _BESIDE_M
    along = np.maximum(left, right).reshape(len(left_m), -1)[:, :-1]  # the last is on neither side
    behind_m = np.column_stack([straight, along]).clip(0.0)
    raised = np.zeros((len(left_m), 1 + 2 * _PLACES, 2))
    kerbs, verges = np.split(raised[:, 1:], 2, axis=1)
    kerbs[:, :, 0], kerbs[:, :, 1] = behind_m > 0.0, behind_m
    verges[:, :, 0] = behind_m.clip(max=_VERGE_M)
    verges[:, :, 1] = behind_m - verges[:, :, 0]
    return raised
