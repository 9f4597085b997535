"""The common last step of all readers: raw messages to a `CamLog` without missing, impossible or repeated values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from laci_stereo.core.errors import CamError
from laci_stereo.core.frames import BoolArray, IntArray
from laci_stereo.core.messages.cam import CamLog
from laci_stereo.io.cam.columns import (
    AXES,
    DIMENSIONS,
    FIELDS,
    HEADING,
    LATITUDE,
    LENGTH,
    LONGITUDE,
    POSITION,
    QUANTITIES,
    SPEED,
    WIDTH,
    Values,
)
from laci_stereo.io.cam.direction import turned_back
from laci_stereo.io.cam.exchange import look_exchanged
from laci_stereo.io.epochs import epoch_notes
from laci_stereo.io.table import BAD_SHARE, Problems, merged, skip_notes
from laci_stereo.io.text_file import listed

_NOWHERE_DEG = 1e-4
_SAME_PLACE_DEG = 1e-6
_SAME_SIZE_M = 0.01
_MOST_STATIONS = 5


@dataclass(frozen=True)
class CamRecording:
    """A log of messages, with notes on how its file was interpreted.

    Attributes
    ----------
    log : CamLog
        The messages of all stations, ordered by time.
    notes : tuple of str
        One line for each interpretation of the file, and for each kind of message or value that was left out or
        corrected.
    format : str
        Name of the file format, for messages to the user.
    is_receiver : bool
        Whether the positions are those of a GNSS receiver's antenna instead of the CAM reference point.
    """

    log: CamLog
    notes: tuple[str, ...]
    format: str = "CSV"
    is_receiver: bool = False


@dataclass(frozen=True)
class Messages:
    """Messages in the order of their file, before anything is checked, sorted or merged.

    Attributes
    ----------
    path : Path
    noun : str
        What the format calls the container of one message, such as row, line or packet.
    places : sequence of int
        The number of each message's row, line or packet in the file; quoted in notes and errors.
    stamps_ns : ndarray of int64, shape (n,)
        Generation time of each message, Unix time.
    station_id : ndarray of int64, shape (n,)
    values : mapping of Quantity to ndarray
        Shape (n,), in each quantity's unit, NaN where missing; quantities that the file lacks may be left out.
    problems : mapping of int to str
        The messages that could not be read: index to reason.
    backward : ndarray of bool, shape (n,), or None
        Which messages report to drive backwards; None where none of them says.
    """

    path: Path
    noun: str
    places: Sequence[int]
    stamps_ns: IntArray
    station_id: IntArray
    values: Values
    problems: Problems = field(default_factory=dict)
    backward: BoolArray | None = None

    def __len__(self) -> int:
        return len(self.stamps_ns)


def recorded(messages: Messages, notes: Sequence[str], file_format: str) -> CamRecording:
    """Return the log of messages that a reader has read.

    Parameters
    ----------
    messages : Messages
        At least one message.
    notes : sequence of str
        The reader's notes on how it interpreted the file.
    file_format : str

    Raises
    ------
    CamError
        If more than a fifth of the messages, or of the values of a quantity, are bad; if more than a fifth of the
        messages have the time and station of another one but another position; if there is no position at all; or if
        latitude and longitude are exchanged.
    """
    missing = np.full(len(messages), np.nan)
    values, zero_notes = _without_zeros({quantity: messages.values.get(quantity, missing) for quantity in QUANTITIES})
    values, sign_notes = _without_signs(values)
    _check_sides(messages.path, values)
    problems = merged([messages.problems, _misplaced(values)])
    skipped = skip_notes(messages.path, problems, messages.noun, messages.places, CamError)
    values, range_notes = _possible(messages, values)
    good = np.array([i not in problems for i in range(len(messages))], dtype=bool)
    backward = np.zeros(len(messages), dtype=bool) if messages.backward is None else messages.backward
    log = _log(messages.stamps_ns, messages.station_id, values)[good]
    log, direction_notes = turned_back(log, backward[good])
    log, order_notes = _in_order(messages, log)
    position_notes = _check_positions(messages, log)
    log_notes = (*order_notes, *position_notes, *epoch_notes(log.stamps_ns), *_size_notes(log))
    understood = (*notes, *zero_notes, *sign_notes, *skipped, *range_notes, *direction_notes, *log_notes)
    return CamRecording(log, understood, file_format)


def _without_zeros(values: Values) -> tuple[Values, list[str]]:
    """Treat placeholders of senders and loggers for unknown values as missing: position 0, 0, and size or axis 0."""
    nowhere = np.all([np.abs(values[quantity]) < _NOWHERE_DEG for quantity in POSITION], axis=0)
    notes = [f"{int(nowhere.sum())} positions are 0, 0; taken as missing"] if nowhere.any() else []
    kept = {
        **values,
        **{quantity: np.where(nowhere, np.nan, values[quantity]) for quantity in POSITION},
        **{quantity: np.where(values[quantity] == 0, np.nan, values[quantity]) for quantity in (*DIMENSIONS, *AXES)},
    }
    return kept, notes


def _without_signs(values: Values) -> tuple[Values, list[str]]:
    """Take speeds for magnitudes, as in a CAM: loggers write negative ones in reverse, or as noise while stationary."""
    speeds = values[SPEED]
    negative = (speeds < 0.0) & (speeds >= -SPEED.highest)
    notes = [f"{int(negative.sum())} speeds are negative; taken as magnitudes"] if negative.any() else []
    return {**values, SPEED: np.where(negative, -speeds, speeds)}, notes


def _check_sides(path: Path, values: Values) -> None:
    """Raise if the median latitude is possible only as a longitude, and the median longitude as a latitude."""
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
            f"needed is {quantity.lowest:g} to {quantity.highest:g}{_as_minutes(values[quantity][i], quantity.highest)}"
            for i in np.flatnonzero(~quantity.possible(values[quantity]))
        }
        for quantity in POSITION
    )


def _as_minutes(value: float, highest: float) -> str:
    """Return a hint at degrees and minutes in one number, as NMEA has them, where a value may be these."""
    degrees, minutes = divmod(abs(value), 100.0)
    may_be = 1.0 <= degrees <= highest and minutes < 60.0
    return " (if these are degrees and minutes, as in NMEA, decimal degrees)" if may_be else ""


def _possible(messages: Messages, values: Values) -> tuple[Values, list[str]]:
    """Replace values outside a quantity's range by NaN; raise if they are more than a fifth of its values."""
    notes = []
    for quantity, found in values.items():
        impossible = np.flatnonzero(~quantity.possible(found))
        if len(impossible) == 0 or quantity in POSITION:
            continue
        place, value = messages.places[impossible[0]], found[impossible[0]]
        what = f"{quantity.name} is {value:.10g} {quantity.unit} in {messages.noun} {place}"
        needed = f"needed is {quantity.lowest:g} to {quantity.highest:g} {quantity.unit}"
        if len(impossible) > BAD_SHARE * np.isfinite(found).sum():
            raise CamError(
                f"{messages.path}: {what} and the like in {len(impossible)} of {len(found)} {messages.noun}s; {needed}"
            )
        notes.append(f"{len(impossible)} values taken as missing: {what}; {needed}")
    return {quantity: np.where(quantity.possible(found), found, np.nan) for quantity, found in values.items()}, notes


def _log(stamps: IntArray, stations: IntArray, values: Values) -> CamLog:
    values = {**values, HEADING: values[HEADING] % 360.0}
    return CamLog(stamps, stations, **{field: values[quantity] for quantity, field in FIELDS.items()})


def _in_order(messages: Messages, log: CamLog) -> tuple[CamLog, list[str]]:
    """Sort the messages by time and merge those that one station sent at one time."""
    late = int((log.stamps_ns < np.maximum.accumulate(log.stamps_ns)).sum())
    log = log[np.lexsort((log.station_id, log.stamps_ns))]
    repeats = np.zeros(len(log), dtype=bool)
    repeats[1:] = (np.diff(log.stamps_ns) == 0) & (np.diff(log.station_id) == 0)
    moved = repeats & _differs_from_before(log)
    if moved.sum() > BAD_SHARE * len(log):
        raise CamError(
            f"{messages.path}: timestamp and station_id are those of another {messages.noun} in "
            f"{int(repeats.sum())} of {len(log)} {messages.noun}s, "
            f"but {int(moved.sum())} have another position; needed is the time of each message, to the millisecond"
        )
    notes = [f"{late} {messages.noun}s out of order sorted"] if late else []
    if repeats.any():
        notes.append(f"{int(repeats.sum())} doubled {messages.noun}s merged")
    return _merge_repeats(log, repeats), notes


def _differs_from_before(log: CamLog) -> BoolArray:
    differs = np.zeros(len(log), dtype=bool)
    for values in (log.latitude_deg, log.longitude_deg):
        differs[1:] |= np.abs(np.diff(values)) > _SAME_PLACE_DEG
    return differs


def _merge_repeats(log: CamLog, repeats: BoolArray) -> CamLog:
    """Keep the first of repeated messages, and fill its missing values from the later ones."""
    first = np.maximum.accumulate(np.where(repeats, 0, np.arange(len(log))))
    columns = []
    for column in fields(log):
        values = getattr(log, column.name).copy()
        # Integer columns, times and stations, have no NaN, and are equal in repeats.
        for i in np.flatnonzero(repeats & np.isnan(values[first])):
            if np.isnan(values[first[i]]):
                values[first[i]] = values[i]
        columns.append(values)
    return CamLog(*columns)[~repeats]


def _check_positions(messages: Messages, log: CamLog) -> list[str]:
    """Return a note on messages without a position; raise if all lack it, or latitude and longitude are exchanged."""
    missing = int((np.isnan(log.latitude_deg) | np.isnan(log.longitude_deg)).sum())
    if missing == len(log):
        raise CamError(
            f"{messages.path} holds no position: all of {missing} {messages.noun}s lack it; needed are at least 2"
        )
    if look_exchanged(log):
        raise CamError(
            f"{messages.path}: latitude and longitude look exchanged: as they are "
            f"({np.nanmedian(log.latitude_deg):.4f} and {np.nanmedian(log.longitude_deg):.4f} deg) "
            "they do not move as heading and speed say, exchanged they do; needed are latitudes as latitude"
        )
    return [f"{missing} {messages.noun}s without position"] if missing else []


def _size_notes(log: CamLog) -> list[str]:
    """Return notes on stations whose vehicle changes its length or width."""
    notes = []
    for quantity, sizes in ((LENGTH, log.length_m), (WIDTH, log.width_m)):
        told = np.flatnonzero(np.isfinite(sizes))
        told = told[np.argsort(log.station_id[told], kind="stable")]
        stations, sizes = log.station_id[told], sizes[told]
        changes = (np.diff(stations) == 0) & (np.abs(np.diff(sizes)) > _SAME_SIZE_M)
        changing, counts = np.unique(stations[1:][changes], return_counts=True)
        if len(changing) == 0:
            continue
        of_first = sizes[stations == changing[0]]
        others = listed([str(station) for station in changing[1:]], _MOST_STATIONS)
        notes.append(
            f"station {changing[0]} changes its {quantity.name} {counts[0]} times, between {of_first.min():.2f} and "
            f"{of_first.max():.2f} m{others and f' (so do {others})'}: the median is taken; if several vehicles send "
            "under one number, give each its own"
        )
    return notes
