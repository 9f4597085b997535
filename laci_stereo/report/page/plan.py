"""The page's map of a calibration, which can be panned and zoomed: metres of the world, north up."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from laci_stereo.core.frames import FloatArray, transform
from laci_stereo.core.result import Calibration
from laci_stereo.io.maps.lane_map import LaneMap
from laci_stereo.report.drawn import (
    T_world_level,
    background_corners,
    drives_of,
    plan_in_world,
    sender_box,
    sender_track,
)
from laci_stereo.report.mapview import MapView, map_view, multiples, nice_step
from laci_stereo.report.page.shapes import Label, Layer, Part, dots, lines, thinned
from laci_stereo.report.style import lane_strokes, look_of
from laci_stereo.report.topdown import marks_of, position_ellipse

SIZE = (960.0, 640.0)
BEYOND = 3.0
"""Size of the area drawn, in multiples of the initial view, for panning and zooming out."""

MOST_DOTS = 6000
MOST_MOMENTS = 1500
"""Largest numbers of points of the vehicles and of their sightings, of all drives together; more would only overlap."""

ARROW_SHARE = 0.1
LABEL_PX = 16.0
BAR_SHARE = 0.2
BAR_AT = (20.0, 14.0)
"""Position of the scale bar: left end, and height above the lower border, pixels."""

TICKS = 8
DIGITS = 3


@dataclass(frozen=True)
class Moment:
    """A position on the map, in pixels of the initial view, with the text that is shown for it."""

    x: float
    y: float
    text: str


@dataclass(frozen=True)
class Plan:
    """The map.

    Attributes
    ----------
    view : MapView
        The initial view.
    layers : tuple of Layer
        Paths in metres of the world, y to the north.
    labels : tuple of Label
        Labels at pixels of the initial view.
    moments : tuple of Moment
        The vehicle where the sensor saw it, drive by drive in the order of time.
    """

    view: MapView
    layers: tuple[Layer, ...]
    labels: tuple[Label, ...]
    moments: tuple[Moment, ...]

    @property
    def matrix(self) -> str:
        """The transform from the world to the initial view, as an SVG transform."""
        scale = self.view.scale_px
        x, y = self.view.pixels(np.zeros(2)).tolist()
        return f"matrix({scale:.6f} 0 0 {-scale:.6f} {x:.4f} {y:.4f})"

    @property
    def moments_data(self) -> list[tuple[float, float, str]]:
        """The moments in the form that the page's script reads: x, y and text."""
        return [(round(moment.x, 3), round(moment.y, 3), moment.text) for moment in self.moments]

    @property
    def bar_m(self) -> float:
        """Length of the scale bar, metres: at most the fraction `BAR_SHARE` of the picture's width."""
        return self.view.bar_m(BAR_SHARE)

    @property
    def bar_path(self) -> str:
        """SVG path data of the scale bar in the initial view, before the script changes it."""
        x, y = BAR_AT[0], self.view.size[1] - BAR_AT[1]
        end = x + self.bar_m * self.view.scale_px
        return lines([np.array([[x, y - 6], [x, y], [end, y], [end, y - 6]])])

    @property
    def bar_text_x(self) -> float:
        """Horizontal position of the scale bar's number, pixels."""
        return round(BAR_AT[0] + self.bar_m * self.view.scale_px / 2, 1)


def draw_plan(calibration: Calibration, lane_map: LaneMap | None) -> Plan:
    """Draw lanes, background, the vehicles' points, boxes and tracks, error ellipses and the sensor."""
    drives = list(drives_of(calibration))
    view = map_view(calibration, SIZE)
    grid_m = nice_step(SIZE[0] / view.scale_px, TICKS)
    layers = [
        Layer("grid", f"Grid, {grid_m:g} m", (Part("grid", lines(_grid(view, grid_m), DIGITS)),)),
        Layer("background", "Background boxes", tuple(_background(calibration))),
        Layer("lanes", "Lane map", tuple(_lanes(view, lane_map))),
        Layer(
            "points", "Points of the vehicle", (Part("points", dots(_points(drives), DIGITS), "points of the vehicle"),)
        ),
        Layer(
            "boxes",
            "Boxes by the sensor",
            (Part("box", lines(_boxes(drives), DIGITS, closed=True), "box by the sensor"),),
        ),
        Layer("sent", "Track by the messages (CAM)", tuple(_sent(drives))),
        Layer("seen", "Track by the sensor", (Part("dots", dots(_seen(drives), DIGITS)),)),
        Layer("doubt", "One- and three-sigma ellipses", tuple(_ellipses(calibration, drives))),
        Layer("sensor", "Sensor and where it looks", tuple(_sensor(calibration, view))),
    ]
    kept = tuple(layer for layer in layers if any(part.d for part in layer.parts))
    return Plan(view, kept, _labels(calibration, drives, view), _moments(drives, view))


def _grid(view: MapView, step_m: float) -> list[FloatArray]:
    low, high = _shown(view)
    upright = [np.array([[x, low[1]], [x, high[1]]]) for x in multiples(low[0], high[0], step_m)]
    return upright + [np.array([[low[0], y], [high[0], y]]) for y in multiples(low[1], high[1], step_m)]


def _shown(view: MapView) -> tuple[FloatArray, FloatArray]:
    """Return the lower left and the upper right corner of the area drawn, shape (2,) each, world."""
    half = BEYOND * np.array(view.size) / view.scale_px / 2
    return view.centre - half, view.centre + half


def _background(calibration: Calibration) -> Iterator[Part]:
    for corners, static in zip(background_corners(calibration), calibration.drive.background.boxes, strict=True):
        size = f"{static.box.length_m:.1f} m × {static.box.width_m:.1f} m, {static.height_m:.1f} m high"
        yield Part("background", lines([corners], 2, closed=True), f"background box, {size}")


def _lanes(view: MapView, lane_map: LaneMap | None) -> Iterator[Part]:
    wider = replace(view, scale_px=view.scale_px / BEYOND)
    for line, _ in lane_strokes(lane_map, (0, 0, 0), 1.0):
        pieces = [(pixels - np.array(wider.size) / 2) / [wider.scale_px, -wider.scale_px] + wider.centre
                  for pixels in wider.line(line.xy)]  # fmt: skip
        if pieces:
            words = " ".join(filter(None, [line.kind, line.subtype])) or "line"
            yield Part(f"lane {look_of(line)}", lines(pieces, 2), f"lane map: {words}, {line.id}")


def _points(drives: list[Calibration]) -> FloatArray:
    """Return at most `MOST_DOTS` points of the vehicles, world, shape (n, 2)."""
    found = [
        transform(T_world_level(alone), sighting.points)[:, :2]
        for alone in drives
        for sighting in alone.drive.track.usable
    ]
    return thinned(np.concatenate([np.zeros((0, 2)), *found]), MOST_DOTS)


def _boxes(drives: list[Calibration]) -> list[FloatArray]:
    return [mark.corners for alone in drives for mark in marks_of(alone)]


def _sent(drives: list[Calibration]) -> Iterator[Part]:
    for alone in drives:
        yield Part(
            "sent", lines(sender_track(alone), DIGITS), f"track by the messages of station {alone.drive.station_id}"
        )


def _seen(drives: list[Calibration]) -> FloatArray:
    found = [plan_in_world(alone, alone.drive.track.centres) for alone in drives]
    return thinned(np.concatenate([np.zeros((0, 2)), *found]), MOST_MOMENTS)


def _ellipses(calibration: Calibration, drives: list[Calibration]) -> Iterator[Part]:
    places = [(mark.seen, 0.0) for alone in drives for mark in marks_of(alone)]
    places.append((calibration.T_world_sensor[:2, 3], float(calibration.T_world_sensor[2, 3])))
    for sigmas, look in ((1.0, "one"), (3.0, "three")):
        around = [position_ellipse(calibration, xy, z_m, sigmas) for xy, z_m in places]
        yield Part(f"ellipse {look}", lines(around, 4, closed=True), f"{look}-sigma ellipse of the position")


def _sensor(calibration: Calibration, view: MapView) -> Iterator[Part]:
    foot = calibration.T_world_sensor[:2, 3]
    looks = (calibration.T_world_sensor[:3, :3] @ np.array(calibration.axes.forward))[:2]
    looks = looks / max(float(np.linalg.norm(looks)), 1e-12)
    length = ARROW_SHARE * view.size[0] / view.scale_px
    aside, tip = np.array([-looks[1], looks[0]]), foot + length * looks
    head = [tip - 0.2 * length * looks + way * 0.1 * length * aside for way in (1.0, -1.0)]
    yield Part("looks", lines([np.stack([foot, tip]), np.stack([head[0], tip, head[1]])], DIGITS))
    yield Part("sensor dots", dots(foot[None], DIGITS), f"sensor, {calibration.height_m:.2f} m above the ground")


def _labels(calibration: Calibration, drives: list[Calibration], view: MapView) -> tuple[Label, ...]:
    looks = calibration.T_world_sensor[:2, :3] @ np.array(calibration.axes.forward)
    below = np.array([0.0, LABEL_PX if looks[1] > 0 else -LABEL_PX])
    places = [(calibration.T_world_sensor[:2, 3], "sensor", below)]
    for alone in drives:
        for mark in marks_of(alone):
            clear_m = float(((mark.corners - mark.sent) @ mark.left).max())
            beside = LABEL_PX * mark.left * [1.0, -1.0]
            places.append((mark.sent + mark.left * clear_m, f"{mark.stamp_s:.0f} s", beside))
    return tuple(_label(view.pixels(xy), text, beside) for xy, text, beside in places)


def _label(pixels: FloatArray, text: str, beside_px: FloatArray) -> Label:
    return Label(float(pixels[0]), float(pixels[1]), text, float(beside_px[0]), float(beside_px[1]))


def _moments(drives: list[Calibration], view: MapView) -> tuple[Moment, ...]:
    found: list[Moment] = []
    for number, alone in enumerate(drives, start=1):
        named = f"drive {number}, " if len(drives) > 1 else ""
        step = max(1, -(-len(alone.drive.track.usable) * len(drives) // MOST_MOMENTS))
        for sighting in alone.drive.track.usable[::step]:
            seen = plan_in_world(alone, sighting.box.centre[None])[0]
            points = f", {sighting.count} points" if len(sighting.points) else ""
            said = f"{named}t = {sighting.stamp_s:.2f} s{points}; {_against(alone, sighting.stamp_s, seen)}"
            x, y = view.pixels(seen).tolist()
            found.append(Moment(x, y, said))
    return tuple(found)


def _against(drive: Calibration, stamp_s: float, seen: FloatArray) -> str:
    sent = sender_box(drive, stamp_s)
    if sent is None:
        return "no message reports where the vehicle was"
    ahead = np.array([np.cos(sent.yaw_rad), np.sin(sent.yaw_rad)])
    along, left = (seen - sent.centre) @ np.column_stack([ahead, [-ahead[1], ahead[0]]])
    return f"the visible part's middle is {along:+.2f} m ahead and {left:+.2f} m left of the vehicle's middle"
