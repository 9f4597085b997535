"""A scanner's field of view in azimuth, learnt from its scans, and its sweep through it.

Azimuths are about the sensor's up axis, counter-clockwise from forward.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from laci_lidar.axes import forward_left_up
from laci_lidar.settings import Sweep
from laci_stereo.core.frames import Axes, BoolArray, FloatArray, wrap

WHOLE_RAD = float(np.radians(330.0))
"""A field wider than this counts as all-round: the gap is a mast, and no border lies near a road."""

MARGIN_RAD = float(np.radians(0.5))
"""Distance from the border within which a point counts as at the edge: some steps of any scanner, a tenth of a car at
20 m."""

NO_POINTS_RAD = float(np.pi / 2)
"""Largest angle between a scan's last and first point: a wall may be there, or nothing within range."""

ONE_LAYER_RAD = float(np.radians(0.1))
"""Largest difference in elevation between successive points of one layer; layers are at least 0.2 deg apart."""

LEAST_OF_LAYER = 36
"""Least number of points from which a layer's rotation is determined: one in ten degrees."""

ALIKE = 0.9
"""Least length of the mean unit vector of the scans' start directions for a common start: within 26 deg."""

_BINS = 1440


@dataclass(frozen=True)
class View:
    """The azimuths that a scanner sees.

    Attributes
    ----------
    axes : Axes
    right_rad : float
        Azimuth of the right border, from which the field extends to the left.
    width_rad : float
        Width of the field; 2 pi if it is all-round.
    begin_rad : float
        Azimuth at which one scan ends and the next begins. If the order of points does not determine it, the middle of
        the gap, or behind the sensor if the field is all-round.
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
        """Return which points, shape (n, 3), are at the left or right border of the field of view.

        The upper and lower border do not count: a scanner with few layers always cuts off the roof.
        """
        if not self.limited:
            return np.zeros(len(points), dtype=bool)
        inward = (self.azimuths(points) - self.right_rad - MARGIN_RAD) % (2 * np.pi)
        edge: BoolArray = inward > self.width_rad - 2 * MARGIN_RAD
        return edge

    def turned_rad(self, points: FloatArray) -> FloatArray:
        """Return the azimuths of points, shape (n, 3), to the left of the scans' start, 0 to 2 pi, shape (n,)."""
        turned: FloatArray = (self.azimuths(points) - self.begin_rad) % (2 * np.pi)
        return turned

    def offsets_s(self, points: FloatArray, sweep: Sweep) -> FloatArray:
        """Return the time at which the sweep passes each point, shape (n, 3), in seconds after the scan's stamp."""
        clockwise = sweep.direction == "cw"
        start = self.begin_rad if sweep.start_deg is None else float(np.radians(sweep.start_deg))
        # A scan that begins within the field covers the full circle; otherwise it runs from border to border.
        inward = (start - self.right_rad + MARGIN_RAD) % (2 * np.pi)
        across = self.limited and not 2 * MARGIN_RAD < inward < self.width_rad
        if across and sweep.start_deg is None:
            start = self.right_rad + (self.width_rad if clockwise else 0.0)
        turned = (self.azimuths(points) - start) * (-1.0 if clockwise else 1.0) % (2 * np.pi)
        # A point that jitters to before the start is not a whole turn later.
        turned = np.where(turned > 2 * np.pi - MARGIN_RAD, turned - 2 * np.pi, turned) if across else turned
        width = self.width_rad if across else 2 * np.pi
        at_stamp = {"start": 0.0, "middle": width / 2, "end": width}[sweep.stamp_at]
        offsets: FloatArray = (turned - at_stamp) / (2 * np.pi * sweep.rate_hz)
        return offsets


def learn_view(clouds: Iterable[FloatArray], axes: Axes) -> View:
    """Learn the field of view from whole scans, each of shape (n, 3), with points in the order of their acquisition.

    It is the full circle without the widest gap between the points' azimuths.
    """
    # The lowest and the highest azimuth of the points in each bin.
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
    """Return the azimuth at which an all-round scan begins, from the order of its points, shape (n,); NaN if unknown.

    It lies between the last and the first point of a turn, which are close together: those of the scan, if its points
    are in the order of the beams, or those of each layer, if it is stored layer by layer. In a layer with few points
    the two are far apart.
    """
    bounds = np.concatenate([[0], np.flatnonzero(np.abs(np.diff(elevations)) > ONE_LAYER_RAD) + 1, [len(azimuths)]])
    long = np.flatnonzero(np.diff(bounds) >= LEAST_OF_LAYER)
    layers = [azimuths[bounds[index] : bounds[index + 1]] for index in long.tolist()]
    missing, begin = min((_ends(each) for each in (azimuths, *layers)), key=lambda ends: ends[0])
    return begin if missing < NO_POINTS_RAD else np.nan


def _ends(azimuths: FloatArray) -> tuple[float, float]:
    """Return the angle from the last point of a turn to its first, and the azimuth in the middle of it."""
    turned = float(wrap(np.diff(azimuths)).sum())
    if abs(turned) < np.pi:
        return np.inf, np.nan
    missing = float(np.sign(turned) * (azimuths[0] - azimuths[-1]) % (2 * np.pi))
    return missing, float(azimuths[-1] + np.sign(turned) * missing / 2)


def _together(begins: Sequence[float]) -> float | None:
    """Return the azimuth at which scans begin if most of them agree on it; None if the order of points was lost."""
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
