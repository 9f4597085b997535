"""What an association says: which track is which sender's, and what else was weighed for that."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from laci_stereo.core.cam import VehicleTrack
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.tracking import Times, Track


@dataclass(frozen=True)
class Other:
    """Another sender that is as clearly seen.

    Attributes
    ----------
    station : int
    track : Track
    late_s : float
        By how much later than the first sender's its clock must be for that: boxes are some decimetres off, which a
        vehicle drives in less than a tenth of a second; or it is wrong.
    alone : bool
        Its own motion shows it, where the first sender's has it elsewhere.
    """

    station: int
    track: Track
    late_s: float = 0.0
    alone: bool = False


@dataclass(frozen=True)
class Choice:
    """The track that is the sender's.

    Attributes
    ----------
    station : int
    track : Track
        Its fragments joined.
    explained : float
        Of how many frames the fit accounts for, each counted by how well.
    second : float
        The same of the best other candidate.
    fit : PlanarMatch
        The motion from the level into the world frame that brings the track onto the sender's.
    time_offset_s : float
        To be added to the sensor's stamps to get the CAMs' time.
    log_likelihood : float
        Of this hypothesis, against everything being where it is by chance.
    log_likelihood_margin : float
        Log odds against the second-best hypothesis that says something else; infinite if there is none.
    second_is : str
        What that is, in words.
    doubt : str
        Why the track may yet be a stranger's; empty where that is out of the question.
    beside : int
        In how many frames something else moves as one with it; see `companion`.
    clocks : str
        By how much clocks would be apart that explain clearly more; empty where none do.
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
    doubt: str = ""
    beside: int = 0
    clocks: str = ""
    others: tuple[Other, ...] = ()


@dataclass(frozen=True)
class Resemblance:
    """Log odds that what was seen is a sender's vehicle, against a stranger that moves much like it.

    Attributes
    ----------
    body : float
        By its length.
    way : float or None
        By how exactly its outline follows the sender's way; None where no outline was seen.
    strayed_s : tuple of (float, float)
        Times from which to which something else was seen with it or instead of it.
    fit : PlanarMatch or None
        The motion into the world by the outline, which is more exact than by boxes.
    """

    body: float = 0.0
    way: float | None = None
    strayed_s: Times = ()
    fit: PlanarMatch | None = None


Likeness = Callable[[Track, VehicleTrack, PlanarMatch, float], Resemblance]
"""Whether a track is a sender's vehicle, given the motion into the world and the clock offset."""


def no_likeness(_track: Track, _vehicle: VehicleTrack, _fit: PlanarMatch, _time_offset_s: float) -> Resemblance:
    """Know nothing of outlines."""
    return Resemblance()
