"""The calibration from end to end: point clouds and messages in, a transform out."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace

from laci_stereo.core.association.choice import Choice, Other
from laci_stereo.core.association.pieces import whole
from laci_stereo.core.association.vehicle_choice import ByOtherClocks, choose_vehicle
from laci_stereo.core.cloud import PointCloudSource
from laci_stereo.core.common_ground import along_ground
from laci_stereo.core.conclusion import conclude
from laci_stereo.core.errors import MatchError
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.messages.cam import FRONT, CamLog, ReferencePoint, VehicleTrack
from laci_stereo.core.messages.stations import senders_of
from laci_stereo.core.observe import Observation, observe, on_the_road
from laci_stereo.core.placement.by_paper import place_by_paper
from laci_stereo.core.placement.objections import objected
from laci_stereo.core.placement.senders import place_jointly
from laci_stereo.core.result import Calibration
from laci_stereo.core.settings import Settings
from laci_stereo.core.threads import in_one_thread
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
        The recording. It is read twice: a survey of whole frames, then every frame once. Both are repeated where the
        sender's path shows that the ground found first is not the road.
    messages : CamLog
        Messages of one station or several: all that are certainly seen are used.
    settings : Settings
    reference : ReferencePoint
        Point of the vehicle that the messages' positions refer to.
    crs : str
        The UTM zone; None takes that of the messages.

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
    senders = senders_of(messages, source.span_ns, reference, crs, settings.match.clock_sigma_s)
    seen = on_the_road(observe(source, settings, None, senders.vehicles), source, senders.vehicles, settings)
    return locate(seen, senders.vehicles, senders.world, settings, senders.by_other_clocks)


@in_one_thread
def locate(
    seen: Observation,
    vehicles: Mapping[int, VehicleTrack],
    world: World,
    settings: Settings | None = None,
    by_other_clocks: ByOtherClocks = dict,
) -> Calibration:
    """Find the transform from what a sensor saw and the tracks of the senders' vehicles.

    Parameters
    ----------
    seen : Observation
    vehicles : mapping of int to VehicleTrack
        By station; their epoch is the observation's.
    world : World
    settings : Settings
    by_other_clocks : callable
        See `choose_vehicle`.

    Raises
    ------
    CalibrationError
        If they do not determine a transform.
    """
    settings = settings or Settings()
    tracks = whole(seen.tracks, vehicles.values(), settings)
    try:
        choice = choose_vehicle(tracks, vehicles, seen.ground.height_m, settings, by_other_clocks)
    except MatchError as error:
        raise MatchError(f"{error}{_assumed(vehicles)}", error.nearer_per_m) from error
    log.info("station %d: %.1f frames explained, next best %.1f", choice.station, choice.explained, choice.second)
    log.info("next best: %s, by log odds of %.1f less", choice.second_is, choice.log_likelihood_margin)
    for remark in vehicles[choice.station].remarks:
        log.warning("%s", remark)
    own, *others = along_ground(_passages(choice, seen, vehicles, world, settings))
    if settings.method == "paper":
        placement = place_by_paper(own.track, own.vehicle, settings.match)
        passages: tuple[Passage, ...] = (replace(own, time_offset_s=placement.fit.time_offsets_s[0]),)
    else:
        placement, passages = place_jointly(own, others, choice, settings)
    kept, objections = objected(passages, own, choice, tracks, placement.fit.match)
    placement = replace(placement, contradictions=(*placement.contradictions, *objections))
    return conclude(kept, placement, settings)


def _assumed(vehicles: Mapping[int, VehicleTrack]) -> str:
    """Return what was assumed of the first vehicle without a reported length: that may be why nothing fits."""
    assumed = (
        f"; station {station}: {remark}"
        for station, vehicle in sorted(vehicles.items())
        if vehicle.guessed_m[0]
        for remark in vehicle.remarks
    )
    return next(assumed, "")


def _passages(
    choice: Choice, seen: Observation, vehicles: Mapping[int, VehicleTrack], world: World, settings: Settings
) -> list[Passage]:
    """Return the drives of all senders that are seen, located by boxes; the drive of the chosen one first."""
    return [
        Passage(
            world=world,
            axes=seen.axes,
            ground=seen.ground,
            background=seen.background,
            track=each.track,
            vehicle=vehicles[each.station],
            station_id=each.station,
            match=choice.fit,
            time_offset_s=choice.time_offset_s + each.late_s,
            method="paper",
            clock_sigma_s=settings.joint.clock_sigma_s,
            apart_sigma_s=settings.joint.apart_sigma_s,
            name=f"station {each.station}",
        )
        for each in (Other(choice.station, choice.track), *choice.others)
    ]
