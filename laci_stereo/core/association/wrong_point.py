"""Whether a detector's boxes fit the messages if their positions are of another point than their centre."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import get_args

from laci_stereo.core.association.case import Alternative, Case, log_odds_between
from laci_stereo.core.association.choice import Choice
from laci_stereo.core.tracking.box_point import BoxPoint, recentred

OTHERS: tuple[BoxPoint, ...] = get_args(BoxPoint)[1:]


def point_off(case: Case, choice: Choice | None) -> Alternative | None:
    """Return the point of the boxes by which they fit the messages clearly better; None if there is none.

    Only a turn, or an end that is no longer the nearer one, tells them apart: on a straight road any of them is a
    shift.

    Parameters
    ----------
    case : Case
    choice : Choice or None
        What was chosen with positions as they are, if anything fits.
    """
    if not any(sighting.box.length_m for track in case.tracks for sighting in track.sightings if sighting.detected):
        return None
    log_searched = math.log(len(OTHERS))
    found = []
    for point in OTHERS:
        other = replace(case, tracks=[recentred(track, point) for track in case.tracks]).chosen()
        if other is None or other.doubt:
            continue
        if log_odds_between(other, choice) > case.settings.least_log_odds + log_searched:
            words = (
                f"if the boxes' positions were not of their centres, station {other.station} would match its messages: "
                f"--box-point {point}"
            )
            found.append(Alternative(other, words, log_searched))
    return max(found, key=lambda each: each.log_odds, default=None)
