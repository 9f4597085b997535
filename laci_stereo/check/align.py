"""Alignment of a map's lines with paint: a search for the shift and turn at which most lines lie on stripes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from laci_stereo.check.profiles import OFFSETS_M, STEP_M
from laci_stereo.check.ridges import WIDTHS_M
from laci_stereo.check.sections import Sections
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray

SHIFT_M = 1.0
"""Search range in all directions: a calibration with a larger error is useless, and farther off lies a lane's other
line."""

TURN_RAD = np.radians(2.0)
GRID_M = 0.07
"""Largest distance between trial positions of a section: less than the tolerance, which is at least 5 cm, plus half of
the narrowest stripe."""

BESIDE = 3.0
"""Distance within which evidence counts, in tolerances."""

RIVAL_SHARE = 2 / 3
"""Fraction of the best alignment's evidence from which a second one counts as equally good: of three lines, two may
well be the only painted ones, while a wrong alignment finds one of two or three beside kerbs."""

MOST_RIVALS = 4
"""Largest number of rivals: the kerbs on both sides of a line, and the lane's other line."""

MOST_SECTIONS = 300
"""Largest number of sections, chosen uniformly: more sections of a line hardly add information on its position."""

LEAST_MOVED = 6.0
"""Number of sections that a rival must move to other paint: two dashes, because a single one may be matched by
chance."""


@dataclass(frozen=True)
class Alignment:
    """Common displacement of the visible lines relative to the map's lines.

    Attributes
    ----------
    shift : ndarray, shape (2,)
        Displacement of what is at ``centre``, world, metres.
    turn_rad : float
        Counter-clockwise about ``centre``.
    centre : ndarray, shape (2,)
        Centre of the sections, world.
    share : float
        Of a rival: the fraction that it retains of the best alignment's evidence, in the sections that it moves to
        other paint.
    rivals : tuple of Alignment
        Alternatives that are about as good, no two of them alike.
    """

    shift: FloatArray
    turn_rad: float
    centre: FloatArray
    share: float = 1.0
    rivals: tuple[Alignment, ...] = ()

    def offsets(self, sections: Sections) -> FloatArray:
        """Return the offset of each section's paint to the left, metres, shape (n,)."""
        offsets: FloatArray = planar_rows(sections, self.centre) @ np.append(self.shift, self.turn_rad)
        return offsets


def planar_rows(sections: Sections, centre: FloatArray) -> FloatArray:
    """Return the derivatives of sections' offsets by shift and turn about a point, shape (n, 3)."""
    arm = sections.xy - centre
    turned = np.einsum("ij,ij->i", np.column_stack([-arm[:, 1], arm[:, 0]]), sections.left)
    return np.column_stack([sections.left, turned])


def align(evidence: FloatArray, tolerance_m: FloatArray, sections: Sections) -> Alignment:
    """Search a grid of shifts and turns for the alignment at which most sections lie on a stripe.

    Parameters
    ----------
    evidence : ndarray, shape (n, m)
        Evidence of stripes at `OFFSETS_M`, from 0 to 1.
    tolerance_m : ndarray, shape (n,)
        Standard deviation of each section's offset if the calibration is exact.
    sections : Sections
    """
    chosen = np.arange(0, len(sections), -(-len(sections) // MOST_SECTIONS))
    evidence, tolerance_m, sections = evidence[chosen], tolerance_m[chosen], sections[chosen]
    centre = sections.xy.mean(axis=0)
    rows = planar_rows(sections, centre)
    tried = _grid(rows)
    near = _spread_over(evidence, tolerance_m)
    support = np.concatenate([_support(near, part @ rows.T).sum(axis=1) for part in _parts(tried)])
    best = _most_central(tried, support)
    offsets = tried[best] @ rows.T
    held = _support(near, offsets[None])[0]
    moved = np.concatenate([apart(part @ rows.T - offsets, tolerance_m) @ held for part in _parts(tried)])
    shares = _shares(support, moved, best)
    good = shares >= RIVAL_SHARE
    tried_well, shares = tried[good], shares[good]
    rivals = tuple(
        Alignment(tried_well[i, :2], float(tried_well[i, 2]), centre, float(shares[i]))
        for i in _unlike(tried_well @ rows.T, shares, tolerance_m)
    )
    return Alignment(tried[best, :2], float(tried[best, 2]), centre, rivals=rivals)


def apart(difference_m: FloatArray, tolerance_m: FloatArray) -> BoolArray:
    """Return which offsets belong to different paint: they differ by more than its width and tolerance, (..., n)."""
    other: BoolArray = np.abs(difference_m) > 2 * tolerance_m + WIDTHS_M[0]
    return other


def _parts(tried: FloatArray) -> list[FloatArray]:
    """Split the trial alignments into parts whose evidence fits into little memory."""
    return np.array_split(tried, -(-len(tried) // 2000))


def _support(near: FloatArray, offsets_m: FloatArray) -> FloatArray:
    """Return the evidence at the sections' offsets, shape (t, n)."""
    return np.asarray(np.take_along_axis(near, _index(offsets_m).T, axis=1).T)


def _shares(support: FloatArray, moved: FloatArray, best: int) -> FloatArray:
    """Return the fraction of the best alignment's evidence that others retain in the sections that they move, (t,).

    Sections that an alignment leaves about where they are, such as those along its shift, support both alignments;
    evidence that it loses there counts against it.
    """
    kept = moved - (support[best] - support)
    return np.where(moved >= LEAST_MOVED, kept / np.maximum(moved, LEAST_MOVED), 0.0)


def _unlike(offsets_m: FloatArray, shares: FloatArray, tolerance_m: FloatArray) -> Iterator[int]:
    """Yield the best rivals, each of which places at least one section on other paint than the preceding ones."""
    left = np.arange(len(shares))
    for _ in range(MOST_RIVALS):
        if len(left) == 0:
            break
        best = int(left[shares[left].argmax()])
        yield best
        left = left[apart(offsets_m[left] - offsets_m[best], tolerance_m).any(axis=1)]


def _most_central(tried: FloatArray, support: FloatArray) -> int:
    """Return the index of the smallest of the best alignments, which are many if a direction is undetermined."""
    best = np.flatnonzero(support >= support.max() * (1 - 1e-6))
    size = np.abs(tried[best] / [SHIFT_M, SHIFT_M, TURN_RAD]).sum(axis=1)
    return int(best[np.argmin(size)])


def _grid(rows: FloatArray) -> FloatArray:
    """Return shifts and turns so dense that no section moves by more than `GRID_M` between neighbouring ones."""
    lever_m = max(float(np.abs(rows[:, 2]).max()), 1.0)
    shifts = np.arange(-SHIFT_M, SHIFT_M + GRID_M / 2, GRID_M)
    count = int(np.ceil(TURN_RAD * lever_m / GRID_M))
    turns = np.linspace(-TURN_RAD, TURN_RAD, 2 * count + 1)
    return np.stack(np.meshgrid(shifts, shifts, turns, indexing="ij"), axis=-1).reshape(-1, 3)


def _index(offsets_m: FloatArray) -> IntArray:
    """Return the index of the sample at an offset; outside the range, that of the last column, without evidence."""
    index = np.rint(offsets_m / STEP_M).astype(np.int64) + len(OFFSETS_M) // 2
    outside: BoolArray = (index < 0) | (index >= len(OFFSETS_M))
    return np.where(outside, len(OFFSETS_M), index)


def _spread_over(evidence: FloatArray, tolerance_m: FloatArray) -> FloatArray:
    """Let evidence also count at neighbouring offsets, with decreasing weight; append a column without evidence."""
    tolerance = tolerance_m / STEP_M
    spread = evidence.copy()
    for step in range(1, int(BESIDE * tolerance.max(initial=0.0)) + 1):
        share = np.exp(-0.5 * (step / tolerance) ** 2)[:, None]
        spread[:, step:] = np.maximum(spread[:, step:], share * evidence[:, :-step])
        spread[:, :-step] = np.maximum(spread[:, :-step], share * evidence[:, step:])
    return np.pad(spread, ((0, 0), (0, 1)))
