"""Damaged inputs for every reader: none may crash, hang, exhaust memory, warn, or be refused in more than one line.

``python -m tools.fuzz_readers --inputs 100000``. Each finding is printed once for the place in the sources that it
comes from, with the input's number: ``--only READER/FORM --seed NUMBER --inputs 1`` repeats it. The exit code is 1 if
there is any.
"""

from __future__ import annotations

import argparse
import importlib
import multiprocessing
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from multiprocessing.context import SpawnProcess
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock

from tools.fuzz.mutate import Files
from tools.fuzz.readers import READERS
from tools.fuzz.worker import Limits, Outcome, Readers, Seed, damaged, serve, write_files

PATIENCE = 6
"""A process is ended after this many times its limit of processor time: others run beside it."""

STARTS_WITHIN_S = 300.0

_LIMITS = Limits()


@dataclass
class Tally:
    """The outcomes of all inputs.

    Attributes
    ----------
    inputs, accepted : Counter
        Counts by reader.
    findings : dict of str to str
        Description of the first input with each finding, by reader, line of the sources and kind of finding.
    memory_bytes : int
        The largest amount that one input took.
    """

    inputs: Counter[str] = field(default_factory=Counter)
    accepted: Counter[str] = field(default_factory=Counter)
    findings: dict[str, str] = field(default_factory=dict)
    memory_bytes: int = 0


class Worker:
    """A process that reads inputs; it is started when needed, and again after it was lost."""

    def __init__(self, folder: Path, readers: Readers, seeds: Sequence[Seed], limits: Limits) -> None:
        self.folder, self.readers, self.seeds, self.limits = folder, readers, seeds, limits
        self.patience_s = PATIENCE * limits.cpu_s
        self.process: SpawnProcess | None = None

    def start(self) -> None:
        """Start the process and have it read the undamaged seeds."""
        context = multiprocessing.get_context("spawn")
        self.pipe, theirs = context.Pipe()
        wholes = [(seed.reader, seed.files) for seed in self.seeds]
        given = (theirs, self.folder, self.readers, wholes, self.limits)
        self.process = context.Process(target=serve, args=given, daemon=True)
        self.process.start()
        theirs.close()
        if not self.pipe.poll(STARTS_WITHIN_S):
            raise SystemExit(f"a process has not read the whole seeds within {STARTS_WITHIN_S:g} s")
        for seed, outcome in zip(self.seeds, self.pipe.recv(), strict=True):
            if outcome.finding:
                raise SystemExit(f"the whole {seed.name}: {outcome.finding} ({outcome.where})")

    def read(self, reader: str, files: Files) -> Outcome:
        """Have the process read an input."""
        if self.process is None:
            self.start()
        try:
            self.pipe.send((reader, files))
            if not self.pipe.poll(self.patience_s):
                self.stop()
                return Outcome(False, f"hang: no answer within {self.patience_s:g} s")
            outcome: Outcome = self.pipe.recv()
        except (EOFError, OSError):
            return Outcome(False, f"crash: exit code {self.stop()}")
        return outcome

    def stop(self) -> int | None:
        """End the process, and return its exit code."""
        if self.process is None:
            return None
        self.pipe.close()
        self.process.join(1.0)
        self.process.kill()
        self.process.join()
        code, self.process = self.process.exitcode, None
        return code


def fuzz(
    readers: Readers,
    seeds: Sequence[Seed],
    numbers: Sequence[int],
    *,
    keep: Path | None = None,
    jobs: int = 1,
    limits: Limits = _LIMITS,
) -> Tally:
    """Read damaged inputs, made from each of the seeds in turn, and print the findings.

    Parameters
    ----------
    readers : Readers
    seeds : sequence of Seed
    numbers : sequence of int
        Numbers of the inputs; the same number produces the same input.
    keep : Path or None
        Folder in which inputs with findings are kept.
    jobs : int
        Number of parallel processes.
    limits : Limits
    """
    tally, lock = Tally(), Lock()

    def share(folder: Path, job: int) -> None:
        worker = Worker(folder / str(job), readers, seeds, limits)
        for at in range(job, len(numbers), jobs):
            seed = seeds[at % len(seeds)]
            files = damaged(seed, numbers[at])
            outcome = worker.read(seed.reader, files)
            with lock:
                found = _note(tally, seed, numbers[at], outcome)
            if found and keep is not None:
                write_files(keep / f"{seed.reader}-{seed.form}-{numbers[at]}".replace(" ", "_"), files)
        worker.stop()

    with TemporaryDirectory(prefix="fuzz") as folder, ThreadPoolExecutor(jobs) as pool:
        list(pool.map(partial(share, Path(folder)), range(jobs)))
    return tally


def _note(tally: Tally, seed: Seed, number: int, outcome: Outcome) -> bool:
    """Count an outcome; return whether it is a new finding."""
    tally.inputs[seed.reader] += 1
    tally.accepted[seed.reader] += outcome.accepted
    tally.memory_bytes = max(tally.memory_bytes, outcome.memory_bytes)
    key = f"{seed.reader if outcome.where else seed.name} {outcome.where} {outcome.finding.partition(':')[0]}"
    if not outcome.finding or key in tally.findings:
        return False
    words = f"{seed.name} --seed {number}: {outcome.finding[:400]!a} ({outcome.where})"
    tally.findings[key] = words
    print(words, flush=True)
    return True


def whole_seeds(only: str = "") -> list[Seed]:
    """Return a valid input of every format of every reader, or of those whose ``reader/form`` begins with ``only``."""
    with TemporaryDirectory() as name:
        # The writers belong to the tests.
        importlib.import_module("tests.seeds").write_seeds(Path(name))
        seeds = []
        for reader in sorted(Path(name).iterdir()):
            forms = {form.name: dict(_contents(form)) for form in sorted(reader.iterdir())}
            others = tuple(content for files in forms.values() for content in files.values())
            seeds += [Seed(reader.name, form, files, others) for form, files in forms.items()]
        return [seed for seed in seeds if seed.name.startswith(only)]


def _contents(folder: Path) -> Iterator[tuple[str, bytes]]:
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            yield str(path.relative_to(folder)), path.read_bytes()


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else None)
    parser.add_argument("--inputs", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0, help="the number of the first input")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--only", default="", metavar="READER[/FORM]", help="what the names begin with")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="where to keep the inputs that show something")
    return parser.parse_args()


def main() -> None:
    """Run the command."""
    asked = _arguments()
    seeds = whole_seeds(asked.only)
    if not seeds:
        raise SystemExit(f"--only is {asked.only!r}; needed is the beginning of one of {', '.join(READERS)}")
    started = time.monotonic()
    tally = fuzz(READERS, seeds, range(asked.seed, asked.seed + asked.inputs), keep=asked.keep, jobs=asked.jobs)
    for reader, count in sorted(tally.inputs.items()):
        print(
            f"{reader:12} {count:7} inputs, {tally.accepted[reader]:6} accepted, {count - tally.accepted[reader]:6} not"
        )
    print(
        f"{asked.inputs} inputs of {len(seeds)} formats in {time.monotonic() - started:.0f} s, at most "
        f"{tally.memory_bytes / 1e6:.0f} MB for one; {len(tally.findings)} findings"
    )
    sys.exit(bool(tally.findings))


if __name__ == "__main__":
    main()
