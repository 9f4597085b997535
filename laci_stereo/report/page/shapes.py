"""Points and lines as the data of SVG paths."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import FloatArray


@dataclass(frozen=True)
class Part:
    """Lines that look alike.

    Attributes
    ----------
    look : str
        The class that the style sheet knows.
    d : str
        The path's data.
    tip : str
        What is said where the pointer rests on it; may be empty.
    """

    look: str
    d: str
    tip: str = ""


@dataclass(frozen=True)
class Layer:
    """What is shown or hidden as one.

    Attributes
    ----------
    key : str
    label : str
        What people call it.
    parts : tuple of Part
    shown : bool
        At first.
    """

    key: str
    label: str
    parts: tuple[Part, ...]
    shown: bool = True


@dataclass(frozen=True)
class Label:
    """Type beside a place of the picture, by so many pixels of the screen."""

    x: float
    y: float
    text: str
    aside_px: float = 0.0
    below_px: float = 0.0


def lines(pieces: Iterable[FloatArray], digits: int = 1, closed: bool = False) -> str:
    """Return lines through points, shape (n, 2) each, as a path's data."""
    end = "Z" if closed else ""
    return "".join("M" + "L".join(_pairs(piece, digits)) + end for piece in pieces if len(piece))


def dots(points: FloatArray, digits: int = 1) -> str:
    """Return points, shape (n, 2), as lines without a length: with round ends they are dots of any size on screen."""
    return "".join(f"M{pair}h0" for pair in _pairs(points, digits))


def thinned(points: FloatArray, most: int) -> FloatArray:
    """Return at most so many points, shape (n, ...), spread evenly."""
    kept: FloatArray = points[:: max(1, -(-len(points) // most))]
    return kept


def _pairs(points: FloatArray, digits: int) -> list[str]:
    rounded = np.round(points, digits) + 0.0  # no minus zero
    return [f"{x:.{digits}f} {y:.{digits}f}" for x, y in rounded.tolist()]
