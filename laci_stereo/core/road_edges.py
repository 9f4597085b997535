"""Edges of a road that nothing shows at first: behind one lies what passed for road, and is none.

A kerb that noise hides has a pavement behind it, which rises to drain to the road. In the country a verge is flush with
the road and falls away from it, to a ditch or to the land, and nothing but that tells where the road ends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import FloatArray

ON_WAY_M = 0.75
"""What is so near the way the vehicle was on itself: most are 1.5 m wide at least."""

_FARTHEST_M = 7.0
"""Edges are looked for within two lanes of the way, as crowns are: roads are no narrower than one."""

_TOWARDS_RAD = np.pi / 8 * np.arange(16)
TOWARDS = np.stack([np.cos(_TOWARDS_RAD), np.sin(_TOWARDS_RAD)])
"""An edge is straight, so far beyond the way in some direction, or runs so far beside it, on one side or on both."""

_STEP_M = 3.0
"""A kerb is as high as what is behind it rises in so much: up to 9 cm, as that rises by 3 % at most."""

_STEEPER = 4.0
"""A verge falls by so much more than a road does, which is 3 % at most: by up to 12 % (RAL 2012)."""

_VERGE_M = 2.0
"""Verges are 1.5 to 2.5 m wide; behind one the land is taken to be as level as the road. What falls on and on, and by
less than is noticed, is taken for the other side of a crown: nothing tells one from the other."""


@dataclass(frozen=True)
class Kind:
    """A kind of edges.

    Attributes
    ----------
    likely : float
        Probability that some of what passed for road is behind such a one.
    apart_m : float
        From one place of an edge to the next.
    rise : callable
        By how much what is so far behind it is raised, of shape (n, k), if a road falls by 1.
    """

    likely: float
    apart_m: float
    rise: Callable[[FloatArray], FloatArray]


def _kerb(behind_m: FloatArray) -> FloatArray:
    raised: FloatArray = np.where(behind_m > 0.0, _STEP_M + behind_m, 0.0)
    return raised


def _verge(behind_m: FloatArray) -> FloatArray:
    fallen: FloatArray = -_STEEPER * behind_m.clip(0.0, _VERGE_M)
    return fallen


KINDS = (Kind(0.1, 1.0, _kerb), Kind(0.3, 0.5, _verge))
"""Most kerbs are noticed: one road in ten has one that is not. Verges are not noticed as such, and as many roads are
taken to have them as to have a crown along the way, or one that it crosses."""


def behind_edges(left_m: FloatArray, beyond_m: FloatArray) -> list[FloatArray]:
    """Return by how much places are raised for each edge of each kind, if roads fall by 1, each of shape (n, edges).

    Parameters
    ----------
    left_m : ndarray, shape (n,)
        How far to the left of the way places are.
    beyond_m : ndarray, shape (n, 16)
        How far beyond it in each direction of `TOWARDS`.
    """
    found = []
    for kind in KINDS:
        away_m = np.arange(0.0, _FARTHEST_M + 0.1, kind.apart_m)
        straight = kind.rise((beyond_m[:, :, None] - away_m).reshape(len(left_m), -1))
        beside_m = ON_WAY_M + np.append(away_m, np.inf)
        left, right = kind.rise(left_m[:, None] - beside_m), kind.rise(-left_m[:, None] - beside_m)
        along = (left[:, :, None] + right[:, None, :]).reshape(len(left_m), -1)
        found.append(np.column_stack([straight, along[:, :-1]]))  # the last has neither
    return found
