"""Objects that stay right ahead of a vehicle or right behind it, at its reported positions, whether it is seen or not.

While a part of a vehicle is in view, the object that was taken for all of it may be out of view: a lorry manoeuvres
below a scanner that sees its cab when it does not see its trailer.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from laci_stereo.core.association.hypotheses import unseen_s
from laci_stereo.core.association.pieces import LARGEST_GAP_M, MORE_OFTEN
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.repair import WIDEST_M
from laci_stereo.core.robust import weighted_median
from laci_stereo.core.tracking.tracks import Track

MOVES_MPS = 0.5
"""Frames in which a vehicle is slower are not used: any object near it stays there."""

STAYS_M = 0.25
"""Accuracy to which a scanner's rings and a matcher's windows show an edge. The gap to a vehicle that drives ahead
changes by more: at speeds that differ by a twentieth, by half a metre over the length of two cars."""

BACKS_M = 1.0
"""Nobody stays so close to another vehicle that reverses and drives on again, each by this distance."""


@dataclass(frozen=True)
class _Ride:
    """An object that stays at one end of a vehicle: the vehicle's advance up to each frame meanwhile, and its length.

    The length includes the gap to the vehicle.
    """

    ahead: bool
    steps_m: dict[float, float]
    length_m: float


def ridden_frames(passages: Sequence[Passage], tracks: Sequence[Track], match: PlanarMatch) -> tuple[int, ...]:
    """Return for each drive in how many frames an object stays right ahead of its vehicle or right behind it.

    It must be in line with the vehicle, with a gap that hardly changes, while the vehicle either drives by more than
    both are long, for which nobody stays so close to another, or drives back and forth.

    Parameters
    ----------
    passages : sequence of Passage
        Drives with their clock offsets.
    tracks : sequence of Track
        Everything that moved, in the level frame of the passages.
    match : PlanarMatch
        Motion from the level into the world frame.
    """
    others = [track for track in tracks if not any(each.track.shares(track) for each in passages)]
    return tuple(_ridden(passage, others, match) for passage in passages)


def _ridden(passage: Passage, tracks: Sequence[Track], match: PlanarMatch) -> int:
    rides = list(_rides(passage, tracks, match))
    frames = 0
    for ahead in (True, False):
        at_end = [ride for ride in rides if ride.ahead is ahead]
        steps_m = np.array(list({frame: step for ride in at_end for frame, step in ride.steps_m.items()}.values()))
        forth_m, back_m = steps_m.clip(0.0).sum(), (-steps_m).clip(0.0).sum()
        both_m = passage.vehicle.length_m + max((ride.length_m for ride in at_end), default=0.0)
        if forth_m + back_m > both_m or min(forth_m, back_m) > BACKS_M:
            frames += len(steps_m)
    return frames


def _rides(passage: Passage, tracks: Sequence[Track], match: PlanarMatch) -> Iterator[_Ride]:
    for track in tracks:
        seen = [one for one in track.usable if len(one.points) and one.sigma_m < STAYS_M]
        stamps_s = np.array([one.stamp_s for one in seen])
        xy, yaw, known = passage.vehicle.at(stamps_s + passage.time_offset_s)
        seen = [one for one, is_known in zip(seen, known, strict=True) if is_known]
        if len(seen) < 2:
            continue
        stamps_s, xy, yaw = stamps_s[known], xy[known], yaw[known]
        steps_m, driven_m = _driven(stamps_s, xy, yaw)
        if driven_m.sum() == 0.0:
            continue
        around = [
            rotate_xy(-heading, match(one.points[:, :2]) - at) for one, at, heading in zip(seen, xy, yaw, strict=True)
        ]
        rear, right, front, left = np.array([(*each.min(axis=0), *each.max(axis=0)) for each in around]).T
        ahead = bool(np.average(front + rear, weights=driven_m) > 0.0)
        gap_m = (rear if ahead else -front) - passage.vehicle.length_m / 2
        usual_m = weighted_median(gap_m, driven_m)
        over_m = STAYS_M + 2.0 * np.array([one.sigma_m for one in seen])
        stays = (np.abs(gap_m - usual_m) < over_m) & (np.maximum(-right, left) < WIDEST_M / 2 + over_m)
        if -over_m.min() < usual_m < LARGEST_GAP_M and np.average(stays, weights=driven_m) > MORE_OFTEN:
            steps = {one.frame_s: step for one, step in zip(seen[1:], steps_m.tolist(), strict=True) if step != 0.0}
            yield _Ride(ahead, steps, usual_m + float(np.median(front - rear)))


def _driven(stamps_s: FloatArray, xy: FloatArray, yaw: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a vehicle's advance between frames, shape (n - 1,), and the distance each frame represents, (n,)."""
    passed_s = np.diff(stamps_s)
    steps_m = (np.diff(xy, axis=0) * np.column_stack([np.cos(yaw[1:]), np.sin(yaw[1:])])).sum(axis=1)
    steps_m = np.where((passed_s < unseen_s(stamps_s)) & (np.abs(steps_m) > MOVES_MPS * passed_s), steps_m, 0.0)
    parts_m: FloatArray = (np.append(np.abs(steps_m), 0.0) + np.append(0.0, np.abs(steps_m))) / 2.0
    return steps_m, parts_m
