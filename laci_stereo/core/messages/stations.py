"""The senders of a log: the world around their messages, and the tracks of their vehicles in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from laci_stereo.core.errors import CamError, TrackError
from laci_stereo.core.messages.cam import CamLog, ReferencePoint, VehicleTrack, vehicle_track
from laci_stereo.core.messages.clock_errors import CLOCK_ERRORS
from laci_stereo.core.messages.repair import STANDING_MPS
from laci_stereo.core.world import World


def world_around(messages: CamLog, crs: str | None = None) -> World:
    """Return a world around the median of the messages' positions, some of which may be far off.

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
    """Return the track, in the world, of every station that has one; others, such as roadside units, have none.

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


def vehicles_by_other_clocks(
    messages: CamLog, span_ns: tuple[int, int], world: World, reference: ReferencePoint
) -> dict[str, Mapping[int, VehicleTrack]]:
    """Return the tracks of vehicles that would drive during a recording if a clock were not UTC, by the cause of that.

    Parameters
    ----------
    messages : CamLog
        The whole log.
    span_ns : tuple of int
        First and last stamp of the recording.
    world : World
    reference : ReferencePoint
    """
    found: dict[str, Mapping[int, VehicleTrack]] = {}
    for error in CLOCK_ERRORS:
        earlier = replace(messages, stamps_ns=messages.stamps_ns - error.ahead_s * 10**9).between(*span_ns)
        if not ((earlier.speed_mps >= STANDING_MPS) | np.isnan(earlier.speed_mps)).any():
            continue
        try:
            found[error.cause] = vehicles_of(earlier, world, span_ns[0], reference)
        except (CamError, TrackError):
            continue
    return found
