"""Time the whole run with a vehicle mask against the same without, by turns.

usage: python -m tools.bench_mask_time RECORDING MODEL.onnx [--repeat 3]

RECORDING is a folder with left/, right/, cam.csv and stereo.yaml. Both are whole processes. The ratio of the medians is
told of the time that passes and of the processors' time; where others use the processors too, only the latter counts.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

from tools.bench_run import tool


def timed(command: list[str]) -> tuple[float, float]:
    """Run a command and return the time that passed and that of the processors, seconds."""
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    if status != 0:
        raise SystemExit(f"{' '.join(command)} failed with status {status}")
    return time.perf_counter() - start, usage.ru_utime + usage.ru_stime


def main() -> None:
    """Run both by turns and print the ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("model", type=Path)
    parser.add_argument("--repeat", type=int, default=3)
    arguments = parser.parse_args()
    seconds: dict[str, list[tuple[float, float]]] = {"without": [], "with": []}
    with tempfile.TemporaryDirectory() as folder:
        plain = tool(arguments.recording, Path(folder) / "result")
        commands = {"without": plain, "with": [*plain, "--vehicle-mask", str(arguments.model)]}
        for _ in range(arguments.repeat):
            for name, command in commands.items():
                seconds[name].append(timed(command))
    middle = {name: [statistics.median(part) for part in zip(*each, strict=True)] for name, each in seconds.items()}
    for name, (passed, worked) in middle.items():
        print(f"{name:8} {passed:6.1f} s passed, {worked:6.1f} s of processors")
    passed, worked = (masked / bare for masked, bare in zip(middle["with"], middle["without"], strict=True))
    print(f"ratio    {passed:6.2f}           {worked:6.2f}")


if __name__ == "__main__":
    main()
