"""Appearance of surfaces: procedural reflectance in the body's frame, without detail finer than a pixel."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from laci_stereo.core.frames import FloatArray
from tools.scenes.geometry import Material

TILE = 128
"""Side of the periodic cube of noise, voxels."""

BAND = (1 / 12, 1 / 6)
"""Frequency band of the noise, cycles per voxel: linear interpolation is accurate up to a sixth."""

WAVE = 9.0
"""Its middle wavelength, voxels."""

BLUR = 0.45
"""Standard deviation of the texture's filter in pixels: frequencies that would alias, beyond half a cycle per pixel,
are damped to a third at the limit and to a fiftieth at twice the limit."""

FAINT = 0.02
"""An octave of which the filter leaves less than this is not evaluated."""


@lru_cache(maxsize=1)
def _tile() -> FloatArray:
    """White noise of one octave, unit variance."""
    white = np.fft.fftn(np.random.default_rng(0).normal(size=(TILE,) * 3))
    f = np.fft.fftfreq(TILE)
    frequency = np.sqrt(f[:, None, None] ** 2 + f[None, :, None] ** 2 + f[None, None, :] ** 2)
    white[(frequency < BAND[0]) | (frequency > BAND[1])] = 0.0
    tile = np.fft.ifftn(white).real
    scaled: FloatArray = (tile / tile.std()).astype(np.float32)
    return scaled


@lru_cache(maxsize=4096)
def _placement(seed: int, octave: int) -> tuple[FloatArray, FloatArray]:
    """Pose of an octave in the body's frame: it is rotated, so that a plane through the cube never repeats."""
    rng = np.random.default_rng([seed, octave])
    return Rotation.random(rng=rng).as_matrix(), rng.uniform(0.0, TILE, 3)


def remaining(footprint_m: FloatArray, wavelength_m: float) -> FloatArray:
    """Return the fraction of a wave's amplitude that remains after the pixel's filter: the transform of a Gaussian."""
    share: FloatArray = np.exp(-2.0 * (np.pi * BLUR / wavelength_m * footprint_m) ** 2)
    return share


def noise(points: FloatArray, footprint_m: FloatArray, waves: Mapping[float, float], seed: int) -> FloatArray:
    """Return a sum of octaves of noise, as averaged by a pixel.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        In the body's frame, metres.
    footprint_m : ndarray, shape (n,)
        Width that a pixel covers.
    waves : mapping of float to float
        Wavelength, metres, to standard deviation.
    seed : int

    Returns
    -------
    ndarray, shape (n,)
    """
    total = np.zeros(len(points))
    for octave, (wavelength, sigma) in enumerate(waves.items()):
        share = remaining(footprint_m, wavelength)
        seen = np.flatnonzero(share > FAINT)
        R, shift = _placement(seed, octave)
        places = points[seen] @ R.T * (WAVE / wavelength) + shift
        total[seen] += sigma * share[seen] * map_coordinates(_tile(), places.T, order=1, mode="grid-wrap")
    return total


def octaves(finest_m: float, sigmas: tuple[float, ...]) -> Mapping[float, float]:
    """Return waves that double in length from the finest, with these standard deviations."""
    return {finest_m * 2.0**k: sigma for k, sigma in enumerate(sigmas)}


@dataclass(frozen=True)
class Patch:
    """Points on one material of one body.

    Attributes
    ----------
    points, normals : ndarray, shape (n, 3)
        In the body's frame, metres.
    footprint_m : ndarray, shape (n,)
        Width that a pixel covers.
    seed : int
        Seed of the body's appearance.
    """

    points: FloatArray
    normals: FloatArray
    footprint_m: FloatArray
    seed: int


# Asphalt: stones of a centimetre (white noise beyond their size: each octave halves), then wear, patches and stains.
_ASPHALT = octaves(0.01, (0.3, 0.2, 0.12, 0.07, 0.045, 0.035, 0.035, 0.04, 0.05, 0.06))
_WORN = octaves(0.02, (0.1, 0.08, 0.06, 0.05, 0.04))
_CONCRETE = octaves(0.02, (0.1, 0.08, 0.06, 0.04, 0.04, 0.05))
_BLADES = octaves(0.02, (0.35, 0.3, 0.25, 0.2, 0.15, 0.12, 0.12, 0.12))
_LEAVES = octaves(0.04, (0.35, 0.4, 0.35, 0.25, 0.15))
_PLASTER = octaves(0.01, (0.06, 0.04, 0.02, 0.015, 0.015, 0.02, 0.03, 0.03, 0.03))
_DIRT = octaves(0.02, (0.008, 0.008, 0.01, 0.012, 0.012, 0.015))
_FOLDS = octaves(0.04, (0.05, 0.1, 0.15, 0.1))

_CARS = np.array([[75, 75, 75], [2, 2, 2], [35, 36, 38], [12, 12, 13], [40, 2, 3], [3, 6, 30], [2, 12, 6]]) / 100
"""Reflectance of car paints, red-green-blue: white, black, silver, grey, red, blue, green."""

DOOR_M, TRIM_M, SEAM_M = 1.05, 0.45, 0.008
"""Spacing of the door gaps along a vehicle's sides, vertical spacing of creases and trim, and width of these dark
lines."""

BRICK_M = (0.25, 0.075)
MORTAR_M = 0.01


def _tinted(patch: Patch, colour: tuple[float, float, float], waves: Mapping[float, float]) -> FloatArray:
    grey = np.clip(1.0 + noise(patch.points, patch.footprint_m, waves, patch.seed), 0.1, 3.0)
    tinted: FloatArray = grey[:, None] * np.asarray(colour)
    return tinted


def _plain(colour: tuple[float, float, float], waves: Mapping[float, float]) -> Callable[[Patch], FloatArray]:
    return lambda patch: _tinted(patch, colour, waves)


def _grass(patch: Patch) -> FloatArray:
    dry = np.clip(0.3 + noise(patch.points, patch.footprint_m, octaves(0.5, (0.1, 0.15, 0.15)), patch.seed + 1), 0, 1)
    blend = dry[:, None] * np.array([0.14, 0.12, 0.05]) + (1 - dry[:, None]) * np.array([0.05, 0.10, 0.025])
    grass: FloatArray = blend * _tinted(patch, (1.0, 1.0, 1.0), _BLADES)
    return grass


def _car(patch: Patch) -> FloatArray:
    colour = _CARS[np.random.default_rng(patch.seed).integers(len(_CARS))]
    lines = [
        _covered(patch.points[:, axis] / apart, patch.footprint_m / apart, width / apart)
        for axis, apart, width in ((0, DOOR_M, SEAM_M), (2, TRIM_M, SEAM_M))
    ]
    dark = np.where(np.abs(patch.normals[:, 1]) > 0.6, 1.0 - (1.0 - lines[0]) * (1.0 - lines[1]), 0.0)
    painted: FloatArray = (1.0 - 0.9 * dark)[:, None] * _tinted(patch, colour, _DIRT)
    return painted


def _cloth(patch: Patch) -> FloatArray:
    rng = np.random.default_rng(patch.seed)
    # The pieces of clothing, such as jacket and trousers, change over the height of a body.
    piece = np.floor(patch.points[:, 2] / 0.8).astype(np.int64) % 4
    return rng.uniform(0.03, 0.4, (4, 3))[piece] * _tinted(patch, (1.0, 1.0, 1.0), _FOLDS)


def _wall(patch: Patch) -> FloatArray:
    rng = np.random.default_rng(patch.seed)
    if rng.random() < 0.5:
        return _tinted(patch, tuple(rng.uniform(0.3, 0.6) * np.array([1.0, 0.95, 0.85])), _PLASTER)
    return _bricks(patch)


def _bricks(patch: Patch) -> FloatArray:
    across = np.column_stack([-patch.normals[:, 1], patch.normals[:, 0]])
    u = np.einsum("ij,ij->i", across, patch.points[:, :2]) / BRICK_M[0]
    v = patch.points[:, 2] / BRICK_M[1]
    row = np.floor(v)
    u = u + 0.5 * (row % 2)
    gaps = [_covered(x, patch.footprint_m / size, MORTAR_M / size) for x, size in ((u, BRICK_M[0]), (v, BRICK_M[1]))]
    mortar = 1.0 - (1.0 - gaps[0]) * (1.0 - gaps[1])
    each = 0.2 * _hashed(np.floor(u), row, patch.seed) * remaining(patch.footprint_m, 2 * BRICK_M[1])
    brick = (1.0 + each)[:, None] * _tinted(patch, (0.28, 0.13, 0.09), _PLASTER)
    wall: FloatArray = mortar[:, None] * np.array([0.35, 0.33, 0.3]) + (1.0 - mortar[:, None]) * brick
    return wall


def _covered(x: FloatArray, width: FloatArray, share: float) -> FloatArray:
    """Return the covered fraction of an interval around x, where the first ``share`` of each unit is covered."""

    def integral(at: FloatArray) -> FloatArray:
        whole = np.floor(at)
        total: FloatArray = whole * share + np.minimum(at - whole, share)
        return total

    width = np.maximum(width, 1e-6)
    covered: FloatArray = (integral(x + width / 2) - integral(x - width / 2)) / width
    return covered


def _hashed(i: FloatArray, j: FloatArray, seed: int) -> FloatArray:
    """Return a pseudo-random number from -1 to 1 for each pair of integers: the fraction of a large sine."""
    value: FloatArray = np.sin(i * 12.9898 + j * 78.233 + seed % 1000) * 43758.5453
    return 2.0 * (value - np.floor(value)) - 1.0


_REFLECTANCE: Mapping[Material, Callable[[Patch], FloatArray]] = MappingProxyType(
    {
        Material.ROAD: _plain((0.115, 0.113, 0.11), _ASPHALT),
        Material.PAINT: _plain((0.6, 0.6, 0.57), _WORN),
        Material.KERB: _plain((0.3, 0.29, 0.27), _CONCRETE),
        Material.GRASS: _grass,
        Material.WALL: _wall,
        Material.FOLIAGE: _plain((0.045, 0.085, 0.02), _LEAVES),
        Material.METAL: _plain((0.3, 0.3, 0.31), _DIRT),
        Material.CAR_PAINT: _car,
        Material.GLASS: _plain((0.02, 0.022, 0.022), _DIRT),
        Material.TYRE: _plain((0.025, 0.025, 0.025), _WORN),
        Material.CLOTH: _cloth,
        Material.LAMP: _plain((0.6, 0.55, 0.5), _DIRT),
    }
)

# From Fresnel's equations at normal incidence: clear coat and glass have an index of 1.5; glass has two faces.
_MIRROR: Mapping[Material, float] = MappingProxyType(
    {Material.CAR_PAINT: 0.04, Material.GLASS: 0.08, Material.LAMP: 0.04, Material.METAL: 0.1}
)


def reflectance(material: Material, patch: Patch) -> FloatArray:
    """Return the diffuse reflectance, red-green-blue, shape (n, 3)."""
    return _REFLECTANCE[material](patch)


def mirrored(at_normal: FloatArray, cos: FloatArray) -> FloatArray:
    """Return the specular reflectance, shape (n,), from that at normal incidence and the angle's cosine.

    Schlick, Computer Graphics Forum 1994, equation 15.
    """
    share: FloatArray = at_normal + (1.0 - at_normal) * (1.0 - cos.clip(0.0, 1.0)) ** 5
    return share


def mirror(material: Material) -> float:
    """Return the fraction of light that a material reflects specularly at normal incidence; 0 if it is matt."""
    return _MIRROR.get(material, 0.0)
