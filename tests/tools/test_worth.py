from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("embreex")

from tools.scenes.drives import Drive
from tools.scenes.scene import draw_scene
from tools.scenes.worth import is_good, sides_seen, speed_change, turned_deg

SCENE = draw_scene(1, "lidar_16", min_seen=0, min_driven_m=0.0, frames=60, vehicles=0, density=0.0)


def driven(drive, seen=60, sensor=(0.0, -20.0)):
    """The scene with another drive of a car, in view in the first frames of sixty, six seconds."""
    T_world_sensor = SCENE.T_world_sensor.copy()
    T_world_sensor[:2, 3] = sensor
    sender = replace(SCENE.sender, drive=drive, length_m=4.5, width_m=1.8, rear_axle_m=0.0)
    in_view = np.arange(60) < seen
    return replace(SCENE, sender=sender, T_world_sensor=T_world_sensor, in_view=in_view)


STRAIGHT = Drive((-20.0, 0.0), 0.0, speeds=((0.0, 8.0),), pivot=(0.0, 0.0))
TURN = replace(STRAIGHT, legs=((15.0, 0.0), (12.0, np.radians(50.0))))
BRAKING = replace(STRAIGHT, speeds=((0.0, 8.0), (6.0, 4.0)), ease_s=0.1)


def test_angle_and_speed_are_those_of_the_drive_in_view():
    assert turned_deg(driven(STRAIGHT)) == pytest.approx(0.0, abs=1e-6)
    assert speed_change(driven(STRAIGHT)) == pytest.approx(0.0, abs=1e-3)
    assert turned_deg(driven(TURN)) == pytest.approx(50.0, abs=0.5)
    # From 8 m/s, by 4 m/s in 6 s.
    assert speed_change(driven(BRAKING)) == pytest.approx(0.5, abs=0.02)
    assert speed_change(driven(BRAKING, seen=30)) == pytest.approx(0.25, abs=0.02)


def test_turning_where_it_is_not_in_view_does_not_count():
    # The bend begins after 15 m, just under two seconds.
    assert turned_deg(driven(TURN, seen=14)) == pytest.approx(0.0, abs=0.5)


def test_sides_are_those_that_face_the_sensor():
    # Past a sensor beside the road: front, right, rear; towards one on its own line: the front alone.
    assert sides_seen(driven(STRAIGHT)) == 3
    assert sides_seen(driven(STRAIGHT, sensor=(60.0, 0.0))) == 1
    # Half a car's width beside the line the side stays oblique.
    assert sides_seen(driven(STRAIGHT, sensor=(60.0, -2.0))) == 1
    assert sides_seen(driven(STRAIGHT, seen=0)) == 0


@pytest.mark.parametrize(
    ("drive", "seen", "sensor", "good"),
    [
        (TURN, 60, (0.0, -20.0), True),
        (BRAKING, 60, (0.0, -20.0), True),
        (STRAIGHT, 60, (0.0, -20.0), False),
        (TURN, 39, (0.0, -20.0), False),
        (BRAKING, 60, (60.0, 0.0), False),
    ],
)
def test_a_good_drive_is_long_seen_from_two_sides_and_turns_or_brakes(drive, seen, sensor, good):
    assert is_good(driven(drive, seen, sensor)) is good
