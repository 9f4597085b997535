"""A log of messages as CSV in the canonical columns, which `read_cam_csv` reads back unchanged, and as GeoJSON."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

import numpy as np

from laci_stereo.core.messages.cam import CamLog
from laci_stereo.io.cam.columns import ANTENNA, COLUMNS, FIELDS, POSITION, POSITION_OF
from laci_stereo.io.stamps import iso_text


def to_csv(log: CamLog, *, of_antenna: bool = False) -> str:
    """Return the log as CSV in the canonical columns: numbers with all digits, empty cells where a value is missing.

    With ``of_antenna``, a further column marks the positions as those of an antenna, so that a reader does not take
    them for positions of the CAM reference point.
    """
    values = [getattr(log, field).tolist() for field in FIELDS.values()]
    constant = {POSITION_OF: ANTENNA} if of_antenna else {}
    lines = [",".join(column.name for column in (*COLUMNS, *constant))]
    for stamp, station, *row in zip(log.stamps_ns.tolist(), log.station_id.tolist(), *values, strict=True):
        cells = ("" if math.isnan(value) else repr(value) for value in row)
        lines.append(",".join((f"{stamp // 10**9}.{stamp % 10**9:09d}", str(station), *cells, *constant.values())))
    return "\n".join(lines) + "\n"


def to_geojson(log: CamLog) -> str:
    """Return a line for each station, and a point with the other values as properties for each message's position."""
    log = log[np.isfinite(log.latitude_deg) & np.isfinite(log.longitude_deg)]
    places = np.column_stack([log.longitude_deg, log.latitude_deg]).tolist()
    lines: dict[int, list[list[float]]] = {}
    for station, place in zip(log.station_id.tolist(), places, strict=True):
        lines.setdefault(station, []).append(place)
    features = [
        _feature("LineString", line, {"station_id": station, "messages": len(line)})
        for station, line in lines.items()
        if len(line) > 1
    ]
    columns = [
        (quantity.name, getattr(log, field).tolist()) for quantity, field in FIELDS.items() if quantity not in POSITION
    ]
    for i, (stamp, station) in enumerate(zip(log.stamps_ns.tolist(), log.station_id.tolist(), strict=True)):
        known = {name: column[i] for name, column in columns if not math.isnan(column[i])}
        features.append(_feature("Point", places[i], {"timestamp": iso_text(stamp), "station_id": station, **known}))
    return json.dumps({"type": "FeatureCollection", "features": features}, indent=1) + "\n"


def _feature(kind: str, coordinates: Sequence[object], properties: dict[str, object]) -> dict[str, object]:
    return {"type": "Feature", "geometry": {"type": kind, "coordinates": coordinates}, "properties": properties}
