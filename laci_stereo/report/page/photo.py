"""Camera images with lines drawn over them by the calibration: map, grid, tracks and boxes."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from laci_stereo.core.frames import FloatArray, Raster, invert
from laci_stereo.core.result import Calibration
from laci_stereo.io.maps.lane_map import LaneMap
from laci_stereo.io.rig.stereo_rig import Lens
from laci_stereo.mask.stage import GlimpseRays
from laci_stereo.report.camera import Camera
from laci_stereo.report.canvas import as_bgr8
from laci_stereo.report.drawn import on_ground, sender_track, sensor_track
from laci_stereo.report.page.shapes import Label, Layer, Part, dots, lines, thinned
from laci_stereo.report.scene import GRID_AHEAD, background_edges, grid_places, ground_grid, vehicle_edges
from laci_stereo.report.style import lane_strokes, look_of

MOMENTS = (0.02, 0.2, 0.4, 0.6, 0.8, 0.98)
"""Times of the images, as fractions of the time in which the vehicle is seen."""

WIDEST_PX = 1600
MOST_BYTES = 600_000
"""Largest size of a JPEG image. Base 64 makes it a third larger, and six images take less than 5 MB of the page's 8."""

QUALITIES = (82, 70, 55, 40)

MOST_DOTS = 1500

BORDER = 0.03
"""Width of the image's border in which a label would be cut off, as a fraction of the image's size."""


@dataclass(frozen=True)
class Photograph:
    """A raw image of the left camera.

    Attributes
    ----------
    stamp_s : float
        When it was taken, seconds since the recording's first stamp.
    image : ndarray
    mask : GlimpseRays or None
        Result of the vehicle mask in this image, where there is a mask.
    """

    stamp_s: float
    image: Raster
    mask: GlimpseRays | None = None


@dataclass(frozen=True)
class Photographs:
    """Images of one camera, and its lens."""

    lens: Lens
    shots: tuple[Photograph, ...]


@dataclass(frozen=True)
class Shot:
    """An image, as JPEG in base 64, with the layers drawn over this image only."""

    stamp_s: float
    jpeg: str
    layers: tuple[Layer, ...]


@dataclass(frozen=True)
class Overlay:
    """Images of one camera, with the layers drawn over all of them.

    Attributes
    ----------
    width, height : int
        Size of the raw image, in whose pixels all paths are given.
    shots : tuple of Shot
    layers : tuple of Layer
    labels : tuple of Label
        Distances ahead of the grid's lines.
    """

    width: int
    height: int
    shots: tuple[Shot, ...]
    layers: tuple[Layer, ...]
    labels: tuple[Label, ...]


def draw_over(photographs: Photographs, calibration: Calibration, lane_map: LaneMap | None) -> Overlay:
    """Project the map, a grid, the tracks and the boxes into the images.

    With a correct calibration, the map's lines coincide with those of the road, and both boxes enclose the vehicle.
    """
    camera = Camera(photographs.lens, invert(calibration.T_world_sensor))
    width, height = photographs.lens.size
    return Overlay(
        width,
        height,
        tuple(_shot(shot, camera, calibration) for shot in photographs.shots),
        _layers(camera, calibration, lane_map),
        _grid_labels(camera, calibration),
    )


def _layers(camera: Camera, calibration: Calibration, lane_map: LaneMap | None) -> tuple[Layer, ...]:
    sent = [on_ground(track) for track in sender_track(calibration)]
    seen = on_ground(thinned(sensor_track(calibration), MOST_DOTS))
    layers = [
        Layer("grid", "Ground grid, 10 m", (_part(camera, "grid", ground_grid(calibration)),)),
        Layer("background", "Background boxes", (_part(camera, "background", background_edges(calibration)),), False),
        Layer("lanes", "Lines of the lane map", tuple(_lanes(camera, lane_map))),
        Layer("track", "Vehicle's tracks", (_part(camera, "sent", sent), Part("seen dots", _dots(camera, seen)))),
    ]
    return tuple(layer for layer in layers if any(part.d for part in layer.parts))


def _lanes(camera: Camera, lane_map: LaneMap | None) -> list[Part]:
    by_look: dict[str, list[FloatArray]] = {}
    for line, _ in lane_strokes(lane_map, (0, 0, 0), 1.0):
        by_look.setdefault(look_of(line), []).append(on_ground(line.xy))
    return [_part(camera, f"lane {look}", pieces) for look, pieces in by_look.items()]


def _shot(shot: Photograph, camera: Camera, calibration: Calibration) -> Shot:
    sent, seen = vehicle_edges(calibration, shot.stamp_s)
    layers: tuple[Layer, ...] = (
        Layer("sent-box", "Vehicle by its messages (CAM)", (_part(camera, "sent box", sent),)),
        Layer("seen-box", "Vehicle by the sensor", (_part(camera, "seen box", seen),)),
    )
    if shot.mask is not None:
        layers += _mask(Camera(camera.lens, np.eye(4)), shot.mask)
    return Shot(shot.stamp_s, jpeg(shot.image), layers)


def _mask(camera: Camera, mask: GlimpseRays) -> tuple[Layer, ...]:
    """Draw the vehicle mask's outlines, the points that it kept, and those that it dropped."""
    closed = [np.concatenate([outline, outline[:1]]) for outline in mask.outlines]
    kept, dropped = (_dots(camera, rays) for rays in (mask.kept, mask.dropped))
    return (
        Layer(
            "mask",
            "Vehicle mask, with points that it kept",
            (_part(camera, "mask", closed), Part("kept dots", kept)),
            False,
        ),
        Layer("dropped", "Points that the mask dropped", (Part("dropped dots", dropped),), False),
    )


def _dots(camera: Camera, points: FloatArray) -> str:
    pixels = camera.project(points)
    return dots(pixels[np.isfinite(pixels).all(axis=1)])


def _part(camera: Camera, look: str, lines_world: Sequence[FloatArray]) -> Part:
    return Part(look, lines(piece for line in lines_world for piece in camera.project_line(line)))


def _grid_labels(camera: Camera, calibration: Calibration) -> tuple[Label, ...]:
    width, height = camera.lens.size
    places = camera.project(grid_places(calibration))
    return tuple(
        Label(float(x), float(y), f"{distance:.0f} m")
        for distance, (x, y) in zip(GRID_AHEAD, places, strict=True)
        if 0 <= x < (1 - BORDER) * width and BORDER * height <= y < (1 - BORDER) * height
    )


def jpeg(image: Raster) -> str:
    """Return a picture as JPEG in base 64; the JPEG has at most `MOST_BYTES`, so that a page can hold several."""
    small = as_bgr8(image)
    share = min(1.0, WIDEST_PX / small.shape[1])
    while True:
        if share < 1.0:
            small = np.asarray(
                cv2.resize(small, None, fx=share, fy=share, interpolation=cv2.INTER_AREA), dtype=np.uint8
            )
        for quality in QUALITIES:
            content = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
            if len(content) <= MOST_BYTES:
                return b64encode(content).decode("ascii")
        share = 0.7  # only noise compresses so badly: no visible detail is lost
