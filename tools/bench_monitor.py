"""Compare a long monitor with plain SGBM, watch its memory, and kill it at random moments.

usage: python -m tools.bench_monitor RECORDING CALIBRATION [--frames 27000] [--hz 10] [--kills 10] [--plain 300]
           [--workers 0] [--seed 0]

RECORDING is a folder with left/, right/, stereo.yaml and map.osm, CALIBRATION its result. The recording is repeated by
links under later names, at --hz frames per second, until it has --frames frames. Three things are measured: the
monitor's frame rate compared with that of plain matching (decode both images as grey, one cv2.StereoSGBM over the
whole image with the disparities that the tool itself derives for it) over the first of the same images, right before
it; the monitor's memory over time; and whether a second monitor, killed (-9) at random moments and restarted each
time, ends with the same histogram and the same table, byte for byte. Plain matching has one thread; --workers 1 gives
the monitor one thread for its images, too, and one for everything else.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

from laci_stereo.io.images import ImageFolder, pair_images, read_image
from laci_stereo.io.rig.stereo_calibration import calibration_files, read_stereo_calibration
from laci_stereo.stereo.recording import StereoRecording
from tools.bench_run import PLAIN

FIRST_NS = 1_760_000_000_000_000_000
SAMPLE_S = 1.0


@dataclass
class Run:
    """A process, its resident memory over time, and its duration."""

    command: list[str]
    megabytes: list[float] = field(default_factory=list)
    seconds: float = 0.0

    def start(self) -> subprocess.Popen[bytes]:
        """Start the process."""
        return subprocess.Popen(self.command, stdout=subprocess.DEVNULL)

    def measured(self) -> Run:
        """Run the process to its end, and record its memory and duration."""
        begin = time.perf_counter()
        process = self.start()
        ended = threading.Event()
        watcher = threading.Thread(target=self._watch, args=(process.pid, ended))
        watcher.start()
        status = process.wait()
        ended.set()
        watcher.join()
        if status != 0:
            raise SystemExit(f"{' '.join(self.command)} failed with status {status}")
        self.seconds = time.perf_counter() - begin
        return self

    def _watch(self, pid: int, ended: threading.Event) -> None:
        page_mb = os.sysconf("SC_PAGE_SIZE") / 2**20
        while not ended.wait(SAMPLE_S):
            try:
                self.megabytes.append(int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * page_mb)
            except (OSError, IndexError, ValueError):
                return


def repeated(recording: Path, frames: int, hz: float, folder: Path) -> Path:
    """Create a recording of ``frames`` pairs by repeating a shorter one with links."""
    names = sorted(path.name for path in (recording / "left").iterdir())
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
        for index in range(frames):
            name = names[index % len(names)]
            stamp_ns = FIRST_NS + round(index * 1e9 / hz)
            link = folder / side / f"{stamp_ns}{Path(name).suffix}"
            link.symlink_to((recording / side / name).resolve())
    for name in ("stereo.yaml", "map.osm"):
        (folder / name).symlink_to((recording / name).resolve())
    return folder


def whole_disparities(recording: Path) -> int:
    """Return the number of disparities that the tool searches in a whole image."""
    left = recording / "left"
    pairs = pair_images(ImageFolder.open(left), ImageFolder.open(recording / "right")).pairs
    height, width = read_image(pairs[0].left).shape[:2]
    rig = read_stereo_calibration(calibration_files((), left), (width, height))
    return StereoRecording(pairs, rig).whole_region().count


def monitor(calibration: Path, recording: Path, out: Path, workers: int) -> list[str]:
    """Return the command that monitors a recording."""
    code = "from laci_stereo.commands.cli import main; main()"
    paths = [str(calibration), str(recording / "left"), str(recording / "right")]
    return [sys.executable, "-c", code, "monitor", *paths, "--out", str(out), "--workers", str(workers), "--quiet"]


def killed(command: list[str], out: Path, times: int, usual_s: float, rng: random.Random) -> list[int]:
    """Kill a monitor at random moments, restart it each time, then let it end; return the frames done at each kill."""
    far: list[int] = []
    while len(far) < times:
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            # Twice the mean interval at most, so that the kills are distributed over the run.
            process.wait(rng.uniform(0.0, 2 * usual_s / (times + 1)))
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
        process.wait()
        state = out / "state.json"
        far.append(json.loads(state.read_text())["frames"] if state.exists() else 0)
    status = subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode
    if status != 0:
        raise SystemExit(f"after {times} kills: status {status}")
    return far


def main() -> None:
    """Print speed, memory and the effect of kills."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recording", type=Path)
    parser.add_argument("calibration", type=Path)
    parser.add_argument("--frames", type=int, default=27_000)
    parser.add_argument("--hz", type=float, default=10.0)
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--plain", type=int, default=300, help="frames of the plain run")
    parser.add_argument("--workers", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        root = Path(scratch)
        recording = repeated(arguments.recording, arguments.frames, arguments.hz, root / "recording")
        short = repeated(arguments.recording, min(arguments.plain, arguments.frames), arguments.hz, root / "short")
        disparities = whole_disparities(short)
        plain = Run([sys.executable, "-c", PLAIN, str(short / "left"), str(short / "right"), str(disparities)])
        plain_hz = min(arguments.plain, arguments.frames) / plain.measured().seconds
        whole = Run(monitor(arguments.calibration, recording, root / "whole", arguments.workers)).measured()
        own_hz = arguments.frames / whole.seconds
        print(f"{os.cpu_count()} processors; {arguments.frames} frames in {whole.seconds:.0f} s, {own_hz:.1f} a second")
        print(f"plain SGBM ({disparities} disparities): {plain_hz:.1f} a second; ratio {own_hz / plain_hz:.2f}")
        tenths = [whole.megabytes[len(whole.megabytes) * i // 10] for i in range(10)] + whole.megabytes[-1:]
        print(f"memory, MB, at each tenth: {' '.join(f'{value:.0f}' for value in tenths)}")
        print(f"peak {max(whole.megabytes):.0f} MB")
        if arguments.kills:
            command = monitor(arguments.calibration, recording, root / "killed", arguments.workers)
            far = killed(command, root / "killed", arguments.kills, whole.seconds, random.Random(arguments.seed))
            print(f"killed {len(far)} times, at frames {' '.join(map(str, far))}")
            for name in ("objects.csv", "monitor.json", "objects.json", "histogram.png", "state.json"):
                same = (root / "whole" / name).read_bytes() == (root / "killed" / name).read_bytes()
                print(f"{name}: {'the same, byte for byte' if same else 'DIFFERS'}")


if __name__ == "__main__":
    main()
