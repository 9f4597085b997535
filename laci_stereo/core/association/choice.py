"""The result of an association: which track belongs to which sender, and which alternatives were considered."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.tracking.tracks import Times, Track


@dataclass(frozen=True)
class Other:
    """Another sender that is seen as clearly as the first.

    Attributes
    ----------
    station : int
    track : Track
    late_s : float
        How much later its clock must be than the first sender's. Box errors are some decimetres, which a vehicle covers
        in less than 0.1 s; with a larger offset, the clock is wrong.
    alone : bool
        Whether only its own motion shows it, while the first sender's motion places it elsewhere.
    """

    station: int
    track: Track
    late_s: float = 0.0
    alone: bool = False


@dataclass(frozen=True)
class Choice:
    """The track that belongs to the sender.

    Attributes
    ----------
    station : int
    track : Track
        All fragments joined.
    explained : float
        Number of frames that the fit accounts for, each weighted by how well.
    second : float
        The same for the second-best candidate.
    fit : PlanarMatch
        Motion from the level into the world frame that maps the track onto the sender's.
    time_offset_s : float
        Offset that, added to the sensor's stamps, gives the CAMs' time.
    log_likelihood : float
        Log-likelihood ratio of this hypothesis against everything being where it is by chance.
    log_likelihood_margin : float
        Log odds against the second-best hypothesis that contradicts this one; infinite if there is none.
    second_is : str
        Description of that hypothesis.
    by_chance : str
        Objection: why the track may be a stranger's; empty where that is out of the question.
    beside : int
        Number of frames in which another object moves as one with it; see `companion`.
    better : str
        Words on what explains clearly more, such as another clock offset; empty where nothing does.
    others : tuple of Other
        Other senders that are clearly seen as well.
    """

    station: int
    track: Track
    explained: float
    second: float
    fit: PlanarMatch
    time_offset_s: float
    log_likelihood: float
    log_likelihood_margin: float
    second_is: str
    by_chance: str = ""
    beside: int = 0
    better: str = ""
    others: tuple[Other, ...] = ()


@dataclass(frozen=True)
class Resemblance:
    """Log odds that an object seen is a sender's vehicle, against a stranger that moves much like it.

    Attributes
    ----------
    body : float
        Contribution of its length.
    way : float or None
        Contribution of how exactly its outline follows the sender's path; None where no outline was seen.
    strayed_s : tuple of (float, float)
        Intervals, from a first to a last time, in which something else was seen with it or instead of it.
    fit : PlanarMatch or None
        Motion into the world according to the outline, which is more exact than that by boxes.
    """

    body: float = 0.0
    way: float | None = None
    strayed_s: Times = ()
    fit: PlanarMatch | None = None


Likeness = Callable[[Track, VehicleTrack, PlanarMatch, float], Resemblance]
"""Compares a track with a sender's vehicle, given the motion into the world and the clock offset."""


def no_likeness(_track: Track, _vehicle: VehicleTrack, _fit: PlanarMatch, _time_offset_s: float) -> Resemblance:
    """Return a neutral resemblance, without looking at outlines."""
    return Resemblance()
