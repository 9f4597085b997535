from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.association.pieces import LARGEST_GAP_M
from laci_stereo.core.association.riders import ridden_frames
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.frames import FORWARD_LEFT_UP_AXES, FloatArray, rotate_xy
from laci_stereo.core.ground.plane import GroundPlane
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.tracking.background import Background
from laci_stereo.core.tracking.tracks import Track
from laci_stereo.core.world import World
from tests.core.tracks import body_sighting

SENSOR = PlanarMatch(0.7, np.array([3.0, -2.0]))
LENGTH_M, WIDTH_M = 12.0, 2.5
FRAMES_S = 0.1 * np.arange(60)

ON = 10.0 * FRAMES_S
"""Where the vehicle's middle is: it drives on at 36 km/h, ..."""
FORTH_AND_BACK = 4.0 * np.cos(FRAMES_S)
"""...it shunts, ..."""
UP_ONE_PLACE = np.interp(FRAMES_S, [2.0, 4.0], [0.0, 7.0])
"""...or it moves up in a queue, and waits again."""


def body(first_m: float, last_m: float, aside_m: float = 0.0) -> FloatArray:
    along = np.arange(first_m, last_m + 0.01, 0.1)
    side = aside_m + np.where(np.arange(len(along)) % 2, 1.0, -1.0)
    return np.column_stack([along, side, np.ones(len(along))])


def seen(points: FloatArray, way_m: FloatArray) -> Track:
    """Return what is seen of a body that is so far along a way, in the sensor's level frame."""
    sightings = []
    for stamp_s, x in zip(FRAMES_S.tolist(), way_m.tolist(), strict=True):
        at = points + np.array([x, 0.0, 0.0])
        at[:, :2] = rotate_xy(-SENSOR.yaw_rad, at[:, :2] - SENSOR.shift)
        sightings.append(body_sighting(stamp_s, at))
    return Track(tuple(sightings))


def drive(way_m: FloatArray, late_s: float = 0.0, own: Track | None = None) -> Passage:
    """Return the drive of a vehicle that is seen in the first half of a second only, and sends by a late clock."""
    xy = np.column_stack([way_m, np.zeros(len(way_m))])
    sender = VehicleTrack(FRAMES_S + late_s, 0, xy, np.zeros(len(xy)), LENGTH_M, WIDTH_M)
    track = seen(body(-6.0, 6.0), way_m) if own is None else own
    ground = GroundPlane(np.array([0.0, 0.0, 1.0]), 5.0, np.eye(4), 0.9, 400, 0.9, 400.0, 0.01)
    return Passage(
        world=World.around(48.4, 10.0),
        axes=FORWARD_LEFT_UP_AXES,
        ground=ground,
        background=Background((), 10, 0.3),
        track=track.where(FRAMES_S < 0.5),
        vehicle=sender,
        station_id=42,
        match=SENSOR,
        time_offset_s=late_s,
        method="joint",
        clock_sigma_s=0.01,
    )


@pytest.mark.parametrize("late_s", [0.0, 0.3])
@pytest.mark.parametrize("way_m", [ON, FORTH_AND_BACK], ids=["on", "forth and back"])
@pytest.mark.parametrize("place", [body(7.0, 9.0), body(-9.0, -7.5), body(7.5, 14.0)], ids=["cab", "rear", "long"])
def test_what_rides_along_is_told_while_the_vehicle_is_not_seen(
    place: FloatArray, way_m: FloatArray, late_s: float
) -> None:
    other = seen(place, way_m).where((FRAMES_S > 0.75) & (FRAMES_S < 5.75))
    (frames,) = ridden_frames([drive(way_m, late_s)], [other], SENSOR)
    assert len(other.sightings) * 0.8 < frames <= len(other.sightings)


def test_pieces_of_what_rides_along_are_told_together_and_each_frame_once() -> None:
    pieces = [seen(body(first, first + 1.0), ON) for first in (7.0, 7.2)]
    late = [each.where((begin < FRAMES_S) & (begin + 1.2 > FRAMES_S)) for each in pieces for begin in (0.75, 3.0)]
    assert all(ridden_frames([drive(ON)], [each], SENSOR) == (0,) for each in late)  # none for long enough by itself
    (frames,) = ridden_frames([drive(ON)], late, SENSOR)
    assert frames == len({one.frame_s for each in late for one in each.sightings}) - 2


@pytest.mark.parametrize(
    ("way_m", "other"),
    [
        (ON, seen(body(6.0 + LARGEST_GAP_M + 0.4, 10.5), ON)),
        (ON, seen(body(7.0, 9.0, 3.0), ON)),
        (ON, seen(body(7.0, 9.0), 0.9 * ON)),
        (ON, seen(body(7.0, 9.0), ON).where(FRAMES_S < 0.85)),
        (ON, seen(body(-3.0, 5.0), ON)),
        (UP_ONE_PLACE, seen(body(7.5, 12.0), UP_ONE_PLACE)),
        (np.zeros(60), seen(body(7.0, 9.0), np.zeros(60))),
        (FORTH_AND_BACK, seen(body(7.0, 9.0), np.zeros(60))),
    ],
    ids=["too far ahead", "beside it", "slower", "too short", "on its place", "in a queue", "standing", "a wall"],
)
def test_what_may_be_another_vehicle_does_not_ride_along(way_m: FloatArray, other: Track) -> None:
    assert ridden_frames([drive(way_m)], [other], SENSOR) == (0,)


def test_another_sender_s_vehicle_is_none_that_rides_along() -> None:
    ahead = seen(body(7.0, 19.0), ON)
    own = drive(ON)
    its = drive(ON + 13.0, own=ahead)
    assert ridden_frames([own], [own.track, ahead], SENSOR)[0] > 50
    assert ridden_frames([own, replace(its, station_id=43)], [own.track, ahead], SENSOR) == (0, 0)


def test_what_is_not_known_of_the_vehicle_or_not_seen_tells_nothing() -> None:
    empty = Track(())
    assert ridden_frames([drive(ON)], [empty, seen(body(7.0, 9.0), ON).where(FRAMES_S < 0.05)], SENSOR) == (0,)
    gone = drive(ON)
    gone = replace(gone, vehicle=replace(gone.vehicle, stamps_s=gone.vehicle.stamps_s + 100.0))
    assert ridden_frames([gone], [seen(body(7.0, 9.0), ON)], SENSOR) == (0,)
