"""Calibrate random scenes and hold the results against their truth.

usage: python -m tools.bench_scenes [--sensors lidar_8,lidar_32,stereo_05] [--scenes 200] [--first SEED]
       [--method paper|joint] [--jobs 2] [--set FACTOR=VALUE ...] [--out DIR] [--worst K]

Prints a table, one row per sensor: errors of those that were calibrated, and how honest the claims are. A run is
refused when the calibration raises `CalibrationError`. With --out the table, one line per scene as CSV, and pictures
of the worst are written there.
"""

from __future__ import annotations

import argparse
import csv
import os
import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.errors import CalibrationError
from laci_stereo.core.frames import FloatArray, Raster, transform
from laci_stereo.core.result import Calibration
from laci_stereo.core.settings import Settings
from tools.scenes.__main__ import settings as read_factors
from tools.scenes.scene import SENSORS, Recorded, Scene, SceneError, SensorKind, draw_scene, errors_of

HONEST_SIGMAS, WRONG_SIGMAS = 3.0, 5.0

PIXELS_PER_M, PICTURE_M = 14, 60.0


@dataclass(frozen=True)
class Run:
    """One scene; errors are NaN where it was refused."""

    sensor: SensorKind
    seed: int
    drive: str = ""
    vehicle: str = ""
    seen: int = 0
    refused: str = ""
    verdict: str = ""
    track_xy_cm: float = np.nan
    track_z_cm: float = np.nan
    rotation_deg: float = np.nan
    position_cm: float = np.nan
    sigma_ratio: float = np.nan
    draw_s: float = 0.0
    calibrate_s: float = 0.0


def core_settings(method: str) -> Settings:
    """Return the settings with this method, where there is a choice."""
    known = {field.name for field in fields(Settings)}
    chosen: dict[str, Any] = {"method": method} if "method" in known else {}
    return Settings(**chosen)


def run(job: tuple[SensorKind, int], method: str, factors: dict[str, object]) -> Run:
    """Calibrate one scene."""
    sensor, seed = job
    start = time.perf_counter()
    try:
        scene = draw_scene(seed, sensor, **factors)
    except SceneError as error:
        return Run(sensor, seed, refused=f"SceneError: {error}")
    drawn = time.perf_counter()
    about = Run(
        sensor,
        seed,
        drive=scene.drive_kind,
        vehicle=scene.vehicle.kind,
        seen=scene.seen,
        draw_s=drawn - start,
    )
    try:
        found = calibrate(Recorded(scene), scene.messages, core_settings(method), crs=scene.crs)
    except Exception as error:  # one crash must not end a long run; only a CalibrationError is a refusal
        crash = "" if isinstance(error, CalibrationError) else "CRASH "
        reason = f"{crash}{type(error).__name__}: {error}"
        return replace(about, refused=reason, calibrate_s=time.perf_counter() - drawn)
    took = time.perf_counter() - drawn
    return replace(about, calibrate_s=took, verdict=found.quality.verdict, **asdict(errors_of(found, scene)))


def table(runs: Sequence[Run], method: str) -> str:
    """Return a Markdown table with one row per sensor."""
    head = (
        "sensor", "method", "scenes", "xy median", "95 %", "worst cm", "rotation median", "95 %", "worst deg",
        "refused", "truth within 3 sigma", "accepted beyond 5 sigma", "accepted (pass)",
    )  # fmt: skip
    rows = [head, tuple("---" for _ in head)]
    for sensor in dict.fromkeys(run.sensor for run in runs):
        mine = [run for run in runs if run.sensor == sensor]
        done = [run for run in mine if not run.refused]
        # "fail" is a refusal in words: the tool prints it as such.
        accepted = [run for run in done if run.verdict != "fail"]
        cells = [sensor, method, str(len(mine))]
        for name, digits in (("track_xy_cm", 1), ("rotation_deg", 3)):
            values = np.array([getattr(run, name) for run in done]) if done else np.array([np.nan])
            cells += [f"{np.percentile(values, share):.{digits}f}" for share in (50, 95, 100)]
        ratios = np.array([run.sigma_ratio for run in done])
        wrong = sum(run.sigma_ratio > WRONG_SIGMAS for run in accepted)
        passed = sum(run.verdict == "pass" for run in done)
        cells += [
            f"{1 - len(done) / len(mine):.0%}",
            f"{(ratios <= HONEST_SIGMAS).mean():.0%}" if done else "",
            f"{wrong / len(mine):.0%}",
            f"{len(accepted)} ({passed})",
        ]
        rows.append(tuple(cells))
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def reasons(runs: Sequence[Run]) -> str:
    """Return what was refused and why, the numbers in it left out so that like ones are counted together."""
    plain = ("".join("#" if letter.isdigit() else letter for letter in run.refused) for run in runs if run.refused)
    counted = Counter(text.replace("##", "#").replace("##", "#").replace("#.#", "#")[:110] for text in plain)
    return "\n".join(f"{count:5d}  {text}" for text, count in counted.most_common())


def picture(scene: Scene, found: Calibration) -> Raster:
    """Draw the scene from above: the sender's points as the calibration puts them, true and found track, the sensor."""
    size = round(PIXELS_PER_M * PICTURE_M)
    image = np.full((size, size, 3), 255, np.uint8)
    middle = scene.track_utm.mean(axis=0)

    def pixels(utm: FloatArray) -> FloatArray:
        across = (utm[:, :2] - middle) * PIXELS_PER_M * [1.0, -1.0] + size / 2
        whole: FloatArray = np.round(across * 16)
        return whole

    def track(utm: FloatArray, colour: tuple[int, int, int]) -> None:
        cv2.polylines(image, [pixels(utm).astype(np.int32)], False, colour, 1, cv2.LINE_AA, 4)

    for cloud in list(Recorded(scene))[::10]:
        for at in pixels(transform(found.T_utm_sensor, cloud.points)).astype(np.int64).tolist():
            if min(at) >= 0 and max(at) < 16 * size:
                image[at[1] // 16, at[0] // 16] = (190, 170, 150)
    track(scene.track_utm, (0, 140, 0))
    seen = transform(found.T_world_sensor, np.zeros((1, 3)))
    boxes = np.column_stack([found.track.centres, np.zeros(len(found.track.centres))])
    moved = found.T_utm_sensor @ np.linalg.inv(found.T_level_sensor)
    track(transform(moved, boxes), (0, 0, 220))
    for at, colour in ((scene.T_utm_sensor[None, :2, 3], (0, 140, 0)), (found.world.to_utm(seen[:, :2]), (0, 0, 220))):
        x, y = (pixels(at)[0] / 16).astype(int).tolist()
        cv2.drawMarker(image, (x, y), colour, cv2.MARKER_TRIANGLE_UP, 12)
    return image


def draw_worst(runs: Sequence[Run], count: int, method: str, factors: dict[str, object], out: Path) -> None:
    """Write pictures of the scenes with the largest errors; green is the truth, red what was found."""
    done = sorted((run for run in runs if not run.refused), key=lambda run: -run.track_xy_cm)
    for worst in done[:count]:
        scene = draw_scene(worst.seed, worst.sensor, **factors)
        found = calibrate(Recorded(scene), scene.messages, core_settings(method), crs=scene.crs)
        image = picture(scene, found)
        text = f"{worst.sensor} {worst.seed}: {worst.track_xy_cm:.1f} cm, {worst.rotation_deg:.2f} deg, {worst.vehicle}"
        cv2.putText(image, text, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
        cv2.imwrite(str(out / f"{worst.sensor}_{worst.seed}.png"), image)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensors", default="lidar_8,lidar_16,lidar_32,lidar_64,stereo_02,stereo_05,stereo_10")
    parser.add_argument("--scenes", type=int, default=200, help="for each sensor")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--method", choices=("paper", "joint"), default="paper")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--set", action="append", default=[], metavar="FACTOR=VALUE", help="see tools.scenes.Factors")
    parser.add_argument("--worst", type=int, default=0, help="pictures of so many")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    known = {sensor: sensor for sensor in SENSORS}
    sensors = [known[name] for name in arguments.sensors.split(",")]
    factors = read_factors(arguments.set)
    jobs = [(sensor, arguments.first + number) for sensor in sensors for number in range(arguments.scenes)]
    runs: list[Run] = []
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for done in pool.map(partial(run, method=arguments.method, factors=factors), jobs):
            runs.append(done)
            print(f"\r{len(runs)} of {len(jobs)}", end="", flush=True)
    text = f"{table(runs, arguments.method)}\n\nrefused:\n{reasons(runs)}\n"
    print(f"\n{text}")
    if arguments.out:
        arguments.out.mkdir(parents=True, exist_ok=True)
        (arguments.out / "table.md").write_text(text)
        with (arguments.out / "scenes.csv").open("w", newline="") as file:
            writer = csv.DictWriter(file, [field.name for field in fields(Run)])
            writer.writeheader()
            writer.writerows(asdict(run) for run in runs)
        draw_worst(runs, arguments.worst, arguments.method, factors, arguments.out)


if __name__ == "__main__":
    main()
