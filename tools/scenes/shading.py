"""The light along rays: the sun and its shadows, the sky and its occlusion, and specular reflection."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, IntArray
from tools.scenes.geometry import Body, Material, RayCaster
from tools.scenes.textures import Patch, mirror, mirrored, noise, octaves, reflectance

STRETCHES = (1, 2, 4, 8)
"""Numbers of texture samples along the longer side of a ray's footprint."""

AMBIENT_RAYS = 16
"""Number of directions, uniformly distributed over the sky, in which its light is sampled."""

AMBIENT_REACH_M = 3.0
"""Distance within which a moving body occludes the sky, with an effect that decreases to zero: twice the body's
height."""

LIFT_M = 2e-3
"""Height above a surface at which rays start: more than the single-precision error at 100 m, less than any part of a
car."""

GLINT = 300.0
"""Exponent of the sun's glint on clear coat and glass: 3 degrees wide."""

GROUND_GLOW = 0.15
"""Fraction of the light that the ground reflects: between asphalt and dry grass."""


@dataclass(frozen=True)
class Light:
    """Sun and sky; radiance is relative to a white, matt surface that faces the clear sun.

    Attributes
    ----------
    to_sun : ndarray, shape (3,)
        Unit vector in the world.
    sun, sky : ndarray, shape (3,)
        Red-green-blue: light of the sun on a surface that faces it; mean of the sky.
    clouds : float
        Contrast of the clouds.
    """

    to_sun: FloatArray
    sun: FloatArray
    sky: FloatArray
    clouds: float

    def of_sky(self, directions: FloatArray) -> FloatArray:
        """Return the sky's radiance, shape (n, 3); brighter towards the horizon, the ground's glow below it."""
        up = directions[:, 2]
        flat = directions / np.maximum(up, 0.05)[:, None]
        cloud = noise(flat, np.full(len(up), 0.02), octaves(0.5, (0.3, 0.5, 0.8)), 7) if self.clouds else 0.0
        # The cosine-weighted mean over the upper hemisphere is 1.
        bright = (2.0 - 1.5 * np.clip(up, 0.0, 1.0)) * np.clip(
            1.0 + self.clouds * np.clip(3.0 * up, 0.0, 1.0) * cloud, 0.2, 3.0
        )
        return np.where(up[:, None] > 0.0, bright[:, None] * self.sky, GROUND_GLOW * self.level)

    @property
    def level(self) -> FloatArray:
        """Light on level ground, shape (3,)."""
        lit: FloatArray = self.sun * self.to_sun[2] + self.sky
        return lit


def sun_at(azimuth_deg: float, elevation_deg: float) -> FloatArray:
    """Return the direction to the sun, shape (3,); azimuth is counter-clockwise from the world's x."""
    a, e = np.radians([azimuth_deg, elevation_deg])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


@dataclass(frozen=True)
class Samples:
    """The surfaces that rays met, and the light that comes along them.

    Attributes
    ----------
    radiance : ndarray, shape (n, 3)
    key : ndarray, shape (n,)
        Body, material and whether the sun shines there, in one number; -1 for the sky, -2 for below the horizon.
    distance_m : ndarray, shape (n,)
    normal : ndarray, shape (n, 3)
    """

    radiance: FloatArray
    key: IntArray
    distance_m: FloatArray
    normal: FloatArray


@dataclass(frozen=True)
class Lit:
    """The light on surfaces in the absence of moving bodies.

    Attributes
    ----------
    light : ndarray, shape (n, 3)
        Relative to the light on a surface that faces the clear sun.
    sunlit : ndarray of bool, shape (n,)
    open_ : ndarray of bool, shape (n, AMBIENT_RAYS)
        The directions of the sky from which light arrives.
    """

    light: FloatArray
    sunlit: BoolArray
    open_: BoolArray

    def __getitem__(self, chosen: IntArray) -> Lit:
        return Lit(self.light[chosen], self.sunlit[chosen], self.open_[chosen])


@dataclass(frozen=True)
class Shader:
    """Computes the light along rays.

    Attributes
    ----------
    caster : RayCaster
    light : Light
    ambient : tuple of int
        Which of the `AMBIENT_RAYS` directions of the sky are sampled: the first, and the step to the next.
    """

    caster: RayCaster
    light: Light
    ambient: tuple[int, int] = (0, 1)

    def trace(
        self, origins: FloatArray, directions: FloatArray, spread: float, time_s: float, mirrors: bool = True
    ) -> Samples:
        """Trace rays.

        Parameters
        ----------
        origins : ndarray, shape (n, 3) or (3,)
        directions : ndarray, shape (n, 3)
        spread : float
            Angular width of a ray, rad.
        time_s : float
        mirrors : bool
            Whether glossy surfaces show specular reflections; what they reflect does not.
        """
        hits = self.caster.cast(origins, directions, time_s)
        radiance = np.empty((len(directions), 3))
        key = np.where(directions[:, 2] > 0.0, np.int64(-1), np.int64(-2))
        nothing = hits.body < 0
        radiance[nothing] = self.light.of_sky(directions[nothing])
        met = np.flatnonzero(~nothing)
        starts = origins if origins.ndim == 1 else origins[met]
        view, normal = directions[met], hits.normal[met]
        surface = Surface(
            starts + view * hits.distance_m[met, None], normal, view, spread * hits.distance_m[met], hits.body[met]
        )
        material = self._materials(hits.body[met], hits.triangle[met])
        sunlit = self._sunlit(surface, time_s)
        radiance[met] = self._albedo(surface, material, time_s) * self._irradiance(surface, sunlit, time_s)
        if mirrors:
            self._add_mirrored(radiance, met, surface, material, sunlit, spread, time_s)
        key[met] = (hits.body[met] * len(Material) + material) * 2 + sunlit
        return Samples(radiance, key, hits.distance_m, hits.normal)

    def _materials(self, body: IntArray, triangle: IntArray) -> IntArray:
        material = np.zeros(len(body), dtype=np.int64)
        for index in np.unique(body):
            own = body == index
            material[own] = self.caster.bodies[index].mesh.material[triangle[own]]
        return material

    def _albedo(self, surface: Surface, material: IntArray, time_s: float) -> FloatArray:
        albedo = np.zeros((len(material), 3))
        for pair in np.unique(surface.body * len(Material) + material):
            index, kind = divmod(int(pair), len(Material))
            body = self.caster.bodies[index]
            own = np.flatnonzero((surface.body == index) & (material == kind))
            albedo[own] = _averaged(Material(kind), surface.part(own), body.pose(time_s), _seed(body))
        return albedo

    def _sunlit(self, surface: Surface, time_s: float) -> BoolArray:
        lit: BoolArray = surface.normal @ self.light.to_sun > 0.0
        towards = np.flatnonzero(lit)
        if self.light.sun.any():
            lit[towards] = self._free(surface.above[towards], self.light.to_sun, time_s)
        return lit

    def _free(self, starts: FloatArray, direction: FloatArray, time_s: float) -> BoolArray:
        return self.caster.cast(starts, np.tile(direction, (len(starts), 1)), time_s).body < 0

    def _hidden(self, starts: FloatArray, direction: FloatArray, time_s: float) -> FloatArray:
        """Return how much of the sky in a direction is occluded; moving bodies fade out up to `AMBIENT_REACH_M`."""
        hits = self.caster.cast(starts, np.tile(direction, (len(starts), 1)), time_s)
        moving = np.array([*(not body.static for body in self.caster.bodies), False])[hits.body]
        fading = np.clip(1.0 - hits.distance_m / AMBIENT_REACH_M, 0.0, 1.0)
        return np.where(moving, fading, (hits.body >= 0).astype(np.float64))

    def _irradiance(self, surface: Surface, sunlit: BoolArray, time_s: float) -> FloatArray:
        """Return the light on a surface relative to that on one that faces the clear sun, shape (n, 3)."""
        straight = np.where(sunlit, surface.normal @ self.light.to_sun, 0.0)
        below = GROUND_GLOW * (1.0 - surface.normal[:, 2]) / 2
        light = straight[:, None] * self.light.sun + below[:, None] * self.light.level
        directions = _upper_hemisphere(AMBIENT_RAYS)[self.ambient[0] :: self.ambient[1]]
        weight = 2.0 / len(directions)
        for direction, sky in zip(directions, self.light.of_sky(directions), strict=True):
            cosine = surface.normal @ direction
            towards = np.flatnonzero(cosine > 0.0)
            hidden = self._hidden(surface.above[towards], direction, time_s)[:, None]
            # What occludes the sky reflects some light itself.
            from_there = (1.0 - hidden) * sky + hidden * GROUND_GLOW * self.light.level
            light[towards] += weight * cosine[towards, None] * from_there
        return light

    def lit(self, surface: Surface, sunlit: BoolArray) -> Lit:
        """Return the light on surfaces in the absence of moving bodies."""
        directions = _upper_hemisphere(AMBIENT_RAYS)
        free = [
            self.caster.still(surface.above, np.tile(direction, (len(sunlit), 1))).body < 0 for direction in directions
        ]
        open_ = np.column_stack(free) & (surface.normal @ directions.T > 0.0)
        return Lit(self._irradiance(surface, sunlit, 0.0), sunlit, open_)

    def dimmed(self, surface: Surface, lit: Lit, time_s: float) -> tuple[FloatArray, BoolArray]:
        """Return the fraction of light that moving bodies leave to static surfaces, shape (n, 3), and which are lit."""
        light, sunlit = lit.light.astype(np.float64), lit.sunlit.copy()
        directions = _upper_hemisphere(AMBIENT_RAYS)
        if self.light.sun.any():
            towards = np.flatnonzero(sunlit)
            distance = self.caster.to_moving(surface.above[towards], self.light.to_sun[None], np.inf, time_s)[:, 0]
            shaded = towards[np.isfinite(distance)]
            sunlit[shaded] = False
            light[shaded] -= (surface.normal[shaded] @ self.light.to_sun)[:, None] * self.light.sun
        distance = self.caster.to_moving(surface.above, directions, AMBIENT_REACH_M, time_s)
        hidden = np.clip(1.0 - distance / AMBIENT_REACH_M, 0.0, 1.0) * lit.open_
        weight = 2.0 / AMBIENT_RAYS * (surface.normal @ directions.T)
        light -= (hidden * weight) @ (self.light.of_sky(directions) - GROUND_GLOW * self.light.level)
        share: FloatArray = light / np.maximum(lit.light, 1e-9)
        return share, sunlit

    def _add_mirrored(
        self,
        radiance: FloatArray,
        met: IntArray,
        surface: Surface,
        material: IntArray,
        sunlit: BoolArray,
        spread: float,
        time_s: float,
    ) -> None:
        straight = np.array([mirror(kind) for kind in Material])[material]
        glossy = np.flatnonzero(straight > 0.0)
        if not len(glossy):
            return
        part = surface.part(glossy)
        cosine = -np.einsum("ij,ij->i", part.view, part.normal)
        share = mirrored(straight[glossy], cosine)
        away = part.view + 2.0 * cosine[:, None] * part.normal
        seen = self.trace(part.above, away, 4 * spread, time_s, mirrors=False).radiance
        towards_sun = np.clip(away @ self.light.to_sun, 0.0, 1.0) ** GLINT * sunlit[glossy]
        glint = (GLINT + 1.0) / 2.0 * towards_sun[:, None] * self.light.sun
        radiance[met[glossy]] = (1.0 - share[:, None]) * radiance[met[glossy]] + share[:, None] * (seen + glint)


@dataclass(frozen=True)
class Surface:
    """The points where rays met bodies.

    Attributes
    ----------
    points, normal, view : ndarray, shape (n, 3)
        In the world; the normal points towards the viewer, the view away from the viewer.
    footprint_m : ndarray, shape (n,)
        Width of a ray, across it.
    body : ndarray of int64, shape (n,)
    """

    points: FloatArray
    normal: FloatArray
    view: FloatArray
    footprint_m: FloatArray
    body: IntArray

    @cached_property
    def above(self) -> FloatArray:
        """The points, lifted off the surface."""
        return self.points + LIFT_M * self.normal

    def part(self, chosen: IntArray) -> Surface:
        """Return a subset of the points."""
        points, normal, view = self.points[chosen], self.normal[chosen], self.view[chosen]
        return Surface(points, normal, view, self.footprint_m[chosen], self.body[chosen])


def _seed(body: Body) -> int:
    # The seed depends on the shape too, or the sender would have the same colour in every scene.
    return zlib.crc32(np.ascontiguousarray(body.mesh.vertices).tobytes(), zlib.crc32(body.name.encode()))


def _averaged(material: Material, surface: Surface, T_world_body: FloatArray, seed: int) -> FloatArray:
    """Return the reflectance averaged over a ray: several samples where its footprint is longer along than across."""
    R = T_world_body[:3, :3]
    cosine = np.abs(np.einsum("ij,ij->i", surface.view, surface.normal)).clip(0.02, 1.0)
    along = surface.view + cosine[:, None] * surface.normal
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    longer = surface.footprint_m / cosine
    counts = np.array(STRETCHES)[np.searchsorted(STRETCHES[:-1], 1.0 / cosine * 0.7)]
    total = np.zeros((len(cosine), 3))
    for count in STRETCHES:
        own = np.flatnonzero(counts == count)
        width = np.maximum(surface.footprint_m[own], longer[own] / count)
        for offset in (np.arange(count) + 0.5) / count - 0.5:
            points = surface.points[own] + (offset * longer[own])[:, None] * along[own]
            patch = Patch((points - T_world_body[:3, 3]) @ R, surface.normal[own] @ R, width, seed)
            if len(own):
                total[own] += reflectance(material, patch) / count
    return total


def _upper_hemisphere(count: int) -> FloatArray:
    """Return directions that are uniformly distributed over the upper hemisphere: a golden spiral."""
    k = np.arange(count)
    z = (k + 0.5) / count
    azimuth = np.pi * (3.0 - np.sqrt(5.0)) * k
    flat = np.sqrt(1.0 - z**2)
    return np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), z])
