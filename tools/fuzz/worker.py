"""A process that reads damaged inputs, so that a crash, a hang or exhausted memory ends nothing else."""

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
"""Functions that read the files in a folder, by name; module-level ones, as they are pickled for another process."""

LONGEST_MESSAGE = 1000
GUARD = 4
"""The address space may grow by this many times the permitted memory, as untouched address space costs nothing."""


@dataclass(frozen=True)
class Limits:
    """Resources that one input may take.

    Attributes
    ----------
    memory_bytes : int
        In addition to what the readers' libraries hold.
    cpu_s : float
        Processor time; inputs have at most 1 MB, and 0.1 MB/s is slower than any reader should be.
    """

    memory_bytes: int = 1 << 30
    cpu_s: float = 10.0


@dataclass(frozen=True)
class Seed:
    """A valid input.

    Attributes
    ----------
    reader, form : str
        The names of the reader and of the format.
    files : Files
    others : tuple of bytes
        Files of the same reader, to splice.
    """

    reader: str
    form: str
    files: Files
    others: tuple[bytes, ...]

    @property
    def name(self) -> str:
        """The unique name of the seed."""
        return f"{self.reader}/{self.form}"


@dataclass(frozen=True)
class Outcome:
    """The outcome of reading an input.

    Attributes
    ----------
    accepted : bool
        Whether the input was read, not refused.
    finding : str
        Description of the misbehaviour, such as a crash or a warning; empty if there is none.
    where : str
        File and line of the sources that the finding comes from.
    memory_bytes : int
        Memory that reading took, in addition to the process's earlier use.
    """

    accepted: bool
    finding: str
    where: str = ""
    memory_bytes: int = 0


def damaged(seed: Seed, number: int) -> dict[str, bytes]:
    """Return the damaged input with a number, made from a seed; the same number always gives the same input."""
    return mutated(seed.files, seed.others, random.Random(f"{seed.name} {number}"))


def write_files(folder: Path, files: Files) -> None:
    """Write files to a folder."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def serve(
    pipe: Connection, folder: Path, readers: Readers, wholes: Sequence[tuple[str, Files]], limits: Limits
) -> None:
    """Read the inputs that arrive through a pipe, in a folder, and answer with the outcome of each."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # C libraries write their own messages to stderr
    # The undamaged seeds come first: what libraries need once is not charged to an input.
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
    """Limit the address space, on systems that report its present size."""
    if sys.platform == "linux":
        limit = _status_bytes("VmSize") + more_bytes
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _status_bytes(entry: str) -> int:
    """Return an entry of Linux's report on this process's memory, bytes; 0 on other systems."""
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
    """Return whether an input was accepted, the finding, and its place."""
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
    """Return the innermost line of the traceback within the project."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [frame for frame in frames if "site-packages" not in frame.filename and sys.prefix not in frame.filename]
    frame = (ours or frames)[-1]
    return f"{Path(frame.filename).name}:{frame.lineno}"
