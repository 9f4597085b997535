"""Objections to the choice of the vehicle, such as that something else moves along with it."""

from __future__ import annotations

from collections.abc import Sequence

from laci_stereo.core.association.choice import Choice
from laci_stereo.core.association.riders import ridden_frames
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.tracking.tracks import Track


def doubts_of(choice: Choice) -> tuple[str, ...]:
    """Return the objections to the choice of the vehicle, other than that it may be a stranger."""
    return (*([choice.better] if choice.better else []), *([_part_of_it(choice.beside)] if choice.beside else []))


def ridden_doubts(
    choice: Choice, passages: Sequence[Passage], tracks: Sequence[Track], match: PlanarMatch
) -> list[tuple[str, ...]]:
    """Return, for each drive, the objection that something moves along with its vehicle, unless `choice` has it.

    See `ridden_frames`.
    """
    return [
        (_part_of_it(frames),) if frames and not (choice.beside and each.station_id == choice.station) else ()
        for each, frames in zip(passages, ridden_frames(passages, tracks, match), strict=True)
    ]


def _part_of_it(frames: int) -> str:
    return (
        f"{besides(frames)}: a trailer that its messages do not report, or a piece of it, may have been taken for the "
        "vehicle"
    )


def besides(frames: int) -> str:
    """Return in words that something moves along with the vehicle."""
    return f"something else moves with the vehicle, right behind or ahead of it, in {frames} frames"
