"""The placement by all senders that are seen in one recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from laci_stereo.core.association.choice import Choice
from laci_stereo.core.association.hypotheses import BOXES_S
from laci_stereo.core.errors import CombineError, MatchError
from laci_stereo.core.estimation.agreement import agreeing, estimates_of, fit_together
from laci_stereo.core.estimation.evidence import Evidence, evidence_of
from laci_stereo.core.estimation.joint import HELD_ROWS, JointFit, fit_jointly
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.estimation.split_check import compare_halves, with_difference
from laci_stereo.core.placement.findings import against_messages
from laci_stereo.core.placement.objections import besides
from laci_stereo.core.placement.place import check_registered, place
from laci_stereo.core.placement.seen_length import seen_length, seen_lengths, with_uncertainty_along
from laci_stereo.core.quality import Placement
from laci_stereo.core.settings import Settings


def place_jointly(
    own: Passage, others: Sequence[Passage], choice: Choice, settings: Settings
) -> tuple[Placement, tuple[Passage, ...]]:
    """Register the visible outline on the vehicle in all frames at once.

    Other senders' vehicles are registered as well, and used where they agree.

    Parameters
    ----------
    own : Passage
        Of the sender that was chosen, as placed by its boxes.
    others : sequence of Passage
        Of other senders in the same recording.
    choice : Choice
    settings : Settings

    Returns
    -------
    placement : Placement
    passages : tuple of Passage
        Those that were used, the most informative one first.

    Raises
    ------
    MatchError
        If too few frames show anything of the outline, or if an end of the vehicle was never seen and something else
        moves there.
    OpenError
        If the drives leave a direction open.
    """
    drive = evidence_of(own.track, own.vehicle, own.ground.height_m)
    fit = fit_jointly([drive], own.match, [own.time_offset_s], settings.joint)
    length = seen_length(drive, fit.match, fit.time_offsets_s[0])
    if choice.beside and length.missing_m:
        raise MatchError(f"{besides(choice.beside)}, and {length.lacks}: which of them is the vehicle cannot be told")
    check_registered(fit, [drive], settings)
    objections = []
    if difference := compare_halves(own, fit, settings):
        fit = with_difference(fit, difference)
        objections.append(str(difference))
    registered, remarks, contradictions = _registered(own, drive, fit, others, settings)
    objections += contradictions
    seen, drives, alone = zip(*registered, strict=True)
    # Clock offsets that straight drives leave open differ by themselves, although the sensor has one clock.
    moved_s = [found.time_offsets_s[0] - passage.time_offset_s for found, passage in zip(alone, seen, strict=True)]
    start = own.match if np.ptp(moved_s) > BOXES_S else None
    try:
        together = fit_together(seen, drives, alone, settings.joint, start)
    except CombineError as error:
        objections.append(f"only {own.name} was used: {error}{''.join(_late(own, other) for other in seen[1:])}")
        together = fit_together([own], [drive], [fit], settings.joint)
    passages = together.passages
    names = [passage.name for passage in passages] if len(passages) > 1 else [""]
    placement = place(together.fit, together.drives, together.sightings, settings, names)
    remarks += map(str, together.left_out)
    for other in passages[1:]:
        remarks.append(f"{other.name} is seen as well, and was used: {len(other.track.sightings)} frames")
        remarks += [f"{other.name}: {remark}" for remark in other.vehicle.remarks]
    placement = replace(
        placement,
        remarks=(*placement.remarks, *remarks),
        contradictions=(*placement.contradictions, *objections),
    )
    passages = tuple(
        replace(passage, objections=(*passage.objections, *objections))
        if passage.station_id == own.station_id
        else passage
        for passage in passages
    )
    return placement, passages


def _registered(
    own: Passage, drive: Evidence, fit: JointFit, others: Sequence[Passage], settings: Settings
) -> tuple[list[tuple[Passage, Evidence, JointFit]], list[str], list[str]]:
    """Register other senders' outlines as well.

    Returns
    -------
    registered : list of tuple of Passage, Evidence and JointFit
        Those that can be used, including the first one.
    remarks, objections : list of str
        Why the others cannot be used. A sender whose messages contradict its own points yields a remark if it places
        the sensor where the usable ones place it, or if these are a majority against it. Otherwise it is an objection,
        since the error may be the sensor's clock, and the first sender's placement wrong with it.
    """
    registered, contradicted, remarks, objections = [(own, drive, fit)], [], [], []
    for other in others:
        try:
            other_drive, alone = _as_well(other, fit, other.time_offset_s - own.time_offset_s, settings)
        except MatchError as error:
            remarks.append(f"{_unused(other)}: {error}")
            continue
        lengths = seen_lengths(alone, [other_drive])
        if wrong := against_messages(alone, [other_drive], lengths, [""]):
            contradicted.append((other, with_uncertainty_along(alone, [other_drive], lengths), "; ".join(wrong)))
        else:
            registered.append((other, other_drive, alone))
    used, _, fits = zip(*registered, strict=True)
    for other, alone, wrong_words in contradicted:
        try:
            both = *used, other
            agreeing(
                [passage.name for passage in both],
                estimates_of([*fits, alone], [passage.station_id for passage in both]),
            )
        except CombineError as error:
            objections.append(f"{_unused(other)}: {wrong_words}; {error}")
        else:
            remarks.append(f"{_unused(other)}: {wrong_words}")
    return registered, remarks, objections


def _unused(other: Passage) -> str:
    return f"{other.name} is seen as well, but was not used"


def _as_well(other: Passage, fit: JointFit, late_s: float, settings: Settings) -> tuple[Evidence, JointFit]:
    """Register another sender's outline, given the first one's; a direction that it leaves open does no harm.

    The search begins with a clock offset that is larger by ``late_s``.

    Raises
    ------
    MatchError
        If hardly anything of it is seen where it must be.
    """
    drive = evidence_of(other.track, other.vehicle, other.ground.height_m)
    alone = fit_jointly([drive.thinned(HELD_ROWS)], fit.match, [fit.time_offsets_s[0] + late_s], settings.joint)
    check_registered(alone, [drive], settings)
    return drive, alone


def _late(own: Passage, other: Passage) -> str:
    """Return in words how much earlier or later than by its messages another vehicle is seen; empty if neither."""
    late_s = other.time_offset_s - own.time_offset_s
    if late_s == 0.0:
        return ""
    when = "before" if late_s > 0.0 else "after"
    return f"; {other.name} is seen {abs(late_s):.2f} s {when} its messages have it there, as by a wrong clock"
