"""Whether a detector's boxes fit the messages if their positions are of another point than their centre."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

from laci_stereo.core.association.case import Alternative, Case, clearly_better
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
    tried = {
        f"--box-point {point}": replace(case, tracks=[recentred(track, point) for track in case.tracks])
        for point in OTHERS
    }
    return clearly_better(tried, case, choice, "the boxes' positions were not of their centres")
