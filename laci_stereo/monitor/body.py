"""Which tracks are parts of one body: a sparse scanner's beams, or a flank on which nothing matches, leave gaps in it.

Two vehicles cannot be where there is room for one only. Parts of a body therefore tell themselves: together, they are
as long and as wide as the object is in the frames in which it is seen in one piece.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, rotate_xy
from laci_stereo.core.settings import BoxSettings
from laci_stereo.monitor.kept import UNIT_M, Kept, in_units

BODY_M = (3.0, 1.8)
"""Largest distances between parts of one car, along and across its path. Cars behind each other are farther apart even
in a queue, by 4 m and a gap of 1 m, and cars beside each other by the width of a lane, 2.75 m and more."""

COMMON_FRAMES = 5
"""Least number of frames in which two tracks are both seen for them to be compared."""

NEARBY = 3
"""The direction of travel in a frame is taken from this many frames before it to as many after it."""

NEARLY_ALL = 0.9
"""Least fraction of the common frames in which parts of one body are within `BODY_M` of each other."""

WHOLE_FRAMES = 5
"""Least number of frames with a single outline from which the size of the whole body is known."""

WHOLE_SHARE = 0.75
"""The size of the whole body is this quantile over those frames, as in a passage: some of them show a part of it."""

ONE_M = (6.0, 2.75)
"""Largest length and width of parts that can be one body, whatever is seen in other frames, where two vehicles may have
run together. Even two of the shortest cars, of 2.7 m, take up 6.4 m with the least gap, 1 m; and the outer sides of two
vehicles side by side are farther apart than a lane is wide."""

APART_M = 1.0
"""Least gap between vehicles, behind each other in a queue or beside each other in lanes (2.75 m less a car's width):
together, two vehicles exceed the larger one at least by this, and by as much as is seen of the other."""

END_M = BoxSettings.line_tolerance_m
"""The end of a body is known to within this, or to within twice the standard deviation of its points' noise if that is
larger. It is the tolerance of the sizes that are compared; where it exceeds `APART_M`, that takes its place."""

END_SHARE = 0.02
"""Fraction of an outline's points that may lie beyond either end: outliers that the density filter kept."""

CHORD_M = 1.0
"""The direction of travel is known where the object moved by at least this between the frames it is taken from."""


def one_body(track: Sequence[Kept], other: Sequence[Kept]) -> bool:
    """Return whether two tracks are parts of one body: near each other all the time, or together as large as one."""
    if track[-1].frame < other[0].frame or other[-1].frame < track[0].frame:
        return False
    other_at = {kept.frame: kept for kept in other}
    pairs = [(kept, other_at[kept.frame]) for kept in track if kept.frame in other_at]
    return len(pairs) >= COMMON_FRAMES and (_near(pairs) or _as_large_as_one(pairs, [*track, *other]))


def _near(pairs: Sequence[tuple[Kept, Kept]]) -> bool:
    """Return whether two tracks move together within the extent of a car's body in their common frames."""
    middles, other_middles = (np.array([kept.middle for kept in side]) for side in zip(*pairs, strict=True))
    if np.linalg.norm(middles[-1] - middles[0]) < BODY_M[0]:
        return False
    apart = np.abs(rotate_xy(-_direction(_ways(middles)), middles - other_middles))
    return bool((apart < BODY_M).all(axis=1).mean() >= NEARLY_ALL)


def _as_large_as_one(pairs: Sequence[tuple[Kept, Kept]], both: Sequence[Kept]) -> bool:
    """Return whether two tracks are together as large as their object where only one of them is seen.

    A part is missing in the frames in which the body is seen in one piece, and either track may have that piece. So
    ``both``, all that is kept of the tracks, gives the body's size, and the common frames give that of the parts
    together; two vehicles are larger than one by the gap between them and the second one's visible part.
    """
    common = {kept.frame: (kept, part) for kept, part in pairs}
    shown: dict[int, tuple[Kept, ...]] = {kept.frame: (kept,) for kept in both if kept.frame not in common}
    shown |= common
    outlined = [parts for _, parts in sorted(shown.items()) if all(len(part.outline) for part in parts)]
    apart_m = [np.linalg.norm(parts[0].middle - parts[1].middle) for parts in outlined if len(parts) == 2]
    if len(apart_m) < COMMON_FRAMES or np.median(apart_m) > np.hypot(*ONE_M):
        return False
    middles = np.array([np.mean([part.middle for part in parts], axis=0) for parts in outlined])
    ways = _ways(middles)
    known: BoolArray = np.linalg.norm(ways, axis=1) >= CHORD_M
    sizes: FloatArray = np.array([_size(parts, yaw) for parts, yaw in zip(outlined, _direction(ways), strict=True)])
    split = np.array([len(parts) == 2 for parts in outlined])
    if (known & split).sum() < COMMON_FRAMES or (known & ~split).sum() < WHOLE_FRAMES:
        return False
    sigma_m = float(np.median([part.sigma_m for parts in outlined if len(parts) == 2 for part in parts]))
    tolerance_m = min(APART_M, max(END_M, 2 * sigma_m))
    together = np.median(sizes[known & split], axis=0)
    whole = np.quantile(sizes[known & ~split], WHOLE_SHARE, axis=0)
    return bool((together < np.minimum(whole + tolerance_m, ONE_M)).all())


def _ways(middles: FloatArray) -> FloatArray:
    """Return the way of an object around each of its places, shape (n, 2)."""
    place = np.arange(len(middles))
    way: FloatArray = middles[np.minimum(place + NEARBY, len(middles) - 1)] - middles[np.maximum(place - NEARBY, 0)]
    return way


def _direction(ways: FloatArray) -> FloatArray:
    yaw_rad: FloatArray = np.arctan2(ways[:, 1], ways[:, 0])
    return yaw_rad


def _size(parts: Sequence[Kept], yaw_rad: float) -> FloatArray:
    """Return the length and width, shape (2,), of parts of a body in one frame, without their widening by noise."""
    outlines = [rotate_xy(-yaw_rad, part.middle + part.outline * UNIT_M) for part in parts]
    ends = np.array([np.quantile(outline, (END_SHARE, 1.0 - END_SHARE), axis=0) for outline in outlines])
    sight = np.abs(rotate_xy(-yaw_rad, parts[0].middle)) / max(float(np.linalg.norm(parts[0].middle)), 1e-9)
    blur_m = 2 * max(part.sigma_m for part in parts) * sight
    size: FloatArray = ends[:, 1].max(axis=0) - ends[:, 0].min(axis=0) - blur_m
    return size


def merged(track: Sequence[Kept], other: Sequence[Kept]) -> list[Kept]:
    """Merge two parts of one body, frame by frame."""
    whole = {kept.frame: kept for kept in other}
    for kept in track:
        part = whole.get(kept.frame)
        whole[kept.frame] = kept if part is None else _together(kept, part)
    return [whole[frame] for frame in sorted(whole)]


def _together(kept: Kept, other: Kept) -> Kept:
    if not (len(kept.outline) and len(other.outline)):
        return kept if len(kept.outline) or not len(other.outline) else other
    both = np.concatenate([kept.middle + kept.outline * UNIT_M, other.middle + other.outline * UNIT_M])
    middle = np.median(both, axis=0)
    outline = in_units(both - middle)
    return replace(kept, middle=middle, outline=outline, top_m=max(kept.top_m, other.top_m))
