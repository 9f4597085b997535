"""``topdown.png``: a map with the sensor's position and viewing direction, and the vehicle's track by either source."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import FloatArray, Raster, transform
from laci_stereo.core.result import Calibration
from laci_stereo.io.maps.lane_map import LaneMap
from laci_stereo.report.canvas import LINE_HEIGHT, TEXT, Canvas, Entry, Rect
from laci_stereo.report.drawn import (
    T_world_level,
    background_corners,
    drives_of,
    known_stamps,
    plan_in_world,
    sender_box,
    sender_track,
    sensor_track,
    sighting_at,
    stations_of,
)
from laci_stereo.report.mapview import MapView, draw_bar, map_view, multiples, nice_step
from laci_stereo.report.style import (
    BLACK,
    BLUE,
    GREY,
    LIGHT_GREY,
    PURPLE,
    SKY_BLUE,
    VERMILLION,
    WHITE,
    Colour,
    Stroke,
    lane_strokes,
)

SIZE = (1600, 1200)
PLOT: Rect = (105.0, 60.0, 1105.0, 1050.0)
"""The map's rectangle; to its right is the legend, below it the caption."""

SIDE_LEFT, SIDE_RIGHT = 1145.0, 1580.0

MARKS = 10
"""Largest number of intervals between the times that are marked on the tracks."""

TICKS = 7
"""Largest number of intervals between the ticks of an axis."""

BAR_SHARE = 0.25
"""Largest length of the scale bar, as a fraction of the map's width."""

ARROW_SHARE = 0.12
"""Length of the arrow in the viewing direction, as a fraction of the map's width."""

DOT_RADIUS, SENSOR_MARK_RADIUS, SENDER_MARK_RADIUS, SENSOR_RADIUS = 2.4, 3.6, 5.4, 9.0
"""Radii in units of the canvas. The sender's mark is larger than the sensor's, which is drawn above it, so that both
are visible where they agree."""

SMALL = 0.9 * TEXT

LANE = Stroke(GREY, 1.6)
SENDER = Stroke(VERMILLION, 3.0)
SENSOR = Stroke(BLUE, 2.0)
BACKGROUND = Stroke(LIGHT_GREY, 1.0)
POINTS = Stroke(SKY_BLUE, 2.0)
ELLIPSE = Stroke(PURPLE, 2.4, halo=False)
FRAME = Stroke(BLACK, 1.2, halo=False)
GRID = Stroke((235, 235, 235), 1.0, halo=False)
TIE = Stroke(BLACK, 1.2, halo=False)


def draw_topdown(calibration: Calibration, lane_map: LaneMap | None = None) -> Raster:
    """Draw the map of a calibration, north up: shape (1200, 1600, 3), uint8, in blue, green, red."""
    canvas = Canvas(np.full((SIZE[1], SIZE[0], 3), 255, dtype=np.uint8), halo=WHITE)
    view = map_view(calibration, (PLOT[2] - PLOT[0], PLOT[3] - PLOT[1]))
    with canvas.within(PLOT) as plot:
        _draw_grid(plot, view)
        entries = _draw_map(plot, view, calibration, lane_map)
    _draw_axes(canvas, view)
    _draw_side(canvas, view, calibration, entries)
    _draw_caption(canvas, calibration)
    return canvas.image


@dataclass(frozen=True)
class Mark:
    """The vehicle at one time, in the world frame.

    Attributes
    ----------
    stamp_s : float
        Stamp of the sighting.
    sent, seen : ndarray, shape (2,)
        Centre of the vehicle by the messages, and of the sensor's box.
    corners : ndarray, shape (4, 2)
        Corners of the sensor's box.
    left : ndarray, shape (2,)
        Unit vector to the vehicle's left.
    """

    stamp_s: float
    sent: FloatArray
    seen: FloatArray
    corners: FloatArray
    left: FloatArray


def marks_of(calibration: Calibration) -> list[Mark]:
    """Return marks for the sightings nearest to whole seconds, or to multiples of more seconds in a long drive."""
    known_s = known_stamps(calibration)
    if len(known_s) == 0:
        return []
    step_s = max(nice_step(float(np.ptp(known_s)) + 1e-9, MARKS), 1.0)
    nearest = np.abs(known_s[:, None] - multiples(known_s[0], known_s[-1], step_s)).argmin(axis=0)
    return [_mark(calibration, float(stamp_s)) for stamp_s in known_s[np.unique(nearest)]]


def _mark(calibration: Calibration, stamp_s: float) -> Mark:
    sent, seen = sender_box(calibration, stamp_s), sighting_at(calibration, stamp_s)
    assert sent is not None
    assert seen is not None
    corners = plan_in_world(calibration, seen.box.corners())
    left = np.array([-np.sin(sent.yaw_rad), np.cos(sent.yaw_rad)])
    return Mark(stamp_s, sent.centre, corners.mean(axis=0), corners, left)


def _draw_grid(canvas: Canvas, view: MapView) -> None:
    for axis in (0, 1):
        for tick in _ticks(view, axis):
            canvas.lines([_line_at(view, axis, tick)], GRID)


def _line_at(view: MapView, axis: int, tick: float) -> FloatArray:
    """Return the ends of the grid line across the map at a coordinate of an axis, pixels, shape (2, 2)."""
    ends = np.array([[0.0, 0.0], view.size])
    ends[:, axis] = view.pixels(np.full(2, tick))[axis]
    return ends


def _ticks(view: MapView, axis: int) -> FloatArray:
    low, high = view.extent_m(axis)
    return multiples(low, high, nice_step(high - low, TICKS))


def _draw_map(canvas: Canvas, view: MapView, calibration: Calibration, lane_map: LaneMap | None) -> list[Entry]:
    """Draw everything with a position in the world, and return the legend's entries."""
    entries = []
    background = background_corners(calibration)
    for corners in background:
        canvas.area(view.pixels(corners), BACKGROUND.colour)
        canvas.lines([view.pixels(corners)], Stroke(GREY, 1.0, halo=False), closed=True)
    if background:
        entries.append(Entry("static background", "area", BACKGROUND))
    lanes = lane_strokes(lane_map, LANE.colour, LANE.width)
    for line, stroke in lanes:
        canvas.lines(view.line(line.xy), stroke)
    if lanes:
        entries.append(Entry("lane map", "line", LANE))
    entries += _draw_vehicle(canvas, view, calibration)
    _draw_sensor(canvas, view, calibration)
    return entries


def _draw_vehicle(canvas: Canvas, view: MapView, calibration: Calibration) -> list[Entry]:
    T = T_world_level(calibration)
    drives = list(drives_of(calibration))
    for sighting in (sighting for alone in drives for sighting in alone.drive.track.usable):
        canvas.specks(view.pixels(transform(T, sighting.points)[:, :2]), POINTS.colour)
    own, *others = (marks_of(drive) for drive in drives)
    marks = [*own, *(mark for each in others for mark in each)]
    for mark in marks:
        canvas.lines([view.pixels(mark.corners)], SENSOR, closed=True)
    canvas.lines([piece for track in sender_track(calibration) for piece in view.line(track)], SENDER)
    canvas.dots(view.pixels(sensor_track(calibration)), SENSOR.colour, DOT_RADIUS)
    ellipses = [view.pixels(position_ellipse(calibration, mark.seen)) for mark in marks]
    visible = [
        ellipse for ellipse in ellipses if np.ptp(ellipse, axis=0).max() > 2 * SENSOR_MARK_RADIUS * canvas.unit_px
    ]
    for mark in marks:
        _draw_mark(canvas, view, mark)
    for mark in own:  # those of other drives would lie on these
        _write_time(canvas, view, mark)
    canvas.lines(visible, ELLIPSE, closed=True)
    entries = [
        Entry("track by the CAMs", "line", SENDER),
        Entry("track by the sensor", "dot", Stroke(SENSOR.colour, DOT_RADIUS)),
        Entry("boxes by the sensor", "box", SENSOR),
        Entry("points of the vehicle", "dot", POINTS),
    ]
    return [*entries, Entry("1σ of the position", "line", ELLIPSE)] if visible else entries


def _draw_mark(canvas: Canvas, view: MapView, mark: Mark) -> None:
    """Mark one time on both tracks, and connect the two marks."""
    ends = view.pixels(np.stack([mark.sent, mark.seen]))
    canvas.lines([ends], TIE)
    canvas.dots(ends[:1], SENDER.colour, SENDER_MARK_RADIUS)
    canvas.dots(ends[1:], SENSOR.colour, SENSOR_MARK_RADIUS)


def _write_time(canvas: Canvas, view: MapView, mark: Mark) -> None:
    """Write the time beside the box."""
    clear_m = float(((mark.corners - mark.sent) @ mark.left).max())
    x, y = view.pixels(mark.sent + mark.left * (clear_m + TEXT * canvas.unit_px / view.scale_px))
    canvas.text(f"{mark.stamp_s:.0f} s", (x, y), BLACK, align="centre", size=SMALL)


def position_covariance(calibration: Calibration, xy_world: FloatArray, z_m: float = 0.0) -> FloatArray:
    """Return the covariance, shape (2, 2), world, of the position to which the calibration maps an object.

    The object is at ``xy_world``, at the height ``z_m``. An error of the rotation about the track's centre displaces it
    in proportion to its distance from there.
    """
    dx, dy = xy_world - calibration.centre_world[:2]
    dz = z_m - calibration.centre_world[2]
    jacobian = np.array([[0.0, dz, -dy, 1.0, 0.0, 0.0], [-dz, 0.0, dx, 0.0, 1.0, 0.0]])
    covariance: FloatArray = jacobian @ calibration.covariance @ jacobian.T
    return covariance


def position_ellipse(
    calibration: Calibration, xy_world: FloatArray, z_m: float = 0.0, sigmas: float = 1.0
) -> FloatArray:
    """Return the error ellipse of an object's position at a number of standard deviations, world, shape (n, 2)."""
    variances, directions = np.linalg.eigh(position_covariance(calibration, xy_world, z_m))
    around = np.linspace(0.0, 2 * np.pi, 72, endpoint=False)
    circle = np.column_stack([np.cos(around), np.sin(around)])
    ellipse: FloatArray = xy_world + sigmas * (circle * np.sqrt(np.maximum(variances, 0.0))) @ directions.T
    return ellipse


def _draw_sensor(canvas: Canvas, view: MapView, calibration: Calibration) -> None:
    """Draw the sensor's position and viewing direction, with a label on the side away from that direction."""
    foot = view.pixels(calibration.T_world_sensor[:2, 3])
    looks = (calibration.T_world_sensor[:3, :3] @ np.array(calibration.axes.forward))[:2] * [1.0, -1.0]
    looks /= max(float(np.linalg.norm(looks)), 1e-12)
    _draw_arrow(canvas, foot, foot + looks * ARROW_SHARE * view.size[0], BLACK)
    canvas.dots(foot[None], BLACK, SENSOR_RADIUS)
    aside = canvas.text_width("sensor", bold=True) / 2 + SENSOR_RADIUS * canvas.unit_px
    x = float(np.clip(foot[0], aside, view.size[0] - aside))
    below = 1.0 if looks[1] < 0 else -1.0
    canvas.text("sensor", (x, foot[1] + below * 1.3 * TEXT * canvas.unit_px), BLACK, align="centre", bold=True)


def _draw_arrow(canvas: Canvas, start: FloatArray, tip: FloatArray, colour: Colour) -> None:
    along = (tip - start) / max(float(np.linalg.norm(tip - start)), 1e-12)
    across = np.array([-along[1], along[0]])
    length = 0.9 * TEXT * canvas.unit_px
    head = np.stack([tip, tip - length * (along + 0.45 * across), tip - length * (along - 0.45 * across)])
    canvas.lines([np.stack([start, tip - 0.8 * length * along])], Stroke(colour, 3.0))
    canvas.area(head, colour)


def _draw_axes(canvas: Canvas, view: MapView) -> None:
    """Draw the border of the map, and the ticks of both axes in metres."""
    left, top, right, bottom = PLOT
    canvas.lines([np.array([[left, top], [right, top], [right, bottom], [left, bottom]])], FRAME, closed=True)
    length = 0.35 * TEXT * canvas.unit_px
    room = 0.8 * TEXT * canvas.unit_px
    for tick in _ticks(view, 0):
        x = left + view.pixels(np.array([tick, 0.0]))[0]
        canvas.lines([np.array([[x, bottom], [x, bottom + length]])], FRAME)
        canvas.text(f"{tick:g}", (x, bottom + length + room), BLACK, align="centre", size=SMALL)
    for tick in _ticks(view, 1):
        y = top + view.pixels(np.array([0.0, tick]))[1]
        canvas.lines([np.array([[left - length, y], [left, y]])], FRAME)
        canvas.text(f"{tick:g}", (left - 2 * length, y), BLACK, align="right", size=SMALL)
    canvas.text("y, north [m]", (left - 2 * room, top - 1.2 * room), BLACK, size=SMALL)
    canvas.text("x, east [m]", (right, bottom + length + 2.4 * room), BLACK, size=SMALL, align="right")


def _draw_side(canvas: Canvas, view: MapView, calibration: Calibration, entries: list[Entry]) -> None:
    """Draw the north arrow, the scale bar, the legend and the calibration's figures beside the map."""
    top, line = PLOT[1], LINE_HEIGHT * TEXT * canvas.unit_px
    x = SIDE_LEFT + line
    _draw_arrow(canvas, np.array([x, top + 2.6 * line]), np.array([x, top + 0.9 * line]), BLACK)
    canvas.text("N", (x, top + 0.4 * line), BLACK, align="centre", bold=True)
    draw_bar(canvas, view, (SIDE_LEFT + 3.0 * line, top + 2.0 * line), BAR_SHARE)
    canvas.legend(entries, (SIDE_LEFT, top + 3.6 * line), BLACK)
    y = top + (4.6 + len(entries)) * line
    told = facts(calibration)
    size = min(canvas.fitting(text, SIDE_RIGHT - SIDE_LEFT, SMALL) for text in told)
    for text in told:
        canvas.text(text, (SIDE_LEFT, y), BLACK, size=size)
        y += line


def facts(calibration: Calibration) -> list[str]:
    """Return the sensor's pose, its uncertainty and the verdict in words, one line each."""
    # Not from T_utm_sensor, which is rigid and so true to the grid's scale only at the track.
    east, north = calibration.world.to_utm(calibration.T_world_sensor[None, :2, 3])[0]
    angles, quality = calibration.viewing_angles, calibration.quality
    return [
        f"sensor at E {east:.2f} m",
        f"N {north:.2f} m, height {calibration.height_m:.2f} m",
        f"looks to {(90.0 - angles.yaw_deg) % 360.0:.1f}°, {angles.down_deg:.1f}° down",
        f"{stations_of(calibration)}, {quality.frames_used} frames used",
        f"verdict: {quality.verdict}, method: {calibration.drive.method}",
        f"objects placed to ±{quality.track_xy_sigma_m:.2f} m (1σ)",
    ]


def _draw_caption(canvas: Canvas, calibration: Calibration) -> None:
    world = calibration.world
    text = (
        f"World frame: metres east and north of E {world.origin_utm[0]:.0f} m, N {world.origin_utm[1]:.0f} m in "
        f"{world.crs} (UTM); grid scale {world.grid_scale:.6f}. Times since the first frame."
    )
    size = canvas.fitting(text, SIDE_RIGHT - PLOT[0], SMALL)
    canvas.text(text, (PLOT[0], SIZE[1] - 1.2 * TEXT * canvas.unit_px), BLACK, size=size)
