"""Drawing with halos and outline fonts, in sizes that scale with the picture."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal, TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from laci_stereo.core.frames import FloatArray, Raster
from laci_stereo.report.lines import dashes
from laci_stereo.report.style import Colour, Stroke

Rect: TypeAlias = tuple[float, float, float, float]
"""Left, top, right, bottom, pixels."""

Align: TypeAlias = Literal["left", "centre", "right"]
Mark: TypeAlias = Literal["line", "box", "dot", "area"]

UNITS = 960.0
"""Geometric mean of a picture's sides in units: one unit is a pixel of a picture of 1280 x 720."""

TEXT = 22.0
"""Font size in units: 5 pt where a picture of 1280 x 720 fills a column of 88 mm."""

TEXT_WEIGHT, BOLD_WEIGHT = 450, 650
CAPITAL = 0.7
"""Height of a capital letter, as a fraction of the font size."""

LINE_HEIGHT = 1.45
"""Distance between lines of text, as a multiple of the font size."""

PANEL_SHARE = 0.62
"""Opacity of the panels behind text."""

MARGIN = 14.0
"""Distance between a panel, its contents and the picture's border, units."""

HALO = 1.1
"""Width of a halo on either side of a line, units."""

SUBPIXEL_BITS = 4

_FONT = cv2.FontFace("sans")


@dataclass(frozen=True)
class Entry:
    """A line of a legend."""

    label: str
    mark: Mark
    stroke: Stroke


class Canvas:
    """A picture to draw on.

    Coordinates are in pixels, with (0, 0) in the middle of the upper left pixel; sizes are in units, see `UNITS`.

    Parameters
    ----------
    image : ndarray
        Grey or blue-green-red, 8 or 16 bit. It is copied.
    halo : tuple of int
        Colour of the rim around lines and text that sets them off from the background.

    Attributes
    ----------
    image : ndarray of uint8, shape (h, w, 3)
        Blue, green, red.
    unit_px : float
        Pixels per unit.
    """

    def __init__(self, image: Raster, halo: Colour) -> None:
        self.image = as_bgr8(image)
        self.halo = halo
        self.unit_px = float(np.sqrt(self.width * self.height)) / UNITS

    @property
    def width(self) -> int:
        """Width of the picture, pixels."""
        return int(self.image.shape[1])

    @property
    def height(self) -> int:
        """Height of the picture, pixels."""
        return int(self.image.shape[0])

    def lines(self, pieces: Sequence[FloatArray], stroke: Stroke, closed: bool = False) -> None:
        """Draw polylines, shape (n, 2) each, with all halos below all lines."""
        self.layers([(pieces, stroke)], closed)

    def layers(self, layers: Sequence[tuple[Sequence[FloatArray], Stroke]], closed: bool = False) -> None:
        """Draw groups of polylines, shape (n, 2) each: the last group on top, but all halos below all lines."""
        fixed = [self._in_dashes(pieces, stroke) for pieces, stroke in layers]
        for pieces, (_, stroke) in zip(fixed, layers, strict=True):
            if stroke.halo:
                rim = max(self._px(stroke.width + 2 * HALO), self._px(stroke.width) + 2)
                cv2.polylines(self.image, pieces, closed, self.halo, rim, cv2.LINE_AA, SUBPIXEL_BITS)
        for pieces, (_, stroke) in zip(fixed, layers, strict=True):
            cv2.polylines(self.image, pieces, closed, stroke.colour, self._px(stroke.width), cv2.LINE_AA, SUBPIXEL_BITS)

    def dots(self, pixels: FloatArray, colour: Colour, radius: float) -> None:
        """Draw filled circles around points, shape (n, 2), with all halos below all circles."""
        core = radius * self.unit_px
        for shade, radius_px in ((self.halo, core + max(HALO * self.unit_px, 1.0)), (colour, core)):
            fixed_radius = int(radius_px * 2**SUBPIXEL_BITS)
            for x, y in _fixed(pixels).tolist():
                cv2.circle(self.image, (x, y), fixed_radius, shade, cv2.FILLED, cv2.LINE_AA, SUBPIXEL_BITS)

    def area(self, corners: FloatArray, colour: Colour) -> None:
        """Fill a convex polygon, shape (n, 2)."""
        cv2.fillConvexPoly(self.image, _fixed(corners), colour, cv2.LINE_AA, SUBPIXEL_BITS)

    def specks(self, pixels: FloatArray, colour: Colour) -> None:
        """Draw many points, shape (n, 2), as squares of one unit."""
        side = self._px(1.0)
        # The canvas ends at whole pixels; what lies beyond them is dropped.
        columns, rows = np.rint(pixels - (side - 1) / 2).astype(int).T
        for dx in range(side):
            for dy in range(side):
                x, y = columns + dx, rows + dy
                seen = (x >= 0) & (x < self.width) & (y >= 0) & (y < self.height)
                self.image[y[seen], x[seen]] = colour

    def text(
        self,
        text: str,
        at: tuple[float, float],
        colour: Colour,
        *,
        align: Align = "left",
        size: float = TEXT,
        bold: bool = False,
    ) -> None:
        """Write a line of text.

        Parameters
        ----------
        text : str
        at : tuple of float
            Pixel at half the height of a capital letter and, by ``align``, at the left end, the middle or the right end
            of the line.
        colour : tuple of int
        align : {"left", "centre", "right"}
        size : float
            Font size, units.
        bold : bool
        """
        size_px, weight = self._px(size), BOLD_WEIGHT if bold else TEXT_WEIGHT
        left = at[0] - {"left": 0.0, "centre": 0.5, "right": 1.0}[align] * self.text_width(text, size, bold)
        x, y = round(left), round(at[1] + CAPITAL * size_px / 2)
        rim = max(round(HALO * self.unit_px), 1)
        for dx, dy in ((-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)):
            cv2.putText(self.image, text, (x + rim * dx, y + rim * dy), self.halo, _FONT, size_px, weight)
        cv2.putText(self.image, text, (x, y), colour, _FONT, size_px, weight)

    def text_width(self, text: str, size: float = TEXT, bold: bool = False) -> float:
        """Return the width of a line of text, pixels."""
        weight = BOLD_WEIGHT if bold else TEXT_WEIGHT
        return float(cv2.getTextSize((0, 0), text, (0, 0), _FONT, self._px(size), weight)[2])

    def fitting(self, text: str, width_px: float, size: float = TEXT) -> float:
        """Return the font size, at most ``size``, at which a line of text is at most ``width_px`` wide."""
        share = min(1.0, width_px / max(self.text_width(text, size), 1.0))
        return max(int(self._px(size) * share), 1) / self.unit_px if share < 1.0 else size

    def legend(self, entries: Sequence[Entry], at: tuple[float, float], colour: Colour) -> None:
        """Draw a legend with its upper left corner at a pixel; ``colour`` is that of the text."""
        step = LINE_HEIGHT * TEXT * self.unit_px
        for row, entry in enumerate(entries):
            middle = at[1] + (row + 0.5) * step
            self._swatch(entry, (at[0], middle - 0.3 * step, at[0] + self._swatch_px, middle + 0.3 * step))
            self.text(entry.label, (at[0] + self._swatch_px + 0.5 * TEXT * self.unit_px, middle), colour)

    def legend_size(self, entries: Sequence[Entry]) -> tuple[float, float]:
        """Return a legend's width and height, pixels."""
        widest = max((self.text_width(entry.label) for entry in entries), default=0.0)
        width = self._swatch_px + 0.5 * TEXT * self.unit_px + widest
        return width, len(entries) * LINE_HEIGHT * TEXT * self.unit_px

    @property
    def caption_top(self) -> float:
        """Upper edge of the panel of a caption, pixels."""
        return self.height - LINE_HEIGHT * 1.2 * TEXT * self.unit_px

    def caption(self, text: str, colour: Colour) -> None:
        """Write a line on a panel along the lower border, smaller if it is too long."""
        margin = MARGIN * self.unit_px
        self.shade((0, self.caption_top, self.width, self.height), PANEL_SHARE)
        size = self.fitting(text, self.width - 2 * margin)
        self.text(text, (margin, (self.caption_top + self.height) / 2), colour, size=size)

    def legend_panel(self, entries: Sequence[Entry], occupied: Sequence[FloatArray], colour: Colour) -> None:
        """Draw a legend on a panel in a corner above the caption, where it hides least, see `emptiest_corner`."""
        margin = MARGIN * self.unit_px
        width, height = (extent + 2 * margin for extent in self.legend_size(entries))
        left, top = emptiest_corner((width, height), (0.0, 0.0, self.width, self.caption_top), occupied)
        self.shade((left, top, left + width, top + height), PANEL_SHARE)
        self.legend(entries, (left + margin, top + margin), colour)

    def shade(self, rect: Rect, share: float) -> None:
        """Blend a rectangle with the halo's colour, which gets the weight ``share``, so that text on it is legible."""
        left, top, right, bottom = (max(round(edge), 0) for edge in rect)
        part = self.image[top:bottom, left:right]
        part[:] = cv2.addWeighted(part, 1 - share, np.full_like(part, self.halo), share, 0.0)

    @contextmanager
    def faint(self, share: float) -> Iterator[None]:
        """Draw everything inside this context with the opacity ``share``."""
        before = self.image.copy()
        yield
        cv2.addWeighted(self.image, share, before, 1 - share, 0.0, dst=self.image)

    @contextmanager
    def within(self, rect: Rect) -> Iterator[Canvas]:
        """Yield a canvas for a part of this one, with its own coordinates, to which drawing is clipped."""
        left, top, right, bottom = (round(edge) for edge in rect)
        part = Canvas(self.image[top:bottom, left:right], self.halo)
        part.unit_px = self.unit_px
        yield part
        self.image[top:bottom, left:right] = part.image

    def _in_dashes(self, pieces: Sequence[FloatArray], stroke: Stroke) -> list[npt.NDArray[np.int32]]:
        if stroke.dash is not None:
            on_px, off_px = (length * self.unit_px for length in stroke.dash)
            pieces = [dash for piece in pieces for dash in dashes(piece, on_px, off_px)]
        return [_fixed(piece) for piece in pieces]

    @property
    def _swatch_px(self) -> float:
        return 1.8 * TEXT * self.unit_px

    def _swatch(self, entry: Entry, rect: Rect) -> None:
        left, top, right, bottom = rect
        middle = (top + bottom) / 2
        corners = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
        if entry.mark == "dot":
            places = np.array([[left + share * (right - left), middle] for share in (0.2, 0.5, 0.8)])
            self.dots(places, entry.stroke.colour, entry.stroke.width)
        elif entry.mark == "area":
            self.area(corners, entry.stroke.colour)
        elif entry.mark == "box":
            self.lines([corners], entry.stroke, closed=True)
        else:
            self.lines([np.array([[left, middle], [right, middle]])], entry.stroke)

    def _px(self, units: float) -> int:
        return max(round(units * self.unit_px), 1)


def as_bgr8(image: Raster) -> npt.NDArray[np.uint8]:
    """Return a copy of a picture in blue-green-red, 8 bit; 16-bit values are scaled so that the largest becomes 255."""
    stretch = 1.0 if image.dtype == np.uint8 else 255.0 / max(int(image.max()), 1)
    grey_or_colour = np.asarray(cv2.convertScaleAbs(image, alpha=stretch), dtype=np.uint8)
    if image.ndim == 3 and image.shape[2] == 3:
        return grey_or_colour
    return np.asarray(cv2.cvtColor(grey_or_colour, cv2.COLOR_GRAY2BGR), dtype=np.uint8)


def emptiest_corner(size: tuple[float, float], inside: Rect, occupied: Sequence[FloatArray]) -> tuple[float, float]:
    """Find the corner in which a panel hides the fewest points.

    Parameters
    ----------
    size : tuple of float
        Width and height of the panel, pixels.
    inside : tuple of float
        The rectangle in whose corners it may be placed.
    occupied : sequence of ndarray, shape (n, 2)
        Groups of points that it should not hide, the most important first; later groups decide ties.

    Returns
    -------
    tuple of float
        Left and upper edge of the panel.
    """
    left, top, right, bottom = inside
    corners = [(x, y) for y in (top, bottom - size[1]) for x in (left, right - size[0])]

    def hidden(corner: tuple[float, float]) -> list[int]:
        low, high = np.array(corner), np.array(corner) + size
        return [int(((pixels >= low) & (pixels <= high)).all(axis=1).sum()) for pixels in occupied]

    return min(corners, key=hidden)


def touches(rect: Rect, line: FloatArray) -> bool:
    """Return whether a rectangle overlaps the axis-aligned bounding box of a line, shape (n, 2)."""
    low, high = line.min(axis=0), line.max(axis=0)
    return bool(rect[0] <= high[0] and rect[2] >= low[0] and rect[1] <= high[1] and rect[3] >= low[1])


def _fixed(pixels: FloatArray) -> npt.NDArray[np.int32]:
    """Convert pixels, shape (n, 2), to OpenCV's fixed-point coordinates with `SUBPIXEL_BITS`."""
    fixed: npt.NDArray[np.int32] = np.rint(pixels * 2**SUBPIXEL_BITS).astype(np.int32)
    return fixed
