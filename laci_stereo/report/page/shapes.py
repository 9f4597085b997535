"""Points and lines as SVG path data."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import FloatArray


@dataclass(frozen=True)
class Part:
    """Lines of one style.

    Attributes
    ----------
    look : str
        Class of the style sheet.
    d : str
        SVG path data.
    tip : str
        Tooltip; may be empty.
    """

    look: str
    d: str
    tip: str = ""


@dataclass(frozen=True)
class Layer:
    """Parts that are shown or hidden together.

    Attributes
    ----------
    key : str
    label : str
        Name for the reader.
    parts : tuple of Part
    shown : bool
        Whether it is visible initially.
    """

    key: str
    label: str
    parts: tuple[Part, ...]
    shown: bool = True


@dataclass(frozen=True)
class Label:
    """Text at a position of the picture, displaced by a number of screen pixels to the right and downwards."""

    x: float
    y: float
    text: str
    aside_px: float = 0.0
    below_px: float = 0.0


def lines(pieces: Iterable[FloatArray], digits: int = 1, closed: bool = False) -> str:
    """Return polylines through points, shape (n, 2) each, as SVG path data."""
    end = "Z" if closed else ""
    return "".join("M" + "L".join(_pairs(piece, digits)) + end for piece in pieces if len(piece))


def dots(points: FloatArray, digits: int = 1) -> str:
    """Return points, shape (n, 2), as SVG lines of length zero, which round line caps turn into dots of any size."""
    return "".join(f"M{pair}h0" for pair in _pairs(points, digits))


def thinned(points: FloatArray, most: int) -> FloatArray:
    """Return at most ``most`` of the points, shape (n, ...), uniformly spaced."""
    kept: FloatArray = points[:: max(1, -(-len(points) // most))]
    return kept


def _pairs(points: FloatArray, digits: int) -> list[str]:
    rounded = np.round(points, digits) + 0.0  # turns -0.0 into 0.0
    return [f"{x:.{digits}f} {y:.{digits}f}" for x, y in rounded.tolist()]
