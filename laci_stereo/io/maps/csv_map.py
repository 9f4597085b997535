"""Lane maps in CSV tables: a row for each point, in the order of its line."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from laci_stereo.core.errors import MapError
from laci_stereo.core.frames import FloatArray
from laci_stereo.io.maps.lines import GEODETIC, DrawnLine, DrawnMap
from laci_stereo.io.table import TIMESTAMP, Column, Table, merged, read_table
from laci_stereo.io.text_file import listed

ID = Column("id", ("lineid", "line", "wayid", "way", "polyline", "polylineid", "featureid", "feature", "fid", "name"))
X = Column(
    "x", ("east", "easting", "e", "xm", "eastm", "eastingm", "utmx", "utmeast", "utme", "xutm", "xcoord", "localx")
)
Y = Column(
    "y", ("north", "northing", "n", "ym", "northm", "northingm", "utmy", "utmnorth", "utmn", "yutm", "ycoord", "localy")
)
LATITUDE = Column("latitude", ("lat", "latdeg", "latitudedeg", "latwgs84", "wgs84lat"))
LONGITUDE = Column("longitude", ("lon", "lng", "long", "londeg", "longitudedeg", "lonwgs84", "wgs84lon"))
KIND = Column("type", ("kind", "layer", "linetype"))
HEADING = Column("heading", ())
SUBTYPE = Column("subtype", ("style", "linestyle"))


def read_csv_map(path: Path) -> DrawnMap:
    """Read polylines from columns of x and y, or latitude and longitude, and of the name of each point's line.

    Raises
    ------
    MapError
        If the file cannot be read, lacks a column, or is the log of a drive.
    """
    table = read_table(path, (), MapError, "point")
    if TIMESTAMP.find(table.header) is not None and HEADING.find(table.header) is not None:
        raise MapError(
            f"{path} has the columns timestamp and heading, as a log of messages; needed is a map: id, x and y, or id, "
            "latitude and longitude"
        )
    pair = next(
        (pair for pair in ((LONGITUDE, LATITUDE), (X, Y)) if all(c.find(table.header) is not None for c in pair)), None
    )
    if pair is None:
        raise MapError(
            f"{path} names the columns {listed(table.header)}; needed are id, x and y, or id, latitude and longitude"
        )
    columns = [table.numbers(column) for column in pair]
    xy = np.column_stack([column.values for column in columns])
    empty = {int(i): f"{pair[0].name} or {pair[1].name} is missing" for i in np.flatnonzero(np.isnan(xy).any(axis=1))}
    problems = merged([table.problems, *(column.problems for column in columns), empty])
    notes = tuple(table.skip_notes(problems))
    lines = _lines(table, xy, set(problems))
    return DrawnMap(lines, notes, GEODETIC if pair[0] is LONGITUDE else None)


def _lines(table: Table, xy: FloatArray, bad: set[int]) -> tuple[DrawnLine, ...]:
    """Return the points with the same name as a line, in the order of the rows."""
    blank = [""] * len(xy)
    names, kinds, subtypes = (table.texts(column) or blank for column in (ID, KIND, SUBTYPE))
    rows: dict[str, list[int]] = {}
    for i, name in enumerate(names):
        if i not in bad:
            rows.setdefault(name, []).append(i)
    return tuple(DrawnLine(kinds[of[0]], subtypes[of[0]], xy[of], name) for name, of in rows.items())
