"""Detection of bright stripes with the width of paint in brightness profiles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter1d

from laci_stereo.check.profiles import OFFSETS_M, STEP_M, Profiles
from laci_stereo.check.texture import noise_of
from laci_stereo.check.traces import Traces, highest
from laci_stereo.core.frames import FloatArray, IntArray

WIDTHS_M = (0.09, 0.15, 0.21, 0.33, 0.51)
"""Widths of stripes: thin lines are 0.10 to 0.15 m wide, thick ones 0.25 to 0.30 m, stop lines up to 0.5 m (RMS)."""

FLANK_M = 0.15
"""Width of road on either side to which a stripe is compared: narrow enough for a pavement not to count as a stripe."""

BESIDE_A_PEAK = 0.5
"""A response below this fraction of a nearby peak belongs to its slope: a wide window responds to the edge of a narrow
stripe."""

FAINT = 0.02
"""Lower limit of the noise, as a fraction of the road's brightness. Worn paint reflects a fifth more than the road,
which is 9 % of the pixel values in an image with a gamma of 2.2, and just above the threshold of a sure detection."""


def find_stripes(profiles: Profiles, line: IntArray) -> Traces:
    """Detect stripes across sections of lines.

    ``line``, shape (n,), is the index of each section's line, in order along it: sections of one line share its noise.
    """
    traces = Traces.unseen(len(profiles.values))
    seen = np.isfinite(profiles.values[:, len(OFFSETS_M) // 2])
    values = profiles.values[seen]
    sigmas, widths = np.zeros(values.shape), np.zeros(values.shape)
    brightness = np.nanmedian(values, axis=1)
    for width_m in WIDTHS_M:
        response = _response(values, width_m)
        found = np.nan_to_num(response / noise_of(response, line[seen], width_m + FLANK_M, FAINT * brightness))
        better = found > sigmas
        sigmas[better], widths[better] = found[better], width_m
    sigmas = np.where(sigmas >= BESIDE_A_PEAK * _greatest_near(sigmas), sigmas, 0.0)
    left_m = np.zeros(values.shape)
    for row, at in np.argwhere(highest(sigmas) & (sigmas > 0.0)).tolist():
        left_m[row, at] = middle_of(values[row], at, float(widths[row, at]))
    found_here = Traces(sigmas, left_m, profiles.cell_m[seen], np.zeros(len(values)))
    return replace(traces.put(seen, found_here), in_image=profiles.in_image)


def _greatest_near(sigmas: FloatArray) -> FloatArray:
    """Return the greatest value within half the width of the widest stripe, shape (n, m)."""
    reach = round(WIDTHS_M[-1] / 2 / STEP_M)
    return np.asarray(maximum_filter1d(sigmas, 2 * reach + 1, axis=1, mode="constant"))


def middle_of(profile: FloatArray, at: int, width_m: float) -> float:
    """Return the middle of a stripe, to the left of the line, metres: halfway between its edges at half brightness.

    Parameters
    ----------
    profile : ndarray, shape (m,)
        Brightness at `OFFSETS_M`.
    at : int
        Index of a sample within the stripe.
    width_m : float
        Approximate width of the stripe.
    """
    reach = round((width_m + FLANK_M) / STEP_M)
    smooth = np.convolve(np.nan_to_num(profile), np.full(3, 1 / 3), mode="same")
    inside = smooth[max(at - round(width_m / 2 / STEP_M), 0) : at + round(width_m / 2 / STEP_M) + 1]
    steps = [_steps_to_edge(smooth[at::way][: reach + 1], float(inside.max())) for way in (1, -1)]
    return float(OFFSETS_M[at]) + STEP_M * (steps[0] - steps[1]) / 2


def _steps_to_edge(outwards: FloatArray, peak: float) -> float:
    """Return the distance, in samples, at which brightness is halfway down to the darkest sample on this side."""
    half = (peak + float(outwards.min())) / 2
    below = int(np.argmax(outwards < half))
    if below == 0:
        return 0.0
    return below - (half - float(outwards[below])) / float(outwards[below - 1] - outwards[below])


def _response(values: FloatArray, width_m: float) -> FloatArray:
    """Return the mean over a stripe minus that of its brighter flank, shape (n, m); NaN next to unseen samples."""
    half = round(width_m / STEP_M) // 2
    flank = round(FLANK_M / STEP_M)
    unseen = np.isnan(values)
    total = np.cumsum(np.pad(np.where(unseen, 0.0, values), ((0, 0), (1, 0))), axis=1)
    gaps = np.cumsum(np.pad(unseen, ((0, 0), (1, 0))), axis=1)
    m = values.shape[1]
    response = np.full(values.shape, np.nan)
    middle = np.arange(half + flank, m - half - flank)
    low, high = middle - half, middle + half + 1
    inner = (total[:, high] - total[:, low]) / (2 * half + 1)
    left = (total[:, low] - total[:, low - flank]) / flank
    right = (total[:, high + flank] - total[:, high]) / flank
    whole = gaps[:, high + flank] == gaps[:, low - flank]
    response[:, middle] = np.where(whole, inner - np.maximum(left, right), np.nan)
    return response
