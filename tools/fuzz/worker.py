"""A process that reads damaged inputs, so that a crash, a hang or hunger for memory ends nothing else."""

from __future__ import annotations

import os
import random
import shutil
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TypeAlias

from laci_stereo.core.errors import LaciError
from tools.fuzz.mutate import Files, mutated

if sys.platform == "linux":
    import resource

Readers: TypeAlias = Mapping[str, Callable[[Path], object]]
"""What reads the files in a folder, by name; functions of modules, for they go to another process."""

LONGEST_MESSAGE = 1000
GUARD = 4
"""Address space may grow by so many times the memory that may be used, for what is never touched costs nothing."""


@dataclass(frozen=True)
class Limits:
    """What one input may take.

    Attributes
    ----------
    memory_bytes : int
        Beyond what the readers' libraries hold.
    cpu_s : float
        Of the processor; inputs have at most 1 MB, and 0.1 MB/s is slower than any reader should be.
    """

    memory_bytes: int = 1 << 30
    cpu_s: float = 10.0


@dataclass(frozen=True)
class Seed:
    """A valid input.

    Attributes
    ----------
    reader, form : str
        The reader's name, and that of the format.
    files : Files
    others : tuple of bytes
        Of the same reader, to splice.
    """

    reader: str
    form: str
    files: Files
    others: tuple[bytes, ...]

    @property
    def name(self) -> str:
        """What tells it from the others."""
        return f"{self.reader}/{self.form}"


@dataclass(frozen=True)
class Outcome:
    """What became of an input.

    Attributes
    ----------
    accepted : bool
        It was read, not refused.
    finding : str
        What must not be, in words; empty if all is well.
    where : str
        The line of the sources that it comes from.
    memory_bytes : int
        That it took, beyond what the process had.
    """

    accepted: bool
    finding: str
    where: str = ""
    memory_bytes: int = 0


def damaged(seed: Seed, number: int) -> dict[str, bytes]:
    """Return the input of a number from a seed; always the same."""
    return mutated(seed.files, seed.others, random.Random(f"{seed.name} {number}"))


def write_files(folder: Path, files: Files) -> None:
    """Write files in a folder."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def serve(
    pipe: Connection, folder: Path, readers: Readers, wholes: Sequence[tuple[str, Files]], limits: Limits
) -> None:
    """Read the inputs that come through a pipe in a folder, and answer with what became of each."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # libraries in C write there whatever they like
    # The whole seeds first: what libraries need once is no input's fault.
    pipe.send([_attempt(readers[reader], folder, files, Limits(1 << 40)) for reader, files in wholes])
    _guard_memory(GUARD * limits.memory_bytes)
    for reader, files in _asked(pipe):
        pipe.send(_attempt(readers[reader], folder, files, limits))


def _asked(pipe: Connection) -> Iterator[tuple[str, Files]]:
    try:
        while True:
            yield pipe.recv()
    except EOFError:
        return


def _guard_memory(more_bytes: int) -> None:
    """Limit the address space, where the system tells how much of it there is already."""
    if sys.platform == "linux":
        limit = _status_bytes("VmSize") + more_bytes
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _status_bytes(entry: str) -> int:
    """Return what Linux tells of this process's memory; elsewhere 0."""
    if sys.platform != "linux":
        return 0
    text = Path("/proc/self/status").read_text(encoding="ascii")
    return 1024 * int(text.partition(entry + ":")[2].split()[0])


def _forget_peak() -> None:
    if sys.platform == "linux":
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")  # man 5 proc: begins VmHWM anew


def _attempt(read: Callable[[Path], object], folder: Path, files: Files, limits: Limits) -> Outcome:
    shutil.rmtree(folder, ignore_errors=True)
    write_files(folder, files)
    _forget_peak()
    held_bytes, started = _status_bytes("VmRSS"), time.process_time()
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        accepted, finding, where = _judged(read, folder)
    taken_s, taken_bytes = time.process_time() - started, _status_bytes("VmHWM") - held_bytes
    if not finding and warned:
        finding, where = f"warning {warned[0].message}", f"{warned[0].filename}:{warned[0].lineno}"
    if not finding and taken_s > limits.cpu_s:
        finding = f"hang: {taken_s:.1f} s of the processor"
    if not finding and taken_bytes > limits.memory_bytes:
        finding = f"memory: {taken_bytes / 1e6:.0f} MB"
    return Outcome(accepted, finding, where, taken_bytes)


def _judged(read: Callable[[Path], object], folder: Path) -> tuple[bool, str, str]:
    """Return whether an input was accepted, what must not be, and where."""
    try:
        read(folder)
    except LaciError as error:
        return False, _fault(error), _place(error)
    except BaseException as error:  # a panic of a library in Rust is no Exception
        return False, f"{type(error).__name__}: {error}", _place(error)
    return True, "", ""


def _fault(error: LaciError) -> str:
    """Return what is wrong with a refusal; empty if nothing is."""
    message = str(error)
    if len(message.splitlines()) != 1 or not message.strip():
        return f"message of {len(message.splitlines())} lines: {message!r}"
    if len(message) > LONGEST_MESSAGE:
        return f"message of {len(message)} characters: {message!r}"
    cause: BaseException | None = error.__cause__ or error.__context__
    while cause is not None:
        if isinstance(cause, MemoryError) or "bad_alloc" in str(cause) or "OutOfMemory" in str(cause):
            return f"memory: {type(cause).__name__} behind {message!r}"
        cause = cause.__cause__ or cause.__context__
    return ""


def _place(error: BaseException) -> str:
    """Return the innermost line of the project's own."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if "site-packages" not in frame.filename and sys.prefix not in frame.filename]
    frame = (ours or frames)[-1]
    return f"{Path(frame.filename).name}:{frame.lineno}"
