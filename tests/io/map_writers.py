"""The same lines written in the formats that maps come in."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import ezdxf
import numpy as np
from pyproj import Transformer

from laci_stereo.core.frames import FloatArray
from laci_stereo.core.world import World
from laci_stereo.io.maps.lane_map import LaneLine

WORLD = World.around(48.4226, 9.9434)
CAPE_TOWN = World.around(-33.918, 18.423)


@dataclass(frozen=True)
class Line:
    """A line as it is drawn: Lanelet2's type and subtype, and points in the world."""

    kind: str
    subtype: str
    xy: FloatArray


def crossing() -> list[Line]:
    """Return the lines of two streets that cross: borders, lane lines, stop lines."""
    lines = []
    for turn in range(4):
        c, s = np.cos(turn * np.pi / 2 + 0.3), np.sin(turn * np.pi / 2 + 0.3)
        rotation = np.array([[c, -s], [s, c]])
        for kind, subtype, points in (
            ("line_thin", "dashed", [(8.0, 0.0), (25.0, 0.2), (60.0, 1.5)]),
            ("line_thin", "solid", [(8.0, 3.5), (60.0, 5.0)]),
            ("stop_line", "", [(8.0, 0.0), (8.0, -3.5)]),
            ("curbstone", "low", [(8.0, -3.6), (60.0, -2.1)]),
        ):
            lines.append(Line(kind, subtype, np.array(points) @ rotation.T))
    return lines


def utm(line: Line, world: World = WORLD) -> FloatArray:
    return world.to_utm(line.xy)


def degrees(line: Line, world: World = WORLD) -> FloatArray:
    """Return latitudes and longitudes."""
    return world.to_geodetic(line.xy)


def in_system(line: Line, crs: str, world: World = WORLD) -> FloatArray:
    to_system = Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    latitude, longitude = degrees(line, world).T.tolist()
    return np.array(to_system.transform(longitude, latitude)).T


def lanelet2(lines: Sequence[Line], world: World = WORLD, local_from: tuple[float, float] | None = None) -> str:
    """Write Lanelet2; with ``local_from``, without latitudes, and with local_x and local_y counted from there."""
    nodes, ways = [], []
    for i, line in enumerate(lines):
        ids = [f"{i}{j:03d}" for j in range(len(line.xy))]
        for n, (lat, lon), (east, north) in zip(ids, degrees(line, world), utm(line, world), strict=True):
            place = f"lat='{float(lat)!r}' lon='{float(lon)!r}'/>"
            if local_from is not None:
                x, y = float(east - local_from[0]), float(north - local_from[1])
                place = f"lat='' lon=''><tag k='local_x' v='{x!r}'/><tag k='local_y' v='{y!r}'/></node>"
            nodes.append(f"<node id='{n}' {place}")
        refs = "".join(f"<nd ref='{n}'/>" for n in ids)
        tags = f"<tag k='type' v='{line.kind}'/><tag k='subtype' v='{line.subtype}'/>"
        ways.append(f"<way id='w{i}'>{refs}{tags}</way>")
    return f"<osm version='0.6'>{''.join(nodes + ways)}</osm>"


def geojson(lines: Sequence[Line], crs: str | None = None, world: World = WORLD) -> str:
    features = [
        {
            "type": "Feature",
            "properties": {"type": line.kind, "subtype": line.subtype},
            "geometry": {
                "type": "LineString",
                "coordinates": (degrees(line, world)[:, ::-1] if crs is None else in_system(line, crs, world)).tolist(),
            },
        }
        for line in lines
    ]
    named = {} if crs is None else {"crs": {"type": "name", "properties": {"name": crs}}}
    return json.dumps({"type": "FeatureCollection", **named, "features": features})


def csv(lines: Sequence[Line], columns: str = "id,x,y,type,subtype", world: World = WORLD) -> str:
    geographic = "lat" in columns
    rows = [columns]
    for i, line in enumerate(lines):
        places = degrees(line, world) if geographic else utm(line, world)
        rows += [f"{i},{float(a)!r},{float(b)!r},{line.kind},{line.subtype}" for a, b in places]
    return "\n".join(rows) + "\n"


def dxf(lines: Sequence[Line], path: Path, world: World = WORLD, *, unit_m: float = 1.0, code: int = 6) -> None:
    """Write a drawing whose polylines are on layers named by type and subtype."""
    drawing = ezdxf.new(units=code)
    for line in lines:
        layer = f"{line.kind}-{line.subtype}".strip("-")
        drawing.modelspace().add_lwpolyline((utm(line, world) / unit_m).tolist(), dxfattribs={"layer": layer})
    text = StringIO()
    drawing.write(text)
    path.write_text(text.getvalue())


MARKS = {"solid": "solid", "dashed": "broken"}


def straight_roads(
    lines: Sequence[Line], reference: str = "+proj=utm +zone=32 +datum=WGS84", world: World = WORLD
) -> str:
    """Write OpenDRIVE: each line of two points as the middle of a road of its own."""
    east, north = world.origin_utm
    roads = []
    for i, line in enumerate(lines):
        start, end = utm(line, world) - [east, north]
        length, heading = float(np.hypot(*(end - start))), float(np.arctan2(*(end - start)[::-1]))
        mark = f"<roadMark sOffset='0' type='{MARKS[line.subtype]}' weight='standard'/>"
        roads.append(
            f"<road id='{i}' length='{length!r}'><planView><geometry s='0' x='{float(start[0])!r}' "
            f"y='{float(start[1])!r}' hdg='{heading!r}' length='{length!r}'><line/></geometry></planView>"
            f"<lanes><laneSection s='0'><center><lane id='0' type='none'>{mark}</lane></center>"
            "</laneSection></lanes></road>"
        )
    return opendrive("".join(roads), reference, (east, north, 0.0))


def opendrive(roads: str, reference: str | None = None, offset: tuple[float, float, float] | None = None) -> str:
    header = "" if reference is None else f"<geoReference><![CDATA[{reference}]]></geoReference>"
    if offset is not None:
        x, y, heading = offset
        header += f"<offset x='{x!r}' y='{y!r}' z='0' hdg='{heading!r}'/>"
    return f"<?xml version='1.0'?><OpenDRIVE><header revMajor='1' revMinor='7'>{header}</header>{roads}</OpenDRIVE>"


def assert_same(found: Sequence[LaneLine], lines: Sequence[Line], apart_m: float) -> None:
    assert [(each.kind, each.subtype) for each in found] == [(line.kind, line.subtype) for line in lines]
    for each, line in zip(found, lines, strict=True):
        np.testing.assert_allclose(each.xy, line.xy, rtol=0, atol=apart_m)
