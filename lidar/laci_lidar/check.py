"""Lane check of a LiDAR: paint is found by its higher intensity, kerbs as steps, and walls as upright surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from laci_lidar.kerbs import find_kerbs
from laci_lidar.sequence import ScanSequence
from laci_lidar.surroundings import Surroundings, gaps, smoothed, surroundings_in, typical, windows
from laci_lidar.walls import find_walls
from laci_stereo.check.images import Checked
from laci_stereo.check.lanes import MAP_SIGMA_M, LaneCheck, check_lanes
from laci_stereo.check.picture import draw_check
from laci_stereo.check.placed import Placed
from laci_stereo.check.profiles import OFFSETS_M, Profiles
from laci_stereo.check.ridges import find_stripes
from laci_stereo.check.sections import KERBS, PAINTED, WALLS, Sections, sections_of
from laci_stereo.check.traces import Traces
from laci_stereo.core.frames import FloatArray, Raster
from laci_stereo.io.maps.lane_map import LaneLine, LaneMap
from laci_stereo.report.mapview import MapView

GROUND_M = 0.3
"""Largest distance of the road from the plane: its crown and bends are less within sight, and vehicle bodies begin
above."""

PIXELS_PER_M = 16.0
MOST_PIXELS = 1600


class PlacedRanging(Placed):
    """A sensor that measures distances: the position of a point does not depend on its assumed height."""

    def lengthening(self, xy: FloatArray) -> FloatArray:
        """Return zero displacement, shape (n, 2)."""
        return np.zeros_like(xy)


@dataclass(frozen=True)
class Seeing:
    """Searches a LiDAR's points for the lines of a map."""

    lines: Sequence[LaneLine]
    placed: PlacedRanging
    around: Surroundings

    @cached_property
    def has_intensity(self) -> bool:
        """Whether any point has an intensity."""
        return bool(np.isfinite(self.around.intensity).any())

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of lines that can be seen; painted ones only with intensity."""
        return (*KERBS, *WALLS, *(PAINTED if self.has_intensity else ()))

    @cached_property
    def near(self) -> Surroundings:
        """The points near lines."""
        return self.around.beside(sections_of(self.lines, self.placed.origin[:2], self.kinds).xy)

    @cached_property
    def road(self) -> Surroundings:
        """The points near lines that are on the ground and have an intensity."""
        return self.near[(np.abs(self.near.points[:, 2]) < GROUND_M) & np.isfinite(self.near.intensity)]

    def __call__(self, sections: Sections) -> Traces:
        """Detect the mapped features across sections of lines."""
        kind = np.array([line.kind for line in self.lines])[sections.line]
        paint, kerb, wall = (np.isin(kind, kinds) for kinds in (PAINTED, KERBS, WALLS))
        return (
            Traces.unseen(len(sections))
            .put(paint, find_paint(self.road, sections[paint]))
            .put(kerb, find_kerbs(self.near, self.placed, sections[kerb]))
            .put(wall, find_walls(self.near, self.placed, sections[wall]))
        )


def check_scans(
    scans: ScanSequence, placed: Placed, lane_map: LaneMap, map_sigma_m: float = MAP_SIGMA_M
) -> Checked | None:
    """Compare a map with what a LiDAR saw; None if the scans have no intensity and the map no kerbs or walls.

    ``map_sigma_m`` is the standard deviation of a line's position in the map.

    Raises
    ------
    ScanError
        If more than a fifth of the selected scans cannot be read.
    """
    see = see_scans(scans, placed, lane_map.lines)
    if not see.has_intensity and not any(line.kind in see.kinds for line in lane_map.lines):
        return None
    check = check_lanes(see.lines, see.placed, see, map_sigma_m, see.kinds)
    return Checked(check, draw_scans(see, check, lane_map))


def see_scans(scans: ScanSequence, placed: Placed, lines: Sequence[LaneLine]) -> Seeing:
    """Accumulate what a LiDAR saw around some lines; see `check_scans`."""
    ranging = PlacedRanging(placed.T_world_sensor, placed.covariance, placed.centre_world, placed.boxes)
    return Seeing(lines, ranging, surroundings_in(scans, placed))


def draw_scans(see: Seeing, check: LaneCheck, lane_map: LaneMap) -> Raster:
    """Return a picture of a check from above, shape (height, width, 3), uint8."""
    view = _view(see.around.points[:, :2])
    return draw_check(_backdrop(view, see.around), view.line, check, see.placed, lane_map, see.kinds)


def find_paint(road: Surroundings, sections: Sections) -> Traces:
    """Detect stripes in the road's intensity, smoothed over the typical gap between points."""
    values = np.full((len(sections), len(OFFSETS_M)), np.nan)
    cells_m = np.full(len(sections), np.inf)
    for window in windows(road, sections):
        cell_m = typical(gaps(window.across_m))
        if cell_m > sections.width_m[window.number]:
            continue
        cells_m[window.number] = cell_m
        values[window.number] = smoothed(window.across_m, window.around.intensity, cell_m)
    return find_stripes(Profiles(values, cells_m, in_image=False), sections.line)


def _backdrop(view: MapView, around: Surroundings) -> Raster:
    """Return a picture of the intensity, or of the height if there is none, shape (height, width), uint8."""
    has_intensity = np.isfinite(around.intensity)
    values = np.where(has_intensity, around.intensity, 0.0) if has_intensity.any() else around.points[:, 2]
    width, height = np.ceil(view.size).astype(int) + 1
    column, row = np.rint(view.pixels(around.points[:, :2])).astype(int).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height) & (has_intensity | ~has_intensity.any())
    flat = row[inside] * width + column[inside]
    count = np.bincount(flat, minlength=width * height)
    mean = np.bincount(flat, values[inside], minlength=width * height) / np.maximum(count, 1)
    dark, bright = np.quantile(values[inside], [0.02, 0.98]) if inside.any() else (0.0, 1.0)
    grey = 60.0 + 195.0 * np.clip((mean - dark) / max(bright - dark, 1e-9), 0.0, 1.0)
    return np.where(count > 0, grey, 25.0).astype(np.uint8).reshape(height, width)


def _view(xy: FloatArray) -> MapView:
    low, high = np.quantile(xy, [0.01, 0.99], axis=0) if len(xy) else (-np.ones(2), np.ones(2))
    width_m, height_m = np.maximum(high - low, 10.0).tolist()
    scale_px = min(PIXELS_PER_M, MOST_PIXELS / max(width_m, height_m))
    return MapView((low + high) / 2, scale_px, (width_m * scale_px, height_m * scale_px))
