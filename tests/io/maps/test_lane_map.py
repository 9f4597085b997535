from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from laci_stereo.core.errors import MapError
from laci_stereo.core.world import World
from laci_stereo.io.maps.lane_map import find_lane_map, read_lane_map
from tests.io.support import SHARED, fuzz, mutations, needs_shared, noise, read_or_refused

WORLD = World.around(48.4226, 9.9434)
POINT = st.tuples(st.floats(-900, 900), st.floats(-900, 900))
LINES = st.lists(st.lists(POINT, min_size=2, max_size=5), min_size=1, max_size=4)


def geodetic(line: list[tuple[float, float]]) -> list[tuple[str, str]]:
    """Return latitudes and longitudes of points in the world."""
    return [(repr(float(lat)), repr(float(lon))) for lat, lon in WORLD.to_geodetic(np.array(line))]


def lanelet2(lines: list[list[tuple[float, float]]], kind: str = "line_thin", subtype: str = "solid") -> str:
    nodes, ways = [], []
    for i, line in enumerate(lines):
        ids = [f"{i}{j:03d}" for j in range(len(line))]
        nodes += [
            f'<node id="{n}" lat="{lat}" lon="{lon}"/>' for n, (lat, lon) in zip(ids, geodetic(line), strict=True)
        ]
        references = "".join(f'<nd ref="{n}"/>' for n in ids)
        ways.append(f'<way id="w{i}">{references}<tag k="type" v="{kind}"/><tag k="subtype" v="{subtype}"/></way>')
    return f"<?xml version='1.0' encoding='UTF-8'?><osm version='0.6'>{''.join(nodes + ways)}</osm>"


def feature(kind: str, coordinates: object, **properties: str) -> dict[str, object]:
    return {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": coordinates}}


def geojson(features: list[dict[str, object]], **members: object) -> str:
    return json.dumps({"type": "FeatureCollection", "features": features, **members})


def longitudes_first(line: list[tuple[float, float]]) -> list[list[float]]:
    return [[float(lon), float(lat)] for lat, lon in geodetic(line)]


@fuzz
@given(LINES)
def test_lanelet2_lines_come_back_in_the_world(tmp_path: Path, lines: list[list[tuple[float, float]]]) -> None:
    path = tmp_path / "map.osm"
    path.write_text(lanelet2(lines))
    found = read_lane_map(path, WORLD)
    assert found.notes == ()
    assert [(line.id, line.kind, line.subtype) for line in found.lines] == [
        (f"w{i}", "line_thin", "solid") for i in range(len(lines))
    ]
    for line, wanted in zip(found.lines, lines, strict=True):
        np.testing.assert_allclose(line.xy, wanted, atol=1e-6)


@fuzz
@given(LINES)
def test_geojson_lines_come_back_in_the_world(tmp_path: Path, lines: list[list[tuple[float, float]]]) -> None:
    path = tmp_path / "map.geojson"
    path.write_text(geojson([feature("LineString", longitudes_first(line), type="line_thin") for line in lines]))
    found = read_lane_map(path, WORLD)
    for line, wanted in zip(found.lines, lines, strict=True):
        assert (line.kind, line.subtype) == ("line_thin", "")
        np.testing.assert_allclose(line.xy, wanted, atol=1e-6)


SQUARE = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 0.0)]
HOLE = [(2.0, 1.0), (3.0, 1.0), (3.0, 2.0), (2.0, 1.0)]


@pytest.mark.parametrize(
    ("kind", "coordinates", "lines"),
    [
        ("LineString", longitudes_first(SQUARE), [SQUARE]),
        ("LineString", [[*point, 560.0] for point in longitudes_first(SQUARE)], [SQUARE]),
        ("MultiLineString", [longitudes_first(SQUARE), longitudes_first(HOLE)], [SQUARE, HOLE]),
        ("Polygon", [longitudes_first(SQUARE), longitudes_first(HOLE)], [SQUARE, HOLE]),
        ("MultiPolygon", [[longitudes_first(SQUARE)], [longitudes_first(HOLE)]], [SQUARE, HOLE]),
    ],
)
def test_geojson_in_its_shapes(tmp_path: Path, kind: str, coordinates: object, lines: list[object]) -> None:
    path = tmp_path / "map.geojson"
    geometry = {"type": kind, "coordinates": coordinates}
    collection = {"type": "GeometryCollection", "geometries": [geometry, {"type": "Point", "coordinates": [9.9, 48.4]}]}
    for root in (
        geometry,
        feature(kind, coordinates),
        {"type": "FeatureCollection", "features": [feature(kind, coordinates)]},
    ):
        path.write_text(json.dumps(root))
        found = read_lane_map(path, WORLD)
        for line, wanted in zip(found.lines, lines, strict=True):
            np.testing.assert_allclose(line.xy, wanted, atol=1e-6)
    path.write_text(json.dumps(collection))
    assert read_lane_map(path, WORLD).notes == ("1 of type 'Point' left out; lines are used",)


@pytest.mark.parametrize("name", ["EPSG:32632", "urn:ogc:def:crs:EPSG::32632", "EPSG:25832"])
def test_a_geojson_in_another_coordinate_system_says_so(tmp_path: Path, name: str) -> None:
    path = tmp_path / "map.geojson"
    line = feature("LineString", WORLD.to_utm(np.array(SQUARE)).tolist())
    path.write_text(geojson([line], crs={"type": "name", "properties": {"name": name}}))
    # The ellipsoids of ETRS89 and WGS84 differ by a tenth of a millimetre.
    np.testing.assert_allclose(read_lane_map(path, WORLD).lines[0].xy, SQUARE, atol=1e-3)
    path.write_text(geojson([line], crs={"type": "name", "properties": {"name": "EPSG:4326"}}))
    with pytest.raises(
        MapError, match=r"has a point at '\[569\d+\.0, 5363\d+\.0\]'; needed are longitude and latitude"
    ):
        read_lane_map(path, WORLD)
    path.write_text(geojson([line], crs={"type": "name", "properties": {"name": "Ulm"}}))
    with pytest.raises(MapError, match=r"map\.geojson: crs is 'Ulm'; needed is a name that PROJ knows"):
        read_lane_map(path, WORLD)


def test_a_geojson_in_metres_from_a_point_is_no_map_in_degrees(tmp_path: Path) -> None:
    path = tmp_path / "map.geojson"
    road = np.array([(-60.0, 2.0), (-20.0, 3.0), (35.0, 1.0)])
    path.write_text(geojson([feature("LineString", road.tolist())]))
    with pytest.raises(MapError, match=r"does not say its coordinate system, .* --map-crs EPSG"):
        read_lane_map(path, WORLD)
    east, north = WORLD.to_utm(np.array([[0.0, 0.0]]))[0]
    found = read_lane_map(path, WORLD, f"{WORLD.crs}@{east:.3f},{north:.3f}")
    np.testing.assert_allclose(WORLD.to_utm(found.lines[0].xy), road + np.array([east, north]), atol=2e-3)


def test_virtual_lines_are_kept_as_such_and_lost_points_noted(tmp_path: Path) -> None:
    path = tmp_path / "map.osm"
    text = lanelet2([SQUARE], kind="virtual")
    path.write_text(
        text.replace('<nd ref="0000"/>', '<nd ref="0000"/><nd ref="404"/>').replace("</osm>", "<way id='9'/></osm>")
    )
    found = read_lane_map(path, WORLD)
    assert [line.kind for line in found.lines] == ["virtual"]
    assert found.notes == (
        "1 points of lines have no position in the file, left out",
        "1 lines of less than two points left out",
    )


@pytest.mark.parametrize("position", ['lat="" lon=""', 'lat="0" lon="0.0"', ""])
def test_a_map_with_only_local_coordinates_needs_to_know_where_they_begin(tmp_path: Path, position: str) -> None:
    path = tmp_path / "map.osm"
    local = '<tag k="local_x" v="3"/><tag k="local_y" v="4"/>'
    nodes = "".join(f'<node id="{i}" {position}>{local}</node>' for i in "12")
    path.write_text(f'<osm>{nodes}<way id="w"><nd ref="1"/><nd ref="2"/></way></osm>')
    with pytest.raises(MapError, match=r"does not say its coordinate system, and 3, 4 is not near .* --map-crs EPSG"):
        read_lane_map(path, WORLD)
    path.write_text(f'<osm><node id="1" {position}/></osm>')
    with pytest.raises(
        MapError, match=r"none of 1 nodes has lat and lon, or local_x and local_y; needed are positions"
    ):
        read_lane_map(path, WORLD)


def test_a_map_of_somewhere_else_is_refused_with_its_distance(tmp_path: Path) -> None:
    path = tmp_path / "map.osm"
    path.write_text(lanelet2([[(4000.0, 0.0), (9000.0, 0.0)]]))
    assert len(read_lane_map(path, WORLD).lines) == 1
    path.write_text(lanelet2([[(0.0, 6200.0), (0.0, 9000.0)]]))
    with pytest.raises(MapError, match=r"map\.osm is 6\.2 km away from the track \(48\.4226\d, 9\.9434\d\)"):
        read_lane_map(path, WORLD)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("hello", r"is no map that is known; needed is Lanelet2 \(\.osm\), OpenDRIVE \(\.xodr\), GeoJSON, DXF or CSV"),
        ("<svg/>", "is XML of <svg>; needed is Lanelet2"),
        ("<html/>", "is a web page, as of a log-in; needed is the file itself"),
        ("<osm><way", "is neither Lanelet2 .* nor OpenDRIVE .*: unclosed token"),
        ('<!DOCTYPE osm [<!ENTITY a "b">]><osm>&a;</osm>', "is neither .* a document type .* is refused"),
        ("<osm/>", "holds no lines"),
        ('<osm><node id="7" lat="91" lon="8"/></osm>', "node '7' is at lat '91', lon '8'; needed are degrees"),
        ('<osm><node id="7" lat="north" lon="8"/></osm>', "node '7' is at lat 'north'"),
        ("{", "is no GeoJSON: .* well-formed JSON"),
        ("[1]", "holds no lines"),
        ("{}", "holds no lines"),
        (geojson([feature("Point", [9.9, 48.4])]), "holds no lines; .*1 of type 'Point' left out"),
        (
            geojson([feature("LineString", [[9.9], [9.8]])]),
            r"line '0' has coordinates '\[\[9\.9\], \[9\.8\]\]'; needed are",
        ),
        (geojson([feature("LineString", [[9.9, None], [9.8, 1]])]), "line '0' has coordinates"),
        (geojson([feature("LineString", [[9.9, True], [9.8, 1]])]), "line '0' has coordinates"),
        ('{"type": "GeometryCollection", "geometries": [' * 40 + "]}" * 40, "is no GeoJSON: it nests deeper than 20"),
        ("[" * 100_000, "is no GeoJSON"),
    ],
)
def test_what_is_no_lane_map(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "map.osm"
    path.write_text(text)
    with pytest.raises(MapError, match=rf"map\.osm:? {message}") as refused:
        read_lane_map(path, WORLD)
    assert len(str(refused.value).splitlines()) == 1


def test_the_map_beside_the_left_images_is_found(tmp_path: Path) -> None:
    (tmp_path / "left").mkdir()
    assert find_lane_map(tmp_path / "left") is None
    for name in ("map.geojson", "map.osm"):
        (tmp_path / name).touch()
        assert find_lane_map(tmp_path / "left") == tmp_path / name


@pytest.mark.parametrize(
    "whole", [lanelet2([SQUARE]), geojson([feature("Polygon", [longitudes_first(SQUARE)])])], ids=["osm", "json"]
)
def test_any_file_is_read_or_refused(tmp_path: Path, whole: str) -> None:
    words = (
        "<osm>",
        "</osm>",
        "<node id='1' lat='48.4' ",
        "lon='9.9'/>",
        "<way>",
        "{",
        "}",
        '"type":',
        '"Feature"',
        "[",
        "]",
        ",",
        "9.9",
    )

    @fuzz
    @given(st.one_of(mutations(whole.encode()), noise(*words)))
    def check(content: bytes) -> None:
        path = tmp_path / "map"
        path.write_bytes(content)
        found = read_or_refused(lambda: read_lane_map(path, WORLD), MapError)
        assert found is None or all(np.isfinite(line.xy).all() for line in found.lines)

    check()


@needs_shared
def test_the_shared_maps() -> None:
    path = find_lane_map(SHARED / "data/crossing/left")
    assert path is not None
    found = read_lane_map(path, WORLD)
    assert Counter(line.kind for line in found.lines) == {"line_thin": 12, "virtual": 8, "stop_line": 4}
    real = SHARED / "formats/map/mapping_example.osm"
    assert len(read_lane_map(real, World.around(49.0034, 8.4243)).lines) == 1140
    with pytest.raises(MapError, match=r"mapping_example\.osm is 127\.\d km away"):
        read_lane_map(real, WORLD)
