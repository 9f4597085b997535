"""Time the whole run against plain decoding and matching of all pairs, and its memory over short and long recordings.

usage: python tools/bench_run.py [RECORDING] [--repeat N] [--pairs 110 1000]

RECORDING is a folder with left/, right/, cam.csv and stereo.yaml (default: calib_data). The plain run is the simplest
implementation: decode both images as grey, one cv2.StereoSGBM over the whole image with the disparities that the tool
itself derives for it, nothing else. Both are whole processes. For memory the recording is repeated by links under later
names; the messages are not repeated.
"""

from __future__ import annotations

import argparse
import csv
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from laci_stereo.run import prepare
from laci_stereo.stereo.recording import StereoRecording

HERE = Path(__file__).resolve().parent.parent

PLAIN = """
import sys
from pathlib import Path
import cv2
left, right, disparities = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
matcher = cv2.StereoSGBM.create(0, disparities, 5, P1=200, P2=800, disp12MaxDiff=1, uniquenessRatio=10,
                                speckleWindowSize=100, speckleRange=2)
for name in sorted(left.iterdir()):
    pair = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in (name, right / name.name)]
    matcher.compute(*pair)
"""


def run(command: list[str]) -> tuple[float, float, float]:
    """Run a command and return its duration and its processor time, in seconds, and its peak memory in MB."""
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status != 0:
        raise SystemExit(f"{' '.join(command)} failed with status {status}")
    return time.perf_counter() - start, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def tool(recording: Path, out: Path) -> list[str]:
    """Return the command that calibrates a recording."""
    code = "from laci_stereo.commands.cli import main; main()"
    paths = [str(recording / part) for part in ("left", "right", "cam.csv")]
    return [sys.executable, "-c", code, "calibrate", *paths, "--out", str(out), "--overwrite", "--quiet"]


def whole_disparities(recording: Path) -> int:
    """Return the number of disparities that the tool searches in a whole image."""
    source = prepare(recording / "left", recording / "right", recording / "cam.csv").recording
    assert isinstance(source, StereoRecording)
    return source.whole_region().count


def repeated(recording: Path, pairs: int, folder: Path) -> Path:
    """Create a recording of ``pairs`` pairs with links that repeat a shorter one, with pauses of one second."""
    names = sorted((recording / "left").iterdir())
    stamps = [int(name.stem) for name in names]
    period_ns = stamps[-1] - stamps[0] + 1_000_000_000
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
    for index in range(pairs):
        lap, position = divmod(index, len(names))
        for side in ("left", "right"):
            link = folder / side / f"{stamps[position] + lap * period_ns}{names[position].suffix}"
            link.symlink_to((recording / side / names[position].name).resolve())
    (folder / "stereo.yaml").symlink_to((recording / "stereo.yaml").resolve())
    # The vehicle drives once; its later laps have no messages, so the tool treats them as other traffic.
    with (recording / "cam.csv").open() as source, (folder / "cam.csv").open("w", newline="") as target:
        csv.writer(target).writerows(csv.reader(source))
    return folder


def main() -> None:
    """Print both benchmarks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", nargs="?", type=Path, default=HERE / "calib_data")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--pairs", type=int, nargs=2, default=(110, 1000))
    arguments = parser.parse_args()
    recording: Path = arguments.recording
    disparities = whole_disparities(recording)
    with tempfile.TemporaryDirectory() as scratch:
        plain = [sys.executable, "-c", PLAIN, str(recording / "left"), str(recording / "right"), str(disparities)]
        ratios, times = [], []
        for _ in range(arguments.repeat):
            own, *_ = run(tool(recording, Path(scratch) / "out"))
            other, *_ = run(plain)
            times.append((own, other))
            ratios.append(own / other)
        own, other = (statistics.median(column) for column in zip(*times, strict=True))
        print(f"whole run {own:.2f} s, plain decoding + SGBM ({disparities} disparities) {other:.2f} s, medians")
        print(f"ratio: median {statistics.median(ratios):.2f}, worst {max(ratios):.2f} of {len(ratios)}")
        memory = {}
        for pairs in arguments.pairs:
            folder = repeated(recording, pairs, Path(scratch) / str(pairs))
            seconds, _, memory[pairs] = run(tool(folder, Path(scratch) / f"out{pairs}"))
            print(f"{pairs} pairs: {memory[pairs]:.0f} MB at most, {seconds:.1f} s")
        few, many = (memory[pairs] for pairs in arguments.pairs)
        print(f"memory ratio: {many / few:.3f}")


if __name__ == "__main__":
    main()
