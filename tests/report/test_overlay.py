from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.frames import Raster
from laci_stereo.core.tracking.tracks import Track
from laci_stereo.report.overlay import draw_overlay, overlay_stamps
from laci_stereo.report.style import SKY_BLUE, VERMILLION, YELLOW, Colour
from tests.report.support import BESIDE_M, calibration, drive, lane, lane_map, lens, pixel, with_another, with_drive

MAP = lane_map(lane((-20.0, 24.0), (20.0, 24.0)), lane((8.0, 15.0), (8.0, 60.0), subtype="dashed"))


def grey(width: int = 1280, height: int = 720) -> Raster:
    return np.full((height, width, 3), 110, dtype=np.uint8)


def has(image: Raster, colour: Colour) -> bool:
    return bool((image == colour).all(axis=2).any())


def test_the_image_stays_as_it_is() -> None:
    image = grey()
    drawn = draw_overlay(image, lens(), calibration(), 1.5, MAP)
    assert (image == 110).all()
    assert drawn.shape == image.shape
    assert drawn.dtype == np.uint8


@pytest.mark.parametrize("size", [(1280, 720), (640, 480), (1920, 1080)])
def test_the_map_is_where_the_pinhole_formula_puts_it(size: tuple[int, int]) -> None:
    drawn = draw_overlay(grey(*size), lens(*size), calibration(), 1.5, MAP)
    for x in (-3.0, 5.5, 11.5):
        u, v = pixel((x, 24.0, 0.0), lens(*size))
        np.testing.assert_allclose(drawn[v, u].astype(int), YELLOW, atol=60)
        assert np.abs(drawn[v + 20, u].astype(int) - YELLOW).max() > 60


def test_the_sensors_track_is_where_the_pinhole_formula_puts_it() -> None:
    stamps_s = np.array([1.3, 2.0, 3.6])
    drawn = draw_overlay(grey(), lens(), calibration(), 4.0, None)
    for x, y in drive(stamps_s)[0]:
        u, v = pixel((x, y, 0.0), lens())
        assert drawn[v, u].tolist() == list(SKY_BLUE)


def test_the_box_stands_on_the_ground_around_the_vehicle() -> None:
    drawn = draw_overlay(grey(), lens(), calibration(), 1.5, None)
    (x, y), *_ = drive(np.array([1.5]))[0]
    # The edge over the rear right corner, what is left of it, and what is above its upper end.
    u, v = pixel((x - 2.25, y - 0.9, 0.7), lens())
    assert has(drawn[v : v + 1, u - 1 : u + 2], SKY_BLUE)
    assert not has(drawn[v : v + 1, u - 20 : u - 3], SKY_BLUE)
    u, v = pixel((x - 2.25, y - 0.9, 1.6), lens())
    assert not has(drawn[v : v + 1, u - 4 : u + 5], SKY_BLUE)


def test_both_boxes_show_where_they_agree() -> None:
    drawn = draw_overlay(grey(), lens(), calibration(), 1.5, None)
    (x, y), *_ = drive(np.array([1.5]))[0]
    u, v = pixel((x - 2.25, y - 0.9, 0.7), lens())
    assert has(drawn[v : v + 1, u - 4 : u + 5], SKY_BLUE)
    assert has(drawn[v : v + 1, u - 4 : u + 5], VERMILLION)


def test_every_vehicle_has_its_tracks_and_boxes() -> None:
    both = with_another(calibration())
    drawn = draw_overlay(grey(), lens(), both, 4.0, None)
    for x, y in drive(np.array([1.3, 2.0]))[0] + BESIDE_M:
        u, v = pixel((x, y, 0.0), lens())
        assert drawn[v, u].tolist() == list(SKY_BLUE)
    drawn = draw_overlay(grey(), lens(), both, 1.5, None)
    (x, y), *_ = drive(np.array([1.5]))[0] + BESIDE_M
    u, v = pixel((x - 2.25, y - 0.9, 0.7), lens())
    assert has(drawn[v : v + 1, u - 4 : u + 5], SKY_BLUE)
    assert has(drawn[v : v + 1, u - 4 : u + 5], VERMILLION)


def test_the_clock_offset_moves_the_senders_box() -> None:
    true = calibration()
    late = with_drive(true, time_offset_s=0.5)
    at_once = draw_overlay(grey(), lens(), true, 1.5, None)
    shifted = draw_overlay(grey(), lens(), late, 1.5, None)
    (x, y), *_ = drive(np.array([2.0]))[0]
    front = pixel((x + 2.25, y - 0.9, 0.7), lens())
    window = np.s_[front[1] - 1 : front[1] + 2, front[0] - 2 : front[0] + 3]
    assert has(shifted[window], VERMILLION)
    assert not has(at_once[window], VERMILLION)


def test_a_map_behind_the_camera_leaves_no_trace() -> None:
    behind = lane_map(lane((-20.0, -30.0), (20.0, -30.0)), lane((3.0, -10.0), (3.0, -90.0)))
    with_map = draw_overlay(grey(), lens(), calibration(), 1.5, behind)
    np.testing.assert_array_equal(with_map, draw_overlay(grey(), lens(), calibration(), 1.5, None))


def test_a_map_far_aside_leaves_no_trace_in_a_lens_that_folds_back() -> None:
    folding = lens(distortion=np.array([-0.35, 0.0, 0.0, 0.0, 0.0]))
    aside = lane_map(lane((40.0, 4.0), (90.0, 4.0)))
    with_map = draw_overlay(grey(), folding, calibration(), 1.5, aside)
    np.testing.assert_array_equal(with_map, draw_overlay(grey(), folding, calibration(), 1.5, None))


def test_without_a_map_nothing_is_drawn_in_its_colour() -> None:
    assert has(draw_overlay(grey(), lens(), calibration(), 1.5, MAP), YELLOW)
    assert not has(draw_overlay(grey(), lens(), calibration(), 1.5, None), YELLOW)


@pytest.mark.parametrize("size", [(1280, 720), (640, 480)])
def test_grey_images_get_the_same_drawing(size: tuple[int, int]) -> None:
    drawn = draw_overlay(grey(*size)[:, :, 0], lens(*size), calibration(), 1.5, MAP)
    np.testing.assert_array_equal(drawn, draw_overlay(grey(*size), lens(*size), calibration(), 1.5, MAP))


def test_a_frame_in_which_neither_knows_the_vehicle_shows_the_tracks_alone() -> None:
    away = draw_overlay(grey(), lens(), calibration(), 60.0, None)
    there = draw_overlay(grey(), lens(), calibration(), 2.0, None)
    roof = pixel((*drive(np.array([2.0]))[0][0], 1.4), lens())
    window = np.s_[roof[1] - 15 : roof[1] + 15, roof[0] - 60 : roof[0] + 60]
    assert has(there[window], SKY_BLUE)
    assert not has(away[window], SKY_BLUE)


def test_three_frames_are_drawn_early_in_the_middle_and_late() -> None:
    true = calibration()
    first, middle, last = overlay_stamps(true)
    assert [first, middle, last] == pytest.approx([1.3, 2.5, 3.7])
    assert {first, middle, last} <= set(true.drive.track.stamps_s.tolist())


def test_no_frame_is_drawn_for_which_no_message_tells_where_the_vehicle_was() -> None:
    true = calibration()
    known = true.drive.vehicle.stamps_s <= 2.0
    vehicle = replace(
        true.drive.vehicle,
        stamps_s=true.drive.vehicle.stamps_s[known],
        xy=true.drive.vehicle.xy[known],
        yaw_rad=true.drive.vehicle.yaw_rad[known],
    )
    assert max(overlay_stamps(with_drive(true, vehicle=vehicle))) <= 2.0
    assert overlay_stamps(with_drive(true, vehicle=vehicle, time_offset_s=60.0)) == []


def test_one_sighting_is_drawn_once() -> None:
    true = calibration()
    first = true.drive.track.sightings[:1]
    assert overlay_stamps(with_drive(true, track=Track(first))) == [first[0].stamp_s]
