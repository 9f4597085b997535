"""The calibration from end to end: point clouds and messages in, a transform out."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from laci_stereo.core.background import learn_background
from laci_stereo.core.cam import FRONT, CamLog, ReferencePoint, VehicleTrack, vehicle_track
from laci_stereo.core.cloud import PointCloud, PointCloudSource
from laci_stereo.core.errors import CamError, GroundError, TrackError
from laci_stereo.core.frames import Axes, planar, transform
from laci_stereo.core.ground import GroundPlane, fit_ground
from laci_stereo.core.matching import choose_track, match_track
from laci_stereo.core.quality import covariance_of, doubt_of, judge
from laci_stereo.core.result import Calibration
from laci_stereo.core.settings import Settings
from laci_stereo.core.sighting import find_vehicles
from laci_stereo.core.tracking import link_tracks
from laci_stereo.core.world import World

log = logging.getLogger(__name__)

GROUND_POINTS = 300_000
"""So many points of the survey fix the ground: the plane's error comes from the road by then, not from their noise."""


def calibrate(
    source: PointCloudSource,
    messages: CamLog,
    settings: Settings | None = None,
    *,
    reference: ReferencePoint = FRONT,
    crs: str | None = None,
) -> Calibration:
    """Find the transform from a sensor into the world, by the paper's method.

    Parameters
    ----------
    source : PointCloudSource
        The recording. It is read twice: a survey of whole frames, then every frame once.
    messages : CamLog
        Of one station or several; the one whose track fits is taken.
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
    messages = messages.between(*source.span_ns)
    world = world_around(messages, crs)
    vehicles = _vehicles(messages, world, epoch_ns, reference)

    survey = list(source.survey())
    ground = _ground(survey, source.axes, settings)
    T_level_sensor = ground.T_level_sensor(source.axes)
    background = learn_background(
        [transform(T_level_sensor, cloud.points) for cloud in survey],
        settings.background,
        settings.cluster,
        settings.box,
    )
    del survey  # whole clouds are large
    log.info("background: %d boxes from %d quiet frames", len(background.boxes), background.quiet_frames)

    sightings = (
        find_vehicles(cloud, (cloud.stamp_ns - epoch_ns) / 1e9, T_level_sensor, background, settings)
        for cloud in source
    )
    tracks = link_tracks(sightings, settings.track)

    choice = choose_track(tracks, vehicles, settings.match)
    log.info("station %d: %.1f frames explained, next best %.1f", choice.station, choice.explained, choice.second)
    vehicle = vehicles[choice.station]
    xy_world, _, known = vehicle.at(choice.track.stamps_s)
    xy_level, xy_world = choice.track.centres[known], xy_world[known]
    match = match_track(xy_level, xy_world, settings.match)

    ground_covariance = ground.covariance_level(source.axes)
    doubt = doubt_of(match, choice.track, vehicle, settings.match)
    residual_rms_m = float(np.sqrt(((match(xy_level) - xy_world) ** 2).sum(axis=1).mean()))
    return Calibration(
        world=world,
        T_world_sensor=planar(match.yaw_rad, match.shift) @ T_level_sensor,
        T_level_sensor=T_level_sensor,
        covariance=covariance_of(doubt, ground_covariance, match, xy_level.mean(axis=0)),
        centre_world=np.append(match(xy_level.mean(axis=0)), 0.0),
        time_offset_s=0.0,
        station_id=choice.station,
        ground=ground,
        background=background,
        track=choice.track,
        vehicle=vehicle,
        match=match,
        axes=source.axes,
        quality=judge(doubt, ground_covariance, residual_rms_m, choice.track, known, settings.quality),
        method="paper",
    )


def _ground(survey: Sequence[PointCloud], axes: Axes, settings: Settings) -> GroundPlane:
    if not survey:
        raise GroundError("the survey has 0 whole frames; needed is at least 1 to find the ground plane")
    step = max(1, -(-sum(map(len, survey)) // GROUND_POINTS))
    ground = fit_ground(
        np.concatenate([cloud.points[::step] for cloud in survey]),
        np.concatenate([cloud.sigma_along_m[::step] for cloud in survey]),
        np.concatenate([cloud.sigma_across_m[::step] for cloud in survey]),
        axes.up,
        settings.ground,
    )
    log.info("ground: %.3f m below the sensor", ground.height_m)
    return ground


def world_around(messages: CamLog, crs: str | None = None) -> World:
    """Lay the world around where the messages are.

    Raises
    ------
    CamError
        If none has a position.
    """
    located = messages[np.isfinite(messages.latitude_deg) & np.isfinite(messages.longitude_deg)]
    if len(located) == 0:
        raise CamError("0 CAMs with a position fall into the recording's time; needed is a drive that was recorded")
    middle = len(located) // 2
    return World.around(float(located.latitude_deg[middle]), float(located.longitude_deg[middle]), crs)


def _vehicles(messages: CamLog, world: World, epoch_ns: int, reference: ReferencePoint) -> dict[int, VehicleTrack]:
    """Lay the track of every station that has one into the world; the rest, such as roadside units, are no vehicles."""
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
