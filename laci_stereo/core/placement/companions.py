"""Objections to the choice of the vehicle, such as that something else moves along with it."""

from __future__ import annotations

from collections.abc import Sequence

from laci_stereo.core.association.choice import Choice
from laci_stereo.core.association.riders import ridden_frames
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.quality import Placement
from laci_stereo.core.tracking.tracks import Track


def doubts_of(choice: Choice) -> tuple[str, ...]:
    """Return the objections to the choice of the vehicle."""
    doubts = [doubt for doubt in (choice.better, choice.doubt) if doubt]
    if choice.beside:
        doubts.append(_part_of_it(choice.beside))
    return tuple(doubts)


def ridden_doubts(
    choice: Choice, passages: Sequence[Passage], tracks: Sequence[Track], placement: Placement
) -> tuple[str, ...]:
    """Return objections where something moves along with a vehicle, unless `choice` has it; see `ridden_frames`."""
    told = []
    for each, frames in zip(passages, ridden_frames(passages, tracks, placement.match), strict=True):
        if frames and not (choice.beside and each.station_id == choice.station):
            told.append(f"{each.name}: {_part_of_it(frames)}" if len(passages) > 1 else _part_of_it(frames))
    return tuple(told)


def _part_of_it(frames: int) -> str:
    return (
        f"{besides(frames)}: a trailer that its messages do not report, or a piece of it, may have been taken for the "
        "vehicle"
    )


def besides(frames: int) -> str:
    """Return in words that something moves along with the vehicle."""
    return f"something else moves with the vehicle, right behind or ahead of it, in {frames} frames"
