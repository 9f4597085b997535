"""Which moving object is which sender's vehicle, without what it tows; if none, what error would explain that."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from laci_stereo.core.association.case import Alternative, Case, clearly_better
from laci_stereo.core.association.choice import Choice, Likeness, Resemblance
from laci_stereo.core.association.handedness import mirrored
from laci_stereo.core.association.pieces import Companion, companion
from laci_stereo.core.association.resemblance import resemblance
from laci_stereo.core.association.unset_clock import clocks_apart
from laci_stereo.core.association.wrong_optics import disparities_off, optics_off
from laci_stereo.core.association.wrong_place import place_off
from laci_stereo.core.association.wrong_point import point_off
from laci_stereo.core.errors import CalibrationError, MatchError
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.settings import UNKNOWN_CLOCK_S, JointSettings, MatchSettings, Settings
from laci_stereo.core.tracking.tracks import Track

ByOtherClocks = Callable[[], Mapping[str, Mapping[int, VehicleTrack]]]
"""Returns the vehicles that would drive during the recording by other clocks, by the cause of that."""


def choose_vehicle(
    tracks: Sequence[Track],
    vehicles: Mapping[int, VehicleTrack],
    height_m: float,
    settings: Settings,
    by_other_clocks: ByOtherClocks = dict,
) -> Choice:
    """Find which track belongs to which sender's vehicle, with the objections against that.

    Parameters
    ----------
    tracks : sequence of Track
        See `whole`.
    vehicles : mapping of int to VehicleTrack
        By station.
    height_m : float
        Height of the sensor above the ground.
    settings : Settings
    by_other_clocks : callable
        Asked where nothing fits for certain.

    Raises
    ------
    TrackError
        If no sender moves during the recording, or no track is long enough.
    MatchError
        If no track fits, two fit equally well, or all fit better in a mirrored frame. If they would fit by another
        clock offset or clock, with another reference point on the vehicle, or with another stereo calibration, the
        message says so.
    """
    case = Case(tracks, vehicles, settings.match, _likeness_by(settings.joint, height_m))
    by_any_clock = _likeness_by(replace(settings.joint, clock_sigma_s=UNKNOWN_CLOCK_S), height_m)
    try:
        choice = _that_drives_ahead(case)
    except CalibrationError as error:
        asked = [mirrored(case, None), clocks_apart(case, None, by_any_clock), point_off(case, None)]
        if isinstance(error, MatchError):
            asked += [place_off(case), optics_off(case), disparities_off(case)]
            asked += [_clock_off(case, None, by_other_clocks())]
        instead = [each for each in asked if each is not None]
        if not instead:
            raise
        nearer_per_m = max((each.nearer_per_m for each in instead), key=abs)
        raise MatchError(f"{error}; {in_words(instead, settings.match)}", nearer_per_m) from error
    if turned_over := mirrored(case, choice):
        raise MatchError(turned_over.words)
    alone = [other for other in choice.others if not _companion(case, choice, other.station, other.track).frames]
    asked = [clocks_apart(case, choice, by_any_clock), point_off(case, choice)]
    if choice.by_chance:
        asked += [_clock_off(case, choice, by_other_clocks())]
    better = in_words([each for each in asked if each is not None], settings.match)
    return replace(choice, others=tuple(alone), better=better)


def _clock_off(
    case: Case, choice: Choice | None, by_other_clocks: Mapping[str, Mapping[int, VehicleTrack]]
) -> Alternative | None:
    """Return the clock that, unlike the one assumed, certainly explains what was seen, or None."""
    tried = {cause: replace(case, vehicles=vehicles) for cause, vehicles in by_other_clocks.items()}
    return clearly_better(tried, case, choice, "times were of another clock")


def in_words(instead: Sequence[Alternative], settings: MatchSettings) -> str:
    """Return words on what would fit: the likeliest alternative and those nearly as likely; empty if there is none."""
    best = max((each.log_odds for each in instead), default=0.0)
    likely = sorted(instead, key=lambda each: -each.log_odds)
    return "; or ".join(each.words for each in likely if each.log_odds > best - settings.least_log_odds)


def _likeness_by(settings: JointSettings, height_m: float) -> Likeness:
    def likeness(track: Track, vehicle: VehicleTrack, fit: PlanarMatch, time_offset_s: float) -> Resemblance:
        return resemblance(track, vehicle, fit, time_offset_s, height_m, settings)

    return likeness


def _that_drives_ahead(case: Case) -> Choice:
    """Return which track belongs to which sender; of two that move as one, the one ahead: what is towed follows."""
    choice = case.choose()
    beside = _companion(case, choice, choice.station, choice.track)
    left = case
    while beside.ahead_m > 0.0:
        left = replace(left, tracks=[track for track in left.tracks if not choice.track.shares(track)])
        ahead = left.chosen()
        if ahead is None or not any(each.shares(beside.track) for each in _tracks_of(ahead)):
            break  # the object ahead does not fit: an objection will mention it
        choice = ahead
        beside = _companion(case, choice, choice.station, choice.track)
    return replace(choice, beside=beside.frames)


def _tracks_of(choice: Choice) -> list[Track]:
    """Return the tracks that are taken for senders' vehicles."""
    return [choice.track, *(other.track for other in choice.others)]


def _companion(case: Case, choice: Choice, station: int, track: Track) -> Companion:
    """Return the result of `companion` for the track of a station, given what was chosen."""

    def yaw_at(stamps_s: FloatArray) -> FloatArray:
        return case.vehicles[station].at(stamps_s + choice.time_offset_s)[1] - choice.fit.yaw_rad

    return companion(track, case.tracks, yaw_at)
