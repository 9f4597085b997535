"""A road with boxes on it, as a stereo rig of any lenses sees it: exact rays, solid texture, and the truth per pixel.

Road frame: x forward, y left, z up, origin on the road under the left camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from laci_stereo.core.frames import FloatArray, IntArray, Raster, rotation_z
from laci_stereo.io.rig.stereo_rig import Lens, StereoRig

ROAD = 0
NOTHING = -1
SKY_GREY = 235.0
WAVELENGTHS_M = tuple(0.03 * 2.0**k for k in range(8))
CONTRAST = 11.0
# Camera axes in forward-left-up axes: x right, y down, z forward.
R_FLU_OPENCV = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
_TILE = 512
_TILE_WAVE = 16.0


@dataclass(frozen=True)
class Box:
    """An upright box in the road frame, with its own texture, which moves with it."""

    x: float
    y: float
    yaw_rad: float = 0.0
    length_m: float = 4.5
    width_m: float = 1.8
    height_m: float = 1.5
    bottom_m: float = 0.0
    grey: float = 130.0
    seed: int = 1
    contrast: float = 1.0

    @property
    def half(self) -> FloatArray:
        return np.array([self.length_m / 2, self.width_m / 2, self.height_m / 2])

    def into(self, points_road: FloatArray) -> FloatArray:
        """Return points, shape (..., 3), in the box's frame, its origin at the centre of the box."""
        centre = np.array([self.x, self.y, self.bottom_m + self.height_m / 2])
        return turned(points_road - centre, rotation_z(self.yaw_rad).T)

    def distance(self, points_road: FloatArray) -> FloatArray:
        """Return the distances of points, shape (n, 3), to the box's surface."""
        q = np.abs(self.into(points_road)) - self.half
        outside = np.linalg.norm(np.maximum(q, 0.0), axis=-1)
        return np.abs(outside + np.minimum(q.max(axis=-1), 0.0))


@dataclass(frozen=True)
class Mounting:
    """Where the left camera hangs: height, pitch downwards, roll."""

    height_m: float = 6.0
    tilt_deg: float = 20.0
    roll_deg: float = 0.0

    @property
    def R_road_left(self) -> FloatArray:
        t, r = np.radians([self.tilt_deg, self.roll_deg])
        pitch = np.array([[np.cos(t), 0.0, np.sin(t)], [0.0, 1.0, 0.0], [-np.sin(t), 0.0, np.cos(t)]])
        roll = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(r), -np.sin(r)], [0.0, np.sin(r), np.cos(r)]])
        R: FloatArray = pitch @ roll @ R_FLU_OPENCV
        return R

    def to_road(self, points_sensor: FloatArray) -> FloatArray:
        return turned(points_sensor, self.R_road_left) + np.array([0.0, 0.0, self.height_m])


@dataclass(frozen=True)
class View:
    """What a camera sees: grey values without noise, and for each pixel the surface at its middle.

    ``points`` are in the raw left camera's frame, NaN where there is nothing; ``owner`` is `NOTHING`, `ROAD`, or the
    box's place in the list plus 1.
    """

    grey: FloatArray
    points: FloatArray
    owner: IntArray


def render(
    rig: StereoRig, mounting: Mounting, boxes: Sequence[Box], samples: int = 2, road_contrast: float = 1.0
) -> tuple[View, View]:
    """Render both cameras' raw images."""
    places = ((rig.left, np.eye(3), np.zeros(3)), (rig.right, rig.R_right_left, rig.t_right_left_m))
    left, right = (_view(lens, R, t, mounting, boxes, samples, road_contrast) for lens, R, t in places)
    return left, right


def turned(points: FloatArray, R: FloatArray) -> FloatArray:
    """Return R p of points, shape (..., 3); without BLAS, whose threads wait for one another on a busy machine."""
    x, y, z = np.moveaxis(points, -1, 0)
    return np.stack([row[0] * x + row[1] * y + row[2] * z for row in R], axis=-1)


def expose(
    view: View, rng: np.random.Generator, gain: float = 1.0, bits: int = 8, colour: bool = False, noise: float = 1.5
) -> Raster:
    """Return the image that a camera writes; noise in grey values of 255, more than 8 bits in a 16-bit image."""
    grey = gain * view.grey
    if colour:
        grey = grey[:, :, None] * np.array([0.9, 1.0, 1.05])
    seen = (grey + noise * rng.standard_normal(grey.shape, dtype=np.float32)) * ((2**bits - 1) / 255)
    return np.clip(np.rint(seen), 0, 2**bits - 1).astype(np.uint8 if bits == 8 else np.uint16)


def rays(lens: Lens, u: FloatArray, v: FloatArray) -> FloatArray:
    """Return the rays of pixels, shape (n, 3), with unit depth."""
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
    if not np.any(lens.distortion) and lens.model == "pinhole":
        flat = (pixels - lens.K[:2, 2]) / np.diag(lens.K)[:2]
    elif lens.model == "fisheye":
        flat = cv2.fisheye.undistortPoints(pixels, lens.K, lens.distortion)
    else:
        precisely = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-9)
        flat = cv2.undistortPoints(pixels, lens.K, lens.distortion, None, None, None, precisely)
    return np.concatenate([flat[:, 0, :], np.ones((len(pixels), 1))], axis=1)


def project(lens: Lens, points_camera: FloatArray) -> FloatArray:
    """Return the raw pixels, shape (n, 2), of points in a camera's own frame, shape (n, 3)."""
    points = np.ascontiguousarray(points_camera, dtype=np.float64).reshape(-1, 1, 3)
    zero = np.zeros(3)
    if lens.model == "fisheye":
        return cv2.fisheye.projectPoints(points, zero, zero, lens.K, lens.distortion)[0].reshape(-1, 2)
    return cv2.projectPoints(points, zero, zero, lens.K, lens.distortion)[0].reshape(-1, 2)


def _view(
    lens: Lens,
    R: FloatArray,
    t: FloatArray,
    mounting: Mounting,
    boxes: Sequence[Box],
    samples: int,
    road_contrast: float,
) -> View:
    width, height = lens.size
    v, u = np.mgrid[:height, :width].astype(np.float64)
    origin_left = -R.T @ t
    origin = mounting.to_road(origin_left[None])[0]
    to_road = mounting.R_road_left @ R.T

    def cast(du: float, dv: float) -> tuple[FloatArray, FloatArray, IntArray]:
        directions = turned(rays(lens, (u + du).ravel(), (v + dv).ravel()), to_road)
        return directions, *trace(origin, directions, boxes)

    grey = np.zeros(height * width, dtype=np.float32)
    offsets = (np.arange(samples) + 0.5) / samples - 0.5
    pixel = 1.0 / float(lens.K[0, 0])
    for dv in offsets:
        for du in offsets:
            grey += _shade(origin, *cast(du, dv), boxes, pixel, road_contrast)
    directions, depth, owner = cast(0.0, 0.0)
    points_road = origin + directions * depth[:, None]
    points = turned(points_road - np.array([0.0, 0.0, mounting.height_m]), mounting.R_road_left.T)
    points[owner == NOTHING] = np.nan
    shape = (height, width)
    return View((grey / samples**2).reshape(shape), points.reshape(*shape, 3), owner.reshape(shape))


def trace(origin: FloatArray, directions: FloatArray, boxes: Sequence[Box]) -> tuple[FloatArray, IntArray]:
    """Return how many times its direction each ray goes until it meets something (0: nothing), and its owner.

    Parameters
    ----------
    origin : ndarray, shape (3,)
        Road frame.
    directions : ndarray, shape (n, 3)
        Road frame, of any length.
    boxes : sequence of Box
    """
    with np.errstate(divide="ignore"):
        depth = np.where(directions[:, 2] < 0, -origin[2] / directions[:, 2], np.inf)
    owner = np.where(np.isfinite(depth), ROAD, NOTHING)
    for number, box in enumerate(boxes, start=1):
        start, into = box.into(origin), turned(directions, rotation_z(box.yaw_rad).T).T
        enter, leave = np.zeros(len(depth)), depth
        with np.errstate(divide="ignore", invalid="ignore"):
            for axis in range(3):
                slower = 1.0 / into[axis]
                one, other = (-box.half[axis] - start[axis]) * slower, (box.half[axis] - start[axis]) * slower
                enter, leave = np.fmax(enter, np.fmin(one, other)), np.fmin(leave, np.fmax(one, other))
        hit = (enter < leave) & (enter > 0)
        depth[hit], owner[hit] = enter[hit], number
    return np.where(owner == NOTHING, 0.0, depth), owner


def _shade(
    origin: FloatArray,
    directions: FloatArray,
    depth: FloatArray,
    owner: IntArray,
    boxes: Sequence[Box],
    pixel: float,
    road_contrast: float,
) -> FloatArray:
    grey = np.full(len(depth), SKY_GREY, dtype=np.float32)
    points = origin + directions * depth[:, None]
    for number in range(len(boxes) + 1):
        mine = np.flatnonzero(owner == number)
        if number == ROAD:
            local, base, contrast, seed = points[mine], 100.0, road_contrast, 0
            # Seen at a grazing angle, a pixel covers a long piece of the road.
            stretch = np.abs(directions[mine, 2])
        else:
            box = boxes[number - 1]
            local, base, contrast, seed = box.into(points[mine]), box.grey, box.contrast, box.seed
            stretch = np.ones(len(mine))
        footprint = depth[mine] * pixel / np.clip(stretch, 0.05, 1.0)
        grey[mine] = base + contrast * CONTRAST * _solid_noise(local, footprint, seed)
    return grey


def _solid_noise(points: FloatArray, footprint_m: FloatArray, seed: int) -> FloatArray:
    """Return noise of unit strength per octave at points, shape (n, 3), without waves below three footprints."""
    if len(points) == 0:
        return np.zeros(0, dtype=np.float32)
    rng = np.random.default_rng(seed)
    points, total = points.astype(np.float32), np.zeros(len(points), dtype=np.float32)
    for wavelength in WAVELENGTHS_M:
        axes = np.linalg.qr(rng.normal(size=(3, 3)))[0] * (_TILE_WAVE / wavelength)
        axes, place = axes.astype(np.float32), rng.uniform(0, _TILE, 3).astype(np.float32)
        strength = np.clip(wavelength / footprint_m / 2.0 - 1.0, 0.0, 1.0).astype(np.float32)
        some = np.flatnonzero(strength)
        if len(some) == 0:
            continue
        x, y, z = (_wrapped(q + shift) for q, shift in zip(turned(points[some], axes).T, place, strict=True))
        total[some] += strength[some] * (_tile_at(x, y) + _tile_at(y, z) + _tile_at(z, x)) / np.float32(np.sqrt(3.0))
    return total


def _wrapped(q: Raster) -> Raster:
    wrapped: Raster = q - np.floor(q * np.float32(1.0 / _TILE)) * np.float32(_TILE)
    return wrapped


def _tile_at(x: Raster, y: Raster) -> Raster:
    """Look the tile up at any number of places; OpenCV's images may not be wider than 32767."""
    n = len(x)
    rows = -(-n // 4096)
    padded = [np.resize(a, rows * 4096).reshape(rows, 4096) for a in (x, y)]
    return cv2.remap(_tile(), padded[0], padded[1], cv2.INTER_LINEAR).ravel()[:n]


@lru_cache(maxsize=1)
def _tile() -> Raster:
    """Return periodic noise of wavelengths about `_TILE_WAVE` pixels, standard deviation 1, with one pixel repeated."""
    rng = np.random.default_rng(7)
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(_TILE), np.fft.fftfreq(_TILE), indexing="ij"))
    band = (frequency > 0.5 / _TILE_WAVE) & (frequency < 1.0 / _TILE_WAVE)
    tile = np.fft.ifft2(np.fft.fft2(rng.normal(size=(_TILE, _TILE))) * band).real
    return np.pad(tile / tile.std(), ((0, 1), (0, 1)), mode="wrap").astype(np.float32)
