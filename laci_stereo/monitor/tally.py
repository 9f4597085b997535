"""Counts of passages: by position on the map, by offset across each lane, and by direction.

Their size does not grow with the duration of the recording.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, wrap
from laci_stereo.monitor.lanes import Located, Strip
from laci_stereo.monitor.passage import Passage
from laci_stereo.monitor.settings import MonitorSettings


@dataclass
class StripTally:
    """Counts of the passages in a strip.

    Attributes
    ----------
    along, against : int
        Number of passages along and against the line's direction; where traffic may drive both ways, all count as
        along.
    offset_sum_m, offset_square_m2 : float
        Sums over the passages along the line: of each passage's median offset to the left of the line, and of the
        square of this median.
    profile : Counter of int
        Number of positions of the passages along the line in each bin across the strip.
    """

    along: int = 0
    against: int = 0
    offset_sum_m: float = 0.0
    offset_square_m2: float = 0.0
    profile: Counter[int] = field(default_factory=Counter)

    @property
    def offset_m(self) -> float | None:
        """Mean offset of the passages to the left of the line; None without a passage."""
        return self.offset_sum_m / self.along if self.along else None

    @property
    def error_m(self) -> float | None:
        """Standard error of the mean offset, from the sample variance; None for fewer than two passages."""
        if self.along < 2 or self.offset_m is None:
            return None
        variance = (self.offset_square_m2 - self.along * self.offset_m**2) / (self.along - 1)
        return math.sqrt(max(variance, 0.0) / self.along)


@dataclass
class Tally:
    """All counts.

    Attributes
    ----------
    passages, strays : int
        Number of passages, and of those that drove along no strip.
    positions, off_road : int
        Number of positions, one per `MonitorSettings.step_m` of each passage's path, and of those in no strip.
    cells : Counter of tuple of int
        Number of positions in each cell of the map, by its column (east) and row (north).
    strips : dict of str to StripTally
        Counts of each strip in which objects drove, by its id.
    """

    passages: int = 0
    strays: int = 0
    positions: int = 0
    off_road: int = 0
    cells: Counter[tuple[int, int]] = field(default_factory=Counter)
    strips: dict[str, StripTally] = field(default_factory=dict)

    def count(self, passage: Passage, strips: Sequence[Strip], settings: MonitorSettings) -> str:
        """Count a passage, and return the id of the strip that it followed most, or an empty string."""
        xy, yaw_rad = passage.spaced(settings.step_m)
        located = [strip.locate(xy) for strip in strips]
        in_any = np.logical_or.reduce([np.zeros(len(xy), dtype=bool), *(place.inside for place in located)])
        self.passages += 1
        self.positions += len(xy)
        self.off_road += int((~in_any).sum())
        self.cells.update(tuple(cell) for cell in np.floor(xy / settings.cell_m).astype(int).tolist())
        driven = _driven(located, strips, yaw_rad, settings)
        for number, mine in driven:
            strip, place = strips[number], located[number]
            self._drove(strip, place, mine, yaw_rad, settings)
        self.strays += not driven
        return strips[driven[0][0]].id if driven else ""

    def _drove(
        self, strip: Strip, place: Located, in_strip: BoolArray, yaw_rad: FloatArray, settings: MonitorSettings
    ) -> None:
        tally = self.strips.setdefault(strip.id, StripTally())
        if strip.one_way and np.cos(yaw_rad[in_strip] - place.yaw_rad[in_strip]).mean() < 0.0:
            tally.against += 1
            return
        offset_m = float(np.median(place.offset_m[in_strip]))
        tally.along += 1
        tally.offset_sum_m += offset_m
        tally.offset_square_m2 += offset_m**2
        tally.profile.update(np.floor(place.offset_m[in_strip] / settings.profile_bin_m).astype(int).tolist())


def _driven(
    located: Sequence[Located], strips: Sequence[Strip], yaw_rad: FloatArray, settings: MonitorSettings
) -> list[tuple[int, BoolArray]]:
    """Return the strips that a passage followed, best fit first: each one's index, and which positions count for it.

    Each position counts for one strip. Where strips overlap, as in a crossing, this is the one that the passage follows
    for longer and closer to its line.
    """
    fits = []
    for place, strip in zip(located, strips, strict=True):
        turned = np.abs(wrap(yaw_rad - place.yaw_rad))
        aligned = np.minimum(turned, np.pi - turned) < np.radians(settings.aligned_deg)
        reach_m = float(max(strip.high_m.max(), -strip.low_m.min()))
        fits.append(np.where(place.inside & aligned, 1.0 - np.abs(place.offset_m) / (2 * reach_m), 0.0))
    fit = np.array(fits).reshape(len(strips), len(yaw_rad))
    found: list[tuple[int, BoolArray]] = []
    while len(fit):
        best = int(fit.sum(axis=1).argmax())
        in_strip: BoolArray = fit[best] > 0.0
        if in_strip.sum() * settings.step_m < settings.min_in_lane_m:
            return found
        found.append((best, in_strip))
        fit[:, in_strip] = 0.0
    return found
