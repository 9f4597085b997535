"""The columns of a table of messages: station numbers, and quantities with ETSI's codes for missing values."""

from __future__ import annotations

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, IntArray
from laci_stereo.io.cam.columns import COLUMNS, DRIVE_DIRECTION, GENERATION_DELTA, MOTION, STATION_ID, Quantity
from laci_stereo.io.cam.its_time import DELTA_PERIOD_MS, generation_times
from laci_stereo.io.stamps import number
from laci_stereo.io.table import Column, Parsed, Table, is_missing
from laci_stereo.io.text_file import quoted

_DIRECTIONS = {"forward": False, "backward": True, "unavailable": False, "0": False, "1": True, "2": False}
"""Whether each value of ETSI's DriveDirection is backwards."""


def column_notes(table: Table) -> list[str]:
    """Return notes on columns that were recognised by a synonym, and on missing heading and speed columns."""
    places = {column: column.find(table.header) for column in COLUMNS}
    notes = [
        f"column {table.header[place]} read as {column.name}"
        for column, place in places.items()
        if place is not None and table.header[place] != column.name
    ]
    lacking = [f"no column {each.name}; it follows from the positions" for each in MOTION if places[each] is None]
    return notes + lacking


def station_ids(table: Table) -> Parsed[IntArray]:
    """Return the station that sent each message; without such a column, all are from station 0."""
    texts = table.texts(STATION_ID)
    if texts is None or all(is_missing(text) for text in texts):
        note = "no station_id; all rows are taken for those of one station, 0"
        return Parsed(np.zeros(len(table.rows), dtype=np.int64), {}, (note,))
    ids = [_whole(text) for text in texts]
    if "station" not in _title(table, STATION_ID).lower() and len(set(ids)) == len(ids) > 1:
        note = f"column {_title(table, STATION_ID)} numbers the rows, so it is no station_id: all are of one station, 0"
        return Parsed(np.zeros(len(table.rows), dtype=np.int64), {}, (note,))
    problems = {
        i: f"station_id is {quoted(text)}; needed is a whole number below 2^63"
        for i, (text, station) in enumerate(zip(texts, ids, strict=True))
        if station is None
    }
    return Parsed(np.array([station or 0 for station in ids], dtype=np.int64), problems)


def generated(table: Table, stamps: Parsed[IntArray], stations: IntArray) -> Parsed[IntArray]:
    """Return the messages' times of generation, where a column `GENERATION_DELTA` tells them beside the reception."""
    texts = table.texts(GENERATION_DELTA)
    if texts is None:
        return stamps
    good = [i for i in range(len(texts)) if i not in stamps.problems]
    deltas_ms = [_whole(texts[i]) for i in good]
    known = [delta_ms for delta_ms in deltas_ms if delta_ms is not None and 0 <= delta_ms < DELTA_PERIOD_MS]
    if len(known) < len(good) or (len(set(known)) < 2 and len(good) > 1):
        note = f"{GENERATION_DELTA.name} is not used: needed are numbers from 0 to {DELTA_PERIOD_MS - 1} that change"
        return Parsed(stamps.values, stamps.problems, (*stamps.notes, note))
    values = stamps.values.copy()
    values[good], notes = generation_times(stamps.values[good], np.array(known, dtype=np.int64), stations[good])
    return Parsed(values, stamps.problems, (*stamps.notes, *notes))


def backwards(table: Table) -> tuple[BoolArray | None, list[str]]:
    """Return in which rows a vehicle reports to drive backwards, shape (n,), None without such a column, and notes."""
    texts = table.texts(DRIVE_DIRECTION)
    if texts is None:
        return None, []
    told = [text.lower().removesuffix(".0") for text in texts]
    unread = [text for text in told if text not in _DIRECTIONS and not is_missing(text)]
    note = (
        f"{DRIVE_DIRECTION.name} is {quoted(unread[0])} and the like in {len(unread)} rows: taken as unavailable; "
        "needed is forward, backward or unavailable, or 0, 1 or 2"
        if unread
        else ""
    )
    return np.array([_DIRECTIONS.get(text, False) for text in told], dtype=bool), [note] if note else []


def numbers_of(table: Table, quantity: Quantity) -> Parsed[FloatArray]:
    """Return a quantity's numbers in the unit of the file: NaN if missing, infinite as `in_units` expects."""
    found = table.numbers(quantity)
    known, notes = found.values, []
    for meaning, code in quantity.codes.items():
        coded = quantity.is_code(found.values, code)
        known = np.where(coded, np.nan, known)
        if coded.any():
            times = f"{int(coded.sum())} times {code}"
            notes.append(f'{quantity.name}: {times}, ETSI\'s "{meaning}"; taken as missing')
    if quantity.is_at_least and quantity.out_of_range is not None:
        beyond = quantity.is_code(found.values, quantity.out_of_range)
        known = np.where(beyond, np.inf, known)
        if beyond.any():
            times = f"{int(beyond.sum())} times {quantity.out_of_range}"
            least = f"{quantity.least_beyond:g} {quantity.unit}"
            notes.append(f'{quantity.name}: {times}, ETSI\'s "out of range"; taken as {least}, the least that it means')
    return Parsed(known, found.problems, tuple(notes))


def _title(table: Table, column: Column) -> str:
    place = column.find(table.header)
    return "" if place is None else table.header[place]


def _whole(text: str) -> int | None:
    value = number(text)
    return int(value) if value is not None and -(2**63) <= value < 2**63 and value % 1 == 0 else None
