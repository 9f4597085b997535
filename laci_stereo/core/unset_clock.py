"""Whether the messages fit better if nothing is known of the clocks: one that nobody has set is off for all senders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from laci_stereo.core.association import BOXES_S, chosen, log_odds_between
from laci_stereo.core.cam import VehicleTrack
from laci_stereo.core.choice import Choice, Likeness
from laci_stereo.core.settings import UNKNOWN_CLOCK_S, MatchSettings, with_turn
from laci_stereo.core.tracking import Track

SURELY = 4.0
"""By so many standard deviations clocks never differ that are as was said."""


def clocks_apart(
    tracks: Sequence[Track],
    vehicles: Mapping[int, VehicleTrack],
    settings: MatchSettings,
    likeness: Likeness,
    choice: Choice | None,
) -> str:
    """Say that clocks which are farther apart than was said explain clearly more; empty where they do not.

    With a turn, or with vehicles that drive in several directions, a clock that is off fits no position. The one sender
    that is seen on a straight road fits all the same, in a wrong place: then it is the others that do not.

    Parameters
    ----------
    tracks : sequence of Track
    vehicles : mapping of int to VehicleTrack
        By station.
    settings : MatchSettings
    likeness : callable
        See `choose_track`, by clocks of which nothing is known; asked where nothing was surely chosen.
    choice : Choice or None
        What was chosen by the clocks that were asked for, if anything fits.
    """
    loose = replace(settings, clock_sigma_s=UNKNOWN_CLOCK_S)
    if settings.clock_sigma_s >= loose.clock_sigma_s:
        return ""
    if choice is None or choice.doubt:
        other = chosen(tracks, vehicles, loose, likeness)
        clearly = other is not None and not other.doubt and log_odds_between(other, choice) > settings.least_log_odds
    elif len(_together(choice)) == len(vehicles):
        return ""
    else:
        other = chosen(tracks, vehicles, loose)
        clearly = other is not None and _explains_more(other, choice, tracks, vehicles, settings)
    turn_s = max((track.turn_s for track in tracks), default=0.0)
    least_s = max(BOXES_S, SURELY * with_turn(settings.clock_sigma_s, turn_s))
    if other is None or not clearly or abs(other.time_offset_s) < least_s:
        return ""
    seen = _together(other)
    stations = " and ".join(str(each) for each in seen)
    who, whose = (f"station {stations}", "its") if len(seen) == 1 else (f"stations {stations}", "their")
    return (
        f"were the clocks {abs(other.time_offset_s):.2f} s apart, {who} would be seen where {whose} messages say: "
        "--clock unknown"
    )


def _explains_more(
    other: Choice,
    choice: Choice,
    tracks: Sequence[Track],
    vehicles: Mapping[int, VehicleTrack],
    settings: MatchSettings,
) -> bool:
    """Tell whether more senders are seen by another clock, and that is clearly likelier, by boxes."""
    if len(_together(other)) <= len(_together(choice)):
        return False
    by_boxes = chosen(tracks, vehicles, settings.any_fit)
    return by_boxes is not None and log_odds_between(other, by_boxes) > settings.least_log_odds


def _together(choice: Choice) -> list[int]:
    """Return which stations are seen by one motion and one clock."""
    together = (other.station for other in choice.others if other.late_s == 0.0 and not other.alone)
    return [choice.station, *together]
