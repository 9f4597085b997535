"""Print the true and the claimed errors of the ground fit on random scenes, and its duration.

Run from the repository's root: ``python -m tools.bench_ground --scenes 200``.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np

from laci_stereo.core.errors import GroundError
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.ground.plane import GroundPlane, fit_ground
from laci_stereo.core.settings import GroundSettings
from tests.scenes import GroundScene, ground_scene, rough_road, wavy_road, with_shared_error


@dataclass(frozen=True)
class Outcome:
    """The outcome of one scene; errors are infinite where no plane was found."""

    tilt_deg: float
    height_m: float
    above_ground: float
    angle_deg: float
    height_error_m: float
    angle_claimed_deg: float
    height_claimed_m: float
    mahalanobis_squared: float
    seconds: float


def outcome(scene: GroundScene) -> Outcome:
    """Fit one scene and compare the result with the ground truth."""
    begin = time.perf_counter()
    try:
        plane = fit_ground(scene.points, scene.sigma_along_m, scene.sigma_across_m, scene.up)
    except GroundError:
        angle = height_error = angle_claimed = height_claimed = normalised = float("inf")
    else:
        # The arc cosine of a number close to 1 is accurate to 1e-8 only.
        angle = float(np.degrees(np.arcsin(np.linalg.norm(np.cross(plane.normal, scene.normal)))))
        height_error = abs(plane.height_m - scene.height_m)
        covariance = plane.covariance_level(scene.axes)
        angle_claimed = float(np.degrees(np.sqrt(covariance[0, 0] + covariance[1, 1])))
        height_claimed = float(np.sqrt(covariance[2, 2]))
        normalised = mahalanobis_squared(scene, plane)
    seconds = time.perf_counter() - begin
    above = float(np.mean(scene.points @ scene.normal + scene.height_m > 0.05))
    return Outcome(
        scene.tilt_deg,
        scene.height_m,
        above,
        angle,
        height_error,
        angle_claimed,
        height_claimed,
        normalised,
        seconds,
    )


def mahalanobis_squared(scene: GroundScene, plane: GroundPlane) -> float:
    """Return the squared Mahalanobis distance of the error of (rotation about level x, about level y, height)."""
    R = plane.T_level_sensor(scene.axes)[:3, :3]
    turn = np.cross(R @ scene.normal, [0.0, 0.0, 1.0])
    error = np.array([turn[0], turn[1], scene.height_m - plane.height_m])
    return float(error @ np.linalg.solve(plane.covariance_level(scene.axes), error))


def row(name: str, outcomes: list[Outcome]) -> str:
    """Return one line of the table of errors."""

    def three(values: FloatArray, digits: int) -> str:
        median, most = np.quantile(values, [0.5, 0.95], method="inverted_cdf")
        return " ".join(f"{v:8.{digits}f}" for v in (median, most, values.max()))

    angle = three(np.array([o.angle_deg for o in outcomes]), 4)
    height = three(np.array([100 * o.height_error_m for o in outcomes]), 2)
    seconds = three(np.array([1000 * o.seconds for o in outcomes]), 0)
    return f"{name:<22}{len(outcomes):>5} |{angle} |{height} |{seconds}"


def claims(name: str, outcomes: list[Outcome]) -> str:
    """Return one line of the table of true and claimed errors; root mean squares."""

    def rms(values: list[float]) -> float:
        return float(np.sqrt(np.mean(np.square(values))))

    angle, angle_claimed = rms([o.angle_deg for o in outcomes]), rms([o.angle_claimed_deg for o in outcomes])
    height, height_claimed = rms([o.height_error_m for o in outcomes]), rms([o.height_claimed_m for o in outcomes])
    normalised = np.mean([o.mahalanobis_squared for o in outcomes])
    return (
        f"{name:<30}{len(outcomes):>5} |{angle:8.4f} {angle_claimed:8.4f} |{100 * height:8.2f} "
        f"{100 * height_claimed:8.2f} |{normalised:6.2f}"
    )


def print_errors(outcomes: dict[str, list[Outcome]]) -> None:
    """Print the table of errors for each kind of sensor."""
    columns = f"{'median':>8} {'95 %':>8} {'worst':>8}"
    print(f"{'':<27} |{'angle [deg]':^26} |{'height [cm]':^26} |{'time [ms]':^26}")
    print(f"{'':<22}{'n':>5} |{columns} |{columns} |{columns}")
    for kind, every in outcomes.items():
        print(row(kind, every))
        for low, high in ((0, 10), (10, 20), (20, 35)):
            chosen = [o for o in every if low <= o.tilt_deg < high]
            if chosen:
                print(row(f"  tilt {low} to {high} deg", chosen))
        for low, high in ((3, 6), (6, 10), (10, 15)):
            chosen = [o for o in every if low <= o.height_m < high]
            if chosen:
                print(row(f"  height {low} to {high} m", chosen))
        print(f"  above ground: median {100 * np.median([o.above_ground for o in every]):.0f} % of the points")


def print_claims(outcomes: dict[str, list[Outcome]], seeds: range, rays: int) -> None:
    """Print true and claimed errors: of the scenes, without pavements, and also with a shared error or uneven road."""
    share = GroundSettings().shared_noise_share
    columns = f"{'true':>8} {'claimed':>8}"
    print(f"\n{'':<35} |{'angle [deg]':^17} |{'height [cm]':^17} | error^2 / covariance")
    print(f"{'':<30}{'n':>5} |{columns} |{columns} | (3 expected)")
    for kind, every in outcomes.items():
        print(claims(kind, every))
        clean = [ground_scene(seed, kind, rays=rays, pavements=False) for seed in seeds]
        print(claims("  no pavements", [outcome(scene) for scene in clean]))
        shared = share * np.random.default_rng(0).normal(size=len(clean))
        biased = [with_shared_error(scene, float(b)) for scene, b in zip(clean, shared, strict=True)]
        print(claims("  no pavements, shared error", [outcome(scene) for scene in biased]))
        for name, road in (("wavy", wavy_road), ("rough", rough_road)):
            uneven = [ground_scene(seed, kind, rays=rays, pavements=False, road=road(seed)) for seed in seeds]
            print(claims(f"  no pavements, {name} road", [outcome(scene) for scene in uneven]))


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=200, help="per kind of sensor")
    parser.add_argument("--rays", type=int, default=20_000, help="cast per scene")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.scenes)
    outcomes = {
        kind: [outcome(ground_scene(seed, kind, rays=arguments.rays)) for seed in seeds] for kind in ("stereo", "lidar")
    }
    print_errors(outcomes)
    print_claims(outcomes, seeds[: max(len(seeds) // 5, 1)], arguments.rays)


if __name__ == "__main__":
    main()
