"""Compare the box fit with two others: its duration, and its yaw error.

Yaw errors are taken modulo 180 deg. The true yaw is the direction of the longer extent of the points before noise
is added, which is the vehicle's own yaw except where only its front or rear is visible.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, rotate_xy
from laci_stereo.core.tracking.box import fit_box

SHAPES = ("L", "I", "box")
COUNTS = (60, 200, 2000)
FILLS = (0.0, 0.3)


@dataclass(frozen=True)
class Scene:
    """Points on a vehicle, shape (n, 2), the sensor that sees them, and the yaw of their longer extent."""

    xy: FloatArray
    sensor_xy: FloatArray
    yaw_rad: float


@dataclass(frozen=True)
class Score:
    """Medians and the 95th percentile over many scenes."""

    time_ms: float
    yaw_median_deg: float
    yaw_p95_deg: float


def random_size(rng: np.random.Generator) -> FloatArray:
    """Draw length and width, shape (2,): three cars in five, one van and one lorry or bus."""
    kinds = (((3.5, 1.6), (5.2, 2.0)), ((4.8, 1.9), (7.0, 2.2)), ((7.0, 2.3), (12.0, 2.55)))
    low, high = kinds[rng.choice(3, p=(0.6, 0.2, 0.2))]
    size: FloatArray = rng.uniform(low, high)
    return size


def sensor_around(size: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Draw a sensor at a random bearing, 5 to 60 m from the outline, in the vehicle's frame, shape (2,)."""
    bearing = rng.uniform(-math.pi, math.pi)
    direction = np.array([math.cos(bearing), math.sin(bearing)])
    to_outline = float(np.min(size / 2 / np.abs(direction)))
    return direction * (to_outline + rng.uniform(5.0, 60.0))


def visible_sides(size: FloatArray, sensor: FloatArray) -> BoolArray:
    """Return which sides the sensor sees, shape (4,): front, left, rear, right."""
    return np.concatenate([sensor > size / 2, sensor < -size / 2])


def seen_outline(size: FloatArray, sensor: FloatArray, n: int, rng: np.random.Generator) -> FloatArray:
    """Intersect n rays of uniformly distributed bearing with the outline, shape (n, 2)."""
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * size / 2
    rays = corners - sensor
    ahead = math.atan2(-sensor[1], -sensor[0])
    bearings = (np.arctan2(rays[:, 1], rays[:, 0]) - ahead + math.pi) % (2 * math.pi) - math.pi
    bearing = ahead + rng.uniform(bearings.min(), bearings.max(), n)
    direction = np.stack([np.cos(bearing), np.sin(bearing)], axis=-1)
    # Slab test: a ray enters the rectangle where it has crossed the nearer line of both pairs.
    enters = np.min(np.stack([(size / 2 - sensor) / direction, (-size / 2 - sensor) / direction]), axis=0).max(axis=1)
    hits: FloatArray = sensor + enters[:, None] * direction
    return hits


def points_on_side(side: int, size: FloatArray, n: int, rng: np.random.Generator) -> FloatArray:
    """Distribute points uniformly over one side, shape (n, 2)."""
    axis, sign = side % 2, 1 if side < 2 else -1
    xy = rng.uniform(-0.5, 0.5, (n, 2)) * size
    xy[:, axis] = sign * size[axis] / 2
    return xy


def outline(shape: str, size: FloatArray, sensor: FloatArray, n: int, rng: np.random.Generator) -> FloatArray:
    """Place n points on the sides that the shape has, shape (n, 2)."""
    if shape == "L":
        return seen_outline(size, sensor, n, rng)
    if shape == "I":
        return points_on_side(int(rng.choice(np.flatnonzero(visible_sides(size, sensor)))), size, n, rng)
    per_side = rng.multinomial(n, size[[1, 0, 1, 0]] / (2 * size.sum()))
    return np.concatenate([points_on_side(side, size, k, rng) for side, k in enumerate(per_side)])


def make_scene(shape: str, n: int, fill: float, sigma_m: float, rng: np.random.Generator) -> Scene:
    """Draw a vehicle, a sensor and n points, a fraction of them inside the vehicle."""
    size = random_size(rng)
    sensor = sensor_around(size, rng)
    while shape == "L" and visible_sides(size, sensor).sum() < 2:
        sensor = sensor_around(size, rng)
    inside = round(fill * n)
    xy = np.concatenate([outline(shape, size, sensor, n - inside, rng), rng.uniform(-0.5, 0.5, (inside, 2)) * size])
    extent = np.ptp(xy, axis=0)
    yaw = rng.uniform(-math.pi, math.pi)
    place = rng.uniform(-50.0, 50.0, 2)
    noisy = rotate_xy(yaw, xy) + place + rng.normal(0.0, sigma_m, xy.shape)
    longer = yaw if extent[0] >= extent[1] else yaw + math.pi / 2
    return Scene(noisy, rotate_xy(yaw, sensor) + place, longer)


def ours(scene: Scene) -> float:
    """Fit the paper's box with default settings."""
    return fit_box(scene.xy, sensor_xy=scene.sensor_xy).yaw_rad


def min_area(scene: Scene) -> float:
    """Fit the rectangle of least area around the points."""
    _, (width, height), angle = cv2.minAreaRect(scene.xy.astype(np.float32))
    return math.radians(angle if width >= height else angle + 90.0)


def closeness(scene: Scene, step_deg: float = 1.0, nearest_m: float = 0.01) -> float:
    """Find the yaw at which the points are closest to two sides of their bounding box.

    Zhang, Xu, Dong, Dolan: Efficient L-Shape Fitting for Vehicle Detection Using Laser Scanners, IV 2017,
    algorithms 2 and 4, with their step and their least distance.
    """
    angles = np.arange(0.0, math.pi / 2, math.radians(step_deg))
    normals = np.stack([np.cos(angles), np.sin(angles), -np.sin(angles), np.cos(angles)], axis=-1).reshape(-1, 2)
    along = scene.xy @ normals.T
    to_low, to_high = along - along.min(axis=0), along.max(axis=0) - along
    low_is_nearer = (to_low**2).sum(axis=0) < (to_high**2).sum(axis=0)
    distance = np.where(low_is_nearer, to_low, to_high)
    near = np.maximum(np.minimum(distance[:, 0::2], distance[:, 1::2]), nearest_m)
    best = int(np.argmax((1.0 / near).sum(axis=0)))
    extent = np.ptp(along[:, 2 * best : 2 * best + 2], axis=0)
    return float(angles[best]) + (0.0 if extent[0] >= extent[1] else math.pi / 2)


METHODS: dict[str, Callable[[Scene], float]] = {
    "fit_box": ours,
    "minAreaRect": min_area,
    "closeness": closeness,
}


def score(method: Callable[[Scene], float], scenes: list[Scene]) -> Score:
    """Time the method on every scene, and compare its yaws with the truth."""
    times, errors = [], []
    for scene in scenes:
        start = time.perf_counter()
        yaw = method(scene)
        times.append(time.perf_counter() - start)
        errors.append(abs((yaw - scene.yaw_rad + math.pi / 2) % math.pi - math.pi / 2))
    degrees = np.degrees(errors)
    return Score(1e3 * float(np.median(times)), float(np.median(degrees)), float(np.percentile(degrees, 95)))


def main() -> None:
    """Print one line for each shape, fill and number of points."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="100 scenes a line instead of 1000")
    parser.add_argument("--sigma", type=float, default=0.02, metavar="M", help="noise of the points (default 0.02)")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    scenes_per_line = 100 if arguments.quick else 1000
    # Without the largest first, the allocator returns every large array to the system, and methods look slower.
    for method in METHODS.values():
        method(make_scene("box", max(COUNTS), 0.0, arguments.sigma, np.random.default_rng(arguments.seed)))
    print(f"median time [ms], median and 95th percentile of the yaw error [deg]; noise {arguments.sigma} m")
    print("shape  fill     n" + "".join(f"  | {name:^23}" for name in METHODS))
    for shape in SHAPES:
        for fill in FILLS:
            for n in COUNTS:
                rng = np.random.default_rng(arguments.seed)
                scenes = [make_scene(shape, n, fill, arguments.sigma, rng) for _ in range(scenes_per_line)]
                scores = [score(method, scenes) for method in METHODS.values()]
                cells = "".join(f"  | {s.time_ms:7.3f} {s.yaw_median_deg:7.2f} {s.yaw_p95_deg:7.2f}" for s in scores)
                print(f"{shape:<5} {fill:4.0%} {n:6}{cells}")


if __name__ == "__main__":
    main()
