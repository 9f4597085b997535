"""Brightness profiles across a map's lines, in metres on the ground."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from laci_stereo.check.sections import SECTION_M, Sections
from laci_stereo.core.frames import BoolArray, FloatArray, Raster
from laci_stereo.report.camera import Camera
from laci_stereo.report.drawn import on_ground

REACH_M = 1.5
"""Range on either side of a line: farther off, a lane's other line is nearer."""

STEP_M = 0.03
"""Sampling interval across a line; the narrowest paint, 8 cm, covers nearly three."""

ROWS = 8
"""Number of samples along a section; their mean is the section's profile."""

WIDEST = 30_000
"""Largest number of columns passed to OpenCV, whose images have at most 32 767."""

OFFSETS_M = np.arange(-round(REACH_M / STEP_M), round(REACH_M / STEP_M) + 1) * STEP_M
"""Offsets at which a profile is sampled, to the left of its line, shape (m,)."""


@dataclass(frozen=True)
class Profiles:
    """Brightness that a sensor saw across sections of lines.

    Attributes
    ----------
    values : ndarray, shape (n, m)
        Brightness at `OFFSETS_M`; NaN if nothing was seen there.
    cell_m : ndarray, shape (n,)
        Width that a pixel, or the spacing of points, covers across the line; infinite if nothing was seen.
    in_image : bool
        Cells are pixels.
    """

    values: FloatArray
    cell_m: FloatArray
    in_image: bool


def profiles_in_image(image: Raster, camera: Camera, sections: Sections) -> Profiles:
    """Sample a raw grey image across sections of lines on the ground, with lens distortion taken into account."""
    values = np.full((len(sections), len(OFFSETS_M)), np.nan)
    cell_m = cell_across(camera, sections)
    # If a pixel covers more than the width of the paint, the paint blends with its surroundings.
    seen = np.flatnonzero((cell_m <= sections.width_m) & _inside(camera.project(on_ground(sections.xy)), image))
    places = _window(sections[seen])
    pixels = camera.project(on_ground(places.reshape(-1, 2))).reshape(places.shape)
    values[seen] = np.where(_inside(pixels, image), _look_up(image.astype(np.float32), pixels), np.nan).mean(axis=1)
    return Profiles(values, cell_m, in_image=True)


def _window(sections: Sections) -> FloatArray:
    """Return the sampling positions of sections, world, shape (n, rows, m, 2)."""
    rows = ((np.arange(ROWS) + 0.5) / ROWS - 0.5) * SECTION_M
    along = rows[None, :, None, None] * sections.ahead[:, None, None]
    return np.asarray(sections.xy[:, None, None] + along + OFFSETS_M[:, None] * sections.left[:, None, None])


def _inside(pixels: FloatArray, image: Raster) -> BoolArray:
    """Return which pixels, shape (..., 2), are inside an image; NaN is not."""
    height, width = image.shape
    return np.asarray(((pixels >= 0.0) & (pixels <= [width - 1, height - 1])).all(axis=-1))


def _look_up(image: Raster, pixels: FloatArray) -> FloatArray:
    """Return an image's values interpolated at pixels, shape (..., 2); values outside the image are meaningless."""
    if pixels.size == 0:
        return np.zeros(pixels.shape[:-1])
    places = np.nan_to_num(pixels, nan=-1.0).astype(np.float32).reshape(-1, 2)
    parts = [
        cv2.remap(image, part[None, :, 0], part[None, :, 1], cv2.INTER_LINEAR)[0]
        for part in np.split(places, np.arange(WIDEST, len(places), WIDEST))
    ]
    return np.concatenate(parts).astype(np.float64).reshape(pixels.shape[:-1])


def cell_across(camera: Camera, sections: Sections) -> FloatArray:
    """Return the width that a pixel covers across sections, metres, shape (n,); infinite if they are not in view."""
    ends = [camera.project(on_ground(sections.xy + side * STEP_M * sections.left)) for side in (-1.0, 1.0)]
    apart_px = np.linalg.norm(ends[1] - ends[0], axis=1)
    return np.where(apart_px > 0, 2 * STEP_M / np.maximum(apart_px, 1e-9), np.inf)
