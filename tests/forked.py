"""Starts of the commands that share one import: each is a process of its own, forked from one that imported them."""

from __future__ import annotations

import multiprocessing
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path

# Elsewhere a process cannot be forked, or not after it has loaded the system's libraries.
FORKS = sys.platform == "linux"
# The commands, and what most of them import once they have begun.
IMPORTED = ("laci_stereo.commands.cli", "laci_lidar.cli", "sklearn.cluster")


def run_forked(
    command: Path, arguments: Sequence[str], folder: Path, env: Mapping[str, str], timeout_s: float
) -> subprocess.CompletedProcess[str]:
    """Run what an installed command runs; descriptors, signals and the exit code are those of a process."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__, *IMPORTED])
    with tempfile.TemporaryDirectory() as kept:
        out, err = Path(kept, "out"), Path(kept, "err")
        process = context.Process(target=_become, args=(command.name, arguments, folder, dict(env), out, err))
        process.start()
        process.join(timeout_s)
        process.kill()
        process.join()
        assert process.exitcode is not None
        written = (path.read_text(encoding="utf-8") for path in (out, err))
        return subprocess.CompletedProcess([command.name, *arguments], process.exitcode, *written)


def _become(program: str, arguments: Sequence[str], folder: Path, env: Mapping[str, str], out: Path, err: Path) -> None:
    for descriptor, path in ((1, out), (2, err)):
        with path.open("wb") as file:
            os.dup2(file.fileno(), descriptor)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(env)
    tempfile.tempdir = None
    sys.argv = [program, *map(str, arguments)]
    import_module(f"{program.replace('-', '_')}.start").main()
