"""Does the lane check distinguish right calibrations from wrong ones? Random rendered scenes with road markings.

usage: python -m tools.bench_check [--sensor stereo_05] [--scenes 100] [--first SEED] [--jobs 2] [--share 1.0]
       [--no-intensity] [--out DIR] [--set FACTOR=VALUE ...]

For a camera, one image of each scene without moving objects is rendered (the median of a recording is free of them, and
of most of its noise); for a LiDAR, the scans that the check reads are simulated, traffic included. The check is run on
calibrations with errors drawn from their covariance (right, see `CLAIMED`), on ones shifted by 30 cm in each of eight
directions, and on ones rotated by 0.5 deg either way about the sensor (both wrong). The errors counted are right ones
that fail and wrong ones that pass; checks with inconclusive lines are counted separately. With --out the pictures of
all errors are kept. ``--share`` scales the image: 0.5 renders four times as fast, with half the resolution.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from laci_lidar.check import draw_scans, see_scans
from laci_lidar.scan import Scan
from laci_lidar.sequence import ScanSequence
from laci_lidar.surroundings import SCANS
from scipy.spatial.transform import Rotation

from laci_stereo.check.align import SHIFT_M as SHIFT_M_SEARCHED
from laci_stereo.check.images import paint_in_image
from laci_stereo.check.lanes import LaneCheck, check_lanes
from laci_stereo.check.picture import draw_check
from laci_stereo.check.placed import Placed
from laci_stereo.core.frames import FloatArray, IntArray, Raster, invert, rigid, transform
from laci_stereo.core.subsampling import spread
from laci_stereo.io.maps.lane_map import LaneLine, LaneMap
from laci_stereo.io.rig.stereo_rig import Lens
from laci_stereo.report.camera import Camera
from laci_stereo.report.drawn import on_ground
from tools.scenes.__main__ import settings as read_factors
from tools.scenes.disparity import StereoCamera
from tools.scenes.geometry import Body
from tools.scenes.imager import Sensor, develop
from tools.scenes.render import Eye, Renderer, exposure_scale, random_look
from tools.scenes.scene import SENSORS, Recorded, Scene, SceneError, SensorKind, SimulatedScans, draw_scene
from tools.scenes.world import Edge, Line

CLAIMED = np.radians([0.02, 0.02, 0.06, 0.0, 0.0, 0.0]) + np.array([0.0, 0.0, 0.0, 0.04, 0.04, 0.005])
"""Standard deviations of the rotation vector (tilt, tilt, yaw) and the position (x, y, z): those of the demonstration's
results."""

RIGHT = 8
"""Number of right calibrations drawn at random for each scene."""

SHIFT_M, TURN_DEG = 0.30, 0.5


@dataclass(frozen=True)
class Options:
    """The options of the command line; see the usage."""

    sensor: SensorKind
    share: float
    intensity: bool
    factors: dict[str, object]
    out: Path | None


@dataclass(frozen=True)
class Trial:
    """One check: the calibration's error, and the outcome; ``both_ways`` as `run_both_ways` returns it."""

    seed: int
    wrong: str
    outcome: str
    reasons: tuple[str, ...]
    found: int
    in_view: int
    shift_error_cm: float
    both_ways: bool


@dataclass(frozen=True)
class Place:
    """A scene without moving objects, with the true pose of its sensor."""

    lane_map: LaneMap
    T_world_sensor: FloatArray
    boxes: FloatArray
    centre: FloatArray

    def check(self, placed: Placed) -> LaneCheck:
        """Check a calibration."""
        raise NotImplementedError

    def draw(self, placed: Placed, check: LaneCheck) -> Raster:
        """Draw a check."""
        raise NotImplementedError


@dataclass(frozen=True)
class Shown(Place):
    """A scene without moving objects, seen by a camera."""

    image: Raster
    lens: Lens

    def check(self, placed: Placed) -> LaneCheck:
        """Check a calibration."""
        camera = Camera(self.lens, invert(placed.T_world_sensor))
        return check_lanes(self.lane_map.lines, placed, partial(paint_in_image, self.image, camera))

    def draw(self, placed: Placed, check: LaneCheck) -> Raster:
        """Draw a check."""
        camera = Camera(self.lens, invert(placed.T_world_sensor))
        return draw_check(self.image, partial(_project, camera), check, placed, self.lane_map)


@dataclass(frozen=True)
class Scanned(Place):
    """The scene of a LiDAR, with the scans that the check reads."""

    scans: ScanSequence

    def check(self, placed: Placed) -> LaneCheck:
        """Check a calibration."""
        see = see_scans(self.scans, placed, self.lane_map.lines)
        return check_lanes(see.lines, see.placed, see, kinds=see.kinds)

    def draw(self, placed: Placed, check: LaneCheck) -> Raster:
        """Draw a check."""
        return draw_scans(see_scans(self.scans, placed, self.lane_map.lines), check, self.lane_map)


@dataclass(frozen=True)
class Kept:
    """The scans of a scene that the check reads, each simulated once (implements `ScanSequence`)."""

    scans: tuple[Scan, ...]
    stamps_ns: IntArray
    path: Path = Path("simulated")
    skipped: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.scans)

    def read(self, indices: Sequence[int], threads: int) -> Iterator[Scan | None]:  # noqa: ARG002
        """Yield the scans at these indices."""
        return (self.scans[index] for index in indices)


def watch(scene: Scene, share: float, *, intensity: bool) -> Place:
    """Record a scene without moving objects."""
    lines: list[Line | Edge] = [*scene.site.lines, *scene.site.edges]
    lane_map = LaneMap(tuple(LaneLine(line.kind, line.subtype, line.xy, str(i)) for i, line in enumerate(lines)), ())
    standing = [body for body in scene.site.bodies if body.name != "ground"]
    boxes = np.array([box_around(body) for body in standing]).reshape(-1, 6)
    centre = np.append(scene.sender.track(scene.times_s)[0][scene.in_view].mean(axis=0), 0.0)
    about = (lane_map, scene.T_world_sensor, boxes, centre)
    if isinstance(scene.sensor, StereoCamera):
        return Shown(*about, *show(scene, scene.sensor, share))
    chosen = spread(range(len(scene.times_s)), SCANS)
    scans = tuple(scan for scan in SimulatedScans(Recorded(scene)).read(chosen, 1) if scan is not None)
    kept = scans if intensity else tuple(replace(scan, intensity=None) for scan in scans)
    return Scanned(*about, Kept(kept, scene.stamps_ns[chosen]))


def show(scene: Scene, camera: StereoCamera, share: float) -> tuple[Raster, Lens]:
    """Render the static bodies, once."""
    lens = scaled(camera.rig.left, share)
    look = random_look(np.random.default_rng(scene.seed))
    # Exposure of four images: the median of fifteen images has even less noise.
    sensor: Sensor = replace(look.sensor, colour=False, bits=8, full_well_e=4 * look.sensor.full_well_e)
    renderer = Renderer([body for body in scene.bodies if body.static], Eye(lens, scene.T_world_sensor), look.light)
    scale = exposure_scale(renderer.background, sensor)
    return develop(renderer.radiance(0.0), lens, sensor, scale, np.random.default_rng(scene.seed)), lens


def scaled(lens: Lens, share: float) -> Lens:
    """Return a lens for an image of another size; integers are the centres of pixels."""
    K = lens.K.copy()
    K[:2, 2] += 0.5
    K[:2] *= share
    K[:2, 2] -= 0.5
    return replace(lens, K=K, size=(round(lens.size[0] * share), round(lens.size[1] * share)))


def box_around(body: Body) -> list[float]:
    """Return the box around a body, upright in its own frame: centre, length, width, yaw, height, world."""
    T = body.pose(0.0)
    low, high = body.mesh.vertices[:, :2].min(axis=0), body.mesh.vertices[:, :2].max(axis=0)
    centre = T[:2, :2] @ ((low + high) / 2) + T[:2, 3]
    top = float(transform(T, body.mesh.vertices)[:, 2].max())
    return [*centre.tolist(), *(high - low).tolist(), float(np.arctan2(T[1, 0], T[0, 0])), top]


def moved(shown: Place, error: FloatArray) -> FloatArray:
    """Return the transform with an error, shape (6,), of (rotation vector, translation) about the track's centre."""
    about = rigid(np.eye(3), shown.centre)
    turned = rigid(Rotation.from_rotvec(error[:3]).as_matrix(), error[3:])
    return about @ turned @ invert(about) @ shown.T_world_sensor


def errors_of(shown: Place, seed: int) -> Iterator[tuple[str, FloatArray]]:
    """Yield the calibrations to be checked: kind of error and transform, shape (4, 4)."""
    rng = np.random.default_rng(seed)
    for _ in range(RIGHT):
        yield "right", moved(shown, CLAIMED * rng.normal(size=6))
    for eighth in range(8):
        angle = eighth * np.pi / 4
        shift = [SHIFT_M * np.cos(angle), SHIFT_M * np.sin(angle), 0.0]
        yield "shifted", moved(shown, np.array([0.0, 0.0, 0.0, *shift]))
    for turn in (-TURN_DEG, TURN_DEG):
        rotation = Rotation.from_euler("z", turn, degrees=True).as_matrix()
        T = shown.T_world_sensor
        yield "turned", rigid(rotation @ T[:3, :3], T[:3, 3])


def run(seed: int, options: Options) -> list[Trial]:
    """Check the calibrations of one scene."""
    try:
        scene = draw_scene(seed, options.sensor, **options.factors)
    except SceneError:
        return []
    place = watch(scene, options.share, intensity=options.intensity)
    trials = []
    for number, (wrong, T_world_sensor) in enumerate(errors_of(place, seed)):
        placed = Placed(T_world_sensor, np.diag(CLAIMED**2), place.centre, place.boxes)
        check = place.check(placed)
        trial = Trial(
            seed,
            wrong,
            check.judgement.outcome,
            check.judgement.reasons,
            check.lines_found,
            len(check.lines),
            measured_wrongly_cm(check, T_world_sensor @ invert(place.T_world_sensor)),
            run_both_ways(check),
        )
        trials.append(trial)
        if options.out is not None and (is_error(trial) or number == 0):
            name = f"{seed}_{number}_{wrong}_{trial.outcome.replace(' ', '_')}.png"
            cv2.imwrite(str(options.out / name), place.draw(placed, check))
    return trials


def _project(camera: Camera, xy: FloatArray) -> list[FloatArray]:
    return camera.project_line(on_ground(xy))


def measured_wrongly_cm(check: LaneCheck, T_found_true: FloatArray) -> float:
    """Return the error of the measured shift at the markings' centre, cm; NaN without a measurement."""
    if check.error is None:
        return float("nan")
    at = np.append(check.error.centre, 0.0)
    true = (transform(T_found_true, at[None])[0] - at)[:2]
    return 100 * float(np.linalg.norm(check.error.value[:2] - true))


def run_both_ways(check: LaneCheck) -> bool:
    """Return whether the markings found determine a shift in every direction, to half of the range that is searched."""
    if check.error is None:
        return False
    return bool(np.linalg.eigvalsh(check.error.covariance[:2, :2]).max() < (SHIFT_M_SEARCHED / 2) ** 2)


def is_error(trial: Trial) -> bool:
    """Return whether the verdict is wrong."""
    return trial.outcome == ("fail" if trial.wrong == "right" else "pass")


def report(trials: Sequence[Trial]) -> str:
    """Return the table."""
    lines = [f"{'calibration':<12}{'trials':>8}{'pass':>7}{'fail':>7}{'cannot tell':>13}{'errors':>9}"]
    for wrong in ("right", "shifted", "turned"):
        mine = [trial for trial in trials if trial.wrong == wrong]
        outcomes = Counter(trial.outcome for trial in mine)
        share = sum(map(is_error, mine)) / max(len(mine), 1)
        lines.append(
            f"{wrong:<12}{len(mine):>8}{outcomes['pass']:>7}{outcomes['fail']:>7}{outcomes['cannot tell']:>13}"
            f"{share:>9.1%}"
        )
    fixed = [trial for trial in trials if trial.wrong == "right" and trial.both_ways]
    silent = sum(trial.outcome == "cannot tell" for trial in fixed)
    lines.append(f"right ones with paint that runs both ways: {len(fixed)}, of which {silent} cannot be told")
    told = [trial for trial in trials if trial.outcome != "cannot tell"]
    if told:
        measured = [trial.shift_error_cm for trial in told]
        low, high = np.quantile(measured, [0.5, 0.95])
        lines.append(f"shift measured, where the lines can tell: median {low:.1f} cm, 95 % within {high:.1f} cm")
    lines.append(f"scenes: {len({trial.seed for trial in trials})}; errors in " + (", ".join(errors(trials)) or "none"))
    reasons = Counter("; ".join(_plain(reason) for reason in trial.reasons) for trial in trials if trial not in told)
    lines += ["cannot tell because:", *(f"{count:5d}  {reason}" for reason, count in reasons.most_common())]
    return "\n".join(lines)


def errors(trials: Sequence[Trial]) -> list[str]:
    """Return the seeds of the wrong verdicts, with their counts."""
    counted = Counter(f"seed {trial.seed} {trial.wrong}" for trial in trials if is_error(trial))
    return [f"{name} ({count})" for name, count in counted.items()]


def _plain(reason: str) -> str:
    """Mask the digits, so that similar reasons are counted together."""
    return "".join("#" if letter.isdigit() else letter for letter in reason).replace("##", "#").replace("##", "#")


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--share", type=float, default=1.0, help="of the image's size")
    parser.add_argument("--sensor", choices=SENSORS, default="stereo_05")
    parser.add_argument("--no-intensity", action="store_true", help="of a LiDAR")
    parser.add_argument("--set", action="append", default=[], metavar="FACTOR=VALUE", help="see tools/scenes/scene.py")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    factors = read_factors(arguments.set)
    options = Options(arguments.sensor, arguments.share, not arguments.no_intensity, factors, arguments.out)
    if arguments.out is not None:
        arguments.out.mkdir(parents=True, exist_ok=True)
    trials: list[Trial] = []
    seeds = range(arguments.first, arguments.first + arguments.scenes)
    with ProcessPoolExecutor(arguments.jobs) as pool:
        jobs = [pool.submit(run, seed, options) for seed in seeds]
        for number, done in enumerate(as_completed(jobs), start=1):
            trials += done.result()
            print(f"\r{number} of {len(jobs)}", end="", flush=True)
    print("\n" + report(sorted(trials, key=lambda trial: trial.seed)))


if __name__ == "__main__":
    main()
