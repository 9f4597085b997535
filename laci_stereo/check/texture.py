"""Noise of a filter's responses due to the texture of a road."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from laci_stereo.check.profiles import OFFSETS_M, STEP_M
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray
from laci_stereo.core.robust import NORMAL

LEAST_KNOWN = 10
"""Least number of offsets from which the texture is estimated."""


def noise_of(response: FloatArray, line: IntArray, felt_m: float, least: FloatArray) -> FloatArray:
    """Return the noise of a filter's responses, estimated where there is nothing to detect.

    Parameters
    ----------
    response : ndarray, shape (n, m)
        Responses at `OFFSETS_M`; NaN if nothing was seen.
    line : ndarray of int, shape (n,)
        Index of each section's line, in order along it: sections of one line share its noise.
    felt_m : float
        Distance to either side within which the filter responds to what it detects.
    least : ndarray, shape (n,)
        Lower limit of each section's noise.

    Returns
    -------
    ndarray, shape (n, m)
        Standard deviation; infinite if unknown.
    """
    noise = np.empty(response.shape)
    for places, beside in _parts(felt_m):
        own = np.fmax(_texture(response[:, beside], line), _unevenness(response[:, beside]))
        noise[:, places] = np.maximum(_shared(own, line), least)[:, None]
    return noise


def _parts(felt_m: float) -> Iterator[tuple[slice, BoolArray]]:
    """Split the offsets into parts, each with the offsets whose responses do not depend on it: these give its noise.

    A feature that affects only a few offsets is ignored by the median, so that no split is needed.
    """
    felt, whole = round(felt_m / STEP_M), len(OFFSETS_M)
    step = felt // 2 if 2 * felt + 1 > whole / 4 else whole
    for start in range(0, whole, step):
        beside = np.ones(whole, dtype=bool)
        if step < whole:
            beside[max(start - felt, 0) : start + step + felt] = False
        yield slice(start, start + step), beside


def _shared(noise: FloatArray, line: IntArray) -> FloatArray:
    """Return each section's noise or its line's median, whichever is greater; infinite if unknown."""
    shared = np.full(len(noise), np.inf)
    for number in np.unique(line):
        on_line = line == number
        known = noise[on_line & np.isfinite(noise)]
        if len(known):
            shared[on_line] = np.maximum(np.nan_to_num(noise[on_line], nan=np.inf), np.median(known))
    return shared


def _unevenness(response: FloatArray) -> FloatArray:
    """Return the robust standard deviation of each section's responses; NaN if unknown."""
    spread = np.full(len(response), np.nan)
    enough = np.isfinite(response).sum(axis=1) >= LEAST_KNOWN
    if enough.any():
        rows = response[enough]
        middle = np.nanmedian(rows, axis=1, keepdims=True)
        spread[enough] = NORMAL * np.nanmedian(np.abs(rows - middle), axis=1)
    return spread


def _texture(response: FloatArray, line: IntArray) -> FloatArray:
    """Return the robust standard deviation of each section's responses relative to its neighbours; NaN if unknown.

    What continues along the line, above all paint, is equal in neighbouring sections and therefore not counted as
    noise.
    """
    apart = np.abs(np.diff(response, axis=0))
    steps = np.full(len(apart), np.nan)
    enough = (np.diff(line) == 0) & (np.isfinite(apart).sum(axis=1) >= LEAST_KNOWN)
    steps[enough] = NORMAL / np.sqrt(2.0) * np.nanmedian(apart[enough], axis=1)
    texture: FloatArray = np.fmax(np.append(np.nan, steps), np.append(steps, np.nan))
    return texture
