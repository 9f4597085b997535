"""A scanner's field of view on the compass, learnt from what it saw, and its sweep through it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from laci_lidar.axes import forward_left_up
from laci_lidar.settings import Sweep
from laci_stereo.core.frames import Axes, BoolArray, FloatArray, wrap

WHOLE_RAD = float(np.radians(330.0))
"""A wider field is taken for all around: what is missing then is a mast, and no border is near a road."""

MARGIN_RAD = float(np.radians(0.5))
"""So near to the border counts as at it: some steps of any scanner, a tenth of a car 20 m away."""

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
    """

    axes: Axes
    right_rad: float
    width_rad: float

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

    def offsets_s(self, points: FloatArray, sweep: Sweep) -> FloatArray:
        """Return when the sweep passes each of the points, shape (n, 3), in seconds after the scan's stamp."""
        width = self.width_rad if self.limited else 2 * np.pi
        right = self.right_rad if self.limited else -np.pi
        clockwise = sweep.direction == "cw"
        start = right + (width if clockwise else 0.0) if sweep.start_deg is None else np.radians(sweep.start_deg)
        turned = (self.azimuths(points) - start) * (-1.0 if clockwise else 1.0) % (2 * np.pi)
        # Jitter before the start is no whole turn later.
        turned = np.where(turned > 2 * np.pi - MARGIN_RAD, turned - 2 * np.pi, turned) if self.limited else turned
        at_stamp = {"start": 0.0, "middle": width / 2, "end": width}[sweep.stamp_at]
        offsets: FloatArray = (turned - at_stamp) / (2 * np.pi * sweep.rate_hz)
        return offsets


def learn_view(clouds: Iterable[FloatArray], axes: Axes) -> View:
    """Learn the field of view from whole scans, each of shape (n, 3): all but the widest gap between their azimuths."""
    # In each bin the lowest and the highest azimuth that was seen in it.
    low, high = np.full(_BINS, np.inf), np.full(_BINS, -np.inf)
    for points in clouds:
        azimuths = wrap(_azimuths(points, axes))
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
    if width >= WHOLE_RAD:
        return View(axes, -np.pi, 2 * np.pi)
    return View(axes, float(first[(widest + 1) % len(first)]), width)


def _azimuths(points: FloatArray, axes: Axes) -> FloatArray:
    forward, left, _ = forward_left_up(axes)
    azimuths: FloatArray = np.arctan2(points @ left, points @ forward)
    return azimuths
