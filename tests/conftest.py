from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import hypothesis
import pytest

# Before NumPy is loaded: workers of the test run share the processors already.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from tests import once
from tests.cli_support import (
    DEMONSTRATION,
    SMALL_LIMIT,
    Finished,
    Site,
    link_recording,
    run_installed,
    write_small_recording,
)

# How long an example takes says more of the machine than of the code.
hypothesis.settings.register_profile("untimed", deadline=None)
hypothesis.settings.load_profile("untimed")


@pytest.fixture(autouse=True, scope="session")
def interruptible() -> Iterator[None]:
    """Children inherit an ignored SIGINT, as that of shells' background jobs, but not a handled one."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(autouse=True, scope="session")
def one_run(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Workers know where to share what takes long to make."""
    once.begin(tmp_path_factory)


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording that is calibrated within seconds; not to be written to."""
    folder = tmp_path_factory.mktemp("recording")
    write_small_recording(folder)
    return folder


@pytest.fixture
def site(recording: Path, tmp_path: Path) -> Site:
    """The small recording, to be damaged at will."""
    link_recording(recording, tmp_path)
    return Site(tmp_path)


@pytest.fixture(scope="session")
def calibrated_site() -> tuple[Site, str]:
    """The small recording with its result, and what the command printed; not to be written to."""

    def calibrate(folder: Path) -> None:
        write_small_recording(folder)
        ran = Site(folder).run(*SMALL_LIMIT)
        assert ran.code == 0, ran
        (folder / "printed").write_text(ran.out, encoding="utf-8")

    folder = once.written_once("calibrated", calibrate)
    return Site(folder), (folder / "printed").read_text(encoding="utf-8")


@pytest.fixture(scope="session")
def demonstration(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    """The first command of the README."""
    folder = tmp_path_factory.mktemp("demonstration")
    arguments = ["calibrate", *(str(DEMONSTRATION / name) for name in ("left", "right", "cam.csv"))]
    return Finished(run_installed(arguments, folder), folder / "calibration")
