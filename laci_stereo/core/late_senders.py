"""Other senders that are seen where they would be if only their clocks were set otherwise."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Set
from dataclasses import replace

import numpy as np

from laci_stereo.core.frames import FloatArray
from laci_stereo.core.track_likelihood import Account, hold_against
from laci_stereo.core.track_motion import Motion
from laci_stereo.core.track_scene import TABLE_S, Scene, Sender

LATEST_S = 3.0
"""What a clock is off that nobody has set, by three of its standard deviations."""


def late_senders(
    scene: Scene, motion: Motion, senders: Iterable[Sender], claimed: Set[int]
) -> Iterator[tuple[Account, float]]:
    """Yield what speaks for senders being seen elsewhere on their ways than they say, and how much later they say it.

    A clock that is off moves a vehicle on its way. It is looked for no farther from where its messages have it than it
    is long: nothing else can be there.

    Parameters
    ----------
    scene : Scene
    motion : Motion
        Into the world, as another sender tells it.
    senders : iterable of Sender
        That are not seen where they say.
    claimed : set of int
        Tracks that are others' vehicles.
    """
    for sender in senders:
        late_s = _possible_s(scene, sender, motion)
        held = [hold_against(scene, sender, replace(motion, offset_s=motion.offset_s + each)) for each in late_s]
        apart = [i for i, account in enumerate(held) if account.tracks and claimed.isdisjoint(account.tracks)]
        if apart:
            best = max(apart, key=lambda i: held[i].value)
            # Of so many times the best one was taken.
            yield replace(held[best], value=held[best].value - math.log(len(held))), float(late_s[best])


def _possible_s(scene: Scene, sender: Sender, motion: Motion) -> FloatArray:
    """Return by how much a sender's clock may be off, shape (k,), in steps in which positions are not told apart."""
    stamps_s = np.arange(scene.knots.stamp_s.min(), scene.knots.stamp_s.max(), TABLE_S)
    poses = sender.at(stamps_s + motion.offset_s)
    speeds = np.linalg.norm(poses.velocity[poses.known], axis=1)
    moving = speeds[speeds > sender.length_m / LATEST_S]
    if not len(moving):
        return np.zeros(0)
    speed_mps = float(np.median(moving))
    most_s = sender.length_m / speed_mps
    steps = math.ceil(most_s * speed_mps / scene.settings.position_sigma_m)
    return np.linspace(-most_s, most_s, 2 * steps + 1)
