"""Where a receiver's positions jump aside, by less than one message may be off by itself, so that all after it are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from laci_stereo.core.frames import FloatArray, IntArray, rotate_xy
from laci_stereo.core.receiver import FINEST_M
from laci_stereo.core.robust import NORMAL

BESIDE = 5
"""Messages on either side that tell a step: it has the noise of one message, 1.3 times."""

LONGEST_S = 1.5
"""These must be together within so long, as those are that come every 0.15 s: of seldom ones bends look like steps."""

SURELY = 6.0
"""A step is beyond so many standard deviations, on two axes: of 60 million places without one is one."""

NEAR = 4
"""Of the noise tell all places, and those near by, up to so many times as many messages away as tell a step, and none
of them: where it drives fast, inexact headings and stamps make more."""

BEYOND_TOLD = 4.0
"""A step must be beyond so many standard deviations of what messages tell of their positions, too."""


def largest_step(
    stamps_s: FloatArray,
    xy: FloatArray,
    yaw_rad: FloatArray,
    onwards_mps: FloatArray,
    levers: Sequence[tuple[float, float]],
    sigma_m: float,
) -> tuple[float, float]:
    """Return by how far positions jump aside at most, metres, and when; 0 where they do not.

    Speeds and headings lead on from one to the next. Beside a parabola, which is what wrong headings and speeds make of
    a way, the positions of some messages before and after each place have a step, or none; not if it goes with one of
    these messages. Of all points that may go where the heading points, the one counts that has the least.

    Parameters
    ----------
    stamps_s : ndarray, shape (n,)
        Ascending.
    xy : ndarray, shape (n, 2)
        Positions in the world, metres.
    yaw_rad : ndarray, shape (n,)
        Of the body.
    onwards_mps : ndarray, shape (n,)
        Speeds as told, negative backwards.
    levers : sequence of tuple of float
        See `laci_stereo.core.cam_repair.levers`.
    sigma_m : float
        What the messages tell of their positions; NaN where nothing.
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
    # Inexact headings move a point by its lever, which bends tell: straight on, a point without one has less noise.
    # Smoothed headings are more exact, but where a bend begins.
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
    """Return the steps before the messages ``place``, shape (m, 2), by the messages ``around``, shape (m, q)."""
    at_s = stamps_s[around] - stamps_s[place][:, None]
    later = np.asarray(around >= place[:, None], dtype=np.float64)
    by_step = np.linalg.pinv(np.stack([np.ones_like(at_s), at_s, at_s**2, later], axis=2))[:, 3]
    steps: FloatArray = np.einsum("mk,mkj->mj", by_step, off[around])
    return steps


def _smoothed(stamps_s: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Return yaws by parabolas through each message and the two before and after (Savitzky and Golay 1964)."""
    smooth: FloatArray = yaw_rad.copy()
    five = np.arange(-2, 3) + np.arange(2, len(yaw_rad) - 2)[:, None]
    five = five[np.ptp(stamps_s[five], axis=1) <= LONGEST_S / 2.0]
    at_s = stamps_s[five] - stamps_s[five[:, 2:3]]
    weights = np.linalg.pinv(np.stack([np.ones_like(at_s), at_s, at_s**2], axis=2))[:, 0]
    smooth[five[:, 2]] = np.einsum("mk,mk->m", weights, yaw_rad[five])
    return smooth


def _noise(steps: FloatArray, place: IntArray) -> FloatArray:
    """Return the standard deviation of steps on both axes, shape (m, 2), where there are none."""
    noise = np.tile(np.maximum(FINEST_M, NORMAL * np.median(np.abs(steps), axis=0)), (len(steps), 1))
    ends = (-NEAR * BESIDE, -BESIDE, BESIDE + 1, NEAR * BESIDE + 1)
    for i, (first, own, after, last) in enumerate(np.searchsorted(place, place[:, None] + np.array(ends)).tolist()):
        near = np.concatenate([steps[first:own], steps[after:last]])
        if len(near):
            noise[i] = np.maximum(noise[i], NORMAL * np.median(np.abs(near), axis=0))
    return noise
