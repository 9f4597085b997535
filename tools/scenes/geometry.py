"""Ray casting: static and moving triangle meshes, and what rays hit of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from laci_stereo.core.frames import FloatArray, IntArray, transform

KNOT_S = 5e-3
"""Interval at which poses are interpolated within a sweep: for a car braking at 9 m/s^2 the error is a t^2 / 8 = 0.03
mm."""


class Material(IntEnum):
    """The material of a triangle."""

    ROAD = 0
    PAINT = 1
    KERB = 2
    GRASS = 3
    WALL = 4
    FOLIAGE = 5
    METAL = 6
    CAR_PAINT = 7
    GLASS = 8
    TYRE = 9
    CLOTH = 10
    LAMP = 11


@dataclass(frozen=True)
class Mesh:
    """Triangles in a body's frame.

    Attributes
    ----------
    vertices : ndarray, shape (n, 3)
        Metres.
    triangles : ndarray of int64, shape (m, 3)
        Indices of vertices.
    material : ndarray of int64, shape (m,)
        A `Material` per triangle.
    """

    vertices: FloatArray
    triangles: IntArray
    material: IntArray

    def __post_init__(self) -> None:
        assert self.vertices.shape == (len(self.vertices), 3), self.vertices.shape
        assert self.triangles.shape == (len(self.material), 3), self.triangles.shape

    def moved(self, T_a_b: FloatArray) -> Mesh:
        """Return the mesh, given in frame b, in frame a."""
        return Mesh(transform(T_a_b, self.vertices), self.triangles, self.material)

    @cached_property
    def normals(self) -> FloatArray:
        """Unit normals by the right-hand rule, shape (m, 3); zero for a triangle without area."""
        a, b, c = (self.vertices[self.triangles[:, i]] for i in range(3))
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        unit: FloatArray = normal / np.where(length > 0.0, length, 1.0)
        return unit


def rotation_y(angle_rad: float) -> FloatArray:
    """Return the rotation about y, shape (3, 3); it turns x downwards."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def merged(meshes: Sequence[Mesh]) -> Mesh:
    """Concatenate meshes of the same frame."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    return Mesh(
        np.concatenate([np.zeros((0, 3)), *(mesh.vertices for mesh in meshes)]),
        np.concatenate(
            [
                np.zeros((0, 3), dtype=np.int64),
                *(mesh.triangles + start for mesh, start in zip(meshes, starts[:-1], strict=True)),
            ]
        ),
        np.concatenate([np.zeros(0, dtype=np.int64), *(mesh.material for mesh in meshes)]),
    )


@dataclass(frozen=True)
class Body:
    """A rigid object in the world.

    Attributes
    ----------
    name : str
    mesh : Mesh
    pose : callable
        Maps a time in seconds to ``T_world_body``, shape (4, 4).
    static : bool
        The body keeps its pose at time zero.
    """

    name: str
    mesh: Mesh
    pose: Callable[[float], FloatArray]
    static: bool


@dataclass(frozen=True)
class Hits:
    """The first intersection of each of n rays.

    Attributes
    ----------
    distance_m : ndarray, shape (n,)
        Infinite where a ray meets nothing.
    body, triangle : ndarray of int64, shape (n,)
        Indices of the body and of the triangle in its mesh; -1 where a ray meets nothing.
    normal : ndarray, shape (n, 3)
        Unit normal of the triangle, in the world, towards the ray's origin; zero where a ray meets nothing.
    """

    distance_m: FloatArray
    body: IntArray
    triangle: IntArray
    normal: FloatArray


class RayCaster:
    """Casts rays at bodies.

    The static bodies form one Embree scene; each moving body is a scene in its own frame, into which rays are
    transformed. Embree works in single precision and is used only to find the triangle; the distance is then computed
    in double precision.

    Parameters
    ----------
    bodies : sequence of Body
    """

    def __init__(self, bodies: Sequence[Body]) -> None:
        self.bodies = tuple(bodies)
        still = [index for index, body in enumerate(bodies) if body.static]
        meshes = [bodies[index].mesh.moved(bodies[index].pose(0.0)) for index in still]
        counts = [len(mesh.material) for mesh in meshes]
        self._still = _Target(merged(meshes))
        self._still_body = np.repeat(np.array(still, dtype=np.int64), counts)
        self._still_first = np.repeat(np.cumsum([0, *counts])[:-1].astype(np.int64), counts)
        self._moving = [(index, _Target(body.mesh)) for index, body in enumerate(bodies) if not body.static]
        self._posed_s, self._poses = np.nan, dict[int, FloatArray]()
        self.materials = np.concatenate([np.zeros(0, dtype=np.int64), *(body.mesh.material for body in bodies)])
        self._first_face = np.cumsum([0, *(len(body.mesh.material) for body in bodies)])[:-1].astype(np.int64)

    def faces(self, hits: Hits) -> IntArray:
        """Return the index of each triangle that was hit among those of all bodies, in the order of ``materials``.

        -1 where a ray meets nothing.
        """
        faces: IntArray = hits.triangle.copy()
        met = hits.body >= 0
        faces[met] += self._first_face[hits.body[met]]
        return faces

    def cast(self, origins: FloatArray, directions: FloatArray, time_s: float) -> Hits:
        """Find the first intersection of rays.

        Parameters
        ----------
        origins : ndarray, shape (n, 3) or (3,)
            In the world, metres.
        directions : ndarray, shape (n, 3)
            Unit vectors in the world.
        time_s : float
            Time at which the moving bodies are met.
        """
        return self.before(self.still(origins, directions), origins, directions, time_s)

    def before(self, still: Hits, origins: FloatArray, directions: FloatArray, time_s: float) -> Hits:
        """Find the first intersection of rays whose intersections with the static bodies are known already.

        Parameters
        ----------
        still : Hits
            The result of `still` for the same rays; it does not depend on time.
        origins, directions, time_s
            See `cast`.
        """
        hits = Hits(still.distance_m.copy(), still.body.copy(), still.triangle.copy(), still.normal.copy())
        distance, body, triangle, normal = hits.distance_m, hits.body, hits.triangle, hits.normal
        for index, target in self._moving:
            T_world_body = self._pose(index, time_s)
            near = target.near(T_world_body, origins, directions)
            rotation = T_world_body[:3, :3]
            starts = (origins if origins.ndim == 1 else origins[near]) - T_world_body[:3, 3]
            own_distance, own_triangle, own_normal = target.cast(starts @ rotation, directions[near] @ rotation)
            nearer = own_distance < distance[near]
            rays = near[nearer]
            distance[rays], triangle[rays] = own_distance[nearer], own_triangle[nearer]
            body[rays] = index
            normal[rays] = own_normal[nearer] @ rotation.T
        return hits

    def _pose(self, index: int, time_s: float) -> FloatArray:
        """Return a body's pose; all poses of the latest time are cached."""
        if time_s != self._posed_s:
            self._posed_s, self._poses = time_s, {}
        if index not in self._poses:
            self._poses[index] = self.bodies[index].pose(time_s)
        return self._poses[index]

    def to_moving(self, origins: FloatArray, directions: FloatArray, reach_m: float, time_s: float) -> FloatArray:
        """Return the distance from each of n origins in each of k directions to a moving body, shape (n, k).

        Infinite where there is none; bodies farther than ``reach_m`` may be left out.
        """
        nearest = np.full((len(origins), len(directions)), np.inf)
        for index, target in self._moving:
            T_world_body = self._pose(index, time_s)
            R = T_world_body[:3, :3]
            close = target.close(T_world_body, origins, reach_m)
            starts = (origins[close] - T_world_body[:3, 3]) @ R
            for number, direction in enumerate(directions):
                ways = np.broadcast_to(direction, (len(close), 3))
                near = target.near(T_world_body, origins[close], ways)
                distance = target.cast(starts[near], ways[near] @ R)[0]
                rays = close[near]
                nearest[rays, number] = np.minimum(nearest[rays, number], distance)
        return nearest

    def still(self, origins: FloatArray, directions: FloatArray) -> Hits:
        """Find the first intersection of rays with the static bodies; see `cast`."""
        distance, triangle, normal = self._still.cast(origins, directions)
        met = triangle >= 0
        body = np.full(len(directions), -1, dtype=np.int64)
        body[met] = self._still_body[triangle[met]]
        triangle[met] -= self._still_first[triangle[met]]
        return Hits(distance, body, triangle, normal)

    def sweep(self, origin: FloatArray, directions: FloatArray, times_s: FloatArray) -> Hits:
        """Find the first intersection of the rays of a sweep, each at its own time.

        Parameters
        ----------
        origin : ndarray, shape (3,)
        directions : ndarray, shape (n, 3)
        times_s : ndarray, shape (n,)
        """
        hits = self.still(origin, directions)
        if len(times_s) == 0:
            return hits
        first_s, last_s = float(times_s.min()), float(times_s.max())
        for index, target in self._moving:
            pose = self.bodies[index].pose
            poses = [pose(time_s) for time_s in ((first_s + last_s) / 2, first_s, last_s)]
            drift_m = max(float(np.linalg.norm(other[:3, 3] - poses[0][:3, 3])) for other in poses)
            near = target.near(poses[0], origin, directions, 2 * drift_m)
            if len(near) == 0:
                continue
            T = _interpolated(pose, times_s[near])
            rotation = T[:, :3, :3]
            starts = np.einsum("nij,ni->nj", rotation, origin - T[:, :3, 3])
            rays = np.einsum("nij,ni->nj", rotation, directions[near])
            distance, triangle, normal = target.cast(starts, rays)
            nearer = distance < hits.distance_m[near]
            met = near[nearer]
            hits.distance_m[met], hits.triangle[met], hits.body[met] = distance[nearer], triangle[nearer], index
            hits.normal[met] = np.einsum("nij,nj->ni", rotation[nearer], normal[nearer])
        return hits


def _interpolated(pose: Callable[[float], FloatArray], times_s: FloatArray) -> FloatArray:
    """Return the poses at these times, shape (n, 4, 4); at 1 rad/s their rotations are orthogonal to 1e-5."""
    first = np.floor(times_s.min() / KNOT_S)
    share, before = np.modf(times_s / KNOT_S - first)
    which = before.astype(np.int64)
    knots = np.stack([pose(float(first + k) * KNOT_S) for k in range(int(which.max()) + 2)])
    steps = np.diff(knots, axis=0)
    poses: FloatArray = knots[which] + share[:, None, None] * steps[which]
    return poses


class _Target:
    """A mesh in its own frame, prepared for ray casting."""

    def __init__(self, mesh: Mesh) -> None:
        self.mesh = mesh
        self._normals = mesh.normals
        self._corner = mesh.vertices[mesh.triangles[:, 0]]
        low, high = (
            (mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)) if len(mesh.vertices) else (np.zeros(3), np.zeros(3))
        )
        self._middle = (low + high) / 2
        self._radius_m = float(np.linalg.norm(mesh.vertices - self._middle, axis=1).max(initial=0.0)) + 1e-3
        self._scene = EmbreeScene()
        if len(mesh.material):
            TriangleMesh(self._scene, mesh.vertices.astype(np.float32), mesh.triangles.astype(np.int32))

    def close(self, T_world_body: FloatArray, points: FloatArray, reach_m: float) -> IntArray:
        """Return the points, in the world, whose distance to the mesh's bounding sphere is below ``reach_m``."""
        middle = T_world_body[:3, :3] @ self._middle + T_world_body[:3, 3]
        apart = points - middle
        return np.flatnonzero(np.einsum("ij,ij->i", apart, apart) < (self._radius_m + reach_m) ** 2)

    def near(
        self, T_world_body: FloatArray, origins: FloatArray, directions: FloatArray, margin_m: float = 0.0
    ) -> IntArray:
        """Return the rays, in the world, that pass through the mesh's bounding sphere, enlarged by a margin."""
        radius = self._radius_m + margin_m
        to_middle = T_world_body[:3, :3] @ self._middle + T_world_body[:3, 3] - origins
        if origins.ndim == 1:
            along = directions @ to_middle
            square = float(to_middle @ to_middle)
        else:
            along = np.einsum("ij,ij->i", directions, to_middle)
            square = np.einsum("ij,ij->i", to_middle, to_middle)
        return np.flatnonzero((square - along**2 < radius**2) & (along > -radius))

    def cast(self, origins: FloatArray, directions: FloatArray) -> tuple[FloatArray, IntArray, FloatArray]:
        """Return distance, triangle and normal of the first hit of rays in the mesh's frame."""
        count = len(directions)
        distance = np.full(count, np.inf)
        triangle = np.full(count, -1, dtype=np.int64)
        normal = np.zeros((count, 3))
        if count == 0 or len(self.mesh.material) == 0:
            return distance, triangle, normal
        starts = np.ascontiguousarray(np.broadcast_to(origins, directions.shape), dtype=np.float32)
        found = self._scene.run(starts, np.ascontiguousarray(directions, dtype=np.float32))
        met = np.flatnonzero(found >= 0)
        which = found[met].astype(np.int64)
        facing = self._normals[which]
        steepness = np.einsum("ij,ij->i", facing, directions[met])
        to_corner = self._corner[which] - (origins if origins.ndim == 1 else origins[met])
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = np.einsum("ij,ij->i", facing, to_corner) / steepness
        sound = np.isfinite(reach) & (reach > 0.0)
        met, which, facing, steepness = met[sound], which[sound], facing[sound], steepness[sound]
        distance[met], triangle[met] = reach[sound], which
        normal[met] = np.where(steepness[:, None] > 0.0, -facing, facing)
        return distance, triangle, normal
