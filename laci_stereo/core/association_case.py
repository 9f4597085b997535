"""What moved and what was sent, as it is or as it might be, and which track is which sender's then."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from laci_stereo.core.association import choose_track
from laci_stereo.core.cam import VehicleTrack
from laci_stereo.core.choice import Choice, Likeness, no_likeness
from laci_stereo.core.errors import MatchError, TrackError
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.tracking import Track


@dataclass(frozen=True)
class Case:
    """What `choose_track` chooses by, whose parameters these are."""

    tracks: Sequence[Track]
    vehicles: Mapping[int, VehicleTrack]
    settings: MatchSettings
    likeness: Likeness = no_likeness

    @property
    def matched(self) -> bool:
        """Whether a matcher saw any of it, and so a stereo camera."""
        return any(track.window_rad for track in self.tracks)

    @property
    def by_boxes(self) -> Case:
        """The same, but by boxes whatever fits best is chosen."""
        return replace(self, settings=self.settings.any_fit, likeness=no_likeness)

    def choose(self) -> Choice:
        """Return what is likeliest; errors are those of `choose_track`."""
        return choose_track(self.tracks, self.vehicles, self.settings, self.likeness)

    def chosen(self) -> Choice | None:
        """Return what is likeliest; None where nothing is."""
        try:
            return self.choose()
        except (TrackError, MatchError):
            return None


@dataclass(frozen=True)
class Alternative:
    """What would fit if something were not as it was said.

    Attributes
    ----------
    choice : Choice
    words : str
    log_searched : float
        Of how many it is the best, as a logarithm: one of so many fits so well by chance.
    nearer_per_m : float
        By how much inverse distances would have to be larger, 1/m.
    """

    choice: Choice
    words: str
    log_searched: float = 0.0
    nearer_per_m: float = 0.0

    @property
    def log_odds(self) -> float:
        """Against everything being where it is by chance."""
        return self.choice.log_likelihood - self.log_searched


def log_odds_between(one: Choice | None, other: Choice | None) -> float:
    """Return the log odds of one choice against another; what does not fit at all is infinitely unlikely."""
    if one is None:
        return -math.inf
    return math.inf if other is None else one.log_likelihood - other.log_likelihood
