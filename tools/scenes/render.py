"""Stereo image pairs of a scene by ray casting: exact lenses, sun and sky, weak specular reflection, and sensor noise.

The static bodies are rendered once for each camera; in each frame, only the pixels that a moving body, its shadow or
its ambient occlusion can change are rendered again. Of these, static matt surfaces are only darkened; the rest is
traced anew.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, IntArray, Raster, invert, rigid
from laci_stereo.io.rig.stereo_rig import Lens, StereoRig
from tools.scenes.cameras import rays, write_calibration
from tools.scenes.geometry import Body, Hits, Material, RayCaster
from tools.scenes.imager import GREY, Sensor, develop
from tools.scenes.shading import AMBIENT_REACH_M, Light, Lit, Shader, Surface, sun_at
from tools.scenes.textures import mirror

Lattice = tuple[int, int]
STANDING_SAMPLES: Lattice = (13, 5)
"""Samples in a pixel at an edge: a square lattice with no two in the same row, column or diagonal, as thirteen is
prime."""

MOVING_SAMPLES: Lattice = (5, 2)
"""Likewise for an edge where something moves: the next frame samples the same edge at other points."""

GROUPS = 4
"""Groups of samples; each group samples other directions of the sky."""

STRIDE = 4
"""Spacing of the pixels that are tested for whether a moving body can change them."""

CREASE = 0.9
"""Cosine between the normals of neighbouring pixels below which an edge lies between them."""

STEP = 0.05
"""Relative difference in distance of neighbouring pixels that is an edge."""

LENS_BLUR_PX = 0.45
"""Standard deviation of the lens's blur, pixels: together with the pixel's own square and the textures' filter, it
leaves a contrast of about 0.2 at the finest pattern."""

CHUNK = 1 << 17

OTHER_KEYS = 1 << 32
"""Offset of the keys of what is rendered anew: with the moving bodies, bodies are numbered differently."""


@dataclass(frozen=True)
class Look:
    """The light and the sensor with which a scene is recorded."""

    light: Light
    sensor: Sensor


def random_look(rng: np.random.Generator) -> Look:
    """Draw a clear, hazy or overcast day and a sensor."""
    # Fraction of the light that comes directly from the sun: clear 0.8, hazy 0.5, overcast none.
    straight = float(rng.choice([0.8, 0.8, 0.5, 0.0]))
    sun = np.array([1.0, 0.95, 0.87]) * straight
    blue = np.array([0.75, 0.95, 1.3]) if straight > 0.6 else np.array([0.95, 1.0, 1.05])
    light = Light(sun_at(rng.uniform(0.0, 360.0), rng.uniform(15.0, 60.0)), sun, (1.0 - straight) * blue, 0.15)
    sensor = Sensor(
        exposure=rng.uniform(0.4, 0.9),
        right_gain=rng.uniform(0.85, 1.15),
        vignetting=rng.uniform(0.0, 0.4),
        gamma=float(rng.choice([1.0, 2.2])),
        bits=int(rng.choice([8, 8, 8, 16])),
        colour=bool(rng.random() < 0.5),
    )
    return Look(light, sensor)


@dataclass(frozen=True)
class Layer:
    """An image before the lens's blur, with what determines its edges, each of shape (height, width, ...)."""

    radiance: Raster
    key: Raster
    distance_m: Raster
    normal: Raster

    def flat(self) -> Layer:
        """Return a view of the same memory, pixel by pixel."""
        key, distance_m = self.key.reshape(-1), self.distance_m.reshape(-1)
        return Layer(self.radiance.reshape(-1, 3), key, distance_m, self.normal.reshape(-1, 3))

    def copy(self) -> Layer:
        """Return a copy with its own memory."""
        return Layer(self.radiance.copy(), self.key.copy(), self.distance_m.copy(), self.normal.copy())


@dataclass(frozen=True)
class Eye:
    """One camera in the world.

    Attributes
    ----------
    lens : Lens
    T_world_camera : ndarray, shape (4, 4)
    """

    lens: Lens
    T_world_camera: FloatArray

    @property
    def origin(self) -> FloatArray:
        """Position of the camera, shape (3,)."""
        return self.T_world_camera[:3, 3]

    @property
    def spread(self) -> float:
        """Angle of a pixel in the middle of the image, rad."""
        return float(1.0 / self.lens.K[0, 0])

    def directions(self, pixels: FloatArray) -> FloatArray:
        """Return the rays of raw pixels, shape (n, 2), in the world, unit, shape (n, 3)."""
        directions: FloatArray = rays(self.lens, pixels) @ self.T_world_camera[:3, :3].T
        return directions

    @cached_property
    def middles(self) -> FloatArray:
        """The rays of all pixels, row by row, shape (n, 3)."""
        width, height = self.lens.size
        return self.directions(_pixels(np.arange(width * height), width))


def _pixels(flat: IntArray, width: int) -> FloatArray:
    return np.column_stack([flat % width, flat // width]).astype(np.float64)


def eyes(rig: StereoRig, T_world_left: FloatArray) -> tuple[Eye, Eye]:
    """Return the left and the right camera."""
    T_right_left = rigid(rig.R_right_left, rig.t_right_left_m)
    return Eye(rig.left, T_world_left), Eye(rig.right, T_world_left @ invert(T_right_left))


class Renderer:
    """Renders the view of one camera.

    Parameters
    ----------
    bodies : sequence of Body
    eye : Eye
    light : Light
    """

    def __init__(self, bodies: Sequence[Body], eye: Eye, light: Light) -> None:
        self.eye = eye
        self.moving = tuple(body for body in bodies if not body.static)
        self._light = light
        self._still = Shader(RayCaster([body for body in bodies if body.static]), light)
        self._all = Shader(RayCaster(bodies), light)

    @cached_property
    def background(self) -> Layer:
        """The image of the static bodies."""
        width, height = self.eye.lens.size
        empty = Layer(
            np.zeros((height, width, 3), np.float32),
            np.zeros((height, width), np.int64),
            np.zeros((height, width), np.float32),
            np.zeros((height, width, 3), np.float32),
        )
        _sample(self._still, self.eye, empty, np.arange(width * height), 0.0)
        _smooth(self._still, self.eye, empty, np.flatnonzero(_edges(empty)), 0.0, STANDING_SAMPLES)
        return empty

    @cached_property
    def _standing(self) -> tuple[Surface, Lit]:
        """The static surface at each pixel, and the light on it; meaningless for the sky."""
        flat = self.background.flat()
        distance = np.where(flat.key >= 0, flat.distance_m, 0.0)
        view = self.eye.middles
        surface = Surface(
            self.eye.origin + view * distance[:, None],
            flat.normal.astype(np.float64),
            view,
            self.eye.spread * distance,
            flat.key,
        )
        return surface, self._still.lit(surface, flat.key % 2 == 1)

    @cached_property
    def _glossy(self) -> BoolArray:
        """Pixels that show a static surface with specular reflection, shape (n,)."""
        shiny = np.array([mirror(kind) > 0.0 for kind in Material])
        key = self.background.flat().key
        glossy: BoolArray = (key >= 0) & shiny[key // 2 % len(Material)]
        return glossy

    def radiance(self, time_s: float) -> Raster:
        """Return the light on the sensor, red-green-blue, shape (height, width, 3), without vignetting."""
        touched = self.touched(time_s)
        layer = self.background
        if touched.any():
            layer = layer.copy()
            self._move(layer, touched, time_s)
        return cv2.GaussianBlur(layer.radiance, (5, 5), LENS_BLUR_PX)

    def _move(self, layer: Layer, touched: BoolArray, time_s: float) -> None:
        """Render the moving bodies, and darken the static surfaces that they take light from."""
        flat, places = layer.flat(), np.flatnonzero(touched)
        none = np.full(len(places), -1)
        still = Hits(flat.distance_m[places].astype(np.float64), none, none, np.zeros((len(places), 3)))
        anew = self._all.caster.before(still, self.eye.origin, self.eye.middles[places], time_s).body >= 0
        anew |= self._glossy[places]
        matt = places[~anew & (flat.key[places] >= 0)]
        surface, lit = self._standing
        share, sunlit = self._all.dimmed(surface.part(matt), lit[matt], time_s)
        flat.radiance[matt] *= share
        flat.key[matt] = flat.key[matt] // 2 * 2 + sunlit
        _sample(self._all, self.eye, layer, places[anew], time_s)
        flat.key[places[anew]] += OTHER_KEYS
        changed = (layer.key != self.background.key).astype(np.uint8)
        beside = cv2.dilate(changed, np.ones((3, 3), np.uint8)) > 0
        edges = np.flatnonzero(_edges(layer) & beside & touched)
        _smooth(self._all, self.eye, layer, edges, time_s, MOVING_SAMPLES)

    def touched(self, time_s: float) -> BoolArray:
        """Return which pixels moving bodies, their shadows or their darkening can change, shape (height, width)."""
        width, height = self.eye.lens.size
        rows, columns = slice(STRIDE // 2, None, STRIDE), slice(STRIDE // 2, None, STRIDE)
        directions = self.eye.middles.reshape(height, width, 3)[rows, columns].reshape(-1, 3)
        distance = self.background.distance_m[rows, columns].astype(np.float64)
        met = np.isfinite(distance).ravel()
        points = self.eye.origin + directions[met] * distance.ravel()[met, None]
        coarse = np.zeros(distance.size, dtype=bool)
        for body in self.moving:
            T_body_world = invert(body.pose(time_s))
            R = T_body_world[:3, :3]
            low, high = body.mesh.vertices.min(axis=0), body.mesh.vertices.max(axis=0)
            away = np.linalg.norm(self.eye.origin @ R.T + T_body_world[:3, 3] - (low + high) / 2)
            # No pixel is farther than half a stride's diagonal from one that is tested.
            grown = STRIDE * self.eye.spread * (away + np.linalg.norm(high - low))
            origin = self.eye.origin @ R.T + T_body_world[:3, 3]
            coarse |= _pierces(origin[None], directions @ R.T, low - grown, high + grown)
            own = points @ R.T + T_body_world[:3, 3]
            beside = AMBIENT_REACH_M + grown
            dark = ((own > low - beside) & (own < high + beside)).all(axis=1)
            shaded = _pierces(own, (R @ self._light.to_sun)[None], low - grown, high + grown)
            coarse[met] |= dark | (shaded & bool(self._light.sun.any()))
        small = coarse.reshape(distance.shape).astype(np.uint8)
        full = np.repeat(np.repeat(small, STRIDE, axis=0), STRIDE, axis=1)
        padded = np.pad(full, ((0, STRIDE), (0, STRIDE)), mode="edge")[:height, :width]
        return padded > 0


def _pierces(origins: FloatArray, directions: FloatArray, low: FloatArray, high: FloatArray) -> BoolArray:
    """Return which rays pass through a box that is aligned with the axes of their frame (slabs)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / directions
        one, other = (low - origins) * inverse, (high - origins) * inverse
    enter = np.fmax.reduce(np.minimum(one, other), axis=1)
    leave = np.fmin.reduce(np.maximum(one, other), axis=1)
    through: BoolArray = (leave >= enter) & (leave > 0.0)
    return through


def _sample(shader: Shader, eye: Eye, layer: Layer, places: IntArray, time_s: float) -> None:
    """Render pixels with one sample each."""
    flat = layer.flat()
    for chunk in _chunks(places, CHUNK):
        found = shader.trace(eye.origin, eye.middles[chunk], eye.spread, time_s)
        flat.radiance[chunk], flat.key[chunk] = found.radiance, found.key
        flat.distance_m[chunk], flat.normal[chunk] = found.distance_m, found.normal


def _smooth(shader: Shader, eye: Eye, layer: Layer, edges: IntArray, time_s: float, lattice: Lattice) -> None:
    """Render pixels that an edge crosses with several samples each."""
    width = eye.lens.size[0]
    flat = layer.flat()
    flat.radiance[edges] = 0.0
    count, step = lattice
    along = np.arange(count)
    shifts = (np.column_stack([along, step * along % count]) + 0.5) / count - 0.5
    for number in range(GROUPS):
        group, part = shifts[number::GROUPS], replace(shader, ambient=(number, GROUPS))
        for chunk in _chunks(edges, CHUNK // len(group)):
            fine = (_pixels(chunk, width)[:, None] + group).reshape(-1, 2)
            light = part.trace(eye.origin, eye.directions(fine), eye.spread, time_s).radiance
            flat.radiance[chunk] += light.reshape(len(chunk), -1, 3).sum(axis=1) / count


def _chunks(items: IntArray, size: int) -> Iterator[IntArray]:
    for start in range(0, len(items), size):
        yield items[start : start + size]


def _edges(layer: Layer) -> BoolArray:
    """Return the pixels on either side of a change of body, material, shadow, direction or distance."""
    edges = np.zeros(layer.key.shape, dtype=bool)
    for one, other in (
        ((slice(None), slice(1, None)), (slice(None), slice(None, -1))),
        ((slice(1, None), slice(None)), (slice(None, -1), slice(None))),
    ):
        near, far = layer.distance_m[one], layer.distance_m[other]
        with np.errstate(invalid="ignore"):
            stepped = np.abs(near - far) > STEP * np.minimum(near, far)
        bent = np.einsum("ijk,ijk->ij", layer.normal[one], layer.normal[other]) < CREASE
        same = layer.key[one] == layer.key[other]
        # There are no bends or steps within the sky.
        between = ~same | ((bent | stepped) & (layer.key[one] >= 0))
        edges[one] |= between
        edges[other] |= between
    return edges


def exposure_scale(layer: Layer, sensor: Sensor) -> float:
    """Return the fraction of the full well for a unit of radiance, from the left camera's background."""
    solid = layer.radiance[layer.key >= 0] @ GREY
    return float(sensor.exposure / np.quantile(solid, 0.95)) if len(solid) else 1.0


def stereo_pairs(
    bodies: Sequence[Body],
    rig: StereoRig,
    T_world_left: FloatArray,
    times_s: FloatArray,
    look: Look,
    seed: int,
    apart_s: float = 0.0,
) -> Iterator[tuple[Raster, Raster]]:
    """Render left and right images, one pair at a time; the same seed gives the same images."""
    left, right = (Renderer(bodies, eye, look.light) for eye in eyes(rig, T_world_left))
    scale = exposure_scale(left.background, look.sensor)
    for index, time_s in enumerate(times_s):
        images = [
            develop(
                camera.radiance(float(time_s) + side * apart_s),
                camera.eye.lens,
                look.sensor,
                scale * gain,
                np.random.default_rng([seed, index, side]),
            )
            for side, (camera, gain) in enumerate(((left, 1.0), (right, look.sensor.right_gain)))
        ]
        yield images[0], images[1]


def write_stereo(
    bodies: Sequence[Body],
    rig: StereoRig,
    T_world_left: FloatArray,
    times_s: FloatArray,
    stamps_ns: Sequence[int],
    folder: Path,
    look: Look,
    seed: int,
    told: StereoRig | None = None,
    apart_s: float = 0.0,
) -> None:
    """Write ``left/``, ``right/`` (PNG, named by their stamps) and ``stereo.yaml``, frame by frame.

    Parameters
    ----------
    bodies : sequence of Body
    rig : StereoRig
    T_world_left : ndarray, shape (4, 4)
        Pose of the raw left camera.
    times_s : ndarray, shape (n,)
        Times of the bodies' poses in the frames.
    stamps_ns : sequence of int, length n
    folder : Path
        Created if it does not exist.
    look : Look
    seed : int
        Seed of the sensors' noise.
    told : StereoRig or None
        The rig that the calibration file describes; None writes the true one.
    apart_s : float
        Time from the left to the right images; the stamps are those of the left ones.
    """
    sides = [folder / "left", folder / "right"]
    for side in sides:
        side.mkdir(parents=True, exist_ok=True)
    write_calibration(folder / "stereo.yaml", told or rig)
    pairs = stereo_pairs(bodies, rig, T_world_left, times_s, look, seed, apart_s)
    for stamp, pair in zip(stamps_ns, pairs, strict=True):
        for side, image in zip(sides, pair, strict=True):
            cv2.imwrite(str(side / f"{stamp}.png"), image, [cv2.IMWRITE_PNG_COMPRESSION, 1])
