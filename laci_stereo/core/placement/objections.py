"""Objections to the choice of the vehicle, such as that something else moves along with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from laci_stereo.core.association.choice import Choice
from laci_stereo.core.association.repeated_frames import repeats_of
from laci_stereo.core.association.riders import ridden_frames
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.tracking.tracks import Track


def objected(
    passages: Sequence[Passage], own: Passage, choice: Choice, tracks: Sequence[Track], match: PlanarMatch
) -> tuple[list[Passage], tuple[str, ...]]:
    """Return drives that keep the objections to them, which an estimate from them cannot find again, and all of these.

    Parameters
    ----------
    passages : sequence of Passage
        Those that were used.
    own : Passage
        Of the sender that was chosen, as placed by its boxes.
    choice : Choice
    tracks : sequence of Track
        Everything that was seen.
    match : PlanarMatch
        Transform from the level to the world frame.
    """
    by_choice = (
        *([choice.better] if choice.better else []),
        *([_part_of_it(choice.beside)] if choice.beside else []),
        *repeats_of(own.track, own.vehicle, own.time_offset_s),
    )
    kept, objections = [], [*([choice.by_chance] if choice.by_chance else []), *by_choice]
    for passage, frames in zip(passages, ridden_frames(passages, tracks, match), strict=True):
        is_own = passage.station_id == choice.station
        lasting = by_choice if is_own else ()
        if frames and not (is_own and choice.beside):
            ridden = _part_of_it(frames)
            lasting = (*lasting, ridden)
            objections.append(f"{passage.name}: {ridden}" if len(passages) > 1 else ridden)
        by_chance = choice.by_chance if is_own else passage.by_chance
        kept.append(replace(passage, by_chance=by_chance, objections=(*passage.objections, *lasting)))
    return kept, tuple(objections)


def _part_of_it(frames: int) -> str:
    return (
        f"{besides(frames)}: a trailer that its messages do not report, or a piece of it, may have been taken for the "
        "vehicle"
    )


def besides(frames: int) -> str:
    """Return in words that something moves along with the vehicle."""
    return f"something else moves with the vehicle, right behind or ahead of it, in {frames} frames"
