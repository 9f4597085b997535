"""The installed command on recordings that tests may damage, and what each of its runs must keep to."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from tests.forked import FORKS, run_forked

COMMAND = Path(sys.executable).with_name("laci-stereo")
DEMONSTRATION = Path(__file__).parents[1] / "calib_data"
LONGEST_RUN_S = 120.0

QUIET_FRAMES = 4
FIRST_SEEN_S, LAST_SEEN_S = 5.7, 9.7
SIZE = (640, 360)


@dataclass(frozen=True)
class Ran:
    """What a run of the command left behind: its exit code, and what it wrote to stdout and stderr."""

    code: int
    out: str
    err: str


@dataclass(frozen=True)
class Finished:
    """A run and the folder that it wrote."""

    ran: Ran
    out: Path


@dataclass(frozen=True)
class Site:
    """A folder as a user has it: two folders of images, a log of messages, a stereo calibration, a map."""

    root: Path

    @property
    def left(self) -> Path:
        return self.root / "left"

    @property
    def right(self) -> Path:
        return self.root / "right"

    @property
    def cam(self) -> Path:
        return self.root / "cam.csv"

    @property
    def stereo(self) -> Path:
        return self.root / "stereo.yaml"

    @property
    def out(self) -> Path:
        return self.root / "result"

    def arguments(self, *options: str | Path, out: Path | None = None) -> list[str]:
        paths = ("calibrate", self.left, self.right, self.cam, "--out", out or self.out)
        return [str(argument) for argument in (*paths, *options)]

    def run(self, *options: str | Path, out: Path | None = None) -> Ran:
        return run(self.arguments(*options, out=out), self.root)

    def refused(self, code: int, *words: str, options: Sequence[str | Path] = (), out: Path | None = None) -> str:
        return refused(lambda: self.run(*options, out=out), self.root, code, *words)

    def replace_text(self, path: Path, old: str, new: str) -> None:
        text = path.read_text(encoding="utf-8")
        assert old in text
        rewrite(path, text.replace(old, new).encode())


def run(arguments: Sequence[str], folder: Path, command: Path = COMMAND) -> Ran:
    """Run a command in a folder, its temporary files below it, in a process of its own."""
    if not FORKS:
        return run_installed(arguments, folder, command=command)
    ended = run_forked(command, arguments, folder, environment(folder), LONGEST_RUN_S)
    return Ran(ended.returncode, ended.stdout, ended.stderr)


def run_installed(
    arguments: Sequence[str],
    folder: Path,
    within: Sequence[str] = (),
    command: Path = COMMAND,
    env: Mapping[str, str] | None = None,
) -> Ran:
    """Run a command as a shell does, from its script on, perhaps by another command or with more in its environment."""
    ended = subprocess.run(
        [*within, str(command), *arguments],
        cwd=folder,
        env=environment(folder) | dict(env or {}),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=LONGEST_RUN_S,
        check=False,
    )
    return Ran(ended.returncode, ended.stdout, ended.stderr)


def environment(folder: Path) -> dict[str, str]:
    """Return an environment in which temporary files are in sight, and lines are not broken."""
    return {**os.environ, "TMPDIR": str(folder), "COLUMNS": "200"}


def refused(start: Callable[[], Ran], folder: Path, code: int, *words: str, program: str = COMMAND.name) -> str:
    """Start a command, which must refuse with one line that holds these words and leave the folder as it was."""
    before = snapshot(folder)
    line = refusal(start(), code, *words, program=program)
    assert snapshot(folder) == before
    return line


def refusal(ran: Ran, code: int, *words: str, program: str = COMMAND.name) -> str:
    """Hold a run against what a refusal must be, and return its line."""
    assert ran.code == code, ran
    assert ran.out == ""
    lines = ran.err.splitlines()
    assert len(lines) == 1, ran.err
    assert lines[0].startswith(f"{program}: ")
    for word in words:
        assert word in lines[0]
    return lines[0]


def document_in(result: Path) -> dict[str, Any]:
    """Return the calibration.json of a result's folder."""
    read: dict[str, Any] = json.loads((result / "calibration.json").read_text(encoding="utf-8"))
    return read


def snapshot(folder: Path) -> dict[str, str]:
    """Return every path below a folder and what is there."""
    return {str(path.relative_to(folder)): _content(path) for path in sorted(folder.rglob("*"))}


def _content(path: Path) -> str:
    if path.is_symlink():
        return f"-> {path.readlink()}"
    return "folder" if path.is_dir() else hashlib.sha256(path.read_bytes()).hexdigest()


def rewrite(path: Path, content: bytes) -> None:
    """Give a file of a site new content; the file it may be a link to keeps its own."""
    path.unlink()
    path.write_bytes(content)


SMALL_LIMIT = ("--max-sigma-deg", "1")
"""Twenty frames of half the size tell the yaw to 0.5 deg, which is the usual limit."""


def write_small_recording(folder: Path) -> None:
    """Write some pairs of the demonstration data in half their size, with the calibration that fits them."""
    names = sorted(path.name for path in (DEMONSTRATION / "left").iterdir())
    epoch_s = int(Path(names[0]).stem) / 1e9
    seen = [name for name in names if FIRST_SEEN_S <= int(Path(name).stem) / 1e9 - epoch_s <= LAST_SEEN_S]
    for side in ("left", "right"):
        (folder / side).mkdir()
        for name in names[:QUIET_FRAMES] + seen:
            image = cv2.imread(str(DEMONSTRATION / side / name))
            assert image is not None
            small = cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA)
            assert cv2.imwrite(str(folder / side / name), small, [cv2.IMWRITE_JPEG_QUALITY, 90])
    calibration = (DEMONSTRATION / "stereo.yaml").read_text(encoding="utf-8")
    halves = {"1280": "640", "720": "360", "1100.": "550.", "639.5": "319.5", "359.5": "179.5"}
    for whole, half in halves.items():
        assert whole in calibration
        calibration = calibration.replace(whole, half)
    (folder / "stereo.yaml").write_text(calibration, encoding="utf-8")
    for name in ("cam.csv", "map.osm"):
        (folder / name).write_bytes((DEMONSTRATION / name).read_bytes())


def link_recording(recording: Path, folder: Path) -> None:
    """Lay a recording into a folder, every file a link, so that one can be replaced without harm to the others."""
    for path in recording.rglob("*"):
        there = folder / path.relative_to(recording)
        if path.is_dir():
            there.mkdir()
        else:
            there.symlink_to(path)


@contextmanager
def running(arguments: Sequence[str], folder: Path, stderr: int = subprocess.PIPE) -> Iterator[subprocess.Popen[str]]:
    """Start the installed command; whatever happens, it does not outlive the block."""
    process = subprocess.Popen(
        [COMMAND, *arguments],
        cwd=folder,
        env=environment(folder),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=stderr,
        text=True,
    )
    with process:
        try:
            yield process
        finally:
            process.kill()
