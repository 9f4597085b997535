"""A crossing written in every format lies in the same place, in every coordinate system."""

from __future__ import annotations

import sys
from io import StringIO
from pathlib import Path

import ezdxf
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import KDTree

from laci_stereo.core.errors import MapError, SettingError
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.world import World
from laci_stereo.io.maps.lane_map import LaneLine, LaneMap, read_lane_map
from tests.io.map_writers import (
    CAPE_TOWN,
    WORLD,
    Line,
    assert_same,
    crossing,
    csv,
    dxf,
    geojson,
    in_system,
    lanelet2,
    opendrive,
    straight_roads,
    utm,
)
from tests.io.support import SHARED, fuzz, mutations, needs_shared, noise, read_or_refused

LINES = crossing()
CENTIMETRE = 0.01
EXACT = 1e-6
"""Of coordinates that are stated: what writing and projecting leave of the digits."""


def read(folder: Path, text: str, name: str = "map", crs: str | None = None, world: World = WORLD) -> LaneMap:
    path = folder / name
    path.write_text(text)
    return read_lane_map(path, world, crs)


@pytest.mark.parametrize("world", [WORLD, CAPE_TOWN], ids=["Ulm", "Cape Town"])
def test_every_format_has_the_same_lines(tmp_path: Path, world: World) -> None:
    dxf(LINES, tmp_path / "drawn.dxf", world)
    east, north = world.origin_utm
    zone = world.crs
    found = {
        "lanelet2": read(tmp_path, lanelet2(LINES, world), world=world),
        "local": read(tmp_path, lanelet2(LINES, world, (east, north)), crs=f"{zone}@{east},{north}", world=world),
        "geojson": read(tmp_path, geojson(LINES, world=world), world=world),
        "geojson utm": read(tmp_path, geojson(LINES, zone, world), world=world),
        "csv": read(tmp_path, csv(LINES, world=world), crs=zone, world=world),
        "csv degrees": read(tmp_path, csv(LINES, "line,lat,lon,type,subtype", world), world=world),
        "dxf": read_lane_map(tmp_path / "drawn.dxf", world, zone),
    }
    for lane_map in found.values():
        assert_same(lane_map.lines, LINES, EXACT)


def test_opendrive_has_the_same_lines(tmp_path: Path) -> None:
    two_points = [line for line in LINES if len(line.xy) == 2 and line.kind == "line_thin"]
    found = read(tmp_path, straight_roads(two_points))
    assert [(each.kind, each.subtype) for each in found.lines] == [(line.kind, line.subtype) for line in two_points]
    for each, line in zip(found.lines, two_points, strict=True):
        np.testing.assert_allclose(each.xy[[0, -1]], line.xy, atol=EXACT)


@pytest.mark.parametrize(
    "crs", ["EPSG:25832", "EPSG:31467", "EPSG:3857", "+proj=tmerc +lat_0=48.4 +lon_0=9.9 +datum=WGS84"]
)
def test_any_coordinate_system_that_proj_knows(tmp_path: Path, crs: str) -> None:
    text = "id,x,y,type,subtype\n"
    for i, line in enumerate(LINES):
        text += "".join(f"{i},{float(x)!r},{float(y)!r},{line.kind},{line.subtype}\n" for x, y in in_system(line, crs))
    found = read(tmp_path, text, crs=crs)
    # Where it has another datum, PROJ is free to choose how to get from one to the other, and back.
    assert_same(found.lines, LINES, 1e-3 if crs != "EPSG:31467" else CENTIMETRE)
    assert found.notes[0].endswith("as --map-crs says")


def test_lines_near_the_track_need_no_statement(tmp_path: Path) -> None:
    dxf(LINES, tmp_path / "drawn.dxf")
    for found in (
        read(tmp_path, csv(LINES)),
        read_lane_map(tmp_path / "drawn.dxf", WORLD),
        read(tmp_path, lanelet2(LINES, local_from=(0.0, 0.0))),
    ):
        assert_same(found.lines, LINES, EXACT)
        assert any("EPSG:32632 fits, for its lines lie near the track" in note for note in found.notes)


def test_lines_elsewhere_without_a_statement_are_refused(tmp_path: Path) -> None:
    far = [Line(line.kind, line.subtype, line.xy + np.array([0.0, 20_000.0])) for line in LINES]
    with pytest.raises(MapError, match=r"does not say its coordinate system, and 5698\d+.* needed is --map-crs EPSG"):
        read(tmp_path, csv(far))


def test_what_the_file_states_is_taken_and_said(tmp_path: Path) -> None:
    found = read(tmp_path, geojson(LINES, "EPSG:25832"), crs="EPSG:25833")
    assert_same(found.lines, LINES, 1e-3)
    assert found.notes == (
        "the map's coordinates are ETRS89 / UTM zone 32N, as the file says; --map-crs was left aside",
    )


def test_the_wrong_system_is_somewhere_else(tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"map is \d+\.\d km away from the track"):
        read(tmp_path, csv(LINES), crs="EPSG:32631")
    with pytest.raises(SettingError, match=r"--map-crs is 'Ulm'; needed is a coordinate system that PROJ knows"):
        read(tmp_path, csv(LINES), crs="Ulm")


def test_lanelet2_with_both_positions_says_which_it_took(tmp_path: Path) -> None:
    east, north = WORLD.origin_utm
    both = lanelet2(LINES).replace("/><node", "><tag k='local_x' v='1'/><tag k='local_y' v='2'/></node><node")
    found = read(tmp_path, both)
    assert_same(found.lines, LINES, EXACT)
    assert found.notes == ("the map's positions are its lat and lon; local_x and local_y were left aside",)
    local = read(tmp_path, both, crs=f"EPSG:32632@{east},{north}")
    assert "the map's positions are its local_x and local_y; lat and lon were left aside" in local.notes
    np.testing.assert_allclose(local.lines[0].xy[0], np.array([1.0, 2.0]) / WORLD.grid_scale, atol=EXACT)


# OpenDRIVE


def road(lanes: str, plan: str = "<geometry s='0' x='0' y='0' hdg='0' length='100'><line/></geometry>") -> str:
    return f"<road id='1' length='100'><planView>{plan}</planView><lanes>{lanes}</lanes></road>"


def found_in(folder: Path, roads: str, offset: tuple[float, float, float] | None = None) -> dict[str, LaneLine]:
    east, north = WORLD.origin_utm
    text = opendrive(
        roads, "+proj=utm +zone=32 +datum=WGS84 +units=m +geoidgrids=none.gtx", offset or (east, north, 0.0)
    )
    return {line.id: line for line in read(folder, text).lines}


def test_borders_of_lanes_are_their_widths_apart(tmp_path: Path) -> None:
    lanes = """<laneOffset s='0' a='0.5' b='0' c='0' d='0'/><laneSection s='0'>
      <left><lane id='2'><width sOffset='0' a='2' b='0' c='0' d='0'/></lane>
        <lane id='1'><width sOffset='0' a='3' b='0.01' c='0' d='0'/>
          <roadMark sOffset='0' type='broken'/><roadMark sOffset='40' type='solid solid' weight='bold'/></lane></left>
      <center><lane id='0'><roadMark sOffset='0' type='none'/></lane></center>
      <right><lane id='-1'><width sOffset='0' a='3' b='0' c='0' d='0'/><width sOffset='50' a='4' b='0' c='0' d='0'/>
          <roadMark sOffset='0' type='curb'/></lane>
        <lane id='-2'><border sOffset='0' a='-9' b='0' c='0' d='0'/></lane></right></laneSection>"""
    found = found_in(tmp_path, road(lanes))
    scale = WORLD.grid_scale
    assert {name: (line.kind, line.subtype) for name, line in found.items()} == {
        "1/0/2/0": ("virtual", ""),
        "1/0/1/0": ("line_thin", "dashed"),
        "1/0/1/1": ("line_thick", "solid_solid"),
        "1/0/0/0": ("virtual", ""),
        "1/0/-1/0": ("curbstone", "high"),
        "1/0/-2/0": ("virtual", ""),
    }
    for name, ends in {
        "1/0/2/0": [[0, 5.5], [100, 6.5]],
        "1/0/1/0": [[0, 3.5], [40, 3.9]],
        "1/0/1/1": [[40, 3.9], [100, 4.5]],
        "1/0/0/0": [[0, 0.5], [100, 0.5]],
        "1/0/-1/0": [[0, -2.5], [100, -3.5]],
    }.items():
        np.testing.assert_allclose(found[name].xy[[0, -1]] * scale, ends, atol=EXACT)
    np.testing.assert_allclose(found["1/0/-2/0"].xy[:, 1] * scale, -9.0 + 0.5, atol=EXACT)


def test_a_road_of_every_geometry_follows_what_integration_says(tmp_path: Path) -> None:
    plan, truth, pose = "", [], (0.0, 0.0, 0.3)
    for i, (shape, first, last) in enumerate(
        [
            ("<line/>", 0.0, 0.0),
            ("<spiral curvStart='0' curvEnd='0.05'/>", 0.0, 0.05),
            ("<arc curvature='0.05'/>", 0.05, 0.05),
            ("<spiral curvStart='0.05' curvEnd='-0.02'/>", 0.05, -0.02),
        ]
    ):
        plan += geometry(20 * i, pose, 20, shape)
        points, pose = integrated(pose, first, last, 20.0)
        truth.append(points)
    # A straight cubic and a parabola, v = 0.001 u^2 over 20 m of u, which is all but 20 m long.
    plan += geometry(80, pose, 10, "<poly3 a='0' b='0' c='0' d='0'/>")
    points, pose = integrated(pose, 0.0, 0.0, 10.0)
    truth.append(points)
    plan += geometry(
        90, pose, 20, "<paramPoly3 pRange='normalized' aU='0' bU='20' cU='0' dU='0' aV='0' bV='0' cV='0.4' dV='0'/>"
    )
    u = np.linspace(0.0, 20.0, 20_001)
    turn = np.array([[np.cos(pose[2]), -np.sin(pose[2])], [np.sin(pose[2]), np.cos(pose[2])]])
    truth.append(np.column_stack([u, 0.001 * u**2]) @ turn.T + pose[:2])
    lanes = "<laneSection s='0'><center><lane id='0'><roadMark sOffset='0' type='solid'/></lane></center></laneSection>"
    found = found_in(tmp_path, road(lanes, plan).replace("length='100'>", "length='110'>", 1))["1/0/0/0"]
    xy = found.xy * WORLD.grid_scale
    curve = np.concatenate(truth)
    assert KDTree(curve).query(xy)[0].max() < 1e-3
    assert KDTree(dense(xy)).query(curve[::50])[0].max() < 0.02
    np.testing.assert_allclose(xy[[0, -1]], curve[[0, -1]], atol=1e-4)


def geometry(start: float, pose: tuple[float, float, float], length: float, shape: str) -> str:
    x, y, heading = pose
    return f"<geometry s='{start}' x='{x!r}' y='{y!r}' hdg='{heading!r}' length='{length}'>{shape}</geometry>"


def integrated(
    pose: tuple[float, float, float], first: float, last: float, length: float
) -> tuple[FloatArray, tuple[float, float, float]]:
    """Walk along a curve in steps of a millimetre."""
    s = np.linspace(0.0, length, int(1000 * length) + 1)
    angle = pose[2] + first * s + (last - first) / length * s**2 / 2
    ahead = np.column_stack([np.cos(angle), np.sin(angle)])
    steps = (ahead[1:] + ahead[:-1]) / 2 * (length / (len(s) - 1))
    points = np.concatenate([[pose[:2]], pose[:2] + np.cumsum(steps, axis=0)])
    return points, (float(points[-1, 0]), float(points[-1, 1]), float(angle[-1]))


def test_the_headers_offset_turns_before_it_shifts(tmp_path: Path) -> None:
    east, north = WORLD.origin_utm
    mark = "<laneSection s='0'><center><lane id='0'/></center></laneSection>"
    found = found_in(tmp_path, road(mark), (east, north, np.pi / 2))["1/0/0/0"]
    np.testing.assert_allclose(found.xy[[0, -1]] * WORLD.grid_scale, [[0, 0], [0, 100]], atol=EXACT)


def test_opendrive_in_degrees_is_no_statement(tmp_path: Path) -> None:
    text = straight_roads(LINES[1:2], "+proj=longlat +datum=WGS84")
    found = read(tmp_path, text)
    assert found.notes[0] == "its geoReference is a geographic system, which metres cannot be in, and was left aside"
    np.testing.assert_allclose(found.lines[0].xy[[0, -1]], LINES[1].xy, atol=EXACT)


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        ("", "has no geometry; needed is a planView"),
        (
            "<geometry s='0' x='0' y='0' hdg='0' length='9'><bezier/></geometry>",
            "has a geometry of 'bezier'; needed is line",
        ),
        (
            "<geometry s='0' x='a' y='0' hdg='0' length='9'><line/></geometry>",
            "has <geometry> with x 'a'; needed is a number",
        ),
        ("<geometry s='0' x='nan' y='0' hdg='0' length='9'><line/></geometry>", "has <geometry> with x 'nan'"),
        ("<geometry s='0' y='0' hdg='0' length='9'><line/></geometry>", "has <geometry> with x 'None'"),
        ("<geometry s='0' x='0' y='0' hdg='0' length='1e9'><arc curvature='1'/></geometry>", r"turns by 1e\+09 rad"),
    ],
)
def test_roads_that_cannot_be(tmp_path: Path, plan: str, message: str) -> None:
    lanes = "<laneSection s='0'><center><lane id='0'/></center></laneSection>"
    with pytest.raises(MapError, match=rf"road '1' {message}"):
        found_in(tmp_path, road(lanes, plan))


# DXF


def drawing(folder: Path, draw: object, units: int = 6) -> LaneMap:
    document = ezdxf.new(units=units)
    draw(document.modelspace())  # type: ignore[operator]
    text = StringIO()
    document.write(text)
    return read(folder, text.getvalue(), crs=f"EPSG:32632@{WORLD.origin_utm[0]},{WORLD.origin_utm[1]}")


def from_origin(found: LaneMap, number: int = 0) -> FloatArray:
    return found.lines[number].xy * WORLD.grid_scale


def test_dxf_in_its_shapes(tmp_path: Path) -> None:
    def draw(space: ezdxf.layouts.Modelspace) -> None:
        space.add_line((1, 2), (3, 4), dxfattribs={"layer": "line_thin-dashed"})
        space.add_polyline2d([(0, 0), (5, 5)], dxfattribs={"layer": "curbstone"})
        space.add_polyline3d([(0, 0, 400), (5, 6, 401)])
        space.add_arc((10, 20), 50.0, 0.0, 90.0)
        space.add_spline([(0, 0), (10, 5), (20, 0), (30, 5)])
        space.add_lwpolyline([(0, 0, 1.0), (40, 0, 0.0), (60, 0, 0.0)], format="xyb")
        space.add_text("Ulm")
        space.add_point((1, 1))

    found = drawing(tmp_path, draw)
    assert [(line.kind, line.subtype) for line in found.lines] == [
        ("line_thin", "dashed"),
        ("curbstone", ""),
        *[("", "")] * 4,
    ]
    np.testing.assert_allclose(from_origin(found, 0), [[1, 2], [3, 4]], atol=EXACT)
    np.testing.assert_allclose(from_origin(found, 2), [[0, 0], [5, 6]], atol=EXACT)
    arc = from_origin(found, 3)
    np.testing.assert_allclose(np.linalg.norm(arc - [10, 20], axis=1), 50.0, atol=EXACT)
    np.testing.assert_allclose(arc[[0, -1]], [[60, 20], [10, 70]], atol=EXACT)
    middles = (arc[1:] + arc[:-1]) / 2
    assert 50.0 - np.linalg.norm(middles - [10, 20], axis=1).min() < 0.021
    for through in [(0, 0), (10, 5), (20, 0), (30, 5)]:
        assert np.linalg.norm(from_origin(found, 4) - through, axis=1).min() < 2.0
    # A bulge of 1 is half a circle, to the right of its chord.
    bulged = from_origin(found, 5)
    half = bulged[bulged[:, 0] < 40.0 - EXACT]
    np.testing.assert_allclose(np.linalg.norm(half - [20, 0], axis=1), 20.0, atol=EXACT)
    assert half[:, 1].min() == pytest.approx(-20.0, abs=0.03)
    assert "1 of type TEXT left out; lines are used" in found.notes
    assert "1 of type POINT left out; lines are used" in found.notes


def test_a_spline_is_followed_to_its_chords(tmp_path: Path) -> None:
    control = np.array([[0.0, 0.0, 0.0], [20.0, 40.0, 0.0], [60.0, -40.0, 0.0], [80.0, 0.0, 0.0]])
    found = from_origin(drawing(tmp_path, lambda space: space.add_open_spline(control)))
    t = np.linspace(0.0, 1.0, 500)[:, None]
    bezier = sum(n * t**k * (1 - t) ** (3 - k) * control[k, :2] for k, n in enumerate((1, 3, 3, 1)))
    apart = np.linalg.norm(bezier[:, None] - dense(found), axis=2).min(axis=1)
    assert apart.max() < 0.03


def dense(xy: FloatArray) -> FloatArray:
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1)))
    at = np.linspace(0.0, along[-1], 20_000)
    return np.column_stack([np.interp(at, along, axis) for axis in xy.T])


@pytest.mark.parametrize(("code", "unit_m"), [(4, 0.001), (5, 0.01), (2, 0.3048), (0, 1.0)])
def test_drawings_in_other_units(tmp_path: Path, code: int, unit_m: float) -> None:
    dxf(LINES, tmp_path / "map.dxf", unit_m=unit_m, code=code)
    assert_same(read_lane_map(tmp_path / "map.dxf", WORLD, "EPSG:32632").lines, LINES, EXACT)


def test_a_binary_drawing_is_read_as_well(tmp_path: Path) -> None:
    document = ezdxf.new(units=6)
    for line in LINES:
        document.modelspace().add_lwpolyline(
            utm(line).tolist(), dxfattribs={"layer": f"{line.kind}-{line.subtype}".strip("-")}
        )
    document.saveas(tmp_path / "map.dxf", fmt="bin")
    assert_same(read_lane_map(tmp_path / "map.dxf", WORLD, "EPSG:32632").lines, LINES, EXACT)


def test_a_drawing_without_its_model_is_refused(tmp_path: Path) -> None:
    dxf(LINES[:1], tmp_path / "map.dxf")
    text = (tmp_path / "map.dxf").read_text()
    assert "\nModel\n" in text
    with pytest.raises(MapError, match="is no whole DXF drawing: KeyError 'MODEL'"):
        read(tmp_path, text.replace("\nModel\n", "\nx\n"))


def test_without_ezdxf_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dxf(LINES, tmp_path / "map.dxf")
    for name in [name for name in sys.modules if name.split(".")[0] == "ezdxf"]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MapError, match=r"is a DXF drawing; needed to read it is .*laci-stereo\[dxf\]"):
        read_lane_map(tmp_path / "map.dxf", WORLD)


# CSV


@pytest.mark.parametrize(
    "columns", ["line_id,x,y,type,subtype", "id;easting;northing;type;subtype", "way,utm_east,utm_north,layer,style"]
)
def test_csv_with_other_titles(tmp_path: Path, columns: str) -> None:
    text = csv(LINES, columns if ";" not in columns else "id,x,y,type,subtype")
    if ";" in columns:
        text = columns + "\n" + text.split("\n", 1)[1].replace(",", ";").replace(".", ",")
    assert_same(read(tmp_path, text).lines, LINES, EXACT)


def test_csv_without_names_is_one_line(tmp_path: Path) -> None:
    east, north = WORLD.origin_utm
    found = read(tmp_path, f"x,y,z\n{east},{north},500\n{east + 10},{north},501\n")
    (line,) = found.lines
    np.testing.assert_allclose(line.xy * WORLD.grid_scale, [[0, 0], [10, 0]], atol=EXACT)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("id,a,b\n1,2,3\n", "names the columns id, a, b; needed are id, x and y, or id, latitude and longitude"),
        ("timestamp,latitude,longitude,heading\n1,48,10,90\n", "as a log of messages; needed is a map: id, x and y"),
        ("id,x,y\n", "holds a header but no rows; needed is at least one point"),
        ("id,x,y\n1,a,2\n1,b,3\n", "row 2: x is 'a'; needed is a number"),
        ("id,x,y\n1,,\n1,2,3\n", "row 2: x or y is missing"),
        ("id,lat,lon\n1,95,9\n1,48,9\n", r"has a point at '\[9\.0, 95\.0\]'; needed are longitude and latitude"),
        ("id,x,y\n1,1e300,2\n1,3,4\n", r"has a point at '\[1e\+300, 2\.0\]'; needed are coordinates"),
    ],
)
def test_tables_that_are_no_map(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(MapError, match=message):
        read(tmp_path, text)


# Whatever the file


def written(folder: Path, form: str) -> bytes:
    if form == "dxf":
        dxf(LINES[:2], folder / "whole.dxf")
        return (folder / "whole.dxf").read_bytes()
    texts = {
        "local": lanelet2(LINES[:3], local_from=(0.0, 0.0)),
        "csv": csv(LINES[:2]),
        "xodr": straight_roads(LINES[1:2]).replace("<line/>", "<spiral curvStart='0' curvEnd='0.01'/>"),
    }
    return texts[form].encode()


@pytest.mark.parametrize("form", ["local", "csv", "xodr", "dxf"])
def test_any_file_is_read_or_refused(tmp_path: Path, form: str) -> None:
    whole = written(tmp_path, form)
    words = (
        "id,x,y\n",
        "1,2,3\n",
        "<OpenDRIVE>",
        "<road>",
        "</road>",
        "0\nSECTION\n2\nENTITIES\n",
        "0\nLINE\n",
        "0\nEOF\n",
    )

    @fuzz
    @given(st.one_of(mutations(whole), noise(*words)))
    def check(content: bytes) -> None:
        path = tmp_path / "map"
        path.write_bytes(content)
        found = read_or_refused(lambda: read_lane_map(path, WORLD), MapError)
        assert found is None or all(np.isfinite(line.xy).all() for line in found.lines)

    check()


@pytest.mark.parametrize(
    "text",
    [
        "<!DOCTYPE a [<!ENTITY b 'c'>]><OpenDRIVE>&b;</OpenDRIVE>",
        "<OpenDRIVE/>",
        opendrive(road("<laneSection s='0'><center><lane id='99999'/></center></laneSection>")),
        opendrive(
            road("<laneSection s='0'><center><lane id='0'/></center></laneSection>").replace(
                "length='100'", "length='1e8'"
            )
        ),
        opendrive("<road id='1'/>" * 2000),
        "0\nSECTION\n" * 20_000,
        "AutoCAD Binary DXF" + "\x01" * 1000,
        "id,x,y\n" + "9" * 100_000,
    ],
    ids=range(8),
)
def test_malicious_files_are_refused_soon(tmp_path: Path, text: str) -> None:
    with pytest.raises(MapError) as refused:
        read(tmp_path, text)
    assert len(str(refused.value).splitlines()) == 1


@needs_shared
def test_the_shared_lanelet2_map_is_in_degrees() -> None:
    path = SHARED / "formats/map/mapping_example.osm"
    assert len(read_lane_map(path, World.around(49.0034, 8.4243)).lines) == 1140
