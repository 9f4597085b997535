from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from laci_lidar.axes import forward_left_up
from laci_lidar.settings import Sweep
from laci_lidar.view import MARGIN_RAD, learn_view

from laci_stereo.core.errors import SettingError
from laci_stereo.core.frames import FORWARD_LEFT_UP_AXES
from laci_stereo.io.axes import parse_axes
from tests.lidar.scanner import road


def at_azimuth(degrees, elevation_deg: float = -5.0):
    a, e = np.radians(np.atleast_1d(degrees)), np.radians(elevation_deg)
    return 20.0 * np.column_stack([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.full(len(a), np.sin(e))])


@given(st.floats(-180.0, 180.0), st.floats(20.0, 320.0))
def test_the_borders_are_where_nothing_more_is_seen(right_deg, width_deg):
    azimuths = right_deg + np.linspace(0.0, width_deg, 2000)
    view = learn_view([at_azimuth(azimuths)], FORWARD_LEFT_UP_AXES)
    assert view.limited
    assert np.degrees(view.width_rad) == pytest.approx(width_deg, abs=1e-6)
    margin = np.degrees(MARGIN_RAD)
    edge = view.at_edge(at_azimuth(azimuths))
    near = np.minimum(azimuths - right_deg, right_deg + width_deg - azimuths)
    np.testing.assert_array_equal(edge[np.abs(near - margin) > 1e-6], (near < margin)[np.abs(near - margin) > 1e-6])
    # What appears beyond the border is cut off there too.
    assert view.at_edge(at_azimuth([right_deg - 1.0, right_deg + width_deg + 1.0])).all()


def test_the_upper_and_lower_border_do_not_count():
    points = road(layers=4)
    elevation = np.arcsin(points[:, 2] / np.linalg.norm(points, axis=1))
    outer = (elevation == elevation.min()) | (elevation == elevation.max())
    view = learn_view([points], FORWARD_LEFT_UP_AXES)
    azimuth = np.degrees(view.azimuths(points))
    np.testing.assert_array_equal(view.at_edge(points[outer]), np.abs(azimuth[outer]) > 59.5 + 1e-9)


def test_all_around_there_is_no_border():
    azimuths = np.setdiff1d(np.arange(360.0), np.arange(170.0, 190.0))  # a mast
    view = learn_view([at_azimuth(azimuths)], FORWARD_LEFT_UP_AXES)
    assert not view.limited
    assert not view.at_edge(at_azimuth(np.arange(360.0))).any()


@pytest.mark.parametrize("words", ["y forward", "-x forward, z down", "z forward, y down"])
def test_a_turned_frame_sees_the_same(words: str):
    axes = parse_axes(words)
    points = road(field_deg=(-50.0, 40.0))
    plain, turned = learn_view([points], FORWARD_LEFT_UP_AXES), learn_view([points @ forward_left_up(axes)], axes)
    assert turned.width_rad == pytest.approx(plain.width_rad)
    assert turned.right_rad == pytest.approx(plain.right_rad)


@pytest.mark.parametrize("direction", ["cw", "ccw"])
@pytest.mark.parametrize("stamp_at", ["start", "middle", "end"])
@pytest.mark.parametrize("field_deg", [(-50.0, 50.0), (-180.0, 179.6)])
def test_a_sweep_passes_its_field_in_its_time(direction, stamp_at, field_deg):
    points = road(field_deg=field_deg)
    view = learn_view([points], FORWARD_LEFT_UP_AXES)
    offsets = view.offsets_s(points, Sweep(stamp_at, direction, rate_hz=12.5))
    duration = (100.0 if view.limited else 360.0) / 360.0 / 12.5
    first = {"start": 0.0, "middle": -duration / 2, "end": -duration}[stamp_at]
    assert offsets.min() == pytest.approx(first, abs=2e-4)
    assert offsets.max() == pytest.approx(first + duration, abs=2e-4)
    order = np.argsort(view.azimuths(points) * (1 if direction == "ccw" else -1), kind="stable")
    inner = order[np.abs(np.degrees(view.azimuths(points)))[order] < 179.0]
    assert (np.diff(offsets[inner]) >= -1e-12).all()


def test_a_sweep_may_start_anywhere():
    view = learn_view([road(field_deg=(-180.0, 179.6))], FORWARD_LEFT_UP_AXES)
    offsets = view.offsets_s(at_azimuth([90.0, 0.0, -90.0, 180.0]), Sweep("start", "cw", 10.0, start_deg=90.0))
    np.testing.assert_allclose(offsets, [0.0, 0.025, 0.05, 0.075], atol=1e-9)


@pytest.mark.parametrize(
    "sweep", [{"rate_hz": 0.0}, {"rate_hz": np.nan}, {"stamp_at": "begin"}, {"direction": "left"}, {"start_deg": 400.0}]
)
def test_what_no_sweep_is(sweep):
    with pytest.raises(SettingError, match=r"needed is|sweep starts"):
        Sweep(**sweep)
