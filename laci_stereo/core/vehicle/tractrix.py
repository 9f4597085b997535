"""How a vehicle's body follows the point whose direction of motion its messages report.

A vehicle's rear axle moves along the body. A point that lies l ahead of it moves in another direction while the vehicle
turns; at a car's front, 3.5 m ahead, that is 20 deg off the body at a crossing. Given that point's direction theta
along its path s, the body's yaw psi follows a tractrix: d psi / d s = sin(theta - psi) / l. The distance l is called
the lever. A receiver that reports the body's own yaw, as those with inertial sensors do, has l = 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from laci_stereo.core.frames import FloatArray, between

STEP_S = 0.02
"""Time step of the integration, in which a car moves at most half a metre: a fraction of any lever that matters."""

LEVERS_M = np.arange(0.0, 16.51, 0.5)
"""Levers, from the rear axle itself to the front of a lorry with its trailer, the longest by Directive 96/53/EC."""


FIRST_M = 3.0
"""Distance over which the initial curvature is measured where messages begin in a bend: a car's wheelbase, within which
the curvature may change; over less, the noise of two headings would dominate."""

MOST_LAG = 0.8
"""Sine of the largest angle between body and motion: beyond 53 deg a vehicle rotates on the spot, or is articulated."""

BACKED_M = 0.3
"""Longest distance backed up, or driven on, without a new start of the integration: three standard deviations of
positions without corrections, which scatter while a vehicle stands. Integrated as it is, it makes an error grow by
exp(0.3 / 0.5), less than twofold, for the shortest lever. A start too many does no harm, as its angle then follows from
where the integrations meet."""

UNSEEN_BEND_PER_M = 0.1
"""Curvature that a path may have where it is too short to show it: that of bends at crossings, of 10 m radius."""

MET_RAD = 0.01
"""Standard deviation of the angle at which two integrations meet: a heading errs by 0.5 deg. Several of them, along a
lever's length, average out to less, but the course between them, and wheels that turn while the vehicle creeps, add to
it."""

ROUNDS = 3
"""Steps of Gauss and Newton: a decay differs from the exponential by up to a quarter, so each leaves a quarter of what
the one before left."""

_RATE = np.concatenate([[0.0], 1.0 / LEVERS_M[1:]])  # without a lever the body's yaw is the heading, and set apart


@dataclass(frozen=True)
class BodyYaw:
    """The yaw of the body relative to the messages' heading, for any lever.

    Attributes
    ----------
    stamps_s : ndarray, shape (n,)
    turned : ndarray, shape (levers, n)
        The relative yaw for each of `LEVERS_M`, rad.
    begun : ndarray, shape (levers, n)
        Increase of the relative yaw, rad, if the body pointed in the point's direction of motion when the messages
        began; the decrease is the same if it had settled in a bend. Where a vehicle drives on after backing up, it is
        the standard deviation, as if all errors were due to the beginning.
    """

    stamps_s: FloatArray
    turned: FloatArray
    begun: FloatArray

    def at(self, stamps_s: FloatArray, lever_m: float) -> tuple[FloatArray, FloatArray]:
        """Return the relative yaw at some times, shape (m,), and its derivative by the lever [rad/m].

        Beyond the shortest and the longest lever it is extrapolated linearly.
        """
        return _between(self.stamps_s, self.turned, stamps_s, lever_m)

    def begun_at(self, stamps_s: FloatArray, lever_m: float) -> tuple[FloatArray, FloatArray]:
        """Return the possible increase or decrease of the relative yaw at some times, and its derivative by lever."""
        return _between(self.stamps_s, self.begun, stamps_s, lever_m)


def _between(
    known_s: FloatArray, values: FloatArray, stamps_s: FloatArray, lever_m: float
) -> tuple[FloatArray, FloatArray]:
    """Interpolate values of all levers, shape (levers, n), in time and lever; return their derivative by lever too."""
    spacing = LEVERS_M[1]
    index = int(np.clip(lever_m // spacing, 0, len(LEVERS_M) - 2))
    low, high = (np.interp(stamps_s, known_s, values[i]) for i in (index, index + 1))
    slope = (high - low) / spacing
    return low + slope * (lever_m - LEVERS_M[index]), slope


def body_yaw(stamps_s: FloatArray, xy: FloatArray, yaw_rad: FloatArray) -> BodyYaw:
    """Integrate the tractrix of every lever along a vehicle's track.

    Only in forward travel does a body forget its initial angle. Therefore every integration starts where the vehicle is
    farther back than before and after: at the first message, at the last one of a vehicle that reverses, and where one
    that has backed up drives on. From there the track is integrated on both sides in time as if driven forwards. Where
    two of these integrations meet, which is where the vehicle begins to back up, the body has one yaw.

    Parameters
    ----------
    stamps_s : ndarray, shape (n,)
        Times of the messages, ascending.
    xy : ndarray, shape (n, 2)
        Positions of the vehicle's middle, world frame.
    yaw_rad : ndarray, shape (n,)
        The reported headings as yaw, unwrapped.
    """
    first, last = stamps_s[[0, -1]]
    stamps = np.linspace(first, last, max(2, int(np.ceil((last - first) / STEP_S)) + 1))
    path = between(stamps, stamps_s, xy)
    theta = np.interp(stamps, stamps_s, yaw_rad)
    if len(stamps_s) > 2:  # as in `VehicleTrack.at`
        theta = Akima1DInterpolator(stamps_s, yaw_rad, method="makima")(stamps)
    ahead = np.column_stack([np.cos(theta), np.sin(theta)])
    driven = np.append(0.0, np.cumsum((np.diff(path, axis=0) * ahead[1:]).sum(axis=1)))
    cusps = _cusps(driven)
    rearmost = range(int(driven[cusps[1]] < driven[0]), len(cusps), 2)
    parts = [slice(cusps[max(k - 1, 0)], cusps[min(k + 1, len(cusps) - 1)] + 1) for k in rearmost]
    bodies = [_Body(theta[part], driven[part], cusps[k] - part.start) for part, k in zip(parts, rearmost, strict=True)]
    begins, unsure = _joined(bodies)
    turned, begun = np.empty((2, len(LEVERS_M), len(stamps)))
    for part, body, begin, sigma in zip(parts, bodies, begins, unsure, strict=True):
        turned[:, part] = body.yaw(begin) - theta[part]
        begun[:, part] = sigma[:, None] * body.decay
    begun[0] = 0.0
    return BodyYaw(stamps, turned, begun)


def _cusps(driven_m: FloatArray) -> list[int]:
    """Return the indices at which a vehicle turns to driving back or on, and those of both ends.

    Parameters
    ----------
    driven_m : ndarray, shape (n,)
        Distance driven along the path, which decreases while the vehicle reverses.
    """
    cusps, end, way = [0], 0, 0.0
    for index, gone in enumerate(driven_m.tolist()):
        gone -= float(driven_m[end])
        if gone * way > 0.0:
            end = index
        elif abs(gone) > BACKED_M:
            cusps += [end] if way else []
            end, way = index, np.sign(gone)
    return [*cusps, len(driven_m) - 1]


@dataclass(frozen=True)
class _Body:
    """A body along the part of a track that is integrated from one place.

    Attributes
    ----------
    theta : ndarray, shape (n,)
        Direction of motion of the point ahead.
    driven_m : ndarray, shape (n,)
        Distance driven along the path.
    start : int
        Index of that place, the rearmost.
    """

    theta: FloatArray
    driven_m: FloatArray
    start: int

    @cached_property
    def initial(self) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of the body's yaw at the start, shapes (levers,).

        At the beginning of a bend the body points in the point's direction of motion, later it has settled; which of
        the two applies is unknown. Where the vehicle turns to driving on, its wheels may turn while it stands, and both
        sides tell. Sides too short to show a bend may be in one. The sign of the standard deviation is the bend's.
        """
        sides = [side for side in self._sides if np.ptp(self.driven_m[side]) >= FIRST_M]
        if not sides:
            return np.full(len(LEVERS_M), self.theta[self.start]), _settled(UNSEEN_BEND_PER_M)
        halves, means = np.empty((2, len(sides), len(LEVERS_M)))
        inner = 0 < self.start < len(self.theta) - 1
        for k, side in enumerate(sides):
            theta, gone = self.theta[side], self.driven_m[side] - self.driven_m[self.start]
            first = int(np.argmax(gone > BACKED_M)) if inner else 0
            halves[k] = _settled(_bend(theta[first:], np.diff(gone[first:]))) / 2.0
            means[k] = theta[first] - halves[k]
        sigma = np.sqrt(np.mean(halves**2, axis=0) + np.var(means, axis=0))
        return means.mean(axis=0), np.copysign(sigma, halves[0])

    @property
    def _sides(self) -> tuple[slice, slice]:
        """Before the start, backwards in time, and after it."""
        return slice(self.start, None, -1), slice(self.start, None)

    @cached_property
    def decay(self) -> FloatArray:
        """What is left of an initial angle, shape (levers, n)."""
        ahead_m = np.maximum(self.driven_m - self.driven_m[self.start], 0.0)
        decay: FloatArray = np.exp(-_RATE[:, None] * ahead_m)
        return decay

    def yaw(self, begin: FloatArray) -> FloatArray:
        """Return the body's yaw, shape (levers, n), from its initial one, in standard deviations, shape (levers,)."""
        mean, sigma = self.initial
        yaw = np.empty((len(LEVERS_M), len(self.theta)))
        for side in self._sides:
            theta = self.theta[side]
            yaw[:, side] = _followed(theta, np.diff(self.driven_m[side]), mean + begin * sigma)
        return yaw


def _joined(bodies: list[_Body]) -> tuple[FloatArray, FloatArray]:
    """Return the initial yaws with which each body meets the next, and their standard deviations.

    A body does not turn while it stands, even if its wheels do. Least squares: each initial yaw is known as `_Body`
    has it, and two bodies meet within `MET_RAD`.

    Returns
    -------
    begins : ndarray, shape (bodies, levers)
        Deviations from the mean, in standard deviations.
    sigma : ndarray, shape (bodies, levers)
        Radians; with the sign that the first body's has.
    """
    count = len(bodies)
    initial = np.stack([body.initial[1] for body in bodies], axis=1)
    begins = np.zeros_like(initial)
    if count == 1:
        return begins.T, initial.T
    meet = np.zeros((len(LEVERS_M), count - 1, count))
    for k, (one, other) in enumerate(pairwise(bodies)):
        meet[:, k, k], meet[:, k, k + 1] = one.decay[:, -1], -other.decay[:, 0]
    meet *= initial[:, None] / MET_RAD
    known = np.eye(count) + meet.transpose(0, 2, 1) @ meet
    for _ in range(ROUNDS):
        yaws = [body.yaw(begin) for body, begin in zip(bodies, begins.T, strict=True)]
        apart = np.stack([one[:, -1] - other[:, 0] for one, other in pairwise(yaws)], axis=1) / MET_RAD
        wanted = (meet @ begins[:, :, None])[:, :, 0] - apart
        begins = np.linalg.solve(known, (meet.transpose(0, 2, 1) @ wanted[:, :, None]))[:, :, 0]
    sigma = np.sqrt(np.diagonal(np.linalg.inv(known), axis1=1, axis2=2))
    return begins.T, np.copysign(initial * sigma, initial[:, :1]).T


def _followed(theta: FloatArray, step: FloatArray, start: FloatArray) -> FloatArray:
    """Return the body's yaw along a path, shape (levers, n), from its yaw at the start, shape (levers,)."""
    psi = np.empty((len(LEVERS_M), len(theta)))
    psi[:, 0] = start
    middle = (theta[1:] + theta[:-1]) / 2.0
    for i, ds in enumerate(step):
        # Along a straight step, the tangent of half of the angle between body and motion decays exponentially with the
        # distance over the lever.
        lag = 2.0 * np.arctan(np.tan((middle[i] - psi[:, i]) / 2.0) * np.exp(-ds * _RATE))
        psi[:, i + 1] = middle[i] - lag
    psi[0] = theta
    return psi


def _settled(bend_per_m: float) -> FloatArray:
    """Return the angle between motion and body once it has settled in a bend, shape (levers,)."""
    settled: FloatArray = np.arcsin(np.clip(LEVERS_M * bend_per_m, -MOST_LAG, MOST_LAG))
    return settled


def _bend(theta: FloatArray, step: FloatArray) -> float:
    """Return the curvature at the beginning of a path, 1/m."""
    count = int(np.searchsorted(np.cumsum(step), FIRST_M)) + 1
    passed_m = float(step[:count].sum())
    return float(theta[min(count, len(step))] - theta[0]) / max(passed_m, FIRST_M)
