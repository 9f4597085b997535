"""A sensor whose left and right are exchanged is told by a turn."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest

from laci_stereo.core.association.case import Case
from laci_stereo.core.association.handedness import mirrored
from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.errors import MatchError
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.tracking.reframing import mirrored_track
from laci_stereo.core.tracking.tracks import Track
from tests.core.tracks import seen, sighting, vehicle
from tests.simulated import LEFT_TURN, STRAIGHT, Drive, Recording, lidar, scene

IN_WORDS = r"messages of station \d+ (by odds of \d+ to 1 )?with left and right exchanged: .* is left-handed; needed is"


@dataclass(frozen=True)
class LeftHanded(Recording):
    """A recording whose y axis points to the right."""

    def frame(self, index: int) -> PointCloud:
        cloud = super().frame(index)
        return replace(cloud, points=cloud.points * [1.0, -1.0, 1.0])


def left_handed(recording: Recording) -> LeftHanded:
    return LeftHanded(recording.sensor, recording.T_world_sensor, recording.static, recording.movers, recording.times_s)


BEND = Drive((24.0, 18.0), -100.0, ((10.0, 0.0), (20.0, 20.0)), ((0.0, 7.0),))
"""It turns by so little that a right bend fits it, but not as well."""


@pytest.mark.slow
@pytest.mark.parametrize("drive", [LEFT_TURN, BEND], ids=["left turn", "bend"])
def test_a_left_handed_frame_is_refused(drive: Drive) -> None:
    made = scene(drive, lidar())
    with pytest.raises(MatchError, match=IN_WORDS):
        calibrate(left_handed(made.recording), made.messages)


@pytest.mark.slow
def test_one_vehicle_on_a_straight_road_does_not_tell() -> None:
    made = scene(STRAIGHT, lidar())
    assert calibrate(left_handed(made.recording), made.messages).quality.verdict == "pass"


def test_what_a_matcher_saw_is_never_mirrored() -> None:
    by_laser = mirrored_track(seen())
    by_images = Track(tuple(replace(one, window_rad=0.01) for one in by_laser.sightings))
    case = Case([by_laser], {42: vehicle()}, MatchSettings())
    told = mirrored(case, None)
    assert told is not None
    assert re.search(IN_WORDS, told.words)
    assert mirrored(replace(case, tracks=[by_images]), None) is None


def test_a_mirrored_track() -> None:
    seen = replace(
        sighting(0.0, np.array([20.0, 5.0]), yaw_rad=0.3), borders=np.array([[19.0, 4.0, 1.0], [21.0, 6.0, 1.0]])
    )
    seen = replace(seen, begin_rad=2.5)
    other = mirrored_track(Track((seen,))).sightings[0]
    np.testing.assert_allclose(other.box.centre, [20.0, -5.0])
    np.testing.assert_allclose(
        sorted(other.box.corners().tolist()), sorted((seen.box.corners() * [1.0, -1.0]).tolist())
    )
    np.testing.assert_allclose(other.points, seen.points * [1.0, -1.0, 1.0])
    np.testing.assert_allclose(other.borders, [[21.0, -6.0, 1.0], [19.0, -4.0, 1.0]])
    assert other.begin_rad == -2.5
