"""Picture of a rig check, in which a person sees whether partners lie in one row after rectification."""

from __future__ import annotations

import numpy as np

from laci_stereo.check.rig_images import RigCheck
from laci_stereo.check.rig_points import Rectified
from laci_stereo.check.rig_verdict import FAIL_PX, WARN_PX
from laci_stereo.core.frames import FloatArray, Raster
from laci_stereo.report.canvas import Canvas, Entry
from laci_stereo.report.style import NIGHT, SKY_BLUE, VERMILLION, WHITE, YELLOW, Stroke
from laci_stereo.stereo.rectify import rectify

ROWS = 12
"""Number of rows that are drawn across both images."""

ROW = Stroke(WHITE, 0.5, halo=False)
RADIUS = 2.6
_COLOURS = (
    (SKY_BLUE, f"within {WARN_PX:g} px of its row", 0.0, WARN_PX),
    (YELLOW, f"within {FAIL_PX:g} px", WARN_PX, FAIL_PX),
    (VERMILLION, "beyond", FAIL_PX, np.inf),
)


def draw_rig(check: RigCheck) -> Raster:
    """Draw the rectified pair side by side, its rows, and the matches coloured by their vertical parallax.

    Returns
    -------
    ndarray of uint8, shape (h, w, 3)
    """
    left, right = check.shown.left, check.shown.right
    if check.fit is not None:
        plane = rectify(check.rig)
        left, right = plane.left.look_up(left), plane.right.look_up(right)
    canvas = Canvas(np.hstack([left, right]), halo=NIGHT)
    height, width = left.shape
    heights = (np.arange(ROWS) + 0.5) * height / ROWS
    canvas.lines([np.array([[0.0, y], [2.0 * width, y]]) for y in heights], ROW)
    dots = [] if check.fit is None else _draw_matches(canvas, check.fit.points, width)
    canvas.legend_panel([Entry(label, "dot", Stroke(colour, RADIUS)) for colour, label, _, _ in _COLOURS], dots, WHITE)
    words = check.findings[0].text if check.findings else "partners lie in their rows"
    canvas.caption(f"{check.outcome.upper()}: {words}", WHITE)
    return canvas.image


def _draw_matches(canvas: Canvas, matches: Rectified, width: int) -> list[FloatArray]:
    """Draw the matches of the first pair; return their positions in the left and the right image."""
    points = matches.chosen(matches.pair == 0)
    left, right = (_seen(each, points.sign, width) for each in (points.left, points.right))
    right += [width, 0.0]
    off = np.abs(points.parallax_px)
    for colour, _, least, most in _COLOURS:
        some = (off >= least) & (off < most)
        canvas.dots(left[some], colour, RADIUS)
        canvas.dots(right[some], colour, RADIUS)
    return [np.concatenate([left, right])]


def _seen(pixels: FloatArray, sign: int, width: int) -> FloatArray:
    """Return the positions of points in images that are mirrored if the second camera is left of the first."""
    return pixels.copy() if sign > 0 else np.column_stack([width - 1 - pixels[:, 0], pixels[:, 1]])
