"""The poses that the messages give a vehicle in the frames of a drive, the yaw of its body, and the rates of both."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, IntArray, dot_xy, perpendicular, rotate_xy, wrap
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.robust import NORMAL

RATE_S = 1.0
"""Half of the time over which speeds and yaw rates are taken where they determine the uncertainty of the clock offset:
over less, the noise of two messages, 2 cm and 0.1 deg, would look like a manoeuvre that determines the offset, which a
steady drive does not."""

SMOOTH_S, NOW_S = 0.5, 0.01
"""Half of the time over which the messages' track is smoothed with a parabola: within it a vehicle changes neither its
acceleration nor its yaw rate. Without smoothing, that noise would shift the clock offset by more than the few
milliseconds to which it is known. The second value is half of the time over which the slope of the smoothed track is
taken."""

_STEPS = np.arange(-5, 6)
_PARABOLA = (89.0 - 5.0 * _STEPS**2) / 429.0
"""Weights for the middle of the least-squares parabola through eleven points (Savitzky and Golay, 1964)."""

LEAST_TOLD = 10
"""Least number of messages from which the noise of the headings is estimated."""

FINEST_RAD = float(np.radians(0.1)) / 12**0.5
"""Least standard deviation of a heading: the last digit in the message is a tenth of a degree."""


@dataclass(frozen=True)
class Rates:
    """The velocity of a vehicle in the world frame, shape (m, 2), and the yaw rate of its body, shape (m,)."""

    velocity: FloatArray
    yaw: FloatArray


@dataclass(frozen=True)
class Poses:
    """The poses of a vehicle in m frames.

    Attributes
    ----------
    xy : ndarray, shape (m, 2)
        The middle of the vehicle, world frame.
    heading, yaw : ndarray, shape (m,)
        Yaw of its motion, and of its body.
    by_lever, by_begin : ndarray, shape (m,)
        Derivatives of the body's yaw by the heading lever, and by the body's initial angle.
    rates, now : Rates
        Over `RATE_S`, and at the moment itself.
    unsure : ndarray, shape (m,)
        Variance of the heading due to its unknown course between two messages, times their interval, rad^2 s.
    known : ndarray of bool, shape (m,)
        The messages determine the pose.
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


def poses_at(
    at: FloatArray, vehicle: VehicleTrack, heading_error: float, lever: float, begin: float = 0.0, lag_s: float = 0.0
) -> Poses:
    """Return a vehicle's poses at some times.

    Parameters
    ----------
    at : ndarray, shape (m,)
        Times of the messages, seconds.
    vehicle : VehicleTrack
    heading_error : float
        To be added to the reported heading, rad.
    lever : float
        Distance from the rear axle to the point ahead of it whose direction of motion is reported, metres.
    begin : float
        Initial angle of the body when the messages began: 1 if it pointed where that point moved, -1 if it had settled
        in a bend.
    lag_s : float
        Time by which the reported headings lag behind the positions. At the end of the messages the heading is that of
        the last one.
    """
    first, last = vehicle.stretch(at)
    # Rows: at the times themselves, a moment before and after them, and so long before and after them that noise does
    # not look like a manoeuvre.
    shifts_s = np.array([[0.0], [-NOW_S], [NOW_S], [-RATE_S], [RATE_S]])
    times_s = np.vstack([at, np.clip(at + shifts_s[1:], first, last)])
    xy, heading, known = _partly_smooth(vehicle, times_s)
    later_s = np.clip(times_s + lag_s, first, last)
    motion = _partly_smooth(vehicle, later_s)[1] if lag_s else heading
    (turned, by_lever), (begun, begun_by_lever) = (
        [each.reshape(heading.shape) for each in way(later_s.ravel(), lever)]
        for way in (vehicle.body.at, vehicle.body.begun_at)
    )
    yaw = motion + turned + begin * begun + heading_error
    # The messages' track is that of the vehicle's middle if its heading were the body's yaw; what they report is the
    # position of the reference point.
    reference = np.asarray(vehicle.reference)
    xy = xy + rotate_xy(heading, reference) - rotate_xy(yaw, reference)
    rates = [
        _rates(heading[0], times_s[ends], xy[ends], heading[ends], yaw[ends], known[ends])
        for ends in (slice(1, 3), slice(3, 5))
    ]
    return Poses(
        xy=xy[0],
        heading=heading[0],
        yaw=yaw[0],
        by_lever=by_lever[0] + begin * begun_by_lever[0],
        by_begin=begun[0],
        now=rates[0],
        rates=rates[1],
        unsure=_unsure(vehicle, at),
        known=known[0],
    )


def _partly_smooth(vehicle: VehicleTrack, times_s: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the same as `VehicleTrack.at`, each with shape (5, m, ...); the first three rows are those of `smooth`."""
    parts = smooth(vehicle, times_s[:3].ravel()), vehicle.at(times_s[3:].ravel())
    xy, heading, known = (np.concatenate(each) for each in zip(*parts, strict=True))
    return xy.reshape(*times_s.shape, 2), heading.reshape(times_s.shape), known.reshape(times_s.shape)


def smooth(vehicle: VehicleTrack, at: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return the same as `VehicleTrack.at` for the smoothed track; at its ends and at gaps it is not smoothed."""
    first, last = vehicle.stretch(at)
    reach_s = np.minimum(at - first, last - at).clip(0.0, SMOOTH_S)
    times = np.clip(at + reach_s * _STEPS[:, None] / _STEPS[-1], np.minimum(first, at), np.maximum(at, last))
    around = vehicle.at(times.ravel())
    xy, heading, known = (values.reshape(len(_STEPS), len(at), *values.shape[1:]) for values in around)
    middle = len(_STEPS) // 2
    return np.tensordot(_PARABOLA, xy, 1), np.tensordot(_PARABOLA, heading, 1), known[middle]


def heading_noise(vehicle: VehicleTrack, otherwise_rad: float) -> float:
    """Return the standard deviation of the independent error of each message's heading, rad.

    It follows from the residuals of each heading from the cubic through the two before and the two after, corrected for
    the noise of these four. The median of the residuals is used, since a cubic is wrong where a bend begins. With few
    messages, or with long intervals between them, the noise cannot be estimated, and ``otherwise_rad`` is returned.
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
    """Return the variance of the heading between messages, times their interval, shape (m,), rad^2 s.

    Linear interpolation is off by c t (h - t) / (2 h), t after a message, where the slope changes by c from one
    interval to the next and this interval lasts for h. A curve is better where the heading changes smoothly, but by an
    unknown amount.
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
    """Return the rates at some times from the poses before and after, shape (2, m), for a constant yaw rate.

    At the ends of a known stretch the pose before or after is that at the end itself: a missing rate beside others
    would look like a manoeuvre. Where a pose is unknown, the rates are 0. The mean velocity is along the chord, which
    is parallel to the arc at its middle, but shorter.
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
        Index of each point's frame.
    xy, normal : ndarray, shape (n, 2)
        In the vehicle frame.
    normal_world : ndarray, shape (n, 2)
        The same normal in the world frame.
    """
    moved = dot_xy(normal_world, rates.velocity[frame])
    derivative: FloatArray = -moved - rates.yaw[frame] * dot_xy(normal, perpendicular(xy))
    return derivative
