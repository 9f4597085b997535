"""Tracks and senders in the form in which they are compared: sightings averaged to knots, poses tabulated."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from laci_stereo.core.columns import Columns
from laci_stereo.core.estimation.drive_prior import PARTIAL_MEAN
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.tracking.tracks import Track

KNOT_S = 0.4
"""Time over which sightings are averaged; braking at 9 m/s^2 displaces the path by 9 * 0.4^2 / 24 = 6 cm meanwhile."""

TABLE_S = 0.05
"""Step of the table of a sender's poses; in between, 9 m/s^2 displaces the path by 3 mm."""

LEVER_SHARE = 1 / 3
"""Standard deviation, as a fraction of the vehicle's length, of the lever of the heading: it is the direction of motion
of some point ahead of the rear axle by up to the wheelbase, 0.6 of the length."""

BEND_S = 0.5
"""Time before and after over which the curvature of a path is averaged: five messages at 5 Hz."""

VIEW_CELL_M = 5.0
"""Distance around a sighting within which everything is assumed to be in view: about a vehicle's length."""


@dataclass(frozen=True)
class Knots(Columns):
    """Averages over a track's successive sightings; each attribute has shape (n,), and ``xy`` (n, 2).

    ``partial`` is the expected fraction of what a box lacks that lies behind it as seen from the sensor: all behind a
    cluster of points, half behind a detector's box, which may also be centred on the vehicle.
    """

    track: IntArray
    stamp_s: FloatArray
    xy: FloatArray
    length_m: FloatArray
    width_m: FloatArray
    yaw_rad: FloatArray
    partial: FloatArray
    sigma_m: FloatArray
    radial_mps: FloatArray
    frames: FloatArray
    usable: BoolArray

    def __len__(self) -> int:
        return len(self.stamp_s)


@dataclass(frozen=True)
class Poses(Columns):
    """Poses of a sender's vehicle: each attribute has the shape of the stamps, ``xy`` and ``velocity`` one axis more.

    ``slip_rad`` is the standard deviation of the body's yaw about the heading, which is large in narrow bends.
    """

    xy: FloatArray
    velocity: FloatArray
    yaw_rad: FloatArray
    path_m: FloatArray
    slip_rad: FloatArray
    known: BoolArray


@dataclass(frozen=True)
class Sender:
    """A sender's poses on a uniform grid of times that begins at ``first_s``."""

    station: int
    first_s: float
    table: FloatArray
    known: BoolArray
    length_m: float
    width_m: float

    @property
    def reach_m(self) -> float:
        """Half of the diagonal: the largest distance of a vehicle's centre from that of its visible part."""
        return math.hypot(self.length_m, self.width_m) / 2

    def at(self, stamps_s: FloatArray) -> Poses:
        """Interpolate the poses; where the sender was silent they have no meaning."""
        place = (stamps_s - self.first_s) / TABLE_S
        before = np.floor(place).astype(np.int64).clip(0, len(self.table) - 2)
        share = (place - before)[..., None]
        values = self.table[before] * (1 - share) + self.table[before + 1] * share
        inside = (place >= 0) & (place <= len(self.table) - 1)
        known = inside & self.known[before] & self.known[before + 1]
        return Poses(values[..., 0:2], values[..., 2:4], values[..., 4], values[..., 5], values[..., 6], known)


@dataclass(frozen=True)
class Scene:
    """Everything that was seen and sent.

    Attributes
    ----------
    tracks : sequence of Track
    knots : Knots
        Knots of all tracks.
    senders : mapping of int to Sender
        By station.
    seen_cells : ndarray of bool, shape (i, j)
        Cells of `VIEW_CELL_M` in which a vehicle would have been seen.
    first_cell : ndarray, shape (2,)
        Corner of the first cell, level frame, metres.
    density : float
        Number of objects at one time per square metre in view.
    settings : MatchSettings
    """

    tracks: Sequence[Track]
    knots: Knots
    senders: Mapping[int, Sender]
    seen_cells: BoolArray
    first_cell: FloatArray
    density: float
    settings: MatchSettings

    def in_view(self, xy_level: FloatArray) -> BoolArray:
        """Return where on the ground, shape (n, 2), a vehicle would have been seen."""
        cell = np.floor((xy_level - self.first_cell) / VIEW_CELL_M)
        inside = np.all((cell >= 0) & (cell < self.seen_cells.shape), axis=1)
        i, j = np.where(inside[:, None], cell, 0).astype(np.int64).T
        seen: BoolArray = inside & self.seen_cells[i, j]
        return seen


def lay_out(tracks: Sequence[Track], vehicles: Mapping[int, VehicleTrack], settings: MatchSettings) -> Scene:
    """Average the sightings to knots and tabulate the senders' poses."""
    knots = _knots(tracks)
    senders = {
        station: _sender(station, vehicle) for station, vehicle in vehicles.items() if len(vehicle.stamps_s) >= 2
    }
    usable = knots.xy[knots.usable] if knots.usable.any() else np.zeros((1, 2))
    first_cell = usable.min(axis=0) - 2 * VIEW_CELL_M
    cells = np.floor((usable - first_cell) / VIEW_CELL_M).astype(np.int64)
    seen = np.zeros(cells.max(axis=0) + 3, dtype=bool)
    seen[tuple(cells.T)] = True
    # The number of other objects at one time per square metre of where there are any.
    bins = max(1, len(np.unique(np.floor(knots.stamp_s / KNOT_S))))
    density = max(len(knots) / bins, 1.0) / (np.count_nonzero(seen) * VIEW_CELL_M**2)
    view = binary_dilation(seen, np.ones((3, 3), dtype=bool))
    return Scene(tracks, knots, senders, view, first_cell, float(density), settings)


def _knots(tracks: Sequence[Track]) -> Knots:
    sightings = [(index, one) for index, track in enumerate(tracks) for one in track.sightings]
    index = np.array([index for index, _ in sightings], dtype=np.int64)
    usable = np.array([one.flaw is None for _, one in sightings], dtype=bool)
    stamps_s = np.array([one.stamp_s for _, one in sightings])
    xy = np.array([one.box.centre for _, one in sightings]).reshape(-1, 2)
    others = np.array(
        [
            (
                one.box.length_m,
                one.box.width_m,
                one.box.yaw_rad,
                PARTIAL_MEAN if one.detected else 1.0,
                one.sigma_m,
                np.nan if one.radial_mps is None else one.radial_mps,
            )
            for _, one in sightings
        ]
    ).reshape(-1, 6)
    key = np.column_stack([index, usable, np.floor(stamps_s / KNOT_S)])
    order = np.lexsort((stamps_s, key[:, 2], key[:, 1], key[:, 0]))
    new = np.append(True, (np.diff(key[order], axis=0) != 0).any(axis=1))[: len(order)]
    starts = np.flatnonzero(new)
    count = np.diff(np.append(starts, len(order)))
    middle = order[starts + count // 2]

    def mean(values: FloatArray) -> FloatArray:
        total: FloatArray = np.add.reduceat(values[order], starts, axis=0) if len(starts) else values
        return total / (count[:, None] if values.ndim == 2 else count)

    length, width, yaw, partial, sigma, radial = others[middle].T
    return Knots(
        track=index[middle],
        stamp_s=mean(stamps_s),
        xy=mean(xy),
        length_m=length,
        width_m=width,
        yaw_rad=yaw,
        partial=partial,
        sigma_m=sigma,
        radial_mps=radial,
        frames=count.astype(float),
        usable=usable[middle],
    )


def _sender(station: int, vehicle: VehicleTrack) -> Sender:
    first_s, last_s = float(vehicle.stamps_s[0]), float(vehicle.stamps_s[-1])
    steps = np.arange(max(2, math.ceil((last_s - first_s) / TABLE_S) + 1), dtype=np.float64)
    grid = first_s + TABLE_S * steps
    xy, yaw, known = vehicle.at(grid)
    for values in (*xy.T, yaw):
        values[~known] = np.interp(grid[~known], grid[known], values[known]) if known.any() else 0.0
    velocity = np.gradient(xy, TABLE_S, axis=0)
    path = np.cumsum(np.linalg.norm(velocity, axis=1)) * TABLE_S
    table = np.column_stack([xy, velocity, yaw, path, _slip(yaw, path, vehicle.length_m)])
    return Sender(station, first_s, table, known, vehicle.length_m, vehicle.width_m)


def _slip(yaw: FloatArray, path_m: FloatArray, length_m: float) -> FloatArray:
    """Return the standard deviation of the body's yaw about the heading, rad, from the curvature of the path."""
    half = min(round(BEND_S / TABLE_S), (len(yaw) - 1) // 2)
    place = np.arange(len(yaw))
    before, after = np.maximum(place - half, 0), np.minimum(place + half, len(yaw) - 1)
    # Over less than a metre, the heading of a stationary vehicle determines no curvature.
    curvature = np.abs(yaw[after] - yaw[before]) / np.maximum(path_m[after] - path_m[before], 1.0)
    slip: FloatArray = np.arcsin(np.minimum(LEVER_SHARE * length_m * curvature, 1.0))
    return slip


def extent(xy: FloatArray) -> float:
    """Return the extent of positions, shape (n, 2): the diagonal of their bounding rectangle."""
    return float(np.linalg.norm(np.ptp(xy, axis=0))) if len(xy) else 0.0
