"""Observation of a scene without any message: ground, background and moving objects; then the road below the sender."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np
from scipy.spatial import cKDTree

from laci_stereo.core.association.choice import Choice
from laci_stereo.core.association.hypotheses import HALF_LANE_M, choose_track
from laci_stereo.core.association.pieces import whole
from laci_stereo.core.cloud import PointCloud, PointCloudSource, window_of
from laci_stereo.core.errors import CalibrationError, GroundError
from laci_stereo.core.frames import Axes, FloatArray, invert, rotate_xy, transform
from laci_stereo.core.ground.axes import ground_below
from laci_stereo.core.ground.plane import GroundPlane, check_support, fit_farther_ground, fit_ground_beside
from laci_stereo.core.ground.road import FARTHEST, road_ground, standing
from laci_stereo.core.ground.road_extent import places, prolonged
from laci_stereo.core.ground.road_surface import OTHER
from laci_stereo.core.ground.uneven import ONE_SURFACE_M
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.settings import Settings
from laci_stereo.core.subsampling import spread
from laci_stereo.core.threads import in_one_thread
from laci_stereo.core.tracking.background import BACKGROUND_FRAMES, Background, learn_background
from laci_stereo.core.tracking.box import Box
from laci_stereo.core.tracking.deskew import deskewed
from laci_stereo.core.tracking.land import learn_land
from laci_stereo.core.tracking.reframing import transformed_background, transformed_track, transformed_xy
from laci_stereo.core.tracking.sighting import Sighting, find_vehicles
from laci_stereo.core.tracking.tracks import GATE, Track, link_tracks
from laci_stereo.core.vehicle.outline import SIDES_HIGHEST_M

log = logging.getLogger(__name__)

LOOKS = 2
"""Largest number of times that the road is estimated."""

_BEYOND_S = np.arange(0.0, 20.0, 0.1)
"""Times after the last sighting, and before the first one, for which a vehicle's path is taken from its messages: at
walking speed these cover 20 m."""

SAME_M = 0.05
"""Largest difference in height along the path up to which the observation on the first ground is transformed to another
ground: at most an eighth of a wall's lower part is missing then. With a larger difference the recording is observed
again, which takes time."""

OTHER_M = FARTHEST * OTHER[0]
"""Largest height of a road above or below the terrain beside it."""

AROUND_S = 60.0
"""Points are kept of what is seen up to so long before the first message and after the last one, or in a gap between
them: no vehicle that is to be compared with the sender's, or may be a part of it, is in view for longer at a stretch.
In an hour of traffic, the points of all objects in view would take gigabytes."""

GROUND_POINTS = 100_000
"""Number of points of the survey that the ground is fitted to: with so many, the plane's error is due to the road and
not to their noise."""


@dataclass(frozen=True)
class Observation:
    """The scene as observed by a sensor.

    Attributes
    ----------
    axes : Axes
        Axes of the sensor.
    ground : GroundPlane
    background : Background
    tracks : tuple of Track
        All objects that may have moved, in the level frame, the one with most sightings first.
    survey : tuple of PointCloud
        The thinned clouds that the ground was fitted to.
    standing : tuple of PointCloud
        The same clouds without the points of moving objects.
    """

    axes: Axes
    ground: GroundPlane
    background: Background
    tracks: tuple[Track, ...]
    survey: tuple[PointCloud, ...] = ()
    standing: tuple[PointCloud, ...] = ()

    @cached_property
    def T_level_sensor(self) -> FloatArray:
        """The transform, shape (4, 4), from the sensor into the level frame."""
        return self.ground.T_level_sensor(self.axes)


@in_one_thread
def observe(
    source: PointCloudSource,
    settings: Settings | None = None,
    ground: GroundPlane | None = None,
    vehicles: Mapping[int, VehicleTrack] | None = None,
) -> Observation:
    """Find the ground, the background and the moving objects of a recording (paper sections III-A to III-C).

    Parameters
    ----------
    source : PointCloudSource
        The recording; it is read twice: a survey of whole frames, then every frame once.
    settings : Settings
    ground : GroundPlane
        The ground if it is known already.
    vehicles : mapping of int to VehicleTrack
        The senders' tracks by station. Of what is seen long before or after their messages (`AROUND_S`), only few
        points are kept; None keeps them throughout.

    Raises
    ------
    CalibrationError
        If no ground is found, or if the survey has no whole frames.
    """
    settings = settings or Settings()
    survey = list(source.survey())
    thinned = _thinned(survey)
    ground = ground or _ground(thinned, source.axes, settings)
    log.info("ground: %.3f m below the sensor", ground.height_m)
    T_level_sensor = ground.T_level_sensor(source.axes)
    whole_frames = [transform(T_level_sensor, cloud.points) for cloud in spread(survey, BACKGROUND_FRAMES)]
    background = learn_background(whole_frames, ground.height_m, settings.background, settings.cluster, settings.box)
    land = learn_land(whole_frames, settings)
    del survey, whole_frames  # whole clouds are large
    log.info("background: %d boxes from %d quiet frames", len(background.boxes), background.quiet_frames)

    moving: dict[int, list[Box]] = {cloud.stamp_ns: [] for cloud in thinned}

    def seen_in(cloud: PointCloud) -> list[Sighting]:
        frame_s = (cloud.stamp_ns - source.span_ns[0]) / 1e9
        return find_vehicles(cloud, frame_s, T_level_sensor, background, settings, land)

    near_messages = _near_messages(vehicles, settings)

    def sightings() -> Iterator[list[Sighting]]:
        for cloud in source:
            found = seen_in(cloud)
            if cloud.stamp_ns in moving:
                others = [] if cloud.others is None else seen_in(cloud.others)
                moving[cloud.stamp_ns] += [sighting.box for sighting in (*found, *others)]
            if found and not near_messages(found[0].frame_s):
                found = [sighting.thinned(settings.vehicle.min_points) for sighting in found]
            yield found

    linked = deque(link_tracks(sightings(), settings.track))
    tracks = tuple(deskewed(linked.popleft(), settings) for _ in range(len(linked)))  # each replaces the one before
    still = standing(thinned, T_level_sensor, moving)
    return Observation(source.axes, ground, background, tracks, tuple(thinned), still)


@in_one_thread
def on_the_road(
    seen: Observation, source: PointCloudSource, vehicles: Mapping[int, VehicleTrack], settings: Settings | None = None
) -> Observation:
    """Replace the ground by the road below the sender, and observe again if that is a different plane.

    On a wrong ground another vehicle, on other terrain, may be mistaken for the sender. If the sender is found
    elsewhere after the ground was replaced, this is done once more. If no track on the ground is clearly the sender's,
    it is searched on other grounds.

    Parameters
    ----------
    seen : Observation
    source : PointCloudSource
        The recording that ``seen`` was made from.
    vehicles : mapping of int to VehicleTrack
        The senders' tracks by station.
    settings : Settings

    Raises
    ------
    GroundError
        If too little of the view supports the ground, and no road that a sender drives on is seen.
    """
    settings = settings or Settings()
    seen, choice = _where_driven(seen, source, vehicles, settings)
    first, before = seen, None
    for _ in range(LOOKS):
        if before is not None:
            choice = _driven(seen, vehicles, settings)
        if choice is None:  # the caller reports why, unless it is the ground's support
            check_support(first.ground, settings.ground)
            break
        T_first_seen = first.T_level_sensor @ invert(seen.T_level_sensor)
        way, *beyond = (transformed_xy(T_first_seen, xy) for xy in (places(choice.track), *_sent(choice, vehicles)))
        if before is not None and _is_along(way, before):
            break
        ground = road_ground(seen.standing, first.axes, first.ground, prolonged(way, *beyond), settings.ground)
        log.info("ground: with what is seen of the road, %.3f m below the sensor", ground.height_m)
        T_road_first = ground.T_level_sensor(first.axes) @ invert(first.T_level_sensor)
        if np.abs(way @ T_road_first[2, :2] + T_road_first[2, 3]).max() < SAME_M:
            return _laid(first, ground, T_road_first)
        seen, before = observe(source, settings, ground, vehicles), way
    return seen


def _near_messages(vehicles: Mapping[int, VehicleTrack] | None, settings: Settings) -> Callable[[float], bool]:
    """Return whether any message was sent around a time, given in seconds since the recording's first stamp."""
    if vehicles is None:
        return lambda _: True
    sent_s = np.sort(np.concatenate([vehicle.stamps_s for vehicle in vehicles.values()]))
    reach_s = AROUND_S + GATE * settings.match.clock_sigma_s

    def near(time_s: float) -> bool:
        first, last = np.searchsorted(sent_s, [time_s - reach_s, time_s + reach_s])
        return bool(first < last)

    return near


def _laid(seen: Observation, ground: GroundPlane, T_ground_seen: FloatArray) -> Observation:
    """Return an observation transformed to the level frame of another ground."""
    tracks = tuple(transformed_track(T_ground_seen, track) for track in seen.tracks)
    return replace(
        seen, ground=ground, background=transformed_background(T_ground_seen, seen.background), tracks=tracks
    )


def _is_along(way: FloatArray, before: FloatArray) -> bool:
    """Return whether most of a path is within half a lane of another one."""
    return bool(np.median(cKDTree(before).query(way)[0]) < HALF_LANE_M)


def _where_driven(
    seen: Observation, source: PointCloudSource, vehicles: Mapping[int, VehicleTrack], settings: Settings
) -> tuple[Observation, Choice | None]:
    """Return the observation on the first ground on which a track is clearly a sender's, and that track.

    The track must also have points at the level of the ground. If there is no such ground, the first one is returned on
    which a track may be a sender's; if there is none either, ``seen`` and None.
    """
    possible: tuple[Observation, Choice] | None = None  # no other is kept: each has the points of all tracks
    for each in chain([seen], _on_other_grounds(seen, source, vehicles, settings)):
        choice = _driven(each, vehicles, settings, surely=True)
        if choice is not None and _stands(choice.track):
            return each, choice
        if possible is None and (choice := _driven(each, vehicles, settings)) is not None:
            possible = each, choice
    return possible or (seen, None)


def _stands(track: Track) -> bool:
    """Return whether any point of a track is as low as a car's sides; those on an embankment are above the terrain."""
    parts = [points for one in track.sightings for points in (one.points, one.low.points)]
    return any((points[:, 2] < SIDES_HIGHEST_M).any() for points in parts)


def _driven(
    seen: Observation, vehicles: Mapping[int, VehicleTrack], settings: Settings, *, surely: bool = False
) -> Choice | None:
    """Return the best match of a track and a sender, or None if there is none.

    Without ``surely`` the odds do not matter: a track that is not the sender's leads to the road as well.
    """
    match = settings.match if surely else settings.match.any_fit
    try:
        return choose_track(whole(seen.tracks, vehicles.values(), settings), vehicles, match)
    except CalibrationError:
        return None


def _sent(choice: Choice, vehicles: Mapping[int, VehicleTrack]) -> tuple[FloatArray, FloatArray]:
    """Return the reported path before the first sighting, backwards, and after the last one, shape (n, 2) each.

    Both are in the level frame and end where the position is no longer known.
    """
    found = []
    for sighting, way in ((choice.track.sightings[0], -1.0), (choice.track.sightings[-1], 1.0)):
        xy, _, known = vehicles[choice.station].at(sighting.stamp_s + choice.time_offset_s + way * _BEYOND_S)
        sent = xy[: len(known) if known.all() else max(1, int(known.argmin()))]
        found.append(rotate_xy(-choice.fit.yaw_rad, np.nan_to_num(sent) - choice.fit.shift))
    return found[0], found[1]


def _on_other_grounds(
    seen: Observation, source: PointCloudSource, vehicles: Mapping[int, VehicleTrack], settings: Settings
) -> Iterator[Observation]:
    """Yield observations on planes above the ground, below it, and farther away, as far as such planes are found."""
    points, axes, told = _gathered(seen.survey), seen.axes, (settings.ground, window_of(seen.survey))
    fits: list[Callable[[], GroundPlane]] = [
        lambda: fit_ground_beside(*points, seen.ground, (0.0, OTHER_M), *told),
        lambda: fit_ground_beside(*points, seen.ground, (-OTHER_M, 0.0), *told),
    ]
    if seen.ground.unevenness_m > ONE_SURFACE_M:
        fits.append(lambda: fit_farther_ground(*points, axes.up, *told))
    for fit in fits:
        try:
            other = observe(source, settings, fit(), vehicles)
        except CalibrationError:
            continue
        yield other


def _thinned(survey: Sequence[PointCloud]) -> list[PointCloud]:
    step = max(1, -(-sum(map(len, survey)) // GROUND_POINTS))
    return [cloud[np.arange(0, len(cloud), step)] for cloud in survey]


def _ground(survey: Sequence[PointCloud], axes: Axes, settings: Settings) -> GroundPlane:
    if not survey:
        raise GroundError("the survey has 0 whole frames; needed is at least 1 to find the ground plane")
    return ground_below(*_gathered(survey), axes, settings.ground, window_of(survey))


def _gathered(survey: Sequence[PointCloud]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the points of all clouds, and their standard deviations along and across the line of sight."""
    return (
        np.concatenate([cloud.points for cloud in survey]),
        np.concatenate([cloud.sigma_along_m for cloud in survey]),
        np.concatenate([cloud.sigma_across_m for cloud in survey]),
    )
