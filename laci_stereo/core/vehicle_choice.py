"""Which of what moves is which sender's vehicle, without what it tows, and what else would have to be wrong."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from laci_stereo.core.association import choose_track, chosen
from laci_stereo.core.cam import VehicleTrack
from laci_stereo.core.choice import Choice, Likeness, Resemblance
from laci_stereo.core.errors import CalibrationError, MatchError
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.handedness import mirrored
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.pieces import Companion, companion
from laci_stereo.core.resemblance import resemblance
from laci_stereo.core.settings import UNKNOWN_CLOCK_S, JointSettings, Settings
from laci_stereo.core.tracking import Track
from laci_stereo.core.unset_clock import clocks_apart
from laci_stereo.core.wrong_optics import optics_off


def choose_vehicle(
    tracks: Sequence[Track], vehicles: Mapping[int, VehicleTrack], height_m: float, settings: Settings
) -> Choice:
    """Find which track is which sender's vehicle, and what makes that doubtful.

    Parameters
    ----------
    tracks : sequence of Track
        See `whole`.
    vehicles : mapping of int to VehicleTrack
        By station.
    height_m : float
        Of the sensor above the ground.
    settings : Settings

    Raises
    ------
    TrackError
        If no sender moves while it is recorded, or no track is long enough.
    MatchError
        If none fits, two fit equally well, or all fit better in a mirrored frame; where they would by another clock,
        or with another stereo calibration, that is said.
    """
    likeness = _likeness_by(settings.joint, vehicles, height_m)
    by_any_clock = _likeness_by(replace(settings.joint, clock_sigma_s=UNKNOWN_CLOCK_S), vehicles, height_m)
    try:
        choice = _that_drives_ahead(tracks, vehicles, settings, likeness)
    except CalibrationError as error:
        if why := mirrored(tracks, vehicles, settings.match, likeness, None):
            raise MatchError(why) from error
        if why := clocks_apart(tracks, vehicles, settings.match, by_any_clock, None):
            raise MatchError(f"{error}; {why}") from error
        if isinstance(error, MatchError) and (why := optics_off(tracks, vehicles, settings.match, likeness)):
            raise MatchError(f"{error}; {why}") from error
        raise
    if why := mirrored(tracks, vehicles, settings.match, likeness, choice):
        raise MatchError(why)
    alone = [
        other for other in choice.others if not _companion(choice, other.station, other.track, tracks, vehicles).frames
    ]
    clocks = clocks_apart(tracks, vehicles, settings.match, by_any_clock, choice)
    return replace(choice, others=tuple(alone), clocks=clocks)


def _likeness_by(settings: JointSettings, vehicles: Mapping[int, VehicleTrack], height_m: float) -> Likeness:
    def likeness(track: Track, station: int, fit: PlanarMatch, time_offset_s: float) -> Resemblance:
        return resemblance(track, vehicles[station], fit, time_offset_s, height_m, settings)

    return likeness


def _that_drives_ahead(
    tracks: Sequence[Track], vehicles: Mapping[int, VehicleTrack], settings: Settings, likeness: Likeness
) -> Choice:
    """Return which track is which sender's; of two that move as one it is the one ahead, for what is towed follows."""
    choice = choose_track(tracks, vehicles, settings.match, likeness)
    beside = _companion(choice, choice.station, choice.track, tracks, vehicles)
    others = list(tracks)
    while beside.ahead_m > 0.0:
        others = [track for track in others if not choice.track.shares(track)]
        ahead = chosen(others, vehicles, settings.match, likeness)
        if ahead is None or not any(each.shares(beside.track) for each in _tracks_of(ahead)):
            break  # what is ahead does not fit: it will be said that it is there
        choice = ahead
        beside = _companion(choice, choice.station, choice.track, tracks, vehicles)
    return replace(choice, beside=beside.frames)


def _tracks_of(choice: Choice) -> list[Track]:
    """Return what is taken for a sender's vehicle."""
    return [choice.track, *(other.track for other in choice.others)]


def _companion(
    choice: Choice, station: int, track: Track, tracks: Sequence[Track], vehicles: Mapping[int, VehicleTrack]
) -> Companion:
    """Return what `companion` does of the track of a station, given what was chosen."""

    def yaw_at(stamps_s: FloatArray) -> FloatArray:
        return vehicles[station].at(stamps_s + choice.time_offset_s)[1] - choice.fit.yaw_rad

    return companion(track, tracks, yaw_at)
