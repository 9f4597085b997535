"""Where the messages put a vehicle in the frames of a drive, how its body stands, and how fast both change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, IntArray, dot_xy, perpendicular, rotate_xy, wrap
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.robust import NORMAL

RATE_S = 1.0
"""How well the clocks' offset is told depends on speeds and turning rates over so long before and after: over less, the
noise of two messages, 2 cm and 0.1 deg, would look like a manoeuvre that tells the offset, and a steady drive none."""

SMOOTH_S, NOW_S = 0.5, 0.01
"""The messages' track is a parabola over so long before and after, in which a vehicle changes neither its acceleration
nor how it bends; as it is, that noise would pull the clocks' offset by more than the few milliseconds to which they are
known. The second is what its slope is taken over."""

_STEPS = np.arange(-5, 6)
_PARABOLA = (89.0 - 5.0 * _STEPS**2) / 429.0
"""Weights of the least-squares parabola's middle through eleven places (Savitzky and Golay, 1964)."""

LEAST_TOLD = 10
"""So many messages tell the noise of all."""

FINEST_RAD = float(np.radians(0.1)) / 12**0.5
"""No heading is better than that: its last digit in the message is a tenth of a degree."""


@dataclass(frozen=True)
class Rates:
    """How fast a vehicle moves in the world, shape (m, 2), and how fast its body turns, shape (m,)."""

    velocity: FloatArray
    yaw: FloatArray


@dataclass(frozen=True)
class Poses:
    """A vehicle in m frames.

    Attributes
    ----------
    xy : ndarray, shape (m, 2)
        World frame.
    heading, yaw : ndarray, shape (m,)
        Of its motion, and of its body.
    by_lever, by_begin : ndarray, shape (m,)
        Derivatives of the body's yaw by the heading lever, and by how it stood when the messages began.
    rates, now : Rates
        Over `RATE_S`, and at the moment itself.
    unsure : ndarray, shape (m,)
        Variance of the heading because of its course between two messages, times how long these are apart, rad^2 s.
    known : ndarray of bool, shape (m,)
        The messages tell it.
    """

    xy: FloatArray
    heading: FloatArray
    yaw: FloatArray
    by_lever: FloatArray
    by_begin: FloatArray
    rates: Rates
    now: Rates
    unsure: FloatArray
    known: BoolArray


def poses_at(at: FloatArray, vehicle: VehicleTrack, heading_error: float, lever: float, begin: float = 0.0) -> Poses:
    """Return a vehicle's poses.

    Parameters
    ----------
    at : ndarray, shape (m,)
        Times of the messages, seconds.
    vehicle : VehicleTrack
    heading_error : float
        To be added to what is told.
    lever : float
        How far ahead of the rear axle the point is whose direction of motion is told, metres.
    begin : float
        How the body stood when the messages began: 1 as that point moved, -1 as in a bend in which it has settled.
    """
    stretch_s = vehicle.stretch(at)
    now, rate = (
        [np.clip(at + shift_s, *stretch_s) for shift_s in (-within_s, within_s)] for within_s in (NOW_S, RATE_S)
    )
    # In rows: there, a moment before and after, and so long before and after that noise is no manoeuvre.
    smoothed, told = smooth(vehicle, np.concatenate([at, *now])), vehicle.at(np.concatenate(rate))
    xy, heading, known = (
        np.concatenate(each).reshape(5, len(at), *each[0].shape[1:]) for each in zip(smoothed, told, strict=True)
    )
    times_s = np.concatenate([at, *now, *rate])
    (turned, by_lever), (begun, begun_by_lever) = (
        each(times_s, lever) for each in (vehicle.body.at, vehicle.body.begun_at)
    )
    times_s, yaw = times_s.reshape(heading.shape), heading + (turned + begin * begun).reshape(heading.shape)
    rates = [
        _rates(heading[0], times_s[ends], xy[ends], heading[ends], yaw[ends], known[ends])
        for ends in (slice(1, 3), slice(3, 5))
    ]
    here = slice(len(at))
    return Poses(
        xy=xy[0],
        heading=heading[0],
        yaw=yaw[0] + heading_error,
        by_lever=(by_lever + begin * begun_by_lever)[here],
        by_begin=begun[here],
        now=rates[0],
        rates=rates[1],
        unsure=_unsure(vehicle, at),
        known=known[0],
    )


def smooth(vehicle: VehicleTrack, at: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return what `VehicleTrack.at` does, of the smoothed track; at its ends and at gaps it is as it is."""
    first, last = vehicle.stretch(at)
    reach_s = np.minimum(at - first, last - at).clip(0.0, SMOOTH_S)
    times = np.clip(at + reach_s * _STEPS[:, None] / _STEPS[-1], np.minimum(first, at), np.maximum(at, last))
    around = vehicle.at(times.ravel())
    xy, heading, known = (values.reshape(len(_STEPS), len(at), *values.shape[1:]) for values in around)
    middle = len(_STEPS) // 2
    return np.tensordot(_PARABOLA, xy, 1), np.tensordot(_PARABOLA, heading, 1), known[middle]


def heading_noise(vehicle: VehicleTrack, otherwise_rad: float) -> float:
    """Return by how much each message's heading is off by itself, one standard deviation, rad.

    That is what is left of each beside the cubic through the two before and the two after, less what these err by. It
    is counted by its median, for where a bend begins a cubic is wrong. Of few messages, or such as come seldom, it is
    not known.
    """
    five = np.arange(5) + np.arange(max(0, len(vehicle.stamps_s) - 4))[:, None]
    five = five[np.ptp(vehicle.stamps_s[five], axis=1) <= 4 * SMOOTH_S]
    if len(five) < LEAST_TOLD:
        return otherwise_rad
    away = vehicle.stamps_s[five[:, [0, 1, 3, 4]]] - vehicle.stamps_s[five[:, 2:3]]
    apart = away[:, None] - away[:, :, None] + np.eye(4)
    weight = np.where(np.eye(4, dtype=bool), 1.0, away[:, None] / apart).prod(axis=2)  # Lagrange's
    left = vehicle.yaw_rad[five[:, 2]] - (weight * vehicle.yaw_rad[five[:, [0, 1, 3, 4]]]).sum(axis=1)
    noise = float(NORMAL * np.median(np.abs(wrap(left)) / np.sqrt(1.0 + (weight**2).sum(axis=1))))
    return max(noise, FINEST_RAD)


def _unsure(vehicle: VehicleTrack, at: FloatArray) -> FloatArray:
    """Return how unsure the heading is between messages, shape (m,), rad^2 s.

    A straight line is off by c t (h - t) / (2 h) where its slope changes by c from one interval to the next and this
    one lasts for h. A curve is better where the heading changes smoothly, by as much as is not known.
    """
    stamps_s = vehicle.stamps_s
    gap_s = np.maximum(np.diff(stamps_s), 1e-9)
    change = np.abs(np.diff(np.diff(vehicle.yaw_rad) / gap_s, prepend=np.nan, append=np.nan))
    change = np.fmax(change[:-1], change[1:])
    index = np.searchsorted(stamps_s, at, side="right").clip(1, len(gap_s)) - 1
    passed_s = (at - stamps_s[index]).clip(0.0, gap_s[index])
    straight_rad = np.nan_to_num(change[index]) * passed_s * (gap_s[index] - passed_s) / (2.0 * gap_s[index])
    unsure: FloatArray = straight_rad**2 * gap_s[index]
    return unsure


def _rates(
    heading: FloatArray, at: FloatArray, xy: FloatArray, headings: FloatArray, yaws: FloatArray, known: BoolArray
) -> Rates:
    """Return the rates at some times, from the poses before and after, shape (2, m), for a vehicle that turns evenly.

    At the ends of a stretch that is known, where one of both is at the end: no rate, beside others, would be a
    manoeuvre. Its mean velocity is along a chord, which is parallel to the arc in the middle, and shorter.
    """
    both = known[0] & known[1] & (at[1] > at[0])
    passed_s = np.where(both, at[1] - at[0], 1.0)
    half = (headings[1] - headings[0]) / 2.0
    arc = (xy[1] - xy[0]) / np.sinc(half / np.pi)[:, None]
    velocity = rotate_xy(heading - headings[0] - half, arc) / passed_s[:, None]
    return Rates(np.where(both[:, None], velocity, 0.0), np.where(both, yaws[1] - yaws[0], 0.0) / passed_s)


def by_time(rates: Rates, frame: IntArray, xy: FloatArray, normal: FloatArray, normal_world: FloatArray) -> FloatArray:
    """Return the derivative of normal . xy by the time of the messages, shape (n,).

    Parameters
    ----------
    rates : Rates
    frame : ndarray of int, shape (n,)
        Which each point is in.
    xy, normal : ndarray, shape (n, 2)
        In the vehicle frame.
    normal_world : ndarray, shape (n, 2)
        The same normal in the world frame.
    """
    moved = dot_xy(normal_world, rates.velocity[frame])
    derivative: FloatArray = -moved - rates.yaw[frame] * dot_xy(normal, perpendicular(xy))
    return derivative
