"""One drive past a sensor, as it is stored for an estimate from several drives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.frames import Axes
from laci_stereo.core.ground.plane import GroundPlane
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.settings import JointSettings, Method
from laci_stereo.core.tracking.background import Background
from laci_stereo.core.tracking.tracks import Track
from laci_stereo.core.world import World


@dataclass(frozen=True)
class Passage:
    """The data from which a calibration was estimated with one drive, and its result.

    Attributes
    ----------
    world : World
    axes : Axes
        Of the sensor.
    ground : GroundPlane
        As the sensor saw it in this drive.
    background : Background
    track : Track
        Of the sender's vehicle, in the level frame of this ground.
    vehicle : VehicleTrack
        In the world frame.
    station_id : int
    match : PlanarMatch
        Transform from the level to the world frame by this drive alone.
    time_offset_s : float
        To be added to the sensor's stamps to get the CAMs' time.
    method : {"joint", "paper"}
        Method by which match and clock offset were estimated.
    clock_sigma_s : float
        Prior standard deviation of the clock offset.
    apart_sigma_s : float
        Prior standard deviation of the time between left and right images, see `JointSettings`.
    turn : float
        Rotation of its scanner, see `JointFit`.
    name : str
        Name in messages to the user.
    body : VehicleTrack or None
        The track of the vehicle's body by the estimate; None where it was not estimated.
    objections : tuple of str
        Objections to its recording, or to the choice of its vehicle, that another estimate cannot find again.
    by_chance : str
        Objection: why the track may be a stranger's; empty where that is out of the question. Another drive that
        agrees refutes it.
    """

    world: World
    axes: Axes
    ground: GroundPlane
    background: Background
    track: Track
    vehicle: VehicleTrack
    station_id: int
    match: PlanarMatch
    time_offset_s: float
    method: Method
    clock_sigma_s: float
    apart_sigma_s: float = JointSettings.apart_sigma_s
    turn: float = 0.0
    name: str = ""
    body: VehicleTrack | None = None
    objections: tuple[str, ...] = ()
    by_chance: str = ""

    @property
    def span_ns(self) -> tuple[int, int]:
        """Unix times of the first and the last sighting, nanoseconds."""
        first, last = (self.track.sightings[i].stamp_s for i in (0, -1))
        return self.vehicle.epoch_ns + round(1e9 * first), self.vehicle.epoch_ns + round(1e9 * last)

    def is_also(self, other: Passage) -> bool:
        """Tell whether another passage has the same sender at the same time: it is this drive, or a part of it."""
        (first_ns, last_ns), (begin_ns, end_ns) = self.span_ns, other.span_ns
        return self.station_id == other.station_id and begin_ns <= last_ns and first_ns <= end_ns


def utc(unix_ns: int) -> str:
    """Return a Unix time, nanoseconds, as a date and a time of day in UTC, to the second."""
    return str(np.datetime_as_string(np.datetime64(unix_ns, "ns"), unit="s")).replace("T", " ")
