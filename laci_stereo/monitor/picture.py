"""``histogram.png``: the density of object positions on the map, and their distribution across each lane."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from laci_stereo.core.frames import FloatArray, Raster
from laci_stereo.io.maps.lane_map import LaneMap
from laci_stereo.monitor.checkpoint import State
from laci_stereo.monitor.lanes import Strip
from laci_stereo.monitor.report import LaneFinding, counted
from laci_stereo.monitor.run import Plan
from laci_stereo.report.canvas import LINE_HEIGHT, TEXT, Canvas, Rect, emptiest_corner
from laci_stereo.report.mapview import LEAST_EXTENT_M, MapView
from laci_stereo.report.style import BLACK, BLUE, GREY, LIGHT_GREY, VERMILLION, WHITE, Stroke, lane_strokes

SIZE = (1600, 1000)
MAP: Rect = (20.0, 20.0, 1030.0, 980.0)
PROFILES: Rect = (1090.0, 20.0, 1580.0, 900.0)

SHOWN = 5
"""Number of lanes whose profile is drawn: those with most passages."""

SEEN_SHARE = 0.005
"""Fraction of the positions that may lie beyond each side of the map: an object far away must not shrink the rest."""

MARGIN_M = 5.0
BAR_SHARE = 0.3
HALF_PROFILE_M = 2.5
"""Distance to which a profile extends on either side of the line: beyond it is the next lane."""

SMALL = 0.85 * TEXT
MAP_LINE = Stroke(GREY, 1.6, halo=False)
CENTRE = Stroke(BLUE, 1.0, (6.0, 5.0), halo=False)
FRAME = Stroke(BLACK, 1.2, halo=False)
ZERO = Stroke(BLUE, 1.4, (6.0, 5.0), halo=False)
MEAN = Stroke(VERMILLION, 2.4, halo=False)


def draw_histogram(plan: Plan, state: State, found: Sequence[LaneFinding], lane_map: LaneMap) -> Raster:
    """Draw the density of positions on the map, north up, and the profiles across the lanes with most passages.

    Returns
    -------
    ndarray of uint8, shape (1000, 1600, 3)
        Blue, green, red.
    """
    canvas = Canvas(np.full((SIZE[1], SIZE[0], 3), 255, dtype=np.uint8), halo=WHITE)
    view = _view(plan, state)
    with canvas.within(MAP) as plot:
        _draw_density(plot, view, state, plan.settings.cell_m)
        for line, stroke in lane_strokes(lane_map, MAP_LINE.colour, MAP_LINE.width):
            plot.lines(view.line(line.xy), Stroke(stroke.colour, stroke.width, stroke.dash, halo=False))
        centres = [piece for strip in plan.strips if strip.is_lane for piece in view.line(strip.xy)]
        plot.lines(centres, CENTRE)
        _draw_sensor(plot, view, plan)
        _draw_scale(plot, view)
        _draw_colours(plot, state)
    left, top, right, bottom = MAP
    canvas.lines([np.array([[left, top], [right, top], [right, bottom], [left, bottom]])], FRAME, closed=True)
    _draw_profiles(canvas, found[:SHOWN], plan)
    return canvas.image


def _view(plan: Plan, state: State) -> MapView:
    """Choose the part of the world that contains nearly all positions, see `SEEN_SHARE`."""
    size = (MAP[2] - MAP[0], MAP[3] - MAP[1])
    cells = np.array(list(state.tally.cells), dtype=np.float64).reshape(-1, 2)
    counts = np.array(list(state.tally.cells.values()), dtype=np.float64)
    if not len(cells):
        return MapView(plan.origin, min(size) / LEAST_EXTENT_M, size)
    low, high = (
        np.array([_quantile(cells[:, axis], counts, share) for axis in (0, 1)]) * plan.settings.cell_m
        for share in (SEEN_SHARE, 1 - SEEN_SHARE)
    )
    extent = np.maximum(high - low + 2 * MARGIN_M, LEAST_EXTENT_M)
    return MapView((low + high) / 2, float((np.array(size) / extent).min()), size)


def _quantile(values: FloatArray, weights: FloatArray, share: float) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, share * total[-1])])


def _draw_density(plot: Canvas, view: MapView, state: State, cell_m: float) -> None:
    """Colour the cells of the map by the logarithm of their counts; empty cells stay white."""
    if not state.tally.cells:
        return
    x = (np.arange(plot.width) - view.size[0] / 2) / view.scale_px + view.centre[0]
    y = (view.size[1] / 2 - np.arange(plot.height)) / view.scale_px + view.centre[1]
    columns, rows = np.floor(x / cell_m).astype(int), np.floor(y / cell_m).astype(int)
    grid = np.zeros((rows[0] - rows[-1] + 1, columns[-1] - columns[0] + 1))
    for (i, j), count in state.tally.cells.items():
        if columns[0] <= i <= columns[-1] and rows[-1] <= j <= rows[0]:
            grid[rows[0] - j, i - columns[0]] = count
    counts = grid[rows[0] - rows][:, columns - columns[0]]
    seen = counts > 0
    plot.image[seen] = _colours(counts, _most(state))[seen]


def _most(state: State) -> int:
    return max(state.tally.cells.values(), default=1)


def _colours(counts: FloatArray, most: int) -> Raster:
    """Return the colour of each count on the cividis map, which is safe for colour-blind readers; light for few."""
    share = np.log(np.maximum(counts, 1.0)) / max(np.log(most), 1e-9)
    coloured: Raster = cv2.applyColorMap((255 * (1 - share)).astype(np.uint8), cv2.COLORMAP_CIVIDIS)
    return coloured


def _draw_sensor(plot: Canvas, view: MapView, plan: Plan) -> None:
    foot, room = view.pixels(plan.origin), 2 * TEXT * plot.unit_px
    if (foot > room).all() and (foot < np.array(view.size) - room).all():
        plot.dots(foot[None], BLACK, 7.0)
        plot.text("sensor", (foot[0], foot[1] - TEXT * plot.unit_px), BLACK, align="centre", size=SMALL)


def _draw_scale(plot: Canvas, view: MapView) -> None:
    """Draw the scale bar in the lower left corner, with the note that north is up."""
    length_m = view.bar_m(BAR_SHARE)
    unit = TEXT * plot.unit_px
    x, y = unit, plot.height - unit
    end = x + length_m * view.scale_px
    plot.shade((x - 0.5 * unit, y - 2.2 * unit, end + 0.5 * unit, y + 0.6 * unit), 0.8)
    bracket = np.array([[x, y - 0.3 * unit], [x, y], [end, y], [end, y - 0.3 * unit]])
    plot.lines([bracket], Stroke(BLACK, 2.0, halo=False))
    plot.text(f"{length_m:g} m, north up", ((x + end) / 2, y - 1.2 * unit), BLACK, align="centre", size=SMALL)


def _draw_colours(plot: Canvas, state: State) -> None:
    """Draw the colour scale in the emptiest corner other than the lower left one, which holds the scale bar."""
    most, unit = _most(state), TEXT * plot.unit_px
    width, height = 9 * unit, 0.7 * unit
    inside = (0.2 * unit, 0.4 * unit, plot.width - 0.2 * unit, plot.height - 0.4 * unit)
    scale = np.array([[inside[0], inside[3]]])
    drawn = np.argwhere((plot.image < 255).any(axis=2))[:, ::-1].astype(np.float64)
    x, y = emptiest_corner((width + 1.6 * unit, height + 3.8 * unit), inside, [scale, drawn])
    left, right, top, bottom = x + 0.8 * unit, x + 0.8 * unit + width, y + 3.2 * unit, y + 3.2 * unit + height
    plot.shade((x, y, right + 0.8 * unit, bottom + 0.6 * unit), 0.8)
    counts = np.exp(np.linspace(0.0, np.log(max(most, 1)), round(width)))[None]
    part = plot.image[round(top) : round(bottom), round(left) : round(left) + counts.shape[1]]
    part[:] = _colours(counts, most)[:, : part.shape[1]]
    plot.text("positions in a cell", ((left + right) / 2, top - 2.2 * unit), BLACK, align="centre", size=SMALL)
    plot.text("1", (left, top - 0.8 * unit), BLACK, size=SMALL)
    if most > 1:
        plot.text(f"{most}", (right, top - 0.8 * unit), BLACK, align="right", size=SMALL)


def _draw_profiles(canvas: Canvas, found: Sequence[LaneFinding], plan: Plan) -> None:
    """Draw the profiles one below the other, with a common axis."""
    left, top, right, bottom = PROFILES
    if not found:
        canvas.text("no passage along a lane", ((left + right) / 2, top + 2 * TEXT), BLACK, align="centre", size=SMALL)
        return
    height = min((bottom - top) / len(found), 260.0)
    for row, one in enumerate(found):
        _draw_profile(canvas, one, (left, top + row * height, right, top + (row + 1) * height), plan)
    base = top + len(found) * height
    for tick in np.arange(-2.0, 2.1, 1.0):
        x = _across(tick)
        canvas.lines([np.array([[x, base], [x, base + 8.0]])], FRAME)
        # Left of the line is left in the picture, as seen by a driver.
        canvas.text(f"{tick:+g}" if tick else "0", (x, base + 26.0), BLACK, align="centre", size=SMALL)
    of = "the lane's middle" if found[0].strip.is_lane else "the line"
    canvas.text(f"left of {of} [m]", ((left + right) / 2, base + 62.0), BLACK, align="centre", size=SMALL)


def _across(offset_m: float) -> float:
    left, _, right, _ = PROFILES
    return (left + right) / 2 - offset_m / HALF_PROFILE_M * (right - left) / 2


def _draw_profile(canvas: Canvas, lane: LaneFinding, rect: Rect, plan: Plan) -> None:
    left, top, right, base = rect
    label, bin_m = LINE_HEIGHT * SMALL * canvas.unit_px, plan.settings.profile_bin_m
    full = base - top - label - 8.0
    most = max(lane.tally.profile.values(), default=1)
    for number, count in lane.tally.profile.items():
        ends = [_across(edge) for edge in (number * bin_m, (number + 1) * bin_m)]
        x0, x1 = max(min(ends), left), min(max(ends), right)
        if x1 > x0:
            y = base - full * count / most
            canvas.area(np.array([[x0, y], [x1, y], [x1, base], [x0, base]]), LIGHT_GREY)
    for edge in _edges(lane.strip):
        if abs(edge) <= HALF_PROFILE_M:
            canvas.lines([np.array([[_across(edge), base - full], [_across(edge), base]])], MAP_LINE)
    canvas.lines([np.array([[_across(0.0), base - full], [_across(0.0), base]])], ZERO)
    canvas.lines([np.array([[left, base], [right, base]])], FRAME)
    if lane.tally.offset_m is not None:
        x = _across(lane.tally.offset_m)
        canvas.lines([np.array([[x, base - full], [x, base]])], MEAN)
    text = _caption(lane)
    canvas.text(text, (left, top + label / 2), BLACK, size=canvas.fitting(text, right - left, SMALL))


def _edges(strip: Strip) -> tuple[float, ...]:
    """Return the median offsets of a strip's right and left edge from its line."""
    return (float(np.median(strip.low_m)), float(np.median(strip.high_m)))


def _caption(lane: LaneFinding) -> str:
    tally = lane.tally
    passages = counted(tally.along + tally.against, "passage")
    name = f"{'lane ' if lane.strip.is_lane else ''}{lane.strip.id}: {passages}"
    if tally.offset_m is None:
        return f"{name}, wrong way"
    error = "" if tally.error_m is None else f" ± {tally.error_m:.2f}"
    wrong = f", {tally.against} wrong way" if tally.against else ""
    return f"{name}, {round(tally.offset_m, 2) + 0.0:+.2f}{error} m{wrong}"
