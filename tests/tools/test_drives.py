from typing import get_args

import numpy as np
import pytest

pytest.importorskip("embreex")

from laci_stereo.core.frames import wrap
from tools.scenes.drives import DRIVES, Drive, DriveKind, Towed
from tools.scenes.scene import SceneError, draw_scene
from tools.scenes.traffic import collide, lanes_of, place_drive, possible, vehicle_mover
from tools.scenes.vehicles import draw_vehicle
from tools.scenes.world import LAYOUTS, draw_road

TIMES = np.arange(0.0, 12.0, 0.01)


def drawn(kind, seed=0, speed=None):
    rng = np.random.default_rng(seed)
    layout = next(layout for layout in LAYOUTS if possible(layout, kind))
    road = draw_road(rng, layout)
    vehicle = draw_vehicle(rng, "saloon")
    return road, vehicle, place_drive(rng, kind, road, vehicle, speed, 6.0, left_hand=False)


@pytest.mark.parametrize("kind", get_args(DriveKind))
@pytest.mark.parametrize("seed", range(3))
def test_speed_is_the_rate_of_position_and_the_rear_axle_does_not_slip(kind, seed):
    drive = drawn(kind, seed)[2]
    xy, yaw = drive.at(TIMES)
    velocity = np.gradient(xy, TIMES, axis=0)[1:-1]
    expected = drive.speed(TIMES)[1:-1, None] * np.column_stack([np.cos(yaw), np.sin(yaw)])[1:-1]
    np.testing.assert_allclose(velocity, expected, atol=0.03)


@pytest.mark.parametrize("kind", get_args(DriveKind))
@pytest.mark.parametrize("seed", range(3))
def test_acceleration_and_jerk_are_a_drivers(kind, seed):
    speed = drawn(kind, seed)[2].speed(TIMES)
    acceleration = np.gradient(speed, TIMES)
    assert np.abs(acceleration).max() < 3.2
    jerk = np.gradient(acceleration[::10], TIMES[::10])
    # A change of at most 3 + 2.5 m/s^2 within the 0.6 s over which it is eased.
    assert np.abs(jerk).max() < 5.5 / 0.6


@pytest.mark.parametrize(("kind", "turn_deg"), [("left_turn", 90.0), ("right_turn", -90.0), ("straight", 0.0)])
def test_turns_turn_and_end_in_their_lane(kind, turn_deg):
    road, _, drive = drawn(kind, speed=6.0)
    yaw = drive.at(np.array([-10.0, 25.0]))[1]
    # What remains is the wander: 0.2 m over 40 m is up to 1.8 deg at either end.
    assert np.degrees(yaw[1] - yaw[0]) == pytest.approx(turn_deg, abs=3.6)
    # The wander again: it swings about the path by 0.2 m at most.
    for time_s in (-10.0, 25.0):
        xy = drive.at(np.array([time_s]))[0][0]
        assert np.abs(xy).min() == pytest.approx(lanes_of(road).offset_m, abs=0.5)


def test_reversing_goes_backwards():
    drive = drawn("reverse", speed=6.0)[2]
    assert drive.speed(TIMES).min() < -1.0
    xy, yaw = drive.at(TIMES)
    back = np.flatnonzero(drive.speed(TIMES) < -1.0)[:-1]
    step = (xy[back + 1] - xy[back]) @ np.array([np.cos(yaw[back[0]]), np.sin(yaw[back[0]])])
    assert (step < 0.0).all()


@pytest.mark.parametrize("left_hand", [False, True])
def test_who_reverses_in_a_turn_backs_along_its_bend_and_then_leaves_to_its_far_side(left_hand):
    rng = np.random.default_rng(0)
    road = draw_road(rng, "cross")
    drive = place_drive(rng, "reverse_in_turn", road, draw_vehicle(rng, "saloon"), 6.0, 6.0, left_hand)
    speed, curvature = drive.speed(TIMES), drive.curvature(TIMES)
    assert np.degrees(np.ptp(drive.at(TIMES)[1][speed < 0.0])) > 15.0
    assert (np.sign(curvature[np.abs(curvature) > 0.05]) == (-1.0 if left_hand else 1.0)).all()
    assert np.degrees(np.abs(np.diff(drive.at(np.array([-10.0, 25.0]))[1]))) == pytest.approx(90.0, abs=3.6)


def test_a_drive_that_reverses_in_a_turn_is_only_drawn_when_asked_for():
    assert "reverse_in_turn" not in DRIVES
    assert draw_scene(810000, "lidar_32", drive="reverse_in_turn").drive_kind == "reverse_in_turn"
    with pytest.raises(SceneError, match="a drive 'sideways'"):
        draw_scene(3, "lidar_8", drive="sideways")


def test_the_front_moves_in_another_direction_than_the_body_points_in_a_bend():
    """Bicycle model: at a distance a before the rear axle, tan(angle) = a * curvature."""
    drive = Drive((0.0, 0.0), 0.2, ((60.0, np.pi),), speeds=((0.0, 5.0),), pivot=(0.0, 20.0))
    times = np.array([-0.001, 0.001])
    xy, yaw = drive.at(times)
    front = xy + 3.5 * np.column_stack([np.cos(yaw), np.sin(yaw)])
    course = np.arctan2(*(front[1] - front[0])[::-1])
    assert float(wrap(course - yaw.mean())) == pytest.approx(np.arctan(3.5 * np.pi / 60.0), abs=1e-3)


@pytest.mark.parametrize("drive_kind", ["straight", "left_turn", "roundabout", "reverse"])
@pytest.mark.parametrize("kind", ["trailer", "caravan"])
def test_a_trailer_hangs_on_its_hitch_and_its_wheels_do_not_slip(kind, drive_kind):
    road, _, drive = drawn(drive_kind, 3)
    vehicle = draw_vehicle(np.random.default_rng(1), kind)
    mover = vehicle_mover("sender", vehicle, drive, road)
    trailer = vehicle.trailer
    axle = []
    for time_s in TIMES[::20]:
        own, towed = mover.pose(time_s), mover.trailer_pose(time_s)
        hitch = [(own @ [trailer.hitch_m, 0.0, 0.0, 1.0]), towed @ [trailer.axle_m + trailer.drawbar_m, 0.0, 0.0, 1.0]]
        # Each stands on the road by itself, which is not flat.
        np.testing.assert_allclose(hitch[0][:3], hitch[1][:3], atol=0.06)
        axle.append([*(towed @ [trailer.axle_m, 0.0, 0.0, 1.0])[:2], np.arctan2(towed[1, 0], towed[0, 0])])
    x, y, yaw = np.array(axle).T
    # The chord of an arc is along the direction halfway.
    half = yaw[:-1] + np.diff(np.unwrap(yaw)) / 2
    np.testing.assert_allclose(np.diff(y) * np.cos(half) - np.diff(x) * np.sin(half), 0.0, atol=0.02)


def test_on_a_circle_a_trailer_folds_by_what_its_drawbar_makes():
    """Hitch and axle are on circles about one point: sin(angle) = drawbar / radius, for a hitch on the axle."""
    drive = Drive((0.0, 0.0), 0.0, ((300.0, 300.0 / 20.0),), speeds=((0.0, 6.0),))
    _, yaw = Towed(drive, 0.0, 8.0).at(np.array([30.0]))
    assert drive.at(np.array([30.0]))[1] - yaw == pytest.approx(np.arcsin(8.0 / 20.0), abs=0.01)


def test_placing_and_mirroring_move_the_whole_path():
    drive = Drive((3.0, -2.0), 0.1, ((10.0, 1.0),), speeds=((0.0, 4.0),))
    xy, yaw = drive.at(TIMES)
    turned, turned_yaw = drive.placed(np.pi / 2).at(TIMES)
    np.testing.assert_allclose(turned, xy @ np.array([[0.0, 1.0], [-1.0, 0.0]]), atol=1e-9)
    np.testing.assert_allclose(turned_yaw, yaw + np.pi / 2)
    np.testing.assert_allclose(drive.mirrored().at(TIMES)[0], xy * [1.0, -1.0], atol=1e-9)


def test_two_in_one_place_collide_and_two_in_a_row_do_not():
    road, vehicle, drive = drawn("straight", speed=8.0)
    one = vehicle_mover("one", vehicle, drive, road)
    ahead = vehicle_mover("ahead", vehicle, drive.placed(0.0, (7.0, 0.0)), road)
    crossing = vehicle_mover("crossing", vehicle, drive.placed(np.pi / 2), road)
    times = np.arange(0.0, 12.0, 0.1)
    along_x = abs(np.cos(one.track(times)[1][0])) > 0.5
    assert collide(one, one, times)
    assert collide(one, ahead, times) != along_x
    assert collide(one, crossing, times)


def test_wheels_stand_on_the_road():
    road, vehicle, drive = drawn("left_turn", 1)
    mover = vehicle_mover("sender", vehicle, drive, road)
    for time_s in (3.0, 6.0, 9.0):
        T = mover.pose(time_s)
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
        xy = mover.track(np.array([time_s]))[0][0]
        np.testing.assert_allclose(T[:2, 3], xy, atol=0.01)
        for x in (vehicle.rear_axle_m, vehicle.rear_axle_m + vehicle.wheelbase_m):
            contact = T @ [x, 0.0, 0.0, 1.0]
            # Four points on a curved surface: the mean of two wheels is off by the crown at most.
            assert contact[2] == pytest.approx(float(road.height(contact[None, :2])[0]), abs=0.03)
