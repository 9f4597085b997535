"""What is kept of a sighting until its track ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from laci_stereo.core.frames import FloatArray

UNIT_M = 1e-3
"""Unit of kept outlines: whole millimetres, which a file holds exactly and which are far below any sensor's noise."""

REACH = np.iinfo(np.int16).max
"""Largest coordinate of an outline, in `UNIT_M`."""

Outline: TypeAlias = npt.NDArray[np.int16]


@dataclass(frozen=True)
class Kept:
    """The part of a sighting that is kept for its passage.

    Attributes
    ----------
    frame : int
        Frame number.
    stamp_s : float
        Seconds since the recording's first stamp.
    middle : ndarray, shape (2,)
        Level frame.
    whole : bool
        Whether the outline can be trusted.
    outline : ndarray of int16, shape (n, 2)
        Some of the points on the ground plan, relative to the middle, in `UNIT_M`; empty where the outline is not
        whole, or where the object has been stationary since its outline was last kept.
    top_m : float
        Height of the highest points; 0 without an outline.
    sigma_m : float
        Typical noise of the points along the line of sight.
    """

    frame: int
    stamp_s: float
    middle: FloatArray
    whole: bool
    outline: Outline
    top_m: float
    sigma_m: float


def in_units(beside_m: FloatArray) -> Outline:
    """Return points relative to a middle, shape (n, 2), metres, as an outline."""
    return np.rint(beside_m / UNIT_M).clip(-REACH, REACH).astype(np.int16)
