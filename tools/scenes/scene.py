"""Whole scenes with their ground truth, drawn from a seed; every factor can be set instead of drawn."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

import numpy as np
from laci_lidar.axes import forward_left_up
from laci_lidar.recording import LidarRecording
from laci_lidar.scan import Scan
from laci_lidar.settings import LidarSettings
from scipy.spatial.transform import Rotation

from laci_stereo.core.cloud import PointCloud, PointCloudSource
from laci_stereo.core.frames import (
    FORWARD_LEFT_UP_AXES,
    OPENCV_AXES,
    Axes,
    BoolArray,
    FloatArray,
    IntArray,
    invert,
    rigid,
    rotation_z,
    transform,
)
from laci_stereo.core.messages.cam import CamLog
from laci_stereo.core.quality import Uncertainty
from laci_stereo.core.result import Calibration, Quality
from laci_stereo.stereo.recording import surveyed
from tools.scenes.cams import EPOCH_NS, CamFlaws, ReceiverName, Rounding, cam_log, together
from tools.scenes.disparity import (
    STEREOS,
    WIDTH_PX,
    Matched,
    Mounted,
    StereoCamera,
    StereoFlaws,
    StereoName,
    match_frame,
    reproject,
    stereo_camera,
)
from tools.scenes.drives import DRIVES, DriveKind
from tools.scenes.geometry import Body, RayCaster, rotation_y
from tools.scenes.places import PLACES, Place
from tools.scenes.sensors import LIDARS, TURNINGS, Lidar, LidarFlaws, LidarName, Swept, Turning, lidar, sweep
from tools.scenes.traffic import Mover, draw_traffic, park, place_drive, possible, vehicle_mover
from tools.scenes.vehicles import KINDS, Vehicle, VehicleKind, draw_vehicle
from tools.scenes.world import LAYOUTS, LayoutKind, Site, build_site, draw_road, shrubs

SensorKind = Literal[LidarName, StereoName]
SENSORS: tuple[SensorKind, ...] = (*LIDARS, *STEREOS)

Hanging = Literal["x forward", "upside down", "y forward", "-x forward"]
HANGINGS: dict[Hanging, Axes] = {
    "x forward": FORWARD_LEFT_UP_AXES,
    "upside down": Axes((1.0, 0.0, 0.0), (0.0, 0.0, -1.0)),
    "y forward": Axes((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "-x forward": Axes((-1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
}

STATION = 4711
NEAR_M = 50.0
"""The sender must be visible within this horizontal distance from the sensor, metres."""

NEEDED_FRAMES = 40
"""Number of frames in which the sender must be in view, unless set otherwise."""

NEEDED_M = 15.0
"""Distance that the sender must drive in these frames, metres: enough to get through the crossing."""

SCORED_M = 60.0
"""The errors of a calibration are evaluated on the track within this distance from the sensor, metres."""

GUSTS_HZ, MASTS_HZ = (0.1, 0.5), (0.7, 2.0)
"""Frequencies of gusts, and at which a mast of 5 to 15 m sways."""

TRIES = 60

T = TypeVar("T")


class SceneError(Exception):
    """No scene with these factors has its sender in view."""


@dataclass(frozen=True, kw_only=True)
class Factors:
    """The factors of a scene; one that is None is drawn, from a random stream of its own, so that it changes no other.

    Attributes
    ----------
    layout, drive, vehicle, place
        See `tools.scenes.world`, `drives`, `vehicles` and `places` (by name).
    speed_mps : float
    left_hand : bool
        Traffic drives on the left.
    uneven : float
        Scales crown, bends and waves of the road.
    land : float
        Scales slopes and bumps of the land behind the pavements.
    verges : bool
        The road has verges instead of kerbs and pavements.
    density : float
        Scales the number of houses, walls, plants, poles and bins around the crossing.
    vehicles, walkers, cyclists, parked : int
        Numbers of other road users and of parked cars.
    near_m : float
        Distance within which the vehicles, walkers and cyclists come to the sender; None leaves it to chance.
    shrubs : int
        Number of hedges, swaying in gusts, behind the kerbs along the sender's path.
    height_m, tilt_deg, roll_deg : float
        The sensor's height above the road, its tilt downwards and its roll.
    away_m : float
        The sensor's horizontal distance from the middle of the crossing.
    hanging : str
        Orientation of a LiDAR's axes, a key of `HANGINGS`.
    frames : int
    frame_rate_hz : float
        None is the sensor's own.
    min_seen, min_driven_m
        Least number of frames in which the sender is in view, and least distance that it drives in them, metres.
    receiver, cam_rate_hz, loss, clock_offset_s, heading_sigma_deg, heading_of, heading_lag_s
        See `CamFlaws`.
    quantised, rounding, over_mirrors
        See `CamFlaws`.
    lever_sigma_m : float
        Standard deviation of the lever arm's error, per axis.
    stations : int
        Number of other vehicles that send, each with flaws of its own.
    stamping_s : float
        Standard deviation of the difference between each other station's clock and the sender's.
    noise, rain, point_times
        See `LidarFlaws`; ``noise`` also scales a stereo camera's.
    begin_deg : float
        Azimuth at which the scans of a LiDAR with a full horizontal field of view begin, counter-clockwise from
        forward.
    turning : str
        How a LiDAR scans, one of `TURNINGS`; a flash LiDAR takes all points at once.
    lean_deg : float
        Angle by which a LiDAR's mast leans in gusts, about x and about y: one standard deviation.
    stamp_jitter_s : float
        Standard deviation of the error of the frames' stamps.
    systematic : float
        Scales the sensors' errors that are common to many points.
    lasting, bleed_px, gross, gloss_px
        For stereo cameras; ``gross`` scales the fraction of mismatches, for the others see `StereoFlaws`.
    width_px, focal_px
        Width of a stereo camera's images, of format 16:9, and its focal length.
    focal_error, baseline_error : float
        Relative errors of focal length and baseline in the stereo calibration; positive if it overestimates them.
    turned_deg : tuple of float
        Pitch, yaw and roll of the right camera since the stereo calibration.
    apart_s : float
        Time from a stereo camera's left to its right images.
    """

    layout: LayoutKind | None = None
    drive: DriveKind | None = None
    vehicle: VehicleKind | None = None
    place: str | None = None
    speed_mps: float | None = None
    left_hand: bool | None = None
    uneven: float | None = None
    land: float | None = None
    verges: bool | None = None
    density: float | None = None
    vehicles: int | None = None
    walkers: int | None = None
    cyclists: int | None = None
    parked: int | None = None
    near_m: float | None = None
    shrubs: int = 0
    height_m: float | None = None
    tilt_deg: float | None = None
    roll_deg: float | None = None
    away_m: float | None = None
    hanging: Hanging | None = None
    frames: int | None = None
    frame_rate_hz: float | None = None
    min_seen: int = NEEDED_FRAMES
    min_driven_m: float = NEEDED_M
    receiver: ReceiverName = "rtk"
    cam_rate_hz: float | None = None
    loss: float | None = None
    clock_offset_s: float | None = None
    heading_sigma_deg: float | None = None
    heading_of: Literal["body", "front"] | None = None
    heading_lag_s: float = 0.0
    quantised: bool = True
    rounding: Rounding | None = None
    over_mirrors: bool | None = None
    lever_sigma_m: float = 0.02
    stations: int | None = None
    stamping_s: float = 0.003
    noise: float = 1.0
    rain: float | None = None
    point_times: bool | None = None
    begin_deg: float = 180.0
    turning: Turning | None = None
    lean_deg: float = 0.0
    stamp_jitter_s: float = 0.0
    systematic: float = 1.0
    lasting: float | None = None
    bleed_px: float | None = None
    gross: float | None = None
    gloss_px: float | None = None
    width_px: int = WIDTH_PX
    focal_px: float | None = None
    focal_error: float = 0.0
    baseline_error: float = 0.0
    turned_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    apart_s: float = 0.0


@dataclass(frozen=True)
class Draw:
    """The random numbers of a scene: one stream per name, so that setting one factor leaves the others unchanged."""

    seed: int
    attempt: int

    def rng(self, name: str) -> np.random.Generator:
        """Return the stream of that name."""
        return np.random.default_rng([self.seed, self.attempt, zlib.crc32(name.encode())])

    def given(self, value: T | None, name: str, drawn: Callable[[np.random.Generator], T]) -> T:
        """Return the value if it is set, else a drawn one."""
        return drawn(self.rng(name)) if value is None else value

    def choice(self, value: T | None, name: str, options: Sequence[T], weights: Sequence[float] | None = None) -> T:
        """Return the value if it is set, else one of the options."""
        p = None if weights is None else np.array(weights) / sum(weights)
        return self.given(value, name, lambda rng: options[int(rng.choice(len(options), p=p))])


@dataclass(frozen=True)
class Scene:
    """A scene in its own frame: metric, z = 0 is the best plane of the road (`Place` relates it to the map).

    Attributes
    ----------
    seed : int
    sensor_kind : SensorKind
    factors : Factors
        As requested.
    place : Place
    site : Site
    vehicle : Vehicle
        The sender's vehicle.
    sender : Mover
    others : tuple of Mover
    sensor : Lidar or StereoCamera
    axes : Axes
        Where forward and up are in the sensor's frame.
    T_world_sensor : ndarray, shape (4, 4)
        "World" is the scene's frame here.
    times_s : ndarray, shape (n,)
        Times of the frames by the sensor's clock, in seconds after `EPOCH_NS`.
    messages : CamLog
    cam_flaws : CamFlaws
    lidar_flaws : LidarFlaws
    stereo_flaws : StereoFlaws
    drive_kind : DriveKind
        The sender's kind of drive.
    in_view : ndarray of bool, shape (n,)
        Frames in which the sender is in view, see `frames_in_view`.
    """

    seed: int
    sensor_kind: SensorKind
    factors: Factors
    place: Place
    site: Site
    vehicle: Vehicle
    sender: Mover
    others: tuple[Mover, ...]
    sensor: Lidar | StereoCamera
    axes: Axes
    T_world_sensor: FloatArray
    times_s: FloatArray
    messages: CamLog
    cam_flaws: CamFlaws
    lidar_flaws: LidarFlaws
    stereo_flaws: StereoFlaws
    drive_kind: DriveKind
    in_view: BoolArray

    @property
    def seen(self) -> int:
        """Number of frames in which the sender is in view."""
        return int(self.in_view.sum())

    @cached_property
    def bodies(self) -> tuple[Body, ...]:
        """Everything that rays can meet; the sender is the last."""
        moving = (body for mover in (*self.others, self.sender) for body in mover.bodies)
        return (*self.site.bodies, *moving)

    @cached_property
    def caster(self) -> RayCaster:
        """The ray caster for these bodies."""
        return RayCaster(self.bodies)

    @property
    def stamps_ns(self) -> IntArray:
        """Stamps of the frames, nanoseconds, shape (n,)."""
        jitter = np.random.default_rng([self.seed, 17]).normal(size=len(self.times_s)).clip(-3.0, 3.0)
        stamps_s = self.times_s + self.factors.stamp_jitter_s * jitter
        return EPOCH_NS + np.round(stamps_s * 1e9).astype(np.int64)

    def T_world_sensor_at(self, time_s: float) -> FloatArray:
        """Return the sensor's pose while its mast leans about its foot: slowly in gusts, faster as the mast sways."""
        rng = np.random.default_rng([self.seed, 19])
        turns = time_s * np.array([rng.uniform(*GUSTS_HZ, 2), rng.uniform(*MASTS_HZ, 2)])
        x_deg, y_deg = self.factors.lean_deg * np.sin(2.0 * np.pi * (turns + rng.random((2, 2)))).sum(axis=0)
        lean = rigid(Rotation.from_euler("xy", [x_deg, y_deg], degrees=True).as_matrix(), np.zeros(3))
        foot = rigid(np.eye(3), self.T_world_sensor[:3, 3] * (1.0, 1.0, 0.0))
        return foot @ lean @ invert(foot) @ self.T_world_sensor

    @cached_property
    def track_utm(self) -> FloatArray:
        """Centre of the sender's box in UTM at the times of the frames, shape (n, 2)."""
        return self.track_utm_of(STATION)

    def track_utm_of(self, station: int) -> FloatArray:
        """Return the centre of the box of a station's vehicle, likewise: others may send as well."""
        mover = self.sender if station == STATION else _talking(self.others)[station - STATION - 1]
        return self.place.to_utm(mover.track(self.times_s)[0])

    @cached_property
    def T_utm_sensor(self) -> FloatArray:
        """The best rigid transform from the sensor into UTM around the part of the track near it, shape (4, 4)."""
        xy = self.sender.track(self.times_s)[0]
        near = np.linalg.norm(xy - self.T_world_sensor[:2, 3], axis=1) < SCORED_M
        return self.place.T_utm_scene(xy[near].mean(axis=0) if near.any() else xy.mean(axis=0)) @ self.T_world_sensor

    @property
    def crs(self) -> str:
        """The UTM zone."""
        return f"EPSG:{self.place.epsg}"


@dataclass(frozen=True)
class Errors:
    """Errors of a calibration with respect to the ground truth.

    Attributes
    ----------
    track_xy_cm, track_z_cm : float
        Root mean square error of ground points under the vehicle's true track, in the plane and in height.
    rotation_deg, position_cm : float
    sigma_ratio : float
        ``track_xy_cm`` over the value that the calibration's covariance predicts for the same points.
    rotation_ratio : float
        Error of the yaw over its predicted standard deviation, or that ratio of the tilt if it is larger.
    """

    track_xy_cm: float
    track_z_cm: float
    rotation_deg: float
    position_cm: float
    sigma_ratio: float
    rotation_ratio: float


def errors_of(calibration: Calibration, scene: Scene) -> Errors:
    """Compare a calibration with the ground truth: both map the same ground points, along the track within `SCORED_M`.

    The track is that of the vehicle whose messages were used. Both must be in the same UTM zone: on a border, pass
    ``scene.crs`` to the calibration.
    """
    assert calibration.world.crs == scene.crs, f"{calibration.world.crs} is not {scene.crs}"
    T_true, T_found = scene.T_utm_sensor, calibration.T_utm_sensor
    track = scene.track_utm_of(calibration.drive.station_id)
    track = track[np.linalg.norm(track - T_true[:2, 3], axis=1) < SCORED_M]
    ground = np.column_stack([track, np.zeros(len(track))])
    error = transform(T_found @ invert(T_true), ground) - ground
    track_xy = float(np.sqrt((error[:, :2] ** 2).sum(axis=1).mean()))
    # The sine of half the angle is used: an arc cosine near 1 cannot resolve less than 0.001 deg.
    apart = float(np.linalg.norm(T_found[:3, :3] - T_true[:3, :3])) / np.sqrt(8.0)
    return Errors(
        track_xy_cm=100 * track_xy,
        track_z_cm=100 * float(np.sqrt((error[:, 2] ** 2).mean())),
        rotation_deg=float(np.degrees(2 * np.arcsin(min(apart, 1.0)))),
        position_cm=100 * float(np.linalg.norm((T_found - T_true)[:3, 3])),
        sigma_ratio=track_xy / max(_claimed_xy_m(calibration, track), 1e-9),
        rotation_ratio=_rotation_ratio(T_found[:3, :3] @ T_true[:3, :3].T, calibration.quality),
    )


def _claimed_xy_m(calibration: Calibration, track_utm: FloatArray) -> float:
    """Return the root mean square error in the plane that a calibration predicts for ground points."""
    arms = calibration.world.from_utm(track_utm) - calibration.centre_world[:2]
    return Uncertainty(calibration.covariance[2:5, 2:5], arms).track_xy_m


def _rotation_ratio(R_error: FloatArray, quality: Quality) -> float:
    x, y, z = np.degrees(Rotation.from_matrix(R_error).as_rotvec()).tolist()
    yaw_ratio = abs(float(z)) / max(quality.yaw_sigma_deg, 1e-9)
    return max(yaw_ratio, float(np.hypot(x, y)) / max(quality.tilt_sigma_deg, 1e-9))


def draw_scene(seed: int, sensor_kind: SensorKind, **overrides: Any) -> Scene:
    """Draw a scene in which the sensor sees the sender.

    Parameters
    ----------
    seed : int
    sensor_kind : SensorKind
    overrides
        Fields of `Factors`.

    Raises
    ------
    SceneError
        If the sender was in view for too few frames, or for too short a drive, in each of `TRIES` attempts.
    """
    factors = Factors(**overrides)
    most = 0
    for attempt in range(TRIES):
        scene = _drawn(Draw(seed, attempt), sensor_kind, factors)
        if scene is None:
            continue
        in_view = frames_in_view(scene)
        seen = int(in_view.sum())
        xy = scene.sender.track(scene.times_s)[0]
        driven_m = float((np.linalg.norm(np.diff(xy, axis=0), axis=1) * in_view[1:]).sum())
        if seen >= factors.min_seen and driven_m >= factors.min_driven_m:
            return replace(scene, in_view=in_view)
        most = max(most, seen)
    raise SceneError(
        f"seed {seed}: the sender is in view for {most} frames at most; needed are {factors.min_seen} frames, and "
        f"{factors.min_driven_m:g} m driven in them"
    )


def frames_in_view(scene: Scene) -> BoolArray:
    """Return in which frames, shape (n,), the sender is near and 40 % of its surface facing the sensor is visible."""
    mesh = scene.vehicle.mesh
    step = max(len(mesh.triangles) // 60, 1)
    middles = mesh.vertices[mesh.triangles[::step]].mean(axis=1)
    facing = mesh.normals[::step]
    origin = scene.T_world_sensor[:3, 3]
    T_own_world = invert(scene.T_world_sensor @ own_axes(scene))
    in_view = np.zeros(len(scene.times_s), dtype=bool)
    for index, time_s in enumerate(scene.times_s.tolist()):
        pose = scene.sender.pose(time_s)
        if np.linalg.norm(pose[:2, 3] - origin[:2]) > NEAR_M:
            continue
        points = transform(pose, middles)
        rays = points - origin
        towards = np.einsum("ij,ij->i", rays, facing @ pose[:3, :3].T) < 0.0
        visible = scene.sensor.sees(transform(T_own_world, points)) & towards
        distance = np.linalg.norm(rays, axis=1)
        hits = scene.caster.cast(origin, rays / distance[:, None], time_s)
        visible &= hits.body == len(scene.bodies) - 1
        in_view[index] = visible.sum() >= 0.4 * towards.sum()
    return in_view


def own_axes(scene: Scene) -> FloatArray:
    """Return the transform, shape (4, 4), from the scanner's own axes to the sensor's frame; identity for a camera."""
    if isinstance(scene.sensor, StereoCamera):
        return np.eye(4)
    return rigid(forward_left_up(scene.axes).T, np.zeros(3))


def _drawn(draw: Draw, sensor_kind: SensorKind, factors: Factors) -> Scene | None:
    kind, layout = _drive_and_layout(draw, factors)
    uneven = draw.given(factors.uneven, "uneven", lambda rng: float(rng.uniform(0.0, 1.0)))
    land = draw.given(factors.land, "land", lambda rng: float(rng.uniform(0.0, 1.0)))
    verges = draw.choice(factors.verges, "verges", (False, True), (0.75, 0.25))
    road = draw_road(draw.rng("road"), layout, uneven, land, verges=verges)
    usual = _sensor(draw, sensor_kind, factors)
    sensor = usual if factors.frame_rate_hz is None else usual.at_rate(factors.frame_rate_hz)
    mounted = _mount(draw, factors, road_free=lambda xy: not road.on_carriageway(xy).any(), sensor=sensor)
    if mounted is None:
        return None
    T_world_sensor, axes = mounted
    density = draw.given(factors.density, "density", lambda rng: float(rng.uniform(0.2, 1.0)))
    site = build_site(draw.rng("site"), road, [tuple(T_world_sensor[:2, 3].tolist())], density)
    parked = draw.given(factors.parked, "parked", lambda rng: int(rng.integers(0, 4)))
    site = replace(site, bodies=(*site.bodies, *park(draw.rng("park"), road, parked)))

    share = usual.period_s / sensor.period_s
    frames = draw.given(factors.frames, "frames", lambda rng: round(int(rng.integers(90, 121)) * share))
    times = 0.02 + sensor.period_s * np.arange(frames, dtype=np.float64)
    left_hand = draw.choice(factors.left_hand, "left hand", (False, True), (0.8, 0.2))
    vehicle = _vehicle(draw, factors)
    middle_s = float(times.mean() + draw.rng("middle").normal(0.0, 0.5))
    drive = place_drive(draw.rng("drive"), kind, road, vehicle, factors.speed_mps, middle_s, left_hand)
    sender = vehicle_mover("sender", vehicle, drive, road)
    counts = (
        draw.given(factors.vehicles, "vehicles", lambda rng: int(rng.choice(6, p=[0.3, 0.25, 0.2, 0.15, 0.06, 0.04]))),
        draw.given(factors.walkers, "walkers", lambda rng: int(rng.integers(0, 4))),
        draw.given(factors.cyclists, "cyclists", lambda rng: int(rng.integers(0, 2))),
    )
    others = draw_traffic(draw.rng("traffic"), road, sender, counts, times, left_hand, factors.near_m)
    way = sender.track(times)[0]
    site = replace(site, bodies=(*site.bodies, *shrubs(draw.rng("shrubs"), road, way, factors.shrubs)))
    place = draw.choice(None, "place", PLACES)
    if factors.place is not None:
        place = next(known for known in PLACES if known.name == factors.place)
    place = replace(place, yaw_rad=float(draw.rng("yaw").uniform(-np.pi, np.pi)))
    flaws = _cam_flaws(draw, factors)
    stations = draw.given(factors.stations, "stations", lambda rng: int(rng.integers(0, 3)))
    return Scene(
        seed=draw.seed,
        sensor_kind=sensor_kind,
        factors=factors,
        place=place,
        site=site,
        vehicle=vehicle,
        sender=sender,
        others=others,
        sensor=sensor,
        axes=axes,
        T_world_sensor=T_world_sensor,
        times_s=times,
        messages=_messages(draw, factors, sender, vehicle, others, stations, place, flaws, times),
        cam_flaws=flaws,
        lidar_flaws=_lidar_flaws(draw, factors, sensor),
        stereo_flaws=_stereo_flaws(draw, factors),
        drive_kind=kind,
        in_view=np.zeros(frames, dtype=bool),
    )


def _drive_and_layout(draw: Draw, factors: Factors) -> tuple[DriveKind, LayoutKind]:
    pairs = [
        (kind, layout)
        for kind in (DRIVES if factors.drive is None else get_args(DriveKind))
        for layout in LAYOUTS
        if possible(layout, kind) and factors.drive in (None, kind) and factors.layout in (None, layout)
    ]
    if not pairs:
        raise SceneError(f"a drive {factors.drive!r} does not fit a layout {factors.layout!r}; needed are two that do")
    # Each drive is equally likely, however many layouts it fits.
    kind = draw.choice(None, "drive kind", sorted({kind for kind, _ in pairs}))
    return kind, draw.choice(None, "layout", [layout for own, layout in pairs if own == kind])


def _vehicle(draw: Draw, factors: Factors) -> Vehicle:
    weights = (0.2, 0.17, 0.2, 0.18, 0.13, 0.05, 0.03, 0.02, 0.02)
    return draw_vehicle(draw.rng("vehicle"), draw.choice(factors.vehicle, "vehicle kind", KINDS, weights))


def _sensor(draw: Draw, kind: SensorKind, factors: Factors) -> Lidar | StereoCamera:
    for name in get_args(StereoName):
        if kind == name:
            in_widths = draw.given(None, "focal", lambda rng: float(rng.uniform(800.0, 1500.0))) / WIDTH_PX
            focal_px = in_widths * factors.width_px if factors.focal_px is None else factors.focal_px
            camera = stereo_camera(name, focal_px, factors.width_px)
            return replace(
                camera,
                focal_error=factors.focal_error,
                baseline_error=factors.baseline_error,
                turned_deg=factors.turned_deg,
                apart_s=factors.apart_s,
            )
    scanner = lidar(next(name for name in LIDARS if name == kind))
    if factors.begin_deg != 180.0:
        scanner = scanner.beginning(factors.begin_deg)
    return scanner.turning(draw.choice(factors.turning, "turning", TURNINGS, (0.6, 0.2, 0.2)))


def _mount(
    draw: Draw, factors: Factors, road_free: Callable[[FloatArray], bool], sensor: Lidar | StereoCamera
) -> tuple[FloatArray, Axes] | None:
    """Draw a pose beside the road, looking roughly at the middle of the crossing; None if no free place is found."""
    rng = draw.rng("mount")
    height = draw.given(factors.height_m, "height", lambda rng: float(rng.uniform(3.0, 15.0)))
    away = draw.given(factors.away_m, "away", lambda rng: float(rng.uniform(max(8.0, 1.2 * height), 30.0)))
    circle = np.linspace(0.0, 2 * np.pi, 12, endpoint=False)
    around = 0.6 * np.column_stack([np.cos(circle), np.sin(circle)])
    for _ in range(60):
        angle = rng.uniform(-np.pi, np.pi)
        xy = away * np.array([np.cos(angle), np.sin(angle)])
        if road_free(xy + around):
            break
    else:
        return None
    target = rng.normal(0.0, 3.0, 2)
    yaw = float(np.arctan2(*(target - xy)[::-1]))
    # The middle of the field of view looks at the middle of a car.
    down = float(np.degrees(np.arctan2(height - 0.8, np.linalg.norm(target - xy)))) + rng.normal(0.0, 2.0)
    if isinstance(sensor, Lidar):
        _, low, high = sensor.field_rad
        down += float(np.degrees(low + high)) / 2
        if sensor.field_rad[0] > 3.0:
            down = float(rng.uniform(0.0, max(down, 0.0)))
    tilt = float(np.clip(down, 0.0, 35.0)) if factors.tilt_deg is None else factors.tilt_deg
    roll = draw.given(factors.roll_deg, "roll", lambda rng: float(rng.normal(0.0, 1.5)))
    R = rotation_z(yaw) @ rotation_y(np.radians(tilt)) @ _rolled(np.radians(roll))
    hanging = draw.choice(factors.hanging, "hanging", tuple(HANGINGS), (0.7, 0.1, 0.1, 0.1))
    axes = OPENCV_AXES if isinstance(sensor, StereoCamera) else HANGINGS[hanging]
    return rigid(R @ forward_left_up(axes), np.append(xy, height)), axes


def _rolled(roll_rad: float) -> FloatArray:
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _cam_flaws(draw: Draw, factors: Factors, whose: str = "") -> CamFlaws:
    """Draw the flaws of a station's messages; ``whose`` names the random streams of stations other than the sender."""
    lever = factors.lever_sigma_m * draw.rng(f"lever{whose}").normal(size=2)
    clock_s = draw.given(factors.clock_offset_s, "clock", lambda rng: float(rng.normal(0.0, 0.005)))
    stamping_s = float(draw.rng(f"stamping{whose}").normal(0.0, factors.stamping_s)) if whose else 0.0
    return CamFlaws(
        receiver=factors.receiver,
        rate_hz=draw.choice(factors.cam_rate_hz, f"rate{whose}", (10.0, 5.0, 0.0, 2.0), (0.4, 0.2, 0.3, 0.1)),
        loss=draw.choice(factors.loss, f"loss{whose}", (0.0, 0.05, 0.2), (0.5, 0.3, 0.2)),
        clock_offset_s=clock_s + stamping_s,
        heading_sigma_deg=draw.given(
            factors.heading_sigma_deg, f"heading{whose}", lambda rng: float(rng.uniform(0.1, 0.5))
        ),
        heading_of=draw.choice(factors.heading_of, f"heading of{whose}", ("body", "front"), (0.7, 0.3)),
        heading_lag_s=factors.heading_lag_s,
        quantised=factors.quantised,
        rounding=draw.choice(factors.rounding, f"rounding{whose}", ("nearest", "up"), (0.5, 0.5)),
        over_mirrors=draw.choice(factors.over_mirrors, f"over mirrors{whose}", (False, True), (0.85, 0.15)),
        lever_m=(float(lever[0]), float(lever[1])),
    )


def _messages(
    draw: Draw,
    factors: Factors,
    sender: Mover,
    vehicle: Vehicle,
    others: tuple[Mover, ...],
    stations: int,
    place: Place,
    flaws: CamFlaws,
    times_s: FloatArray,
) -> CamLog:
    span = (float(times_s[0]) - 1.5, float(times_s[-1]) + 1.5)
    logs = [cam_log(sender, place, flaws, span, STATION, vehicle.mirror_width_m, draw.rng("cam"))]
    for number, mover in enumerate(_talking(others)[:stations], start=1):
        its, rng = _cam_flaws(draw, factors, f" {number}"), draw.rng(f"cam {number}")
        logs.append(cam_log(mover, place, its, span, STATION + number, mover.width_m + 0.3, rng))
    return together(logs)


def _talking(others: Sequence[Mover]) -> list[Mover]:
    """Return the other vehicles in the order in which they become stations."""
    return [mover for mover in others if mover.name.startswith("other_vehicle")]


def _lidar_flaws(draw: Draw, factors: Factors, sensor: Lidar | StereoCamera) -> LidarFlaws:
    sigma = factors.noise * sensor.range_sigma_m if isinstance(sensor, Lidar) else 0.0
    return LidarFlaws(
        noise=factors.noise,
        rain=draw.choice(factors.rain, "rain", (0.0, 0.001, 0.005), (0.8, 0.1, 0.1)),
        point_times=draw.choice(factors.point_times, "point times", (True, False), (0.85, 0.15)),
        bias_m=factors.systematic * float(draw.rng("bias").normal(0.0, 0.25)) * sigma,
        layer_sigma_m=factors.systematic * 0.25 * sigma,
    )


def _stereo_flaws(draw: Draw, factors: Factors) -> StereoFlaws:
    return StereoFlaws(
        noise=factors.noise,
        lasting=draw.given(factors.lasting, "lasting", lambda rng: float(rng.uniform(0.3, 0.9))),
        offset_px=factors.systematic * float(draw.rng("offset").normal(0.0, 0.04)),
        bleed_px=draw.given(factors.bleed_px, "bleed", lambda rng: float(rng.uniform(0.5, 2.0))),
        gross=draw.given(factors.gross, "gross", lambda rng: float(rng.uniform(0.0, 2.0))),
        gloss_px=draw.given(factors.gloss_px, "gloss", lambda rng: float(rng.uniform(0.0, 0.6))),
    )


@dataclass
class Recorded:
    """The recording of a scene's sensor (implements `PointCloudSource`); each frame is simulated once and kept.

    A LiDAR's scans go through the same adapter as a user's, with its estimates of noise, field of view and edges.
    """

    scene: Scene
    _frames: dict[int, Scan | Matched] = field(default_factory=dict)

    @property
    def axes(self) -> Axes:
        """Where forward and up are in the sensor frame."""
        return self.scene.axes

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last stamp."""
        return int(self.scene.stamps_ns[0]), int(self.scene.stamps_ns[-1])

    def __len__(self) -> int:
        return len(self.scene.times_s)

    def __iter__(self) -> Iterator[PointCloud]:
        if isinstance(self.scene.sensor, Lidar):
            return iter(self._adapter)
        return (self._cloud(index, whole=False) for index in range(len(self)))

    def survey(self) -> Iterator[PointCloud]:
        """Yield some whole frames: of a camera, those with the fewest moving points and others spread over time."""
        if isinstance(self.scene.sensor, Lidar):
            return self._adapter.survey()
        ranked = sorted(range(len(self)), key=lambda index: int(self._matched(index).moving.sum()))
        return (self._cloud(index, whole=True) for index in surveyed(ranked, ranked))

    @cached_property
    def _adapter(self) -> PointCloudSource:
        settings = LidarSettings(axes=self.scene.axes, workers=1)
        return LidarRecording(SimulatedScans(self), settings)

    def scan(self, index: int) -> Scan:
        """Return a LiDAR's scan."""
        if index not in self._frames:
            self._frames[index] = _scan(self.scene, index)
        scan = self._frames[index]
        assert isinstance(scan, Scan)
        return scan

    @cached_property
    def _mounted(self) -> Mounted:
        camera = self.scene.sensor
        assert isinstance(camera, StereoCamera)
        return Mounted(camera, self.scene.caster, self.scene.T_world_sensor)

    def _matched(self, index: int) -> Matched:
        if index not in self._frames:
            scene = self.scene
            time_s = float(scene.times_s[index])
            self._frames[index] = match_frame(self._mounted, scene.stereo_flaws, time_s, (scene.seed, index))
        matched = self._frames[index]
        assert isinstance(matched, Matched)
        return matched

    def _cloud(self, index: int, whole: bool) -> PointCloud:
        matched = self._matched(index)
        assert isinstance(self.scene.sensor, StereoCamera)
        where = np.ones_like(matched.moving) if whole else matched.moving
        return reproject(self.scene.sensor, int(self.scene.stamps_ns[index]), matched, where)


def _scan(scene: Scene, index: int) -> Scan:
    swept = swept_frame(scene, index)
    points = transform(own_axes(scene), swept.points)
    return Scan(points, swept.intensity, swept.offset_s if scene.lidar_flaws.point_times else None)


def swept_frame(scene: Scene, index: int) -> Swept:
    """Simulate a LiDAR's frame; the points are in the scanner's own axes."""
    assert isinstance(scene.sensor, Lidar)
    T_world_own = scene.T_world_sensor_at(float(scene.times_s[index])) @ own_axes(scene)
    first_s = float(scene.times_s[0])
    return sweep(scene.sensor, scene.lidar_flaws, scene.caster, T_world_own, index, scene.seed, first_s)


@dataclass
class SimulatedScans:
    """The scans of a scene, as the LiDAR adapter reads them (implements `ScanSequence`)."""

    recorded: Recorded
    path: Path = Path("simulated")
    skipped: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def stamps_ns(self) -> IntArray:
        """Stamps of the scans, nanoseconds, shape (n,)."""
        return self.recorded.scene.stamps_ns

    def __len__(self) -> int:
        return len(self.recorded)

    def read(self, indices: Sequence[int], threads: int) -> Iterator[Scan | None]:  # noqa: ARG002
        """Yield the scans at these indices."""
        return map(self.recorded.scan, indices)
