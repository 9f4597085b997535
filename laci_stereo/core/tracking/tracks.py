"""Linking the clusters of successive frames into tracks.

The strain of a gap is the larger of the normalised deviations of position and velocity across it, in units of `GATE`.
Links are chosen together, at the least total cost.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from laci_stereo.core.cloud import Cameras
from laci_stereo.core.frames import BoolArray, FloatArray
from laci_stereo.core.settings import TrackSettings
from laci_stereo.core.tracking.sighting import Sighting
from laci_stereo.core.tracking.static_clutter import stands

UNLINKED = 1.5
"""Cost of leaving a track without a sighting, in gates: above one, so that a sighting at the expected place is
linked."""

GATE = 3.0
"""Standard deviations at which a gate closes."""

FILTERED, FILTERED_S = 10, 0.9
"""Least number of sightings at the beginning of a track from which its velocity there is estimated, and the time that
these must cover if frames are more frequent than 10 Hz: in less, a vehicle moves no farther than its middle jumps."""

STRAY = 0.5
"""Cost of treating a sighting at an end of a track as an outlier that belongs to another object, in gates."""

LEAST_PIECE = 3
"""Least number of sightings that determine a velocity."""

UNLIKELY, MOST_KEPT = 1.0, 2.0
"""`UNLIKELY` is the margin per link, beyond `UNLINKED`, by which exchanging two tracks must lower the squared strains:
half of nine times that is log odds of a hundred to one. `MOST_KEPT` is the largest squared strain, twice a gate's, that
counts where a cut track continues as before."""

Times = tuple[tuple[float, float], ...]
"""Intervals, each from a first to a last time."""


@dataclass(frozen=True)
class Track:
    """One object through time.

    Attributes
    ----------
    sightings : tuple of Sighting
        At most one per frame, in the order of time.
    """

    sightings: tuple[Sighting, ...]

    @cached_property
    def usable(self) -> tuple[Sighting, ...]:
        """The sightings whose box can be trusted."""
        return tuple(sighting for sighting in self.sightings if sighting.flaw is None)

    @cached_property
    def stamps_s(self) -> FloatArray:
        """Stamps of the usable sightings, shape (n,)."""
        return np.array([sighting.stamp_s for sighting in self.usable])

    @cached_property
    def centres(self) -> FloatArray:
        """Centres of the usable sightings' boxes, level frame, shape (n, 2)."""
        return np.array([sighting.box.centre for sighting in self.usable]).reshape(-1, 2)

    @cached_property
    def turn_s(self) -> float:
        """Duration of the scanner's revolution if it rotates and the points' times are not known, else 0."""
        return max((sighting.turn_s for sighting in self.sightings), default=0.0)

    @cached_property
    def window_rad(self) -> float:
        """Side of the window within which points share their noise, 0 if the noise of each is independent."""
        return max((sighting.window_rad for sighting in self.sightings), default=0.0)

    @property
    def cameras(self) -> Cameras | None:
        """The cameras by which it was seen, level frame; None for other sensors."""
        return next((sighting.cameras for sighting in self.sightings if sighting.cameras), None)

    def flaws(self) -> Counter[str]:
        """Count the sightings that are left out, by reason."""
        return Counter(sighting.flaw for sighting in self.sightings if sighting.flaw is not None)

    def shares(self, other: Track) -> bool:
        """Return whether a sighting is part of both tracks."""
        mine = {id(sighting) for sighting in self.sightings}
        return any(id(sighting) in mine for sighting in other.sightings)

    def without(self, times_s: Times) -> Track:
        """Return the track without the sightings in some half-open intervals: from a first to before a last time."""
        stamps_s = np.array([sighting.stamp_s for sighting in self.sightings])
        kept = np.ones(len(stamps_s), dtype=bool)
        for begin_s, end_s in times_s:
            kept &= (stamps_s < begin_s) | (stamps_s >= end_s)
        return self.where(kept)

    def where(self, kept: BoolArray) -> Track:
        """Return the track with those sightings only that are kept, shape (n,)."""
        if kept.all():
            return self
        return Track(tuple(sighting for sighting, is_kept in zip(self.sightings, kept, strict=True) if is_kept))

    def without_points(self) -> Track:
        """Return the track with the boxes of its sightings, but without their points."""
        return Track(tuple(sighting.without_points() for sighting in self.sightings))

    def joined(self, other: Track) -> Track:
        """Return two tracks as one; in frames that hold both, the first one's sighting is kept."""
        mine = {sighting.frame_s for sighting in self.sightings}
        new = tuple(sighting for sighting in other.sightings if sighting.frame_s not in mine)
        if not new:
            return self
        return Track(tuple(sorted(self.sightings + new, key=lambda sighting: sighting.stamp_s)))


def link_tracks(frames: Iterable[Sequence[Sighting]], settings: TrackSettings | None = None) -> list[Track]:
    """Link sightings into tracks: each to the nearest predicted position, over all pairs at once.

    Each track has a position and a velocity (a Kalman filter with white acceleration noise). While it is out of sight,
    its predicted position soon becomes too uncertain to identify what appears there; longer gaps are closed in a second
    step, where the velocities before and after agree with the displacement in between. Clusters that are at one place
    from the beginning to the end, such as vegetation on uneven ground, are left out: vehicles that pass them would be
    linked with them.

    Parameters
    ----------
    frames : iterable of sequence of Sighting
        In chronological order; consumed once.
    settings : TrackSettings

    Returns
    -------
    list of Track
        In descending order of the number of sightings.
    """
    settings = settings or TrackSettings()
    finished: list[Moving] = []
    active: list[Moving] = []
    seen = [frame for frame in _that_move([frame for frame in frames if frame], settings) if frame]
    stamps_s = np.array([sightings[0].frame_s for sightings in seen])
    settings = replace(settings, max_lost_s=max(settings.max_lost_s, bridged_s(stamps_s)))
    limit_s = min(max(blind_s(settings), bridged_s(stamps_s)), settings.max_lost_s)
    for now_s, sightings in zip(stamps_s, seen, strict=True):
        finished += [track for track in active if now_s - track.last.frame_s > limit_s]
        active = [track for track in active if now_s - track.last.frame_s <= limit_s]
        taken = assign(active, sightings, settings)
        for index, sighting in enumerate(sightings):
            if index in taken:
                active[taken[index]].add(sighting, settings)
            else:
                active.append(Moving(sighting, settings))
    tracks = _stitched(finished + active, settings)
    return sorted(tracks, key=lambda track: len(track.sightings), reverse=True)


def _that_move(frames: Sequence[Sequence[Sighting]], settings: TrackSettings) -> list[list[Sighting]]:
    """Leave out clusters that are at one place throughout, but keep a detector's reports: these are objects even so."""
    clusters = [(number, one) for number, frame in enumerate(frames) for one in frame if len(one.points)]
    if not clusters:
        return [list(frame) for frame in frames]
    number = np.array([number for number, _ in clusters])
    fixed = stands(number, np.array([one.middle for _, one in clusters]), len(frames), settings.fixture_share)
    fixtures = {id(one) for (_, one), is_fixed in zip(clusters, fixed, strict=True) if is_fixed}
    return [[one for one in frame if id(one) not in fixtures] for frame in frames]


def bridged_s(stamps_s: FloatArray) -> float:
    """Return how long one missing frame leaves objects unseen, at any frame rate; 0 for a single frame."""
    return 2.5 * float(np.median(np.diff(stamps_s))) if len(stamps_s) > 1 else 0.0


def blind_s(settings: TrackSettings) -> float:
    """Return the time out of sight after which a position is as uncertain as a vehicle's visible part jumps."""
    return float((3 * settings.jitter_m**2 / _agility(settings)) ** (1 / 3))


def _agility(settings: TrackSettings) -> float:
    """Return the spectral density of accelerations, m^2/s^3: the largest is three sigma and lasts a second."""
    return (settings.max_acceleration_mps2 / GATE) ** 2


def _noise(settings: TrackSettings) -> float:
    """Return the variance of a position, m^2: its largest jump is twice its standard deviation."""
    return (settings.jitter_m / 2) ** 2


Links = dict[tuple[int, int], tuple[float, int, int]]
"""Possible links from one part to the next: the cost, and the number of sightings that are outliers if so, at the end
of the one and at the beginning of the other."""


class Moving:
    """A growing track: its sightings, and its current position and velocity with the covariance of each axis."""

    def __init__(self, first: Sighting, settings: TrackSettings) -> None:
        self.sightings = [first]
        self.state = np.array([first.middle, np.zeros(2)])
        self.covariance = np.diag([_noise(settings), (settings.max_speed_mps / GATE) ** 2])

    @property
    def last(self) -> Sighting:
        """The newest sighting."""
        return self.sightings[-1]

    def ahead(self, stamp_s: float, settings: TrackSettings) -> tuple[FloatArray, FloatArray]:
        """Predict the state, shape (2, 2): position and velocity, and its covariance, which is that of each axis."""
        dt = max(stamp_s - self.last.stamp_s, 0.0)
        step = np.array([[1.0, dt], [0.0, 1.0]])
        grown = _agility(settings) * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        return step @ self.state, step @ self.covariance @ step.T + grown

    def add(self, sighting: Sighting, settings: TrackSettings) -> None:
        """Update the state by a sighting."""
        state, covariance = self.ahead(sighting.stamp_s, settings)
        gain = covariance[:, 0] / (covariance[0, 0] + _noise(settings))
        self.state = state + np.outer(gain, sighting.middle - state[0])
        self.covariance = covariance - np.outer(gain, covariance[0])
        self.sightings.append(sighting)


def assign(tracks: Sequence[Moving], sightings: Sequence[Sighting], settings: TrackSettings) -> dict[int, int]:
    """Return the index of the track for each sighting that is linked to one."""
    if not tracks:
        return {}
    # Within a frame the stamps differ by milliseconds; the vehicles' positions are predicted for each.
    now_s = float(np.mean([sighting.stamp_s for sighting in sightings]))
    ahead = [track.ahead(now_s, settings) for track in tracks]
    places = np.array([state[0] for state, _ in ahead])
    speeds = np.array([state[1] for state, _ in ahead])
    sigma = np.sqrt(np.array([covariance[0, 0] for _, covariance in ahead]) + _noise(settings))
    late_s = np.array([sighting.stamp_s for sighting in sightings]) - now_s
    middles = np.array([sighting.middle for sighting in sightings])
    expected = places[:, None] + late_s[None, :, None] * speeds[:, None]
    distance = np.linalg.norm(expected - middles, axis=2) / sigma[:, None] / GATE
    sizes = np.log10([max(sighting.count, 1) for sighting in sightings])
    size_before = np.log10([float(np.median([max(s.count, 1) for s in track.sightings[-5:]])) for track in tracks])
    # Debris that breaks off a vehicle is near it but small: a factor of ten in size costs as much as the whole gate.
    cost = np.hypot(distance, size_before[:, None] - sizes[None])
    cost[distance >= 1.0] = UNLINKED
    return _pairs(cost)


def _pairs(cost: FloatArray) -> dict[int, int]:
    """Return the row of each column that has one, at the least total cost."""
    rows, columns = linear_sum_assignment(np.minimum(cost, UNLINKED))
    return {int(c): int(r) for r, c in zip(rows, columns, strict=True) if cost[r, c] < UNLINKED}


def _stitched(tracks: Sequence[Moving], settings: TrackSettings) -> list[Track]:
    """Close the gaps between tracks that end and tracks that begin, over all pairs at once.

    A track that ends with an outlier has lost its object by it; without the outlier the gap may close. Where a track
    changes its motion so much that a gap there would not be closed, two tracks may have met and been exchanged: it is
    cut there, and continues as before unless the exchanged parts fit better by the required odds.
    """
    parts: list[Moving] = []
    kept: Links = {}
    for track in tracks:
        for strained, piece in _cut(track, settings):
            if strained:
                kept[len(parts) - 1, len(parts)] = min(strained**2 - UNLIKELY, MOST_KEPT) - UNLINKED, 0, 0
            parts.append(piece)
    found = _links(parts, kept, settings)
    after_of = _following(found)
    stitched = []
    for index in sorted(set(range(len(parts))) - set(after_of.values())):
        sightings = list(parts[index].sightings)
        while index in after_of:
            _, stray_last, stray_first = found[index, after_of[index]]
            index = after_of[index]
            sightings = sightings[: len(sightings) - stray_last] + parts[index].sightings[stray_first:]
        stitched.append(Track(tuple(sightings)))
    return stitched


def _following(found: Links) -> dict[int, int]:
    """Return the successor of each part that has one, at the least total cost.

    Groups of parts that no chain of possible links connects are solved separately: of many parts, each has few possible
    successors.
    """
    pairs = [pair for pair, (cost, *_) in found.items() if cost < UNLINKED]
    if not pairs:
        return {}
    before, after = np.array(pairs).T
    count = int(max(before.max(), after.max())) + 1
    graph = coo_array((np.ones(len(pairs)), (before, count + after)), shape=(2 * count, 2 * count))
    group = connected_components(graph, directed=False)[1]
    groups: dict[int, list[tuple[int, int]]] = {}
    for pair in pairs:
        groups.setdefault(int(group[pair[0]]), []).append(pair)
    follows = {}
    for linked in groups.values():
        rows, columns = (sorted({pair[axis] for pair in linked}) for axis in (0, 1))
        costs = np.full((len(rows), len(columns)), UNLINKED)
        for i, j in linked:
            costs[rows.index(i), columns.index(j)] = found[i, j][0]
        follows.update({rows[row]: columns[column] for column, row in _pairs(costs).items()})
    return follows


def _links(parts: Sequence[Moving], kept: Links, settings: TrackSettings) -> Links:
    """Return which parts may follow which, beside the `kept` links, with the squared strain as the cost."""
    found = dict(kept)
    ends_by = [[_without_last(part, strays, settings) for part in parts] for strays in (0, 1)]
    begins_by = [
        [backwards(part.sightings[strays:] or part.sightings, settings) for part in parts] for strays in (0, 1)
    ]
    for stray_last, stray_first in ((0, 0), (1, 0), (0, 1)):
        ends, begins = ends_by[stray_last], begins_by[stray_first]
        begins_s, ends_s = (np.array([one.last.stamp_s for one in each]) for each in (begins, ends))
        order = np.argsort(begins_s)
        firsts, lasts = (
            np.searchsorted(begins_s[order], ends_s + later_s, side="right") for later_s in (0.0, settings.max_lost_s)
        )
        for i, (first, last) in enumerate(zip(firsts.tolist(), lasts.tolist(), strict=True)):
            for j in np.sort(order[first:last]).tolist():
                gap_s = float(begins_s[j] - ends_s[i])
                strained = strain(ends[i], begins[j], gap_s, settings) + STRAY * (stray_last + stray_first)
                if i != j and strained**2 < found.get((i, j), (1.0,))[0]:
                    found[i, j] = strained**2, stray_last, stray_first
    return found


def _cut(track: Moving, settings: TrackSettings) -> list[tuple[float, Moving]]:
    """Cut a track, and its pieces again, where it changes its motion most, if a gap with that change would stay open.

    Where frames are so frequent that the first or the last sightings determine no velocity, no change is known there.

    Returns
    -------
    list of tuple
        The strain between each piece and the one before, 0 for the first, and the piece.
    """
    whole: list[tuple[float, Moving]] = []
    left = [(0.0, track)]
    while left:
        strained, piece = left.pop()
        strains = _strains(piece.sightings, settings)
        most = max(strains, default=0.0)
        if most < 1.0:
            whole.append((strained, piece))
            continue
        first = LEAST_PIECE + int(np.argmax(strains))
        before, after = (_filtered(part, settings) for part in (piece.sightings[:first], piece.sightings[first:]))
        left += [(most, after), (strained, before)]
    return whole


def _strains(sightings: Sequence[Sighting], settings: TrackSettings) -> list[float]:
    """Return the strain between successive sightings of a track, from that where a first piece could end."""
    before = _states(sightings, settings)
    after = [_forwards_in_time(one) for one in _states(_mirrored(sightings), settings)[::-1]]
    gaps_s = np.diff([one.stamp_s for one in sightings]).tolist()
    return [
        0.0 if _vague(before[i], after[i + 1], settings) else strain(before[i], after[i + 1], gaps_s[i], settings)
        for i in range(LEAST_PIECE - 1, len(sightings) - LEAST_PIECE)
    ]


def _states(sightings: Sequence[Sighting], settings: TrackSettings) -> list[Moving]:
    """Return the state of the track as of each of its sightings, which is all that it holds of them."""
    moving = Moving(sightings[0], settings)
    states = [_copied(moving)]
    for one in sightings[1:]:
        moving.add(one, settings)
        states.append(_copied(moving))
    return states


def _copied(moving: Moving) -> Moving:
    state = copy(moving)
    state.sightings = moving.sightings[-1:]
    return state


def _without_last(part: Moving, strays: int, settings: TrackSettings) -> Moving:
    left = part.sightings[: len(part.sightings) - strays]
    return _filtered(left, settings) if strays and left else part


def _filtered(sightings: Sequence[Sighting], settings: TrackSettings) -> Moving:
    moving = Moving(sightings[0], settings)
    for one in sightings[1:]:
        moving.add(one, settings)
    return moving


def backwards(sightings: Sequence[Sighting], settings: TrackSettings) -> Moving:
    """Filter the beginning of a track backwards in time, so that its `last` sighting is the earliest."""
    few = [
        one
        for number, one in enumerate(sightings)
        if number < FILTERED or one.stamp_s < sightings[0].stamp_s + FILTERED_S
    ]
    moving = _forwards_in_time(_filtered(_mirrored(few), settings))
    moving.sightings = few[::-1]
    return moving


def has_begun(sightings: Sequence[Sighting]) -> bool:
    """Return whether a growing track holds all sightings from which the velocity at its beginning is estimated."""
    return len(sightings) >= FILTERED and sightings[-1].stamp_s >= sightings[0].stamp_s + FILTERED_S


def _mirrored(sightings: Sequence[Sighting]) -> list[Sighting]:
    return [replace(one, stamp_s=-one.stamp_s) for one in sightings[::-1]]


def _forwards_in_time(moving: Moving) -> Moving:
    """Return a track filtered backwards with its velocity in forward time."""
    forwards = copy(moving)
    forwards.state = moving.state * np.array([[1.0], [-1.0]])
    return forwards


def strain(before: Moving, after: Moving, gap_s: float, settings: TrackSettings) -> float:
    """Return the cost of a gap, in gates: of its displacement against the mean velocity, and of the velocity change."""
    agility = _agility(settings)
    way = after.state[0] - before.state[0] - gap_s * (before.state[1] + after.state[1]) / 2
    positions = before.covariance[0, 0] + after.covariance[0, 0]
    speeds = before.covariance[1, 1] + after.covariance[1, 1]
    # The variance that a random walk of the velocity adds between two known ends, and between two unknown ones.
    way_sigma = np.sqrt(positions + speeds * gap_s**2 / 4 + agility * gap_s**3 / 12 + _noise(settings))
    change = np.linalg.norm(after.state[1] - before.state[1]) / np.sqrt(speeds + agility * gap_s)
    found = max(float(np.linalg.norm(way) / way_sigma), float(change)) / GATE
    # No vehicle stops and drives back within so short a time. For stationary objects this leaves one gap in five open:
    # the product of two velocities that are only noise has a Laplace distribution.
    back = before.state[1] @ after.state[1] < -np.sqrt(before.covariance[1, 1] * after.covariance[1, 1])
    return np.inf if back or _vague(before, after, settings) else found


def _vague(before: Moving, after: Moving, settings: TrackSettings) -> bool:
    """Return whether the velocities at both ends of a gap are unknown: one or two sightings could be of any object."""
    speeds = before.covariance[1, 1] + after.covariance[1, 1]
    return bool(np.sqrt(speeds) > settings.max_speed_mps / (2 * GATE))
