"""Charts for the templates: positions of ticks and marks, in units of the chart's SVG view box."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import FloatArray
from laci_stereo.report.mapview import multiples, nice_step
from laci_stereo.report.page.shapes import Part, dots, lines

WIDTH, HEIGHT = 720.0, 292.0
LEFT, TOP, RIGHT, BOTTOM = 64.0, 30.0, 706.0, 250.0
X_TICKS, Y_TICKS = 7, 6
MARK = 4.0
ROOM = 0.06
"""Margin between the outermost marks and the frame, as a fraction of the values' range."""


@dataclass(frozen=True)
class Tick:
    """A number beside an axis, and its position in units of the chart."""

    at: float
    text: str


@dataclass(frozen=True)
class Series:
    """A data series.

    Attributes
    ----------
    look : str
        Class of the style sheet, which sets the colour; the series also differ in the shape of their marks.
    label : str
        Label in the legend.
    x, y : ndarray, shape (n,)
        Positions of the marks, in the data's units.
    low, high : ndarray, shape (n,), or None
        Ends of vertical bars through the marks.
    """

    look: str
    label: str
    x: FloatArray
    y: FloatArray
    low: FloatArray | None = None
    high: FloatArray | None = None


@dataclass(frozen=True)
class Drawn:
    """A series as SVG path data in units of the chart: marks, bars, and a sample mark for the legend."""

    look: str
    label: str
    marks: str
    bars: str
    sample: str


@dataclass(frozen=True)
class Chart:
    """A scatter chart; ``zero`` is the y coordinate of the zero line, in units of the chart."""

    title: str
    x_title: str
    y_title: str
    x_ticks: tuple[Tick, ...]
    y_ticks: tuple[Tick, ...]
    zero: float | None
    series: tuple[Drawn, ...]

    width, height = WIDTH, HEIGHT
    left, top, right, bottom = LEFT, TOP, RIGHT, BOTTOM


def chart(title: str, x_title: str, y_title: str, series: list[Series]) -> Chart:
    """Lay out a chart whose axes include all marks, all bars and the zero line."""
    x = np.concatenate([each.x for each in series])
    edges = [edge for each in series for edge in (each.y, each.low, each.high) if edge is not None]
    y = np.append(np.concatenate(edges), 0.0)
    x_range, y_range = _range(x), _range(y)
    return Chart(
        title,
        x_title,
        y_title,
        _ticks(x_range, X_TICKS, (LEFT, RIGHT)),
        _ticks(y_range, Y_TICKS, (BOTTOM, TOP)),
        float(_place(np.zeros(1), y_range, (BOTTOM, TOP))[0]),
        tuple(_drawn(each, number, x_range, y_range) for number, each in enumerate(series)),
    )


def _drawn(series: Series, number: int, x_range: tuple[float, float], y_range: tuple[float, float]) -> Drawn:
    x = _place(series.x, x_range, (LEFT, RIGHT))
    y, low, high = (
        _place(values, y_range, (BOTTOM, TOP))
        for values in (series.y, *(series.y if end is None else end for end in (series.low, series.high)))
    )
    bars = [np.array([[a, b], [a, c]]) for a, b, c in zip(x, low, high, strict=True)]
    marks = "".join(mark(number, a, b) for a, b in zip(x, y, strict=True))
    return Drawn(series.look, series.label, marks, lines(bars), mark(number, 8.0, 8.0))


def mark(number: int, x: float, y: float) -> str:
    """Return the SVG path data of a mark: a circle, a triangle or a square, depending on the series' number."""
    if number % 3 == 0:
        turn = f"a{MARK} {MARK} 0 1 0"
        return f"M{x - MARK:.1f} {y:.1f}{turn} {2 * MARK} 0{turn} {-2 * MARK} 0Z"
    shape = [(-1.1, 0.9), (0.0, -1.2), (1.1, 0.9)] if number % 3 == 1 else [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    return lines([np.array([x, y]) + MARK * np.array(shape)], 1, closed=True)


def _range(values: FloatArray) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    room = max(ROOM * (high - low), 1e-3)
    return low - room, high + room


def _place(values: FloatArray, span: tuple[float, float], ends: tuple[float, float]) -> FloatArray:
    placed: FloatArray = ends[0] + (values - span[0]) / (span[1] - span[0]) * (ends[1] - ends[0])
    return placed


def _ticks(span: tuple[float, float], count: int, ends: tuple[float, float]) -> tuple[Tick, ...]:
    values = multiples(*span, nice_step(span[1] - span[0], count))
    places = _place(values, span, ends)
    return tuple(Tick(float(at), f"{value:g}".replace("-", "−")) for at, value in zip(places, values, strict=True))


@dataclass(frozen=True)
class OutlineChart:
    """The vehicle and its points from above; metres, x ahead and y to the left."""

    length_m: float
    width_m: float
    parts: tuple[Part, ...]


def outline_chart(size: tuple[float, float], xy_vehicle: FloatArray, surface: FloatArray) -> OutlineChart:
    """Draw the points around a vehicle: those attributed to its outline, and the others.

    Parameters
    ----------
    size : tuple of float
        Length and width of the vehicle, metres.
    xy_vehicle : ndarray, shape (n, 2)
        Points in the vehicle's frame, metres.
    surface : ndarray, shape (n,)
        Probability that the point belongs to the outline.
    """
    near = (np.abs(xy_vehicle) < 0.75 * np.array(size) + 0.5).all(axis=1)
    taken = near & (surface >= 0.5)
    parts = (
        Part("aside dots", dots(xy_vehicle[near & ~taken], 3), "points taken for something else"),
        Part("taken dots", dots(xy_vehicle[taken], 3), "points of the outline"),
    )
    return OutlineChart(*size, parts)
