"""Logs of Cooperative Awareness Messages in CSV files, with the many ways in which people write them."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from laci_stereo.core.cam import CamLog
from laci_stereo.core.errors import CamError
from laci_stereo.core.frames import BoolArray, IntArray
from laci_stereo.io.cam_columns import (
    ALTITUDE,
    DIMENSIONS,
    ELLIPSE_ORIENTATION,
    HEADING,
    LATITUDE,
    LENGTH,
    LONGITUDE,
    POSITION,
    QUANTITIES,
    REQUIRED,
    SEMI_MAJOR,
    SEMI_MINOR,
    SPEED,
    WIDTH,
    Values,
    in_units,
)
from laci_stereo.io.cam_exchange import look_exchanged
from laci_stereo.io.cam_table import column_notes, numbers_of, station_ids
from laci_stereo.io.table import BAD_SHARE, Problems, Table, merged, read_table, stamps_ns

_NOWHERE_DEG = 1e-4
_SAME_PLACE_DEG = 1e-6


@dataclass(frozen=True)
class CamRecording:
    """A log of messages, and how its file was understood.

    Attributes
    ----------
    log : CamLog
        Of all stations, in the order of time.
    notes : tuple of str
        One line for each interpretation, and for what was left out or put right.
    """

    log: CamLog
    notes: tuple[str, ...]


def read_cam_csv(path: Path) -> CamRecording:
    """Read a log of messages with a header row.

    The columns are ``timestamp``, ``station_id``, ``latitude``, ``longitude``, ``heading``, ``speed``,
    ``vehicle_length`` and ``vehicle_width``, optionally ``altitude``, ``semi_major_95``, ``semi_minor_95`` and
    ``ellipse_orientation``; common synonyms are known. Raw ETSI integers are recognised for the whole file at once.

    Raises
    ------
    CamError
        If it cannot be read, lacks a column, more than a fifth of its rows or values are bad, it has no position at
        all, or latitude and longitude are exchanged.
    """
    table = read_table(path, REQUIRED, CamError, "message")
    stamps, stations = stamps_ns(table), station_ids(table)
    numbers = {quantity: numbers_of(table, quantity) for quantity in QUANTITIES}
    values, unit_notes = in_units({quantity: parsed.values for quantity, parsed in numbers.items()})
    values, zero_notes = _without_zeros(values)
    _check_sides(path, values)
    unread = merged(parsed.problems for parsed in numbers.values())
    problems = merged([table.problems, stamps.problems, stations.problems, unread, _misplaced(values)])
    skip_notes = table.skip_notes(problems)
    values, range_notes = _possible(table, values)
    good = np.array([i not in problems for i in range(len(table.rows))], dtype=bool)
    log, order_notes = _in_order(path, _log(stamps.values, stations.values, values)[good])
    position_notes = _check_positions(path, log)
    code_notes = [note for parsed in numbers.values() for note in parsed.notes]
    understood = (*column_notes(table), *stamps.notes, *stations.notes, *unit_notes, *code_notes, *zero_notes)
    return CamRecording(log, (*understood, *skip_notes, *range_notes, *order_notes, *position_notes))


def _without_zeros(values: Values) -> tuple[Values, list[str]]:
    """Take for missing what senders and loggers put where they know nothing: the position 0, 0 and the size 0."""
    nowhere = np.all([np.abs(values[quantity]) < _NOWHERE_DEG for quantity in POSITION], axis=0)
    notes = [f"{int(nowhere.sum())} positions are 0, 0; taken as missing"] if nowhere.any() else []
    kept = {
        **values,
        **{quantity: np.where(nowhere, np.nan, values[quantity]) for quantity in POSITION},
        **{quantity: np.where(values[quantity] == 0, np.nan, values[quantity]) for quantity in DIMENSIONS},
    }
    return kept, notes


def _check_sides(path: Path, values: Values) -> None:
    """Raise if latitudes are beyond what latitudes can be, and the longitudes are not."""
    latitude, longitude = (values[quantity][np.isfinite(values[quantity])] for quantity in POSITION)
    if len(latitude) == 0 or len(longitude) == 0:
        return
    latitude_deg, longitude_deg = float(np.median(latitude)), float(np.median(longitude))
    if LATITUDE.highest < abs(latitude_deg) <= LONGITUDE.highest and abs(longitude_deg) <= LATITUDE.highest:
        raise CamError(
            f"{path}: latitude and longitude look exchanged: they are {latitude_deg:.4f} and {longitude_deg:.4f} deg; "
            "needed is a latitude between -90 and 90 deg"
        )


def _misplaced(values: Values) -> Problems:
    return merged(
        {
            int(i): f"{quantity.name} is {values[quantity][i]:.10g} deg; "
            f"needed is {quantity.lowest:g} to {quantity.highest:g}"
            for i in np.flatnonzero(~quantity.possible(values[quantity]))
        }
        for quantity in POSITION
    )


def _possible(table: Table, values: Values) -> tuple[Values, list[str]]:
    """Return only values that the quantities can have; raise if too many have others."""
    notes = []
    for quantity, found in values.items():
        impossible = np.flatnonzero(~quantity.possible(found))
        if len(impossible) == 0 or quantity in POSITION:
            continue
        line_number, value = table.line_numbers[impossible[0]], found[impossible[0]]
        what = f"{quantity.name} is {value:.10g} {quantity.unit} in row {line_number}"
        needed = f"needed is {quantity.lowest:g} to {quantity.highest:g} {quantity.unit}"
        if len(impossible) > BAD_SHARE * np.isfinite(found).sum():
            raise CamError(f"{table.path}: {what} and the like in {len(impossible)} of {len(found)} rows; {needed}")
        notes.append(f"{len(impossible)} values taken as missing: {what}; {needed}")
    return {quantity: np.where(quantity.possible(found), found, np.nan) for quantity, found in values.items()}, notes


def _log(stamps: IntArray, stations: IntArray, values: Values) -> CamLog:
    return CamLog(
        stamps_ns=stamps,
        station_id=stations,
        latitude_deg=values[LATITUDE],
        longitude_deg=values[LONGITUDE],
        heading_deg=values[HEADING] % 360.0,
        speed_mps=values[SPEED],
        altitude_m=values[ALTITUDE],
        length_m=values[LENGTH],
        width_m=values[WIDTH],
        semi_major_95_m=values[SEMI_MAJOR],
        semi_minor_95_m=values[SEMI_MINOR],
        ellipse_orientation_deg=values[ELLIPSE_ORIENTATION],
    )


def _in_order(path: Path, log: CamLog) -> tuple[CamLog, list[str]]:
    """Sort the messages by time and merge those of one station at one time."""
    late = int((log.stamps_ns < np.maximum.accumulate(log.stamps_ns)).sum())
    log = _reordered(log, np.lexsort((log.station_id, log.stamps_ns)))
    repeats = np.zeros(len(log), dtype=bool)
    repeats[1:] = (np.diff(log.stamps_ns) == 0) & (np.diff(log.station_id) == 0)
    moved = repeats & _differs_from_before(log)
    if moved.sum() > BAD_SHARE * len(log):
        raise CamError(
            f"{path}: timestamp and station_id are those of another row in {int(repeats.sum())} of {len(log)} rows, "
            f"but {int(moved.sum())} have another position; needed is the time of each message, to the millisecond"
        )
    notes = [f"{late} rows out of order sorted"] if late else []
    if repeats.any():
        notes.append(f"{int(repeats.sum())} doubled rows merged")
    return _merge_repeats(log, repeats), notes


def _differs_from_before(log: CamLog) -> BoolArray:
    differs = np.zeros(len(log), dtype=bool)
    for values in (log.latitude_deg, log.longitude_deg):
        differs[1:] |= np.abs(np.diff(values)) > _SAME_PLACE_DEG
    return differs


def _merge_repeats(log: CamLog, repeats: BoolArray) -> CamLog:
    """Keep the first of messages that repeat, and take what it lacks from those that follow."""
    first = np.maximum.accumulate(np.where(repeats, 0, np.arange(len(log))))
    columns = []
    for field in fields(log):
        values = getattr(log, field.name).copy()
        for i in np.flatnonzero(repeats):
            # Only numbers can be NaN; times and stations of repeats are equal anyway.
            if np.isnan(values[first[i]]):
                values[first[i]] = values[i]
        columns.append(values)
    return CamLog(*columns)[~repeats]


def _reordered(log: CamLog, order: IntArray) -> CamLog:
    return CamLog(*(getattr(log, field.name)[order] for field in fields(log)))


def _check_positions(path: Path, log: CamLog) -> list[str]:
    """Return a note on messages without a position; raise if none has one, or all have it exchanged."""
    missing = int((np.isnan(log.latitude_deg) | np.isnan(log.longitude_deg)).sum())
    if missing == len(log):
        raise CamError(f"{path} holds no position: all of {missing} rows lack it; needed are at least 2")
    if look_exchanged(log):
        raise CamError(
            f"{path}: latitude and longitude look exchanged: as they are ({np.nanmedian(log.latitude_deg):.4f} and "
            f"{np.nanmedian(log.longitude_deg):.4f} deg) they do not move as heading and speed say, exchanged they do"
        )
    return [f"{missing} rows without position"] if missing else []
