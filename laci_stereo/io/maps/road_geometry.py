"""Curves along roads: reference lines made of lines, arcs, clothoids and cubics, offset laterally, as polylines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval

from laci_stereo.core.frames import FloatArray, rotate_xy

CHORD_M = 0.02
"""Largest distance of a polyline from its curve: a fifth of the width of a painted line."""

LONGEST_M = 1e6
"""Length of the longest road."""

STEP_M = 5.0
"""Initial sampling distance: within this length, no road bends to and fro without displacing one of three points in
between."""

_FINEST = 12
_MOST_POINTS = 500_000
_MOST_TURN_RAD = 200.0
_QUADRATURE = np.polynomial.legendre.leggauss(12)
_TURN_OF_QUADRATURE_RAD = 2.0
"""Change of heading over which 12 nodes integrate a cosine to 1e-16."""


class GeometryError(ValueError):
    """A curve that no road can have; the text is the reason."""


@dataclass(frozen=True)
class Bend:
    """A piece of a reference line whose curvature changes linearly: a straight line, an arc or a clothoid.

    Attributes
    ----------
    start_m : float
        Distance of its start along the road.
    xy : tuple of float
    heading_rad : float
    length_m : float
    curvature, change : float
        Curvature at the start, 1/m, and its change per metre of length, 1/m^2.
    """

    start_m: float
    xy: tuple[float, float]
    heading_rad: float
    length_m: float
    curvature: float
    change: float

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return positions, shape (n, 2), and headings, shape (n,), at distances from the road's start.

        Positions are integrals of the unit vector along the heading, by quadrature over pieces in which the heading
        changes by at most 2 rad.

        Raises
        ------
        GeometryError
            If its heading changes by more than any road's.
        """
        turn = (abs(self.curvature) + abs(self.change) * self.length_m) * self.length_m
        if not turn <= _MOST_TURN_RAD:
            raise GeometryError(f"turns by {turn:.6g} rad; needed are at most {_MOST_TURN_RAD:g}")
        along = s - self.start_m
        count = int(np.ceil(turn / _TURN_OF_QUADRATURE_RAD)) or 1
        nodes, weights = _QUADRATURE
        shares = (np.arange(count)[:, None] + (nodes + 1.0) / 2.0).ravel() / count
        headings = self._heading(along[:, None] * shares)
        share_weights = np.tile(weights / 2.0, count) / count
        moved = np.column_stack([np.cos(headings) @ share_weights, np.sin(headings) @ share_weights])
        return np.array(self.xy) + along[:, None] * moved, self._heading(along)

    def _heading(self, along: FloatArray) -> FloatArray:
        heading: FloatArray = self.heading_rad + along * (self.curvature + along * self.change / 2.0)
        return heading


@dataclass(frozen=True)
class Cubic:
    """A piece of a reference line whose coordinates along and across its first heading are cubics of a parameter.

    Attributes
    ----------
    start_m, xy, heading_rad, length_m
        As in `Bend`.
    u, v : ndarray, shape (4,)
        Coefficients of the coordinates along and across the heading at its start, constant first.
    per_m : float
        Increment of the parameter per metre of length.
    """

    start_m: float
    xy: tuple[float, float]
    heading_rad: float
    length_m: float
    u: FloatArray
    v: FloatArray
    per_m: float

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return positions, shape (n, 2), and headings, shape (n,), at distances from the road's start."""
        p = (s - self.start_m) * self.per_m
        uv = np.array([polyval(p, self.u), polyval(p, self.v)]).T
        ahead = polyval(p, polyder(self.u)), polyval(p, polyder(self.v))
        return np.array(self.xy) + rotate_xy(self.heading_rad, uv), self.heading_rad + np.arctan2(ahead[1], ahead[0])


@dataclass(frozen=True)
class ReferenceLine:
    """The line that a road's lanes are measured from: at least one piece, in the order of their starts."""

    pieces: tuple[Bend | Cubic, ...]

    @property
    def starts_m(self) -> FloatArray:
        """The start of each piece along the road, shape (n,)."""
        return np.array([piece.start_m for piece in self.pieces])

    def beside(self, s: FloatArray, t: FloatArray) -> FloatArray:
        """Return the points, shape (n, 2), at distances s along the road and t to the left of it."""
        owner = np.clip(np.searchsorted(self.starts_m, s, side="right") - 1, 0, None)
        xy = np.empty((len(s), 2))
        for i in np.unique(owner):
            here = owner == i
            positions, headings = self.pieces[i].at(s[here])
            xy[here] = positions + t[here, None] * np.column_stack([-np.sin(headings), np.cos(headings)])
        return xy


def parameters_of_lengths(u: FloatArray, v: FloatArray, length_m: float) -> float:
    """Return the parameter u at which the curve (u, v(u)) has a given length from its start."""
    low, high = 0.0, length_m
    slope = polyder(v)
    nodes, weights = _QUADRATURE
    for _ in range(50):
        middle = (low + high) / 2.0
        at = middle * (nodes + 1.0) / 2.0
        length = middle / 2.0 * float(weights @ np.sqrt(u[1] ** 2 + polyval(at, slope) ** 2))
        low, high = (middle, high) if length < length_m else (low, middle)
    return (low + high) / 2.0


def polyline(curve: Callable[[FloatArray], FloatArray], breaks: FloatArray) -> FloatArray:
    """Sample a curve so densely that its chords deviate from it by at most `CHORD_M`.

    Parameters
    ----------
    curve : callable
        From parameters, shape (n,), to points, shape (n, 2).
    breaks : ndarray, shape (m,)
        Ascending: the ends of the curve, and in between the places where it may have corners.

    Returns
    -------
    ndarray, shape (k, 2)

    Raises
    ------
    GeometryError
        If the curve is too long or too curved for any road.
    """
    if not breaks[-1] - breaks[0] <= LONGEST_M:
        raise GeometryError(f"is {breaks[-1] - breaks[0]:.6g} m long; needed are at most {LONGEST_M:g}")
    counts = np.maximum(np.ceil(np.diff(breaks) / STEP_M), 1).astype(int)
    at = np.concatenate(
        [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(breaks, breaks[1:], counts, strict=False)]
        + [breaks[-1:]]
    )
    for _ in range(_FINEST):
        if len(at) > _MOST_POINTS:
            raise GeometryError(f"is too crooked: {len(at)} points do not follow it to {CHORD_M:g} m")
        quarters = (at[:-1, None] + np.diff(at)[:, None] * np.array([0.0, 0.25, 0.5, 0.75])).ravel()
        points = curve(np.append(quarters, at[-1]))
        far = _from_chords(points) > CHORD_M / 2.0
        if not far.any():
            break
        at = np.sort(np.append(at, quarters[2::4][far]))
    return curve(at)


def _from_chords(points: FloatArray) -> FloatArray:
    """Return the largest distance of the 3 points within each chord, shape (n,); ``points``: shape (4 n + 1, 2)."""
    starts, chords = points[:-1:4, None], np.diff(points[::4], axis=0)[:, None]
    off = points[:-1].reshape(-1, 4, 2)[:, 1:] - starts
    lengths = np.maximum((chords**2).sum(axis=2), 1e-18)
    share = np.clip((off * chords).sum(axis=2) / lengths, 0.0, 1.0)
    distance: FloatArray = np.linalg.norm(off - share[..., None] * chords, axis=2).max(axis=1)
    return distance
