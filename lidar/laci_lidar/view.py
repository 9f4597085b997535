"""A scanner's field of view on the compass, learnt from what it saw, and its sweep through it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from laci_lidar.axes import forward_left_up
from laci_lidar.settings import Sweep
from laci_stereo.core.frames import Axes, BoolArray, FloatArray, wrap

WHOLE_RAD = float(np.radians(330.0))
"""A wider field is taken for all around: what is missing then is a mast, and no border is near a road."""

MARGIN_RAD = float(np.radians(0.5))
"""So near to the border counts as at it: some steps of any scanner, a tenth of a car 20 m away."""

NO_POINTS_RAD = float(np.pi / 2)
"""What ends a scan and what begins it may be so far apart: there is a wall, or nothing in reach."""

ONE_LAYER_RAD = float(np.radians(0.1))
"""Points of one laser are seen no farther up or down than one another; layers are 0.2 deg apart at the least."""

LEAST_OF_LAYER = 36
"""Points of a layer that tell a turn: one in ten degrees."""

ALIKE = 0.9
"""Mean length of the scans' directions of begin, as unit vectors, if they begin at one place: within 26 deg."""

_BINS = 1440


@dataclass(frozen=True)
class View:
    """The directions that a scanner sees, as azimuths about its up axis, counter-clockwise from forward.

    Attributes
    ----------
    axes : Axes
    right_rad : float
        Azimuth of the border on the right, from where the field extends to the left.
    width_rad : float
        Of the field; 2 pi if it is all around.
    begin_rad : float
        Azimuth where a scan ends and the next begins. Where the order of points does not tell it, that is where nothing
        is seen, or behind the sensor if it sees all around.
    """

    axes: Axes
    right_rad: float
    width_rad: float
    begin_rad: float = np.pi

    @property
    def limited(self) -> bool:
        """Whether the field has borders."""
        return self.width_rad < WHOLE_RAD

    def azimuths(self, points: FloatArray) -> FloatArray:
        """Return the azimuths of points, shape (n, 3), in radians, shape (n,)."""
        return _azimuths(points, self.axes)

    def at_edge(self, points: FloatArray) -> BoolArray:
        """Tell which points, shape (n, 3), are at the left or right border of the field of view.

        The upper and lower border do not count: a scanner of few layers always cuts the roof.
        """
        if not self.limited:
            return np.zeros(len(points), dtype=bool)
        inward = (self.azimuths(points) - self.right_rad - MARGIN_RAD) % (2 * np.pi)
        edge: BoolArray = inward > self.width_rad - 2 * MARGIN_RAD
        return edge

    def turned_rad(self, points: FloatArray) -> FloatArray:
        """Return how far to the left of where scans begin points, shape (n, 3), are seen, 0 to 2 pi, shape (n,)."""
        turned: FloatArray = (self.azimuths(points) - self.begin_rad) % (2 * np.pi)
        return turned

    def offsets_s(self, points: FloatArray, sweep: Sweep) -> FloatArray:
        """Return when the sweep passes each of the points, shape (n, 3), in seconds after the scan's stamp."""
        clockwise = sweep.direction == "cw"
        start = self.begin_rad if sweep.start_deg is None else float(np.radians(sweep.start_deg))
        # A scan that begins within the field goes all around; else it passes from one border to the other.
        inward = (start - self.right_rad + MARGIN_RAD) % (2 * np.pi)
        across = self.limited and not 2 * MARGIN_RAD < inward < self.width_rad
        if across and sweep.start_deg is None:
            start = self.right_rad + (self.width_rad if clockwise else 0.0)
        turned = (self.azimuths(points) - start) * (-1.0 if clockwise else 1.0) % (2 * np.pi)
        # Jitter before the start is no whole turn later.
        turned = np.where(turned > 2 * np.pi - MARGIN_RAD, turned - 2 * np.pi, turned) if across else turned
        width = self.width_rad if across else 2 * np.pi
        at_stamp = {"start": 0.0, "middle": width / 2, "end": width}[sweep.stamp_at]
        offsets: FloatArray = (turned - at_stamp) / (2 * np.pi * sweep.rate_hz)
        return offsets


def learn_view(clouds: Iterable[FloatArray], axes: Axes) -> View:
    """Learn the field of view from whole scans, each of shape (n, 3), in the order in which they were taken.

    It is all but the widest gap between their azimuths.
    """
    # In each bin the lowest and the highest azimuth that was seen in it.
    low, high = np.full(_BINS, np.inf), np.full(_BINS, -np.inf)
    begins = []
    for points in clouds:
        azimuths = wrap(_azimuths(points, axes))
        begins.append(_begin(azimuths, _elevations(points, axes)))
        bins = np.minimum((azimuths + np.pi) * (_BINS / (2 * np.pi)), _BINS - 1).astype(np.int64)
        np.minimum.at(low, bins, azimuths)
        np.maximum.at(high, bins, azimuths)
    seen = np.isfinite(low)
    if not seen.any():
        return View(axes, -np.pi, 2 * np.pi)
    first, last = low[seen], high[seen]
    gaps = np.append(first[1:], first[0] + 2 * np.pi) - last
    widest = int(np.argmax(gaps))
    width = 2 * np.pi - float(gaps[widest])
    begin = _together(begins)
    if width >= WHOLE_RAD:
        return View(axes, -np.pi, 2 * np.pi, np.pi if begin is None else begin)
    right = float(first[(widest + 1) % len(first)])
    return View(axes, right, width, right - float(gaps[widest]) / 2 if begin is None else begin)


def _begin(azimuths: FloatArray, elevations: FloatArray) -> float:
    """Return where a scan begins that goes all around, by the order of its points, each shape (n,), or NaN.

    It is told by what ends a turn and what begins it, next to each other: of the scan, where beams follow one another,
    and of each layer, where it is written layer by layer. Of a layer that sees little the two are far apart.
    """
    bounds = np.concatenate([[0], np.flatnonzero(np.abs(np.diff(elevations)) > ONE_LAYER_RAD) + 1, [len(azimuths)]])
    long = np.flatnonzero(np.diff(bounds) >= LEAST_OF_LAYER)
    layers = [azimuths[bounds[index] : bounds[index + 1]] for index in long.tolist()]
    missing, begin = min((_ends(each) for each in (azimuths, *layers)), key=lambda ends: ends[0])
    return begin if missing < NO_POINTS_RAD else np.nan


def _ends(azimuths: FloatArray) -> tuple[float, float]:
    """Return how far it is from the last point of a turn to its first, and the middle of that, by their azimuths."""
    turned = float(wrap(np.diff(azimuths)).sum())
    if abs(turned) < np.pi:
        return np.inf, np.nan
    missing = float(np.sign(turned) * (azimuths[0] - azimuths[-1]) % (2 * np.pi))
    return missing, float(azimuths[-1] + np.sign(turned) * missing / 2)


def _together(begins: Sequence[float]) -> float | None:
    """Return where scans begin if most of them do so at one place; None where their order was lost."""
    known = np.array([begin for begin in begins if np.isfinite(begin)])
    if 2 * len(known) <= len(begins):
        return None
    mean = np.exp(1j * known).mean()
    return float(np.angle(mean)) if abs(mean) > ALIKE else None


def _elevations(points: FloatArray, axes: Axes) -> FloatArray:
    forward, left, up = forward_left_up(axes)
    elevations: FloatArray = np.arctan2(points @ up, np.hypot(points @ forward, points @ left))
    return elevations


def _azimuths(points: FloatArray, axes: Axes) -> FloatArray:
    forward, left, _ = forward_left_up(axes)
    azimuths: FloatArray = np.arctan2(points @ left, points @ forward)
    return azimuths
