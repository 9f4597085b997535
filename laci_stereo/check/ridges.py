"""Bright stripes as wide as paint in profiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d

from laci_stereo.check.profiles import OFFSETS_M, STEP_M, Profiles
from laci_stereo.core.frames import FloatArray, IntArray

WIDTHS_M = (0.09, 0.15, 0.21, 0.33, 0.51)
"""Of stripes: thin lines are 0.10 to 0.15 m wide, thick ones 0.25 to 0.30 m, lines to stop at up to 0.5 m (RMS)."""

FLANK_M = 0.15
"""How much of the road on either side a stripe is compared with: so little that a pavement is none."""

NOISE_SCALE = 1.4826
"""From the median absolute deviation to the standard deviation of normal numbers."""

SURE = 4.0
"""Sigma. Of some 10 000 places that are looked at, noise alone passes at less than one."""

BESIDE_A_PEAK = 0.5
"""What is less than this share of a peak near by is its slope: a wide window answers to a narrow stripe at its edge."""

FAINT = 0.02
"""Of the road's brightness: what the noise is at least. Worn paint reflects a fifth more than the road, which is 9 % of
the values in an image with a gamma of 2.2, and just beyond `SURE`."""

LEAST_KNOWN = 10
"""Offsets from which a texture can be told."""

DOUBTFUL = 2.0
"""Sigma below which a stripe counts nothing; what is between counts in part, for paint wears off."""


@dataclass(frozen=True)
class Stripes:
    """How much each place across a line looks like the middle of a stripe.

    Attributes
    ----------
    sigmas : ndarray, shape (n, m)
        Brightness over that of the brighter side, in standard deviations of the road's; 0 where nothing was seen.
    width_m : ndarray, shape (n, m)
        Of the stripe that fits best there.
    """

    sigmas: FloatArray
    width_m: FloatArray

    @property
    def evidence(self) -> FloatArray:
        """From 0 to 1, shape (n, m)."""
        return np.clip((self.sigmas - DOUBTFUL) / (SURE - DOUBTFUL), 0.0, 1.0)

    @property
    def peaks(self) -> FloatArray:
        """The evidence where it is greatest among its neighbours, else 0, shape (n, m)."""
        return np.where(self.sigmas == maximum_filter1d(self.sigmas, 5, axis=1, mode="constant"), self.evidence, 0.0)


def find_stripes(profiles: Profiles, line: IntArray) -> Stripes:
    """Look for stripes.

    Parameters
    ----------
    profiles : Profiles
        With something seen in each of them.
    line : ndarray of int, shape (n,)
        Which of them are of one line, in order: they share its noise.
    """
    sigmas = np.zeros(profiles.values.shape)
    widths = np.zeros(profiles.values.shape)
    brightness = np.nanmedian(profiles.values, axis=1)
    for width_m in WIDTHS_M:
        response = _response(profiles.values, width_m)
        noise = np.fmax(_texture(response, line), _unevenness(response, width_m))
        found = _in_sigmas(response, np.maximum(_shared(noise, line), FAINT * brightness))
        better = found > sigmas
        sigmas[better], widths[better] = found[better], width_m
    return Stripes(np.where(sigmas >= BESIDE_A_PEAK * _greatest_near(sigmas), sigmas, 0.0), widths)


def _greatest_near(sigmas: FloatArray) -> FloatArray:
    """Return the greatest value within half of the widest stripe, shape (n, m)."""
    reach = round(WIDTHS_M[-1] / 2 / STEP_M)
    return np.asarray(maximum_filter1d(sigmas, 2 * reach + 1, axis=1, mode="constant"))


def middle_of(profile: FloatArray, at: int, width_m: float) -> float:
    """Return the middle of a stripe, to the left of the line, metres: halfway between where it is half as bright.

    Parameters
    ----------
    profile : ndarray, shape (m,)
        At `OFFSETS_M`.
    at : int
        A sample within the stripe.
    width_m : float
        About its width.
    """
    reach = round((width_m + FLANK_M) / STEP_M)
    smooth = np.convolve(np.nan_to_num(profile), np.full(3, 1 / 3), mode="same")
    inside = smooth[max(at - round(width_m / 2 / STEP_M), 0) : at + round(width_m / 2 / STEP_M) + 1]
    steps = [_steps_to_edge(smooth[at::way][: reach + 1], float(inside.max())) for way in (1, -1)]
    return float(OFFSETS_M[at]) + STEP_M * (steps[0] - steps[1]) / 2


def _steps_to_edge(outwards: FloatArray, peak: float) -> float:
    """Return after how many samples brightness is halfway down to the darkest one; each side has its own half."""
    half = (peak + float(outwards.min())) / 2
    below = int(np.argmax(outwards < half))
    if below == 0:
        return 0.0
    return below - (half - float(outwards[below])) / float(outwards[below - 1] - outwards[below])


def _response(values: FloatArray, width_m: float) -> FloatArray:
    """Return the mean over a stripe's width less that of its brighter flank, shape (n, m); NaN near what is unseen."""
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


def _in_sigmas(response: FloatArray, noise: FloatArray) -> FloatArray:
    """Divide responses, shape (n, m), by their noise, shape (n,); 0 where nothing is known."""
    return np.asarray(np.nan_to_num(response / np.maximum(noise, 1e-9)[:, None]))


def _shared(noise: FloatArray, line: IntArray) -> FloatArray:
    """Return each section's noise, or its line's median where that is greater; infinite where it is not known."""
    shared = np.full(len(noise), np.inf)
    for number in np.unique(line):
        mine = line == number
        known = noise[mine & np.isfinite(noise)]
        if len(known):
            shared[mine] = np.maximum(np.nan_to_num(noise[mine], nan=np.inf), np.median(known))
    return shared


def _unevenness(response: FloatArray, width_m: float) -> FloatArray:
    """Return the robust standard deviation of each section's responses; NaN where a stripe would spoil half of them."""
    spread = np.full(len(response), np.nan)
    known = np.isfinite(response)
    spoilt = 2 * (width_m + FLANK_M) / STEP_M
    enough = known.sum(axis=1) > 2 * spoilt
    if enough.any():
        rows = response[enough]
        middle = np.nanmedian(rows, axis=1, keepdims=True)
        spread[enough] = NOISE_SCALE * np.nanmedian(np.abs(rows - middle), axis=1)
    return spread


def _texture(response: FloatArray, line: IntArray) -> FloatArray:
    """Return the robust standard deviation of each section's responses against its neighbours'; NaN where unknown.

    What runs along the line, paint above all, is the same in neighbours, so that it is no noise.
    """
    apart = np.abs(np.diff(response, axis=0))
    known = np.isfinite(apart)
    steps = np.full(len(apart), np.nan)
    enough = (np.diff(line) == 0) & (known.sum(axis=1) >= LEAST_KNOWN)
    steps[enough] = NOISE_SCALE / np.sqrt(2.0) * np.nanmedian(apart[enough], axis=1)
    texture: FloatArray = np.fmax(np.append(np.nan, steps), np.append(steps, np.nan))
    return texture
