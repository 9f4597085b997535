"""Lanelet2 maps: OpenStreetMap XML, with positions in degrees or in local metres."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from laci_stereo.core.errors import MapError
from laci_stereo.io.maps.lines import GEODETIC, DrawnLine, DrawnMap
from laci_stereo.io.stamps import number
from laci_stereo.io.text_file import quoted

_Positions = Mapping[str, "tuple[float, float] | None"]


def read_lanelet2(path: Path, root: Element, *, prefer_local: bool) -> DrawnMap:
    """Read the ways of a map; ``prefer_local``: by ``local_x`` and ``local_y`` where nodes have both these and degrees.

    Raises
    ------
    MapError
        If a node's position is invalid, or no node has a position.
    """
    nodes = {node.get("id", ""): _degrees(path, node) for node in root.iterfind("node")}
    local = {node.get("id", ""): _local(path, node) for node in root.iterfind("node")}
    in_degrees, in_metres = (any(positions.values()) for positions in (nodes, local))
    if nodes and not in_degrees and not in_metres:
        raise MapError(
            f"{path}: none of {len(nodes)} nodes has lat and lon, or local_x and local_y; needed are positions"
        )
    if in_metres and (prefer_local or not in_degrees):
        note = "the map's positions are its local_x and local_y" + ("; lat and lon were left aside" * in_degrees)
        return _ways(root, local, (note,), None)
    note = "the map's positions are its lat and lon; local_x and local_y were left aside"
    return _ways(root, nodes, (note,) if in_metres else (), GEODETIC)


def _ways(root: Element, nodes: _Positions, notes: tuple[str, ...], crs: str | None) -> DrawnMap:
    lines, lost = [], 0
    for way in root.iterfind("way"):
        found = [nodes.get(reference.get("ref", "")) for reference in way.iterfind("nd")]
        positions = [position for position in found if position is not None]
        lost += len(found) - len(positions)
        tags = tags_of(way)
        points = np.array(positions, dtype=np.float64).reshape(-1, 2)
        lines.append(DrawnLine(tags.get("type", ""), tags.get("subtype", ""), points, way.get("id", "")))
    if lost:
        notes += (f"{lost} points of lines have no position in the file, left out",)
    return DrawnMap(tuple(lines), notes, crs)


def tags_of(element: Element) -> dict[str, str]:
    """Return the tags of a node, a way or a relation."""
    return {tag.get("k", ""): tag.get("v", "") for tag in element.iterfind("tag")}


def _degrees(path: Path, node: Element) -> tuple[float, float] | None:
    """Return a node's longitude and latitude; None if missing or 0, as written by maps with local coordinates."""
    longitude, latitude = (node.get(key) or "0" for key in ("lon", "lat"))
    values = tuple(number(text) for text in (longitude, latitude))
    if not all(value is not None and abs(value) <= limit for value, limit in zip(values, (180, 90), strict=True)):
        raise MapError(
            f"{path}: node {quoted(node.get('id', ''))} is at lat {quoted(latitude)}, lon {quoted(longitude)}; needed "
            "are degrees"
        )
    return (float(longitude), float(latitude)) if any(values) else None


def _local(path: Path, node: Element) -> tuple[float, float] | None:
    tags = tags_of(node)
    texts = [tags.get(key) for key in ("local_x", "local_y")]
    if None in texts:
        return None
    values = [number(text or "") for text in texts]
    if None in values:
        raise MapError(
            f"{path}: node {quoted(node.get('id', ''))} has local_x, local_y {quoted(str(texts))}; needed are metres"
        )
    return float(texts[0] or 0), float(texts[1] or 0)
