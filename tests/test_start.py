"""The console scripts end at an interrupt, however early it comes."""

from __future__ import annotations

import signal
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import laci_stereo

START = "from laci_stereo.start import start; start('slow')"
WAITING = "print('waiting', flush=True); time.sleep(60)"
IMPORTING = {
    "plain": f"import time\n{WAITING}",
    "what catches everything": f"import time\ntry:\n    {WAITING}\nexcept BaseException:\n    print('caught')",
    "what turns it into another": f"import time\ntry:\n    {WAITING}\nexcept KeyboardInterrupt:\n    raise ImportError",
}


def interrupted(folder: Path, module: str, code: str = START) -> tuple[int, str, str]:
    """Interrupt a module that waits, and return the exit code and what was written."""
    (folder / "slow.py").write_text(module)
    command = [sys.executable, "-c", code]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "waiting\n"
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=30)
    return process.returncode, out, err


@pytest.mark.parametrize("module", IMPORTING.values(), ids=IMPORTING.keys())
def test_an_interrupt_while_modules_are_imported_ends_it_without_a_word(tmp_path: Path, module: str) -> None:
    assert interrupted(tmp_path, module) == (130, "", "")


def test_an_interrupt_afterwards_is_the_commands_own(tmp_path: Path) -> None:
    module = f"import time\ndef main():\n  try:\n    {WAITING}\n  except KeyboardInterrupt:\n    print('mine')"
    assert interrupted(tmp_path, module) == (0, "mine\n", "")


def test_who_is_started_without_interrupts_stays_so(tmp_path: Path) -> None:
    """As by nohup, or in the background of a script."""
    ignoring = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); "
    module = "import time\nprint('waiting', flush=True); time.sleep(1)\ndef main():\n  time.sleep(1)\n  print('done')"
    assert interrupted(tmp_path, module, ignoring + START) == (0, "done\n", "")


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_an_interrupt_within_a_destructor_is_not_lost(tmp_path: Path, name: str) -> None:
    """Python drops an exception that is raised there."""
    code = f"""
import click, os, signal, time
from laci_stereo.commands.program import run_command

class Closed:
    def __del__(self):
        os.kill(os.getpid(), signal.{name})
        time.sleep(0)

@click.command()
def command():
    closed = Closed()
    del closed
    time.sleep(20)
    print("went on")

run_command(command, "laci-stereo")
"""
    ran = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stdout) == (130, "")
    assert ran.stderr.strip() == "laci-stereo: interrupted; nothing was written"


def test_before_the_command_nothing_is_imported_that_takes_time() -> None:
    code = "import sys, laci_stereo.start, laci_lidar.start; print({'numpy', 'cv2', 'click', 'scipy'} & {*sys.modules})"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout == "set()\n"


@pytest.mark.parametrize("package", ["laci_stereo", "laci_lidar"])
def test_a_package_runs_as_its_script_does(package: str) -> None:
    ran = subprocess.run([sys.executable, "-m", package, "--version"], capture_output=True, text=True, check=True)
    assert ran.stdout == f"{package.replace('_', '-')} {version('laci-stereo')}\n"


def test_all_that_is_public_is_there() -> None:
    assert [name for name in laci_stereo.__all__ if getattr(laci_stereo, name, None) is None] == []
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = laci_stereo.nothing
