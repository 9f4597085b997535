from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from laci_stereo.core.frames import FORWARD_LEFT_UP_AXES, FloatArray, Raster, planar
from laci_stereo.core.result import Calibration
from laci_stereo.report.mapview import MapView, map_view, nice_step
from laci_stereo.report.style import BLACK, LIGHT_GREY, VERMILLION
from laci_stereo.report.summary import summarise
from laci_stereo.report.topdown import PLOT, SIZE, draw_topdown, facts, position_covariance
from tests.report.support import (
    BESIDE_M,
    CORNER,
    SENSOR_XY,
    YAW_RAD,
    calibration,
    drive,
    lane,
    lane_map,
    with_another,
    with_drive,
)


def plot(image: Raster) -> Raster:
    left, top, right, bottom = map(int, PLOT)
    return image[top:bottom, left:right]


def plot_view(of: Calibration) -> MapView:
    return map_view(of, (PLOT[2] - PLOT[0], PLOT[3] - PLOT[1]))


def test_the_picture_has_its_size() -> None:
    drawn = draw_topdown(calibration())
    assert drawn.shape == (SIZE[1], SIZE[0], 3)
    assert drawn.dtype == np.uint8


def test_north_is_up_and_east_is_right() -> None:
    # The car comes from the west, and turns to the north at the corner.
    rows, columns = np.nonzero((plot(draw_topdown(calibration())) == VERMILLION).all(axis=2))
    northern, western = columns[rows == rows.min()].mean(), rows[columns == columns.min()].mean()
    assert northern > columns.mean()
    assert western > rows.mean()


@pytest.mark.parametrize("stamp_s", [0.4, 0.7, 4.2])
def test_the_senders_track_is_where_the_view_puts_it(stamp_s: float) -> None:
    true = calibration()
    x, y = np.rint(plot_view(true).pixels(drive(np.array([stamp_s]))[0])[0]).astype(int)
    assert plot(draw_topdown(true))[y, x].tolist() == list(VERMILLION)


@pytest.mark.parametrize("stamp_s", [0.4, 0.7, 4.2])
def test_every_senders_track_is_in_view_and_all_are_named(stamp_s: float) -> None:
    both = with_another(calibration())
    (xy,) = drive(np.array([stamp_s]))[0]
    for at in (xy, xy + BESIDE_M):
        x, y = np.rint(plot_view(both).pixels(at)).astype(int)
        assert plot(draw_topdown(both))[y, x].tolist() == list(VERMILLION)
    assert any(line.startswith("stations 4711, 4712, ") for line in facts(both))


def test_the_scale_is_the_same_in_both_directions() -> None:
    view = plot_view(calibration())
    origin, east, north = view.pixels(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    np.testing.assert_allclose(east - origin, [view.scale_px, 0.0])
    np.testing.assert_allclose(north - origin, [0.0, -view.scale_px])


@pytest.mark.parametrize("axes", [None, FORWARD_LEFT_UP_AXES])
def test_the_sensor_stands_in_its_place_and_looks_north(axes: object) -> None:
    true = calibration() if axes is None else calibration(FORWARD_LEFT_UP_AXES)
    x, y = np.rint(plot_view(true).pixels(SENSOR_XY)).astype(int)
    drawn = plot(draw_topdown(true))
    black = (drawn == BLACK).all(axis=2)
    assert black[y, x]
    assert black[y - 60, x]
    assert not black[y, x - 60 : x - 20].any()
    assert not black[y, x + 20 : x + 60].any()


def test_all_that_matters_is_in_view_and_a_far_box_does_not_shrink_it() -> None:
    view = plot_view(calibration())
    shown = np.vstack([SENSOR_XY, CORNER, drive(np.array([1.0, 4.0]))[0]])
    assert (view.pixels(shown) > 0).all()
    assert (view.pixels(shown) < view.size).all()
    far = plot_view(calibration(far_box=True))
    assert far.scale_px == view.scale_px
    np.testing.assert_allclose(far.centre, view.centre)


def test_background_is_drawn_in_its_place() -> None:
    true = calibration()
    level = true.drive.background.boxes[0].box.centre
    world = SENSOR_XY + np.array([-level[1], level[0]])  # the level frame's x points north
    assert pytest.approx(np.pi / 2) == YAW_RAD
    x, y = np.rint(plot_view(true).pixels(world)).astype(int)
    assert plot(draw_topdown(true))[y, x].tolist() == list(LIGHT_GREY)


def test_a_map_is_drawn_only_in_the_frame() -> None:
    true = calibration()
    huge = lane_map(lane((-4000.0, 10.0), (4000.0, 10.0), subtype="dashed"), lane((0.0, 900.0), (50.0, 900.0)))
    changed = (draw_topdown(true, huge) != draw_topdown(true, lane_map(lane((0.0, 900.0), (50.0, 900.0))))).any(axis=2)
    rows, columns = np.nonzero(changed)
    row = plot_view(true).pixels(np.array([0.0, 10.0]))[1] + PLOT[1]
    assert np.abs(rows - row).max() < 6
    assert columns.min() >= PLOT[0]
    assert columns.max() <= PLOT[2]


def test_the_ellipse_is_the_translations_at_the_centre_and_widens_away_from_it() -> None:
    true = calibration()
    centre = true.centre_world[:2]
    np.testing.assert_allclose(position_covariance(true, centre), np.diag([0.09, 0.04]))
    # 20 m to the east, a turn of 0.02 rad moves an object by 0.4 m to the north.
    np.testing.assert_allclose(position_covariance(true, centre + np.array([20.0, 0.0])), np.diag([0.09, 0.04 + 0.16]))


@pytest.mark.parametrize("at", [(-15.0, 8.0), (30.0, -20.0)])
def test_the_ellipse_is_that_of_calibrations_drawn_at_random(at: tuple[float, float]) -> None:
    true = calibration()
    rng = np.random.default_rng(1)
    root = rng.normal(size=(6, 6)) * [1e-3, 1e-3, 1e-3, 0.05, 0.05, 0.05]
    true = replace(true, covariance=root.T @ root)
    offset = np.append(np.array(at) - true.centre_world[:2], 0.0)
    errors: FloatArray = rng.multivariate_normal(np.zeros(6), true.covariance, 20_000)
    moved = np.cross(errors[:, :3], offset) + errors[:, 3:]
    expected = position_covariance(true, np.array(at))
    np.testing.assert_allclose(np.cov(moved[:, :2].T), expected, atol=0.05 * np.trace(expected))


def test_no_ellipse_is_drawn_that_would_be_hidden() -> None:
    true = calibration()
    sharp = replace(true, covariance=true.covariance * 1e-4)
    legend = np.s_[:, int(PLOT[2]) + 20 :]
    assert (draw_topdown(true)[legend] != draw_topdown(sharp)[legend]).any()


def test_a_vehicle_without_known_times_still_gives_a_map() -> None:
    assert draw_topdown(with_drive(calibration(), time_offset_s=1000.0)).shape == (SIZE[1], SIZE[0], 3)


@given(st.floats(1e-3, 1e5), st.integers(2, 12))
def test_ticks_are_round_and_as_many_as_fit(span: float, count: int) -> None:
    step = nice_step(span, count)
    mantissa = step / 10.0 ** np.floor(np.log10(step * (1 + 1e-9)))
    assert min(abs(mantissa - nice) for nice in (1.0, 2.0, 5.0)) < 1e-6
    assert span / step <= count * (1 + 1e-6)
    assert span / (step / 2.5) > count * (1 - 1e-6)


@given(st.floats(1e-3, 1e4), st.floats(0.05, 1.0))
def test_a_scale_bar_is_the_longest_round_length_that_fits(scale_px: float, share: float) -> None:
    most_m = share * SIZE[0] / scale_px
    bar_m = MapView(np.zeros(2), scale_px, SIZE).bar_m(share)
    mantissa = bar_m / 10.0 ** np.floor(np.log10(bar_m * (1 + 1e-9)))
    assert min(abs(mantissa - nice) for nice in (1.0, 2.0, 5.0)) < 1e-6
    assert most_m / 2.5 < bar_m <= most_m


def test_the_sensor_stands_where_the_summary_says() -> None:
    """A kilometre from the track, where a rigid transform into the grid is off by decimetres."""
    away = replace(
        calibration(), T_world_sensor=planar(0.0, np.array([1000.0, -1000.0])) @ calibration().T_world_sensor
    )
    words = summarise(away, "", "")
    for fact in facts(away)[:2]:
        number = re.search(r"(?:E|N) (\d+\.\d\d) m", fact)
        assert number is not None
        assert number[1] in words
