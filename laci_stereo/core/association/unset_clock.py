"""Whether the messages fit better with unknown clock offsets: a clock that nobody has set is off for all senders."""

from __future__ import annotations

from dataclasses import replace

from laci_stereo.core.association.case import Alternative, Case, log_odds_between
from laci_stereo.core.association.choice import Choice, Likeness, no_likeness
from laci_stereo.core.association.hypotheses import BOXES_S
from laci_stereo.core.robust import TAIL
from laci_stereo.core.settings import UNKNOWN_CLOCK_S, with_turn


def clocks_apart(case: Case, choice: Choice | None, by_any_clock: Likeness) -> Alternative | None:
    """Return the alternative of clocks farther apart than specified if it explains clearly more; else None.

    With a turn, or with vehicles that drive in several directions, no position fits with a wrong clock offset. A single
    sender that is seen on a straight road fits all the same, in a wrong place: then the other senders do not fit.

    Parameters
    ----------
    case : Case
    choice : Choice or None
        What was chosen with the specified clock uncertainty, if anything fits.
    by_any_clock : callable
        The likeness with unknown clocks; used where nothing was certainly chosen.
    """
    known_s, least_log_odds = case.settings.clock_sigma_s, case.settings.least_log_odds
    if known_s >= UNKNOWN_CLOCK_S:
        return None
    loose = replace(case, settings=replace(case.settings, clock_sigma_s=UNKNOWN_CLOCK_S), likeness=by_any_clock)
    if choice is None or choice.by_chance:
        other = loose.chosen()
        clearly = other is not None and not other.by_chance and log_odds_between(other, choice) > least_log_odds
    elif len(_together(choice)) == len(case.vehicles):
        return None
    else:
        other = replace(loose, likeness=no_likeness).chosen()
        clearly = other is not None and _explains_more(other, choice, case)
    turn_s = max((track.turn_s for track in case.tracks), default=0.0)
    least_s = max(BOXES_S, TAIL * with_turn(known_s, turn_s))
    if other is None or not clearly or abs(other.time_offset_s) < least_s:
        return None
    seen = _together(other)
    stations = " and ".join(str(each) for each in sorted(seen))
    who, whose = (f"station {stations}", "its") if len(seen) == 1 else (f"stations {stations}", "their")
    return Alternative(
        other,
        f"with the clocks {abs(other.time_offset_s):.2f} s apart, {who} would match {whose} messages: --clock unknown",
    )


def _explains_more(other: Choice, choice: Choice, case: Case) -> bool:
    """Return whether more senders are seen by another clock offset, and that is clearly likelier, judged by boxes."""
    if len(_together(other)) <= len(_together(choice)):
        return False
    by_boxes = case.by_boxes.chosen()
    return by_boxes is not None and log_odds_between(other, by_boxes) > case.settings.least_log_odds


def _together(choice: Choice) -> list[int]:
    """Return which stations are seen by one motion and one clock offset."""
    together = (other.station for other in choice.others if other.late_s == 0.0 and not other.alone)
    return [choice.station, *together]
