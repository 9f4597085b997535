"""Whether a sensor's frame is right-handed: in a mirrored one a vehicle that turns left is seen to turn right."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from laci_stereo.core.association import chosen, log_odds_between
from laci_stereo.core.cam import VehicleTrack
from laci_stereo.core.choice import Choice, Likeness
from laci_stereo.core.laying import mirrored_track
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.tracking import Track

MOST_ODDS = 1e6
"""Beyond this nobody reads odds any more."""


def mirrored(
    tracks: Sequence[Track],
    vehicles: Mapping[int, VehicleTrack],
    settings: MatchSettings,
    likeness: Likeness,
    choice: Choice | None,
) -> str:
    """Say that what moves fits the messages clearly better with left and right exchanged; empty where it does not.

    One vehicle on a straight road fits both ways equally well. Boxes are asked first, for outlines take time. What a
    matcher saw is never mirrored: images that are would not match.

    Parameters
    ----------
    tracks : sequence of Track
    vehicles : mapping of int to VehicleTrack
        By station.
    settings : MatchSettings
    likeness : callable
        See `choose_track`.
    choice : Choice or None
        What was chosen as it was seen, if anything fits.
    """
    if any(track.window_rad for track in tracks):
        return ""
    boxes = [mirrored_track(track.without_points()) for track in tracks]
    by_boxes = [chosen(each, vehicles, settings.any_fit) for each in (boxes, tracks)]
    if log_odds_between(*by_boxes) < settings.least_log_odds:
        return ""
    turned = [mirrored_track(track) for track in tracks]
    other = chosen(turned, vehicles, settings, likeness)
    if other is None or other.doubt or log_odds_between(other, choice) < settings.clear_log_odds:
        return ""
    odds = f"by odds of {min(math.exp(log_odds_between(other, choice)), MOST_ODDS):.0f} to 1 " if choice else ""
    return (
        f"what was seen fits the messages of station {other.station} {odds}with left and right exchanged: the "
        "sensor's frame is left-handed; needed is a right-handed one, such as x forward, y left, z up"
    )
