"""Other senders whose vehicles are seen where they would be if only the senders' clocks were set differently."""

from __future__ import annotations

import math
from collections.abc import Set
from dataclasses import replace

import numpy as np

from laci_stereo.core.association.likelihood import Account, hold_against
from laci_stereo.core.association.motion import Motion
from laci_stereo.core.association.scene import TABLE_S, Scene, Sender
from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.settings import UNKNOWN_CLOCK_S

LATEST_S = 3.0 * UNKNOWN_CLOCK_S
"""Largest offset of a clock that nobody has set: three of its standard deviations. A vehicle that takes longer to drive
its own length hardly moves."""


def by_another_clock(scene: Scene, motion: Motion, sender: Sender, claimed: Set[int]) -> tuple[Account, float] | None:
    """Return the evidence that a sender is seen elsewhere on its path than it reports, and its clock offset.

    A wrong clock displaces a vehicle along its path. The search extends no farther from the reported position than the
    vehicle's length: no other object can be there.

    Parameters
    ----------
    scene : Scene
    motion : Motion
        Motion into the world, as determined by another sender.
    sender : Sender
        A sender that is not seen where it reports.
    claimed : set of int
        Tracks that are other senders' vehicles.

    Returns
    -------
    tuple of Account and float, or None
        How much later, in seconds, the sender's clock is than the motion's; None where nothing is seen.
    """
    late_s = _possible_s(scene, sender, motion)
    held = [hold_against(scene, sender, replace(motion, offset_s=motion.offset_s + each)) for each in late_s]
    apart = [i for i, account in enumerate(held) if account.tracks and claimed.isdisjoint(account.tracks)]
    if not apart:
        return None
    best = max(apart, key=lambda i: held[i].value)
    # Look-elsewhere penalty: the best of several times was taken.
    return replace(held[best], value=held[best].value - math.log(len(held))), float(late_s[best])


def _possible_s(scene: Scene, sender: Sender, motion: Motion) -> FloatArray:
    """Return the offsets of a sender's clock to try, shape (k,), in steps within which positions are indistinguishable.

    Empty where the vehicle does not drive in view.
    """
    stamps_s = np.arange(scene.knots.stamp_s.min(), scene.knots.stamp_s.max(), TABLE_S)
    poses = sender.at(stamps_s + motion.offset_s)
    in_view = poses.known & scene.in_view(rotate_xy(-motion.yaw_rad, poses.xy - motion.shift))
    speeds_mps = np.linalg.norm(poses.velocity[in_view], axis=1)
    moving_mps = speeds_mps[speeds_mps > sender.length_m / LATEST_S]
    if not len(moving_mps):
        return np.zeros(0)
    most_s = sender.length_m / float(np.median(moving_mps))
    steps = math.ceil(sender.length_m / scene.settings.position_sigma_m)
    return np.linspace(-most_s, most_s, 2 * steps + 1)
