"""Detection of kerbs in LiDAR points: steps in the height of the ground."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from laci_lidar.surroundings import Surroundings, gaps, smoothed, typical, windows
from laci_stereo.check.placed import Placed
from laci_stereo.check.profiles import OFFSETS_M, STEP_M
from laci_stereo.check.sections import Sections
from laci_stereo.check.texture import noise_of
from laci_stereo.check.traces import SURE, Traces, highest
from laci_stereo.core.frames import FloatArray

OFF_PLANE_M = 0.5
"""Points farther from the plane are no ground: kerbs are at most 0.2 m high, and roads deviate by less."""

FLANK_M = 0.3
"""Width of the road and of the ground behind the kerb that are compared: that of a gutter or a kerb stone."""

SPARSEST_M = 0.12
"""Largest spacing of points across a line: several points in a flank, and one or two in the part left out."""

CLEAR_M = 0.09
"""Width left out on either side of a step: stones are slanted and rounded by up to 5 cm, and a beam is as wide."""

LOWEST_M, HIGHEST_M = 0.03, 0.25
"""Range of kerb heights: 3 cm where lowered for bicycles and wheels, up to 24 cm at bus stops; higher steps are walls
or vehicles."""

EVEN_M = 0.005
"""Lower limit of the noise of a step: an even road (2 to 4 mm/m) rises by 2 mm between flanks, and the ranges of lasers
differ by 0.5 to 1.5 cm, a third of which is the difference in height. Kerbs lowered for bicycles, 3 cm, remain
detectable."""


def find_kerbs(around: Surroundings, placed: Placed, sections: Sections) -> Traces:
    """Detect steps across sections of lines.

    A section is in view if a step is found there, or if the points are dense and even enough for no step to be missed.
    From the sensor's place, a kerb that faces away casts a shadow on the road.
    """
    heights, cell_m = _profiles(around, sections)
    seen = cell_m <= SPARSEST_M
    traces = Traces.unseen(len(sections))
    if not seen.any():
        return traces
    heights, sections = heights[seen], sections[seen]
    step = _steps(heights)
    bare = step - _slope(step)
    noise = noise_of(bare, sections.line, CLEAR_M + FLANK_M, np.full(len(heights), EVEN_M))
    sigmas = np.where(np.abs(step) < HIGHEST_M, np.abs(bare) / noise, 0.0)
    judged = (sigmas.max(axis=1) >= SURE) | (SURE * noise[:, len(OFFSETS_M) // 2] <= LOWEST_M)
    left_m = np.zeros(heights.shape)
    shadow_per_m = _shadow_per_m(placed, sections)
    for row, at in np.argwhere(highest(sigmas) & (sigmas > 0.0)).tolist():
        left_m[row, at] = _edge(heights[row], at, float(shadow_per_m[row]))
    return traces.put(seen, Traces(sigmas, left_m, np.where(judged, cell_m[seen], np.inf), np.zeros(len(judged))))


def _profiles(around: Surroundings, sections: Sections) -> tuple[FloatArray, FloatArray]:
    """Return the heights across sections, shape (n, m), and the spacing of points apart from one shadow, shape (n,)."""
    heights, cell_m = np.full((len(sections), len(OFFSETS_M)), np.nan), np.full(len(sections), np.inf)
    for window in windows(around, sections):
        z = window.around.points[:, 2]
        ground = np.abs(z) < OFF_PLANE_M
        across = window.across_m[ground]
        cell_m[window.number] = typical(np.sort(gaps(across))[:-1])
        profile = smoothed(across, z[ground], cell_m[window.number])
        known = np.isfinite(profile)
        if known.any():
            inner = np.interp(OFFSETS_M, OFFSETS_M[known], profile[known], left=np.nan, right=np.nan)
            heights[window.number] = inner
        else:
            cell_m[window.number] = np.inf
    return heights, cell_m


def _steps(heights: FloatArray) -> FloatArray:
    """Return the height difference between left and right of each place, shape (n, m); NaN at the ends."""
    clear, flank = round(CLEAR_M / STEP_M), round(FLANK_M / STEP_M)
    reach, count = clear + flank, heights.shape[1]
    padded = np.pad(heights, ((0, 0), (reach, reach)), constant_values=np.nan)
    means = sliding_window_view(padded, flank, axis=1).mean(axis=2)
    step: FloatArray = means[:, reach + clear + 1 : reach + clear + 1 + count] - means[:, :count]
    return step


def _slope(step: FloatArray) -> FloatArray:
    """Return each row's median, shape (n, 1); 0 if nothing is known."""
    known = np.isfinite(step).any(axis=1)
    slope = np.zeros((len(step), 1))
    slope[known, 0] = np.nanmedian(step[known], axis=1)
    return slope


def _shadow_per_m(placed: Placed, sections: Sections) -> FloatArray:
    """Return the width of the shadow to the right per metre of a step that is higher on the left, shape (n,)."""
    beside = np.einsum("ij,ij->i", placed.origin[:2] - sections.xy, sections.left)
    return np.asarray(beside / placed.origin[2])


def _edge(heights: FloatArray, at: int, shadow_per_m: float) -> float:
    """Return the position of a kerb's face, to the left of the line, metres.

    Points from its upper edge to the end of its shadow are missing, so the interpolated height is halfway between the
    flanks in the middle of the shadow, half of the shadow's width from the face.
    """
    shadow_m, step_m, middle = 0.0, 0.0, float(at)
    for _ in range(2):
        clear = round((CLEAR_M + shadow_m / 2) / STEP_M)
        reach = clear + round(FLANK_M / STEP_M)
        right, left = heights[max(at - reach, 0) : max(at - clear, 1)], heights[at + clear + 1 : at + reach + 1]
        if not (np.isfinite(right).any() and np.isfinite(left).any()):
            break
        low, high = float(np.nanmean(right)), float(np.nanmean(left))
        step_m = high - low
        shadow_m = max(step_m * shadow_per_m, 0.0)
        middle = _crossing(heights - (low + high) / 2, at, reach)
    return float(np.interp(middle, np.arange(len(OFFSETS_M)), OFFSETS_M)) + float(np.sign(step_m)) * shadow_m / 2


def _crossing(values: FloatArray, at: int, reach: int) -> float:
    """Return the interpolated zero crossing of values nearest to a sample; the sample if there is none within reach."""
    low = max(at - reach, 0)
    near = values[low : at + reach + 1]
    before = np.flatnonzero(np.sign(near[1:]) * np.sign(near[:-1]) < 0)
    if len(before) == 0:
        return at
    places = low + before + near[before] / (near[before] - near[before + 1])
    return float(places[np.abs(places - at).argmin()])
