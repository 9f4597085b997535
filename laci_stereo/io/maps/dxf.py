"""Lane maps in DXF: lines, polylines, arcs and splines in model space, with their layers as types."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from laci_stereo.core.errors import MapError
from laci_stereo.io.maps.lines import LARGEST, MOST_POINTS, DrawnLine, DrawnMap
from laci_stereo.io.maps.road_geometry import CHORD_M
from laci_stereo.io.text_file import listed, quoted

EXTRA = "python3 -m pip install 'laci-stereo[dxf]'"

LINES = ("LINE", "LWPOLYLINE", "POLYLINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE")

_LANELET2 = {"", "line_thin", "line_thick", "stop_line", "pedestrian_marking", "bike_marking", "keepout", "virtual"} | {
    *("curbstone", "road_border", "guard_rail", "wall", "fence", "zebra_marking", "jersey_barrier", "rail"),
}

_METRES = {0: 1.0, 1: 0.0254, 2: 0.3048, 4: 0.001, 5: 0.01, 6: 1.0, 7: 1000.0, 14: 0.1}
"""Metres per drawing unit, by the code in the header's $INSUNITS; unspecified units (0) are metres."""


def read_dxf(path: Path) -> DrawnMap:
    """Read the lines in a drawing's model space.

    A layer that is named like a Lanelet2 type, or like type and subtype with a hyphen between them, such as
    ``line_thin-dashed``, determines the type of its lines.

    Raises
    ------
    MapError
        If ezdxf is not installed, or the file is no valid drawing.
    """
    code, entities = _model(path)
    if code not in _METRES:
        raise MapError(f"{path}: the drawing's unit ($INSUNITS) is {quoted(str(code))}; needed is metres (6)")
    lines: list[DrawnLine] = []
    left_out, points = Counter[str](), 0
    for entity in entities:
        if entity.dxftype() not in LINES:
            left_out[entity.dxftype()] += 1
            continue
        kind, subtype = _tags(str(entity.dxf.get("layer", "0")))
        for xy in _polylines(path, entity, _METRES[code]):
            points += len(xy)
            if points > MOST_POINTS:
                raise MapError(f"{path}: its lines have more than {MOST_POINTS} points; needed is a smaller map")
            lines.append(DrawnLine(kind, subtype, xy, str(entity.dxf.get("handle", len(lines)))))
    notes = [f"{count} of type {kind} left out; lines are used" for kind, count in left_out.items()]
    unknown = sorted({line.kind for line in lines} - _LANELET2)
    if unknown:
        notes.append(f"lines on the layers {listed(unknown)} are only drawn; names of layers are Lanelet2's types")
    if code not in (0, 6):
        notes.append(f"the drawing's unit is {_METRES[code]:g} m, as its header says")
    return DrawnMap(tuple(lines), tuple(notes), None)


def _model(path: Path) -> tuple[Any, list[Any]]:
    """Return a drawing's unit code and entities; any exception of ezdxf means that the drawing is damaged."""
    try:
        from ezdxf.filemanagement import readfile
    except ImportError as missing:
        raise MapError(f"{path} is a DXF drawing; needed to read it is {EXTRA}") from missing
    logging.getLogger("ezdxf").setLevel(logging.ERROR)
    try:
        drawing = readfile(path)
        return drawing.header.get("$INSUNITS", 0), list(drawing.modelspace())
    except Exception as problem:
        raise MapError(f"{path} is no whole DXF drawing: {_one_line(problem)}; needed is one") from problem


def _one_line(problem: Exception) -> str:
    return listed([f"{type(problem).__name__} {problem}"])


def _tags(layer: str) -> tuple[str, str]:
    kind, _, subtype = layer.partition("-")
    return ("" if layer == "0" else kind), subtype


def _polylines(path: Path, entity: Any, unit_m: float) -> Iterator[np.ndarray[Any, np.dtype[np.float64]]]:
    """Yield the polylines that an entity consists of, in metres, shape (n, 2)."""
    try:
        _check_size(entity, LARGEST / unit_m)
        parts = [_vertices(part) * unit_m for part in _parts(entity, CHORD_M / unit_m)]
    except Exception as problem:
        handle = quoted(str(entity.dxf.get("handle", "")))
        raise MapError(f"{path}: {entity.dxftype()} {handle} cannot be drawn: {_one_line(problem)}") from problem
    for part in parts:
        if len(part) and not (np.abs(part) < LARGEST).all():
            raise MapError(f"{path}: {entity.dxftype()} reaches {np.abs(part).max():.3g}; needed are metres")
        yield part


def _parts(entity: Any, chord: float) -> Iterator[Iterable[Any]]:
    kind = entity.dxftype()
    if kind == "LINE":
        yield entity.dxf.start, entity.dxf.end
    elif kind == "LWPOLYLINE":
        points = [tuple(point) for point in entity.get_points("xyb")]
        yield entity.ocs().points_to_wcs((x, y, 0.0) for x, y in _bulged(points, chord, closed=entity.closed))
    elif kind != "POLYLINE":
        yield entity.flattening(chord)
    elif entity.is_2d_polyline or entity.is_3d_polyline:
        places = [(vertex.dxf.location, vertex.dxf.get("bulge", 0.0)) for vertex in entity.vertices]
        flat = _bulged([(place.x, place.y, bulge) for place, bulge in places], chord, closed=entity.is_closed)
        yield entity.ocs().points_to_wcs((x, y, 0.0) for x, y in flat)


def _check_size(entity: Any, largest: float) -> None:
    """Raise if a curve is so large that flattening it would take forever."""
    attributes = entity.dxf.all_existing_dxf_attribs()
    sizes = [attributes.get("radius", 0.0), *attributes.get("major_axis", ())]
    sizes += [value for point in getattr(entity, "control_points", ()) for value in point]
    if not all(abs(size) < largest for size in sizes):
        raise ValueError("it is larger than any map")


def _bulged(points: list[tuple[float, float, float]], error: float, *, closed: bool) -> Iterator[tuple[float, float]]:
    """Yield a polyline's vertices, and points on its arcs; a bulge is the tangent of a quarter of an arc's angle."""
    following = points[1:] + (points[:1] if closed else [])
    for (x, y, bulge), (to_x, to_y, _) in zip(points, following, strict=False):
        yield x, y
        if abs(bulge) > 1e-9:
            start, across = complex(x, y), complex(to_x - x, to_y - y)
            centre = start + across / 2.0 + 1j * across * (1.0 - bulge**2) / (4.0 * bulge)
            turn = 4.0 * np.arctan(bulge)
            step = 2.0 * np.arccos(max(1.0 - error / max(abs(start - centre), error), 0.0))
            steps = int(np.ceil(abs(turn) / step))
            for i in range(1, min(steps, 10_000)):
                place = centre + (start - centre) * np.exp(1j * turn * i / steps)
                yield float(place.real), float(place.imag)
    if following:
        yield following[-1][0], following[-1][1]


def _vertices(points: Iterable[Any]) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([(point[0], point[1]) for point in points], dtype=np.float64).reshape(-1, 2)
