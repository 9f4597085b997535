"""Vehicles as meshes: rounded and tapered, with windows, mirrors and wheels, of drawn dimensions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from laci_stereo.core.frames import FloatArray, IntArray
from tools.scenes.geometry import Material, Mesh, merged
from tools.scenes.shapes import box, loft, wheel

VehicleKind = Literal["saloon", "estate", "hatchback", "suv", "van", "lorry", "trailer", "bus", "caravan"]
KINDS: tuple[VehicleKind, ...] = get_args(VehicleKind)

_ARC = 6
_FRONT, _SIDE = 8, 24

PAINT, GLASS, METAL = Material.CAR_PAINT, Material.GLASS, Material.METAL


@dataclass(frozen=True)
class Trailer:
    """A towed trailer, in its own frame: origin on the ground under the centre of its box, x forward, y left.

    Attributes
    ----------
    width_m : float
    hitch_m : float
        Position of the hitch along the x axis of the towing vehicle.
    drawbar_m : float
        Distance from the hitch to the trailer's axle, or to the middle of its axles.
    axle_m : float
        Position of the axle along the trailer's own x axis (negative).
    mesh : Mesh
    """

    width_m: float
    hitch_m: float
    drawbar_m: float
    axle_m: float
    mesh: Mesh


@dataclass(frozen=True)
class Vehicle:
    """A vehicle, in the vehicle frame: origin on the ground under the centre of its box, x forward, y left.

    Attributes
    ----------
    kind : str
    length_m, width_m, height_m : float
        Dimensions of the body without mirrors, exactly the extent of the mesh without them; of a lorry with its trailer
        in line. A car that tows reports its own length: it does not know its trailer's
        (trailerPresentWithUnknownLength, ETSI TS 102 894-2).
    mirror_width_m : float
        Width including the mirrors.
    rear_axle_m, wheelbase_m : float
        Position of the rear axle along x, and distance from there to the front axle; of the towing vehicle.
    mesh : Mesh
        Without the trailer.
    trailer : Trailer or None
    """

    kind: VehicleKind
    length_m: float
    width_m: float
    height_m: float
    mirror_width_m: float
    rear_axle_m: float
    wheelbase_m: float
    mesh: Mesh
    trailer: Trailer | None = None


@dataclass(frozen=True)
class Ring:
    """A horizontal outline of a body: a rectangle with round corners, bowed and tapered.

    Attributes
    ----------
    z_m, front_m, rear_m, width_m : float
        Height, the ends along x, and the width.
    radius_m : float
        Radius of the corners.
    bow_m : float
        Distance of the front's corners behind its middle; half of it at the rear.
    taper : float
        Fraction by which the width decreases at the front; half of it at the rear.
    """

    z_m: float
    front_m: float
    rear_m: float
    width_m: float
    radius_m: float
    bow_m: float
    taper: float

    def outline(self) -> FloatArray:
        """Return the outline, counter-clockwise from the front's right corner, shape (n, 3)."""
        half = np.array([(self.front_m - self.rear_m) / 2, self.width_m / 2])
        radius = min(self.radius_m, 0.9 * float(half.min()))
        x, y = half - radius
        arc = np.linspace(0.0, np.pi / 2, _ARC)
        parts = []
        for corner, (cx, cy) in enumerate([(x, -y), (x, y), (-x, y), (-x, -y)]):
            angle = arc + (corner - 1) * np.pi / 2
            parts.append(np.column_stack([cx + radius * np.cos(angle), cy + radius * np.sin(angle)]))
            nx, ny = [(x, y), (-x, y), (-x, -y), (x, -y)][corner]
            count = _FRONT if corner % 2 == 0 else _SIDE
            share = np.arange(1, count)[:, None] / count
            end = np.array([nx, ny]) + radius * np.array([np.cos(angle[-1]), np.sin(angle[-1])])
            parts.append(parts[-1][-1] * (1 - share) + end * share)
        xy = np.concatenate(parts)
        ahead = xy[:, 0] / half[0]
        across = xy[:, 1] / half[1]
        # Outside of the middle third the sides taper; cubically, so that no edge is visible.
        drawn_in = self.taper * (_ease(ahead) + 0.5 * _ease(-ahead))
        bowed = self.bow_m * across**2 * (_ease(ahead) - 0.5 * _ease(-ahead))
        middle = (self.front_m + self.rear_m) / 2
        return np.column_stack([middle + xy[:, 0] - bowed, xy[:, 1] * (1 - drawn_in), np.full(len(xy), self.z_m)])


def _ease(ahead: FloatArray) -> FloatArray:
    eased: FloatArray = ((ahead - 1 / 3) / (2 / 3)).clip(0.0, 1.0) ** 3
    return eased


@dataclass(frozen=True)
class Skin:
    """Materials between two rings; ``posts`` are painted intervals of the sides, as fractions from rear to front."""

    front: Material = PAINT
    side: Material = PAINT
    rear: Material = PAINT
    posts: tuple[tuple[float, float], ...] = ()

    def faces(self, ring: FloatArray) -> IntArray:
        """Return the material of each face above a ring, shape (n,)."""
        middle = (ring + np.roll(ring, -1, axis=0)) / 2
        along = np.roll(ring, -1, axis=0) - ring
        outward = np.column_stack([along[:, 1], -along[:, 0]])
        material = np.full(len(ring), int(self.side), dtype=np.int64)
        share = (middle[:, 0] - ring[:, 0].min()) / np.ptp(ring[:, 0])
        for low, high in self.posts:
            material[(share >= low) & (share <= high)] = int(PAINT)
        steep = np.abs(outward[:, 0]) > 1.5 * np.abs(outward[:, 1])
        material[steep & (outward[:, 0] > 0)] = int(self.front)
        material[steep & (outward[:, 0] < 0)] = int(self.rear)
        return material


def body(rings: Sequence[Ring], skins: Sequence[Skin], low: Material = METAL, high: Material = PAINT) -> Mesh:
    """Join rings, from low to high, into a closed shell."""
    outlines = np.stack([ring.outline() for ring in rings])
    material = np.stack([skin.faces(outline) for skin, outline in zip(skins, outlines, strict=False)])
    return loft(outlines, material, low, high)


@dataclass(frozen=True)
class Shape:
    """Dimensions by which cars differ; fractions are of the length, from the front, or of the height.

    Attributes
    ----------
    length_m, width_m, height_m : tuple of float
        Smallest and largest.
    bonnet, windscreen : tuple of float
        Where the windscreen begins, and how long it is, measured along the length.
    boot, rear_window : tuple of float
        The equivalent at the rear.
    belt : tuple of float
        Height of the windows' lower edge.
    windows : tuple of (float, float)
        Interval of the greenhouse's sides, from its rear to its front, that has windows.
    """

    length_m: tuple[float, float]
    width_m: tuple[float, float]
    height_m: tuple[float, float]
    bonnet: tuple[float, float]
    windscreen: tuple[float, float]
    boot: tuple[float, float]
    rear_window: tuple[float, float]
    belt: tuple[float, float] = (0.58, 0.64)
    windows: tuple[float, float] = (0.06, 0.94)


# Extremes of the European models of the last twenty years, from the makers' brochures, rounded.
SALOON = Shape((4.4, 5.0), (1.76, 1.90), (1.40, 1.50), (0.24, 0.29), (0.10, 0.15), (0.10, 0.15), (0.10, 0.15))
ESTATE = Shape((4.4, 4.95), (1.76, 1.90), (1.44, 1.56), (0.23, 0.27), (0.10, 0.14), (0.01, 0.02), (0.04, 0.09))
HATCHBACK = Shape((3.6, 4.4), (1.63, 1.82), (1.43, 1.56), (0.20, 0.26), (0.12, 0.16), (0.01, 0.03), (0.06, 0.12))
SUV = Shape((4.2, 4.95), (1.80, 1.98), (1.58, 1.80), (0.22, 0.27), (0.08, 0.13), (0.01, 0.02), (0.03, 0.08))
VAN = Shape(
    (4.9, 6.0), (1.90, 2.05), (1.95, 2.60), (0.13, 0.19), (0.10, 0.14), (0.0, 0.005), (0.005, 0.02), (0.46, 0.52),
    (0.70, 0.95),
)  # fmt: skip
CARS: tuple[tuple[VehicleKind, Shape], ...] = (
    ("saloon", SALOON), ("estate", ESTATE), ("hatchback", HATCHBACK), ("suv", SUV), ("van", VAN)
)  # fmt: skip


def draw_vehicle(rng: np.random.Generator, kind: VehicleKind) -> Vehicle:
    """Draw the dimensions of a vehicle of a kind, and build it."""
    for known, shape in CARS:
        if kind == known:
            return _car(rng, kind, shape)
    if kind == "caravan":
        return _with_caravan(rng)
    if kind == "bus":
        return _bus(rng)
    return _articulated(rng) if kind == "trailer" else _lorry(rng)


def without_mirrors(vehicle: Vehicle) -> Mesh:
    """Return the mesh of the body and the wheels only; the mirrors are the last two boxes of each vehicle's mesh."""
    mesh = vehicle.mesh
    return Mesh(mesh.vertices[:-16], mesh.triangles[:-24], mesh.material[:-24])


def _car(rng: np.random.Generator, kind: VehicleKind, shape: Shape) -> Vehicle:
    length, width, height = (rng.uniform(*bounds) for bounds in (shape.length_m, shape.width_m, shape.height_m))
    bonnet, screen = rng.uniform(*shape.bonnet) * length, rng.uniform(*shape.windscreen) * length
    boot, window = rng.uniform(*shape.boot) * length, rng.uniform(*shape.rear_window) * length
    belt, clearance = rng.uniform(*shape.belt) * height, rng.uniform(0.14, 0.22)
    radius, bow, taper = rng.uniform(0.1, 0.5), rng.uniform(0.05, 0.22), rng.uniform(0.03, 0.12)
    nose, tail = rng.uniform(0.05, 0.20), rng.uniform(0.0, 0.10)
    tumblehome = rng.uniform(0.10, 0.22) if kind != "van" else rng.uniform(0.03, 0.08)
    front, rear = length / 2, -length / 2
    base = Ring(belt - 0.01, front - bonnet, rear + max(boot, tail + 0.03), width - 0.08, radius, bow, 0.0)
    low, high = shape.windows
    glass = Skin(GLASS, GLASS, GLASS, ((0.0, low), (0.46, 0.52), (high, 1.0)))
    blind = Skin(posts=glass.posts)
    head = replace(
        base,
        z_m=height - 0.06,
        front_m=base.front_m - screen,
        rear_m=base.rear_m + window,
        width_m=(1 - tumblehome) * width,
        radius_m=min(radius, 0.25),
    )
    roof = replace(
        head, z_m=height, front_m=head.front_m - 0.08, rear_m=head.rear_m + 0.05, width_m=head.width_m - 0.15
    )
    windows = glass if kind != "van" else replace(glass, rear=PAINT if rng.random() < 0.5 else GLASS)
    upper = body([base, head, roof], [windows, blind], low=PAINT)
    tyre = min(rng.uniform(0.29, 0.36), 0.45 * belt)
    rear_axle, base_m = rear + rng.uniform(0.17, 0.21) * length, rng.uniform(0.57, 0.62) * length
    axles = (rear_axle, rear_axle + base_m)
    wheels = [wheel(x, side * (width / 2 - 0.125), tyre, 0.2) for x in axles for side in (-1, 1)]
    reach = rng.uniform(0.10, 0.20)
    drawn_in = rng.uniform(0.02, 0.14)
    waist = Ring(rng.uniform(0.55, 0.80) * belt, front, rear, width, radius, bow, taper)
    lower = body(
        [
            replace(waist, z_m=clearance, front_m=front - 0.08, rear_m=rear + 0.08, width_m=width - drawn_in - 0.08),
            replace(waist, z_m=clearance + 0.12, width_m=width - drawn_in),
            waist,
            replace(waist, z_m=0.85 * belt, front_m=front - nose / 2, rear_m=rear + tail / 2, width_m=width - 0.01),
            replace(waist, z_m=belt, front_m=front - nose - 0.05, rear_m=rear + tail + 0.02, width_m=width - 0.06),
        ],
        [Skin()] * 4,
    )
    mirrors = _mirrors(base.front_m - 0.35 * screen - 0.15, width, belt - 0.02, reach, 0.16)
    mesh = merged([lower, upper, *wheels, *mirrors])
    return Vehicle(kind, length, width, height, width + 2 * reach, rear_axle, base_m, mesh)


def _mirrors(x_m: float, width_m: float, z_m: float, reach_m: float, tall_m: float) -> list[Mesh]:
    inner, outer = width_m / 2 - 0.08, width_m / 2 + reach_m
    spans = ((-outer, -inner), (inner, outer))
    return [box((x_m, low, z_m), (x_m + 0.12, high, z_m + tall_m), PAINT) for low, high in spans]


def _bus(rng: np.random.Generator) -> Vehicle:
    length, width, height = rng.uniform(10.5, 13.0), rng.uniform(2.50, 2.55), rng.uniform(2.9, 3.3)
    ring = Ring(0.3, length / 2, -length / 2, width, rng.uniform(0.15, 0.4), rng.uniform(0.05, 0.15), 0.0)
    posts = tuple((share, share + 0.03) for share in np.linspace(0.0, 0.97, 8).tolist())
    glass = Skin(GLASS, GLASS, GLASS, posts)
    shell = body(
        [
            replace(ring, width_m=width - 0.08),
            replace(ring, z_m=0.5),
            replace(ring, z_m=1.1),
            replace(ring, z_m=height - 0.5, front_m=length / 2 - 0.1),
            replace(ring, z_m=height - 0.1, front_m=length / 2 - 0.15, width_m=width - 0.06),
            replace(ring, z_m=height, front_m=length / 2 - 0.4, rear_m=-length / 2 + 0.3, width_m=width - 0.4),
        ],
        [Skin(), Skin(), glass, Skin(), Skin()],
    )
    rear_axle, base_m = -length / 2 + rng.uniform(3.1, 3.5), 0.49 * length
    wheels = [
        wheel(x, side * (width / 2 - 0.18), 0.48, 0.3) for x in (rear_axle, rear_axle + base_m) for side in (-1, 1)
    ]
    reach = rng.uniform(0.18, 0.28)
    mirrors = _mirrors(length / 2 - 0.25, width, 2.1, reach, 0.45)
    mesh = merged([shell, *wheels, *mirrors])
    return Vehicle("bus", length, width, height, width + 2 * reach, rear_axle, base_m, mesh)


def _lorry(rng: np.random.Generator) -> Vehicle:
    """Build a cab and a box behind it, on one frame."""
    length = rng.uniform(6.5, 10.0)
    width, height = rng.uniform(2.48, 2.55), rng.uniform(3.0, 3.9)
    front, rear = length / 2, -length / 2
    cab, behind = _cab(rng, front, height)
    load = Ring(rng.uniform(0.9, 1.15), behind, rear, width, 0.03, 0.0, 0.0)
    loaded = body([load, replace(load, z_m=height)], [Skin()])
    frame = box((rear + 0.3, -0.45, 0.6), (front - 0.5, 0.45, load.z_m + 0.01), METAL)
    rear_axle = rear + rng.uniform(1.6, 2.4)
    axles = (front - 1.4, rear_axle)
    reach = rng.uniform(0.15, 0.25)
    mirrors = _mirrors(front - 0.4, width, 1.9, reach, 0.6)
    mesh = merged([cab, loaded, frame, _guard(rear, width), *_pairs(axles, width), *mirrors])
    return Vehicle("lorry", length, width, height, width + 2 * reach, rear_axle, front - 1.4 - rear_axle, mesh)


def _articulated(rng: np.random.Generator) -> Vehicle:
    """Build a tractor with a semi-trailer, 16.5 m long at most (Directive 96/53/EC)."""
    width, height = rng.uniform(2.48, 2.55), rng.uniform(3.7, 4.0)
    wheelbase, before_axle, kingpin = rng.uniform(3.5, 3.8), rng.uniform(0.4, 0.7), rng.uniform(1.4, 1.7)
    ahead = 1.4 + wheelbase - before_axle
    length = ahead + min(rng.uniform(10.7, 12.0), 16.5 - ahead)
    trailer_length = length - ahead + kingpin
    front = length / 2
    rear_axle = front - 1.4 - wheelbase
    cab, _ = _cab(rng, front, height)
    frame = box((rear_axle - 0.8, -0.45, 0.6), (front - 0.5, 0.45, 0.95), METAL)
    reach = rng.uniform(0.15, 0.25)
    mirrors = _mirrors(front - 0.4, width, 1.9, reach, 0.6)
    mesh = merged([cab, frame, *_pairs((front - 1.4, rear_axle), width), *mirrors])
    rear = -trailer_length / 2
    load = Ring(rng.uniform(0.98, 1.15), -rear, rear, width, 0.03, 0.0, 0.0)
    axle = rear + rng.uniform(3.9, 4.4)
    towed = merged(
        [
            body([load, replace(load, z_m=height)], [Skin()]),
            _guard(rear, width),
            *_pairs((axle - 1.31, axle, axle + 1.31), width),
        ]
    )
    trailer = Trailer(width, rear_axle + before_axle, -rear - kingpin - axle, axle, towed)
    return Vehicle("trailer", length, width, height, width + 2 * reach, rear_axle, wheelbase, mesh, trailer)


def _with_caravan(rng: np.random.Generator) -> Vehicle:
    """Build a car that tows a caravan, or a trailer with a box."""
    car = _car(rng, *CARS[int(rng.choice([1, 3, 4]))])
    caravan = rng.random() < 0.5
    length, width = (rng.uniform(4.2, 6.0), rng.uniform(2.1, 2.5)) if caravan else rng.uniform((1.8, 1.2), (3.2, 1.8))
    height = rng.uniform(2.4, 2.7) if caravan else rng.uniform(0.9, 1.9)
    axle = rng.uniform(-0.6, -0.1)
    ring = Ring(rng.uniform(0.35, 0.5), length / 2, -length / 2, width, rng.uniform(0.03, 0.2), 0.05, 0.0)
    shaft = box((length / 2 - 0.1, -0.06, 0.4), (length / 2 + rng.uniform(0.9, 1.3), 0.06, 0.5), METAL)
    towed = merged([body([ring, replace(ring, z_m=height)], [Skin()]), shaft, *_pairs((axle,), width, 0.32, 0.2)])
    ball = float(shaft.vertices[:, 0].max())
    trailer = Trailer(width, -car.length_m / 2 - 0.08, ball - axle, axle, towed)
    return replace(car, kind="caravan", trailer=trailer)


def _cab(rng: np.random.Generator, front_m: float, highest_m: float) -> tuple[Mesh, float]:
    """Return a lorry's cab, and the foremost position of the load behind it."""
    length, width, gap = rng.uniform(1.7, 2.3), rng.uniform(2.2, 2.48), rng.uniform(0.15, 0.9)
    ring = Ring(0.35, front_m, front_m - length, width, rng.uniform(0.12, 0.3), rng.uniform(0.05, 0.12), 0.0)
    height = rng.uniform(2.6, min(3.6, highest_m))
    cab = body(
        [
            ring,
            replace(ring, z_m=1.5),
            replace(ring, z_m=2.3, front_m=front_m - 0.15),
            replace(ring, z_m=height, front_m=front_m - rng.uniform(0.3, 0.7), width_m=width - 0.1),
        ],
        [Skin(), Skin(GLASS, GLASS, PAINT, ((0.0, 0.4), (0.92, 1.0))), Skin()],
    )
    return cab, front_m - length - gap


def _guard(rear_m: float, width_m: float) -> Mesh:
    """Return the underrun guard, the bar that keeps cars from driving below a lorry."""
    half = width_m / 2 - 0.06
    return box((rear_m + 0.05, -half, 0.45), (rear_m + 0.2, half, 0.62), METAL)


def _pairs(axles_m: Sequence[float], width_m: float, radius_m: float = 0.5, tyre_m: float = 0.34) -> list[Mesh]:
    """Return the wheels of some axles."""
    return [wheel(x, side * (width_m / 2 - tyre_m / 2 - 0.03), radius_m, tyre_m) for x in axles_m for side in (-1, 1)]
