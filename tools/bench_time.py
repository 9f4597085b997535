"""Time whole runs against one another, alternately: with a mask, jointly, and of several drives.

usage: python -m tools.bench_time mask RECORDING MODEL.onnx [--repeat 3]
       python -m tools.bench_time joint SCANS CAMS [--repeat 3]
       python -m tools.bench_time combine RESULT [--drives 10] [--repeat 3]

"mask" compares a calibration of images with a vehicle mask with one without, "joint" one of scans with the paper's
method; RECORDING is a folder with left/, right/, cam.csv and stereo.yaml. "combine" estimates over --drives drives,
each the result's own on another day and with the noise of its points drawn anew, and compares that with one such drive.
All are whole processes. The ratio of the medians is printed for the elapsed time and for the processor time; where
other processes use the processors too, only the latter is meaningful.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.tracking.tracks import Track
from laci_stereo.io.output import EVIDENCE_FILE
from laci_stereo.io.result.evidence_file import read_evidence, write_evidence
from tools.bench_run import run, tool

DAY_NS = 86_400_000_000_000


def on_another_day(passage: Passage, day: int) -> Passage:
    """Return a drive on a later day, with the noise of its points along the line of sight drawn anew."""
    rng = np.random.default_rng(day)
    sightings = []
    for each in passage.track.sightings:
        towards = each.points[:, :2] / np.linalg.norm(each.points[:, :2], axis=1, keepdims=True)
        noise_m = rng.normal(0.0, each.sigma_along_m)
        points = each.points + np.column_stack([noise_m[:, None] * towards, np.zeros(len(towards))])
        sightings.append(replace(each, points=points))
    vehicle = replace(passage.vehicle, epoch_ns=passage.vehicle.epoch_ns + day * DAY_NS)
    return replace(passage, track=Track(tuple(sightings)), vehicle=vehicle)


def commands_of(arguments: argparse.Namespace, folder: Path) -> dict[str, list[str]]:
    """Return the two commands by their names, the reference first."""
    out = ["--out", str(folder / "out"), "--overwrite", "--quiet"]
    if arguments.what == "mask":
        plain = tool(arguments.recording, folder / "out")
        return {"without": plain, "with": [*plain, "--vehicle-mask", str(arguments.model)]}
    if arguments.what == "joint":
        scans = [sys.executable, "-m", "laci_lidar", "calibrate", str(arguments.scans), str(arguments.cams), *out]
        return {"paper": [*scans, "--method", "paper"], "joint": [*scans, "--method", "joint"]}
    kept = read_evidence(arguments.result / EVIDENCE_FILE)
    drives = []
    for day in range(arguments.drives):
        drives.append(folder / f"{day}.npz")
        write_evidence(drives[-1], replace(kept, passages=tuple(on_another_day(each, day) for each in kept.passages)))
    combine = [sys.executable, "-m", "laci_stereo", "combine", *out]
    return {"one": [*combine, str(drives[0])], f"{len(drives)}": [*combine, *map(str, drives)]}


def parsed_arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kinds = parser.add_subparsers(dest="what", required=True)
    mask, joint, combine = (kinds.add_parser(name) for name in ("mask", "joint", "combine"))
    for name in ("recording", "model"):
        mask.add_argument(name, type=Path)
    for name in ("scans", "cams"):
        joint.add_argument(name, type=Path)
    combine.add_argument("result", type=Path)
    combine.add_argument("--drives", type=int, default=10)
    for kind in (mask, joint, combine):
        kind.add_argument("--repeat", type=int, default=3)
    return parser.parse_args()


def main() -> None:
    """Run both commands alternately and print the ratios."""
    arguments = parsed_arguments()
    with tempfile.TemporaryDirectory() as folder:
        commands = commands_of(arguments, Path(folder))
        seconds: dict[str, list[tuple[float, float]]] = {name: [] for name in commands}
        for _ in range(arguments.repeat):
            for name, command in commands.items():
                seconds[name].append(run(command)[:2])
    middle = {name: [statistics.median(part) for part in zip(*each, strict=True)] for name, each in seconds.items()}
    for name, (passed, worked) in middle.items():
        print(f"{name:8} {passed:6.1f} s passed, {worked:6.1f} s of processors")
    first, second = middle.values()
    passed, worked = (more / less for more, less in zip(second, first, strict=True))
    print(f"ratio    {passed:6.2f}           {worked:6.2f}")


if __name__ == "__main__":
    main()
