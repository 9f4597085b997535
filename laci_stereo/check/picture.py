"""Picture of a lane check, in which a person sees whether a map's lines lie on those of the road."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

import numpy as np

from laci_stereo.check.describe import verdict_text
from laci_stereo.check.lanes import LaneCheck
from laci_stereo.check.placed import Placed
from laci_stereo.check.sections import PAINTED, WALLS
from laci_stereo.core.frames import FloatArray, Raster
from laci_stereo.io.maps.lane_map import LaneLine, LaneMap
from laci_stereo.report.canvas import Canvas, Entry
from laci_stereo.report.lines import subdivide
from laci_stereo.report.style import NIGHT, SKY_BLUE, VERMILLION, WHITE, YELLOW, Stroke

Project: TypeAlias = Callable[[FloatArray], list[FloatArray]]
"""Projects a line on the ground, shape (n, 2), world, to the pieces of it that are in the picture, pixels."""

LINE_WIDTH, DOT_RADIUS = 1.4, 2.2
LANE = Stroke(YELLOW, LINE_WIDTH, halo=False)
HIDDEN = Stroke(YELLOW, LINE_WIDTH, dash=(4.0, 9.0), halo=False)
STEP_M = 0.5

LEGEND = (
    Entry("line of the map", "line", LANE),
    Entry("the same, hidden by the background", "line", HIDDEN),
    Entry("where a line was found", "dot", Stroke(SKY_BLUE, DOT_RADIUS)),
    Entry("found, off on its own", "dot", Stroke(VERMILLION, DOT_RADIUS)),
)


def draw_check(
    backdrop: Raster,
    project: Project,
    check: LaneCheck,
    placed: Placed,
    lane_map: LaneMap,
    kinds: Sequence[str] = PAINTED,
) -> Raster:
    """Draw the map's lines according to the calibration, dashed where hidden, and the places where they were found.

    ``backdrop`` is grey or in colour; ``kinds`` are those of the lines that the sensor can see. The picture has the
    shape (height, width, 3), uint8.
    """
    canvas = Canvas(backdrop, halo=NIGHT)
    drawn: list[FloatArray] = []
    for line in lane_map.lines:
        for piece, hidden in _by_sight(line, placed) if line.kind in kinds else ():
            pieces = project(piece)
            canvas.lines(pieces, HIDDEN if hidden else LANE)
            drawn += pieces
    for colour, places in ((SKY_BLUE, _found(check, False)), (VERMILLION, _found(check, True))):
        dots = [pixels[:1] for each in places for pixels in project(each)]
        if dots:
            canvas.dots(np.concatenate(dots), colour, DOT_RADIUS)
    canvas.legend_panel(LEGEND, [np.concatenate([*drawn, np.zeros((0, 2))])], WHITE)
    canvas.caption(_caption(check), WHITE)
    return canvas.image


def _by_sight(line: LaneLine, placed: Placed) -> Iterator[tuple[FloatArray, bool]]:
    """Split a line into visible pieces, shape (n, 2), and hidden ones; walls are part of the background itself."""
    fine = subdivide(line.xy, STEP_M)
    behind = placed.hidden((fine[1:] + fine[:-1]) / 2) & (line.kind not in WALLS)
    for part in np.split(np.arange(len(behind)), np.flatnonzero(np.diff(behind)) + 1):
        yield fine[part[0] : part[-1] + 2], bool(behind[part[0]])


def _found(check: LaneCheck, astray: bool) -> Iterator[FloatArray]:
    """Yield the places where something was found, as lines of one centimetre, shape (2, 2), world."""
    if check.offsets is None:
        return
    sections = check.offsets.sections
    places = sections.xy + check.offsets.left_m[:, None] * sections.left
    chosen = np.isin(sections.line, list(check.astray)) == astray
    for place, ahead in zip(places[chosen], sections.ahead[chosen], strict=True):
        yield np.stack([place, place + 0.01 * ahead])


def _caption(check: LaneCheck) -> str:
    found = f"{check.lines_found} of {check.lines_sought} lines found"
    residual = "" if check.residual_m is None else f", {100 * check.residual_m:.0f} cm off (RMS)"
    return f"{found}{residual}. {verdict_text(check)}"
