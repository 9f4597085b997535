"""What one of the workers of a test run makes, and all of them use."""

from __future__ import annotations

import os
import pickle
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import pytest

LONGEST_S = 240.0

T = TypeVar("T")
_base: list[Path] = []


def begin(factory: pytest.TempPathFactory) -> None:
    """Choose the folder of this test run, which its workers have in common."""
    own = factory.getbasetemp()
    _base[:] = [own.parent if "PYTEST_XDIST_WORKER" in os.environ else own]


def written_once(name: str, write: Callable[[Path], object]) -> Path:
    """Return a folder that one worker writes, and that the others wait for; not to be changed."""
    (base,) = _base
    folder, ended = base / name, base / f"{name} ended"
    try:
        folder.mkdir()
    except FileExistsError:
        latest_s = time.monotonic() + LONGEST_S
        while not ended.exists():
            assert time.monotonic() < latest_s, f"{folder} was not written in time"
            time.sleep(0.1)
    else:
        try:
            write(folder)
        finally:
            ended.touch()
    return folder


def found_once(name: str, find: Callable[[], T]) -> T:
    """Return what one worker finds."""
    folder = written_once(name, lambda folder: (folder / "found").write_bytes(pickle.dumps(find())))
    found: T = pickle.loads((folder / "found").read_bytes())
    return found
