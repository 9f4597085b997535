"""Lanes of a Lanelet2 map: the lines that bound each lane, and its direction of travel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from laci_stereo.core.errors import MapError
from laci_stereo.core.frames import FloatArray, along_line
from laci_stereo.io.file_content import read_content
from laci_stereo.io.maps.lane_map import LaneMap
from laci_stereo.io.maps.lanelet2 import tags_of
from laci_stereo.io.safe_xml import XmlError, parse_xml
from laci_stereo.io.text_file import text_in

FOR_PEOPLE = frozenset({"crosswalk", "walkway", "shared_walkway", "stairs"})
"""Subtypes of lanelets that no vehicle drives on."""

STEP_M = 1.0
"""Spacing of points along a lane: in a bend with a radius of 10 m, the chord deviates by 1 cm from the arc."""


@dataclass(frozen=True)
class Lane:
    """A lane between its two boundaries, in the world frame.

    Attributes
    ----------
    id : str
        Identifier of the relation in the file.
    left, right : ndarray, shape (n, 2)
        Boundaries in the direction of travel, sampled at the same fractions of their lengths; n >= 2.
    one_way : bool
        Whether traffic drives in this direction only.
    """

    id: str
    left: FloatArray
    right: FloatArray
    one_way: bool

    @property
    def centre(self) -> FloatArray:
        """The centre line, shape (n, 2)."""
        middle: FloatArray = (self.left + self.right) / 2
        return middle


def read_lanelets(path: Path, lane_map: LaneMap) -> tuple[Lane, ...]:
    """Read the lanes that a map's lines bound.

    Parameters
    ----------
    path : Path
        The map's file. Maps in other formats than Lanelet2 have no lanes.
    lane_map : LaneMap
        The map that was read from this file: its lines have the identifiers of the file's ways.

    Returns
    -------
    tuple of Lane
        The lanes for vehicles whose boundaries are in the map.

    Raises
    ------
    MapError
        If the file cannot be read.
    """
    content = read_content(path, MapError)
    if not content.lstrip().startswith(b"<"):
        return ()
    try:
        root = parse_xml(text_in(content, path, MapError))
    except XmlError:
        return ()
    lines = {line.id: line.xy for line in lane_map.lines}
    found = (_lane(relation, lines) for relation in root.iterfind("relation"))
    return tuple(lane for lane in found if lane is not None)


def _lane(relation: Element, lines: dict[str, FloatArray]) -> Lane | None:
    tags = tags_of(relation)
    if tags.get("type") != "lanelet" or tags.get("subtype", "") in FOR_PEOPLE:
        return None
    sides = []
    for role in ("left", "right"):
        members = [member.get("ref", "") for member in relation.iterfind("member") if member.get("role") == role]
        if not members or not all(member in lines for member in members):
            return None
        sides.append(_joined([lines[member] for member in members]))
    return lane_between(relation.get("id", ""), sides[0], sides[1], one_way=tags.get("one_way", "yes") != "no")


def lane_between(name: str, left: FloatArray, right: FloatArray, *, one_way: bool) -> Lane | None:
    """Return the lane between two boundaries, shape (n, 2) each, which may run in either direction.

    The lane's direction is the one that has the left boundary on its left. None if a boundary has no length.
    """
    if np.linalg.norm(left[[0, -1]] - right[[0, -1]], axis=1).sum() > (
        np.linalg.norm(left[[0, -1]] - right[[-1, 0]], axis=1).sum()
    ):
        right = right[::-1]
    longest = max(_length_m(left), _length_m(right))
    if min(_length_m(left), _length_m(right)) == 0.0:
        return None
    count = int(np.ceil(longest / STEP_M)) + 1
    left, right = _resampled(left, count), _resampled(right, count)
    along, across = np.diff((left + right) / 2, axis=0), ((left - right)[1:] + (left - right)[:-1]) / 2
    if (along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]).sum() < 0.0:
        left, right = left[::-1], right[::-1]
    return Lane(name, left, right, one_way)


def _joined(pieces: Sequence[FloatArray]) -> FloatArray:
    """Join pieces of a boundary, shape (n, 2) each, end to end, each reversed if its end is nearer to the last one."""
    line, *others = pieces
    if others and _gap(line[-1], others[0]) > _gap(line[0], others[0]):
        line = line[::-1]
    for piece in others:
        turned = np.linalg.norm(piece[-1] - line[-1]) < np.linalg.norm(piece[0] - line[-1])
        line = np.concatenate([line, piece[::-1] if turned else piece])
    return line


def _gap(end: FloatArray, piece: FloatArray) -> float:
    return float(np.linalg.norm(piece[[0, -1]] - end, axis=1).min())


def _length_m(line: FloatArray) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def _resampled(line: FloatArray, count: int) -> FloatArray:
    """Return ``count`` points at equal distances along a line, shape (count, 2)."""
    along = along_line(line)
    places = np.linspace(0.0, along[-1], count)
    return np.column_stack([np.interp(places, along, line[:, axis]) for axis in (0, 1)])
