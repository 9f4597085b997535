"""ASAM OpenDRIVE maps: the borders of lanes with their road marks, as lines."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from pyproj import CRS
from pyproj.exceptions import CRSError

from laci_stereo.core.errors import MapError
from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.io.maps.lines import MOST_POINTS, DrawnLine, DrawnMap
from laci_stereo.io.maps.road_geometry import (
    Bend,
    Cubic,
    GeometryError,
    ReferenceLine,
    parameters_of_lengths,
    polyline,
)
from laci_stereo.io.text_file import quoted

_STYLES = {"solid": "solid", "broken": "dashed"}
_THIN, _THICK = "line_thin", "line_thick"
_OTHER_KINDS = {"none": ("virtual", ""), "curb": ("curbstone", "high"), "edge": ("road_border", "")}


@dataclass(frozen=True)
class _Cubics:
    """A piecewise cubic along a road: the start of each piece, shape (n,), and its coefficients, shape (n, 4)."""

    starts: FloatArray
    coefficients: FloatArray

    def __call__(self, s: FloatArray) -> FloatArray:
        if not len(self.starts):
            return np.zeros(len(s))
        # The cubic is undefined before its first piece, which is extrapolated, as most readers do.
        owner = np.clip(np.searchsorted(self.starts, s, side="right") - 1, 0, None)
        a, b, c, d = self.coefficients[owner].T
        along = s - self.starts[owner]
        values: FloatArray = a + along * (b + along * (c + along * d))
        return values


@dataclass(frozen=True)
class _Lane:
    """A lane of a section: its number, its width or else its border, and its XML element."""

    number: int
    width: _Cubics
    border: _Cubics
    element: Element


@dataclass(frozen=True)
class _Section:
    """A part of a road with the same lanes, from ``start`` to ``end`` along the road, metres."""

    start: float
    end: float
    lanes: tuple[_Lane, ...]

    @cached_property
    def by_number(self) -> dict[int, _Lane]:
        return {lane.number: lane for lane in self.lanes}

    def offset(self, number: int, s: FloatArray) -> FloatArray:
        """Return the lateral offset of a lane's outer border from the lanes' centre, to the left, metres, (n,)."""
        side = int(math.copysign(1, number))
        left = np.zeros(len(s))
        for each in range(side, number + side, side) if number else ():
            lane = self.by_number.get(each)
            if lane is not None:
                left = lane.border(s) if len(lane.border.starts) else left + side * lane.width(s)
        return left


@dataclass(frozen=True)
class _Road:
    """A road: its name, its reference line, the lateral offset of its lanes' centre from that, and its sections."""

    name: str
    line: ReferenceLine
    middle: _Cubics
    sections: tuple[_Section, ...]


@np.errstate(over="ignore", invalid="ignore")  # overflowing values are refused as coordinates
def read_opendrive(path: Path, root: Element) -> DrawnMap:
    """Read the borders of all lanes of an OpenDRIVE map, split where their road marks change.

    Heights, superelevation, objects and signals are ignored.

    Raises
    ------
    MapError
        If the geometry of a road, or the header, is invalid, or the map is too large.
    """
    lines: list[DrawnLine] = []
    points = 0
    for road in root.iterfind("road"):
        name = road.get("id", "")
        try:
            found = list(_lines_of(_road(road)))
        except GeometryError as problem:
            raise MapError(f"{path}: road {quoted(name)} {problem}") from problem
        lines += found
        points += sum(len(line.xy) for line in found)
        if points > MOST_POINTS:
            raise MapError(f"{path}: its lines have more than {MOST_POINTS} points; needed is a smaller map")
    crs, notes = _reference(root)
    objects = sum(1 for _ in root.iterfind("road/objects/object"))
    if objects:
        notes += (f"{objects} objects left out; borders of lanes are used",)
    try:
        shifted = _shifted(tuple(lines), root)
    except GeometryError as problem:
        raise MapError(f"{path}: the header {problem}") from problem
    return DrawnMap(shifted, notes, crs)


def _reference(root: Element) -> tuple[str | None, tuple[str, ...]]:
    """Return the coordinate system that the header states, and a note if metric coordinates cannot be in it."""
    stated = (root.findtext("header/geoReference") or "").strip()
    if not stated:
        return None, ()
    try:
        geographic = CRS.from_user_input(stated).is_geographic
    except CRSError:
        geographic = False
    note = "its geoReference is a geographic system, which metres cannot be in, and was left aside"
    return (None, (note,)) if geographic else (stated, ())


def _shifted(lines: tuple[DrawnLine, ...], root: Element) -> tuple[DrawnLine, ...]:
    """Rotate and then translate the lines by the header's offset, in the order that the standard prescribes."""
    offset = root.find("header/offset")
    if offset is None:
        return lines
    x, y, heading = (_number(offset, key, 0.0) for key in ("x", "y", "hdg"))
    return tuple(replace(line, xy=rotate_xy(heading, line.xy) + np.array([x, y])) for line in lines)


def _road(road: Element) -> _Road:
    pieces = sorted((_piece(each) for each in road.iterfind("planView/geometry")), key=lambda piece: piece.start_m)
    if not pieces:
        raise GeometryError("has no geometry; needed is a planView")
    last = pieces[-1]
    length = _number(road, "length", last.start_m + last.length_m)
    line = ReferenceLine(tuple(pieces))
    middle = _cubics(road.iterfind("lanes/laneOffset"), "s", 0.0)
    return _Road(road.get("id", ""), line, middle, tuple(_sections(road, length)))


def _piece(geometry: Element) -> Bend | Cubic:
    start, x, y, heading, length = (_number(geometry, key) for key in ("s", "x", "y", "hdg", "length"))
    shape = next((child for child in geometry if child.tag in _SHAPES), None)
    if shape is None:
        tags = ", ".join(child.tag for child in geometry)[:80]
        raise GeometryError(f"has a geometry of {quoted(tags)}; needed is {', '.join(_SHAPES)}")
    if shape.tag in ("line", "arc", "spiral"):
        first, last = (_number(shape, key, 0.0) for key in ("curvStart", "curvEnd"))
        curvature = _number(shape, "curvature") if shape.tag == "arc" else first
        change = (last - first) / length if shape.tag == "spiral" and length > 0 else 0.0
        return Bend(start, (x, y), heading, length, curvature, change)
    if shape.tag == "poly3":
        u, v = np.array([0.0, 1.0, 0.0, 0.0]), _coefficients(shape, "")
        end = parameters_of_lengths(u, v, length)
    else:
        u, v = _coefficients(shape, "U"), _coefficients(shape, "V")
        end = length if shape.get("pRange") == "arcLength" else 1.0
    return Cubic(start, (x, y), heading, length, u, v, end / length if length > 0 else 0.0)


_SHAPES = ("line", "arc", "spiral", "poly3", "paramPoly3")


def _sections(road: Element, length: float) -> Iterator[_Section]:
    elements = sorted(road.iterfind("lanes/laneSection"), key=lambda each: _number(each, "s"))
    starts = [_number(each, "s") for each in elements]
    for element, start, end in zip(elements, starts, [*starts[1:], length], strict=True):
        lanes = [
            _Lane(
                _whole(lane, "id"),
                _cubics(lane.iterfind("width"), "sOffset", start),
                # A border is used only where there is no width.
                _cubics(() if lane.find("width") is not None else lane.iterfind("border"), "sOffset", start),
                lane,
            )
            for side in ("left", "center", "right")
            for lane in element.iterfind(f"{side}/lane")
        ]
        if end > start:
            yield _Section(start, end, tuple(lanes))


def _cubics(elements: Iterator[Element] | Sequence[Element], key: str, start: float) -> _Cubics:
    rows = sorted([start + _number(each, key), *_coefficients(each, "")] for each in elements)
    table = np.array(rows, dtype=np.float64).reshape(-1, 5)
    return _Cubics(table[:, 0], table[:, 1:])


def _coefficients(element: Element, suffix: str) -> FloatArray:
    return np.array([_number(element, f"{name}{suffix}", 0.0) for name in "abcd"])


def _lines_of(road: _Road) -> Iterator[DrawnLine]:
    for index, section in enumerate(road.sections):
        for lane in section.lanes:
            for number, (start, end, mark) in enumerate(_stretches(section, lane)):
                kind, subtype = _kind_of(mark)
                name = f"{road.name}/{index}/{lane.number}/{number}"
                yield DrawnLine(kind, subtype, _border(road, section, lane, start, end), name)


def _stretches(section: _Section, lane: _Lane) -> Iterator[tuple[float, float, Element | None]]:
    """Yield begin and end along the road, metres, of each road mark of a lane's border, and the mark's element."""
    marks = sorted(lane.element.iterfind("roadMark"), key=lambda each: _number(each, "sOffset", 0.0))
    starts = [section.start + _number(each, "sOffset", 0.0) for each in marks]
    if not starts or starts[0] > section.start:
        yield section.start, min([*starts, section.end]), None
    for mark, (start, end) in zip(marks, pairwise([*starts, section.end]), strict=True):
        if min(end, section.end) > start:
            yield start, min(end, section.end), mark


def _border(road: _Road, section: _Section, lane: _Lane, start: float, end: float) -> FloatArray:
    corners = [road.line.starts_m, road.middle.starts, *(each.width.starts for each in section.lanes)]
    inner = np.unique(np.concatenate([*corners, *(each.border.starts for each in section.lanes)]))
    breaks = np.concatenate([[start], inner[(inner > start) & (inner < end)], [end]])
    return polyline(partial(_beside, road, section, lane.number), breaks)


def _beside(road: _Road, section: _Section, number: int, s: FloatArray) -> FloatArray:
    return road.line.beside(s, road.middle(s) + section.offset(number, s))


def _kind_of(mark: Element | None) -> tuple[str, str]:
    """Return the Lanelet2 type and subtype of a road mark."""
    if mark is None:
        return "virtual", ""
    kind = mark.get("type", "none")
    if kind in _OTHER_KINDS:
        return _OTHER_KINDS[kind]
    styles = [_STYLES.get(word) for word in kind.split()]
    if not styles or None in styles:
        return kind, ""
    return _THICK if mark.get("weight") == "bold" else _THIN, "_".join(style for style in styles if style)


def _number(element: Element, key: str, missing: float | None = None) -> float:
    text = element.get(key)
    try:
        value = missing if text is None else float(text)
    except ValueError:
        value = None
    if value is None or not abs(value) < 1e12:
        raise GeometryError(f"has <{element.tag[:40]}> with {key} {quoted(str(text))}; needed is a number")
    return value


def _whole(element: Element, key: str) -> int:
    value = _number(element, key)
    if value != int(value) or abs(value) > 1000:
        raise GeometryError(f"has <{element.tag[:40]}> with {key} {value:g}; needed is a lane's number")
    return int(value)
