"""A painted road seen by a camera, without error: each pixel's ray meets the plane, and paint is where lines are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import cv2
import numpy as np

from laci_stereo.check.images import paint_in_image
from laci_stereo.check.lanes import LaneCheck, check_lanes
from laci_stereo.check.placed import Placed
from laci_stereo.check.sections import PAINTED
from laci_stereo.core.frames import FloatArray, Raster, invert, planar, rigid, rotation_z, transform
from laci_stereo.io.maps.lane_map import LaneLine
from laci_stereo.io.rig.stereo_rig import Lens
from laci_stereo.report.camera import Camera

CLAIMED = np.diag(np.array([3e-4, 3e-4, 1e-3, 0.04, 0.04, 0.005]) ** 2)
CENTRE = np.array([0.0, 20.0, 0.0])
LENS = Lens(np.array([[600.0, 0.0, 399.5], [0.0, 600.0, 299.5], [0.0, 0.0, 1.0]]), np.zeros(5), (800, 600), "pinhole")
BARREL = replace(LENS, distortion=np.array([-0.25, 0.08, 1e-3, -5e-4, 0.0]))
FINE = 3
"""Rays in a pixel, to either side."""


def line(*points: tuple[float, float], kind: str = "line_thin", subtype: str = "solid", name: str = "") -> LaneLine:
    return LaneLine(kind, subtype, np.array(points, dtype=np.float64), name or f"{points[0]}")


CROSSING = (
    line((-3.3, 5.0), (-3.3, 16.0)),
    line((3.3, 5.0), (3.3, 16.0)),
    line((0.0, 5.0), (0.0, 16.0)),
    line((-3.3, 25.0), (-3.3, 45.0)),
    line((3.3, 25.0), (3.3, 45.0)),
    line((-14.0, 17.0), (-4.0, 17.0)),
    line((4.0, 17.0), (14.0, 17.0)),
    line((-16.0, 24.0), (-4.0, 24.0)),
    line((4.0, 24.0), (16.0, 24.0)),
)
"""A camera at the origin looks along y."""


def looking_north(height_m: float = 6.0, tilt_deg: float = 18.0) -> FloatArray:
    tilt = np.radians(tilt_deg)
    forward = np.array([0.0, np.cos(tilt), -np.sin(tilt)])
    right = np.array([1.0, 0.0, 0.0])
    rotation = np.column_stack([right, np.cross(forward, right), forward])
    return rigid(rotation, np.array([0.0, 0.0, height_m]))


@dataclass(frozen=True)
class Painted:
    """A road with paint, ``beside`` the lines of the map by so much to their left (each of several)."""

    lines: tuple[LaneLine, ...] = CROSSING
    beside_m: tuple[float, ...] = (0.0,)
    width_m: float = 0.12
    lens: Lens = LENS
    T_world_camera: FloatArray = field(default_factory=looking_north)
    boxes: FloatArray = field(default_factory=lambda: np.zeros((0, 6)))
    texture: float = 6.0

    @cached_property
    def image(self) -> Raster:
        width, height = self.lens.size
        shifts = (np.arange(FINE) + 0.5) / FINE - 0.5
        u, v = np.meshgrid(np.arange(width), np.arange(height))
        total = np.zeros((height, width))
        for dx in shifts:
            for dy in shifts:
                total += self._light(np.stack([u + dx, v + dy], axis=-1).reshape(-1, 2)).reshape(height, width)
        rng = np.random.default_rng(5)
        grain = cv2.GaussianBlur(rng.normal(size=(height, width)), (0, 0), 1.5)
        return np.clip(total / FINE**2 + self.texture * grain / grain.std(), 0, 255).astype(np.uint8)

    def _light(self, pixels: FloatArray) -> FloatArray:
        until = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-9)
        flat = cv2.undistortPoints(
            pixels[:, None].astype(np.float64), self.lens.K, self.lens.distortion, criteria=until
        )
        rays = np.column_stack([flat[:, 0], np.ones(len(pixels))]) @ self.T_world_camera[:3, :3].T
        down = rays[:, 2] < -1e-3
        reach = np.where(down, -self.T_world_camera[2, 3] / np.where(down, rays[:, 2], -1.0), 0.0)
        xy = self.T_world_camera[:2, 3] + reach[:, None] * rays[:, :2]
        light = np.full(len(pixels), 230.0)
        light[down] = np.where(self.is_paint(xy[down]), 190.0, 90.0)
        return light

    def is_paint(self, xy: FloatArray) -> FloatArray:
        paint = np.zeros(len(xy), dtype=bool)
        for each in self.lines:
            (start, end), length = each.xy, np.linalg.norm(each.xy[1] - each.xy[0])
            ahead = (end - start) / length
            left = np.array([-ahead[1], ahead[0]])
            across = xy @ left - start @ left
            for beside in self.beside_m:
                near = np.flatnonzero(np.abs(across - beside) < self.width_m / 2)
                along = (xy[near] - start) @ ahead
                paint[near] |= (along > 0) & (along < length)
        return paint

    def check(
        self,
        T_error: FloatArray | None = None,
        lines: Sequence[LaneLine] | None = None,
        covariance: FloatArray = CLAIMED,
        map_sigma_m: float = 0.05,
        kinds: Sequence[str] = PAINTED,
    ) -> LaneCheck:
        """Check a calibration that is off by a transform of the world."""
        T = self.T_world_camera if T_error is None else T_error @ self.T_world_camera
        placed = Placed(T, covariance, CENTRE, self.boxes)
        see = partial(paint_in_image, self.image, Camera(self.lens, invert(T)))
        return check_lanes(self.lines if lines is None else lines, placed, see, map_sigma_m, kinds)


def shift(east_m: float, north_m: float) -> FloatArray:
    return planar(0.0, np.array([east_m, north_m]))


def turn_about(xy: FloatArray, degrees: float) -> FloatArray:
    about = rigid(np.eye(3), np.append(xy, 0.0))
    return about @ rigid(rotation_z(np.radians(degrees)), np.zeros(3)) @ invert(about)


def moved_by(T_error: FloatArray, centre: FloatArray) -> FloatArray:
    """Return the planar error, shape (2,), of the ground at a point of it as the wrong calibration has it."""
    true = transform(invert(T_error), np.append(centre, 0.0)[None])[0]
    return (np.append(centre, 0.0) - true)[:2]
