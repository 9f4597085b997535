"""Projection of points and lines from the world into the raw image, with the lens' distortion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, transform
from laci_stereo.io.rig.stereo_rig import Lens
from laci_stereo.report.lines import clip_slab, runs, subdivide

NEAR_M = 0.1
"""Depth of the near clipping plane; anything nearer would be inside the camera's housing."""

FAR_M = 300.0
"""Depth of the far clipping plane, beyond which nothing is drawn: there, a metre is a few pixels."""

STEP_M = 0.5
"""Length of the pieces into which lines are cut, so that they follow the distortion."""

FOLD_DIRECTIONS = 72
FOLD_STEP_DEG = 0.25
WIDEST_DEG = 89.0
"""The search for the angle at which a lens' distortion folds back: number of directions in the image, step of the
angle from the optical axis, and its limit."""


@dataclass(frozen=True)
class Camera:
    """A lens and its pose: ``T_camera_world`` leads into the raw camera's frame (x right, y down, z forward)."""

    lens: Lens
    T_camera_world: FloatArray

    def project(self, points_world: FloatArray) -> FloatArray:
        """Project points, shape (n, 3), into the raw image.

        Returns
        -------
        ndarray, shape (n, 2)
            Pixels, which may lie outside the image; NaN behind the camera and where the lens model is not valid.
        """
        return self._project(transform(self.T_camera_world, points_world))

    def project_line(self, points_world: FloatArray) -> list[FloatArray]:
        """Project a line through points, shape (n, 3), into the raw image.

        Returns
        -------
        list of ndarray, shape (k, 2)
            The pieces in or near the image, in pixels, with at least two points each.
        """
        return [
            piece
            for line in clip_slab(transform(self.T_camera_world, points_world), 2, NEAR_M, FAR_M)
            for piece in self._pieces(self._project(subdivide(line, STEP_M)))
        ]

    def _project(self, points: FloatArray) -> FloatArray:
        pixels = np.full((len(points), 2), np.nan)
        # Clipping at the near plane leaves points on it, which rounding may put before it.
        ahead = points[:, 2] > (1 - 1e-6) * NEAR_M
        rays = points[ahead, :2] / points[ahead, 2:]
        angle = np.arctan2(rays[:, 1], rays[:, 0])
        valid = np.hypot(rays[:, 0], rays[:, 1]) < np.interp(angle, *self._fold, period=2 * np.pi)
        pixels[np.flatnonzero(ahead)[valid]] = _distort(self.lens, rays[valid])
        return pixels

    @cached_property
    def _fold(self) -> tuple[FloatArray, FloatArray]:
        """Directions in the image, shape (d,), and the largest ``tan(angle from the axis)`` with a valid model in each.

        As a ray moves away from the optical axis, its point in the image must move outwards too. Where the distortion
        polynomial folds back, it is outside the range to which it was fitted, and would project objects from far aside
        into the image.
        """
        directions = np.linspace(-np.pi, np.pi, FOLD_DIRECTIONS, endpoint=False)
        radii = np.tan(np.radians(np.arange(FOLD_STEP_DEG, WIDEST_DEG, FOLD_STEP_DEG)))
        outwards = np.column_stack([np.cos(directions), np.sin(directions)])
        rays = (outwards[:, None] * radii[:, None]).reshape(-1, 2)
        focal, centre = self.lens.K[[0, 1], [0, 1]], self.lens.K[:2, 2]
        seen = ((_distort(self.lens, rays) - centre) / focal).reshape(len(directions), len(radii), 2)
        moved_out = np.diff((seen * outwards[:, None]).sum(axis=2), axis=1, prepend=0.0) > 0.0
        steps = np.where(moved_out.all(axis=1), len(radii), moved_out.argmin(axis=1))
        # The very first step may already go back: then the model is valid nowhere in this direction.
        return directions, np.append(0.0, radii)[steps]

    def _pieces(self, pixels: FloatArray) -> Iterator[FloatArray]:
        """Yield the pieces of a line, shape (n, 2), within the image and a margin as wide as the image around it."""
        size = np.array(self.lens.size)
        with np.errstate(invalid="ignore"):
            near: BoolArray = np.all((pixels > -size) & (pixels < 2 * size), axis=1)
        # Keep the adjacent points too, so that a long segment that crosses the border is not lost.
        near[:-1] |= near[1:].copy()
        near[1:] |= near[:-1].copy()
        kept: BoolArray = near & np.isfinite(pixels).all(axis=1)
        yield from (pixels[run] for run in runs(kept))


def _distort(lens: Lens, rays: FloatArray) -> FloatArray:
    """Project rays of unit depth, shape (n, 2), into the raw image, shape (n, 2)."""
    if len(rays) == 0:
        return np.zeros((0, 2))
    points = np.column_stack([rays, np.ones(len(rays))])[:, None]
    still = np.zeros(3)
    if lens.model == "fisheye":
        pixels, _ = cv2.fisheye.projectPoints(points, still, still, lens.K, lens.distortion)
    else:
        pixels, _ = cv2.projectPoints(points, still, still, lens.K, lens.distortion)
    return np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
