"""The readers hold against damaged inputs, and what does not hold is found."""

from __future__ import annotations

import os
import signal
import sys
import time
import warnings
from pathlib import Path

import pytest

from laci_stereo.core.errors import InputError
from tools.fuzz.readers import READERS
from tools.fuzz.worker import Limits, Seed, damaged, write_files
from tools.fuzz_readers import fuzz, whole_seeds

WHOLE = b"speed 3.5\nname a\n" * 4
SEED = Seed("broken", "text", {"a.txt": WHOLE}, (WHOLE,))


@pytest.fixture(scope="module")
def seeds() -> list[Seed]:
    return whole_seeds()


def is_damaged(folder: Path) -> bool:
    return (folder / "a.txt").read_bytes() != WHOLE


def crashes(folder: Path) -> None:
    if is_damaged(folder):
        os.kill(os.getpid(), signal.SIGSEGV)


def hangs(folder: Path) -> None:
    while is_damaged(folder):
        time.sleep(0.1)


def spins(folder: Path) -> None:
    started = time.process_time()
    while is_damaged(folder) and time.process_time() < started + 0.6:
        pass


def hungers(folder: Path) -> None:
    if is_damaged(folder):
        b"x" * (200 << 20)


def hungers_in_secret(folder: Path) -> None:
    try:
        bytearray(int(is_damaged(folder)) << 40)
    except MemoryError as problem:
        raise InputError("a.txt cannot be read; needed is another one") from problem


def rambles(folder: Path) -> None:
    if is_damaged(folder):
        raise InputError("a.txt is bad\nvery bad")


def goes_on(folder: Path) -> None:
    if is_damaged(folder):
        raise InputError("bad " * 1000)


def stumbles(folder: Path) -> None:
    if is_damaged(folder):
        raise KeyError("speed")


def warns(folder: Path) -> None:
    if is_damaged(folder):
        warnings.warn("overflow", RuntimeWarning, stacklevel=1)


def refuses(folder: Path) -> None:
    if is_damaged(folder):
        raise InputError("a.txt: speed is x; needed is a number")


BROKEN = {
    crashes: "crash: exit code -11",
    hangs: "hang: no answer",
    spins: "hang: ",
    rambles: "message of 2 lines",
    goes_on: "message of 4000 characters",
    stumbles: "KeyError: ",
    warns: "warning overflow",
}
HUNGRY = {hungers: "memory: 2", hungers_in_secret: "memory: MemoryError behind"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("reader", "words"), (BROKEN | HUNGRY).items(), ids=lambda given: getattr(given, "__name__", "")
)
def test_a_broken_reader_is_found_and_its_input_kept(reader, words, tmp_path: Path) -> None:
    if reader in HUNGRY and sys.platform != "linux":
        pytest.skip("the memory of a process is limited on Linux only")
    limits = Limits(100 << 20, 0.3 if reader in (hangs, spins) else 10.0)
    tally = fuzz({"broken": reader}, [SEED], [5], keep=tmp_path, limits=limits)
    (found,) = tally.findings.values()
    assert found.startswith("broken/text --seed 5: ")
    assert words in found
    (kept,) = tmp_path.rglob("a.txt")
    assert kept.read_bytes() == damaged(SEED, 5)["a.txt"] != WHOLE


@pytest.mark.slow
def test_a_lost_process_is_replaced_and_a_refusal_is_none_of_that() -> None:
    lost = fuzz({"broken": crashes}, [SEED], range(3))
    assert lost.inputs["broken"] == 3
    assert len(lost.findings) == 1
    fine = fuzz({"broken": refuses}, [SEED], range(20), jobs=2)
    assert not fine.findings
    assert (fine.inputs["broken"], fine.accepted["broken"]) == (20, 0)


def test_every_reader_holds_against_damaged_inputs(seeds: list[Seed]) -> None:
    tally = fuzz(READERS, seeds, range(200))
    assert not tally.findings
    assert tally.inputs.total() == 200
    assert set(tally.inputs) == set(READERS)


def test_the_seeds_are_what_the_readers_read(seeds: list[Seed], tmp_path: Path) -> None:
    """What is refused already would show little when damaged; a bare message alone is known only to be refused."""
    refused = []
    for seed in seeds:
        folder = tmp_path / seed.reader / seed.form
        write_files(folder, seed.files)
        try:
            READERS[seed.reader](folder)
        except InputError:
            refused.append(f"{seed.reader}/{seed.form}")
    assert refused == ["cam/UPER"]


def test_each_number_is_another_input_and_always_the_same() -> None:
    made = [damaged(SEED, number)["a.txt"] for number in range(300)]
    assert made == [damaged(SEED, number)["a.txt"] for number in range(300)]
    assert len(set(made)) > 250
