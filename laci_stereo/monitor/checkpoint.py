"""``state.json``: a monitor's checkpoint, from which it resumes after it was ended or killed."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from laci_stereo.core.errors import OutputError
from laci_stereo.core.frames import IntArray
from laci_stereo.core.settings import TrackSettings
from laci_stereo.core.tracking.box import Box
from laci_stereo.core.tracking.sighting import Sighting
from laci_stereo.core.tracking.tracks import Moving
from laci_stereo.io.output import write_file
from laci_stereo.monitor.kept import Kept
from laci_stereo.monitor.linking import Linker, Live
from laci_stereo.monitor.tally import StripTally, Tally

SCHEMA = "laci-monitor-state/2"


@dataclass
class State:
    """The state from which a monitor resumes.

    Attributes
    ----------
    identity : mapping of str to str
        Identity of the calibration, the map, the recording and the settings (hashes or values), by name.
    frames : int
        Number of frames processed.
    stamps_sha256 : str
        Hash of their times, see `sha256_of`.
    epoch_ns : int
        Time of the first frame, Unix, nanoseconds.
    last_ns : int
        Time of the last frame processed, Unix, nanoseconds.
    table_bytes : int
        Length of ``objects.csv``.
    objects : int
        Number of passages in that table.
    unusable : int
        Number of processed frames that could not be read.
    linker : Linker
        Tracks in progress.
    tally : Tally
        Counts so far.
    """

    identity: Mapping[str, str]
    frames: int = 0
    stamps_sha256: str = ""
    epoch_ns: int = 0
    last_ns: int = 0
    table_bytes: int = 0
    objects: int = 0
    unusable: int = 0
    linker: Linker = field(default_factory=Linker)
    tally: Tally = field(default_factory=Tally)


def sha256_of(stamps_ns: IntArray) -> str:
    """Return the SHA-256 of frames' times, as little-endian 64-bit integers."""
    return hashlib.sha256(np.ascontiguousarray(stamps_ns, dtype="<i8").tobytes()).hexdigest()


def write_state(path: Path, state: State) -> None:
    """Write a checkpoint atomically: on failure, the previous one is kept.

    Raises
    ------
    OutputError
    """
    document = {
        "schema": SCHEMA,
        **{name: value for name, value in vars(state).items() if name not in ("linker", "tally")},
        "active": [_of_live(live) for live in state.linker.active],
        "lost": [_of_live(live) for live in state.linker.lost],
        "recent_s": state.linker.recent_s,
        "tally": _of_tally(state.tally),
    }
    write_file(path, (json.dumps(document, allow_nan=False) + "\n").encode())


def read_state(path: Path, settings: TrackSettings) -> State:
    """Read a checkpoint.

    Raises
    ------
    OutputError
        If the file is not a checkpoint, or one of another schema.
    """
    try:
        document = json.loads(path.read_bytes())
        if document["schema"] != SCHEMA:
            raise OutputError(f"{path}: schema is {document['schema']!r}; needed is {SCHEMA}, or --overwrite")
        return _parsed(document, settings)
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as problem:
        raise OutputError(
            f"{path} is no checkpoint of a monitor: {problem!r}; needed is one, or --overwrite"
        ) from problem


def check_same(path: Path, found: Mapping[str, str], asked: Mapping[str, str]) -> None:
    """Check that the identity found in a checkpoint is the identity asked for.

    Raises
    ------
    OutputError
        If they differ, with the name of the first difference.
    """
    for name in sorted({*found, *asked}):
        if found.get(name) == asked.get(name):
            continue
        values = [of.get(name, "not set") for of in (found, asked)]
        differs = f"is {values[0]}, asked for is now {values[1]}"
        if all(re.fullmatch(r"[0-9a-f]{64}", value) for value in values):
            differs = f"is {values[0][:8]}..., asked for is now {values[1][:8]}... (SHA-256), so it is another one"
        raise OutputError(
            f"{path}: the checkpoint's {name} {differs}; needed is the same, another --out, or --overwrite to start "
            "afresh"
        )


def _parsed(document: Mapping[str, Any], settings: TrackSettings) -> State:
    return State(
        identity=dict(document["identity"]),
        frames=int(document["frames"]),
        stamps_sha256=str(document["stamps_sha256"]),
        epoch_ns=int(document["epoch_ns"]),
        last_ns=int(document["last_ns"]),
        table_bytes=int(document["table_bytes"]),
        objects=int(document["objects"]),
        unusable=int(document["unusable"]),
        linker=Linker(
            [_live(one, settings) for one in document["active"]],
            [_live(one, settings) for one in document["lost"]],
            list(map(float, document["recent_s"])),
        ),
        tally=_tally(document["tally"]),
    )


def _of_tally(tally: Tally) -> dict[str, Any]:
    cells = [[*cell, count] for cell, count in sorted(tally.cells.items())]
    strips = {name: {**vars(one), "profile": sorted(one.profile.items())} for name, one in tally.strips.items()}
    return {**vars(tally), "cells": cells, "strips": strips}


def _tally(document: Mapping[str, Any]) -> Tally:
    cells = Counter({(i, j): count for i, j, count in document["cells"]})
    strips = {
        name: StripTally(**{**strip, "profile": Counter(dict(strip["profile"]))})
        for name, strip in document["strips"].items()
    }
    return Tally(**{**document, "cells": cells, "strips": strips})


def _of_live(live: Live) -> dict[str, Any]:
    moving = live.moving
    return {
        "last": [_of_sighting(one) for one in moving.sightings],
        "state": moving.state.tolist(),
        "covariance": moving.covariance.tolist(),
        "head": [_of_sighting(one) for one in live.head],
        "kept": [_of_kept(one) for one in live.kept],
    }


def _live(document: Mapping[str, Any], settings: TrackSettings) -> Live:
    last = [_sighting(one) for one in document["last"]]
    moving = Moving(last[0], settings)
    moving.sightings = last
    moving.state, moving.covariance = np.array(document["state"]), np.array(document["covariance"])
    return Live(moving, [_sighting(one) for one in document["head"]], [_kept(one) for one in document["kept"]])


def _of_kept(kept: Kept) -> list[Any]:
    outline = base64.b64encode(kept.outline.tobytes()).decode()
    return [kept.frame, kept.stamp_s, kept.middle.tolist(), kept.whole, outline, kept.top_m, kept.sigma_m]


def _kept(values: Sequence[Any]) -> Kept:
    frame, stamp_s, middle, whole, outline, top_m, sigma_m = values
    points = np.frombuffer(base64.b64decode(outline), dtype=np.int16).reshape(-1, 2)
    return Kept(frame, stamp_s, np.array(middle), whole, points, top_m, sigma_m)


def _of_sighting(sighting: Sighting) -> list[float]:
    return [sighting.stamp_s, sighting.frame_s, *sighting.middle.tolist(), sighting.count]


def _sighting(values: list[float]) -> Sighting:
    """Return a sighting with the fields that the linking needs; the others are empty."""
    stamp_s, frame_s, x, y, count = values
    nothing, middle = np.zeros(0), np.array([x, y])
    box = Box(middle, 0.0, 0.0, 0.0)
    return Sighting(stamp_s, frame_s, np.zeros((0, 3)), nothing, nothing, int(count), middle, box, None)
