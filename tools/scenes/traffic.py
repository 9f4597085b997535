"""Other road users, that drive, walk and cycle without colliding."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from laci_stereo.core.frames import FloatArray, rotate_xy
from tools.scenes.drives import Drive, DriveKind, Lanes, Towed, draw_drive
from tools.scenes.geometry import Body, Material, Mesh, merged
from tools.scenes.shapes import box, turned_solid, wheel
from tools.scenes.vehicles import Trailer, Vehicle, VehicleKind, draw_vehicle
from tools.scenes.world import LayoutKind, Road, lift, standing

STEERING_RAD = 0.6
"""Wheels of road vehicles steer by up to 35 deg."""

CLEARANCE_M = 0.7

TRIES, NEAR_TRIES = 25, 200
"""Attempts to find room for a road user; few paths lead near the sender."""


@dataclass(frozen=True)
class Mover:
    """A road user that moves.

    Attributes
    ----------
    name : str
    mesh : Mesh
        In the vehicle frame: origin on the ground under the centre of the box.
    length_m, width_m : float
    rear_axle_m, wheelbase_m : float
        Position along x of the point that follows the drive, and the distance between the two contacts with the road.
    drive : Drive
    road : Road
    trailer : Trailer or None
        The trailer that it tows.
    """

    name: str
    mesh: Mesh
    length_m: float
    width_m: float
    rear_axle_m: float
    wheelbase_m: float
    drive: Drive
    road: Road
    trailer: Trailer | None = None

    def track(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the centre of the box, shape (n, 2), and the body's yaw, shape (n,)."""
        xy, yaw = self.drive.at(times_s)
        return xy + rotate_xy(yaw, np.tile([-self.rear_axle_m, 0.0], (len(xy), 1))), yaw

    def pose(self, time_s: float) -> FloatArray:
        """Return ``T_world_vehicle``, shape (4, 4), with the wheels on the road."""
        xy, yaw = self.drive.at(np.array([time_s]))
        ahead = rotate_xy(float(yaw[0]), np.array([self.wheelbase_m / 2, 0.0]))
        T = lift(self.road, xy[0] + ahead, float(yaw[0]), self.wheelbase_m, max(self.width_m - 0.3, 0.3))
        T[:3, 3] -= T[:3, 0] * (self.rear_axle_m + self.wheelbase_m / 2)
        return T

    def trailer_pose(self, time_s: float) -> FloatArray:
        """Return ``T_world_trailer``, shape (4, 4): hitch and wheels keep their height above the road."""
        assert self.trailer is not None
        xy, yaw = self._towed.at(np.array([time_s]))
        half = self.trailer.drawbar_m / 2
        ahead = rotate_xy(float(yaw[0]), np.array([half, 0.0]))
        T = lift(self.road, xy[0] + ahead, float(yaw[0]), self.trailer.drawbar_m, self.trailer.width_m - 0.3)
        T[:3, 3] -= T[:3, 0] * (self.trailer.axle_m + half)
        return T

    @cached_property
    def _towed(self) -> Towed:
        assert self.trailer is not None
        return Towed(self.drive, self.trailer.hitch_m - self.rear_axle_m, self.trailer.drawbar_m)

    @property
    def bodies(self) -> tuple[Body, ...]:
        """The mover for the ray caster, after its trailer."""
        own = Body(self.name, self.mesh, self.pose, static=False)
        if self.trailer is None:
            return (own,)
        return Body(f"{self.name}, trailer", self.trailer.mesh, self.trailer_pose, static=False), own


def vehicle_mover(name: str, vehicle: Vehicle, drive: Drive, road: Road) -> Mover:
    """Put a vehicle on a drive."""
    return Mover(
        name,
        vehicle.mesh,
        vehicle.length_m,
        vehicle.width_m,
        vehicle.rear_axle_m,
        vehicle.wheelbase_m,
        drive,
        road,
        vehicle.trailer,
    )


def lanes_of(road: Road) -> Lanes:
    """Return the lanes: in the middle of each half of the road."""
    return Lanes(min(road.half_m / 2, 1.9), (road.ring_m + road.island_m) / 2)


_ARMS: dict[LayoutKind, tuple[int, ...]] = {
    "cross": (0, 1, 2, 3),
    "tee": (0, 2, 3),
    "street": (0, 2),
    "roundabout": (0, 1, 2, 3),
}


def possible(layout: LayoutKind, kind: DriveKind) -> list[int]:
    """Return by how many quarter turns a drive that comes along x can be rotated so that its arms exist.

    Arms are numbered counter-clockwise from the one along +x; a drive comes from arm 2 and leaves through 0, 1 or 3. A
    turn within which the vehicle reverses is one to the left, where traffic drives on the left one to the right.
    """
    if (kind == "roundabout") != (layout == "roundabout"):
        return []
    ways: dict[DriveKind, tuple[int, ...]] = {"left_turn": (2, 1), "right_turn": (2, 3), "reverse_in_turn": (2, 1, 3)}
    arms = _ARMS[layout]
    return [q for q in range(4) if all((arm + q) % 4 in arms for arm in ways.get(kind, (2, 0)))]


def place_drive(
    rng: np.random.Generator,
    kind: DriveKind,
    road: Road,
    vehicle: Vehicle,
    speed_mps: float | None,
    middle_s: float,
    left_hand: bool,
) -> Drive:
    """Draw a drive of a kind across a crossing; where traffic drives on the left it is mirrored."""
    tightest = vehicle.wheelbase_m / np.tan(STEERING_RAD)
    other: dict[DriveKind, DriveKind] = {"left_turn": "right_turn", "right_turn": "left_turn"}
    drawn = other.get(kind, kind) if left_hand else kind
    drive = draw_drive(rng, drawn, lanes_of(road), tightest, speed_mps, middle_s)
    quarter = int(rng.choice(possible(road.kind, kind)))
    return (drive.mirrored() if left_hand else drive).placed(quarter * np.pi / 2)


def collide(one: Mover, other: Mover, times_s: FloatArray, clearance_m: float = CLEARANCE_M) -> bool:
    """Return whether two movers come nearer than the clearance (separating axes of their rectangles)."""
    (xy_a, yaw_a), (xy_b, yaw_b) = one.track(times_s), other.track(times_s)
    apart = xy_b - xy_a
    separate = np.zeros(len(times_s), dtype=bool)
    for yaw in (yaw_a, yaw_a + np.pi / 2, yaw_b, yaw_b + np.pi / 2):
        reach = np.zeros(len(times_s)) + clearance_m
        for mover, own in ((one, yaw_a), (other, yaw_b)):
            reach += np.abs(np.cos(own - yaw)) * mover.length_m / 2 + np.abs(np.sin(own - yaw)) * mover.width_m / 2
        separate |= np.abs(rotate_xy(-yaw, apart)[:, 0]) > reach
    return not bool(separate.all())


def draw_traffic(
    rng: np.random.Generator,
    road: Road,
    sender: Mover,
    counts: tuple[int, int, int],
    times_s: FloatArray,
    left_hand: bool,
    near_m: float | None = None,
) -> tuple[Mover, ...]:
    """Draw vehicles, walkers and cyclists; those for which no room is found are left out.

    Parameters
    ----------
    rng : Generator
    road : Road
    sender : Mover
    counts : tuple of int
        Numbers of vehicles, walkers and cyclists.
    times_s : ndarray, shape (n,)
        Times at which they must not collide.
    left_hand : bool
    near_m : float or None
        Distance within which all of them come to the sender during the middle half of that time.
    """
    movers: list[Mover] = [sender]
    checked = np.linspace(times_s[0] - 0.5, times_s[-1] + 0.5, 60)
    meeting = checked[len(checked) // 4 : -len(checked) // 4]
    makers = [_other_vehicle] * counts[0] + [_walker] * counts[1] + [_cyclist] * counts[2]
    for number, maker in enumerate(makers):
        for _ in range(TRIES if near_m is None else NEAR_TRIES):
            mover = maker(rng, road, f"{maker.__name__.removeprefix('_')} {number}", times_s, left_hand)
            if near_m is not None and not collide(mover, sender, meeting, near_m):
                continue
            if not any(collide(mover, other, checked) for other in movers):
                movers.append(mover)
                break
    return tuple(movers[1:])


def _other_vehicle(rng: np.random.Generator, road: Road, name: str, times_s: FloatArray, left_hand: bool) -> Mover:
    kinds: tuple[VehicleKind, ...] = ("saloon", "estate", "hatchback", "suv", "van", "lorry", "bus")
    vehicle = draw_vehicle(rng, kinds[int(rng.choice(7, p=[0.2, 0.17, 0.2, 0.2, 0.13, 0.06, 0.04]))])
    drives: tuple[DriveKind, ...] = ("straight", "left_turn", "right_turn", "stop_and_go", "roundabout")
    feasible = [kind for kind in drives if possible(road.kind, kind)]
    kind = feasible[int(rng.integers(len(feasible)))]
    middle = float(rng.uniform(times_s[0] - 2.0, times_s[-1] + 2.0))
    return vehicle_mover(name, vehicle, place_drive(rng, kind, road, vehicle, None, middle, left_hand), road)


def _walker(rng: np.random.Generator, road: Road, name: str, times_s: FloatArray, left_hand: bool) -> Mover:
    """Return a walker on the pavement or across a road; 1.2 to 1.6 m/s (Weidmann 1993: 1.34 +- 0.26 m/s)."""
    beside = road.half_m + road.corner_m / 3 + rng.uniform(1.0, 2.5)
    along = rng.uniform(-12.0, 12.0)
    start = (along, -beside if left_hand else beside)
    drive = Drive(
        start,
        float(rng.choice([0.0, np.pi])),
        speeds=((0.0, float(rng.uniform(1.2, 1.6))),),
        pivot=(float(rng.uniform(times_s[0], times_s[-1])), 0.0),
    ).placed(int(rng.integers(4)) * np.pi / 2)
    tall, broad = rng.uniform(1.55, 1.95), rng.uniform(0.42, 0.55)
    return Mover(name, walker_mesh(tall, broad), 0.4, broad, 0.0, 0.3, drive, road)


def _cyclist(rng: np.random.Generator, road: Road, name: str, times_s: FloatArray, left_hand: bool) -> Mover:
    offset = road.half_m - rng.uniform(0.6, 1.0)
    drive = Drive(
        (0.0, offset if left_hand else -offset),
        0.0,
        speeds=((0.0, float(rng.uniform(3.0, 6.5))),),
        pivot=(float(rng.uniform(times_s[0], times_s[-1])), 0.0),
    )
    quarter = int(rng.choice(possible(road.kind, "straight") or [0]))
    return Mover(name, cyclist_mesh(), 1.75, 0.6, -0.5, 1.05, drive.placed(quarter * np.pi / 2), road)


def walker_mesh(tall_m: float, broad_m: float) -> Mesh:
    """Return a walker who faces along x."""
    cloth, half = Material.CLOTH, broad_m / 2
    legs = [
        turned_solid([(0.0, 0.08, 0.06), (0.48 * tall_m, 0.09, 0.09)], cloth, 8).moved(
            _shifted(0.12 * side, 0.09 * side)
        )
        for side in (-1.0, 1.0)
    ]
    trunk = turned_solid(
        [(0.46 * tall_m, 0.12, 0.8 * half), (0.7 * tall_m, 0.13, half), (0.84 * tall_m, 0.08, 0.7 * half)], cloth
    )
    head = turned_solid([(0.85 * tall_m, 0.05, 0.05), (0.92 * tall_m, 0.1, 0.08), (tall_m, 0.04, 0.04)], cloth, 8)
    return merged([*legs, trunk, head])


def cyclist_mesh() -> Mesh:
    """Return a bicycle with its rider."""
    wheels = [wheel(x, 0.0, 0.34, 0.04) for x in (-0.5, 0.55)]
    frame = box((-0.5, -0.02, 0.4), (0.5, 0.02, 0.75), Material.METAL)
    bar = box((0.38, -0.3, 0.98), (0.44, 0.3, 1.04), Material.METAL)
    rider = turned_solid(
        [(0.3, 0.12, 0.16), (0.9, 0.16, 0.18), (1.3, 0.16, 0.22), (1.5, 0.1, 0.1), (1.7, 0.1, 0.08)], Material.CLOTH
    )
    return merged([*wheels, frame, bar, rider])


def _shifted(x_m: float, y_m: float) -> FloatArray:
    T = np.eye(4)
    T[:2, 3] = x_m, y_m
    return T


def park(rng: np.random.Generator, road: Road, count: int) -> tuple[Body, ...]:
    """Park cars at the kerbs of roads that are wide enough, otherwise behind them."""
    bodies = []
    kinds: Sequence[VehicleKind] = ("saloon", "estate", "hatchback", "suv", "van")
    for number in range(count):
        vehicle = draw_vehicle(rng, kinds[int(rng.integers(len(kinds)))])
        away = max(road.ring_m, road.half_m + road.corner_m) + 6.0
        inside = road.half_m > 4.9
        across = road.half_m + (-0.2 - vehicle.width_m / 2 if inside else 0.4 + vehicle.width_m / 2)
        along = away + 6.5 * number + rng.uniform(0.0, 1.0)
        xy = np.array([along, across]) * rng.choice([-1.0, 1.0], 2)
        yaw = float(rng.choice([0.0, np.pi]) + rng.normal(0.0, 0.02))
        high = float((road.height if inside else road.land)(xy[None])[0])
        bodies.append(standing(f"parked {number}", vehicle.mesh, xy, yaw, high))
    return tuple(bodies)
