"""Logs of Cooperative Awareness Messages in CSV files, with the column names, units and codes found in practice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from laci_stereo.core.errors import CamError
from laci_stereo.io.cam.columns import ANTENNA, POSITION_OF, QUANTITIES, REQUIRED, in_units
from laci_stereo.io.cam.gnss import OF_ANTENNA
from laci_stereo.io.cam.kinds import cam_rows
from laci_stereo.io.cam.recording import CamRecording, Messages, recorded
from laci_stereo.io.cam.table import backwards, column_notes, generated, numbers_of, station_ids
from laci_stereo.io.table import Table, merged, read_table, stamps_ns


def read_cam_csv(path: Path) -> CamRecording:
    """Read a log of messages with a header row.

    The columns are ``timestamp``, ``station_id``, ``latitude``, ``longitude``, ``heading``, ``speed``,
    ``vehicle_length`` and ``vehicle_width``, optionally ``altitude``, ``semi_major_95``, ``semi_minor_95`` and
    ``ellipse_orientation``, ``driveDirection``, by which headings are turned where it is ``backward``, ``position_of``,
    which is ``antenna`` where positions are those of an antenna, and ``generationDeltaTime``, beside which
    ``timestamp`` is the time of reception. Common synonyms are recognised. Only times and positions are required. Raw
    ETSI integers are recognised for the whole file at once. Rows of other messages, by ``messageID`` or a type, are
    left out.

    Raises
    ------
    CamError
        If the file cannot be read or lacks a required column, more than a fifth of its rows or of a column's values are
        bad, it has no position at all, or latitude and longitude are exchanged.
    """
    table, notes = cam_rows(read_table(path, REQUIRED, CamError, "message"))
    return recorded_table(table, "row", "CSV", notes)


def recorded_table(table: Table, noun: str, file_format: str, notes: Sequence[str] = ()) -> CamRecording:
    """Return the log of the messages in a table; ``noun`` is what its format calls a row, ``notes`` are its reader's.

    Raises
    ------
    CamError
        As in `read_cam_csv`, except for files that cannot be read.
    """
    stations = station_ids(table)
    stamps = generated(table, stamps_ns(table), stations.values)
    numbers = {quantity: numbers_of(table, quantity) for quantity in QUANTITIES}
    values, unit_notes = in_units(
        {quantity: parsed.values for quantity, parsed in numbers.items()},
        {quantity for quantity in QUANTITIES if any("." in text for text in table.texts(quantity) or [])},
    )
    unread = merged(parsed.problems for parsed in numbers.values())
    problems = merged([table.problems, stamps.problems, stations.problems, unread])
    code_notes = [note for parsed in numbers.values() for note in parsed.notes]
    backward, direction_notes = backwards(table)
    value_notes = [*unit_notes, *code_notes, *direction_notes]
    understood = [*column_notes(table), *notes, *stamps.notes, *stations.notes, *value_notes]
    messages = Messages(
        table.path, noun, table.line_numbers, stamps.values, stations.values, values, problems, backward
    )
    of_antenna = ANTENNA in (table.texts(POSITION_OF) or [])
    return replace(
        recorded(messages, [*understood, *([OF_ANTENNA] if of_antenna else [])], file_format), is_receiver=of_antenna
    )
