"""Lane maps: the lines that Lanelet2 and GeoJSON files hold, in the world frame."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeGuard
from xml.etree.ElementTree import Element

import numpy as np
from pyproj import Geod, Transformer
from pyproj.exceptions import ProjError

from laci_stereo.core.errors import MapError
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.world import World
from laci_stereo.io.safe_xml import XmlError, parse_xml
from laci_stereo.io.stamps import number
from laci_stereo.io.text_file import listed, quoted, read_text

MAP_FILES = ("map.osm", "map.geojson")
FARTHEST_M = 5000.0

_DEEPEST = 20
_LARGEST = 1e9
_NESTING: Mapping[str, int] = {"LineString": 0, "MultiLineString": 1, "Polygon": 1, "MultiPolygon": 2}
_COLLECTIONS: Mapping[object, str] = {"FeatureCollection": "features", "GeometryCollection": "geometries"}
_WGS84 = Geod(ellps="WGS84")


@dataclass(frozen=True)
class LaneLine:
    """A line of a lane map.

    Attributes
    ----------
    kind : str
        Lanelet2's type, such as ``line_thin``, ``curbstone``, ``stop_line`` or ``virtual``; empty if it has none.
    subtype : str
        Such as ``solid`` or ``dashed``; empty if it has none.
    xy : ndarray, shape (n, 2)
        At least two points in the world.
    id : str
        Its name in the file.
    """

    kind: str
    subtype: str
    xy: FloatArray
    id: str


@dataclass(frozen=True)
class LaneMap:
    """The lines of a lane map, and a note on everything in its file that is none of them."""

    lines: tuple[LaneLine, ...]
    notes: tuple[str, ...]


def find_lane_map(left_folder: Path) -> Path | None:
    """Return the map that lies beside the folder of left images, if there is one."""
    beside = left_folder.absolute().parent
    return next((beside / name for name in MAP_FILES if (beside / name).is_file()), None)


def read_lane_map(path: Path, to_world: World) -> LaneMap:
    """Read a Lanelet2 map (``.osm``) or GeoJSON; which of them it is, its first character tells.

    Raises
    ------
    MapError
        If it cannot be read, holds no lines, or lies more than 5 km from the world's origin.
    """
    text = read_text(path, MapError)
    geodetic = _read_geojson(path, text) if text.lstrip()[:1] in ("{", "[") else _read_lanelet2(path, text)
    lines = [line for line in geodetic.lines if len(line.positions_deg) > 1]
    if not lines:
        raise MapError(
            f"{path} holds no lines; needed are lane lines ({listed(list(geodetic.notes)) or 'it is empty'})"
        )
    _check_near(path, lines, to_world)
    short = len(geodetic.lines) - len(lines)
    notes = (*geodetic.notes, f"{short} lines of less than two points left out") if short else geodetic.notes
    return LaneMap(tuple(line.in_world(to_world) for line in lines), notes)


@dataclass(frozen=True)
class _GeodeticLine:
    """A line before it comes into the world: longitudes and latitudes (WGS84), shape (n, 2)."""

    kind: str
    subtype: str
    positions_deg: FloatArray
    id: str

    def in_world(self, world: World) -> LaneLine:
        longitude, latitude = self.positions_deg.T
        return LaneLine(self.kind, self.subtype, world.from_geodetic(latitude, longitude), self.id)


@dataclass(frozen=True)
class _GeodeticMap:
    lines: tuple[_GeodeticLine, ...]
    notes: tuple[str, ...]


def _check_near(path: Path, lines: list[_GeodeticLine], world: World) -> None:
    latitude, longitude = world.to_geodetic(np.zeros((1, 2)))[0]
    positions = np.concatenate([line.positions_deg for line in lines])
    here = np.tile([longitude, latitude], (len(positions), 1))
    _, _, distances = _WGS84.inv(here[:, 0], here[:, 1], positions[:, 0], positions[:, 1])
    nearest = int(np.argmin(distances))
    if distances[nearest] > FARTHEST_M:
        raise MapError(
            f"{path} is {distances[nearest] / 1000:.1f} km away from the track ({latitude:.5f}, {longitude:.5f}): its "
            f"nearest point is {positions[nearest, 1]:.5f}, {positions[nearest, 0]:.5f}; needed is a map within "
            f"{FARTHEST_M / 1000:g} km"
        )


def _read_lanelet2(path: Path, text: str) -> _GeodeticMap:
    try:
        root = parse_xml(text)
    except XmlError as problem:
        raise MapError(f"{path} is neither Lanelet2 (.osm) nor GeoJSON: {problem}") from problem
    if root.tag != "osm":
        raise MapError(f"{path} is XML of <{root.tag[:40]}>; needed is Lanelet2 (<osm>) or GeoJSON")
    nodes = {node.get("id", ""): _node_position(path, node) for node in root.iterfind("node")}
    if nodes and not any(nodes.values()):
        raise MapError(
            f"{path}: none of {len(nodes)} nodes has lat and lon{_local_hint(root)}; needed are geographic coordinates"
        )
    lines, lost = [], 0
    for way in root.iterfind("way"):
        found = [nodes.get(reference.get("ref", "")) for reference in way.iterfind("nd")]
        positions = [position for position in found if position is not None]
        lost += len(found) - len(positions)
        tags = {tag.get("k", ""): tag.get("v", "") for tag in way.iterfind("tag")}
        points = np.array(positions, dtype=np.float64).reshape(-1, 2)
        lines.append(_GeodeticLine(tags.get("type", ""), tags.get("subtype", ""), points, way.get("id", "")))
    notes = (f"{lost} points of lines have no position in the file, left out",) if lost else ()
    return _GeodeticMap(tuple(lines), notes)


def _node_position(path: Path, node: Element) -> tuple[float, float] | None:
    """Return a node's longitude and latitude, or None if it has none, which maps with local coordinates write as 0."""
    longitude, latitude = (node.get(key) or "0" for key in ("lon", "lat"))
    values = tuple(number(text) for text in (longitude, latitude))
    if not all(value is not None and abs(value) <= limit for value, limit in zip(values, (180, 90), strict=True)):
        raise MapError(
            f"{path}: node {quoted(node.get('id', ''))} is at lat {quoted(latitude)}, lon {quoted(longitude)}; needed "
            "are degrees"
        )
    return (float(longitude), float(latitude)) if any(values) else None


def _local_hint(root: Element) -> str:
    if not any(tag.get("k") == "local_x" for tag in root.iterfind("node/tag")):
        return ""
    return ", only local_x and local_y, and where these begin the file does not say"


@dataclass(frozen=True)
class _Shape:
    """A geometry in a GeoJSON file, with the properties of its feature."""

    kind: str
    coordinates: object
    properties: Mapping[str, object]
    id: str


def _read_geojson(path: Path, text: str) -> _GeodeticMap:
    try:
        root = json.loads(text)
        shapes = list(_shapes(root, {}, "", 0))
    except (ValueError, RecursionError) as problem:
        raise MapError(f"{path} is no GeoJSON: {problem}; needed is well-formed JSON") from problem
    to_wgs84 = _to_wgs84(path, root)
    lines = []
    for i, shape in enumerate(shapes):
        name = shape.id or str(i)
        kind, subtype = (str(shape.properties.get(key) or "") for key in ("type", "subtype"))
        if shape.kind in _NESTING:
            for points in _polylines(shape.coordinates, _NESTING[shape.kind]):
                positions = _degrees(path, name, points, to_wgs84)
                lines.append(_GeodeticLine(kind, subtype, positions, name))
    others = Counter(shape.kind for shape in shapes if shape.kind not in _NESTING)
    notes = tuple(f"{count} of type {quoted(kind)} left out; lines are used" for kind, count in others.items())
    return _GeodeticMap(tuple(lines), notes)


def _shapes(node: object, properties: Mapping[str, object], name: str, depth: int) -> Iterator[_Shape]:
    if depth > _DEEPEST:
        raise ValueError(f"it nests deeper than {_DEEPEST} levels")
    if not isinstance(node, dict):
        return
    kind = node.get("type")
    if kind == "Feature":
        inner = node.get("properties")
        name = str(node.get("id") or name)
        yield from _shapes(node.get("geometry"), inner if isinstance(inner, dict) else {}, name, depth + 1)
    elif kind in _COLLECTIONS:
        members = node.get(_COLLECTIONS[kind])
        for member in members if isinstance(members, list) else []:
            yield from _shapes(member, properties, name, depth + 1)
    else:
        yield _Shape(str(kind), node.get("coordinates"), properties, name)


def _polylines(coordinates: object, nesting: int) -> Iterator[object]:
    if nesting == 0:
        yield coordinates
    elif isinstance(coordinates, list):
        for inner in coordinates:
            yield from _polylines(inner, nesting - 1)


def _degrees(path: Path, name: str, points: object, to_wgs84: Transformer | None) -> FloatArray:
    """Return the positions of a line as longitudes and latitudes, shape (n, 2)."""
    positions = [position for position in points if _is_position(position)] if isinstance(points, list) else []
    if not isinstance(points, list) or len(positions) < len(points):
        raise MapError(f"{path}: line {quoted(name)} has coordinates {quoted(str(points))}; needed are [[x, y], ...]")
    xy = np.array([position[:2] for position in positions], dtype=np.float64).reshape(-1, 2)
    if to_wgs84 is not None:
        xy = np.column_stack(to_wgs84.transform(*xy.T.tolist()))
    off = np.flatnonzero(~((np.abs(xy[:, 0]) <= 180) & (np.abs(xy[:, 1]) <= 90)))
    if len(off):
        raise MapError(
            f"{path}: line {quoted(name)} has a point at {quoted(str(positions[off[0]]))}; needed are longitude and "
            "latitude in degrees, or a member crs that says what else"
        )
    return xy


def _is_position(position: object) -> TypeGuard[list[float]]:
    return (
        isinstance(position, list)
        and len(position) >= 2
        and all(type(value) in (int, float) and abs(value) < _LARGEST for value in position[:2])
    )


def _to_wgs84(path: Path, root: object) -> Transformer | None:
    """Return the way out of the coordinate system that a file names, as GeoJSON did before 2016."""
    crs = root.get("crs") if isinstance(root, dict) else None
    if crs is None:
        return None
    properties = crs.get("properties") if isinstance(crs, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    try:
        return Transformer.from_crs(str(name), "EPSG:4326", always_xy=True)
    except ProjError as problem:
        raise MapError(
            f"{path}: crs is {quoted(str(name))}; needed is a name that PROJ knows, as EPSG:25832"
        ) from problem
