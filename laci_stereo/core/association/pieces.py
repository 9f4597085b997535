"""Vehicles that are seen in pieces: where little of a body sends light back, its cluster splits."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import KDTree

from laci_stereo.core.association.likelihood import SIZE_SIGMA_M
from laci_stereo.core.estimation.evidence import Evidence
from laci_stereo.core.frames import BoolArray, FloatArray, rotate_xy
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.messages.repair import MIRRORS_M, MIRRORS_SIGMA_M, WIDEST_M
from laci_stereo.core.settings import Settings
from laci_stereo.core.tracking.sighting import Sighting, together
from laci_stereo.core.tracking.tracks import Track

LEAST_FRAMES = 5
"""Least number of frames in which two pieces must be seen together; they must also be so in half of the frames in which
the piece seen less often is."""

LARGEST_GAP_M = 2.0
"""Largest gap between pieces, not exceeded in half of the frames: where one hides the other the gap looks wider.
Vehicles in a queue are as close, but nobody follows another as closely over more than a vehicle's length."""

MOSTLY = 0.9
"""Quantile of the frames that is representative: in the others much is hidden, or noise makes things look longer."""

MORE_OFTEN = 0.5
"""Both pieces together must be no larger than the vehicle in more than this fraction of the frames in which it is
straight."""

SIDE_SEEN_RAD = 0.35
"""Where rays meet a side at this angle or a steeper one, its far end is visible as well: at 20 deg the spacing of its
points along the side is three times that across the view."""

LEAST_UNSEEN_M = 1.0
"""Length of a vehicle's end that may remain unseen without an objection: a bonnet that lies below a sparse scanner's
layers, or has only specular reflections where a camera needs texture, is up to a metre long."""

_DIRECTIONS = np.pi / 18 * np.arange(18)
_ACROSS = np.array([np.cos(_DIRECTIONS), np.sin(_DIRECTIONS)])


def whole(tracks: Sequence[Track], vehicles: Collection[VehicleTrack], settings: Settings) -> list[Track]:
    """Join tracks that are seen at the same time and can only be one vehicle.

    They are one if they stay close together while they move by more than their common length, and if that length is no
    more than the length of some sender's vehicle.

    Parameters
    ----------
    tracks : sequence of Track
        Tracks of boxes that a detector gave stay as they are.
    vehicles : collection of VehicleTrack
    settings : Settings

    Returns
    -------
    list of Track
        In descending order of the number of sightings.
    """
    joined = list(tracks)
    place = list(range(len(tracks)))
    for pair in _often_close(tracks, max(vehicle.length_m for vehicle in vehicles)):
        first, second = sorted(_root(place, index) for index in pair)
        if first == second:
            continue
        pairs = _at_once(joined[first], joined[second])
        if _move_as_one(pairs, joined[first], joined[second]) and _fit_one(pairs, vehicles):
            joined[first] = _both(pairs, joined[first], joined[second], settings)
            place[second] = first
    left = [track for index, track in enumerate(joined) if place[index] == index]
    return sorted(left, key=lambda track: len(track.sightings), reverse=True)


@dataclass(frozen=True)
class Companion:
    """An object that moves as one with a vehicle, in line with it.

    Attributes
    ----------
    frames : int
        Number of frames in which both are seen; 0 if there is no such object.
    ahead_m : float
        Median distance of its middle ahead of the vehicle's; negative behind it.
    track : Track
        Track of the object; empty if there is none.
    """

    frames: int = 0
    ahead_m: float = 0.0
    track: Track = field(default_factory=lambda: Track(()))


def companion(track: Track, tracks: Sequence[Track], yaw_at: Callable[[FloatArray], FloatArray]) -> Companion:
    """Return the object that moves as one with a vehicle, in line with it, in most frames.

    Objects that are too thin for a box, such as stereo matches that bleed from the vehicle, do not count.

    Parameters
    ----------
    track : Track
        Track of the vehicle.
    tracks : sequence of Track
    yaw_at : callable
        Returns the yaw of the vehicle's body at some of the track's stamps, level frame; NaN where it is not known.
    """
    vehicle, found = Track(track.usable), Companion()
    for one in (one for one in tracks if not track.shares(one)):
        other = Track(one.usable)
        pairs = _at_once(vehicle, other)
        if _move_as_one(pairs, vehicle, other):
            in_line = _extents_m(pairs).min(axis=1) < WIDEST_M + _over_m(pairs)
            if in_line.mean() > 0.5 and len(pairs) > found.frames:
                yaw = yaw_at(np.array([a.stamp_s for a, _ in pairs]))
                ahead_m = rotate_xy(-yaw, np.array([b.middle - a.middle for a, b in pairs]))[np.isfinite(yaw), 0]
                found = Companion(len(pairs), float(np.median(ahead_m)) if len(ahead_m) else 0.0, one)
    return found


def unseen_m(drive: Evidence, match: PlanarMatch, time_offset_s: float) -> tuple[float, float]:
    """Return how much of a vehicle's rear and of its front was never seen, although its side was.

    Parameters
    ----------
    drive : Evidence
    match : PlanarMatch
        From the level into the world frame.
    time_offset_s : float
        Clock offset of the drive.

    Returns
    -------
    rear_m, front_m : float
        Length that is missing in all but a tenth of the frames; 0 if the side is seen in fewer than `LEAST_FRAMES`.
    """
    ends = _ends_m(drive, match, time_offset_s)
    if len(ends) < LEAST_FRAMES:
        return 0.0, 0.0
    rear_m, front_m = np.quantile(ends * (1.0, -1.0) + drive.vehicle.length_m / 2, 1.0 - MOSTLY, axis=0)
    return max(float(rear_m), 0.0), max(float(front_m), 0.0)


def seen_share(drive: Evidence, match: PlanarMatch, time_offset_s: float) -> float:
    """Return the median fraction of a vehicle's length that is seen at a time while its side is; 1 if it never is.

    Parameters are those of `unseen_m`.
    """
    ends = _ends_m(drive, match, time_offset_s)
    return float(np.median(np.ptp(ends, axis=1))) / drive.vehicle.length_m if len(ends) >= LEAST_FRAMES else 1.0


def _ends_m(drive: Evidence, match: PlanarMatch, time_offset_s: float) -> FloatArray:
    """Return the first and last position along the vehicle in each frame that shows its side, shape (n, 2), metres."""
    vehicle = drive.vehicle
    half = np.array([vehicle.length_m, vehicle.width_m]) / 2
    xy, yaw, known = vehicle.at(drive.stamps_s + time_offset_s)
    sensor = np.abs(rotate_xy(-yaw, match(np.zeros((1, 2))) - xy))
    side = known & (np.arctan2(sensor[:, 1] - half[1], sensor[:, 0] + half[0]) > SIDE_SEEN_RAD)
    along = rotate_xy(-yaw[drive.frame], match(drive.points[:, :2]) - xy[drive.frame])[:, 0]
    each = np.split(along, np.searchsorted(drive.frame, np.arange(1, len(drive))))
    ends = [np.quantile(one, (0.02, 0.98)) for one, seen in zip(each, side, strict=True) if seen and len(one)]
    return np.array(ends).reshape(-1, 2)


def _often_close(tracks: Sequence[Track], length_m: float) -> list[tuple[int, int]]:
    """Return the pairs of tracks whose middles are at most ``length_m`` apart in enough frames, most frequent first."""
    frames: dict[float, list[tuple[int, FloatArray]]] = {}
    for index, track in enumerate(tracks):
        for one in track.sightings:
            if len(one.points):
                frames.setdefault(one.frame_s, []).append((index, one.middle))
    often: Counter[tuple[int, int]] = Counter()
    for seen in frames.values():
        middles = np.array([middle for _, middle in seen])
        often.update((seen[i][0], seen[j][0]) for i, j in KDTree(middles).query_pairs(length_m))
    return [pair for pair, count in often.most_common() if count >= LEAST_FRAMES]


def _root(place: Sequence[int], index: int) -> int:
    while place[index] != index:
        index = place[index]
    return index


Pairs = Sequence[tuple[Sighting, Sighting]]
"""Sightings of two tracks in the same frames."""


def _at_once(first: Track, second: Track) -> Pairs:
    by_frame = {one.frame_s: one for one in second.sightings if len(one.points)}
    return [(one, by_frame[one.frame_s]) for one in first.sightings if one.frame_s in by_frame and len(one.points)]


def _move_as_one(pairs: Pairs, first: Track, second: Track) -> bool:
    """Return whether two tracks stay close together while they move by more than their common length."""
    if len(pairs) < max(LEAST_FRAMES, min(len(first.sightings), len(second.sightings)) / 2):
        return False
    if min(_moved_m(each) for each in zip(*pairs, strict=True)) < np.quantile(_extents_m(pairs).max(axis=1), MOSTLY):
        return False
    gap_m = [np.min(KDTree(a.points[:, :2]).query(b.points[:, :2])[0]) for a, b in pairs]
    return bool(np.median(gap_m) <= LARGEST_GAP_M)


def _moved_m(piece: Sequence[Sighting]) -> float:
    """Return the largest distance that any edge of a piece moves, in any direction.

    The middle of an object that comes into view bit by bit lags behind; the edges of a stationary object move by no
    more than its length.
    """
    along = [one.points[:, :2] @ _ACROSS for one in piece]
    return float(np.ptp([(at.min(axis=0), at.max(axis=0)) for at in along], axis=0).max())


def _fit_one(pairs: Pairs, vehicles: Iterable[VehicleTrack]) -> bool:
    """Return whether both together are no larger than one of some vehicles, with an allowance for its mirrors.

    An articulated vehicle is wider in bends; it is judged only where it is straight.
    """
    extents_m = _extents_m(pairs)
    across_m, along_m = extents_m.min(axis=1), extents_m.max(axis=1)
    over_m, widest_m = _over_m(pairs), MIRRORS_M + 2 * MIRRORS_SIGMA_M
    stamps_s = np.array([one.stamp_s for one, _ in pairs])
    for vehicle in vehicles:
        fits = along_m < np.hypot(vehicle.length_m, vehicle.width_m) + over_m
        fits &= across_m < vehicle.width_m + widest_m + over_m
        straight = _straight(vehicle, stamps_s)
        if straight.sum() >= LEAST_FRAMES and fits[straight].mean() > MORE_OFTEN:
            return True
    return False


def _straight(vehicle: VehicleTrack, stamps_s: FloatArray) -> BoolArray:
    """Return at which times a vehicle is straight, not articulated, according to its nearest message."""
    nearest = np.searchsorted((vehicle.stamps_s[1:] + vehicle.stamps_s[:-1]) / 2, stamps_s)
    straight: BoolArray = ~vehicle.folded[nearest]
    return straight


def _over_m(pairs: Pairs) -> FloatArray:
    """Return how much larger both together may look than they are, shape (n,): by the clusters' reach, and by noise."""
    return SIZE_SIGMA_M + 5 * np.array([max(a.sigma_m, b.sigma_m) for a, b in pairs])


def _extents_m(pairs: Pairs) -> FloatArray:
    """Return the extent of both together in each of 18 directions, shape (n, 18), metres."""
    return np.array([np.ptp(np.vstack([a.points, b.points])[:, :2] @ _ACROSS, axis=0) for a, b in pairs])


def _both(pairs: Pairs, first: Track, second: Track, settings: Settings) -> Track:
    merged = {id(a): together(a, b, settings) for a, b in pairs}
    return Track(tuple(merged.get(id(one), one) for one in first.sightings)).joined(second)
