"""Clock offsets by which the vehicles of two senders fit one motion.

On a straight road at constant speed, a track fits its sender's messages with any clock offset, at another place along
the road. Of two vehicles that drive in different directions, only one offset has both where they are seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from laci_stereo.core.association.motion import (
    SEARCH_KNOTS,
    WORST,
    Motion,
    Seed,
    completed,
    cost,
    offset_steps,
    path_shares,
    rigid_motion,
    trust,
)
from laci_stereo.core.association.scene import Scene
from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.subsampling import evenly

MOST = 12
"""Number of alignments, the best by themselves, that are paired: of so many there are 66 pairs."""

REFINEMENTS = 3
"""Number of finer grids of clock offsets, as for one track."""

ONE_STEP = 3
"""Number of offsets of a grid that has one step to either side."""


def meeting_seeds(scene: Scene, seeds: Sequence[Seed]) -> list[Seed]:
    """Return alignments of two tracks with two senders by one motion, each as a seed of both, the best first.

    There are none where clocks are synchronised to one step of the search, as nothing is open then. A pair counts if
    both fit together as well as each by itself.
    """
    grids = {station: offset_steps(sender, scene.settings) for station, sender in scene.senders.items()}
    good = [seed for seed in seeds if seed.share >= scene.settings.min_explained][:MOST]
    found = []
    for pair in combinations(good, 2):
        offsets_s, step_s = max((grids[seed.station] for seed in pair), key=lambda grid: len(grid[0]))
        apart = len({seed.station for seed in pair}) == len({seed.track for seed in pair}) == 2
        if apart and len(offsets_s) > ONE_STEP:
            score, motion = _together(scene, pair, offsets_s, step_s)
            if score > sum(seed.score for seed in pair) - scene.settings.least_log_odds:
                found += [Seed(seed.station, seed.track, motion, score, seed.share, meeting=True) for seed in pair]
    return sorted(found, key=lambda seed: -seed.score)


def _together(scene: Scene, pair: Sequence[Seed], offsets_s: FloatArray, step_s: float) -> tuple[float, Motion]:
    """Return the score of a pair, and its best motion and clock offset, by a grid of offsets and finer ones."""
    best = _best(scene, pair, offsets_s)
    for _ in range(REFINEMENTS):
        best = _best(scene, pair, best[1].offset_s + np.linspace(-step_s, step_s, 7))
        step_s /= 3
    return best


def _best(scene: Scene, pair: Sequence[Seed], offsets_s: FloatArray) -> tuple[float, Motion]:
    """Return the score and the motion by the best of some clock offsets, shape (g,)."""
    settings = scene.settings
    seen = []
    for seed in pair:
        knots = scene.knots[(scene.knots.track == seed.track) & scene.knots.usable]
        knots = knots[evenly(len(knots), SEARCH_KNOTS)]
        sender = scene.senders[seed.station]
        poses = sender.at(knots.stamp_s + offsets_s[:, None])
        seen.append((knots, poses, poses.known * path_shares(poses, knots.stamp_s, settings), sender))
    world = np.concatenate([poses.xy for _, poses, _, _ in seen], axis=1)
    weight = np.concatenate([weight for _, _, weight, _ in seen], axis=1)
    level = np.concatenate([np.broadcast_to(knots.xy, poses.xy.shape) for knots, poses, _, _ in seen], axis=1)
    yaw, shift = rigid_motion(level, world, weight)
    q = np.zeros_like(weight)
    for widening in (16.0, 4.0, 1.0, 1.0):
        parts = [completed(knots, poses, yaw[:, None], sender, settings) for knots, poses, _, sender in seen]
        level, sigma = (np.concatenate(each, axis=1) for each in zip(*parts, strict=True))
        remains = rotate_xy(yaw[:, None], level) + shift[:, None] - world
        q = (remains**2).sum(axis=-1) / sigma**2
        yaw, shift = rigid_motion(level, world, weight * trust(q / widening) / sigma**2)
    score = (weight * (WORST - cost(q))).sum(axis=1) - (offsets_s / settings.clock_sigma_s) ** 2 / 2
    i = int(np.argmax(score))
    return float(score[i]), Motion(yaw[i], shift[i], offsets_s[i])
