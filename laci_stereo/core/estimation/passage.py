"""One drive past a sensor, as it is kept for an estimate over several."""

from __future__ import annotations

from dataclasses import dataclass

from laci_stereo.core.frames import Axes
from laci_stereo.core.ground.plane import GroundPlane
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.settings import Method
from laci_stereo.core.tracking.background import Background
from laci_stereo.core.tracking.tracks import Track
from laci_stereo.core.world import World


@dataclass(frozen=True)
class Passage:
    """What a calibration from one drive was estimated from, and what came out.

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
        In the world.
    station_id : int
    match : PlanarMatch
        Where this drive alone puts the level frame in the world.
    time_offset_s : float
        To be added to the sensor's stamps to get the CAMs' time.
    method : {"joint", "paper"}
        By which match and clock offset were estimated.
    clock_sigma_s : float
        What was known of that beforehand, one standard deviation.
    turn : float
        How its scanner turned, see `JointFit`.
    name : str
        What messages call it.
    body : VehicleTrack or None
        Where the estimate has the vehicle's body; None where it was not estimated.
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
    turn: float = 0.0
    name: str = ""
    body: VehicleTrack | None = None

    @property
    def span_ns(self) -> tuple[int, int]:
        """Unix time of the first and the last sighting."""
        first, last = (self.track.sightings[i].stamp_s for i in (0, -1))
        return self.vehicle.epoch_ns + round(1e9 * first), self.vehicle.epoch_ns + round(1e9 * last)
