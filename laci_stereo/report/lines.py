"""Splitting of polylines: into short pieces, at clipping planes, and into dashes."""

from __future__ import annotations

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, along_line

MAX_STEPS = 2000
"""Largest number of pieces of one segment, which bounds the cost of segments of many kilometres."""


def subdivide(line: FloatArray, step: float) -> FloatArray:
    """Subdivide a line, shape (n, d), into pieces of at most ``step``, or `MAX_STEPS` per segment; keep its points."""
    lengths = np.linalg.norm(np.diff(line, axis=0), axis=1)
    steps = np.clip(np.ceil(lengths / step), 1, MAX_STEPS).astype(int)
    place = np.concatenate([i + np.arange(n) / n for i, n in enumerate(steps)] + [[len(steps)]])
    return _at(line, place, np.arange(len(line), dtype=np.float64))


def clip(line: FloatArray, inside: FloatArray) -> list[FloatArray]:
    """Return the pieces of a line, shape (n, d), on which a linear function is not negative.

    ``inside``, shape (n,), holds the values of the function at the line's points.
    """
    crossing = np.flatnonzero((inside[:-1] < 0) != (inside[1:] < 0))
    share = inside[crossing] / (inside[crossing] - inside[crossing + 1])
    border = line[crossing] + share[:, None] * (line[crossing + 1] - line[crossing])
    cut = np.insert(line, crossing + 1, border, axis=0)
    return [cut[run] for run in runs(np.insert(inside, crossing + 1, 0.0) >= 0)]


def clip_slab(line: FloatArray, axis: int, low: float, high: float) -> list[FloatArray]:
    """Return the pieces of a line, shape (n, d), whose coordinate on ``axis`` is between ``low`` and ``high``."""
    above = clip(line, line[:, axis] - low)
    return [piece for part in above for piece in clip(part, high - part[:, axis])]


def runs(kept: BoolArray) -> list[slice]:
    """Return the runs of at least two consecutive True values, as slices."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]]).astype(np.int8)))
    return [slice(start, stop) for start, stop in edges.reshape(-1, 2) if stop - start > 1]


def dashes(line: FloatArray, on: float, off: float) -> list[FloatArray]:
    """Return the dashes, of length ``on`` with gaps of ``off`` between them, of a line, shape (n, d)."""
    along = along_line(line)
    if along[-1] == 0.0:
        return []
    starts = np.arange(0.0, along[-1], on + off)
    stops = np.minimum(starts + on, along[-1])
    # All dashes at once: a picture has thousands of them.
    dash = np.searchsorted(starts, along, side="right") - 1
    inner = (along > starts[dash]) & (along < stops[dash])
    every = np.arange(len(starts))
    places, owners = np.concatenate([starts, along[inner], stops]), np.concatenate([every, dash[inner], every])
    order = np.lexsort((places, owners))
    return np.split(_at(line, places[order], along), np.flatnonzero(np.diff(owners[order])) + 1)


def _at(line: FloatArray, places: FloatArray, along: FloatArray) -> FloatArray:
    """Return the points of a line, shape (n, d), at the values ``places``, shape (m,), of its parameter ``along``."""
    return np.stack([np.interp(places, along, axis) for axis in line.T], axis=1)
