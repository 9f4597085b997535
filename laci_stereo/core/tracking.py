"""Linking the clusters of successive frames into tracks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import linear_sum_assignment

from laci_stereo.core.frames import FloatArray
from laci_stereo.core.settings import TrackSettings
from laci_stereo.core.sighting import Sighting

UNLINKED = 1.5
"""Cost of leaving a track without a sighting, in gates: above one, so that what is where it should be is linked."""


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
        """Of the usable sightings, shape (n,)."""
        return np.array([sighting.stamp_s for sighting in self.usable])

    @cached_property
    def centres(self) -> FloatArray:
        """Of the usable sightings' boxes, level frame, shape (n, 2)."""
        return np.array([sighting.box.centre for sighting in self.usable]).reshape(-1, 2)

    def flaws(self) -> Counter[str]:
        """Count the sightings that are left out, by reason."""
        return Counter(sighting.flaw for sighting in self.sightings if sighting.flaw is not None)

    def disjoint(self, other: Track) -> bool:
        """Tell whether no frame holds both."""
        mine = {sighting.frame_s for sighting in self.sightings}
        return not any(sighting.frame_s in mine for sighting in other.sightings)

    def shares(self, other: Track) -> bool:
        """Tell whether a sighting is part of both."""
        mine = {id(sighting) for sighting in self.sightings}
        return any(id(sighting) in mine for sighting in other.sightings)

    def joined(self, other: Track) -> Track:
        """Return two disjoint tracks as one."""
        return Track(tuple(sorted(self.sightings + other.sightings, key=lambda sighting: sighting.stamp_s)))


def link_tracks(frames: Iterable[Sequence[Sighting]], settings: TrackSettings | None = None) -> list[Track]:
    """Link sightings into tracks: nearest to where each track should be by now, over all pairs at once.

    Parameters
    ----------
    frames : iterable of sequence of Sighting
        In the order of time; consumed once, so it may be a stream.
    settings : TrackSettings

    Returns
    -------
    list of Track
        The one with most sightings first.
    """
    settings = settings or TrackSettings()
    finished: list[list[Sighting]] = []
    active: list[list[Sighting]] = []
    for sightings in frames:
        if not sightings:
            continue
        now = sightings[0].frame_s
        finished += [track for track in active if now - track[-1].frame_s > settings.max_lost_s]
        active = [track for track in active if now - track[-1].frame_s <= settings.max_lost_s]
        taken = _assign(active, sightings, settings)
        for index, sighting in enumerate(sightings):
            if index in taken:
                active[taken[index]].append(sighting)
            else:
                active.append([sighting])
    tracks = [Track(tuple(track)) for track in finished + active]
    return sorted(tracks, key=lambda track: len(track.sightings), reverse=True)


def _assign(
    tracks: Sequence[Sequence[Sighting]], sightings: Sequence[Sighting], settings: TrackSettings
) -> dict[int, int]:
    """Return the track of each sighting that has one."""
    if not tracks:
        return {}
    here = np.array([sighting.middle for sighting in sightings])
    stamps_s = np.array([sighting.stamp_s for sighting in sightings])
    expected = [_expect(track, stamps_s, settings) for track in tracks]
    distance = np.linalg.norm(np.array([xy for xy, _ in expected]) - here, axis=2)
    gate = np.array([reach for _, reach in expected])
    sizes = np.log10([sighting.count for sighting in sightings])
    size_before = np.log10([float(np.median([sighting.count for sighting in track[-5:]])) for track in tracks])
    # Debris that breaks off a vehicle is near to it but small: a factor of ten counts as much as the whole gate.
    cost = np.hypot(distance / gate, size_before[:, None] - sizes[None])
    cost[distance >= gate] = UNLINKED
    rows, columns = linear_sum_assignment(np.minimum(cost, UNLINKED))
    return {int(c): int(r) for r, c in zip(rows, columns, strict=True) if cost[r, c] < UNLINKED}


def _expect(track: Sequence[Sighting], stamps_s: FloatArray, settings: TrackSettings) -> tuple[FloatArray, FloatArray]:
    """Return where a track should be at some times, shape (n, 2), and by how much that may be wrong, shape (n,)."""
    last = track[-1]
    ahead_s = (stamps_s - last.stamp_s).clip(0.0)
    recent = [sighting for sighting in track[-6:] if last.stamp_s - sighting.stamp_s <= settings.max_lost_s]
    if len(recent) < 3:
        return np.tile(last.middle, (len(stamps_s), 1)), settings.jitter_m + settings.max_speed_mps * ahead_s
    span_s = last.stamp_s - recent[0].stamp_s
    velocity = (last.middle - recent[0].middle) / span_s
    # The mean velocity of the span is that of its middle.
    gained_mps = settings.max_acceleration_mps2 * (ahead_s + span_s) / 2
    slip = settings.jitter_m * (1 + ahead_s / span_s) + gained_mps * ahead_s
    return last.middle + velocity * ahead_s[:, None], slip
