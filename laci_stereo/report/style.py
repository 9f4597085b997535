"""Colours and line styles common to all pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from laci_stereo.io.maps.lane_map import LaneLine, LaneMap

Colour: TypeAlias = tuple[int, int, int]
"""Blue, green, red."""

# Palette of Okabe and Ito: distinguishable with all kinds of colour vision, and ordered by lightness in a grey print.
BLACK: Colour = (0, 0, 0)
BLUE: Colour = (178, 114, 0)
VERMILLION: Colour = (0, 94, 213)
PURPLE: Colour = (167, 121, 204)
SKY_BLUE: Colour = (233, 180, 86)
YELLOW: Colour = (66, 228, 240)
WHITE: Colour = (255, 255, 255)
GREY: Colour = (120, 120, 120)
LIGHT_GREY: Colour = (215, 215, 215)
NIGHT: Colour = (25, 25, 25)

VIRTUAL = "virtual"
THICK_KINDS = ("stop_line", "line_thick")
THICK, THIN = 1.6, 0.5
DASH = (9.0, 7.0)
VIRTUAL_DASH = (3.0, 5.0)


@dataclass(frozen=True)
class Stroke:
    """Style of a line; lengths are in units of the canvas (`Canvas.unit_px`).

    Attributes
    ----------
    colour : tuple of int
    width : float
    dash : tuple of float or None
        Length of a dash and of the gap after it; None for a solid line.
    halo : bool
        Whether a rim sets the line off from the background.
    """

    colour: Colour
    width: float
    dash: tuple[float, float] | None = None
    halo: bool = True


def lane_strokes(lane_map: LaneMap | None, colour: Colour, width: float) -> list[tuple[LaneLine, Stroke]]:
    """Return every line of a map with its stroke, in drawing order; ``width`` is that of an ordinary line.

    Lines look as they do on the road. Virtual lines, which are not painted on the road, are thin and dotted, and drawn
    below the others, with which they often coincide.
    """
    lines = lane_map.lines if lane_map is not None else ()
    strokes = [(line, _lane_stroke(line, colour, width)) for line in lines]
    return sorted(strokes, key=lambda item: item[0].kind != VIRTUAL)


def look_of(line: LaneLine) -> Literal["virtual", "dashed", "thick", "thin"]:
    """Return the style-sheet class with which a line is drawn."""
    if line.kind == VIRTUAL:
        return "virtual"
    if line.subtype == "dashed":
        return "dashed"
    return "thick" if line.kind in THICK_KINDS else "thin"


def _lane_stroke(line: LaneLine, colour: Colour, width: float) -> Stroke:
    if line.kind == VIRTUAL:
        return Stroke(colour, THIN * width, VIRTUAL_DASH, halo=False)
    dash = DASH if line.subtype == "dashed" else None
    return Stroke(colour, (THICK if line.kind in THICK_KINDS else 1.0) * width, dash)
