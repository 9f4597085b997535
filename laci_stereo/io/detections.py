"""Detections in CSV files, with the column names and units found in practice."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from laci_stereo.core.detections import DetectionLog
from laci_stereo.core.errors import DetectionError
from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.io.table import (
    BAD_SHARE,
    TIMESTAMP,
    Column,
    Problems,
    Table,
    is_missing,
    merged,
    plain_name,
    read_table,
    stamps_ns,
)
from laci_stereo.io.text_file import listed


@dataclass(frozen=True)
class Measure(Column):
    """A column of numbers, possible if greater than ``above`` and at most ``highest``."""

    unit: str
    above: float
    highest: float

    @property
    def possible(self) -> str:
        """The range in words."""
        return f"more than {self.above:g} and at most {self.highest:g} {self.unit}"

    def told(self, value: float) -> str:
        """Return a value in words."""
        return f"{self.name} is {value:.10g} {self.unit}"


_FAR_M = 1000.0
"""Beyond the range of any roadside sensor; map coordinates are larger."""

X = Measure("x", ("xm", "posx", "positionx", "centerx", "centrex", "cx", "tx", "locationx"), "m", -_FAR_M, _FAR_M)
Y = Measure("y", ("ym", "posy", "positiony", "centery", "centrey", "cy", "ty", "locationy"), "m", -_FAR_M, _FAR_M)
Z = Measure("z", ("zm", "posz", "positionz", "centerz", "centrez", "cz", "tz", "locationz"), "m", -_FAR_M, _FAR_M)
YAW = Measure(
    "yaw",
    (
        *("yawrad", "yawdeg", "yawdegrees", "heading", "headingrad", "headingdeg", "orientation", "orientationdeg"),
        *("rotationz", "rotz", "rotationy", "roty", "ry", "rotation", "theta", "angle"),
    ),
    *("rad", -math.inf, math.inf),
)
LENGTH = Measure("length", ("lengthm", "l", "sizex", "dx", "dimx", "dimensionx"), "m", 0.0, 60.0)
WIDTH = Measure("width", ("widthm", "w", "sizey", "dy", "dimy", "dimensiony"), "m", 0.0, 6.1)
HEIGHT = Measure("height", ("heightm", "h", "sizez", "dz", "dimz", "dimensionz"), "m", 0.0, 6.0)
RADIAL_SPEED = Measure(
    "radial_speed",
    ("radialspeedmps", "radialvelocity", "radialvel", "doppler", "dopplermps", "rangerate", "vr", "vradial"),
    *("m/s", -130.0, 130.0),
)
TRACK_ID = Column("track_id", ("trackid", "track", "id", "objectid", "objid", "object", "trackingid", "instanceid"))

REQUIRED: tuple[Column, ...] = (TIMESTAMP, X, Y)
MEASURES = (X, Y, Z, YAW, LENGTH, WIDTH, HEIGHT, RADIAL_SPEED)
COLUMNS: tuple[Column, ...] = (TIMESTAMP, *MEASURES, TRACK_ID)
POSITION = (X, Y, Z)


@dataclass(frozen=True)
class DetectionRecording:
    """A log of detections, with notes on how its file was interpreted.

    Attributes
    ----------
    log : DetectionLog
        Its ``above_ground_m`` is the height of the boxes' centres.
    notes : tuple of str
        One line for each interpretation, and for each kind of row or value that was left out or corrected.
    no_height : str
        Why no box has a height; empty if one has.
    """

    log: DetectionLog
    notes: tuple[str, ...]
    no_height: str


def read_detections(path: Path) -> DetectionRecording:
    """Read a log of detections with a header row.

    The columns are ``timestamp``, ``x`` and ``y``, optionally ``z``, ``yaw``, ``length``, ``width``, ``height``,
    ``track_id`` and ``radial_speed``; common synonyms are recognised. Yaw in degrees is recognised for the whole file.

    Raises
    ------
    DetectionError
        If the file cannot be read, lacks a column, more than a fifth of its rows are bad, or, in more than a fifth, an
        object is at another position at the same time.
    """
    table = read_table(path, REQUIRED, DetectionError, "detection")
    stamps = stamps_ns(table)
    numbers = {measure: table.numbers(measure) for measure in MEASURES}
    values = {measure: parsed.values for measure, parsed in numbers.items()}
    unread = merged(parsed.problems for parsed in numbers.values())
    problems = merged([table.problems, stamps.problems, unread, _misplaced(table, values)])
    skip_notes = table.skip_notes(problems)
    values, range_notes = _possible(table, values)
    yaw, yaw_notes = _in_radians(table, values[YAW])
    good = np.array([row not in problems for row in range(len(table.rows))])
    found = DetectionLog(
        stamps_ns=stamps.values,
        points_sensor=np.column_stack([values[measure] for measure in POSITION]),
        above_ground_m=values[HEIGHT] / 2,
        yaw_rad=yaw,
        length_m=values[LENGTH],
        width_m=values[WIDTH],
        track_id=_track_ids(table),
        radial_mps=values[RADIAL_SPEED],
    )[good]
    found, number_notes = _without_row_numbers(found)
    log, order_notes = _in_order(path, found)
    notes = (*_column_notes(table), *stamps.notes, *yaw_notes, *skip_notes, *range_notes, *number_notes, *order_notes)
    unnumbered = ["no track_id; detections are linked by their motion"] if (log.track_id < 0).all() else []
    return DetectionRecording(log, (*notes, *unnumbered), _no_height(table, log, numbers[HEIGHT].values))


def _column_notes(table: Table) -> list[str]:
    """Return notes on columns that were recognised by a synonym, and on unused columns."""
    places = {column: column.find(table.header) for column in COLUMNS}
    used = {place for place in places.values() if place is not None}
    unused = [title for place, title in enumerate(table.header) if place not in used and title]
    read = [
        f"column {listed([table.header[place]])} read as {column.name}"
        for column, place in places.items()
        if place is not None and plain_name(table.header[place]) != plain_name(column.name)
    ]
    return [*read, f"columns not used: {listed(unused)}"] if unused else read


def _misplaced(table: Table, values: Mapping[Measure, FloatArray]) -> Problems:
    """Return the rows whose position is missing or out of range."""
    problems = {}
    for measure in POSITION:
        if measure.find(table.header) is None:
            continue
        for row in np.flatnonzero(~(np.abs(values[measure]) <= measure.highest)):
            value = values[measure][row]
            found = "missing" if np.isnan(value) else f"{value:.10g} m"
            problems[int(row)] = (
                f"{measure.name} is {found}; needed is {-measure.highest:g} to {measure.highest:g} m from the sensor"
            )
    return problems


def _possible(table: Table, values: Mapping[Measure, FloatArray]) -> tuple[dict[Measure, FloatArray], list[str]]:
    """Replace values out of range by NaN, such as size 0 for an unknown one; return them with notes on these values."""
    kept, notes = dict(values), []
    for measure in (LENGTH, WIDTH, HEIGHT, RADIAL_SPEED):
        found = values[measure]
        impossible = np.flatnonzero((found <= measure.above) | (found > measure.highest))
        if len(impossible):
            what = f"{measure.told(found[impossible[0]])} in row {table.line_numbers[impossible[0]]}"
            notes.append(f"{len(impossible)} values taken as missing: {what}; needed is {measure.possible}")
            kept[measure] = np.where((found > measure.above) & (found <= measure.highest), found, np.nan)
    return kept, notes


def _no_height(table: Table, log: DetectionLog, told_m: FloatArray) -> str:
    """Return why no detection has a height, empty if one has."""
    if np.isfinite(log.above_ground_m).any():
        return ""
    told = np.flatnonzero(np.isfinite(told_m))
    if not len(told):
        return "lacks height"
    row = table.line_numbers[told[0]]
    return f"holds no possible height: {HEIGHT.told(told_m[told[0]])} in row {row}, possible is {HEIGHT.possible}"


def _in_radians(table: Table, yaw: FloatArray) -> tuple[FloatArray, list[str]]:
    """Convert yaw from degrees if the column's title says so, or too many values exceed two turns in radians.

    Of headings in degrees all but those within 12.6 deg of x do. Radians exceed one turn by rounding, and two nowhere:
    a tracker that does not begin anew at a full turn adds one to a vehicle that turns.
    """
    place = YAW.find(table.header)
    known = np.abs(yaw[np.isfinite(yaw)])
    if place is None or not len(known):
        return yaw, []
    titled = plain_name(table.header[place]).endswith(("deg", "degrees"))
    if titled or np.mean(known > 4 * math.pi) > BAD_SHARE:
        return np.radians(yaw), [f"yaw: degrees (up to {known.max():.4g})"]
    beyond = int((known > 2 * math.pi).sum())
    some = f"yaw: radians, although {beyond} of {len(known)} values exceed a full turn (up to {known.max():.4g})"
    return yaw, [f"{some}; degrees need the title yaw_deg"] if beyond else []


def _track_ids(table: Table) -> IntArray:
    """Return a number for each track name of the detector, -1 where it is missing, shape (n,)."""
    texts = [text.lower() for text in table.texts(TRACK_ID) or [""] * len(table.rows)]
    _, numbers = np.unique(np.array(texts), return_inverse=True)
    return np.where([is_missing(text) for text in texts], -1, numbers.reshape(-1)).astype(np.int64)


def _without_row_numbers(log: DetectionLog) -> tuple[DetectionLog, list[str]]:
    """Ignore track numbers of which none is there at a second time: they number rows instead of objects."""
    known = log.track_id >= 0
    times = np.unique(np.column_stack([log.track_id, log.stamps_ns])[known], axis=0)
    count = len(np.unique(log.track_id[known]))
    if count < 2 or len(times) > count:
        return log, []
    note = f"track_id: not used, as none of its {count} values is there at a second time, as those of objects are"
    return replace(log, track_id=np.full(len(log), -1, dtype=np.int64)), [note]


def _in_order(path: Path, log: DetectionLog) -> tuple[DetectionLog, list[str]]:
    """Sort detections by time; drop repeated ones, and all but the first of a track at one time."""
    late = int((log.stamps_ns < np.maximum.accumulate(log.stamps_ns)).sum())
    log = log[np.argsort(log.stamps_ns, kind="stable")]
    places = np.nan_to_num(log.points_sensor).view(np.int64)
    once = log[_firsts(np.column_stack([log.stamps_ns, log.track_id, places]))]
    # Each detection without a track number is its own track here.
    own = np.where(once.track_id >= 0, once.track_id, -1 - np.arange(len(once)))
    single = once[_firsts(np.column_stack([once.stamps_ns, own]))]
    doubled, moved = len(log) - len(once), len(once) - len(single)
    if moved > BAD_SHARE * len(log):
        raise DetectionError(
            f"{path}: timestamp and track_id are those of another row in {moved} of {len(log)} rows, but the position "
            "is another; needed is one row for each object and time"
        )
    notes = [f"{late} rows out of order sorted"] if late else []
    notes += [f"{doubled} doubled rows dropped"] if doubled else []
    notes += [f"{moved} rows dropped whose object is elsewhere at the same time"] if moved else []
    return single, notes


def _firsts(keys: IntArray) -> IntArray:
    """Return the index of the first occurrence of each key, shape (n, k), ascending."""
    return np.sort(np.unique(keys, axis=0, return_index=True)[1])
