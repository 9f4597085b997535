"""Crossings: the road's surface, kerbs, buildings, poles, hedges and trees, in the scene's frame.

The scene's frame is metric, with z up along the normal of the road: z = 0 is the best-fitting plane of the carriageway.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.spatial import Delaunay, cKDTree

from laci_stereo.core.frames import BoolArray, FloatArray, along_line, planar, rigid, rotation_z
from tools.scenes.geometry import Body, Material, Mesh, merged, rotation_y
from tools.scenes.shapes import box, cylinder, leaves, turned_solid

LayoutKind = Literal["cross", "tee", "street", "roundabout"]
LAYOUTS: tuple[LayoutKind, ...] = get_args(LayoutKind)

REACH_M = 90.0
"""The ground extends to this distance from the middle of the crossing."""

FITTED_M = 35.0
"""The carriageway within this distance from the middle defines z = 0: about as far as a car is well visible."""


PAVEMENT_M = 2.5
"""Width of a pavement, or of a verge."""

PAVEMENT_RISE = 0.025

EDGE_STEP_M = 0.5
"""Largest spacing of the surface's vertices along its edges to verges, so that it ends there."""


@dataclass(frozen=True)
class Wave:
    """One wave of a surface."""

    amplitude_m: float
    per_m: tuple[float, float]
    phase_rad: float


@dataclass(frozen=True)
class Road:
    """The carriageway's plan and surface; its arms lie along x and, except for a street, along y.

    Attributes
    ----------
    kind : LayoutKind
    half_m : float
        Half of the width, kerb to kerb.
    corner_m : float
        Radius of the kerbs at the corners.
    ring_m, island_m : float
        Radius of a roundabout's outer kerb and of its island; zero for other layouts.
    kerb_m : float
        Height of the kerbs.
    verge : float, optional
        Downward slope, as a fraction, of the verges that country roads have in place of kerbs and pavements.
    crown : float
        Cross fall on either side of the middle, as a fraction.
    bend_per_m : tuple of float
        Vertical curvature along x and y, 1/m: the road descends or rises beyond the crossing.
    waves : tuple of Wave
        Undulation of the carriageway.
    rises : tuple of float
        Slopes of the land behind the pavements, in each quadrant.
    bumps : tuple of Wave
        Undulation of that land.
    plane : tuple of float
        Slope along x and y, and height, that are subtracted so that z = 0 fits best.
    """

    kind: LayoutKind
    half_m: float
    corner_m: float
    ring_m: float
    island_m: float
    kerb_m: float
    crown: float
    bend_per_m: tuple[float, float]
    waves: tuple[Wave, ...]
    rises: tuple[float, float, float, float]
    bumps: tuple[Wave, ...]
    verge: float | None = None
    plane: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def height(self, xy: FloatArray) -> FloatArray:
        """Return the height of the carriageway's surface, shape (n,), extended below kerbs and pavements."""
        x, y = xy[:, 0], xy[:, 1]
        across = np.abs(y) if self.kind == "street" else np.minimum(np.abs(x), np.abs(y))
        # Beyond the kerb there is no cross fall.
        height = -self.crown * np.minimum(across, self.half_m)
        # A parabola up to 40 m, straight from there.
        for at, bend in zip((x, y), self.bend_per_m, strict=True):
            far = np.maximum(np.abs(at) - 40.0, 0.0)
            height = height + bend / 2 * (np.minimum(np.abs(at), 40.0) ** 2 + 80.0 * far)
        for wave in self.waves:
            height = height + wave.amplitude_m * np.sin(xy @ np.array(wave.per_m) + wave.phase_rad)
        levelled: FloatArray = height - xy @ np.array(self.plane[:2]) - self.plane[2]
        return levelled

    def land(self, xy: FloatArray) -> FloatArray:
        """Return the height of the land behind the kerbs, or of the verges, shape (n,).

        Pavements fall by 2.5 % towards the road, verges away from it; behind them the land has slopes and bumps of its
        own.
        """
        x, y = xy[:, 0], xy[:, 1]
        strip = (self.kind == "street") | ((self.kind == "tee") & (y > 0.0))
        back = np.where(strip, np.abs(y), np.minimum(np.abs(x), np.abs(y))) - self.half_m
        if self.verge is not None and not self.ring_m:
            back = np.where(strip, back, self._behind_corner(xy))
        if self.ring_m:
            back = np.minimum(back, np.hypot(x, y) - self.ring_m)
        back = back.clip(0.0)
        behind = (back - PAVEMENT_M).clip(0.0)
        quarter = np.where(strip, 0, (x > 0.0).astype(np.int64)) + 2 * (y > 0.0)
        step_m, beside = (self.kerb_m, PAVEMENT_RISE) if self.verge is None else (0.0, -self.verge)
        rise = np.array(self.rises)[quarter] * behind + beside * np.minimum(back, PAVEMENT_M)
        for bump in self.bumps:
            wave = bump.amplitude_m * np.sin(xy @ np.array(bump.per_m) + bump.phase_rad)
            rise = rise + wave * np.minimum(behind / 2.0, 1.0)
        height: FloatArray = self.height(xy) + step_m + rise
        return height

    def _behind_corner(self, xy: FloatArray) -> FloatArray:
        """Return the distance of points behind the edges of two arms and the round corner between them, shape (n,)."""
        off = self.half_m + self.corner_m - np.abs(xy)
        behind: FloatArray = self.corner_m - np.linalg.norm(off.clip(0.0), axis=1) - off.max(axis=1).clip(max=0.0)
        return behind

    def between_edges(self, xy: FloatArray) -> BoolArray:
        """Return which points, shape (n, 2), are between the kerbs or verges, including round corners and island."""
        between: BoolArray = self.on_carriageway(xy) | (np.linalg.norm(xy, axis=1) < self.ring_m)
        if self.kind in ("cross", "tee"):
            between |= (self._behind_corner(xy) < 0.0) & ((xy[:, 1] < self.half_m) | (self.kind != "tee"))
        return between

    def on_carriageway(self, xy: FloatArray) -> BoolArray:
        """Return which points, shape (n, 2), are between the kerbs; the areas at round corners do not count."""
        x, y = xy[:, 0], xy[:, 1]
        on = np.abs(y) < self.half_m
        if self.kind != "street":
            on |= (np.abs(x) < self.half_m) & ((y < 0.0) | (self.kind != "tee"))
        square = x**2 + y**2
        on |= square < self.ring_m**2
        return on & (square >= self.island_m**2)

    def levelled(self) -> Road:
        """Return the road with its best-fitting plane subtracted."""
        grid = np.arange(-FITTED_M + 0.125, FITTED_M, 0.25)
        xy = np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2)
        xy = xy[(np.linalg.norm(xy, axis=1) < FITTED_M) & self.on_carriageway(xy)]
        bare = replace(self, plane=(0.0, 0.0, 0.0))
        a, b, c = np.linalg.lstsq(np.column_stack([xy, np.ones(len(xy))]), bare.height(xy), rcond=None)[0].tolist()
        return replace(self, plane=(a, b, c))


@dataclass(frozen=True)
class Line:
    """A painted line of the road, metres: a polyline in the plan, shape (n, 2)."""

    xy: FloatArray
    width_m: float
    dashed: bool

    @property
    def kind(self) -> str:
        """Its type in Lanelet2."""
        return "line_thin" if self.width_m < 0.2 else "stop_line"

    @property
    def subtype(self) -> str:
        """Its subtype in Lanelet2."""
        return "dashed" if self.dashed else "solid"


@dataclass(frozen=True)
class Edge:
    """A map feature other than paint: a polyline in the plan, shape (n, 2), metres, with its types in Lanelet2."""

    xy: FloatArray
    kind: str
    subtype: str = ""


@dataclass(frozen=True)
class Site:
    """A crossing with everything around it.

    Attributes
    ----------
    road : Road
    lines : tuple of Line
    bodies : tuple of Body
    edges : tuple of Edge
        Kerbs, and the walls of buildings and other walls.
    """

    road: Road
    lines: tuple[Line, ...]
    bodies: tuple[Body, ...]
    edges: tuple[Edge, ...]


def draw_road(
    rng: np.random.Generator, kind: LayoutKind, uneven: float = 1.0, land: float = 1.0, *, verges: bool = False
) -> Road:
    """Draw a road.

    ``uneven`` scales crown, bends and waves: 0 is a plane. ``land`` scales slopes and bumps behind the pavements, or
    behind ``verges``.

    Cross falls are 2.5 % on straight roads (RASt 06 and RAA), less within crossings. Waves of up to 1 cm correspond to
    an international roughness index of 2 to 4 m/km; longer ones are higher, as on roads of ISO 8608's classes B to C:
    standard deviations of 6 to 13 mm from 25 to 90 m. Verges fall by up to 12 % (RAL 2012).
    """
    half = float(rng.choice([3.25, 3.5, 5.0, 6.5, 7.0]))
    ring = float(rng.uniform(13.0, 18.0)) if kind == "roundabout" else 0.0
    waves = _waves(rng, (5.0, 25.0), uneven * 0.005)
    rises = (land * rng.uniform(-0.03, 0.06, 4)).tolist()
    bend = uneven * rng.uniform(-2e-4, 2e-4, 2)
    road = Road(
        kind=kind,
        half_m=half,
        corner_m=float(rng.uniform(6.0, 12.0)),
        ring_m=ring,
        island_m=float(rng.uniform(0.45, 0.6)) * ring,
        kerb_m=float(rng.uniform(0.03, 0.15)),
        crown=uneven * float(rng.uniform(0.0, 0.025)),
        bend_per_m=(float(bend[0]), float(bend[1])),
        waves=waves,
        rises=(rises[0], rises[1], rises[2], rises[3]),
        bumps=_waves(rng, (6.0, 20.0), land * 0.03),
        verge=float(rng.uniform(0.0, 0.12)) if verges else None,
    )
    longer = _waves(rng, (25.0, 90.0), uneven * float(rng.uniform(0.008, 0.016)))
    return replace(road, waves=(*waves, *longer)).levelled()


def _waves(rng: np.random.Generator, lengths_m: tuple[float, float], highest_m: float) -> tuple[Wave, ...]:
    """Draw four waves."""
    waves = []
    for _ in range(4):
        length, direction = rng.uniform(*lengths_m), rng.uniform(0.0, 2 * np.pi)
        per_m = (2 * np.pi / length * np.array([np.cos(direction), np.sin(direction)])).tolist()
        amplitude, phase = rng.uniform(0.0, highest_m), rng.uniform(0.0, 2 * np.pi)
        waves.append(Wave(float(amplitude), (per_m[0], per_m[1]), float(phase)))
    return tuple(waves)


def still(T_world_body: FloatArray) -> Callable[[float], FloatArray]:
    """Return the pose of a static body, as a function of time."""
    return lambda _: T_world_body


def standing(name: str, mesh: Mesh, xy: FloatArray, yaw_rad: float, z_m: float) -> Body:
    """Return a static body at a place."""
    return Body(name, mesh, still(rigid(rotation_z(yaw_rad), np.array([xy[0], xy[1], z_m]))), static=True)


def build_site(rng: np.random.Generator, road: Road, keep_free: Sequence[tuple[float, float]], density: float) -> Site:
    """Build the ground and draw the objects on it.

    Parameters
    ----------
    rng : Generator
    road : Road
    keep_free : sequence of (float, float)
        Positions of sensors: nothing is placed near them or between them and the middle of the crossing.
    density : float
        Scales the number of objects; 0 is an empty plain.
    """
    lines = _lines(road)
    meshes = [_carriageway(road), *_blocks(road), *(_paint(road, line) for line in lines)]
    ground = standing("ground", merged(meshes), np.zeros(2), 0.0, 0.0)
    spots = _Spots(rng, road, tuple(keep_free))
    things: list[Body] = []
    for kind, most in (("house", 8), ("wall", 3), ("tree", 8), ("hedge", 5), ("pole", 8), ("bin", 4)):
        for number in range(round(density * rng.integers(0, most + 1))):
            body = _thing(rng, spots, kind, f"{kind} {number}")
            if body is not None:
                things.append(body)
    faces = (edge for thing in things if thing.name.startswith(("house", "wall")) for edge in _walls(thing))
    return Site(road, lines, (ground, *things), (*_kerb_edges(road), *faces))


def _kerb_edges(road: Road) -> Iterator[Edge]:
    subtype = "high" if road.kerb_m > 0.1 else "low"
    for kerb_xy, _ in _kerbs(road):
        yield Edge(kerb_xy, "curbstone", subtype) if road.verge is None else Edge(kerb_xy, "road_border")
    if road.island_m:
        around = np.linspace(0.0, 2 * np.pi, 49)
        yield Edge(road.island_m * np.column_stack([np.cos(around), np.sin(around)]), "curbstone", subtype)


def _walls(body: Body) -> Iterator[Edge]:
    """Yield a box as a map represents it: the foot of its sides, or the centre line of a thin one."""
    T = body.pose(0.0)
    foot = body.mesh.vertices[body.mesh.vertices[:, 2] < 0.0, :2]
    (a, b), (c, d) = foot.min(axis=0), foot.max(axis=0)
    corners = np.array([[a, b], [c, b], [c, d], [a, d], [a, b]])
    if d - b < 0.5:
        corners = np.array([[a, 0.0], [c, 0.0]])
    for side in sliding_window_view(corners @ T[:2, :2].T + T[:2, 3], 2, axis=0):
        yield Edge(side.T, "wall")


def _thing(rng: np.random.Generator, spots: _Spots, kind: str, name: str) -> Body | None:
    mesh, radius, back = _MAKERS[kind](rng)
    xy = spots.draw(radius, back)
    if xy is None:
        return None
    yaw = rng.integers(0, 4) * np.pi / 2 + rng.normal(0.0, 0.05)
    z = float(spots.road.land(xy[None])[0]) - 0.05
    if kind not in ("tree", "hedge"):
        return standing(name, mesh, xy, float(yaw), z)
    sway, rate, phase = rng.uniform(0.0, 0.01), rng.uniform(0.2, 0.6), rng.uniform(0.0, 2 * np.pi)

    def pose(time_s: float) -> FloatArray:
        lean = sway * np.sin(2 * np.pi * rate * time_s + phase)
        return rigid(rotation_z(float(yaw)) @ rotation_y(lean), np.array([xy[0], xy[1], z]))

    return Body(name, mesh, pose, static=False)


def shrubs(rng: np.random.Generator, road: Road, way_xy: FloatArray, count: int) -> tuple[Body, ...]:
    """Draw hedges behind the kerbs that a vehicle passes on its path, shape (n, 2), wherever there is room.

    They lean in gusts, a third of the time: permanent swaying would be taken for noise, not for a change.
    """
    bodies = []
    ahead = np.gradient(way_xy, axis=0)
    moves = np.flatnonzero((np.linalg.norm(ahead, axis=1) > 0.05) & (np.linalg.norm(way_xy, axis=1) < FITTED_M / 2))
    for number in range(count if len(moves) else 0):
        at = int(rng.choice(moves))
        yaw = float(np.arctan2(*ahead[at][::-1]))
        a, b, high = rng.uniform(1.0, 3.0), rng.uniform(0.5, 1.0), rng.uniform(0.6, 1.6)
        corners = planar(yaw, way_xy[at])[:2, :2] @ (np.array([[a, a, -a, -a], [b, -b, b, -b]]) / 2)
        outward = rng.choice([-1.0, 1.0]) * np.array([-np.sin(yaw), np.cos(yaw)])
        for apart in np.arange(1.5, 8.0, 0.25):
            xy = way_xy[at] + apart * outward
            if not road.on_carriageway(np.vstack([xy, xy + corners.T])).any():
                z = float(road.land(xy[None])[0]) - 0.05
                middles = rng.uniform(-0.5, 0.5, (int(350 * a * b * high), 3)) * [a, b, high] + [0.0, 0.0, high / 2]
                gusts = rng.uniform(0.02, 0.06), rng.uniform(0.5, 1.5), rng.uniform(5.0, 10.0), rng.uniform(0.0, 10.0)
                pose = _in_wind(rigid(rotation_z(yaw), np.append(xy, z)), *gusts)
                bodies.append(Body(f"shrub {number}", leaves(middles, 0.12, rng), pose, static=False))
                break
    return tuple(bodies)


def _in_wind(
    T_world_body: FloatArray, lean_rad: float, rate_hz: float, period_s: float, start_s: float
) -> Callable[[float], FloatArray]:
    def pose(time_s: float) -> FloatArray:
        # Positive for a third of the period, in the middle of which it is 1.
        gust = float(np.clip(3.0 * np.cos(2 * np.pi * (time_s - start_s) / period_s) - 1.5, 0.0, 1.0))
        lean = lean_rad * gust * (0.5 + 0.5 * np.sin(2 * np.pi * rate_hz * time_s))
        return T_world_body @ rigid(rotation_y(lean), np.zeros(3))

    return pose


def _house(rng: np.random.Generator) -> tuple[Mesh, float, float]:
    a, b, high = rng.uniform(6.0, 22.0), rng.uniform(6.0, 14.0), rng.uniform(4.0, 15.0)
    parts = [box((-a / 2, -b / 2, -0.5), (a / 2, b / 2, high), Material.WALL)]
    # Ledges, so that a wall is not one plane.
    parts += [
        box((-a / 2 - 0.12, -b / 2 - 0.12, z), (a / 2 + 0.12, b / 2 + 0.12, z + 0.2), Material.WALL)
        for z in np.arange(2.8, high, 3.0).tolist()
    ]
    return merged(parts), float(np.hypot(a, b)) / 2, 4.0


def _wall(rng: np.random.Generator) -> tuple[Mesh, float, float]:
    a, high = rng.uniform(4.0, 15.0), rng.uniform(0.6, 2.5)
    return box((-a / 2, -0.12, -0.3), (a / 2, 0.12, high), Material.WALL), a / 2, 2.5


def _tree(rng: np.random.Generator) -> tuple[Mesh, float, float]:
    trunk, crown, high = rng.uniform(1.8, 3.0), rng.uniform(1.0, 2.6), rng.uniform(1.5, 4.0)
    direction = rng.normal(size=(1500, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    spread = np.cbrt(rng.uniform(0.2, 1.0, (1500, 1)))
    middles = direction * spread * [crown, crown, high / 2] + [0.0, 0.0, trunk + high / 2]
    stem = cylinder(rng.uniform(0.08, 0.25), -0.2, trunk + high / 2, Material.WALL, 8)
    return merged([stem, leaves(middles, 0.22, rng)]), crown, 2.0


def _hedge(rng: np.random.Generator) -> tuple[Mesh, float, float]:
    a, b, high = rng.uniform(2.0, 10.0), rng.uniform(0.5, 1.2), rng.uniform(0.6, 2.0)
    count = int(350 * a * b * high)
    middles = rng.uniform(-0.5, 0.5, (count, 3)) * [a, b, high] + [0.0, 0.0, high / 2]
    return leaves(middles, 0.12, rng), a / 2, 1.5


def _pole(rng: np.random.Generator) -> tuple[Mesh, float, float]:
    radius, high = rng.uniform(0.04, 0.15), rng.uniform(2.5, 8.0)
    parts = [cylinder(radius, -0.2, high, Material.METAL, 10)]
    if rng.random() < 0.5:
        parts.append(box((-0.03, -0.35, high - 0.8), (0.0, 0.35, high - 0.1), Material.METAL))
    else:
        parts.append(box((-0.15, -0.15, high), (0.9, 0.15, high + 0.12), Material.LAMP))
    return merged(parts), 0.4, 0.4


def _bin(rng: np.random.Generator) -> tuple[Mesh, float, float]:
    a, high = rng.uniform(0.25, 0.6), rng.uniform(0.6, 1.3)
    return turned_solid([(-0.1, a, a), (high, 1.1 * a, 1.1 * a)], Material.METAL), a, 0.6


_MAKERS: dict[str, Callable[[np.random.Generator], tuple[Mesh, float, float]]] = {
    "house": _house,
    "wall": _wall,
    "tree": _tree,
    "hedge": _hedge,
    "pole": _pole,
    "bin": _bin,
}


@dataclass
class _Spots:
    """Free places beside the road; each one that is drawn becomes occupied."""

    rng: np.random.Generator
    road: Road
    keep_free: tuple[tuple[float, float], ...]

    def __post_init__(self) -> None:
        self.taken: list[tuple[float, float, float]] = [(x, y, 1.0) for x, y in self.keep_free]

    def draw(self, radius_m: float, back_m: float) -> FloatArray | None:
        """Return a place for an object of that radius, at that distance behind the kerb; None if none is found."""
        for _ in range(40):
            xy = self.rng.uniform(-55.0, 55.0, 2)
            around = xy + (radius_m + back_m) * self._circle
            if self.road.on_carriageway(np.vstack([around, xy])).any():
                continue
            if any(np.hypot(*(xy - (x, y))) < radius_m + r + 0.5 for x, y, r in self.taken):
                continue
            if any(self._before(np.array(eye), xy, radius_m) for eye in self.keep_free):
                continue
            self.taken.append((float(xy[0]), float(xy[1]), radius_m))
            return xy
        return None

    @cached_property
    def _circle(self) -> FloatArray:
        angle = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
        return np.column_stack([np.cos(angle), np.sin(angle)])

    def _before(self, eye: FloatArray, xy: FloatArray, radius_m: float) -> bool:
        """Return whether an object stands between an eye and the middle of the crossing."""
        length = float(np.hypot(*eye))
        if length < 1.0:
            return False
        along = float(np.clip((xy - eye) @ -eye / length**2, 0.0, 1.0))
        return float(np.hypot(*(eye * (1 - along) - xy))) < radius_m + 3.0


def _carriageway(road: Road) -> Mesh:
    grid = np.arange(-REACH_M, REACH_M + 0.1, 1.0)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    xy = np.column_stack([x.ravel(), y.ravel()])
    if road.verge is not None:
        return _between_verges(road, xy)
    vertices = np.column_stack([xy, road.height(xy)])
    index = np.arange(len(xy)).reshape(x.shape)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[:-1, 1:], index[1:, 1:]))
    triangles = np.concatenate([np.column_stack([a, b, c]), np.column_stack([b, d, c])])
    # Cells that are entirely below the blocks are never visible.
    middle = vertices[triangles].mean(axis=1)[:, :2]
    near = np.abs(middle).min(axis=1) < road.half_m + road.corner_m + 2.0
    near |= np.linalg.norm(middle, axis=1) < road.ring_m + 2.0
    triangles = triangles[near]
    return Mesh(vertices, triangles, np.full(len(triangles), Material.ROAD, dtype=np.int64))


def _between_verges(road: Road, grid: FloatArray) -> Mesh:
    """Build a carriageway that ends at its edges: there is no block to hide the surface beyond."""
    edges = np.concatenate([_dense(edge_xy) for edge_xy, _ in _kerbs(road)])
    apart_m = cKDTree(edges).query(grid)[0]
    xy = np.concatenate([grid[road.between_edges(grid) & (apart_m > EDGE_STEP_M)], edges])
    triangles = Delaunay(xy).simplices.astype(np.int64)
    triangles = triangles[road.between_edges(xy[triangles].mean(axis=1))]
    vertices = np.column_stack([xy, road.height(xy)])
    return Mesh(vertices, triangles, np.full(len(triangles), Material.ROAD, dtype=np.int64))


def _dense(xy: FloatArray) -> FloatArray:
    along_m = along_line(xy)
    at_m = np.unique(np.append(np.arange(0.0, along_m[-1], EDGE_STEP_M), along_m))
    return np.column_stack([np.interp(at_m, along_m, column) for column in xy.T])


_BACK_M = (0.0, 0.12, 1.0, 2.5, 4.0, 6.0, 9.0, 12.0, 16.0, 20.0, 26.0, 34.0, 45.0, 60.0, 80.0)
_PAVEMENTS = 4
"""Number of rows of triangles up to the pavement's end, including the kerb's."""


def _kerbs(road: Road) -> list[tuple[FloatArray, FloatArray]]:
    """Return the lines of the road's edges, shape (n, 2), each with the direction away from the road."""
    h, r = road.half_m, road.corner_m
    far = np.arange(h + r, REACH_M, 2.0)[::-1]
    angle = np.linspace(0.0, np.pi / 2, 13)
    if road.kind == "roundabout":
        reach = float(np.sqrt(road.ring_m**2 - h**2))
        far = np.arange(reach, REACH_M, 2.0)[::-1]
        start = float(np.arctan2(h, reach))
        sweep = np.linspace(start, np.pi / 2 - start, 15)[1:-1]
        arc = road.ring_m * np.column_stack([np.cos(sweep), np.sin(sweep)])
    else:
        arc = np.column_stack([h + r - r * np.sin(angle), h + r - r * np.cos(angle)])[1:-1]
    corner = np.concatenate(
        [np.column_stack([far, np.full(len(far), h)]), arc, np.column_stack([np.full(len(far), h), far[::-1]])]
    )
    straight = np.column_stack([np.arange(-REACH_M, REACH_M + 0.1, 2.0), np.full(int(REACH_M) + 1, h)])
    diagonal, sideways = np.array([1.0, 1.0]) / np.sqrt(2), np.array([0.0, 1.0])
    kerbs = [(corner * sign, diagonal * sign) for sign in _signs(road)]
    strips = {"street": (1.0, -1.0), "tee": (1.0,)}.get(road.kind, ())
    return kerbs + [(straight * [1.0, sign], sideways * sign) for sign in strips]


def _blocks(road: Road) -> list[Mesh]:
    """Build the land behind the kerbs: swept from the kerb's line away from the road."""
    corners = [_block(road, kerb_xy, away) for kerb_xy, away in _kerbs(road)]
    if road.island_m:
        high = float(road.height(np.zeros((1, 2)))[0]) + road.kerb_m
        island = turned_solid(
            [(-0.3, road.island_m, road.island_m), (high, road.island_m, road.island_m), (high + 0.6, 1.0, 1.0)],
            Material.GRASS,
            48,
        )
        corners.append(island)
    return corners


def _signs(road: Road) -> list[FloatArray]:
    signs = [np.array([a, b]) for b in (-1.0, 1.0) for a in (-1.0, 1.0)]
    return {"street": [], "tee": signs[:2]}.get(road.kind, signs)


def _block(road: Road, kerb_xy: FloatArray, away: FloatArray) -> Mesh:
    # With an oblique sweep, the distance behind the kerb is shorter than the step.
    rows = [kerb_xy, *(kerb_xy + back * away for back in _BACK_M)]
    heights = [road.height(kerb_xy) - 0.05, *map(road.land, rows[1:])]
    vertices = np.concatenate([np.column_stack([xy, z]) for xy, z in zip(rows, heights, strict=True)])
    n = len(kerb_xy)
    index = np.arange(len(vertices)).reshape(len(rows), n)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    triangles = np.stack([np.stack([a, b, c], axis=-1), np.stack([b, d, c], axis=-1)], axis=2).reshape(-1, 3)
    kerb = [Material.KERB if road.verge is None else Material.GRASS] * _PAVEMENTS
    material = np.repeat([*kerb, *[Material.GRASS] * (len(_BACK_M) - _PAVEMENTS)], 2 * (n - 1))
    return Mesh(vertices, triangles, material)


def _lines(road: Road) -> tuple[Line, ...]:
    """Return the dashed centre lines of the arms, their edge lines, and the stop lines."""
    start = max(road.ring_m, road.half_m + road.corner_m) + 1.0
    half = road.half_m
    along = np.arange(start, 60.0, 1.0)
    lines = []
    directions = {"street": (0, 2), "tee": (0, 2, 3)}.get(road.kind, (0, 1, 2, 3))
    for quarter in directions:
        R = rotation_z(quarter * np.pi / 2)[:2, :2].round()
        for offset, dashed in ((0.0, True), (half - 0.25, False), (0.25 - half, False)):
            xy = np.column_stack([along, np.full(len(along), offset)])
            lines.append(Line(xy @ R.T, 0.12, dashed))
        if road.kind != "street":
            stop = np.array([[start, 0.1], [start, half - 0.3]])
            lines.append(Line(stop @ R.T, 0.5, False))
    return tuple(lines)


def _paint(road: Road, line: Line) -> Mesh:
    """Place a line 2 mm above the road; dashes are 3 m long, with gaps of 3 m."""
    a, b = line.xy[:-1], line.xy[1:]
    if line.dashed:
        keep = np.arange(len(a)) % 6 < 3
        a, b = a[keep], b[keep]
    side = (b - a) / np.linalg.norm(b - a, axis=1, keepdims=True) @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    side *= line.width_m / 2
    xy = np.stack([a + side, a - side, b + side, b - side], axis=1).reshape(-1, 2)
    triangles = (4 * np.arange(len(a))[:, None, None] + np.array([[0, 1, 2], [1, 3, 2]])).reshape(-1, 3)
    vertices = np.column_stack([xy, road.height(xy) + 0.002])
    return Mesh(vertices, triangles, np.full(len(triangles), Material.PAINT, dtype=np.int64))


def lift(road: Road, xy: FloatArray, yaw_rad: float, wheelbase_m: float, track_m: float) -> FloatArray:
    """Return the pose ``T_world_vehicle`` of a vehicle, shape (4, 4), with its four wheels on the road.

    Parameters
    ----------
    road : Road
    xy : ndarray, shape (2,)
        Point midway between the axles.
    yaw_rad : float
    wheelbase_m, track_m : float
    """
    flat = planar(yaw_rad, xy)
    a, b = wheelbase_m / 2, track_m / 2
    wheels = np.array([[a, b], [a, -b], [-a, b], [-a, -b]])
    z = road.height(wheels @ flat[:2, :2].T + xy)
    pitch = (z[0] + z[1] - z[2] - z[3]) / 2 / wheelbase_m
    roll = (z[0] + z[2] - z[1] - z[3]) / 2 / track_m
    # For slopes of a few percent: the axes are made orthogonal, with forward kept above the direction of the yaw.
    forward = flat[:3, 0] + [0.0, 0.0, pitch]
    left = flat[:3, 1] + [0.0, 0.0, roll]
    forward /= np.linalg.norm(forward)
    up = np.cross(forward, left)
    up /= np.linalg.norm(up)
    return rigid(np.column_stack([forward, np.cross(up, forward), up]), np.array([xy[0], xy[1], z.mean()]))
