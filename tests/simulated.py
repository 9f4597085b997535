"""Recordings of a drive with their exact truth, in memory: rays cast at boxes on a flat road, and the CAMs to them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from pyproj import Geod, Proj

from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.frames import (
    FORWARD_LEFT_UP_AXES,
    OPENCV_AXES,
    Axes,
    BoolArray,
    FloatArray,
    planar,
    rigid,
    rotate_xy,
)
from laci_stereo.core.messages.cam import CamLog

EPOCH_NS = 1_700_000_000_123_456_789
R_FLU_OPENCV = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class Place:
    """A metric frame somewhere on Earth: UTM = ``origin_utm`` + ``scale`` * xy."""

    latitude_deg: float
    longitude_deg: float
    crs: str

    @cached_property
    def proj(self) -> Proj:
        return Proj(self.crs)

    @cached_property
    def origin_utm(self) -> FloatArray:
        return np.array(self.proj(self.longitude_deg, self.latitude_deg))

    @cached_property
    def scale(self) -> float:
        """Grid metres per true metre, by a geodesic of 100 m to the east and one to the north."""
        xy = np.array([[-50.0, 0.0], [50.0, 0.0], [0.0, -50.0], [0.0, 50.0]])
        x, y = (self.origin_utm + xy).T
        longitude, latitude = self.proj(x, y, inverse=True)
        east, north = Geod(ellps="WGS84").inv(longitude[::2], latitude[::2], longitude[1::2], latitude[1::2])[2]
        return float(200.0 / (east + north))

    def to_utm(self, xy: FloatArray) -> FloatArray:
        return self.origin_utm + self.scale * xy

    def geodetic(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return latitude and longitude in degrees."""
        x, y = self.to_utm(xy).T
        longitude, latitude = self.proj(x, y, inverse=True)
        return np.asarray(latitude), np.asarray(longitude)

    def heading_deg(self, xy: FloatArray, yaw_rad: FloatArray) -> FloatArray:
        """Return the azimuth of a step of 10 m, clockwise from true north."""
        ahead = xy + 10.0 * np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad)])
        (lat0, lon0), (lat1, lon1) = self.geodetic(xy), self.geodetic(ahead)
        return np.asarray(Geod(ellps="WGS84").inv(lon0, lat0, lon1, lat1)[0]) % 360.0


ULM = Place(48.42, 9.94, "EPSG:32632")
SYDNEY = Place(-33.86, 151.2, "EPSG:32756")
ZONE_BORDER = Place(52.0, 12.0, "EPSG:32633")
EQUATOR = Place(0.0, -78.5, "EPSG:32617")
TROMSO = Place(69.65, 18.95, "EPSG:32634")


@dataclass(frozen=True)
class Drive:
    """A motion along a path of straight legs and arcs.

    ``legs`` are (length in m, degrees turned to the left); before the first and after the last it is straight.
    ``speeds`` are (time in s, m/s), linear in between. At ``start_s`` it is at the start.
    """

    start: tuple[float, float]
    yaw_deg: float
    legs: tuple[tuple[float, float], ...] = ()
    speeds: tuple[tuple[float, float], ...] = ((0.0, 7.0),)
    start_s: float = 0.0

    def at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return positions, shape (n, 2), and yaw, shape (n,)."""
        time, driven, path, xy, yaw = self._tables
        s = np.interp(times_s, time, driven)
        return np.column_stack([np.interp(s, path, xy[:, 0]), np.interp(s, path, xy[:, 1])]), np.interp(s, path, yaw)

    def speed(self, times_s: FloatArray) -> FloatArray:
        times, speeds = zip(*self.speeds, strict=True)
        speed: FloatArray = np.interp(times_s - self.start_s, times, speeds)
        return speed

    @cached_property
    def _tables(self) -> tuple[FloatArray, ...]:
        time = np.arange(-10.0, 40.0, 1e-3)
        driven = _cumulated(self.speed(time), time, self.start_s)
        path = np.arange(driven[0] - 1.0, driven[-1] + 1.0, 0.01)
        metres, degrees = np.cumsum([(0.0, self.yaw_deg), *self.legs], axis=0).T
        yaw = np.radians(np.interp(path, metres, degrees))
        xy = [_cumulated(np.cos(yaw), path, 0.0), _cumulated(np.sin(yaw), path, 0.0)]
        return time, driven, path, np.column_stack(xy) + self.start, yaw

    def turned(self, yaw_rad: float) -> Drive:
        x, y = rotate_xy(yaw_rad, np.array(self.start)).tolist()
        return replace(self, start=(x, y), yaw_deg=self.yaw_deg + float(np.degrees(yaw_rad)))


def _cumulated(rate: FloatArray, over: FloatArray, zero: float) -> FloatArray:
    """Return the integral from ``zero``."""
    total = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(over))])
    from_zero: FloatArray = total - np.interp(zero, over, total)
    return from_zero


@dataclass(frozen=True)
class Solid:
    """An upright box; ``xy`` is under its centre."""

    xy: tuple[float, float]
    yaw_deg: float
    length: float
    width: float
    low: float
    high: float

    def moved(self, xy: FloatArray, yaw_rad: float) -> Solid:
        x, y = (xy + rotate_xy(yaw_rad, np.array(self.xy))).tolist()
        return replace(self, xy=(x, y), yaw_deg=self.yaw_deg + float(np.degrees(yaw_rad)))

    def hit(self, origin: FloatArray, directions: FloatArray) -> FloatArray:
        """Return how far along each ray, shape (n, 3), the box is entered; inf where it is missed."""
        distance = np.full(len(directions), np.inf)
        middle = np.array([*self.xy, (self.low + self.high) / 2]) - origin
        far = float(np.linalg.norm(middle))
        radius = float(np.linalg.norm([self.length, self.width, self.high - self.low])) / 2
        near = np.arange(len(directions))
        if far > radius:
            near = np.flatnonzero(directions @ (middle / far) >= np.sqrt(1 - (radius / far) ** 2))
        c, s = np.cos(np.radians(self.yaw_deg)), np.sin(np.radians(self.yaw_deg))
        into = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        rays = directions[near] @ into.T
        rays = np.where(np.abs(rays) < 1e-12, 1e-12, rays)
        to_middle = into @ middle
        half = np.array([self.length, self.width, self.high - self.low]) / 2
        first, second = (to_middle - half) / rays, (to_middle + half) / rays
        enter = np.minimum(first, second).max(axis=1)
        leave = np.maximum(first, second).min(axis=1)
        met = (enter < leave) & (enter > 0.0)
        distance[near[met]] = enter[met]
        return distance


@dataclass(frozen=True)
class Mover:
    """Something that moves, or comes and goes: its parts are in the vehicle frame."""

    drive: Drive
    parts: tuple[Solid, ...]
    presence: float = 1.0

    @property
    def length(self) -> float:
        return max(part.length for part in self.parts)

    @property
    def width(self) -> float:
        return max(part.width for part in self.parts)


def car(drive: Drive, length: float = 4.4, width: float = 1.8) -> Mover:
    body = Solid((0.0, 0.0), 0.0, length, width, 0.2, 0.8)
    windows = Solid((-0.06 * length, 0.0), 0.0, 0.76 * length, 0.95 * width, 0.8, 1.15)
    roof = Solid((-0.08 * length, 0.0), 0.0, 0.5 * length, 0.9 * width, 1.15, 1.5)
    return Mover(drive, (body, windows, roof))


def pedestrian(drive: Drive) -> Mover:
    return Mover(drive, (Solid((0.0, 0.0), 0.0, 0.5, 0.6, 0.0, 1.75),))


def shrub(xy: tuple[float, float], presence: float = 0.4, size: float = 2.0) -> Mover:
    return Mover(Drive(xy, 0.0, speeds=((0.0, 0.0),)), (Solid((0.0, 0.0), 20.0, size, size, 0.0, 1.5),), presence)


@dataclass(frozen=True)
class Sensor:
    """Rays in the sensor frame, and their noise: ``relative`` of 1 / depth, ``constant_m`` of range.

    ``turn_s`` is how long a scanner's turn lasts that does not tell its points' times, negative if it turns clockwise;
    half a turn of it before the stamp it passes ``begin_rad``.
    """

    directions: FloatArray
    at_edge: BoolArray
    axes: Axes
    relative: float
    constant_m: float
    bearing_rad: float
    turn_s: float = 0.0
    begin_rad: float = np.pi
    window_rad: float = 0.0

    @cached_property
    def late_s(self) -> FloatArray:
        """When each ray is sent after the stamp, by steps of a millisecond, shape (n,)."""
        late_s: FloatArray = np.round(self.turn_s * (self.turned_rad - np.pi) / (2 * np.pi), 3)
        return late_s

    @cached_property
    def turned_rad(self) -> FloatArray:
        """How far to the left of where a scan begins each ray is, shape (n,)."""
        turned: FloatArray = (np.arctan2(self.directions[:, 1], self.directions[:, 0]) - self.begin_rad) % (2 * np.pi)
        return turned

    def measure(self, distance: FloatArray, stamp_ns: int, rng: np.random.Generator) -> PointCloud:
        """Add noise to true distances; inf is nothing."""
        seen = distance < 120.0
        directions, true = self.directions[seen], distance[seen]
        forward = np.maximum(directions @ np.asarray(self.axes.forward), 1e-6) if self.relative else np.ones(len(true))
        inverse = 1.0 / (true * forward) + self.relative * rng.normal(size=len(true))
        with np.errstate(divide="ignore"):
            measured = 1.0 / (inverse * forward) + self.constant_m * rng.normal(size=len(true))
        keep = (inverse > 0.0) & (measured > 0.5) & (measured < 150.0)
        measured, forward = measured[keep], forward[keep]
        tilted = directions[keep] + self.bearing_rad * rng.normal(size=(len(measured), 3))
        return PointCloud(
            stamp_ns,
            tilted / np.linalg.norm(tilted, axis=1, keepdims=True) * measured[:, None],
            self.relative * forward * measured**2 + self.constant_m,
            self.bearing_rad * measured,
            self.at_edge[seen][keep],
            turn_s=abs(self.turn_s),
            turned_rad=self.turned_rad[seen][keep] if self.turn_s else None,
            window_rad=self.window_rad,
        )


def lidar(
    layers: int = 64,
    columns: int = 240,
    field_deg: tuple[float, float] = (100.0, 30.0),
    down_deg: float = 0.0,
    sigma_m: float = 0.02,
) -> Sensor:
    """A scanner with its axes forward, left and up; it looks as far down from its own forward axis as ``down_deg``."""
    azimuth = np.radians(np.linspace(-field_deg[0] / 2, field_deg[0] / 2, columns))
    elevation = np.radians(np.linspace(-field_deg[1] / 2, field_deg[1] / 2, layers) - down_deg)
    e, a = np.meshgrid(elevation, azimuth, indexing="ij")
    directions = np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=-1)
    edge = np.zeros((layers, columns), dtype=bool)
    edge[:, [0, -1]] = True
    return Sensor(directions.reshape(-1, 3), edge.ravel(), FORWARD_LEFT_UP_AXES, 0.0, sigma_m, 5e-4)


def stereo(
    columns: int = 160,
    focal: float = 0.8,
    baseline_m: float = 0.5,
    sigma_px: float = 0.25,
    width_px: int = 1280,
    window_px: int = 0,
) -> Sensor:
    """A pair of cameras of format 16:9; ``focal`` is in widths of the image."""
    rows = columns * 9 // 16
    v, u = np.meshgrid(
        (np.arange(rows) + 0.5) / columns - 9 / 32, (np.arange(columns) + 0.5) / columns - 0.5, indexing="ij"
    )
    directions = np.stack([u / focal, v / focal, np.ones_like(u)], axis=-1).reshape(-1, 3)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    edge = np.zeros((rows, columns), dtype=bool)
    edge[:, [0, -1]] = edge[[0, -1]] = True
    focal_px = focal * width_px
    return Sensor(
        directions,
        edge.ravel(),
        OPENCV_AXES,
        sigma_px / (focal_px * baseline_m),
        0.0,
        0.2 / focal_px,
        window_rad=window_px / focal_px,
    )


def mounted(
    sensor: Sensor, xy: tuple[float, float], height_m: float, yaw_deg: float, down_deg: float, roll_deg: float = 0.0
) -> FloatArray:
    """Return ``T_world_sensor`` of a sensor that looks along yaw, so far down, and is rolled clockwise."""
    y, d, r = np.radians([yaw_deg, down_deg, roll_deg])
    turn = np.array([[np.cos(y), -np.sin(y), 0.0], [np.sin(y), np.cos(y), 0.0], [0.0, 0.0, 1.0]])
    pitch = np.array([[np.cos(d), 0.0, np.sin(d)], [0.0, 1.0, 0.0], [-np.sin(d), 0.0, np.cos(d)]])
    roll = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(r), -np.sin(r)], [0.0, np.sin(r), np.cos(r)]])
    R = turn @ pitch @ roll
    return rigid(R @ R_FLU_OPENCV if sensor.axes == OPENCV_AXES else R, np.array([*xy, height_m]))


@dataclass(frozen=True)
class Recording:
    """A `PointCloudSource`: frame i is the same whenever it is asked for."""

    sensor: Sensor
    T_world_sensor: FloatArray
    static: tuple[Solid, ...]
    movers: tuple[Mover, ...]
    times_s: FloatArray
    seed: int = 0
    surveyed: int = 8

    @property
    def axes(self) -> Axes:
        return self.sensor.axes

    @cached_property
    def stamps_ns(self) -> list[int]:
        return [EPOCH_NS + round(1e9 * float(t)) for t in self.times_s]

    @property
    def span_ns(self) -> tuple[int, int]:
        return self.stamps_ns[0], self.stamps_ns[-1]

    def __len__(self) -> int:
        return len(self.times_s)

    def __iter__(self) -> Iterator[PointCloud]:
        return map(self.frame, range(len(self)))

    def survey(self) -> Iterator[PointCloud]:
        count = min(self.surveyed, len(self))
        return map(self.frame, np.linspace(0, len(self) - 1, count).round().astype(int).tolist())

    def frame(self, index: int) -> PointCloud:
        rng = np.random.default_rng([self.seed, index])
        distance = self._at_rest.copy()
        late_s = np.unique(self.sensor.late_s)
        at_once = [np.flatnonzero(self.sensor.late_s == late) for late in late_s]
        for mover in self.movers:
            if rng.random() > mover.presence:
                continue
            poses = zip(*mover.drive.at(self.times_s[index] + late_s), at_once, strict=True)
            for (xy, yaw, rays), part in product(poses, mover.parts):
                hit = part.moved(xy, yaw).hit(self.T_world_sensor[:3, 3], self._directions[rays])
                distance[rays] = np.minimum(distance[rays], hit)
        return self.sensor.measure(distance, self.stamps_ns[index], rng)

    @cached_property
    def _directions(self) -> FloatArray:
        directions: FloatArray = self.sensor.directions @ self.T_world_sensor[:3, :3].T
        return directions

    @cached_property
    def _at_rest(self) -> FloatArray:
        down = self._directions[:, 2]
        with np.errstate(divide="ignore"):
            distance = np.where(down < 0.0, -self.T_world_sensor[2, 3] / down, np.inf)
        for solid in self.static:
            distance = np.minimum(distance, solid.hit(self.T_world_sensor[:3, 3], self._directions))
        return distance

    def turned(self, yaw_rad: float) -> Recording:
        """Return the same scene, turned about the origin of the world."""
        return replace(
            self,
            T_world_sensor=planar(yaw_rad, np.zeros(2)) @ self.T_world_sensor,
            static=tuple(solid.moved(np.zeros(2), yaw_rad) for solid in self.static),
            movers=tuple(replace(mover, drive=mover.drive.turned(yaw_rad)) for mover in self.movers),
        )


def cam_log(
    place: Place,
    mover: Mover,
    last_s: float,
    rate_hz: float = 10.0,
    phase_s: float = 0.037,
    station: int = 42,
    first_s: float = -1.0,
    reference: tuple[float, float] | None = None,
    rounded: bool = True,
    seed: int = 0,
) -> CamLog:
    """Return the messages of a vehicle: headings are of its motion, and arbitrary while it stands.

    ``reference`` is in the vehicle frame; None is ETSI's, the centre of the front side.
    """
    times = np.arange(first_s + phase_s, last_s + 1.0, 1.0 / rate_hz)
    xy, yaw = mover.drive.at(times)
    speed = mover.drive.speed(times)
    offset = np.array([mover.length / 2, 0.0] if reference is None else reference)
    latitude, longitude = place.geodetic(xy + rotate_xy(yaw, np.tile(offset, (len(times), 1))))
    heading = place.heading_deg(xy, yaw) + np.where(speed < 0.0, 180.0, 0.0)
    speed = np.abs(speed)
    heading = np.where(speed < 0.3, np.random.default_rng(seed).uniform(0.0, 360.0, len(times)), heading)
    if rounded:
        latitude, longitude, heading, speed = latitude.round(7), longitude.round(7), heading.round(1), speed.round(2)
    unknown = np.full(len(times), np.nan)
    return CamLog(
        EPOCH_NS + (1e9 * times).round().astype(np.int64),
        np.full(len(times), station),
        latitude,
        longitude,
        heading % 360.0,
        speed,
        unknown,
        np.full(len(times), mover.length),
        np.full(len(times), mover.width),
        unknown,
        unknown,
        unknown,
    )


def together(logs: Sequence[CamLog]) -> CamLog:
    """Return the messages of several stations in the order of time."""
    order = np.argsort(np.concatenate([log.stamps_ns for log in logs]), kind="stable")
    return logs[0].joined(*logs[1:])[order]


@dataclass(frozen=True)
class Scene:
    """A recording, its messages and where it is."""

    place: Place
    recording: Recording
    messages: CamLog

    @property
    def vehicle(self) -> Mover:
        return self.recording.movers[0]


HOUSES = (
    Solid((46.0, 4.0), 3.0, 1.0, 60.0, 0.0, 12.0),
    Solid((42.5, 20.0), 0.0, 8.0, 10.0, 0.0, 9.0),
    Solid((43.5, -17.0), 8.0, 8.0, 4.0, 0.0, 6.0),
    Solid((17.0, 9.5), 4.0, 4.5, 1.8, 0.0, 1.5),
    Solid((26.0, -11.0), 0.0, 0.3, 0.3, 0.0, 6.0),
)
"""Walls and buildings, a parked car and a mast, around a sensor that stands at the origin and looks along x."""

STRAIGHT = Drive((22.0, 22.0), -90.0, speeds=((0.0, 8.0),))
LEFT_TURN = Drive((33.0, -14.0), 90.0, ((11.0, 0.0), (12.5, 90.0)), ((0.0, 6.0),))
RIGHT_TURN = Drive((30.0, 15.0), -90.0, ((8.0, 0.0), (11.0, -90.0)), ((0.0, 6.0),))
CURVE = Drive((38.0, -10.0), 150.0, ((50.0, -110.0),), ((0.0, 7.0),))
STOP_AND_GO = Drive((21.0, 16.0), -90.0, speeds=((0.0, 7.0), (1.2, 7.0), (3.0, 0.0), (4.5, 0.0), (6.5, 6.0)))


def scene(
    drive: Drive = LEFT_TURN,
    sensor: Sensor | None = None,
    place: Place = ULM,
    last_s: float = 6.0,
    frames_hz: float = 10.0,
    yaw_deg: float = 35.0,
    others: Sequence[Mover] = (),
    static: Sequence[Solid] = HOUSES,
    rate_hz: float = 10.0,
    seed: int = 0,
    height_m: float = 6.0,
    down_deg: float = 14.0,
    size: tuple[float, float] = (4.4, 1.8),
) -> Scene:
    """A sensor above the origin that looks along x and down; in the end all is turned by yaw."""
    sensor = sensor or lidar()
    T_world_sensor = mounted(sensor, (0.0, 0.0), height_m, 0.0, down_deg, 1.5)
    times = np.arange(0.0, last_s, 1.0 / frames_hz)
    recording = Recording(sensor, T_world_sensor, tuple(static), (car(drive, *size), *others), times, seed)
    recording = recording.turned(float(np.radians(yaw_deg)))
    return Scene(place, recording, cam_log(place, recording.movers[0], last_s, rate_hz))
