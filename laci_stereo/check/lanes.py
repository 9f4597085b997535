"""Find a map's lines around a sensor, and judge a calibration by where they are."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from laci_stereo.check.align import LEAST_MOVED, Alignment, align, apart, planar_rows
from laci_stereo.check.fit import Offsets, PlanarError, covariance_of, fit_planar
from laci_stereo.check.placed import Placed
from laci_stereo.check.profiles import OFFSETS_M
from laci_stereo.check.ridges import WIDTHS_M
from laci_stereo.check.sections import MAYBE, PAINTED, WALLS, Sections, sections_of
from laci_stereo.check.traces import SURE, Traces
from laci_stereo.check.verdict import Evidence, Judgement, judge
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray
from laci_stereo.io.lane_map import LaneLine

MAP_SIGMA_M = 0.05
"""Default of a map's own error: surveys for maps of lanes promise 5 to 10 cm."""

LEAST_SECTIONS = 3
"""Of a line in view, or it is not counted: the length of a dash."""

DASHED_SHARE = 1 / 3
"""What of a dashed line is painted: dashes half as long as their gaps (RMS)."""

FOUND_SHARE = 0.5
"""A line is found where so much of its paint is."""

PALE = 1 / 3
"""A line's paint is nowhere so much paler than where it is fresh, the middle of its brightest part."""

GATE = 3.0
"""Standard deviations within which a line's paint is looked for once the others tell where it should be."""

ASTRAY = 4.0
"""Standard deviations beyond which a line is off on its own: at 40 lines, noise alone passes in one of 400 maps."""

ROUNDS = 5

See: TypeAlias = Callable[[Sections], Traces]
"""Looks for what the map shows across sections of its lines."""


@dataclass(frozen=True)
class LineCheck:
    """One line of the map.

    Attributes
    ----------
    id, kind : str
        As in the map.
    in_view_m, hidden_m, found_m : float
        Length that should be seen, that the background hides, and that was found: none of a line less than half of
        which is.
    found : bool
        It is seen as much as it should be.
    offset_m, sigma_m : float or None
        Where what it stands for is to its left, as the calibration has it, and how well that is measured; None where
        there is none.
    offset_px, sigma_px : float or None
        The same in the image; None without an image.
    astray : bool
        It is off on its own, not with the others.
    """

    id: str
    kind: str
    in_view_m: float
    hidden_m: float
    found_m: float
    found: bool
    offset_m: float | None = None
    sigma_m: float | None = None
    offset_px: float | None = None
    sigma_px: float | None = None
    astray: bool = False


@dataclass(frozen=True)
class LaneCheck:
    """How a map's lines lie on the road's.

    Attributes
    ----------
    judgement : Judgement
    lines : tuple of LineCheck
        Those in view.
    error : PlanarError or None
        None where nothing was found.
    residual_m, residual_px : float or None
        Root mean square of the offsets of all sections that were found, those of lines that are astray left out.
    offsets : Offsets or None
        Of all sections that were found.
    hidden : Sections
        What the background hides.
    astray : frozenset of int
        Indices of the lines that are off on their own.
    """

    judgement: Judgement
    lines: tuple[LineCheck, ...]
    error: PlanarError | None
    residual_m: float | None
    residual_px: float | None
    offsets: Offsets | None
    hidden: Sections
    astray: frozenset[int] = frozenset()

    @property
    def lines_found(self) -> int:
        """How many of the lines in view were found."""
        return sum(line.found for line in self.lines)

    @property
    def lines_sought(self) -> int:
        """How many lines in view were found or should have been."""
        return _sought(self.lines)


@dataclass(frozen=True)
class View:
    """What was seen of a map's lines.

    Attributes
    ----------
    sections, traces
        Of what is in view, alike in length.
    hidden : Sections
    alone_m : ndarray, shape (n,)
        By how much paint may be off where the calibration is right, one sigma.
    least : ndarray, shape (lines,)
        In how many sections each line is seen at least, if it is found.
    """

    sections: Sections
    traces: Traces
    hidden: Sections
    alone_m: FloatArray
    least: FloatArray


@dataclass(frozen=True)
class Fitted:
    """Paint that was found, and what the calibration's error is by it."""

    offsets: Offsets
    error: PlanarError
    astray: frozenset[int]

    @property
    def together(self) -> BoolArray:
        """Which sections are of lines that are not astray, shape (n,)."""
        return ~np.isin(self.offsets.sections.line, list(self.astray))


def check_lanes(
    lines: Sequence[LaneLine],
    placed: Placed,
    see: See,
    map_sigma_m: float = MAP_SIGMA_M,
    kinds: Sequence[str] = PAINTED,
) -> LaneCheck:
    """Hold a map against what a sensor saw.

    Parameters
    ----------
    lines : sequence of LaneLine
    placed : Placed
    see : callable
    map_sigma_m : float
        Standard deviation of a line's place in the map.
    kinds : sequence of str
        Of lines that the sensor can see.
    """
    view = _look(lines, placed, see, map_sigma_m, kinds)
    if len(view.sections) == 0:
        return LaneCheck(judge(Evidence(0, 0, 0.0), None), (), None, None, None, None, view.hidden)
    alignment = align(view.traces.evidence, view.alone_m, view.sections)
    fitted = _fit(view, alignment.offsets(view.sections), placed, map_sigma_m)
    checked = tuple(
        _line_checked(lines[number], number, view, fitted, placed) for number in np.unique(view.sections.line).tolist()
    )
    astray = sum(line.astray for line in checked)
    together = sum(line.found for line in checked) - astray
    rival = max(
        (other.share for other in alignment.rivals if _ends_elsewhere(other, fitted, view, placed, map_sigma_m)),
        default=0.0,
    )
    judgement = judge(Evidence(_sought(checked), together, rival, astray), None if fitted is None else fitted.error)
    if fitted is None:
        return LaneCheck(judgement, checked, None, None, None, None, view.hidden)
    left_m = fitted.offsets.left_m[fitted.together]
    residual_px = _rms(left_m / fitted.offsets.cell_m[fitted.together]) if view.traces.in_image else None
    return LaneCheck(
        judgement,
        checked,
        fitted.error,
        residual_m=_rms(left_m),
        residual_px=residual_px,
        offsets=fitted.offsets,
        hidden=view.hidden,
        astray=fitted.astray,
    )


def _sought(lines: Sequence[LineCheck]) -> int:
    return sum(line.found or line.kind not in MAYBE for line in lines)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _look(lines: Sequence[LaneLine], placed: Placed, see: See, map_sigma_m: float, kinds: Sequence[str]) -> View:
    """Find what of the lines can be seen, and what is seen across it."""
    whole = sections_of(lines, placed.origin[:2], kinds)
    tall = np.array([line.kind in WALLS for line in lines], dtype=bool)[whole.line]
    behind = placed.hidden(whole.xy) & ~tall  # a wall hides itself, and is seen over what is lower
    sections, hidden = whole[~behind], whole[behind]
    traces = see(sections)
    visible = np.isfinite(traces.cell_m)
    counts = np.bincount(sections.line[visible], minlength=len(lines))
    kept = visible & (counts[sections.line] >= LEAST_SECTIONS)
    sections, traces = sections[kept], traces[kept]
    still = Offsets(sections, np.zeros(len(sections)), traces.cell_m, traces.loose_m)
    own = covariance_of(still, placed, map_sigma_m)
    painted = np.array([DASHED_SHARE if line.subtype == "dashed" else 1.0 for line in lines])
    least = FOUND_SHARE * painted * np.bincount(sections.line, minlength=len(lines))
    return View(sections, traces, hidden[np.isfinite(see(hidden).cell_m)], np.sqrt(np.diag(own)), least)


def _fit(view: View, expected_m: FloatArray, placed: Placed, map_sigma_m: float) -> Fitted | None:
    """Measure paint near to where it is expected, and fit, until both agree; lines that are astray stay out."""
    fitted, astray = None, frozenset[int]()
    for _ in range(ROUNDS):
        index, left_m = _measured(view, expected_m)
        if len(index) == 0:
            return None
        offsets = Offsets(view.sections[index], left_m, view.traces.cell_m[index], view.traces.loose_m[index])
        if np.isin(offsets.sections.line, list(astray)).all():
            astray = frozenset()
        error = fit_planar(offsets[~np.isin(offsets.sections.line, list(astray))], placed, map_sigma_m)
        fitted = Fitted(offsets, error, astray)
        expected_m = planar_rows(view.sections, error.centre) @ error.value
        astray = _astray(offsets, np.abs(left_m - expected_m[index]) / view.alone_m[index])
    return fitted


def _ends_elsewhere(rival: Alignment, fitted: Fitted | None, view: View, placed: Placed, map_sigma_m: float) -> bool:
    """Tell whether what is found from a rival's start lies elsewhere, as far as a rival must be."""
    other = _fit(view, rival.offsets(view.sections), placed, map_sigma_m)
    if fitted is None or other is None:
        return False
    ends = [planar_rows(view.sections, each.centre) @ each.value for each in (fitted.error, other.error)]
    return bool(apart(ends[1] - ends[0], view.alone_m).sum() >= LEAST_MOVED)


def _measured(view: View, expected_m: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return which sections have a stripe near to where it is expected, the nearest one, and where its middle is."""
    beside = np.abs(OFFSETS_M - expected_m[:, None]) / np.maximum(view.alone_m, WIDTHS_M[0] / GATE)[:, None]
    likely = np.where(beside <= GATE, view.traces.peaks * np.exp(-0.5 * beside**2), 0.0)
    best = likely.argmax(axis=1)
    rows = np.arange(len(best))
    sigmas = np.where(likely[rows, best] > 0.0, view.traces.sigmas[rows, best], 0.0)
    line = view.sections.line
    index = np.flatnonzero(sigmas >= np.maximum(SURE, _paler(sigmas, line)))
    found = np.bincount(line[index], minlength=len(view.least)) >= view.least
    index = index[found[line[index]]]  # of a line that is not found, a few sections are something else
    return index, view.traces.left_m[index, best[index]]


def _paler(sigmas: FloatArray, line: IntArray) -> FloatArray:
    """Return for each section what is too pale to be its line's paint, shape (n,): between dashes there is texture."""
    most = np.zeros(line.max(initial=0) + 1)
    for number in np.unique(line):
        most[number] = PALE * np.quantile(sigmas[line == number], 1.0 - DASHED_SHARE / 2)
    return most[line]


def _astray(offsets: Offsets, beside: FloatArray) -> frozenset[int]:
    """Return the lines that lie elsewhere than the others, ``beside`` so many sigma; no more than a third of them."""
    numbers = np.unique(offsets.sections.line)
    medians = np.array([np.median(beside[offsets.sections.line == number]) for number in numbers])
    worst = np.argsort(-medians)[: len(numbers) // 3]
    return frozenset(int(numbers[i]) for i in worst if medians[i] > ASTRAY)


def _line_checked(line: LaneLine, number: int, view: View, fitted: Fitted | None, placed: Placed) -> LineCheck:
    in_view, hidden = (int((each.line == number).sum()) for each in (view.sections, view.hidden))
    mine = None if fitted is None else fitted.offsets[fitted.offsets.sections.line == number]
    if fitted is None or mine is None or len(mine) == 0:
        return LineCheck(line.id, line.kind, in_view, hidden, 0, found=False)
    weights = np.linalg.inv(covariance_of(mine, placed, 0.0))
    sigma_m = 1.0 / float(np.sqrt(weights.sum()))
    mean = weights.sum(axis=0) * sigma_m**2
    per_m = float(mean @ (1.0 / mine.cell_m)) if view.traces.in_image else None
    offset_m = float(mean @ mine.left_m)
    return LineCheck(
        line.id,
        line.kind,
        in_view,
        hidden,
        len(mine),
        found=True,
        offset_m=offset_m,
        sigma_m=sigma_m,
        offset_px=None if per_m is None else float(mean @ (mine.left_m / mine.cell_m)),
        sigma_px=None if per_m is None else sigma_m * per_m,
        astray=number in fitted.astray,
    )
