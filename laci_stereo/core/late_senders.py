"""Other senders that are seen where they would be if only their clocks were set otherwise."""

from __future__ import annotations

import math
from collections.abc import Set
from dataclasses import replace

import numpy as np

from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.settings import UNKNOWN_CLOCK_S
from laci_stereo.core.track_likelihood import Account, hold_against
from laci_stereo.core.track_motion import Motion
from laci_stereo.core.track_scene import TABLE_S, Scene, Sender

LATEST_S = 3.0 * UNKNOWN_CLOCK_S
"""What a clock is off that nobody has set, by three of its standard deviations. Whoever takes longer for its own length
hardly moves."""


def by_another_clock(scene: Scene, motion: Motion, sender: Sender, claimed: Set[int]) -> tuple[Account, float] | None:
    """Return what speaks for a sender being seen elsewhere on its way than it says, and how much later it says it.

    A clock that is off moves a vehicle on its way. It is looked for no farther from where its messages have it than it
    is long: nothing else can be there.

    Parameters
    ----------
    scene : Scene
    motion : Motion
        Into the world, as another sender tells it.
    sender : Sender
        That is not seen where it says.
    claimed : set of int
        Tracks that are others' vehicles.

    Returns
    -------
    tuple of Account and float, or None
        Seconds; None where nothing is seen.
    """
    late_s = _possible_s(scene, sender, motion)
    held = [hold_against(scene, sender, replace(motion, offset_s=motion.offset_s + each)) for each in late_s]
    apart = [i for i, account in enumerate(held) if account.tracks and claimed.isdisjoint(account.tracks)]
    if not apart:
        return None
    best = max(apart, key=lambda i: held[i].value)
    # Of so many times the best one was taken.
    return replace(held[best], value=held[best].value - math.log(len(held))), float(late_s[best])


def _possible_s(scene: Scene, sender: Sender, motion: Motion) -> FloatArray:
    """Return by how much a sender's clock may be off, shape (k,), in steps in which positions are not told apart.

    Empty where it does not drive in view.
    """
    stamps_s = np.arange(scene.knots.stamp_s.min(), scene.knots.stamp_s.max(), TABLE_S)
    poses = sender.at(stamps_s + motion.offset_s)
    there = poses.known & scene.in_view(rotate_xy(-motion.yaw_rad, poses.xy - motion.shift))
    speeds_mps = np.linalg.norm(poses.velocity[there], axis=1)
    moving_mps = speeds_mps[speeds_mps > sender.length_m / LATEST_S]
    if not len(moving_mps):
        return np.zeros(0)
    most_s = sender.length_m / float(np.median(moving_mps))
    steps = math.ceil(sender.length_m / scene.settings.position_sigma_m)
    return np.linspace(-most_s, most_s, 2 * steps + 1)
