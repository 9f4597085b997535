"""Simple solids as meshes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from laci_stereo.core.frames import FloatArray, IntArray
from tools.scenes.geometry import Material, Mesh

# Two triangles for each of the faces below, above, in front, behind, left and right; corner indices count x fastest.
_BOX_FACES = np.array(
    [0, 2, 1, 1, 2, 3, 4, 5, 6, 5, 7, 6, 0, 1, 4, 1, 5, 4, 2, 6, 3, 3, 6, 7, 0, 4, 2, 2, 4, 6, 1, 3, 5, 3, 7, 5]
).reshape(12, 3)


def box(low: Sequence[float], high: Sequence[float], material: Material) -> Mesh:
    """Return an upright box between two corners, metres."""
    corners = np.stack(np.meshgrid(*zip(low, high, strict=True), indexing="ij"), axis=-1).reshape(-1, 3)
    # The corners are generated with z fastest; the faces count x fastest.
    ordered = corners.reshape(2, 2, 2, 3).transpose(2, 1, 0, 3).reshape(-1, 3)
    return Mesh(ordered.astype(np.float64), _BOX_FACES, np.full(12, material, dtype=np.int64))


def loft(rings: FloatArray, material: IntArray, low_cap: Material, high_cap: Material) -> Mesh:
    """Join closed outlines of equal length, one above another, and close the lowest and the highest.

    Parameters
    ----------
    rings : ndarray, shape (levels, n, 3)
    material : ndarray of int64, shape (levels - 1, n)
        Material of the face above the edge between points i and i + 1 of a ring.
    low_cap, high_cap : Material
    """
    levels, n, _ = rings.shape
    at = np.arange(levels * n).reshape(levels, n)
    a, b = at[:-1], np.roll(at[:-1], -1, axis=1)
    c, d = at[1:], np.roll(at[1:], -1, axis=1)
    sides = np.stack([np.stack([a, b, c], axis=-1), np.stack([b, d, c], axis=-1)], axis=2).reshape(-1, 3)
    middles = rings[[0, -1]].mean(axis=1)
    low, high = levels * n, levels * n + 1
    turned = np.roll(at, -1, axis=1)
    caps = [
        np.column_stack([turned[0], at[0], np.full(n, low)]),
        np.column_stack([at[-1], turned[-1], np.full(n, high)]),
    ]
    return Mesh(
        np.concatenate([rings.reshape(-1, 3), middles]),
        np.concatenate([sides, *caps]),
        np.concatenate([np.repeat(material.ravel(), 2), np.full(n, low_cap), np.full(n, high_cap)]),
    )


def ellipse(radius_x: float, radius_y: float, z: float, corners: int = 12) -> FloatArray:
    """Return an outline about the z axis, shape (corners, 3), counter-clockwise."""
    angle = np.linspace(0.0, 2 * np.pi, corners, endpoint=False)
    return np.column_stack([radius_x * np.cos(angle), radius_y * np.sin(angle), np.full(corners, z)])


def turned_solid(profile: Sequence[tuple[float, float, float]], material: Material, corners: int = 12) -> Mesh:
    """Return a solid of elliptical sections; ``profile`` is (z, radius along x, radius along y) from low to high."""
    rings = np.stack([ellipse(x, y, z, corners) for z, x, y in profile])
    return loft(rings, np.full((len(profile) - 1, corners), material, dtype=np.int64), material, material)


def cylinder(radius_m: float, low_m: float, high_m: float, material: Material, corners: int = 12) -> Mesh:
    """Return an upright cylinder about the z axis."""
    return turned_solid([(low_m, radius_m, radius_m), (high_m, radius_m, radius_m)], material, corners)


def wheel(x_m: float, y_m: float, radius_m: float, width_m: float) -> Mesh:
    """Return a wheel that stands on the ground, its axle along y; ``y_m`` is the middle of its tread."""
    upright = cylinder(radius_m, -width_m / 2, width_m / 2, Material.TYRE, 20)
    x, y, z = upright.vertices.T
    return Mesh(np.column_stack([x + x_m, z + y_m, radius_m - y]), upright.triangles, upright.material)


def leaves(middles: FloatArray, size_m: float, rng: np.random.Generator) -> Mesh:
    """Return a randomly oriented triangle around each of the points, shape (n, 3)."""
    n = len(middles)
    corners = middles[:, None] + size_m * rng.normal(size=(n, 3, 3)) / 2
    return Mesh(corners.reshape(-1, 3), np.arange(3 * n).reshape(n, 3), np.full(n, Material.FOLIAGE, dtype=np.int64))
