"""Lane check: finds a map's lines around a sensor, measures their offsets, and judges the calibration by these.

A line is astray if its offset contradicts those of the other lines.
"""

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
from laci_stereo.io.maps.lane_map import LaneLine

MAP_SIGMA_M = 0.05
"""Default standard deviation of a line's position in the map: surveys for lane maps specify 5 to 10 cm."""

LEAST_SECTIONS = 3
"""Least number of sections that a line must have in view to be counted: the length of a dash."""

DASHED_SHARE = 1 / 3
"""Painted fraction of a dashed line: dashes are half as long as their gaps (RMS)."""

FOUND_SHARE = 0.5
"""A line is found if at least this fraction of its paint is found."""

PALE = 1 / 3
"""Least contrast of a line's paint relative to fresh paint, for which the median of its most contrasting third is
taken."""

GATE = 3.0
"""Search range for a line's paint once the other lines predict its position, standard deviations."""

ASTRAY = 4.0
"""A line whose offset deviates from the others' by more standard deviations is astray: with 40 lines, noise alone
causes this in one of 400 maps."""

ROUNDS = 5

See: TypeAlias = Callable[[Sections], Traces]
"""Searches for the mapped features across sections of lines."""


@dataclass(frozen=True)
class LineCheck:
    """Result for one line of the map.

    Attributes
    ----------
    id, kind : str
        As in the map.
    in_view_m, hidden_m, found_m : float
        Length that should be visible, that the background hides, and along which the line was found; the last is 0 if
        less than half of its paint was found.
    found : bool
        At least half of the paint that should be visible was found.
    offset_m, sigma_m : float or None
        Position of the feature (paint, kerb or wall) to the left of the map's line according to the calibration, and
        the standard deviation of this measurement; None if it was not found.
    offset_px, sigma_px : float or None
        The same in the image, pixels; None without an image.
    astray : bool
        Its offset contradicts those of the other lines.
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
    """How a map's lines compare with the features that the sensor saw.

    Attributes
    ----------
    judgement : Judgement
    lines : tuple of LineCheck
        The lines in view.
    hidden : Sections
        Sections that the background hides.
    error : PlanarError or None
        None if nothing was found.
    residual_m, residual_px : float or None
        Root mean square of the offsets of all sections that were found, without those of astray lines.
    offsets : Offsets or None
        Of all sections that were found, astray lines included.
    astray : frozenset of int
        Indices of the astray lines.
    """

    judgement: Judgement
    lines: tuple[LineCheck, ...]
    hidden: Sections
    error: PlanarError | None = None
    residual_m: float | None = None
    residual_px: float | None = None
    offsets: Offsets | None = None
    astray: frozenset[int] = frozenset()

    @property
    def lines_found(self) -> int:
        """Number of lines in view that were found."""
        return sum(line.found for line in self.lines)

    @property
    def lines_sought(self) -> int:
        """Number of lines in view that were found or should have been found."""
        return _sought(self.lines)


@dataclass(frozen=True)
class View:
    """What the sensor saw of a map's lines.

    Attributes
    ----------
    sections, traces
        The sections in view and what was seen across them, of equal length.
    hidden : Sections
    alone_m : ndarray, shape (n,)
        Standard deviation of each section's offset if the calibration is exact.
    least : ndarray, shape (lines,)
        Least number of sections in which each line must be seen to be found.
    """

    sections: Sections
    traces: Traces
    hidden: Sections
    alone_m: FloatArray
    least: FloatArray


@dataclass(frozen=True)
class Fitted:
    """Sections in which paint was found, and the calibration's error estimated from them."""

    offsets: Offsets
    error: PlanarError
    astray: frozenset[int]

    @property
    def together(self) -> BoolArray:
        """Which sections belong to lines that are not astray, shape (n,)."""
        return ~np.isin(self.offsets.sections.line, list(self.astray))


def check_lanes(
    lines: Sequence[LaneLine],
    placed: Placed,
    see: See,
    map_sigma_m: float = MAP_SIGMA_M,
    kinds: Sequence[str] = PAINTED,
) -> LaneCheck:
    """Compare a map with what a sensor saw.

    Parameters
    ----------
    lines : sequence of LaneLine
    placed : Placed
        The calibration that is checked.
    see : callable
        Searches for the mapped features in the sensor's data.
    map_sigma_m : float
        Standard deviation of a line's position in the map.
    kinds : sequence of str
        Kinds of lines that the sensor can see.
    """
    view = _look(lines, placed, see, map_sigma_m, kinds)
    if len(view.sections) == 0:
        return LaneCheck(judge(Evidence(0, 0, 0.0), None), (), view.hidden)
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
        return LaneCheck(judgement, checked, view.hidden)
    left_m = fitted.offsets.left_m[fitted.together]
    residual_px = _rms(left_m / fitted.offsets.cell_m[fitted.together]) if view.traces.in_image else None
    return LaneCheck(
        judgement,
        checked,
        view.hidden,
        error=fitted.error,
        residual_m=_rms(left_m),
        residual_px=residual_px,
        offsets=fitted.offsets,
        astray=fitted.astray,
    )


def _sought(lines: Sequence[LineCheck]) -> int:
    return sum(line.found or line.kind not in MAYBE for line in lines)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _look(lines: Sequence[LaneLine], placed: Placed, see: See, map_sigma_m: float, kinds: Sequence[str]) -> View:
    """Cut the lines into sections, find those in view, and search for features across them."""
    whole = sections_of(lines, placed.origin[:2], kinds)
    tall = np.array([line.kind in WALLS for line in lines], dtype=bool)[whole.line]
    behind = placed.hidden(whole.xy) & ~tall  # a wall is itself in the background, and visible above lower objects
    sections, hidden = whole[~behind], whole[behind]
    traces = see(sections)
    visible = np.isfinite(traces.cell_m)
    counts = np.bincount(sections.line[visible], minlength=len(lines))
    kept = visible & (counts[sections.line] >= LEAST_SECTIONS)
    sections, traces = sections[kept], traces[kept]
    still = Offsets(sections, np.zeros(len(sections)), traces.cell_m, traces.loose_m)
    covariance = covariance_of(still, placed, map_sigma_m)
    painted = np.array([DASHED_SHARE if line.subtype == "dashed" else 1.0 for line in lines])
    least = FOUND_SHARE * painted * np.bincount(sections.line, minlength=len(lines))
    return View(sections, traces, hidden[np.isfinite(see(hidden).cell_m)], np.sqrt(np.diag(covariance)), least)


def _fit(view: View, expected_m: FloatArray, placed: Placed, map_sigma_m: float) -> Fitted | None:
    """Measure paint near its expected position and fit, without astray lines, repeatedly, so that both agree."""
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
    """Return whether the fit that starts from a rival differs from the best one in at least `LEAST_MOVED` sections."""
    moved = _fit(view, rival.offsets(view.sections), placed, map_sigma_m)
    if fitted is None or moved is None:
        return False
    ends = [planar_rows(view.sections, each.centre) @ each.value for each in (fitted.error, moved.error)]
    return bool(apart(ends[1] - ends[0], view.alone_m).sum() >= LEAST_MOVED)


def _measured(view: View, expected_m: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the indices of sections with a stripe near its expected position, and that stripe's offset, metres.

    The likelihood of a stripe decreases with the distance from the expected position.
    """
    beside = np.abs(OFFSETS_M - expected_m[:, None]) / np.maximum(view.alone_m, WIDTHS_M[0] / GATE)[:, None]
    likely = np.where(beside <= GATE, view.traces.peaks * np.exp(-0.5 * beside**2), 0.0)
    best = likely.argmax(axis=1)
    rows = np.arange(len(best))
    sigmas = np.where(likely[rows, best] > 0.0, view.traces.sigmas[rows, best], 0.0)
    line = view.sections.line
    index = np.flatnonzero(sigmas >= np.maximum(SURE, _paler(sigmas, line)))
    found = np.bincount(line[index], minlength=len(view.least)) >= view.least
    index = index[found[line[index]]]  # a few sections of a line that is not found show something else
    return index, view.traces.left_m[index, best[index]]


def _paler(sigmas: FloatArray, line: IntArray) -> FloatArray:
    """Return the least significance of each section's paint, shape (n,): between dashes there is road texture."""
    most = np.zeros(line.max(initial=0) + 1)
    for number in np.unique(line):
        most[number] = PALE * np.quantile(sigmas[line == number], 1.0 - DASHED_SHARE / 2)
    return most[line]


def _astray(offsets: Offsets, beside: FloatArray) -> frozenset[int]:
    """Return the astray lines, at most a third; ``beside`` is each section's deviation in standard deviations."""
    numbers = np.unique(offsets.sections.line)
    medians = np.array([np.median(beside[offsets.sections.line == number]) for number in numbers])
    worst = np.argsort(-medians)[: len(numbers) // 3]
    return frozenset(int(numbers[i]) for i in worst if medians[i] > ASTRAY)


def _line_checked(line: LaneLine, number: int, view: View, fitted: Fitted | None, placed: Placed) -> LineCheck:
    in_view, hidden = (int((each.line == number).sum()) for each in (view.sections, view.hidden))
    on_line = None if fitted is None else fitted.offsets[fitted.offsets.sections.line == number]
    if fitted is None or on_line is None or len(on_line) == 0:
        return LineCheck(line.id, line.kind, in_view, hidden, 0, found=False)
    weights = np.linalg.inv(covariance_of(on_line, placed, 0.0))
    sigma_m = 1.0 / float(np.sqrt(weights.sum()))
    mean = weights.sum(axis=0) * sigma_m**2
    per_m = float(mean @ (1.0 / on_line.cell_m)) if view.traces.in_image else None
    offset_m = float(mean @ on_line.left_m)
    return LineCheck(
        line.id,
        line.kind,
        in_view,
        hidden,
        len(on_line),
        found=True,
        offset_m=offset_m,
        sigma_m=sigma_m,
        offset_px=None if per_m is None else float(mean @ (on_line.left_m / on_line.cell_m)),
        sigma_px=None if per_m is None else sigma_m * per_m,
        astray=number in fitted.astray,
    )
