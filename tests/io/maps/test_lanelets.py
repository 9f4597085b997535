"""Lanes of Lanelet2 maps, whichever way their boundaries were drawn."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.world import World
from laci_stereo.io.maps.lane_map import read_lane_map
from laci_stereo.io.maps.lanelets import Lane, lane_between, read_lanelets

WORLD = World.around(48.42, 9.94)
LEFT = np.array([[0.0, 2.0], [20.0, 2.0], [40.0, 3.0]])
RIGHT = np.array([[0.0, -1.0], [40.0, -1.0]])


def osm(ways: dict[int, FloatArray], relations: str) -> str:
    nodes, lines, number = [], [], 1000
    for name, xy in ways.items():
        refs = []
        for latitude, longitude in WORLD.to_geodetic(xy):
            nodes.append(f'<node id="{number}" lat="{latitude:.10f}" lon="{longitude:.10f}"/>')
            refs.append(f'<nd ref="{number}"/>')
            number += 1
        lines.append(f'<way id="{name}">{"".join(refs)}<tag k="type" v="line_thin"/></way>')
    return f'<osm version="0.6">{"".join(nodes + lines)}{relations}</osm>'


def relation(left: str, right: str, extra: str = "", name: int = 9) -> str:
    members = "".join(
        f'<member type="way" ref="{way}" role="{role}"/>'
        for role, ways in (("left", left), ("right", right))
        for way in ways.split()
    )
    return f'<relation id="{name}">{members}<tag k="type" v="lanelet"/>{extra}</relation>'


def read(folder: Path, text: str) -> tuple[Lane, ...]:
    path = folder / "map.osm"
    path.write_text(text)
    return read_lanelets(path, read_lane_map(path, WORLD))


@pytest.mark.parametrize(("turn_left", "turn_right"), list(product([False, True], repeat=2)))
def test_direction_has_the_left_boundary_on_its_left(tmp_path: Path, turn_left: bool, turn_right: bool) -> None:
    ways = {1: LEFT[::-1] if turn_left else LEFT, 2: RIGHT[::-1] if turn_right else RIGHT}
    (lane,) = read(tmp_path, osm(ways, relation("1", "2")))
    assert lane.id == "9"
    assert lane.one_way
    assert lane.centre[0] == pytest.approx([0.0, 0.5], abs=1e-3)
    assert lane.centre[-1] == pytest.approx([40.0, 1.0], abs=1e-3)
    # The other way round it is the lane of who comes towards us.
    (back,) = read(tmp_path, osm(ways, relation("2", "1")))
    assert back.centre == pytest.approx(lane.centre[::-1], abs=1e-3)


def test_boundary_of_several_ways_is_one_line(tmp_path: Path) -> None:
    ways = {1: LEFT[[1, 0]], 3: LEFT[[2, 1]], 2: RIGHT}
    (lane,) = read(tmp_path, osm(ways, relation("1 3", "2")))
    (whole,) = read(tmp_path, osm({1: LEFT, 2: RIGHT}, relation("1", "2")))
    assert lane.centre[[0, -1]] == pytest.approx(whole.centre[[0, -1]], abs=1e-3)
    assert np.linalg.norm(np.diff(lane.left, axis=0), axis=1).max() < 1.5


def test_what_is_no_lane_of_vehicles_is_left_out(tmp_path: Path) -> None:
    ways = {1: LEFT, 2: RIGHT}
    walk = relation("1", "2", '<tag k="subtype" v="crosswalk"/>')
    incomplete = relation("1", "77", name=10)
    other = '<relation id="11"><tag k="type" v="regulatory_element"/></relation>'
    both = relation("1", "2", '<tag k="one_way" v="no"/>', name=12)
    lanes = read(tmp_path, osm(ways, walk + incomplete + other + both))
    assert [(lane.id, lane.one_way) for lane in lanes] == [("12", False)]


def test_other_maps_have_no_lanes(tmp_path: Path) -> None:
    path = tmp_path / "map.geojson"
    east, north = 9.94, 48.42
    path.write_text(f'{{"type": "LineString", "coordinates": [[{east}, {north}], [{east}, {north + 1e-4}]]}}')
    assert read_lanelets(path, read_lane_map(path, WORLD)) == ()


@given(
    st.floats(-3.0, 3.0),
    st.floats(1.0, 5.0),
    st.lists(st.floats(-0.2, 0.2), min_size=1, max_size=8),
    st.booleans(),
    st.booleans(),
)
def test_centre_line_is_in_the_middle_of_any_lane(
    yaw_rad: float, width_m: float, bends: list[float], turn_left: bool, turn_right: bool
) -> None:
    yaw = yaw_rad + np.cumsum(bends)
    steps = 6.0 * np.column_stack([np.cos(yaw), np.sin(yaw)])
    centre = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    heading = np.arctan2(*np.gradient(centre, axis=0).T[::-1])
    across = rotate_xy(heading, np.tile([0.0, width_m / 2], (len(centre), 1)))
    left, right = centre + across, centre - across
    lane = lane_between("x", left[::-1] if turn_left else left, right[::-1] if turn_right else right, one_way=True)
    assert lane is not None
    assert lane.centre[[0, -1]] == pytest.approx(centre[[0, -1]], abs=1e-6)
    apart = np.linalg.norm(lane.centre[:, None] - centre, axis=2).min(axis=1)
    assert apart.max() < 3.1
    # For each radian of a bend one border is longer by the width, and so far along it are places that belong together.
    # How far it bends its steps tell: at the corners a heading is the mean of two.
    width = np.linalg.norm(lane.left - lane.right, axis=1) / width_m
    assert width.min() > 0.9
    assert width.max() < max(1.1, float(np.hypot(1.0, np.ptp(yaw))))
