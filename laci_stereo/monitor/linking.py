"""Linking of sightings into tracks frame by frame, with the core's filter and assignment, in constant memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from laci_stereo.core.settings import Settings, TrackSettings
from laci_stereo.core.tracking.sighting import NOTHING_LOW, Sighting, dense
from laci_stereo.core.tracking.tracks import STRAY, Moving, assign, backwards, blind_s, bridged_s, has_begun, strain
from laci_stereo.monitor.body import merged, one_body
from laci_stereo.monitor.kept import Kept, in_units

REMEMBERED = 5
"""Number of sightings at the end of a track whose sizes the assignment considers."""

RECENT = 11
"""Number of the last frames whose median interval is that of the recording."""

STANDS_M = 0.1
"""An object that has moved by less than this, or by less than its noise, since its outline was last kept is stationary;
that outline is used further."""

TOP_SHARE = 0.95
"""An object's height is this quantile of its points' heights: the highest of some hundred points is noise."""


@dataclass
class Live:
    """A growing track.

    Attributes
    ----------
    moving : Moving
        The filter, with the last `REMEMBERED` sightings.
    head : list of Sighting
        The first sightings, without points, until the velocity at the beginning can be estimated (`has_begun`):
        ten at 10 Hz, 28 at 30 Hz.
    kept : list of Kept
        The kept part of every sighting.
    """

    moving: Moving
    head: list[Sighting]
    kept: list[Kept]

    @property
    def first_s(self) -> float:
        """Time of the first sighting, seconds since the recording's first stamp."""
        return self.head[0].stamp_s

    @property
    def last_s(self) -> float:
        """Time of the last sighting, seconds since the recording's first stamp."""
        return self.moving.last.stamp_s


@dataclass
class Linker:
    """Tracks in progress.

    Attributes
    ----------
    active : list of Live
        Tracks in sight, or out of sight for a moment.
    lost : list of Live
        Tracks out of sight for longer; a track that begins now may turn out to continue one of them.
    recent_s : list of float
        Times of the last `RECENT` frames; their median interval is not misled by a pause.
    """

    active: list[Live] = field(default_factory=list)
    lost: list[Live] = field(default_factory=list)
    recent_s: list[float] = field(default_factory=list)

    def add(
        self, frame: int, now_s: float, sightings: Sequence[Sighting], settings: Settings, longest_s: float
    ) -> list[Live]:
        """Add a frame's sightings, and return the tracks that have ended.

        Parameters
        ----------
        frame : int
            Frame number.
        now_s : float
            Time of the frame, seconds since the recording's first stamp.
        sightings : sequence of Sighting
        settings : Settings
        longest_s : float
            A track that lasts longer is cut.
        """
        self.recent_s = [*self.recent_s, now_s][-RECENT:]
        missing_s = bridged_s(np.array(self.recent_s))
        limits = replace(settings.track, max_lost_s=max(settings.track.max_lost_s, missing_s))
        self._retire(now_s, min(max(blind_s(limits), missing_s), limits.max_lost_s), limits)
        if sightings:
            self._link(frame, sightings, replace(settings, track=limits))
        too_long = [live for live in self.active if live.last_s - live.first_s > longest_s]
        self.active = [live for live in self.active if live.last_s - live.first_s <= longest_s]
        return self._alone(self._over(now_s, limits) + too_long)

    def rest(self, settings: TrackSettings) -> list[Live]:
        """Return all tracks, as if the recording ended here."""
        self._retire(np.inf, 0.0, settings)
        over, self.lost = sorted(self.lost, key=lambda live: live.last_s), []
        return self._alone(over)

    def _retire(self, now_s: float, patience_s: float, settings: TrackSettings) -> None:
        """Move tracks not seen for longer than ``patience_s`` to `lost`.

        After this time, a prediction no longer determines which of the sightings continues a track.
        """
        out = [live for live in self.active if now_s - live.last_s > patience_s]
        self.active = [live for live in self.active if now_s - live.last_s <= patience_s]
        for live in out:
            if not has_begun(live.head):
                self._join(live, settings)
        self.lost += out

    def _link(self, frame: int, sightings: Sequence[Sighting], settings: Settings) -> None:
        taken = assign([live.moving for live in self.active], sightings, settings.track)
        for index, sighting in enumerate(sightings):
            bare = _bare(sighting)
            if index not in taken:
                moving = Moving(bare, settings.track)
                self.active.append(Live(moving, [bare], [_kept(frame, sighting, None, settings)]))
                continue
            live = self.active[taken[index]]
            live.moving.add(bare, settings.track)
            live.moving.sightings = live.moving.sightings[-REMEMBERED:]
            live.kept.append(_kept(frame, sighting, live, settings))
            if not has_begun(live.head):
                live.head.append(bare)
                if has_begun(live.head):
                    self._join(live, settings.track)

    def _join(self, live: Live, settings: TrackSettings) -> None:
        """Append a track to an earlier, lost one, where the displacement in the gap agrees with both velocities.

        Where the points of a body were split for a frame, its next track begins with a fragment while the previous
        track goes on. The sighting simultaneous with the previous track's last ones is not its continuation, but what
        follows may be, so the first sighting may be dropped as an outlier.
        """
        strains = {}
        for stray in range(min(2, len(live.head))):
            begin = backwards(live.head[stray:], settings)
            for number, lost in enumerate(self.lost):
                gap_s = live.head[stray].stamp_s - lost.last_s
                if 0.0 < gap_s <= settings.max_lost_s:
                    surely = stray == 0 or live.first_s <= lost.last_s
                    strains[number, stray] = strain(lost.moving, begin, gap_s, settings) + (0.0 if surely else STRAY)
        if strains and min(strains.values()) < 1.0:
            number, stray = min(strains, key=lambda pair: strains[pair])
            before = self.lost.pop(number)
            live.head, live.kept = _beginning(before.head + live.head[stray:]), before.kept + live.kept[stray:]

    def _over(self, now_s: float, settings: TrackSettings) -> list[Live]:
        """Remove and return the lost tracks that no track can continue any more."""
        undecided_s = [live.first_s for live in self.active if not has_begun(live.head)]
        since_s = min([now_s, *undecided_s]) - settings.max_lost_s
        over = [live for live in self.lost if live.last_s < since_s]
        self.lost = [live for live in self.lost if live.last_s >= since_s]
        return sorted(over, key=lambda live: live.last_s)

    def _alone(self, over: list[Live]) -> list[Live]:
        """Return the tracks that are separate objects, and merge each part of a body into the track of another part.

        The beams of a sparse scanner may leave a gap between a car's side and its roof.
        """
        alone = []
        for number, live in enumerate(over):
            others = [*self.active, *self.lost, *over[number + 1 :]]
            body = next((other for other in others if one_body(live.kept, other.kept)), None)
            if body is None:
                alone.append(live)
            else:
                body.head = min(body.head, live.head, key=lambda head: head[0].stamp_s)
                body.kept = merged(body.kept, live.kept)
        return alone


def _beginning(sightings: list[Sighting]) -> list[Sighting]:
    """Return the first sightings, only as many as the velocity at the beginning is estimated from."""
    counts = range(1, len(sightings))
    return next((sightings[:count] for count in counts if has_begun(sightings[:count])), sightings)


def _bare(sighting: Sighting) -> Sighting:
    """Return a copy of a sighting without its points."""
    nothing = np.zeros(0)
    return replace(
        sighting,
        points=np.zeros((0, 3)),
        sigma_along_m=nothing,
        sigma_across_m=nothing,
        late_s=None,
        low=NOTHING_LOW,
    )


def _kept(frame: int, sighting: Sighting, live: Live | None, settings: Settings) -> Kept:
    whole = sighting.flaw is None
    if not whole or (live is not None and _stands(sighting, live)):
        nothing = np.zeros((0, 2), dtype=np.int16)
        return Kept(frame, sighting.stamp_s, sighting.middle, whole, nothing, 0.0, sighting.sigma_m)
    points = sighting.points.copy()
    if sighting.late_s is not None and live is not None:  # motion compensation to the sighting's stamp
        points[:, :2] -= sighting.late_s[:, None] * live.moving.state[1]
    points = points[dense(points[:, :2], settings.vehicle)]
    top_m = float(np.quantile(points[:, 2], TOP_SHARE))
    outline = in_units(points[:, :2] - sighting.middle)
    return Kept(frame, sighting.stamp_s, sighting.middle, whole, outline, top_m, sighting.sigma_m)


def _stands(sighting: Sighting, live: Live) -> bool:
    outlined = next((one for one in reversed(live.kept) if len(one.outline)), None)
    if outlined is None:
        return False
    return float(np.linalg.norm(sighting.middle - outlined.middle)) < max(STANDS_M, sighting.sigma_m)
