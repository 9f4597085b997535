"""How a vehicle's body follows the point whose direction of motion its messages report.

A vehicle's rear axle moves along the body. A point that lies l ahead of it moves in another direction while the vehicle
turns; at a car's front, 3.5 m ahead, that is 20 deg off the body at a crossing. Given that point's direction theta
along its path s, the body's yaw psi follows a tractrix: d psi / d s = sin(theta - psi) / l. The distance l is called
the lever. A receiver that reports the body's own yaw, as those with inertial sensors do, has l = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

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
        began; the decrease is the same if it had settled in a bend.
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

    The track of a vehicle that reverses is integrated from its end, as if the vehicle drove forwards: only in forward
    travel does a body forget its initial angle.

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
    step = (np.diff(path, axis=0) * ahead[1:]).sum(axis=1)
    backwards = step.sum() < 0.0
    if backwards:
        theta, step = theta[::-1], step[::-1]
    step = np.abs(step)
    psi = np.empty((len(LEVERS_M), len(stamps)))
    # At the beginning of a bend the body points in the point's direction of motion, later it has settled; which of the
    # two applies is unknown.
    half = np.arcsin(np.clip(LEVERS_M * _bend(theta, step), -MOST_LAG, MOST_LAG)) / 2.0
    psi[:, 0] = theta[0] - half
    rate = np.concatenate([[0.0], 1.0 / LEVERS_M[1:]])  # without a lever the body's yaw is the heading, set below
    middle = (theta[1:] + theta[:-1]) / 2.0
    for i, ds in enumerate(step):
        # Along a straight step, the tangent of half of the angle between body and motion decays exponentially with the
        # distance over the lever.
        lag = 2.0 * np.arctan(np.tan((middle[i] - psi[:, i]) / 2.0) * np.exp(-ds * rate))
        psi[:, i + 1] = middle[i] - lag
    psi[0] = theta
    turned = psi - theta
    begun = half[:, None] * np.exp(-rate[:, None] * np.append(0.0, np.cumsum(step)))
    return BodyYaw(stamps, *(each[:, ::-1] if backwards else each for each in (turned, begun)))


def _bend(theta: FloatArray, step: FloatArray) -> float:
    """Return the curvature at the beginning of a path, 1/m."""
    count = int(np.searchsorted(np.cumsum(step), FIRST_M)) + 1
    passed_m = float(step[:count].sum())
    return float(theta[min(count, len(step))] - theta[0]) / max(passed_m, FIRST_M)
