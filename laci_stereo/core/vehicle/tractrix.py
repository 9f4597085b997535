"""How a vehicle's body follows the point whose direction of motion its messages tell.

A vehicle's rear axle moves along the body. A point that lies l ahead of it moves in another direction while the vehicle
turns; at a car's front, 3.5 m ahead, that is 20 deg off the body at a crossing. Given that point's direction theta
along its path s, the body's yaw psi follows a tractrix: d psi / d s = sin(theta - psi) / l. A receiver that tells the
body's own yaw, as those with inertial sensors do, has l = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from laci_stereo.core.frames import FloatArray, between

STEP_S = 0.02
"""In which a car moves half a metre at most, a fraction of any lever that matters."""

LEVERS_M = np.arange(0.0, 16.51, 0.5)
"""From the rear axle itself to the front of a lorry with its trailer, the longest by Directive 96/53/EC."""


FIRST_M = 3.0
"""Over so much of its way a vehicle whose messages begin in a bend tells how it bends: a car's wheelbase, within which
that may change; over less, the noise of two headings would."""

MOST_LAG = 0.8
"""Sine of the largest angle between body and motion: beyond 53 deg a vehicle is turned on the spot, or folded."""


@dataclass(frozen=True)
class BodyYaw:
    """By how much the body is turned against the messages' heading, for any lever.

    Attributes
    ----------
    stamps_s : ndarray, shape (n,)
    turned : ndarray, shape (levers, n)
        For each of `LEVERS_M`, rad.
    begun : ndarray, shape (levers, n)
        By how much more it is turned, rad, if the body stood as the point moved when the messages began; by as much
        less if it had settled in a bend.
    """

    stamps_s: FloatArray
    turned: FloatArray
    begun: FloatArray

    def at(self, stamps_s: FloatArray, lever_m: float) -> tuple[FloatArray, FloatArray]:
        """Return the turn at some times, shape (m,), and its derivative by the lever [rad/m].

        Beyond the shortest and the longest lever the turn goes on as it began.
        """
        return _between(self.stamps_s, self.turned, stamps_s, lever_m)

    def begun_at(self, stamps_s: FloatArray, lever_m: float) -> tuple[FloatArray, FloatArray]:
        """Return by how much it may be turned more or less at some times, and the derivative of that by the lever."""
        return _between(self.stamps_s, self.begun, stamps_s, lever_m)


def _between(
    known_s: FloatArray, values: FloatArray, stamps_s: FloatArray, lever_m: float
) -> tuple[FloatArray, FloatArray]:
    """Return values of all levers, shape (levers, n), at some times and for one lever, and their derivative by it."""
    spacing = LEVERS_M[1]
    index = int(np.clip(lever_m // spacing, 0, len(LEVERS_M) - 2))
    low, high = (np.interp(stamps_s, known_s, values[i]) for i in (index, index + 1))
    slope = (high - low) / spacing
    return low + slope * (lever_m - LEVERS_M[index]), slope


def body_yaw(stamps_s: FloatArray, xy: FloatArray, yaw_rad: FloatArray) -> BodyYaw:
    """Lay the tractrix of every lever along a vehicle's track.

    A vehicle that reverses is followed from its end: only in the direction of travel does a body forget how it stood.

    Parameters
    ----------
    stamps_s : ndarray, shape (n,)
        Of the messages, ascending.
    xy : ndarray, shape (n, 2)
        Of the vehicle's middle, world frame.
    yaw_rad : ndarray, shape (n,)
        The headings that were told, unwrapped.
    """
    first, last = stamps_s[[0, -1]]
    stamps = np.linspace(first, last, max(2, int(np.ceil((last - first) / STEP_S)) + 1))
    path = between(stamps, stamps_s, xy)
    theta = np.interp(stamps, stamps_s, yaw_rad)
    if len(stamps_s) > 2:  # as `VehicleTrack.at` has it
        theta = Akima1DInterpolator(stamps_s, yaw_rad, method="makima")(stamps)
    ahead = np.column_stack([np.cos(theta), np.sin(theta)])
    step = (np.diff(path, axis=0) * ahead[1:]).sum(axis=1)
    backwards = step.sum() < 0.0
    if backwards:
        theta, step = theta[::-1], step[::-1]
    step = np.abs(step)
    psi = np.empty((len(LEVERS_M), len(stamps)))
    # At a bend's begin the body stands as the point moves, later it has settled; which of both it is nothing tells.
    half = np.arcsin(np.clip(LEVERS_M * _bend(theta, step), -MOST_LAG, MOST_LAG)) / 2.0
    psi[:, 0] = theta[0] - half
    rate = np.concatenate([[0.0], 1.0 / LEVERS_M[1:]])  # without a lever the body is the heading, which is set below
    middle = (theta[1:] + theta[:-1]) / 2.0
    for i, ds in enumerate(step):
        # Along a straight step the tangent of half of the angle between body and motion decays with the lever.
        lag = 2.0 * np.arctan(np.tan((middle[i] - psi[:, i]) / 2.0) * np.exp(-ds * rate))
        psi[:, i + 1] = middle[i] - lag
    psi[0] = theta
    turned = psi - theta
    begun = half[:, None] * np.exp(-rate[:, None] * np.append(0.0, np.cumsum(step)))
    return BodyYaw(stamps, *(each[:, ::-1] if backwards else each for each in (turned, begun)))


def _bend(theta: FloatArray, step: FloatArray) -> float:
    """Return the curvature at the beginning of a way, 1/m."""
    count = int(np.searchsorted(np.cumsum(step), FIRST_M)) + 1
    passed_m = float(step[:count].sum())
    return float(theta[min(count, len(step))] - theta[0]) / max(passed_m, FIRST_M)
