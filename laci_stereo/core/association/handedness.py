"""Whether a sensor's frame is right-handed: in a mirrored one, a vehicle that turns left appears to turn right."""

from __future__ import annotations

import math
from dataclasses import replace

from laci_stereo.core.association.case import Alternative, Case, log_odds_between
from laci_stereo.core.association.choice import Choice
from laci_stereo.core.association.words import two_digits
from laci_stereo.core.tracking.reframing import mirrored_track

MOST_ODDS = 1e6
"""Larger odds are reported as these: nobody distinguishes them any more."""


def mirrored(case: Case, choice: Choice | None) -> Alternative | None:
    """Return the alternative of left and right exchanged if it fits the messages clearly better; else None.

    A single vehicle on a straight road fits equally well either way. Boxes are compared first, as outlines take time.
    The points of a stereo matcher are never mirrored: mirrored images would not match.

    Parameters
    ----------
    case : Case
    choice : Choice or None
        What was chosen as it was seen, if anything fits.
    """
    if case.matched:
        return None
    boxes = replace(case, tracks=[mirrored_track(track.without_points()) for track in case.tracks])
    if log_odds_between(boxes.by_boxes.chosen(), case.by_boxes.chosen()) < case.settings.least_log_odds:
        return None
    other = replace(case, tracks=[mirrored_track(track) for track in case.tracks]).chosen()
    if other is None or other.by_chance or log_odds_between(other, choice) < case.settings.clear_log_odds:
        return None
    size = math.exp(min(log_odds_between(other, choice), math.log(MOST_ODDS)))
    odds = f"by odds of {two_digits(size)} to 1 " if choice else ""
    return Alternative(
        other,
        f"what was seen fits the messages of station {other.station} {odds}with left and right exchanged: the "
        "sensor's frame is left-handed; needed is a right-handed one, such as x forward, y left, z up",
    )
