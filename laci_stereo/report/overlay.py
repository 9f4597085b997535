"""Overlays for visual verification: map, tracks and boxes, drawn into the camera's image by the calibration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from laci_stereo.core.frames import FloatArray, Raster, invert
from laci_stereo.core.result import Calibration
from laci_stereo.io.maps.lane_map import LaneMap
from laci_stereo.io.rig.stereo_rig import Lens
from laci_stereo.report.camera import Camera
from laci_stereo.report.canvas import LINE_HEIGHT, TEXT, Canvas, Entry, Rect, touches
from laci_stereo.report.drawn import (
    known_stamps,
    on_ground,
    sender_track,
    sensor_track,
    stations_of,
)
from laci_stereo.report.scene import GRID_AHEAD, GRID_M, grid_places, ground_grid, vehicle_edges
from laci_stereo.report.style import NIGHT, SKY_BLUE, VERMILLION, WHITE, YELLOW, Stroke, lane_strokes

GRID_SHARE = 0.55
LANE_WIDTH, SENDER_WIDTH, SENSOR_WIDTH, DOT_RADIUS = 2.6, 4.6, 2.2, 3.2
"""Line widths and radii in units of the canvas. The sensor's box has thinner lines than the sender's, which is drawn
below it, so that both are visible where they agree."""

MOMENTS = (0.1, 0.5, 0.9)
"""Times of the overlays, as fractions of the time in which the vehicle is seen: early, in the middle, late."""

GRID = Stroke(WHITE, 1.0)
SENDER = Stroke(VERMILLION, SENDER_WIDTH)
SENSOR = Stroke(SKY_BLUE, SENSOR_WIDTH)
LANE = Stroke(YELLOW, LANE_WIDTH)


def overlay_stamps(calibration: Calibration, moments: Sequence[float] = MOMENTS) -> list[float]:
    """Choose the frames to draw, at fractions ``moments`` of the time in which the vehicle was seen and used.

    Returned are stamps of sightings, ascending, each once. In all of them both the sensor and the messages determine
    the vehicle's position.
    """
    stamps_s = known_stamps(calibration)
    if len(stamps_s) == 0:
        return []
    wanted = stamps_s[0] + np.array(moments) * (stamps_s[-1] - stamps_s[0])
    nearest = np.abs(stamps_s[:, None] - wanted).argmin(axis=0)
    return [float(stamp_s) for stamp_s in stamps_s[np.unique(nearest)]]


def draw_overlay(
    image: Raster, lens: Lens, calibration: Calibration, stamp_s: float, lane_map: LaneMap | None
) -> Raster:
    """Draw the map, the vehicle and its tracks into an image.

    With a correct calibration, the map's lines coincide with those of the road, and both boxes enclose the vehicle.

    Parameters
    ----------
    image : ndarray
        Raw image of the left camera; it is not changed.
    lens : Lens
        Lens of that camera.
    calibration : Calibration
    stamp_s : float
        Stamp of the image, seconds since the recording's first stamp.
    lane_map : LaneMap or None

    Returns
    -------
    ndarray of uint8, shape (h, w, 3)
        Blue, green, red.
    """
    canvas = Canvas(image, halo=NIGHT)
    camera = Camera(lens, invert(calibration.T_world_sensor))
    lanes = _draw_lanes(canvas, camera, lane_map)
    _draw_grid(canvas, camera, calibration)
    tracks = _draw_tracks(canvas, camera, calibration)
    boxes = _draw_boxes(canvas, camera, calibration, stamp_s)
    _label_grid(canvas, camera, calibration, boxes)
    _draw_legend(canvas, [*tracks, *boxes], lanes)
    canvas.caption(_caption(calibration, stamp_s), WHITE)
    return canvas.image


def _draw_lanes(canvas: Canvas, camera: Camera, lane_map: LaneMap | None) -> list[FloatArray]:
    """Draw the map's lines, and return them in pixels."""
    drawn: list[FloatArray] = []
    for line, stroke in lane_strokes(lane_map, LANE.colour, LANE.width):
        pieces = camera.project_line(on_ground(line.xy))
        canvas.lines(pieces, stroke)
        drawn += pieces
    return drawn


def _draw_grid(canvas: Canvas, camera: Camera, calibration: Calibration) -> None:
    """Draw a grid on the ground, with its origin at the point below the sensor."""
    with canvas.faint(GRID_SHARE):
        canvas.lines([piece for line in ground_grid(calibration) for piece in camera.project_line(line)], GRID)


def _label_grid(canvas: Canvas, camera: Camera, calibration: Calibration, avoid: Sequence[FloatArray]) -> None:
    """Label the grid's lines with their distance ahead, except where there is no room or where the vehicle is."""
    bottom = canvas.caption_top
    places = camera.project(grid_places(calibration))
    room = LINE_HEIGHT * TEXT * canvas.unit_px
    for distance, (x, y) in zip(GRID_AHEAD, places, strict=True):
        text = f"{distance:.0f} m"
        left, right = x + room / 3, x + room / 3 + canvas.text_width(text)
        rect = (left, y - room / 2, right, y + room / 2)
        if _within(rect, (0.0, room, canvas.width, bottom)) and not any(touches(rect, taken) for taken in avoid):
            canvas.text(text, (left, y), WHITE)
            bottom = rect[1]  # the next label is farther away, so it is higher in the image


def _draw_tracks(canvas: Canvas, camera: Camera, calibration: Calibration) -> list[FloatArray]:
    """Draw the vehicles' tracks by their messages and by the sensor, and return them in pixels."""
    sent = [piece for track in sender_track(calibration) for piece in camera.project_line(on_ground(track))]
    canvas.lines(sent, SENDER)
    seen = camera.project(on_ground(sensor_track(calibration)))
    seen = seen[np.isfinite(seen).all(axis=1)]
    canvas.dots(seen, SENSOR.colour, DOT_RADIUS)
    return [*sent, seen]


def _draw_boxes(canvas: Canvas, camera: Camera, calibration: Calibration, stamp_s: float) -> list[FloatArray]:
    """Draw the vehicles' boxes at a time by their messages and by the sensor, and return their edges in pixels."""
    edges = vehicle_edges(calibration, stamp_s)
    sent_px, seen_px = ([piece for edge in each for piece in camera.project_line(edge)] for each in edges)
    canvas.layers([(sent_px, SENDER), (seen_px, SENSOR)])
    return sent_px + seen_px


def _draw_legend(canvas: Canvas, vehicle: list[FloatArray], lanes: list[FloatArray]) -> None:
    entries = [
        Entry("vehicle by its CAMs", "line", SENDER),
        Entry("vehicle by the sensor", "dot", Stroke(SENSOR.colour, DOT_RADIUS)),
        Entry(f"{GRID_M:.0f} m grid from the sensor's foot", "line", GRID),
    ]
    if lanes:
        entries.insert(0, Entry("lane map", "line", LANE))
    occupied = [np.concatenate([*part, np.zeros((0, 2))]) for part in (vehicle, lanes)]
    canvas.legend_panel(entries, occupied, WHITE)


def _caption(calibration: Calibration, stamp_s: float) -> str:
    quality = calibration.quality
    return (
        f"t = {stamp_s:.2f} s, {stations_of(calibration)}, verdict: {quality.verdict}, "
        f"objects placed to ±{quality.track_xy_sigma_m:.2f} m (1σ)"
    )


def _within(rect: Rect, frame: Rect) -> bool:
    """Return whether a rectangle lies within a frame; a rectangle with NaN does not."""
    return rect[0] >= frame[0] and rect[1] >= frame[1] and rect[2] <= frame[2] and rect[3] <= frame[3]
