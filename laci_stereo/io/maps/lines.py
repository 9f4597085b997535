"""Lines of a map in the coordinate system of its file, and their conversion to longitude and latitude."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError

from laci_stereo.core.errors import MapError, SettingError
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.world import World
from laci_stereo.io.text_file import listed, quoted

FARTHEST_M = 5000.0
"""Largest distance from the track: a map whose nearest point is farther away is of another place."""

GEODETIC = "EPSG:4326"
"""WGS84; in map files, longitude precedes latitude, in degrees."""

LARGEST = 1e9
"""Largest coordinate, degrees or metres: larger ones are a mistake in any coordinate system."""

MOST_POINTS = 5_000_000
"""Most points in a map: some 10,000 km of road; each point takes 16 bytes."""

_COUNTED_FROM = re.compile(r"(.+?)@([+-]?\d+(?:\.\d*)?),([+-]?\d+(?:\.\d*)?)", re.DOTALL)


@dataclass(frozen=True)
class DrawnLine:
    """A line in the coordinates of its file.

    Attributes
    ----------
    kind, subtype : str
        Lanelet2's; empty if there is none.
    xy : ndarray, shape (n, 2)
        In the map's coordinate system: east before north, longitude before latitude.
    id : str
    """

    kind: str
    subtype: str
    xy: FloatArray
    id: str


@dataclass(frozen=True)
class DrawnMap:
    """The lines of a file, notes on parts of it that were left out, and the coordinate system if the file states it."""

    lines: tuple[DrawnLine, ...]
    notes: tuple[str, ...]
    crs: str | None


@dataclass(frozen=True)
class MapFrame:
    """A user's statement about a map's coordinates: their system, and the point in it that they are relative to."""

    crs: CRS
    origin: tuple[float, float]


def parse_map_frame(text: str) -> MapFrame:
    """Parse ``CRS`` or ``CRS@E,N``, where CRS is any text that PROJ accepts.

    Raises
    ------
    SettingError
        If PROJ does not know the system.
    """
    counted = _COUNTED_FROM.fullmatch(text)
    name, origin = (counted[1], (float(counted[2]), float(counted[3]))) if counted else (text, (0.0, 0.0))
    try:
        return MapFrame(CRS.from_user_input(name), origin)
    except CRSError as error:
        raise SettingError(
            f"--map-crs is {quoted(text)}; needed is a coordinate system that PROJ knows, as EPSG:25832, or with "
            "@E,N where the map's coordinates are counted from"
        ) from error


def to_degrees(path: Path, drawn: DrawnMap, world: World, asked: MapFrame | None) -> DrawnMap:
    """Convert the lines of a map to longitude and latitude (WGS84).

    Their coordinate system is the one that the file states, else the one that the user states (``asked``), else the
    world's, provided that the lines then lie near the track.

    Raises
    ------
    MapError
        If the system is unknown, or a coordinate is invalid in it.
    """
    check_numbers(path, drawn.lines)
    crs, origin, note = _system(path, drawn, world, asked)
    try:
        transformer = Transformer.from_crs(crs, GEODETIC, always_xy=True)
    except ProjError as problem:
        raise MapError(f"{path}: coordinate system {quoted(str(crs))} cannot be used: {problem}") from problem
    lines = []
    for line in drawn.lines:
        x, y = (line.xy + np.array(origin)).T.tolist()
        degrees = np.array(transformer.transform(x, y), dtype=np.float64).reshape(2, -1).T
        off = np.flatnonzero(~((np.abs(degrees[:, 0]) <= 180) & (np.abs(degrees[:, 1]) <= 90)))
        if len(off):
            raise MapError(
                f"{path}: line {quoted(line.id)} has a point at {quoted(str(line.xy[off[0]].tolist()))}; needed are "
                f"{'longitude and latitude in degrees' if drawn.crs == GEODETIC else 'coordinates in ' + crs.name}"
            )
        lines.append(DrawnLine(line.kind, line.subtype, degrees, line.id))
    return DrawnMap(tuple(lines), (*drawn.notes, *note), GEODETIC)


def check_numbers(path: Path, lines: tuple[DrawnLine, ...]) -> None:
    """Raise if a coordinate is not finite, or too large for any coordinate system.

    Raises
    ------
    MapError
    """
    for line in lines:
        off = np.flatnonzero(~(np.abs(line.xy) < LARGEST).all(axis=1))  # true for NaN, too
        if len(off):
            raise MapError(
                f"{path}: line {quoted(line.id)} has a point at {quoted(str(line.xy[off[0]].tolist()))}; needed are "
                "coordinates in degrees or metres"
            )


def _system(
    path: Path, drawn: DrawnMap, world: World, asked: MapFrame | None
) -> tuple[CRS, tuple[float, float], tuple[str, ...]]:
    """Return the lines' coordinate system, the origin of their coordinates in it, and notes on how these are known."""
    if drawn.crs == GEODETIC:
        return CRS(GEODETIC), (0.0, 0.0), ()
    if drawn.crs is not None:
        crs = _known(path, drawn.crs)
        aside = "; --map-crs was left aside" if asked is not None and asked.crs != crs else ""
        name = drawn.crs if crs.name == "unknown" else crs.name
        return crs, (0.0, 0.0), (f"the map's coordinates are {listed([name])}, as the file says{aside}",)
    if asked is not None:
        counted = f" counted from {asked.origin[0]:.12g}, {asked.origin[1]:.12g}" if any(asked.origin) else ""
        return asked.crs, asked.origin, (f"the map's coordinates are {asked.crs.name}{counted}, as --map-crs says",)
    if _within_reach(drawn, world):
        note = f"the map does not say its coordinate system; {world.crs} fits, for its lines lie near the track"
        return CRS(world.crs), (0.0, 0.0), (note,)
    x, y = drawn.lines[0].xy[0] if drawn.lines and len(drawn.lines[0].xy) else (0.0, 0.0)
    raise MapError(
        f"{path} does not say its coordinate system, and {x:.9g}, {y:.9g} is not near the track in {world.crs}; needed "
        "is --map-crs EPSG:..., or --map-crs EPSG:...@E,N where they are counted from"
    )


def _known(path: Path, name: str) -> CRS:
    try:
        # Heights are not used, and the geoid grids that they require are seldom installed.
        return CRS.from_user_input(re.sub(r"\+(geoidgrids|vunits)=\S+", "", name).strip())
    except CRSError as problem:
        raise MapError(f"{path}: crs is {quoted(name)}; needed is a name that PROJ knows, as EPSG:25832") from problem


def _within_reach(drawn: DrawnMap, world: World) -> bool:
    points = [line.xy for line in drawn.lines if len(line.xy)]
    if not points:
        return True
    return bool(np.linalg.norm(world.from_utm(np.concatenate(points)), axis=1).min() <= FARTHEST_M)
