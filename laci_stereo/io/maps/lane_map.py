"""Lane maps: the lines of a map's file, in the world frame."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pyproj import Geod

from laci_stereo.core.errors import MapError
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.world import World
from laci_stereo.io.file_content import read_content
from laci_stereo.io.maps.csv_map import read_csv_map
from laci_stereo.io.maps.dxf import read_dxf
from laci_stereo.io.maps.geojson import read_geojson
from laci_stereo.io.maps.lanelet2 import read_lanelet2
from laci_stereo.io.maps.lines import FARTHEST_M, DrawnLine, DrawnMap, parse_map_frame, to_degrees
from laci_stereo.io.maps.opendrive import read_opendrive
from laci_stereo.io.safe_xml import XmlError, parse_xml
from laci_stereo.io.text_file import listed, text_in

MAP_FILES = ("map.osm", "map.geojson", "map.xodr", "map.dxf", "map.csv")
FORMATS = "Lanelet2 (.osm), OpenDRIVE (.xodr), GeoJSON, DXF or CSV"

_WGS84 = Geod(ellps="WGS84")
_DXF = re.compile(rb"AutoCAD Binary DXF|(\s*999[^\n]*\n[^\n]*\n)*\s*0\s*\n\s*SECTION\s")


@dataclass(frozen=True)
class LaneLine:
    """A line of a lane map.

    Attributes
    ----------
    kind : str
        Lanelet2's type, such as ``line_thin``, ``curbstone``, ``stop_line`` or ``virtual``; empty if there is none.
    subtype : str
        Such as ``solid`` or ``dashed``; empty if there is none.
    xy : ndarray, shape (n, 2)
        At least two points, world frame.
    id : str
        Its identifier in the file.
    """

    kind: str
    subtype: str
    xy: FloatArray
    id: str


@dataclass(frozen=True)
class LaneMap:
    """The lines of a lane map, and notes on all parts of its file that are not among them."""

    lines: tuple[LaneLine, ...]
    notes: tuple[str, ...]


def find_lane_map(recording: Path) -> Path | None:
    """Return the map beside a folder of left images or scans, or beside a file; None if there is none."""
    beside = recording.absolute().parent
    return next((beside / name for name in MAP_FILES if (beside / name).is_file()), None)


def read_lane_map(path: Path, to_world: World, crs: str | None = None) -> LaneMap:
    """Read a lane map; its format is recognised by its content.

    Parameters
    ----------
    path : Path
        Lanelet2, OpenDRIVE, GeoJSON, DXF or CSV.
    to_world : World
    crs : str or None
        The map's coordinate system where the file does not state it, such as ``EPSG:25832``, or ``EPSG:25832@E,N`` for
        coordinates relative to E, N. None: the world's, if the lines then lie near the track.

    Raises
    ------
    MapError
        If the map cannot be read, holds no lines, or lies more than 5 km from the world's origin.
    SettingError
        If ``crs`` is unknown.
    """
    asked = None if crs is None else parse_map_frame(crs)
    drawn = to_degrees(path, _with_lines(path, _read(path, prefer_local=asked is not None)), to_world, asked)
    _check_near(path, drawn.lines, to_world)
    return LaneMap(tuple(_in_world(line, to_world) for line in drawn.lines), drawn.notes)


def _read(path: Path, *, prefer_local: bool) -> DrawnMap:
    content = read_content(path, MapError)
    if _DXF.match(content[:2000]):
        return read_dxf(path)
    text = text_in(content, path, MapError)
    start = text.lstrip()[:1]
    if start in ("{", "["):
        return read_geojson(path, text)
    if start == "<":
        return _read_xml(path, text, prefer_local=prefer_local)
    if re.search("[,;\t]", text.lstrip().partition("\n")[0]):
        return read_csv_map(path)
    raise MapError(f"{path} is no map that is known; needed is {FORMATS}")


def _read_xml(path: Path, text: str, *, prefer_local: bool) -> DrawnMap:
    try:
        root = parse_xml(text)
    except XmlError as problem:
        raise MapError(f"{path} is neither Lanelet2 (.osm) nor OpenDRIVE (.xodr): {problem}") from problem
    if root.tag == "OpenDRIVE":
        return read_opendrive(path, root)
    if root.tag == "osm":
        return read_lanelet2(path, root, prefer_local=prefer_local)
    raise MapError(f"{path} is XML of <{root.tag[:40]}>; needed is Lanelet2 (<osm>) or OpenDRIVE (<OpenDRIVE>)")


def _with_lines(path: Path, drawn: DrawnMap) -> DrawnMap:
    """Drop lines of fewer than two points."""
    lines = tuple(line for line in drawn.lines if len(line.xy) > 1)
    if not lines:
        raise MapError(f"{path} holds no lines; needed are lane lines ({listed(list(drawn.notes)) or 'it is empty'})")
    short = len(drawn.lines) - len(lines)
    notes = (*drawn.notes, f"{short} lines of less than two points left out") if short else drawn.notes
    return DrawnMap(lines, notes, drawn.crs)


def _in_world(line: DrawnLine, world: World) -> LaneLine:
    longitude, latitude = line.xy.T
    return LaneLine(line.kind, line.subtype, world.from_geodetic(latitude, longitude), line.id)


def _check_near(path: Path, lines: tuple[DrawnLine, ...], world: World) -> None:
    latitude, longitude = world.to_geodetic(np.zeros((1, 2)))[0]
    positions = np.concatenate([line.xy for line in lines])
    here = np.tile([longitude, latitude], (len(positions), 1))
    _, _, distances = _WGS84.inv(here[:, 0], here[:, 1], positions[:, 0], positions[:, 1])
    nearest = int(np.argmin(distances))
    if distances[nearest] > FARTHEST_M:
        raise MapError(
            f"{path} is {distances[nearest] / 1000:.1f} km away from the track ({latitude:.5f}, {longitude:.5f}): its "
            f"nearest point is {positions[nearest, 1]:.5f}, {positions[nearest, 0]:.5f}; needed is a map within "
            f"{FARTHEST_M / 1000:g} km"
        )
