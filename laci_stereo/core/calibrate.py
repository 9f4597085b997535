"""The calibration from end to end: point clouds and messages in, a transform out."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from laci_stereo.core.association import Choice, Likeness, Resemblance, choose_track, chosen
from laci_stereo.core.cam import FRONT, CamLog, ReferencePoint, VehicleTrack, vehicle_track
from laci_stereo.core.cloud import PointCloudSource
from laci_stereo.core.common_ground import along_ground
from laci_stereo.core.conclusion import conclude
from laci_stereo.core.errors import CalibrationError, CamError, MatchError, TrackError
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.handedness import mirrored
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.observe import Observation, observe, on_the_road
from laci_stereo.core.passage import Passage
from laci_stereo.core.pieces import Companion, companion, whole
from laci_stereo.core.placement import doubts_of, place_by_paper, place_jointly
from laci_stereo.core.repeats import repeats_of
from laci_stereo.core.resemblance import resemblance
from laci_stereo.core.result import Calibration
from laci_stereo.core.settings import UNKNOWN_CLOCK_S, JointSettings, Settings
from laci_stereo.core.threads import in_one_thread
from laci_stereo.core.tracking import Track
from laci_stereo.core.unset_clock import clocks_apart
from laci_stereo.core.world import World

log = logging.getLogger(__name__)


def calibrate(
    source: PointCloudSource,
    messages: CamLog,
    settings: Settings | None = None,
    *,
    reference: ReferencePoint = FRONT,
    crs: str | None = None,
) -> Calibration:
    """Find the transform from a sensor into the world.

    Parameters
    ----------
    source : PointCloudSource
        The recording. It is read twice: a survey of whole frames, then every frame once; and so once more where the
        sender's way shows that the ground found first is not the road.
    messages : CamLog
        Of one station or several: all that are surely seen are used.
    settings : Settings
    reference : ReferencePoint
        Where on the vehicle the messages' positions are.
    crs : str
        The UTM zone; None takes the one of the messages.

    Returns
    -------
    Calibration

    Raises
    ------
    InputError
        If the messages make no sense.
    CalibrationError
        If the recording and the messages do not determine a transform.
    """
    settings = settings or Settings()
    epoch_ns = source.span_ns[0]
    messages = messages.between(*source.span_ns, settings.match.clock_sigma_s)
    world = world_around(messages, crs)
    vehicles = vehicles_of(messages, world, epoch_ns, reference)
    seen = on_the_road(observe(source, settings), source, vehicles, settings)
    return locate(seen, vehicles, world, settings)


@in_one_thread
def locate(
    seen: Observation, vehicles: Mapping[int, VehicleTrack], world: World, settings: Settings | None = None
) -> Calibration:
    """Find the transform from what a sensor saw and where the senders' vehicles were.

    Parameters
    ----------
    seen : Observation
    vehicles : mapping of int to VehicleTrack
        By station; their epoch is the observation's.
    world : World
    settings : Settings

    Raises
    ------
    CalibrationError
        If they do not determine a transform.
    """
    settings = settings or Settings()

    def likeness_by(joint: JointSettings) -> Likeness:
        def likeness(track: Track, station: int, fit: PlanarMatch, time_offset_s: float) -> Resemblance:
            return resemblance(track, vehicles[station], fit, time_offset_s, seen.ground.height_m, joint)

        return likeness

    likeness = likeness_by(settings.joint)
    by_any_clock = likeness_by(replace(settings.joint, clock_sigma_s=UNKNOWN_CLOCK_S))
    tracks = whole(seen.tracks, vehicles.values(), settings)
    try:
        choice = _that_drives_ahead(tracks, vehicles, settings, likeness)
    except CalibrationError as error:
        if why := mirrored(tracks, vehicles, settings.match, likeness, None):
            raise MatchError(why) from error
        if why := clocks_apart(tracks, vehicles, settings.match, by_any_clock, None):
            raise MatchError(f"{error}; {why}") from error
        raise
    if why := mirrored(tracks, vehicles, settings.match, likeness, choice):
        raise MatchError(why)
    log.info("station %d: %.1f frames explained, next best %.1f", choice.station, choice.explained, choice.second)
    vehicle = vehicles[choice.station]
    for remark in vehicle.remarks:
        log.warning("%s", remark)

    def passage(station: int, track: Track, late_s: float = 0.0) -> Passage:
        return Passage(
            world=world,
            axes=seen.axes,
            ground=seen.ground,
            background=seen.background,
            track=track,
            vehicle=vehicles[station],
            station_id=station,
            match=choice.fit,
            time_offset_s=choice.time_offset_s + late_s,
            method="paper",
            clock_sigma_s=settings.joint.clock_sigma_s,
            name=f"station {station}",
        )

    others = [
        passage(other.station, other.track, other.late_s)
        for other in choice.others
        if not _companion(choice, other.station, other.track, tracks, vehicles).frames
    ]
    own, *others = along_ground([passage(choice.station, choice.track), *others])
    passages: tuple[Passage, ...] = (own,)
    if settings.method == "paper":
        placement = place_by_paper(own.track, own.vehicle, settings.match)
    else:
        placement, passages = place_jointly(own, others, choice, settings)
    clocks = clocks_apart(tracks, vehicles, settings.match, by_any_clock, choice)
    doubts = (*([clocks] if clocks else []), *doubts_of(choice), *repeats_of(own.track, own.vehicle, own.time_offset_s))
    placement = replace(placement, contradictions=(*placement.contradictions, *doubts))
    return conclude(passages, placement, settings)


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


def world_around(messages: CamLog, crs: str | None = None) -> World:
    """Lay the world around where the messages are: around the median, for some positions may be wrong by far.

    Raises
    ------
    CamError
        If none has a position.
    """
    located = messages[np.isfinite(messages.latitude_deg) & np.isfinite(messages.longitude_deg)]
    if len(located) == 0:
        raise CamError("0 CAMs with a position fall into the recording's time; needed is a drive that was recorded")
    east_deg = (located.longitude_deg - located.longitude_deg[0] + 180.0) % 360.0 - 180.0
    longitude_deg = (float(located.longitude_deg[0] + np.median(east_deg)) + 180.0) % 360.0 - 180.0
    return World.around(float(np.median(located.latitude_deg)), longitude_deg, crs)


def vehicles_of(messages: CamLog, world: World, epoch_ns: int, reference: ReferencePoint) -> dict[int, VehicleTrack]:
    """Lay the track of every station that has one into the world; the rest, such as roadside units, are no vehicles.

    Raises
    ------
    CamError, TrackError
        If none has one.
    """
    tracks: dict[int, VehicleTrack] = {}
    problems: list[CamError | TrackError] = []
    for station in messages.stations():
        try:
            tracks[station] = vehicle_track(messages.of(station), world, epoch_ns, reference)
        except (CamError, TrackError) as error:
            problems.append(error)
    if not tracks:
        raise problems[0]
    return tracks
