"""The view of a map picture: which part of the world it shows, and the mapping from world to pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import FloatArray
from laci_stereo.core.result import Calibration
from laci_stereo.report.canvas import TEXT, Canvas
from laci_stereo.report.drawn import background_corners, drives_of, sensor_track
from laci_stereo.report.lines import clip_slab
from laci_stereo.report.style import BLACK, Stroke

NEAR_BACKGROUND_M = 12.0
"""Background boxes within this distance of the tracks and the sensor extend the view; those farther away do not."""

MARGIN_SHARE = 0.08
LEAST_EXTENT_M = 20.0

NICE = np.array([1.0, 2.0, 5.0])


@dataclass(frozen=True)
class MapView:
    """A part of the world, north up, and its mapping to a picture.

    Attributes
    ----------
    centre : ndarray, shape (2,)
        Centre of the view, world, metres.
    scale_px : float
        Pixels per metre.
    size : tuple of float
        Width and height of the picture, pixels.
    """

    centre: FloatArray
    scale_px: float
    size: tuple[float, float]

    def pixels(self, xy: FloatArray) -> FloatArray:
        """Map points of the world, shape (..., 2), to pixels relative to the upper left corner."""
        moved: FloatArray = (xy - self.centre) * [self.scale_px, -self.scale_px] + np.array(self.size) / 2
        return moved

    def line(self, xy: FloatArray) -> list[FloatArray]:
        """Return the pieces in view of a line, shape (n, 2), world, in pixels."""
        return [
            self.pixels(piece)
            for part in clip_slab(xy, 0, *self.extent_m(0))
            for piece in clip_slab(part, 1, *self.extent_m(1))
        ]

    def extent_m(self, axis: int) -> tuple[float, float]:
        """Return the least and the greatest coordinate in view, of x (0) or y (1)."""
        half = self.size[axis] / 2 / self.scale_px
        return float(self.centre[axis] - half), float(self.centre[axis] + half)

    def bar_m(self, share: float) -> float:
        """Return the greatest 1, 2 or 5 times a power of ten, in metres, that covers at most ``share`` of the width."""
        most = share * self.size[0] / self.scale_px
        steps = NICE * 10.0 ** np.floor(np.log10(most))
        return float(steps[steps <= most].max())


def map_view(calibration: Calibration, size: tuple[float, float]) -> MapView:
    """Choose a part of the world with the sensor, the vehicles' tracks while they were seen, and nearby background."""
    drives = list(drives_of(calibration))
    sent = [_seen_sender(drive) for drive in drives]
    shown = np.concatenate([sensor_track(calibration), *sent, calibration.T_world_sensor[None, :2, 3]])
    low, high = shown.min(axis=0), shown.max(axis=0)
    boxes = [box for drive in drives for box in background_corners(drive)]
    corners = [corner for box in boxes if _near(box, low, high) for corner in box]
    shown = np.concatenate([shown, np.array(corners).reshape(-1, 2)])
    low, high = shown.min(axis=0), shown.max(axis=0)
    extent = np.maximum((1 + 2 * MARGIN_SHARE) * (high - low), LEAST_EXTENT_M)
    return MapView((low + high) / 2, float((np.array(size) / extent).min()), size)


def draw_bar(canvas: Canvas, view: MapView, at: tuple[float, float], share: float, words: str = "") -> None:
    """Draw a scale bar with its left end at a pixel, over at most the fraction ``share`` of the map's width."""
    length_m, (x, y) = view.bar_m(share), at
    end, height = x + length_m * view.scale_px, 0.3 * TEXT * canvas.unit_px
    bracket = np.array([[x, y - height], [x, y], [end, y], [end, y - height]])
    canvas.lines([bracket], Stroke(BLACK, 2.0, halo=False))
    canvas.text(f"{length_m:g} m{words}", ((x + end) / 2, y - 2.6 * height), BLACK, align="centre")


def nice_step(span: float, count: int) -> float:
    """Return the smallest of 1, 2 or 5 times a power of ten that divides a span into at most ``count`` parts."""
    least = span / count
    steps = NICE * 10.0 ** np.floor(np.log10(least))
    return float(next((step for step in steps if step >= least * (1 - 1e-9)), 10 * steps[0]))


def multiples(low: float, high: float, step: float) -> FloatArray:
    """Return the multiples of a step from ``low`` to ``high``, shape (n,)."""
    return np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step + 0.0  # turns -0.0 into 0.0


def _near(corners: FloatArray, low: FloatArray, high: FloatArray) -> bool:
    """Return whether all corners of a box, shape (4, 2), are near the axis-aligned rectangle from low to high."""
    return bool((corners > low - NEAR_BACKGROUND_M).all() and (corners < high + NEAR_BACKGROUND_M).all())


def _seen_sender(calibration: Calibration) -> FloatArray:
    """Return the messages' positions at the times at which the vehicle was seen, world, shape (n, 2)."""
    xy, _, known = calibration.drive.vehicle.at(calibration.drive.track.stamps_s + calibration.drive.time_offset_s)
    seen: FloatArray = xy[known]
    return seen
