"""Detection of walls, fences and rails in LiDAR points: points above each other."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import maximum_filter1d

from laci_lidar.surroundings import Surroundings, Window, windows
from laci_stereo.check.align import SHIFT_M
from laci_stereo.check.placed import Placed
from laci_stereo.check.profiles import OFFSETS_M, STEP_M
from laci_stereo.check.sections import Sections
from laci_stereo.check.traces import SURE, Traces, highest
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.robust import NORMAL

LOWEST_M = 0.3
"""Height over the plane above which points count: below are the ground and kerbs."""

LEAST_HIGH_M = 0.3
"""Vertical extent of a sure detection: guard rails have 0.31 m, and grass has less."""

BIN_M = 0.1
"""Height of a bin: a ring of points on sloping terrain, which rises by a few percent in a metre, is in one or two
bins."""

BESIDE_M = 0.075
"""Distance within which points belong to one surface: four standard deviations of a usual range noise of 2 cm."""

FLANK_M = 0.2
"""Distance on either side at which the extent must be lower: beyond the noise of the surface, and narrower than
foliage."""

THICK_M = 0.1
"""Standard deviation of the offset between the visible face and the mapped line: walls and hedges are 0.2 to 0.5 m
thick, and maps contain their middle or either face."""

AT_REST = 1 / 3
"""Least fraction of the scans that see a place in which it must be occupied: vehicles occupy it in fewer."""


def find_walls(around: Surroundings, placed: Placed, sections: Sections) -> Traces:
    """Detect upright surfaces across sections of lines.

    A section is in view if something upright is found there, or if the ground behind it is visible.
    """
    traces = Traces.unseen(len(sections))
    towards = np.sign(np.einsum("ij,ij->i", placed.origin[:2] - sections.xy, sections.left))
    for window in windows(around, sections):
        number, z = window.number, window.around.points[:, 2]
        tall = _extent(window)
        flank = round(FLANK_M / STEP_M)
        padded = np.pad(tall, flank)
        sigmas = SURE * (tall - np.maximum(padded[: -2 * flank], padded[2 * flank :])) / LEAST_HIGH_M
        behind = (z < LOWEST_M) & (window.across_m * towards[number] < -SHIFT_M)
        if not (behind.any() or sigmas.max() >= SURE):
            continue
        traces.sigmas[number] = np.maximum(sigmas, 0.0)
        upright = window.across_m[z > LOWEST_M]
        spread_m = 0.0
        for at in np.flatnonzero(highest(sigmas[None])[0] & (sigmas > 0.0)).tolist():
            near = upright[np.abs(upright - OFFSETS_M[at]) < 2 * BESIDE_M]
            middle = float(np.median(near))
            traces.left_m[number, at] = middle
            spread_m = max(spread_m, NORMAL * float(np.median(np.abs(near - middle))))
        traces.cell_m[number], traces.loose_m[number] = max(STEP_M, spread_m), THICK_M
    return traces


def _extent(window: Window) -> FloatArray:
    """Return the vertical extent of static points at `OFFSETS_M`, metres, shape (m,)."""
    scans, scan = np.unique(window.around.scan, return_inverse=True)
    z = window.around.points[:, 2]
    above = z > LOWEST_M
    if not above.any():
        return np.zeros(len(OFFSETS_M))
    level = ((z[above] - LOWEST_M) / BIN_M).astype(np.int64)
    at = np.rint((window.across_m[above] - OFFSETS_M[0]) / STEP_M).astype(np.int64)
    hit = np.zeros((len(scans), len(OFFSETS_M), int(level.max()) + 1), dtype=np.uint8)
    hit[scan[above], at, level] = 1
    reach = round(BESIDE_M / STEP_M)
    near = maximum_filter1d(hit, 2 * reach + 1, axis=1, mode="constant")
    there = near.mean(axis=0) >= AT_REST
    first, last = there.argmax(axis=1), there.shape[1] - there[:, ::-1].argmax(axis=1)
    return np.where(there.any(axis=1), BIN_M * (last - first), 0.0)
