"""Synthetic roads as a stereo camera or a LiDAR on a pole sees them: rays cast at boxes, with the truth beside them.

Scene frame: z up, the ground at z = 0, the sensor above the origin and looking along +x before it is tilted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from laci_stereo.core.frames import FORWARD_LEFT_UP_AXES, OPENCV_AXES, Axes, BoolArray, FloatArray
from laci_stereo.core.ground.uneven import CLASS_B_M, REACH_M

MAX_RANGE_M = 80.0
ABOVE_GROUND_SHARE = 0.6
MATCHING_WINDOW_PX = 11
LONGEST_WAVE_M = 10.0
# Camera axes in forward-left-up axes: x right, y down, z forward.
R_FLU_OPENCV = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class GroundScene:
    """Points with their noise, and the plane that is the ground."""

    points: FloatArray
    sigma_along_m: FloatArray
    sigma_across_m: FloatArray
    axes: Axes
    normal: FloatArray
    height_m: float
    tilt_deg: float

    @property
    def up(self) -> tuple[float, float, float]:
        return self.axes.up


@dataclass(frozen=True)
class Boxes:
    """Upright boxes: centre xy, yaw, half lengths, and lower and upper end."""

    xy: FloatArray
    yaw: FloatArray
    half: FloatArray
    z: FloatArray


@dataclass(frozen=True)
class Pattern:
    """A sensor's rays in its own frame, and the noise of what they measure.

    For a stereo camera ``relative`` is sigma_disparity / (focal * baseline) [1/m], so that sigma_depth = relative *
    depth^2; for a LiDAR it is 0.
    """

    directions: FloatArray
    block: np.ndarray
    axes: Axes
    relative: float
    constant_m: float
    bearing_rad: float


@dataclass(frozen=True)
class Road:
    """Plane waves and a crown about z = 0, all of mean zero.

    ``wave_m`` has the shape (k,), ``wave_radpm`` (k, 2) has each wave's number as a vector, ``wave_phase`` (k,) is in
    turns. The road rises and falls by ``crown_m`` about its mean between each crown and the gutters ``fall_m`` beside
    it; crowns run along x.
    """

    wave_m: FloatArray
    wave_radpm: FloatArray
    wave_phase: FloatArray
    crown_m: float = 0.0
    fall_m: float = 1.0
    crown_phase: float = 0.0

    def height(self, xy: FloatArray) -> FloatArray:
        wave = np.sin(xy @ self.wave_radpm.T + 2.0 * np.pi * self.wave_phase) @ self.wave_m
        to_gutter = np.abs((xy[:, 1] / self.fall_m + 2.0 * self.crown_phase) % 2.0 - 1.0)
        height: FloatArray = wave + self.crown_m * (1.0 - 2.0 * to_gutter)
        return height


FLAT_ROAD = Road(np.zeros(0), np.zeros((0, 2)), np.zeros(0))


def wavy_road(seed: int) -> Road:
    """Draw a road with waves up to 1.5 cm high and 3 to 10 m long, and a crown of up to as much."""
    rng = np.random.default_rng([seed, 1])
    direction, length_m = rng.uniform(0.0, np.pi), rng.uniform(3.0, LONGEST_WAVE_M)
    return Road(
        wave_m=rng.uniform(0.0, 0.015, 1),
        wave_radpm=2.0 * np.pi / length_m * np.array([[np.cos(direction), np.sin(direction)]]),
        crown_m=float(rng.uniform(0.0, 0.015)),
        fall_m=float(rng.uniform(3.5, 7.0)),
        wave_phase=rng.uniform(size=1),
        crown_phase=float(rng.uniform()),
    )


def rough_road(seed: int) -> Road:
    """Draw a random field of waves of all lengths: a paved road of class A to C by ISO 8608.

    The field has the covariance u^2 exp(-distance / l), see `laci_stereo.core.ground.uneven`. In two dimensions its
    waves' numbers k have the density k l^2 / (1 + (k l)^2)^1.5, of which 1 - 1 / sqrt(1 + (k l)^2) lie below k.
    """
    rng = np.random.default_rng([seed, 2])
    waves = 100
    rms_m = CLASS_B_M * 2.0 ** rng.uniform(-1.0, 1.0)
    # As many waves in each part of the spectrum; those below 1 m make no difference to a plane.
    below = (np.arange(waves) + rng.uniform(size=waves)) / waves
    number = np.minimum(np.sqrt((1.0 - below) ** -2 - 1.0) / REACH_M, 2.0 * np.pi)
    direction = rng.uniform(0.0, 2.0 * np.pi, waves)
    return Road(
        wave_m=np.full(waves, rms_m * np.sqrt(2.0 / waves)),
        wave_radpm=number[:, None] * np.column_stack([np.cos(direction), np.sin(direction)]),
        wave_phase=rng.uniform(size=waves),
    )


def ground_scene(
    seed: int,
    kind: str,
    tilt_deg: float | None = None,
    height_m: float | None = None,
    rays: int = 20_000,
    pavements: bool = True,
    road: Road = FLAT_ROAD,
) -> GroundScene:
    """Draw a scene; ``kind`` is ``stereo`` or ``lidar``; tilt and height are drawn too where they are not given."""
    rng = np.random.default_rng(seed)
    tilt_deg = float(rng.uniform(0.0, 35.0)) if tilt_deg is None else tilt_deg
    height_m = float(rng.uniform(3.0, 15.0)) if height_m is None else height_m
    R = _mounting(tilt_deg, float(rng.uniform(-3.0, 3.0)))
    pattern, R = _sensor(rng, kind, R, tilt_deg, height_m, rays)
    directions = pattern.directions @ R.T
    # Crowded streets, but a sensor hangs where it sees road: enough of it, and as deep a piece as the sensor is high.
    for attempt in range(40):
        objects = _objects(rng, directions, height_m, 0.95**attempt, pavements)
        distance, ground = _cast(directions, height_m, objects, road)
        depth = np.quantile(distance[ground], [0.05, 0.95]) if ground.any() else np.zeros(2)
        enough = np.count_nonzero(ground) > (1 - ABOVE_GROUND_SHARE) * np.count_nonzero(np.isfinite(distance))
        if enough and depth[1] - depth[0] > height_m:
            break
    else:
        raise AssertionError(f"scene {seed} never shows enough road")
    seen = np.isfinite(distance)
    hits = np.where(seen[:, None], directions * np.where(seen, distance, 0.0)[:, None], np.inf)
    keep = seen & ~_holes(rng, hits, ground)
    return _measure(rng, pattern, keep, distance, R, height_m, tilt_deg)


def with_shared_error(scene: GroundScene, deviations: float) -> GroundScene:
    """Return the scene with 1 / range off for all points alike, by so many standard deviations of each.

    For a stereo camera that is a bias of the disparity, for a LiDAR an offset of the range.
    """
    ranges = np.linalg.norm(scene.points, axis=1)
    # First order in 1 / range: what it pushes beyond infinity a sensor does not report.
    stretch = 1.0 / (1.0 + deviations * scene.sigma_along_m / ranges)
    seen = (stretch > 0.0) & (stretch * ranges < 1.5 * MAX_RANGE_M)
    return replace(
        scene,
        points=(scene.points * stretch[:, None])[seen],
        sigma_along_m=scene.sigma_along_m[seen],
        sigma_across_m=scene.sigma_across_m[seen],
    )


def walls_only(seed: int, kind: str) -> GroundScene:
    """Return a facing and an oblique wall, down to their feet on a road that gives no points."""
    rng = np.random.default_rng(seed)
    height_m, tilt_deg = 6.0, 15.0
    R = _mounting(tilt_deg, 1.0)
    pattern, R = _sensor(rng, kind, R, tilt_deg, height_m, 20_000)
    directions = pattern.directions @ R.T
    walls = Boxes(
        xy=np.array([[20.0, 0.0], [12.0, 12.0]]),
        yaw=np.array([0.0, rng.uniform(0.3, 1.0)]),
        half=np.array([[0.2, 40.0], [25.0, 0.2]]),
        z=np.array([[0.0, 25.0], [0.0, 25.0]]),
    )
    distance, ground = _cast(directions, height_m, walls, FLAT_ROAD)
    return _measure(rng, pattern, np.isfinite(distance) & ~ground, distance, R, height_m, tilt_deg)


def _mounting(tilt_deg: float, roll_deg: float) -> FloatArray:
    """Rotation from forward-left-up sensor axes into the scene: roll about forward, then pitch down."""
    t, r = np.radians([tilt_deg, roll_deg])
    pitch = np.array([[np.cos(t), 0.0, np.sin(t)], [0.0, 1.0, 0.0], [-np.sin(t), 0.0, np.cos(t)]])
    roll = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(r), -np.sin(r)], [0.0, np.sin(r), np.cos(r)]])
    R: FloatArray = pitch @ roll
    return R


def _sensor(
    rng: np.random.Generator, kind: str, R: FloatArray, tilt_deg: float, height_m: float, rays: int
) -> tuple[Pattern, FloatArray]:
    """Return a pattern and the rotation from its frame into the scene."""
    if kind == "stereo":
        return _stereo_pattern(rng, tilt_deg, height_m, rays), R @ R_FLU_OPENCV
    return _lidar_pattern(rng, R, height_m, rays), R


def _stereo_pattern(rng: np.random.Generator, tilt_deg: float, height_m: float, rays: int) -> Pattern:
    width, height = 1280, 960
    # A camera that hardly looks down has a wide lens: the picture begins no farther away than twice its height.
    below_axis = np.radians(max(np.degrees(np.arctan(1 / 2)) - tilt_deg, 1.0))
    focal_px = rng.uniform(700.0, min(1500.0, height / 2 / np.tan(below_axis)))
    # Who looks down from higher needs more base for the same depth: a tenth of the height, in the range sold.
    baseline_m = np.clip(height_m * rng.uniform(0.07, 0.13), 0.3, 1.0)
    sigma_px = rng.uniform(0.2, 0.3)
    step = np.sqrt(width * height / rays)
    v, u = (a.ravel() for a in np.meshgrid(np.arange(0, height, step), np.arange(0, width, step), indexing="ij"))
    directions = np.stack([(u - width / 2) / focal_px, (v - height / 2) / focal_px, np.ones_like(u)], axis=1)
    block = (v // MATCHING_WINDOW_PX).astype(int) * 1000 + (u // MATCHING_WINDOW_PX).astype(int)
    return Pattern(
        directions=directions / np.linalg.norm(directions, axis=1, keepdims=True),
        block=block,
        axes=OPENCV_AXES,
        relative=float(sigma_px / (focal_px * baseline_m)),
        constant_m=0.0,
        bearing_rad=float(0.1 / focal_px),
    )


def _lidar_pattern(rng: np.random.Generator, R: FloatArray, height_m: float, rays: int) -> Pattern:
    layers = int(rng.choice([8, 16, 32, 64]))
    around = np.radians(rng.choice([120.0, 360.0]))
    azimuth = np.linspace(-around / 2, around / 2, rays // layers)
    # A LiDAR is mounted so that some layers reach the road: one that looks over it measures no ground at all.
    while True:
        field = np.radians(rng.uniform(25.0, 80.0))
        middle = np.radians(rng.uniform(-25.0, 5.0))
        elevation = np.linspace(middle - field / 2, middle + field / 2, layers)
        steepness = -(R @ np.stack([np.cos(elevation), np.zeros(layers), np.sin(elevation)]))[2]
        reach = height_m / steepness[steepness > height_m / (0.7 * MAX_RANGE_M)]
        if len(reach) >= 4 and reach.max() > 3.0 * height_m:
            break
    e, a = (x.ravel() for x in np.meshgrid(elevation, azimuth, indexing="ij"))
    return Pattern(
        directions=np.stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)], axis=1),
        block=np.arange(len(e)),
        axes=FORWARD_LEFT_UP_AXES,
        relative=0.0,
        constant_m=float(rng.uniform(0.01, 0.03)),
        bearing_rad=0.001,
    )


def _objects(rng: np.random.Generator, directions: FloatArray, height_m: float, crowd: float, pavements: bool) -> Boxes:
    """Draw walls that stand where the view ends, parked cars, trees, and pavements 10 to 15 cm high."""
    down = np.minimum(directions[:, 2], -1e-9)
    reach = height_m * np.linalg.norm(directions[:, :2], axis=1) / -down
    near = float(np.quantile(reach, 0.02))
    facing = min(float(np.quantile(reach, rng.uniform(0.5, 1.0 - 0.35 * crowd))), 60.0)
    side = rng.uniform(0.5, 1.0) * max(0.6 * facing, 8.0)
    rows = [  # x, y, yaw, half length, half width, z0, z1
        (facing, 0.0, rng.uniform(-0.2, 0.2), 0.2, 60.0, 0.0, rng.uniform(8.0, 30.0)),
        (facing, side, rng.uniform(-0.5, 0.5), 60.0, 0.2, 0.0, rng.uniform(5.0, 20.0)),
    ]
    for sign in (-1, 1):  # pavements along the road
        edge = rng.uniform(0.5, 0.9) * side
        high = rng.uniform(0.10, 0.15) if pavements else 0.0
        wide = rng.uniform(0.75, 1.5)
        rows.append((facing, sign * (edge + wide), 0.0, 100.0, wide, 0.0, high))
    for _ in range(int(crowd * rng.integers(3, 9))):  # cars: body and cabin
        x, y, yaw = rng.uniform(near, facing), rng.uniform(-1.0, 1.0) * side, rng.normal(0.0, 0.3)
        long, wide = rng.uniform(3.8, 5.0) / 2, rng.uniform(1.7, 1.9) / 2
        rows += [(x, y, yaw, long, wide, 0.2, 0.9), (x, y, yaw, 0.55 * long, 0.9 * wide, 0.9, rng.uniform(1.4, 1.9))]
    for _ in range(int(crowd * rng.integers(1, 6))):  # trees: trunk and crown
        x, y = rng.uniform(near + 0.3 * (facing - near), facing), rng.choice([-1, 1]) * rng.uniform(0.4, 1.0) * side
        crown = rng.uniform(1.0, 2.5)
        rows += [(x, y, 0.3, 0.2, 0.2, 0.0, 3.0), (x, y, 0.7, crown, crown, 2.5, rng.uniform(4.0, 9.0))]
    table = np.array(rows)
    # Nothing stands in the sensor's own pole.
    clear = np.hypot(table[:, 0], table[:, 1]) > 1.0 + table[:, 3]
    clear[:4] = True
    table = table[clear]
    return Boxes(table[:, :2], table[:, 2], table[:, 3:5], table[:, 5:])


def _cast(directions: FloatArray, height_m: float, boxes: Boxes, road: Road) -> tuple[FloatArray, BoolArray]:
    """Return the distance to what each ray hits first (inf: nothing in range), and whether that is the ground."""
    distance = _to_road(directions, height_m, road)
    ground = np.isfinite(distance)
    for xy, yaw, half, z in zip(boxes.xy, boxes.yaw, boxes.half, boxes.z, strict=True):
        c, s = np.cos(yaw), np.sin(yaw)
        into = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        d = directions @ into.T
        d = np.where(np.abs(d) < 1e-12, 1e-12, d)
        origin = into @ np.array([-xy[0], -xy[1], height_m])
        low = (np.array([-half[0], -half[1], z[0]]) - origin) / d
        high = (np.array([half[0], half[1], z[1]]) - origin) / d
        enter, leave = np.minimum(low, high).max(axis=1), np.maximum(low, high).min(axis=1)
        hit = (enter < leave) & (enter > 0.0) & (enter < distance)
        distance = np.where(hit, enter, distance)
        ground &= ~hit
    reached = distance < MAX_RANGE_M
    return np.where(reached, distance, np.inf), ground & reached


def _to_road(directions: FloatArray, height_m: float, road: Road) -> FloatArray:
    """Return the distance at which each ray meets the road, inf where it does not."""
    down = np.maximum(-directions[:, 2], 0.0)
    with np.errstate(divide="ignore"):
        distance = height_m / down
        # Nearly every ray within range is steeper than the road, so that each step leaves a part of the error.
        for _ in range(20):
            xy = directions[:, :2] * np.minimum(distance, 2.0 * MAX_RANGE_M)[:, None]
            distance = (height_m - road.height(xy)) / down
    return distance


def _holes(rng: np.random.Generator, hits: FloatArray, ground: BoolArray) -> BoolArray:
    """Return which points of the ground are missing: patches without texture, down to the share that has to be left."""
    missing = np.zeros(len(hits), dtype=bool)
    everything = np.count_nonzero(np.isfinite(hits[:, 0]))
    for _ in range(20):
        centre = hits[rng.choice(np.flatnonzero(ground)), :2]
        across = rng.uniform(0.05, 0.25) * np.linalg.norm(centre) * np.array([3.0, 1.0])
        more = missing | (ground & (np.sum(((hits[:, :2] - centre) / across) ** 2, axis=1) < 1.0))
        above = everything - np.count_nonzero(ground)
        if above <= ABOVE_GROUND_SHARE * (everything - np.count_nonzero(more)):
            missing = more
    return missing


def _measure(
    rng: np.random.Generator,
    pattern: Pattern,
    keep: BoolArray,
    distance: FloatArray,
    R: FloatArray,
    height_m: float,
    tilt_deg: float,
) -> GroundScene:
    """Add the noise: half of a disparity's variance is shared by a block of pixels, as a matcher's window makes it."""
    directions, distance, block = pattern.directions[keep], distance[keep], pattern.block[keep]
    n = len(distance)
    forward = directions @ np.asarray(pattern.axes.forward)
    _, member = np.unique(block, return_inverse=True)
    noise = (rng.normal(size=n) + rng.normal(size=member.max() + 1)[member.reshape(-1)]) / np.sqrt(2.0)
    if pattern.relative > 0.0:
        with np.errstate(divide="ignore"):
            inverse_depth = 1.0 / (distance * forward) + pattern.relative * noise
            measured = np.where(inverse_depth > 0.0, 1.0 / (inverse_depth * forward), np.inf)
    else:
        measured = distance + pattern.constant_m * rng.normal(size=n)
    gross = rng.random(n) < rng.uniform(0.01, 0.03)
    measured[gross] = rng.uniform(1.0, MAX_RANGE_M, size=n)[gross]
    tilted = directions + pattern.bearing_rad * rng.normal(size=(n, 3))
    points = tilted / np.linalg.norm(tilted, axis=1, keepdims=True) * measured[:, None]
    seen = (measured > 0.5) & (measured * forward < MAX_RANGE_M) & (measured < 1.5 * MAX_RANGE_M)
    points, measured, forward = points[seen], measured[seen], forward[seen]
    return GroundScene(
        points=points,
        sigma_along_m=pattern.relative * forward * measured**2 + pattern.constant_m,
        sigma_across_m=pattern.bearing_rad * measured,
        axes=pattern.axes,
        normal=R[2],
        height_m=height_m,
        tilt_deg=tilt_deg,
    )
