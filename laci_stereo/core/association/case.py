"""The input of an association, as recorded or with an assumption changed, and the choice that follows from it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from laci_stereo.core.association.choice import Choice, Likeness, no_likeness
from laci_stereo.core.association.hypotheses import choose_track
from laci_stereo.core.errors import MatchError, TrackError
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.tracking.tracks import Track


@dataclass(frozen=True)
class Case:
    """The parameters of `choose_track`, bundled."""

    tracks: Sequence[Track]
    vehicles: Mapping[int, VehicleTrack]
    settings: MatchSettings
    likeness: Likeness = no_likeness

    @property
    def matched(self) -> bool:
        """Whether any of it was seen by a stereo matcher, and so by a stereo camera."""
        return any(track.window_rad for track in self.tracks)

    @property
    def by_boxes(self) -> Case:
        """The same, but judged by boxes only, and with whatever fits best chosen."""
        return replace(self, settings=self.settings.any_fit, likeness=no_likeness)

    def choose(self) -> Choice:
        """Return the likeliest choice; errors are those of `choose_track`."""
        return choose_track(self.tracks, self.vehicles, self.settings, self.likeness)

    def chosen(self) -> Choice | None:
        """Return the likeliest choice; None if there is none."""
        try:
            return self.choose()
        except (TrackError, MatchError):
            return None


@dataclass(frozen=True)
class Alternative:
    """A choice that would fit if something were not as specified.

    Attributes
    ----------
    choice : Choice
    words : str
    log_searched : float
        Logarithm of the number of alternatives of which it is the best (look-elsewhere effect): one of that many fits
        as well by chance.
    nearer_per_m : float
        By how much inverse distances would have to be larger, 1/m.
    """

    choice: Choice
    words: str
    log_searched: float = 0.0
    nearer_per_m: float = 0.0

    @property
    def log_odds(self) -> float:
        """Log odds against everything being where it is by chance."""
        return self.choice.log_likelihood - self.log_searched


def log_odds_between(one: Choice | None, other: Choice | None) -> float:
    """Return the log odds of one choice against another; one that does not fit at all is infinitely unlikely."""
    if one is None:
        return -math.inf
    return math.inf if other is None else one.log_likelihood - other.log_likelihood


def clearly_better(tried: Mapping[str, Case], case: Case, told: Choice | None, what: str) -> Alternative | None:
    """Return the likeliest of some cases that is certainly chosen, and clearly likelier than what was told, or None.

    Parameters
    ----------
    tried : mapping of str to Case
        By the option for it.
    case : Case
        As it was told; where what is chosen is the same in it, nothing was tried.
    told : Choice or None
        What is chosen in that.
    what : str
        What the cases assume, in words.
    """
    log_searched = math.log(max(len(tried), 1))
    found = []
    for option, other in tried.items():
        choice = other.chosen()
        if choice is None or choice.by_chance:
            continue
        same = other.tracks is case.tracks and other.vehicles[choice.station] is case.vehicles[choice.station]
        if not same and log_odds_between(choice, told) > case.settings.least_log_odds + log_searched:
            words = f"if {what}, station {choice.station} would match its messages: {option}"
            found.append(Alternative(choice, words, log_searched))
    return max(found, key=lambda each: each.log_odds, default=None)
