from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from laci_lidar.axes import forward_left_up
from laci_lidar.settings import Sweep
from laci_lidar.view import MARGIN_RAD, learn_view

from laci_stereo.core.errors import SettingError
from laci_stereo.core.frames import FORWARD_LEFT_UP_AXES, wrap
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


@pytest.mark.parametrize("in_layers", [False, True], ids=["by beams", "by layers"])
@pytest.mark.parametrize("way", [-1.0, 1.0], ids=["clockwise", "counter-clockwise"])
@pytest.mark.parametrize("begin_deg", [-170.0, -60.0, 0.0, 135.0])
def test_where_scans_begin_is_told_by_the_order_of_their_points(begin_deg, way, in_layers):
    azimuths = begin_deg + way * np.arange(0.0, 360.0, 0.5)
    layers = [at_azimuth(azimuths, elevation) for elevation in (-12.0, -8.0, -4.0)]
    points = np.concatenate(layers) if in_layers else np.stack(layers, axis=1).reshape(-1, 3)
    rng = np.random.default_rng(1)
    scans = [points[rng.random(len(points)) < 0.8] for _ in range(10)]
    view = learn_view(scans, FORWARD_LEFT_UP_AXES)
    assert wrap(view.begin_rad - np.radians(begin_deg - way * 0.25)) == pytest.approx(0.0, abs=np.radians(1.0))
    late_s = view.offsets_s(points, Sweep("start", "cw" if way < 0.0 else "ccw", 10.0))
    taken_s = np.arange(len(azimuths)) * 0.1 / len(azimuths)
    in_turn = np.tile(taken_s, 3) if in_layers else np.repeat(taken_s, 3)
    off_s = np.abs(late_s - in_turn)
    assert np.quantile(off_s, 0.99) < 1e-3
    # Between what ends one scan and what begins the next nothing may be seen.
    kept = np.abs(np.degrees(wrap(view.azimuths(points) - np.radians(begin_deg + 20.0)))) > 20.0
    without = learn_view([points[kept]], FORWARD_LEFT_UP_AXES)
    assert wrap(without.begin_rad - np.radians(begin_deg + 20.0)) == pytest.approx(0.0, abs=np.radians(21.0))


@pytest.mark.parametrize("begin_deg", [20.0, -40.0])
def test_a_scanner_that_turns_where_nothing_is_in_reach_begins_where_it_does(begin_deg):
    """Of all around nothing comes back from behind, over 90 deg: its scans begin in view nevertheless."""
    azimuths = begin_deg - np.arange(0.0, 360.0, 0.2)
    points = at_azimuth(azimuths)
    view = learn_view([points[np.abs(np.degrees(wrap(np.radians(azimuths)))) < 135.0]] * 3, FORWARD_LEFT_UP_AXES)
    assert view.limited
    assert np.degrees(view.begin_rad) == pytest.approx(begin_deg, abs=0.2)
    beside = at_azimuth([begin_deg - 1.0, begin_deg + 0.3])
    for stamp_at, before_s in (("start", 0.0), ("middle", 0.05), ("end", 0.1)):
        late_s = view.offsets_s(beside, Sweep(stamp_at, "cw", 10.0))
        np.testing.assert_allclose(late_s + before_s, [0.1 / 360.0, 0.1 - 0.03 / 360.0], atol=1e-4)


def test_a_layer_that_sees_little_does_not_tell_where_scans_begin():
    """The first one sees a building only, from 140 deg on; what begins behind is told by the others."""
    azimuths = 180.0 - np.arange(0.0, 360.0, 0.5)
    top = at_azimuth(azimuths[(azimuths < 140.0) & (azimuths > -160.0)], 3.0)
    below = [at_azimuth(azimuths, elevation) for elevation in (-4.0, -8.0)]
    view = learn_view([np.concatenate([top, *below])] * 3, FORWARD_LEFT_UP_AXES)
    assert abs(wrap(view.begin_rad - np.pi)) < np.radians(1.0)


def test_an_order_that_was_lost_tells_no_begin_so_it_is_taken_to_be_behind():
    points = at_azimuth(np.arange(0.0, 360.0, 0.2))
    rng = np.random.default_rng(2)
    shuffled = [rng.permutation(points) for _ in range(10)]
    along = [points[np.argsort(points[:, 0])]] * 10
    in_squares = [points[np.lexsort((points[:, 1] // 2.0, points[:, 0] // 2.0))]] * 10
    drifting = [at_azimuth(begin + np.arange(0.0, 360.0, 0.2)) for begin in np.arange(0.0, 360.0, 36.0)]
    for scans in (shuffled, along, in_squares, drifting):
        assert learn_view(scans, FORWARD_LEFT_UP_AXES).begin_rad == np.pi


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
