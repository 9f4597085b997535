"""What a detector beside a crossing makes of its traffic, with the exact truth, and the messages of one vehicle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from laci_stereo.core.detections import DetectionLog
from laci_stereo.core.frames import Axes, BoolArray, FloatArray, IntArray, invert, rotate_xy, transform
from laci_stereo.core.messages.cam import CamLog
from laci_stereo.core.result import Calibration
from laci_stereo.core.tracking.box_point import BoxPoint
from tests.simulated import EPOCH_NS, ULM, Drive, Place, cam_log, car, lidar, mounted

LASTS_S = 120.0
FRAMES_HZ = 10.0
RANGE_M = 60.0
HALF_FIELD_DEG = 60.0
CLEAR_M = 3.5
"""No two centres are nearer than this: side by side on two lanes."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations of a detector's boxes, and the share of those that it misses."""

    position_m: float = 0.1
    yaw_deg: float = 2.0
    size_m: float = 0.1
    missing: float = 0.2


EXACT = Noise(0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Passing:
    """A vehicle that is at the start of its drive at ``begin_s``."""

    drive: Drive
    begin_s: float
    size: tuple[float, float, float]

    def at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self.drive.at(times_s - self.begin_s)


@dataclass(frozen=True)
class Traffic:
    """Boxes in the sensor frame in the order of time, and the messages of the first vehicle."""

    place: Place
    T_world_sensor: FloatArray
    axes: Axes
    vehicles: tuple[Passing, ...]
    detections: DetectionLog
    heights_m: FloatArray
    of_vehicle: IntArray
    messages: CamLog

    @property
    def sender(self) -> Passing:
        return self.vehicles[0]

    def sender_xy(self) -> FloatArray:
        """Where the sender truly was whenever it was detected."""
        stamps = self.detections.stamps_ns[self.of_vehicle == 0]
        return self.sender.at((stamps - EPOCH_NS) / 1e9)[0]


def _routes(rng: np.random.Generator) -> list[Drive]:
    """Return ways over a crossing some 28 m ahead of the origin: two roads of two lanes each."""
    speed = rng.uniform(5.0, 11.0)
    slow = rng.uniform(0.4, 1.0) * speed
    speeds = ((-5.0, speed), (rng.uniform(0.0, 2.0), speed), (rng.uniform(3.0, 4.5), slow), (7.0, speed))
    middle = rng.uniform(26.0, 30.0)
    return [
        Drive((middle + 2.0, -30.0), 90.0, speeds=speeds),
        Drive((middle - 2.0, 30.0), -90.0, speeds=speeds),
        Drive((middle + 22.0, 2.0), 180.0, speeds=speeds),
        Drive((middle + 2.0, -30.0), 90.0, ((25.0, 0.0), (11.0, 90.0)), speeds),
        Drive((middle - 2.0, 30.0), -90.0, ((25.0, 0.0), (14.0, 90.0)), speeds),
        Drive((middle - 2.0, 30.0), -90.0, ((22.0, 0.0), (8.0, -90.0)), speeds),
    ]


def _vehicles(count: int, rng: np.random.Generator) -> tuple[Passing, ...]:
    """Draw vehicles that do not drive through each other, the first of which is recorded from end to end."""
    times = np.arange(0.0, LASTS_S, 0.2)
    passing: list[Passing] = []
    paths: list[FloatArray] = []
    while len(passing) < count:
        begin_s = float(rng.uniform(15.0, 90.0) if not passing else rng.uniform(-5.0, LASTS_S))
        size = (float(rng.uniform(3.8, 5.0)), float(rng.uniform(1.7, 1.95)), float(rng.uniform(1.4, 2.0)))
        one = Passing(_routes(rng)[int(rng.integers(6))], begin_s, size)
        path = np.where(_there(one, times)[:, None], one.at(times)[0], np.nan)
        distances = [np.nanmin(np.linalg.norm(path - other, axis=1), initial=np.inf) for other in paths]
        if all(distance > CLEAR_M for distance in distances):
            passing.append(one)
            paths.append(path)
    return tuple(passing)


def _there(one: Passing, times_s: FloatArray) -> BoolArray:
    """Tell when a vehicle is on its way over the crossing, which is as long as its drive is defined."""
    there: BoolArray = (times_s > one.begin_s - 9.0) & (times_s < one.begin_s + 20.0)
    return there


def _messages(place: Place, sender: Passing) -> CamLog:
    length, width, _ = sender.size
    sent = cam_log(place, car(sender.drive, length, width), 20.0, rate_hz=5.0, first_s=-9.0)
    return replace(sent, stamps_ns=sent.stamps_ns + round(1e9 * sender.begin_s))


def traffic(
    seed: int = 0, count: int = 30, noise: Noise | None = None, vehicles: Sequence[Passing] | None = None
) -> Traffic:
    """Draw a crossing and let a detector see it for two minutes."""
    return _drawn(seed, count, noise or Noise(), None if vehicles is None else tuple(vehicles))


@lru_cache(maxsize=64)
def _drawn(seed: int, count: int, noise: Noise, vehicles: tuple[Passing, ...] | None) -> Traffic:
    rng = np.random.default_rng(seed)
    sensor = lidar()
    down, roll, yaw = rng.uniform(0.0, 20.0), rng.uniform(-3.0, 3.0), rng.uniform(-180.0, 180.0)
    T_here_sensor = mounted(sensor, (0.0, 0.0), rng.uniform(4.0, 9.0), 0.0, down, roll)
    made = _vehicles(count, rng) if vehicles is None else vehicles
    turn = np.eye(4)
    turn[:2, :2] = rotate_xy(np.radians(yaw), np.eye(2)).T
    turned = tuple(replace(one, drive=one.drive.turned(float(np.radians(yaw)))) for one in made)
    parts = [_seen(one, number, T_here_sensor, noise, rng) for number, one in enumerate(made)]
    stamps, points, above, yaws, sizes, of_vehicle = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.argsort(stamps, kind="stable")
    log = DetectionLog(
        stamps.astype(np.int64),
        points,
        above,
        yaws,
        sizes[:, 0],
        sizes[:, 1],
        of_vehicle.astype(np.int64),
        np.full(len(stamps), np.nan),
    )[order]
    return Traffic(
        ULM,
        turn @ T_here_sensor,
        sensor.axes,
        turned,
        log,
        sizes[order, 2],
        log.track_id,
        _messages(ULM, turned[0]),
    )


def cars_and_vans(count: int = 12) -> list[Passing]:
    """Return vehicles of two heights on three lanes, the first of which brakes and turns in view."""
    lanes = [Drive((x, -30.0), 90.0, speeds=((0.0, 8.0),)) for x in (20.0, 28.0, 36.0)]
    sizes = ((4.4, 1.8, 1.5), (6.0, 2.0, 2.6))
    others = [Passing(lanes[i % 3], 10.0 + 8.0 * i, sizes[i % 2]) for i in range(1, count)]
    speeds = ((-5.0, 9.0), (1.0, 9.0), (4.0, 5.0), (7.0, 9.0))
    return [Passing(Drive((28.0, -30.0), 90.0, ((25.0, 0.0), (11.0, 90.0)), speeds), 18.0, sizes[0]), *others]


def by_bottom(made: Traffic) -> Traffic:
    """Return the same boxes by the middle of their bottom."""
    log, up = made.detections, made.T_world_sensor[2, :3]
    points = log.points_sensor - made.heights_m[:, None] / 2 * up
    return replace(made, detections=replace(log, points_sensor=points))


def by_point(made: Traffic, point: BoxPoint) -> Traffic:
    """Return the same boxes by another point on the ground plan."""
    log, R = made.detections, made.T_world_sensor[:3, :3]
    flat = np.column_stack([np.cos(log.yaw_rad), np.sin(log.yaw_rad), np.zeros(len(log))])
    ahead = flat @ R.T - np.outer(flat @ R[2] / R[2, 2], R[:, 2])  # along the road, with the same yaw about z
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    left = np.cross([0.0, 0.0, 1.0], ahead)
    front, side = log.length_m[:, None] / 2 * ahead, log.width_m[:, None] / 2 * left
    candidates = {
        "front": [front],
        "rear": [-front],
        "near-end": [front, -front],
        "near-corner": [front + side, front - side, -front + side, -front - side],
    }[point]
    points = np.array([log.points_sensor + each @ R for each in candidates])
    nearest = np.linalg.norm((points @ R.T)[..., :2], axis=2).argmin(axis=0)
    return replace(made, detections=replace(log, points_sensor=points[nearest, np.arange(len(log))]))


def _seen(
    one: Passing, number: int, T_here_sensor: FloatArray, noise: Noise, rng: np.random.Generator
) -> tuple[FloatArray, ...]:
    times = np.arange(round(LASTS_S * FRAMES_HZ)) / FRAMES_HZ
    times = times[_there(one, times)]
    xy, yaw = one.at(times)
    near = np.linalg.norm(xy, axis=1) < RANGE_M
    near &= np.abs(np.degrees(np.arctan2(xy[:, 1], xy[:, 0]))) < HALF_FIELD_DEG
    near &= rng.random(len(times)) >= noise.missing
    times, xy, yaw = times[near], xy[near], yaw[near]
    n = len(times)
    size = np.array(one.size) + noise.size_m * rng.normal(size=(n, 3))
    centres = np.column_stack([xy, np.full(n, one.size[2] / 2)]) + noise.position_m * rng.normal(size=(n, 3))
    ahead = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(n)]) @ T_here_sensor[:3, :3]
    seen_yaw = np.arctan2(ahead[:, 1], ahead[:, 0]) + np.radians(noise.yaw_deg) * rng.normal(size=n)
    stamps = EPOCH_NS + np.round(1e9 * times).astype(np.int64)
    points = transform(invert(T_here_sensor), centres)
    return stamps, points, size[:, 2] / 2, seen_yaw, size, np.full(n, number)


@dataclass(frozen=True)
class Errors:
    """Of a calibration: along the sender's track, and of its angles."""

    track_xy_m: float
    yaw_deg: float
    rotation_deg: float


def errors(made: Traffic, found: Calibration) -> Errors:
    """Compare with the truth in UTM, at the places on the road where the sender was detected."""
    xy = made.sender_xy()
    sensor = transform(invert(made.T_world_sensor), np.column_stack([xy, np.zeros(len(xy))]))
    off = transform(found.T_utm_sensor, sensor)[:, :2] - made.place.to_utm(xy)
    R = found.T_world_sensor[:3, :3] @ made.T_world_sensor[:3, :3].T
    return Errors(
        track_xy_m=float(np.sqrt((off**2).sum(axis=1).mean())),
        yaw_deg=float(np.degrees(np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1]))),
        rotation_deg=float(np.degrees(np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1)))),
    )


def is_senders(made: Traffic, found: Calibration) -> bool:
    """Tell whether at least nine tenths of the track are detections of the sender."""
    stamps = made.detections.stamps_ns
    hits = 0
    for sighting in found.drive.track.sightings:
        rows = np.flatnonzero(np.abs((stamps - stamps[0]) / 1e9 - sighting.stamp_s) < 1e-6)
        level = transform(found.T_level_sensor, made.detections.points_sensor[rows])[:, :2]
        nearest = rows[np.argmin(np.linalg.norm(level - sighting.middle, axis=1))]
        hits += int(made.of_vehicle[nearest] == 0)
    return hits >= 0.9 * len(found.drive.track.sightings)


@dataclass
class Rows:
    """A table that a test may damage before it is written."""

    header: list[str]
    rows: list[list[str]] = field(default_factory=list)

    def column(self, name: str, values: Sequence[object]) -> None:
        """Replace or add a column."""
        if name not in self.header:
            self.header.append(name)
            for row in self.rows:
                row.append("")
        place = self.header.index(name)
        for row, value in zip(self.rows, values, strict=True):
            row[place] = str(value)

    def without(self, *names: str) -> Rows:
        places = [i for i, name in enumerate(self.header) if name not in names]
        return Rows([self.header[i] for i in places], [[row[i] for i in places] for row in self.rows])

    def renamed(self, names: Mapping[str, str]) -> Rows:
        return Rows([names.get(name, name) for name in self.header], [list(row) for row in self.rows])

    def text(self, separator: str = ",") -> str:
        return "\n".join(separator.join(row) for row in [self.header, *self.rows]) + "\n"

    def write(self, path: Path) -> Path:
        path.write_text(self.text(), encoding="utf-8")
        return path


def detection_rows(made: Traffic, track_ids: bool = True) -> Rows:
    """Return detections as a user's file has them."""
    log = made.detections
    numbers = np.column_stack([log.points_sensor, log.yaw_rad, log.length_m, log.width_m, made.heights_m])
    header = ["timestamp", "x", "y", "z", "yaw", "length", "width", "height"]
    stamps = [f"{stamp // 10**9}.{stamp % 10**9:09d}" for stamp in log.stamps_ns.tolist()]
    rows = Rows(header, [[stamp, *(f"{v:.4f}" for v in row)] for stamp, row in zip(stamps, numbers, strict=True)])
    if track_ids:
        rows.column("track_id", log.track_id.tolist())
    return rows


def cam_rows(messages: CamLog) -> Rows:
    """Return messages as a user's file has them."""
    header = ["timestamp", "station_id", "latitude", "longitude", "heading", "speed", "vehicle_length", "vehicle_width"]
    columns = zip(
        messages.stamps_ns.tolist(),
        messages.station_id.tolist(),
        messages.latitude_deg,
        messages.longitude_deg,
        messages.heading_deg,
        messages.speed_mps,
        messages.length_m,
        messages.width_m,
        strict=True,
    )
    return Rows(
        header,
        [
            [f"{t // 10**9}.{t % 10**9:09d}", str(s), f"{a:.7f}", f"{o:.7f}", *(f"{v:.3f}" for v in rest)]
            for t, s, a, o, *rest in columns
        ],
    )
