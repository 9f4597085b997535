"""Lateral steps in a receiver's positions: smaller than the error of a single message, but shared by all after it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from laci_stereo.core.frames import FloatArray, IntArray, rotate_xy
from laci_stereo.core.messages.receiver import FINEST_M
from laci_stereo.core.robust import NORMAL

BESIDE = 5
"""Messages on either side from which a step is estimated: it has 1.3 times the noise of one message."""

LONGEST_S = 1.5
"""The messages around a step must span no more, as those that come every 0.15 s do: at lower rates bends look like
steps."""

SURELY = 6.0
"""A step must exceed this many standard deviations, on two axes: one of 60 million places without a step does."""

NEAR = 4
"""The noise is estimated from all places, and from those near by: up to `NEAR` times as many messages away as a step is
estimated from, excluding the messages around the step itself. Where the vehicle drives fast, inexact headings and
stamps increase the noise."""

BEYOND_TOLD = 4.0
"""A step must also exceed this many of the standard deviations that messages report for their positions."""


def largest_step(
    stamps_s: FloatArray,
    xy: FloatArray,
    yaw_rad: FloatArray,
    onwards_mps: FloatArray,
    levers: Sequence[tuple[float, float]],
    sigma_m: float,
) -> tuple[float, float]:
    """Return the size, metres, and the time of the largest lateral step of the positions; zeros where there is none.

    Speeds and headings lead from one position to the next. The positions of some messages before and after each place
    are fitted by a parabola, which is how errors of headings and speeds distort a path, and by a step, or by none; a
    step does not count if it disappears with one of these messages. Of all points that may move where the heading
    points, the one with the smallest step counts.

    Parameters
    ----------
    stamps_s : ndarray, shape (n,)
        Ascending.
    xy : ndarray, shape (n, 2)
        Positions in the world, metres.
    yaw_rad : ndarray, shape (n,)
        Yaw of the body.
    onwards_mps : ndarray, shape (n,)
        Reported speeds, negative backwards.
    levers : sequence of tuple of float
        See `laci_stereo.core.messages.repair.levers`.
    sigma_m : float
        Standard deviation that messages report for their positions; NaN if none does.
    """
    if len(stamps_s) < 2 * BESIDE:
        return 0.0, 0.0
    around = np.arange(-BESIDE, BESIDE) + np.arange(BESIDE, len(stamps_s) - BESIDE + 1)[:, None]
    around = around[np.ptp(stamps_s[around], axis=1) <= LONGEST_S]
    if not len(around):
        return 0.0, 0.0
    velocity = onwards_mps[:, None] * np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad)])
    passed_s = np.diff(stamps_s)[:, None]
    led = np.cumsum(np.vstack([np.zeros((1, 2)), (velocity[1:] + velocity[:-1]) / 2 * passed_s]), axis=0)
    yaws = (yaw_rad, _smoothed(stamps_s, yaw_rad))
    each = [xy - rotate_xy(yaw, np.tile(lever, (len(xy), 1))) - led for yaw in yaws for lever in levers]
    place = around[:, BESIDE]
    by_lever = np.array([rotate_xy(-yaw_rad[place], _steps(stamps_s, off, around, place)) for off in each])
    size_m = np.linalg.norm(by_lever, axis=2)
    lever = size_m.argmin(axis=0)
    steps = by_lever[lever, np.arange(len(place))]
    # Inexact headings displace a point in proportion to its lever, which only bends determine: on a straight road, a
    # point without a lever has less noise. Smoothed headings are more exact, except where a bend begins.
    noise = np.maximum(_noise(steps, place), _noise(by_lever[size_m.mean(axis=1).argmin()], place))
    steps_m, sigmas = (np.linalg.norm(each_way, axis=1) for each_way in (steps, steps / noise))
    surely = (sigmas > SURELY) & (steps_m > BEYOND_TOLD * float(np.nan_to_num(sigma_m)))
    for i in np.flatnonzero(surely)[np.argsort(-steps_m[surely])].tolist():
        others = np.array([np.delete(around[i], k) for k in range(2 * BESIDE)])
        left_m = np.hypot(*_steps(stamps_s, each[lever[i]], others, np.full(len(others), place[i])).T)
        if left_m.min() > steps_m[i] / 2.0:
            return float(steps_m[i]), float(stamps_s[place[i]])
    return 0.0, 0.0


def _steps(stamps_s: FloatArray, off: FloatArray, around: IntArray, place: IntArray) -> FloatArray:
    """Return the steps just before the messages ``place``, shape (m, 2), from the messages ``around``, shape (m, q)."""
    at_s = stamps_s[around] - stamps_s[place][:, None]
    later = np.asarray(around >= place[:, None], dtype=np.float64)
    by_step = np.linalg.pinv(np.stack([np.ones_like(at_s), at_s, at_s**2, later], axis=2))[:, 3]
    steps: FloatArray = np.einsum("mk,mkj->mj", by_step, off[around])
    return steps


def _smoothed(stamps_s: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Return yaws smoothed by parabolas through five messages around each (Savitzky and Golay 1964)."""
    smooth: FloatArray = yaw_rad.copy()
    five = np.arange(-2, 3) + np.arange(2, len(yaw_rad) - 2)[:, None]
    five = five[np.ptp(stamps_s[five], axis=1) <= LONGEST_S / 2.0]
    at_s = stamps_s[five] - stamps_s[five[:, 2:3]]
    weights = np.linalg.pinv(np.stack([np.ones_like(at_s), at_s, at_s**2], axis=2))[:, 0]
    smooth[five[:, 2]] = np.einsum("mk,mk->m", weights, yaw_rad[five])
    return smooth


def _noise(steps: FloatArray, place: IntArray) -> FloatArray:
    """Return the standard deviation of estimated steps on both axes, shape (m, 2), where there is no step."""
    noise = np.tile(np.maximum(FINEST_M, NORMAL * np.median(np.abs(steps), axis=0)), (len(steps), 1))
    ends = (-NEAR * BESIDE, -BESIDE, BESIDE + 1, NEAR * BESIDE + 1)
    for i, (first, own, after, last) in enumerate(np.searchsorted(place, place[:, None] + np.array(ends)).tolist()):
        near = np.concatenate([steps[first:own], steps[after:last]])
        if len(near):
            noise[i] = np.maximum(noise[i], NORMAL * np.median(np.abs(near), axis=0))
    return noise
