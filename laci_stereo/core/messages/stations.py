"""The senders of a log: the world around their messages, and the tracks of their vehicles in it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from laci_stereo.core.errors import CamError, TrackError
from laci_stereo.core.messages.cam import CamLog, ReferencePoint, VehicleTrack, vehicle_track
from laci_stereo.core.messages.clock_errors import CLOCK_ERRORS
from laci_stereo.core.world import World


@dataclass(frozen=True)
class Senders:
    """The vehicles that send while a sensor records.

    Attributes
    ----------
    messages : CamLog
        The whole log.
    span_ns : tuple of int
        First and last stamp of the recording.
    reference : ReferencePoint
        Point of the vehicle that the messages' positions refer to.
    world : World
    vehicles : mapping of int to VehicleTrack
        By station; their epoch is the recording's first stamp.
    """

    messages: CamLog
    span_ns: tuple[int, int]
    reference: ReferencePoint
    world: World
    vehicles: Mapping[int, VehicleTrack]

    def by_other_clocks(self) -> dict[str, Mapping[int, VehicleTrack]]:
        """Return the vehicles that would drive meanwhile if a clock were not UTC, by the cause of that."""
        found: dict[str, Mapping[int, VehicleTrack]] = {}
        for error in CLOCK_ERRORS:
            earlier = replace(self.messages, stamps_ns=self.messages.stamps_ns - error.ahead_s * 10**9)
            earlier = earlier.between(*self.span_ns)
            if not earlier.may_drive.any():
                continue
            try:
                found[error.cause] = vehicles_of(earlier, self.world, self.span_ns[0], self.reference)
            except (CamError, TrackError):
                continue
        return found


def senders_of(
    messages: CamLog, span_ns: tuple[int, int], reference: ReferencePoint, crs: str | None, clock_sigma_s: float
) -> Senders:
    """Return the vehicles that send while a sensor records, in the world around them.

    Parameters
    ----------
    messages, span_ns, reference
        See `Senders`.
    crs : str or None
        The UTM zone; None takes that of the messages.
    clock_sigma_s : float
        Standard deviation of the offset between the clocks.

    Raises
    ------
    CamError, TrackError
        If no message has a position, or no station a track.
    """
    recorded = messages.between(*span_ns, clock_sigma_s)
    world = world_around(recorded, crs)
    return Senders(messages, span_ns, reference, world, vehicles_of(recorded, world, span_ns[0], reference))


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
