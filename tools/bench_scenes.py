"""Calibrate random scenes and compare the results with the ground truth.

usage: python -m tools.bench_scenes [--sensors lidar_8,lidar_32,stereo_05,detections] [--scenes 200] [--first SEED]
       [--in-turn] [--method paper|joint|both] [--jobs 2] [--set FACTOR=VALUE ...] [--rendered N]
       [--out DIR [--resume]] [--worst K]

Prints a table, one row for each sensor and method. A run is *accepted* when it is calibrated with another verdict than
"fail"; all others are *refused*. A scene is *good* when the sender is in view in at least 40 frames, two of its sides
are seen, and meanwhile it turns by at least 30 deg or changes its speed by at least 10 %. Errors, and whether they are
covered by the claimed covariance, are those of the accepted runs; "within 3 sigma" refers to the position along the
track, the last column to yaw and tilt.

"detections" are a detector's boxes of the moving objects around a lidar_32: with errors of 10 cm and 2 deg, and of 5 %
of each object's size that last, every fifth missing, without track numbers. With --rendered N the first N seeds of each
stereo camera are images, rendered at 5 Hz (seconds per image, minutes per scene) and matched by the tool itself, in
rows of their own; the other seeds use the fast simulation. With --out the table, the runs as CSV, written one line each
as they end, and pictures of the worst are kept.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import get_args

import cv2
import numpy as np

from laci_stereo.core.errors import CalibrationError
from laci_stereo.core.frames import FloatArray, Raster, transform
from laci_stereo.core.result import Calibration
from laci_stereo.core.settings import Method, Settings
from tools.scenes.__main__ import settings as read_factors
from tools.scenes.disparity import STEREOS
from tools.scenes.runs import NO_SCENE, Run, read_runs, recorded, report
from tools.scenes.scene import SENSORS, Recorded, Scene, SceneError, SensorKind, draw_scene, errors_of
from tools.scenes.seeing import Seen, Way, see
from tools.scenes.worth import is_good

PIXELS_PER_M, PICTURE_M = 14, 60.0

DETECTIONS = "detections"
DETECTED_AROUND: SensorKind = "lidar_32"
RENDERED = "_rendered"


@dataclass(frozen=True)
class Job:
    """One scene, by one or several methods; see `Run`."""

    sensor: str
    seed: int
    methods: tuple[Method, ...]

    @property
    def kind(self) -> SensorKind:
        """The sensor whose scene is drawn."""
        name = DETECTED_AROUND if self.sensor == DETECTIONS else self.sensor.removesuffix(RENDERED)
        return {sensor: sensor for sensor in SENSORS}[name]  # type: ignore[index]

    @property
    def way(self) -> Way:
        """How the scene is observed."""
        if self.sensor == DETECTIONS:
            return "detections"
        return "rendered" if self.sensor.endswith(RENDERED) else "simulated"


def run(job: Job, factors: dict[str, object]) -> list[Run]:
    """Calibrate one scene by each of the methods; it is drawn and observed once."""
    start = time.perf_counter()
    runs = [Run(job.sensor, method, job.seed) for method in job.methods]
    try:
        scene = draw_scene(job.seed, job.kind, **factors)
    except SceneError as error:
        return [replace(one, refused=f"{NO_SCENE}: {error}") for one in runs]
    drawn = time.perf_counter()
    about = [
        replace(
            one,
            drive=scene.drive_kind,
            vehicle=scene.vehicle.kind,
            seen=scene.seen,
            good=is_good(scene),
            draw_s=drawn - start,
        )
        for one in runs
    ]
    try:
        seen = see(scene, job.way)
    except Exception as error:  # one crash must not end a long run; only a CalibrationError is a refusal
        took = time.perf_counter() - drawn
        return [replace(one, refused=_reason(error), observe_s=took) for one in about]
    took = time.perf_counter() - drawn
    return [
        _located(replace(one, observe_s=took), method, seen, scene)
        for one, method in zip(about, job.methods, strict=True)
    ]


def _located(about: Run, method: Method, seen: Seen, scene: Scene) -> Run:
    start = time.perf_counter()
    try:
        found = seen.locate(Settings(method=method))
    except Exception as error:
        return replace(about, refused=_reason(error), locate_s=time.perf_counter() - start)
    took = time.perf_counter() - start
    verdict = found.quality.verdict
    refused = f"verdict fail: {'; '.join(found.quality.reasons)}" if verdict == "fail" else ""
    return replace(about, refused=refused, verdict=verdict, locate_s=took, **asdict(errors_of(found, scene)))


def _reason(error: Exception) -> str:
    crash = "" if isinstance(error, CalibrationError) else "CRASH "
    return f"{crash}{type(error).__name__}: {error}"


def picture(scene: Scene, found: Calibration) -> Raster:
    """Draw a view from above: the sender's points by the calibration, the true and the found track, and the sensor."""
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
    boxes = np.column_stack([found.drive.track.centres, np.zeros(len(found.drive.track.centres))])
    moved = found.T_utm_sensor @ np.linalg.inv(found.T_level_sensor)
    track(transform(moved, boxes), (0, 0, 220))
    for at, colour in ((scene.T_utm_sensor[None, :2, 3], (0, 140, 0)), (found.world.to_utm(seen[:, :2]), (0, 0, 220))):
        x, y = (pixels(at)[0] / 16).astype(int).tolist()
        cv2.drawMarker(image, (x, y), colour, cv2.MARKER_TRIANGLE_UP, 12)
    return image


def draw_worst(runs: Sequence[Run], count: int, factors: dict[str, object], out: Path) -> None:
    """Write pictures of the runs with the largest errors; green is the truth, red what was found."""
    done = sorted((run for run in runs if run.verdict), key=lambda run: -run.track_xy_cm)
    for worst in done[:count]:
        method = {name: name for name in METHODS}[worst.method]  # type: ignore[index]
        job = Job(worst.sensor, worst.seed, (method,))
        scene = draw_scene(job.seed, job.kind, **factors)
        image = picture(scene, see(scene, job.way).locate(Settings(method=method)))
        text = f"{worst.track_xy_cm:.1f} cm, {worst.rotation_deg:.2f} deg, {worst.vehicle}, {worst.verdict}"
        cv2.putText(image, text, (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
        cv2.imwrite(str(out / f"{worst.sensor}_{method}_{worst.seed}.png"), image)


METHODS: tuple[Method, ...] = get_args(Method)


def jobs_of(
    sensors: Sequence[str], seeds: range, methods: Sequence[Method], rendered: int, *, in_turn: bool = False
) -> list[Job]:
    """Return the jobs to be run; for stereo cameras, the first ``rendered`` seeds use images."""
    return [
        Job(sensor + RENDERED * (sensor in STEREOS and seed - seeds.start < rendered), seed, tuple(methods))
        for number, sensor in enumerate(sensors)
        for seed in (seeds[number :: len(sensors)] if in_turn else seeds)
    ]


def missing(jobs: Iterable[Job], runs: Iterable[Run]) -> list[Job]:
    """Return the jobs, or those of their methods, that are not among the runs."""
    there = {(run.sensor, run.seed, run.method) for run in runs}
    left = [
        replace(job, methods=tuple(name for name in job.methods if (job.sensor, job.seed, name) not in there))
        for job in jobs
    ]
    return [job for job in left if job.methods]


def runs_of(jobs: Sequence[Job], factors: dict[str, object], processes: int) -> Iterator[list[Run]]:
    """Yield the runs of each job when it is done."""
    with ProcessPoolExecutor(processes) as pool:
        for done in as_completed([pool.submit(run, job, factors) for job in jobs]):
            yield done.result()


def parsed_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sensors", default="lidar_8,lidar_16,lidar_32,lidar_64,stereo_02,stereo_05,stereo_10")
    parser.add_argument("--scenes", type=int, default=200, help="for each sensor")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--in-turn", action="store_true", help="each seed by one sensor, these in turn")
    parser.add_argument("--method", choices=(*METHODS, "both"), default="both", help="both see the scene once")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--set", action="append", default=[], metavar="FACTOR=VALUE", help="see tools/scenes/scene.py")
    parser.add_argument(
        "--rendered", type=int, default=0, metavar="N", help="seeds of stereo cameras on images, at 5 Hz"
    )
    parser.add_argument("--worst", type=int, default=0, help="pictures of so many")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--resume", action="store_true", help="skip what stands in DIR/scenes.csv, of the same factors")
    arguments = parser.parse_args()
    unknown = set(arguments.sensors.split(",")) - {*SENSORS, DETECTIONS}
    if unknown:
        parser.error(
            f"--sensors has {', '.join(sorted(unknown))}; needed are some of {', '.join((*SENSORS, DETECTIONS))}"
        )
    if arguments.out is None and (arguments.resume or arguments.worst):
        parser.error("--resume and --worst need --out DIR")
    return arguments


def main() -> None:
    """Run the benchmark."""
    arguments = parsed_arguments()
    factors = read_factors(arguments.set)
    methods = METHODS if arguments.method == "both" else (arguments.method,)
    seeds = range(arguments.first, arguments.first + arguments.scenes)
    jobs = jobs_of(arguments.sensors.split(","), seeds, methods, arguments.rendered, in_turn=arguments.in_turn)
    runs = read_runs(arguments.out / "scenes.csv") if arguments.resume else []
    batches = runs_of(left := missing(jobs, runs), factors, arguments.jobs)
    if arguments.out:
        batches = recorded(batches, arguments.out / "scenes.csv", tuple(runs))
    for number, batch in enumerate(batches, start=1):
        runs += batch
        print(f"\r{number} of {len(left)}", end="", flush=True)
    place = {job.sensor: number for number, job in enumerate(jobs)}
    asked = sorted(
        (run for run in runs if run.sensor in place), key=lambda run: (place[run.sensor], run.method, run.seed)
    )
    text = report(asked)
    print(f"\n{text}")
    if arguments.out:
        (arguments.out / "table.md").write_text(text)
        draw_worst(asked, arguments.worst, factors, arguments.out)


if __name__ == "__main__":
    main()
