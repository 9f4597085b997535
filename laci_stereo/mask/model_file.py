"""Checks of an ONNX file before it is loaded: its format, the location of its weights, and the memory needed.

Only the fields that lead to tensors are followed, with the encoding of Protocol Buffers and the field numbers of
``onnx.proto``, so that nothing of the file is copied and no further library is needed.
"""

from __future__ import annotations

import mmap
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from laci_stereo.mask.errors import MaskError

MODEL = {7: "graph", 25: "function"}
FIELDS = {
    "model": MODEL,
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "function": {7: "node"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 10: "tensor", 6: "graph", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
    "tensor": {13: "entry"},
}
"""Numbers of the fields that lead to tensors' entries on external data, for each type of message."""

MOST_BYTES = 2**31 - 1
"""Maximum length of a message in Protocol Buffers."""

COPIES = 2
"""Copies of the weights in memory while a model is loaded: as read, and as arranged by the runtime."""

DEEPEST = 40


@dataclass(frozen=True)
class _Part:
    """A message within the file."""

    kind: str
    start: int
    end: int
    depth: int


def check_model(path: Path) -> None:
    """Raise if a model cannot be loaded, before the runtime tries.

    Raises
    ------
    MaskError
        If the file is missing or no ONNX file, its external data are missing or outside its folder, or it needs more
        than the free memory.
    """
    try:
        size = path.stat().st_size
        external = _external(path) if path.is_file() and 0 < size <= MOST_BYTES else set[str]()
    except OSError as problem:
        raise MaskError(f"{path}: cannot be read ({problem.strerror}); needed is an ONNX file") from problem
    except (IndexError, ValueError, UnicodeDecodeError):
        raise MaskError(f"{path}: is not an ONNX file ({size} bytes); needed is a model exported as ONNX") from None
    if not path.is_file() or size == 0:
        what = "is a folder" if path.is_dir() else "is empty"
        raise MaskError(f"{path}: {what}; needed is an ONNX file")
    whole = size + sum(_size_of(path, name) for name in sorted(external))
    free = free_memory()
    if free is not None and COPIES * whole > free:
        raise MaskError(
            f"{path}: the model has {whole / 1e9:.1f} GB and needs {COPIES} times that while it is loaded; "
            f"{free / 1e9:.1f} GB of memory are free"
        )
    if size > MOST_BYTES:
        raise MaskError(
            f"{path}: the file has {size / 1e9:.1f} GB; needed are less than 2.1 GB, with the weights as external data"
        )


def free_memory() -> int | None:
    """Return the available memory in bytes; None if the system does not report it (only Linux does)."""
    try:
        found = re.search(r"^MemAvailable:\s+(\d+) kB", Path("/proc/meminfo").read_text(encoding="ascii"), re.MULTILINE)
    except OSError:
        return None
    free = None if found is None else 1024 * int(found[1])
    try:
        limit, used = (Path("/sys/fs/cgroup", name).read_text(encoding="ascii").strip() for name in _CGROUP)
    except OSError:
        return free
    if free is None or not limit.isdigit():
        return free
    return min(free, max(int(limit) - int(used), 0))


_CGROUP = ("memory.max", "memory.current")


def _size_of(model: Path, name: str) -> int:
    """Return the size of an external data file, which must be in the model's folder."""
    folder = model.parent.resolve()
    file = folder / name
    if Path(name).is_absolute() or not file.resolve().is_relative_to(folder):
        raise MaskError(f"{model}: its external data {name!r} lie outside of its folder; needed is a file in {folder}")
    try:
        return file.stat().st_size
    except OSError:
        raise MaskError(f"{model}: its external data {name!r} are missing; needed is that file beside it") from None


def _external(path: Path) -> set[str]:
    """Return the names of the external data files."""
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
        has_graph = any(number == 7 and span is not None for number, span in _fields(content, 0, len(content)))
        if not has_graph:
            raise ValueError("no graph")
        return set(_locations(content, _Part("model", 0, len(content), 0)))


def _locations(content: mmap.mmap, part: _Part) -> Iterator[str]:
    if part.depth > DEEPEST:
        raise ValueError("nested too deep")
    for number, span in _fields(content, part.start, part.end):
        kind = FIELDS[part.kind].get(number)
        if kind is None:
            continue
        if span is None:
            raise ValueError("a number where a message is due")
        if kind == "entry":
            entry = {key: content[slice(*at)].decode() for key, at in _fields(content, *span) if at is not None}
            if entry.get(1) == "location":
                yield entry.get(2, "")
        else:
            yield from _locations(content, _Part(kind, *span, part.depth + 1))


def _fields(content: mmap.mmap, at: int, end: int) -> Iterator[tuple[int, tuple[int, int] | None]]:
    """Yield the number of each field, and the range of its bytes; None if it is a number."""
    while at < end:
        key, at = _varint(content, at)
        number, wire = key >> 3, key & 7
        span = None
        if wire == 0:
            _, at = _varint(content, at)
        elif wire == 2:
            length, at = _varint(content, at)
            span, at = (at, at + length), at + length
        elif wire in (1, 5):
            at += 8 if wire == 1 else 4
        else:
            raise ValueError("no wire type")
        if at > end or number == 0:
            raise ValueError("beyond the end")
        yield number, span


def _varint(content: mmap.mmap, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        byte = content[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ValueError("a number without end")
