"""Drives made by hand: points on the outline of a vehicle, seen from a sensor at the origin of the level frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from laci_stereo.core.cloud import Cameras
from laci_stereo.core.estimation.evidence import Evidence
from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from tests.simulated import Drive

SIZE = (4.6, 1.8)
CORNERS = np.array(SIZE) / 2 * np.array([(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)])
HEIGHT_M = 6.0
ENDS_SEEN_M, SIDES_SEEN_M = 0.55, 0.63
"""So high are the points: below the edges of bonnet and boot, and where a car's sides are hardly drawn in."""

TRUTH = PlanarMatch(0.7, np.array([-30.0, 12.0]))
TURN = Drive((-20.0, 30.0), -60.0, ((22.0, 0.0), (12.0, 80.0)), ((0.0, 8.0), (4.0, 5.0), (8.0, 9.0)))
CIRCLE, ROUNDABOUT = (Drive((-16.0, 50.0), -60.0, ((200.0, turn_deg),), start_s=-4.0) for turn_deg in (300.0, 600.0))
"""Even turns of 38 and 19 m, on which the clocks' offset is told by nothing but its prior."""

CAMERAS = Cameras(np.array([0.0, -0.5, 0.0]), np.array([0.96, 0.0, -0.28]))
"""A stereo camera that looks down by 16 deg."""

STRAIGHT = Drive((-20.0, 30.0), -60.0, speeds=((0.0, 7.0),))
BRAKING = Drive((-20.0, 30.0), -60.0, speeds=((0.0, 9.0), (5.0, 5.0)))


@dataclass(frozen=True)
class Stopping(Drive):
    """A drive that brakes before its third second, stands, and goes on as it would have."""

    stop_s: float = 0.0

    def at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        begin, end, brake_s = 2.0, 4.0 + self.stop_s, 2.0
        braking, starting = (np.clip((times_s - since) / brake_s, 0.0, 1.0) for since in (begin, end))
        gone_s = np.minimum(times_s, begin) + brake_s * (braking - braking**2 / 2 + starting**2 / 2)
        return super().at(gone_s + np.maximum(times_s - end - brake_s, 0.0))


def stopping(drive: Drive, stop_s: float) -> Stopping:
    return Stopping(drive.start, drive.yaw_deg, drive.legs, drive.speeds, drive.start_s, stop_s)


def rectangle_points(origin: FloatArray, count: int, rng: np.random.Generator) -> FloatArray:
    """Return points, shape (count, 2), where random lines of sight from ``origin`` meet the rectangle of `SIZE`."""
    half = np.array(SIZE) / 2
    target = rng.uniform(-half, half, (count, 2))
    ray = target - origin
    enter = np.max(np.minimum((-half - origin) / ray, (half - origin) / ray), axis=1)
    points: FloatArray = origin + ray * enter[:, None]
    return points


def evidence(
    drive: Drive = TURN,
    seed: int = 0,
    sigma_m: float = 0.02,
    offset_s: float = 0.0,
    per_frame: int = 40,
    last_s: float = 6.0,
    behind: float = 0.0,
    bias_m: tuple[float, float] = (0.0, 0.0),
    reference: tuple[float, float] = (0.0, 0.0),
) -> Evidence:
    """Return a drive whose sensor's stamps are ``offset_s`` early; a share ``behind`` of the points lies inside.

    The vehicle's outline is the plain rectangle; the noise is along the line of sight from `HEIGHT_M` above the ground.
    """
    rng = np.random.default_rng(seed)
    stamps = np.arange(0.5, last_s, 0.1)
    xy, yaw = drive.at(stamps + offset_s)
    middles, points = [], []
    for at, angle in zip(xy, yaw, strict=True):
        origin = rotate_xy(-angle, TRUTH.shift - at)
        hit = rectangle_points(origin, per_frame, rng)
        world = rotate_xy(angle, hit) + at
        level = rotate_xy(-TRUTH.yaw_rad, world - TRUTH.shift)
        far = np.linalg.norm(level, axis=1, keepdims=True)
        deeper = np.where(rng.random((per_frame, 1)) < behind, rng.exponential(0.8, (per_frame, 1)), 0.0)
        longer = 1.0 + (sigma_m * rng.normal(size=(per_frame, 1)) + deeper) / far
        middles.append(np.median(level * longer, axis=0))
        at_end = np.isclose(np.abs(hit[:, :1]), SIZE[0] / 2)
        seen_m = np.where(at_end, ENDS_SEEN_M, SIDES_SEEN_M)
        points.append(np.hstack([level * longer, HEIGHT_M + (seen_m - HEIGHT_M) * longer]))
    return Evidence(
        stamps_s=stamps,
        middles=np.array(middles),
        lacking_m=np.zeros((len(stamps), 2)),
        points=np.concatenate(points),
        frame=np.repeat(np.arange(len(stamps)), per_frame),
        sigma_along_m=np.full(len(stamps) * per_frame, sigma_m),
        sigma_across_m=np.full(len(stamps) * per_frame, 0.003),
        sigma_z_m=np.full(len(stamps) * per_frame, 0.005),
        height_m=HEIGHT_M,
        vehicle=told(drive, last_s, bias_m, reference),
        borders=np.full((len(stamps), 2, 3), np.nan),
        begins_rad=np.full(len(stamps), np.pi),
    )


def with_borders(
    seen: Evidence,
    drive: Drive = TURN,
    window_rad: float = 0.01,
    growth: tuple[float, float] = (0.0, 0.0),
    sigma: float = 0.0,
    seed: int = 0,
) -> Evidence:
    """Return a camera's evidence: the borders, right and left, have grown by so many windows, with noise."""
    xy, yaw = drive.at(seen.stamps_s)
    world = np.stack([rotate_xy(angle, CORNERS) + at for at, angle in zip(xy, yaw, strict=True)])
    level = rotate_xy(-TRUTH.yaw_rad, world.reshape(-1, 2) - TRUTH.shift).reshape(world.shape)
    middle = np.arctan2(*seen.middles.T[::-1])[:, None]
    beside = (np.arctan2(level[:, :, 1], level[:, :, 0]) - middle + np.pi) % (2 * np.pi) - np.pi
    outermost = np.column_stack([beside.min(axis=1), beside.max(axis=1)])
    off = np.array(growth) + sigma * np.random.default_rng([seed, 5]).normal(size=outermost.shape)
    bearing = middle + outermost + window_rad * off * (-1.0, 1.0)
    far = np.linalg.norm(seen.middles, axis=1)[:, None]
    borders = np.stack([far * np.cos(bearing), far * np.sin(bearing), np.full(bearing.shape, 0.5)], axis=2)
    return replace(seen, window_rad=window_rad, borders=borders)


def untriggered(seen: Evidence, apart_s: float, drive: Drive = TURN) -> Evidence:
    """Return what `CAMERAS` measure by disparity if the right images are that much later than the left ones."""
    eye, right, ahead = np.array([0.0, 0.0, HEIGHT_M]), CAMERAS.baseline_m / 0.5, CAMERAS.ahead
    points = []
    for frame, (now, later) in enumerate(zip(*(_poses(seen, drive, s) for s in (0.0, apart_s)), strict=True)):
        left = seen.points[seen.frame == frame] - eye
        body = rotate_xy(-now[2], left[:, :2] - now[:2])
        moved = np.column_stack([rotate_xy(later[2], body) + later[:2], left[:, 2]]) - CAMERAS.baseline_m
        shift = left @ right / (left @ ahead) - moved @ right / (moved @ ahead)
        points.append(eye + left * (0.5 / shift / (left @ ahead))[:, None])
    return replace(seen, points=np.concatenate(points), cameras=CAMERAS)


def _poses(seen: Evidence, drive: Drive, after_s: float) -> FloatArray:
    """Return the vehicle's pose x, y, yaw in the level frame some time after each frame, shape (m, 3)."""
    xy, yaw = drive.at(seen.stamps_s + after_s)
    return np.column_stack([rotate_xy(-TRUTH.yaw_rad, xy - TRUTH.shift), yaw - TRUTH.yaw_rad])


def told(
    drive: Drive,
    last_s: float,
    bias_m: tuple[float, float] = (0.0, 0.0),
    reference: tuple[float, float] = (0.0, 0.0),
) -> VehicleTrack:
    stamps = np.arange(-2.0, last_s + 2.0, 0.1)
    xy, yaw = drive.at(stamps)
    return VehicleTrack(stamps, 0, xy + np.array(bias_m), yaw, *SIZE, reference)


def without_messages(vehicle: VehicleTrack, first_s: float, last_s: float) -> VehicleTrack:
    """Return a track that lost its messages between two times."""
    kept = (vehicle.stamps_s <= first_s) | (vehicle.stamps_s >= last_s)
    return replace(vehicle, stamps_s=vehicle.stamps_s[kept], xy=vehicle.xy[kept], yaw_rad=vehicle.yaw_rad[kept])


def boxed(seen: Evidence, centres: FloatArray) -> Evidence:
    """Return what a detector tells that gives boxes with such centres, level, in the same frames."""
    per_point = ("points", "frame", "sigma_along_m", "sigma_across_m", "sigma_z_m")
    return replace(seen, middles=centres, **{name: getattr(seen, name)[:0] for name in per_point})


def lasting(xy: FloatArray, over_m: float, rng: np.random.Generator, columns: int = 1) -> FloatArray:
    """Return errors with a variance of 1 that decay over so much of a way, shape (m, columns)."""
    way = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1)))
    alike = np.exp(-np.abs(way[:, None] - way) / over_m) + 1e-9 * np.eye(len(way))
    errors: FloatArray = np.linalg.cholesky(alike) @ rng.normal(size=(len(way), columns))
    return errors


def lacking(drive: Evidence, first_s: float, last_s: float) -> Evidence:
    """Return what a drive tells whose messages between two times were lost."""
    vehicle = without_messages(drive.vehicle, first_s, last_s)
    return replace(drive.of_frames(vehicle.at(drive.stamps_s)[2]), vehicle=vehicle)
