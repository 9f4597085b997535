"""Lane maps in GeoJSON: lines and outlines of areas, with Lanelet2's ``type`` and ``subtype`` as properties."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeGuard

import numpy as np

from laci_stereo.core.errors import MapError
from laci_stereo.core.frames import FloatArray
from laci_stereo.io.maps.lines import GEODETIC, LARGEST, DrawnLine, DrawnMap
from laci_stereo.io.text_file import quoted

WIDEST_DEG = 10.0
"""Largest extent of a lane map in degrees, wider than most countries: with larger numbers, a map is in metres."""

_DEEPEST = 20
_NESTING: Mapping[str, int] = {"LineString": 0, "MultiLineString": 1, "Polygon": 1, "MultiPolygon": 2}
_COLLECTIONS: Mapping[object, str] = {"FeatureCollection": "features", "GeometryCollection": "geometries"}


@dataclass(frozen=True)
class _Shape:
    """A geometry of a GeoJSON file, with the properties and identifier of its feature."""

    kind: str
    coordinates: object
    properties: Mapping[str, object]
    id: str


def read_geojson(path: Path, text: str) -> DrawnMap:
    """Read the lines of a GeoJSON file.

    The standard requires degrees. Until 2016 it allowed other systems, named in a member ``crs``; where that is missing
    and the numbers cannot be degrees, or as degrees would make a map that is as large as a country, the coordinate
    system is unknown.

    Raises
    ------
    MapError
        If the text is no GeoJSON.
    """
    try:
        root = json.loads(text)
        shapes = list(_shapes(root, {}, "", 0))
    except (ValueError, RecursionError) as problem:
        raise MapError(f"{path} is no GeoJSON: {problem}; needed is well-formed JSON") from problem
    lines = []
    for i, shape in enumerate(shapes):
        name = shape.id or str(i)
        kind, subtype = (str(shape.properties.get(key) or "") for key in ("type", "subtype"))
        if shape.kind in _NESTING:
            for points in _polylines(shape.coordinates, _NESTING[shape.kind]):
                lines.append(DrawnLine(kind, subtype, _positions(path, name, points), name))
    others = Counter(shape.kind for shape in shapes if shape.kind not in _NESTING)
    notes = tuple(f"{count} of type {quoted(kind)} left out; lines are used" for kind, count in others.items())
    return DrawnMap(tuple(lines), notes, _crs(root, lines))


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
    elif isinstance(kind, str) and kind in _COLLECTIONS:
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


def _positions(path: Path, name: str, points: object) -> FloatArray:
    """Return the positions of a line, shape (n, 2)."""
    positions = [position for position in points if _is_position(position)] if isinstance(points, list) else []
    if not isinstance(points, list) or len(positions) < len(points):
        raise MapError(f"{path}: line {quoted(name)} has coordinates {quoted(str(points))}; needed are [[x, y], ...]")
    return np.array([position[:2] for position in positions], dtype=np.float64).reshape(-1, 2)


def _is_position(position: object) -> TypeGuard[list[float]]:
    return (
        isinstance(position, list)
        and len(position) >= 2
        and all(type(value) in (int, float) and abs(value) < LARGEST for value in position[:2])
    )


def _crs(root: object, lines: list[DrawnLine]) -> str | None:
    crs = root.get("crs") if isinstance(root, dict) else None
    if crs is not None:
        properties = crs.get("properties") if isinstance(crs, dict) else None
        name = str(properties.get("name") if isinstance(properties, dict) else None)
        return GEODETIC if name.upper().endswith((":CRS84", "EPSG:4326", "EPSG::4326")) else name
    positions = np.concatenate([np.zeros((0, 2)), *(line.xy for line in lines)])
    if not len(positions):
        return GEODETIC
    wide, high = np.ptp(positions, axis=0)
    as_large = min(wide, 360.0 - wide) > WIDEST_DEG or high > WIDEST_DEG  # a map may lie on both sides of 180 deg
    return None if as_large or (np.abs(positions) > (180.0, 90.0)).any() else GEODETIC
