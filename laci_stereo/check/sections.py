"""Division of a map's lines into short sections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from laci_stereo.core.columns import Columns
from laci_stereo.core.frames import FloatArray, IntArray, along_line
from laci_stereo.io.maps.lane_map import LaneLine

SECTION_M = 1.0
"""Length of a section: long enough to average the road's texture, short relative to the shortest urban dash (3 m)."""

PAINTED = ("", "line_thin", "line_thick", "stop_line", "pedestrian_marking", "bike_marking", "keepout")
"""Kinds of lines that are painted on a road; lines without a kind may be."""

THIN_M = 0.12
"""Typical width of paint; the narrowest is 8 cm wide."""

WIDE_M = {"line_thick": 0.25, "stop_line": 0.30}
"""Widths of kinds with wider paint (RMS: 0.25 to 0.30 m, and 0.50 m; MUTCD: at least 0.30 m)."""

KERBS = ("curbstone", "road_border")
"""Kinds of lines at which a road may end with a step."""

MAYBE = ("road_border",)
"""Kinds of lines that may or may not be a step: their absence is no evidence."""

WALLS = ("wall", "fence", "guard_rail", "jersey_barrier")
"""Kinds of lines along which an upright structure stands."""

FARTHEST_M = 80.0
"""Largest distance from the sensor: from 15 m, the greatest mounting height, a line of sight meets the road there at 11
deg."""


@dataclass(frozen=True)
class Sections(Columns):
    """Short sections of lines.

    Attributes
    ----------
    line : ndarray of int, shape (n,)
        Index of the line in the map.
    along_m : ndarray, shape (n,)
        Distance of the section's middle from the beginning of the line.
    xy : ndarray, shape (n, 2)
        Middle of the section, world.
    left : ndarray, shape (n, 2)
        Unit vector to the left of the line.
    width_m : ndarray, shape (n,)
        Width of the line's paint.
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
    """Divide lines of some kinds into sections of about a metre, and return those within `FARTHEST_M` of a point."""
    pieces = [
        _cut(number, line.xy, WIDE_M.get(line.kind, THIN_M)) for number, line in enumerate(lines) if line.kind in kinds
    ]
    none = Sections(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))
    whole = none.joined(*pieces)
    return whole[np.linalg.norm(whole.xy - around_xy, axis=1) < FARTHEST_M]


def _cut(number: int, xy: FloatArray, width_m: float) -> Sections:
    at = along_line(xy)
    count = max(round(at[-1] / SECTION_M), 1) if at[-1] > 0 else 0
    edges = np.linspace(0.0, at[-1], count + 1)
    ends = np.column_stack([np.interp(edges, at, axis) for axis in xy.T])
    ahead = np.diff(ends, axis=0)
    length = np.linalg.norm(ahead, axis=1)
    kept = length > 0.5 * SECTION_M  # a shorter one is folded or degenerate
    ahead = ahead[kept] / length[kept, None]
    left = np.column_stack([-ahead[:, 1], ahead[:, 0]])
    middle, along = (ends[1:] + ends[:-1])[kept] / 2, (edges[1:] + edges[:-1])[kept] / 2
    return Sections(np.full(len(middle), number), along, middle, left, np.full(len(middle), width_m))
