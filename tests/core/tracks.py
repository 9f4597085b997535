"""Tracks made by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.settings import Settings
from laci_stereo.core.tracking.box import Box
from laci_stereo.core.tracking.sighting import Flaw, Sighting, box_around
from laci_stereo.core.tracking.tracks import Track
from tests.simulated import Drive

DRIVE = Drive((10.0, -20.0), 80.0, ((15.0, 0.0), (16.0, 90.0)), ((0.0, 8.0),))
"""Straight on, then a left turn."""

STRAIGHT_ON = Drive((20.0, 22.0), -90.0, speeds=((0.0, 8.0),))


def sighting(
    stamp_s: float,
    xy: FloatArray,
    count: int = 200,
    flaw: Flaw | None = None,
    size: tuple[float, float] = (4.4, 1.8),
    yaw_rad: float = 0.0,
    sigma_m: float = 0.0,
    radial_mps: float | None = None,
) -> Sighting:
    box = Box(np.asarray(xy, dtype=np.float64), *size, yaw_rad)
    points = np.column_stack([box.corners(), np.ones(4)])
    noise = np.full(4, sigma_m)
    return Sighting(stamp_s, stamp_s, points, noise, noise, count, box.centre, box, flaw, sigma_m, radial_mps)


def body_sighting(stamp_s: float, points: FloatArray) -> Sighting:
    """What is seen of a body: its points, shape (n, 3), level frame, known to 2 cm."""
    noise, middle = np.full(len(points), 0.02), np.median(points[:, :2], axis=0)
    box = box_around(points, Settings())
    return Sighting(stamp_s, stamp_s, points, noise, noise, len(points), middle, box, None, 0.02)


def track(stamps_s: FloatArray, xy: FloatArray, **of_each: object) -> Track:
    return Track(tuple(sighting(float(t), at, **of_each) for t, at in zip(stamps_s, xy, strict=True)))  # type: ignore[arg-type]


def vehicle(drive: Drive = DRIVE, last_s: float = 8.0, size: tuple[float, float] = (4.4, 1.8)) -> VehicleTrack:
    """The true track in the world, by messages at 10 Hz."""
    stamps = np.arange(-1.0, last_s + 1.0, 0.1) + 0.03
    xy, yaw = drive.at(stamps)
    return VehicleTrack(stamps, 0, xy, yaw, *size)


TRUTH = PlanarMatch(2.3, np.array([40.0, -7.0]))
"""Where the sensor stands in the traffic below."""

STAMPS = np.arange(0.0, 6.0, 0.1)


def seen(
    drive: Drive = DRIVE,
    stamps: FloatArray = STAMPS,
    noise_m: float = 0.1,
    seed: int = 0,
    sensor: PlanarMatch = TRUTH,
    **of_each: object,
) -> Track:
    """What a sensor sees of a drive, as whole boxes."""
    noise = np.random.default_rng(seed).normal(0.0, noise_m, (len(stamps), 2))
    xy, yaw = drive.at(stamps)
    level = rotate_xy(-sensor.yaw_rad, xy + noise - sensor.shift)
    boxes = zip(stamps, level, yaw - sensor.yaw_rad, strict=True)
    return Track(tuple(sighting(float(t), at, yaw_rad=float(turn), **of_each) for t, at, turn in boxes))  # type: ignore[arg-type]


@dataclass(frozen=True)
class Car:
    """A vehicle whose path and speed are tabled every 20 ms, in the level frame."""

    stamps_s: FloatArray
    xy: FloatArray
    yaw_rad: FloatArray
    size: tuple[float, float] = (4.4, 1.8)

    def at(self, stamp_s: float) -> tuple[FloatArray, float]:
        x, y, yaw = (np.interp(stamp_s, self.stamps_s, one) for one in (*self.xy.T, self.yaw_rad))
        return np.array([x, y]), float(yaw)

    def sends(self, offset_s: float = 0.0, rate_hz: float = 10.0, noise_m: float = 0.05, seed: int = 0) -> VehicleTrack:
        """What it sends; the sensor's clock is behind by the offset."""
        stamps = np.arange(self.stamps_s[0], self.stamps_s[-1], 1.0 / rate_hz)
        poses = [self.at(t) for t in stamps]
        xy = TRUTH(np.array([xy for xy, _ in poses]))
        xy += np.random.default_rng(seed).normal(0.0, noise_m, xy.shape)
        yaw = np.array([yaw for _, yaw in poses]) + TRUTH.yaw_rad
        return VehicleTrack(stamps + offset_s, 0, xy, yaw, *self.size)

    @cached_property
    def driven_m(self) -> FloatArray:
        return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(self.xy, axis=0), axis=1)))


def path_car(
    lane: FloatArray,
    enters_s: float,
    mean_mps: float,
    rng: np.random.Generator,
    wander_mps: float = 0.7,
    leader: Car | None = None,
) -> Car:
    """Drive along a polyline, shape (n, 2), from its beginning; the speed wanders over some three seconds.

    Behind a leader on the same lane the car slows down so that 12 m from centre to centre are left.
    """
    time = enters_s + np.arange(0.0, 75.0, 0.02)
    wander = np.interp(time, enters_s + np.arange(0.0, 76.0, 3.0), rng.normal(0.0, wander_mps, 26))
    driven = np.cumsum(np.maximum(mean_mps + wander, 1.0)) * 0.02
    step = np.diff(lane, axis=0)
    along = np.append(0.0, np.cumsum(np.linalg.norm(step, axis=1)))
    if leader is not None:
        free = np.interp(time, leader.stamps_s, leader.driven_m - 12.0, right=np.inf)
        # A smooth minimum, as drivers brake in time.
        driven = -np.logaddexp(-driven / 4.0, -free / 4.0) * 4.0
    on_lane = (driven < along[-1]) & (driven > 0.0)
    yaw = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    s = driven[on_lane]
    xy = np.column_stack([np.interp(s, along, one) for one in lane.T])
    return Car(time[on_lane], xy, np.interp(s, (along[1:] + along[:-1]) / 2, yaw))


def looks(car: Car, stamp_s: float, rng: np.random.Generator, noise_m: float = 0.1) -> Sighting | None:
    """What a sensor at the origin that looks along y sees of a car: the sides that it does not graze."""
    if not car.stamps_s[0] <= stamp_s <= car.stamps_s[-1]:
        return None
    centre, yaw = car.at(stamp_s)
    distance = float(np.linalg.norm(centre))
    if distance > 70.0 or centre[1] < distance * np.cos(np.radians(55.0)):
        return None
    sight = rotate_xy(-yaw, centre / distance)
    # A side is seen from 10 deg on; what is seen of the other axis is some 0.4 m of bumper or mirror.
    full = np.abs(sight[::-1]) > np.sin(np.radians(10.0))
    size = np.where(full, car.size, 0.4)
    seen = centre - rotate_xy(yaw, np.sign(sight) * (np.array(car.size) - size) / 2)
    seen = seen + rng.normal(0.0, noise_m, 2)
    # The middle of all points lies between the sides, by how large they look.
    large = np.array([car.size[1] * abs(sight[0]), car.size[0] * abs(sight[1])])
    middle = centre - rotate_xy(yaw, np.sign(sight) * np.array(car.size) / 2 * large / large.sum())
    length, width = size if size[0] >= size[1] else size[::-1]
    turned = yaw if size[0] >= size[1] else yaw + np.pi / 2
    count = int(200 * (20.0 / distance) ** 2) + 10
    one = sighting(stamp_s, seen, count, None, (float(length), float(width)), turned)
    return replace(one, middle=middle + rng.normal(0.0, noise_m, 2))


@dataclass(frozen=True)
class Traffic:
    """Cars before a sensor; which one a sighting is of can be asked afterwards."""

    cars: Sequence[Car]
    last_s: float
    seed: int = 0
    presence: float = 0.8
    hidden: float = 0.25

    @cached_property
    def frames(self) -> list[list[Sighting]]:
        """At 10 Hz; a fifth of the sightings is missing, and of each car a gap of one to two seconds at times."""
        rng = np.random.default_rng(self.seed)
        gaps = {}
        for number, car in enumerate(self.cars):
            first = rng.uniform(car.stamps_s[0], car.stamps_s[-1])
            gaps[number] = (first, first + rng.uniform(1.0, 2.0)) if rng.random() < self.hidden else (0.0, 0.0)
        frames = []
        for stamp_s in np.arange(0.0, self.last_s, 0.1):
            frame = []
            for number, car in enumerate(self.cars):
                first, last = gaps[number]
                if rng.random() < self.presence and not first < stamp_s < last:
                    one = looks(car, float(stamp_s), rng)
                    if one is not None:
                        self.owner[id(one)] = number
                        frame.append(one)
            frames.append(frame)
        return frames

    @cached_property
    def owner(self) -> dict[int, int]:
        return {}


def lane(points: Sequence[tuple[float, float]]) -> FloatArray:
    """A polyline with rounded corners, a point every half metre."""
    corners = np.array(points, dtype=np.float64)
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1)))
    s = np.arange(0.0, along[-1], 0.5)
    xy = np.column_stack([np.interp(s, along, one) for one in corners.T])
    # A running mean over 40 m rounds a right angle to a radius of 25 m, which 12 m/s take with 6 m/s^2.
    padded = np.pad(xy, ((40, 40), (0, 0)), mode="reflect", reflect_type="odd")
    return np.column_stack([np.convolve(one, np.full(81, 1 / 81), "valid") for one in padded.T])


STRAIGHT_ROAD = (lane([(-300.0, 16.0), (300.0, 16.0)]), lane([(300.0, 20.0), (-300.0, 20.0)]))
CROSSING = (
    *STRAIGHT_ROAD,
    lane([(-300.0, 12.5), (5.5, 12.5), (5.5, 300.0)]),
    lane([(-2.0, 300.0), (-2.0, 23.5), (-300.0, 23.5)]),
    lane([(300.0, 23.5), (2.0, 23.5), (2.0, 300.0)]),
    lane([(-5.5, 300.0), (-5.5, 9.0), (300.0, 9.0)]),
)


def traffic(
    seed: int, lanes: Sequence[FloatArray], count: int = 30, last_s: float = 60.0, wander_mps: float = 0.7
) -> Traffic:
    """Cars of different speeds one behind another on their lanes, which none of them leaves."""
    rng = np.random.default_rng(seed)
    cars: list[Car] = []
    for number in range(count):
        enters = (number // len(lanes)) * last_s * len(lanes) / count - 23.0 + rng.uniform(0.0, 2.0)
        leader = cars[number - len(lanes)] if number >= len(lanes) else None
        cars.append(path_car(lanes[number % len(lanes)], enters, rng.uniform(9.0, 14.0), rng, wander_mps, leader))
    return Traffic(cars, last_s, seed)
