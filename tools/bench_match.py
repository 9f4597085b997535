"""Print how often, and how accurately, a detector's boxes are matched with the messages of one vehicle among many.

Run from the repository's root: ``python -m tools.bench_match --scenes 50``.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from laci_stereo.core.errors import CalibrationError
from laci_stereo.match import match
from tests.detections import cam_rows, detection_rows, errors, is_senders, traffic

FAR_SIGMAS = 3.0
"""An error above this many of the result's own standard deviations is not covered by its covariance."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of one scene; errors are NaN where it was refused."""

    seed: int
    right: bool
    refused: bool
    silently_wrong: bool
    track_xy_m: float
    yaw_deg: float
    seconds: float


def outcome(seed: int, vehicles: int, track_ids: bool) -> Outcome:
    """Write one scene's files, match them, and compare with the truth."""
    made = traffic(seed, vehicles)
    with tempfile.TemporaryDirectory() as name:
        detections = detection_rows(made, track_ids).write(Path(name) / "detections.csv")
        cam = cam_rows(made.messages).write(Path(name) / "cam.csv")
        begin = time.perf_counter()
        try:
            found = match(detections, cam).calibration
        except CalibrationError as refusal:
            print(f"scene {seed}: refused: {refusal}")
            return Outcome(seed, False, True, False, np.nan, np.nan, time.perf_counter() - begin)
        seconds = time.perf_counter() - begin
    error, quality = errors(made, found), found.quality
    right = is_senders(made, found)
    covered = error.track_xy_m <= FAR_SIGMAS * quality.track_xy_sigma_m
    covered &= abs(error.yaw_deg) <= FAR_SIGMAS * quality.yaw_sigma_deg
    silent = quality.verdict == "pass" and not (right and covered)
    return Outcome(seed, right, False, silent, error.track_xy_m, abs(error.yaw_deg), seconds)


def spread(values: Sequence[float]) -> str:
    """Return median, 95th percentile and worst."""
    median, most, worst = np.nanpercentile(values, [50, 95, 100])
    return f"median {median:.3f}, 95 % {most:.3f}, worst {worst:.3f}"


def main() -> None:
    """Print the summary of some scenes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=50)
    parser.add_argument("--first", type=int, default=0, help="seed of the first scene")
    parser.add_argument("--vehicles", type=int, default=30)
    parser.add_argument("--track-ids", action="store_true", help="the detector also tracks")
    arguments = parser.parse_args()
    seeds = range(arguments.first, arguments.first + arguments.scenes)
    outcomes = [outcome(seed, arguments.vehicles, arguments.track_ids) for seed in seeds]
    found = [one for one in outcomes if not one.refused]
    wrong = [one.seed for one in outcomes if one.silently_wrong]
    print(f"{arguments.vehicles} vehicles in 2 min, noise 0.1 m and 2 deg, 20 % of the boxes missing")
    print(f"the sender's track found  {sum(one.right for one in outcomes)} of {len(outcomes)}")
    print(f"refused                   {len(outcomes) - len(found)}")
    print(f"wrong without a warning   {len(wrong)} {wrong or ''}")
    if found:
        print(f"position along the track  {spread([one.track_xy_m for one in found])} m")
        print(f"yaw                       {spread([one.yaw_deg for one in found])} deg")
    print(f"time                      {spread([one.seconds for one in outcomes])} s")


if __name__ == "__main__":
    main()
