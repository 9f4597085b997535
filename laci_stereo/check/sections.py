"""A map's lines, cut into short sections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from laci_stereo.core.columns import Columns
from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.io.lane_map import LaneLine

SECTION_M = 1.0
"""Long enough to average the road's texture, short beside the shortest dash in towns (3 m)."""

PAINTED = ("", "line_thin", "line_thick", "stop_line", "pedestrian_marking", "bike_marking", "keepout")
"""Kinds of lines that are painted on a road; a line without a kind may be."""

THIN_M = 0.12
"""What paint is wide, as a rule; the narrowest has 8 cm."""

WIDE_M = {"line_thick": 0.25, "stop_line": 0.30}
"""What is painted wider (RMS: 0.25 to 0.30 m, and 0.50 m; MUTCD: 0.30 m at least)."""

KERBS = ("curbstone", "road_border")
"""Kinds of lines where a road may end with a step."""

MAYBE = ("road_border",)
"""Kinds of lines that may be a step or none: not to find them tells nothing."""

WALLS = ("wall", "fence", "guard_rail", "jersey_barrier")
"""Kinds of lines along which something stands."""

FARTHEST_M = 80.0
"""From the sensor: at 15 m, the highest that one hangs, a line of sight is 11 deg from the road there."""


@dataclass(frozen=True)
class Sections(Columns):
    """Short pieces of lines.

    Attributes
    ----------
    line : ndarray of int, shape (n,)
        Index of the line.
    along_m : ndarray, shape (n,)
        Of its middle, from the line's beginning.
    xy : ndarray, shape (n, 2)
        Its middle, world.
    left : ndarray, shape (n, 2)
        Unit vector to the left of the line.
    width_m : ndarray, shape (n,)
        What its paint is wide.
    """

    line: IntArray
    along_m: FloatArray
    xy: FloatArray
    left: FloatArray
    width_m: FloatArray

    def __len__(self) -> int:
        return len(self.line)

    @property
    def ahead(self) -> FloatArray:
        """Unit vectors along the lines, shape (n, 2)."""
        return np.column_stack([self.left[:, 1], -self.left[:, 0]])


def sections_of(lines: Sequence[LaneLine], around_xy: FloatArray, kinds: Sequence[str] = PAINTED) -> Sections:
    """Cut those of some lines that are of some kinds into sections of about a metre, within `FARTHEST_M` of a point."""
    pieces = [
        _cut(number, line.xy, WIDE_M.get(line.kind, THIN_M)) for number, line in enumerate(lines) if line.kind in kinds
    ]
    none = Sections(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    whole = none.joined(*pieces)
    return whole[np.linalg.norm(whole.xy - around_xy, axis=1) < FARTHEST_M]


def _cut(number: int, xy: FloatArray, width_m: float) -> Sections:
    steps = np.linalg.norm(np.diff(xy, axis=0), axis=1)
    at = np.append(0.0, np.cumsum(steps))
    count = max(round(at[-1] / SECTION_M), 1) if at[-1] > 0 else 0
    edges = np.linspace(0.0, at[-1], count + 1)
    ends = np.column_stack([np.interp(edges, at, axis) for axis in xy.T])
    ahead = np.diff(ends, axis=0)
    length = np.linalg.norm(ahead, axis=1)
    kept = length > 0.5 * SECTION_M  # a shorter one is folded, or no line
    ahead = ahead[kept] / length[kept, None]
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    middle, along = (ends[1:] + ends[:-1])[kept] / 2, (edges[1:] + edges[:-1])[kept] / 2
    return Sections(np.full(len(middle), number), along, middle, left, np.full(len(middle), width_m))
