"""Messages in JSON, an object for each, as V2X stacks publish them: in lines, in a list, or in a list in an object."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from laci_stereo.core.errors import CamError
from laci_stereo.io.cam.columns import REQUIRED
from laci_stereo.io.cam.csv_log import recorded_table
from laci_stereo.io.cam.recording import CamRecording
from laci_stereo.io.table import table_of
from laci_stereo.io.text_file import listed

_DEEPEST = 20
_CHOICE = 2
"""Elements of a list that stands for a choice of ASN.1: its name and its value."""


def parsed(text: str) -> object:
    """Return the content of JSON text, or a list of that of its lines.

    Raises
    ------
    ValueError, RecursionError
        If it is neither.
    """
    try:
        return json.loads(text)
    except json.JSONDecodeError as problem:
        if not problem.msg.startswith("Extra data"):
            raise
        return [json.loads(line) for line in text.splitlines() if line.strip()]


def read_cam_records(path: Path, content: object) -> CamRecording:
    """Read a list of records, or the only list in an object, as a table whose titles are the paths of their values.

    Raises
    ------
    CamError
        If no record has a time or a position, or as in `read_cam_csv`.
    """
    lists = [part for part in content.values() if isinstance(part, list)] if isinstance(content, dict) else [content]
    records = lists[0] if len(lists) == 1 and isinstance(lists[0], list) else [content]
    rows = [dict(_leaves(record, (), _DEEPEST)) for record in records]
    header = list(dict.fromkeys(title for row in rows for title in row))
    lacking = [column.name for column in REQUIRED if column.find(header) is None]
    if lacking:
        raise CamError(
            f"{path} is JSON, but no object of topics as {{'/v2x/cam': [...]}}, and its records lack "
            f"{', '.join(lacking)}; needed are timestamp, latitude and longitude in each, and they hold "
            f"{listed(header) or 'nothing'}"
        )
    cells = [(place, [row.get(title, "") for title in header]) for place, row in enumerate(rows, 1)]
    return recorded_table(table_of(path, header, cells, REQUIRED, CamError, "message"), "record", "JSON")


def _leaves(value: object, names: tuple[str, ...], deep: int) -> Iterator[tuple[str, str]]:
    """Yield the paths and texts of single values; lists are left out, as of the points of a vehicle's path."""
    if deep == 0:
        return
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _leaves(inner, (*names, name), deep - 1)
    elif isinstance(value, list) and len(value) == _CHOICE and isinstance(value[0], str):
        yield from _leaves(value[1], (*names, value[0]), deep - 1)
    elif isinstance(value, str | int | float):
        yield ".".join(names), str(value).strip()
