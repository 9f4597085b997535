"""Messages in JSON, an object for each, as V2X stacks publish them: in lines, in a list, or in a list in an object."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path

from laci_stereo.core.errors import CamError
from laci_stereo.io.cam.columns import REQUIRED
from laci_stereo.io.cam.csv_log import recorded_table
from laci_stereo.io.cam.etsi import CAM_KIND, kind_named
from laci_stereo.io.cam.kinds import cam_records, choice
from laci_stereo.io.cam.received import left_out_note
from laci_stereo.io.cam.recording import CamRecording
from laci_stereo.io.table import skip_notes, table_of
from laci_stereo.io.text_file import listed, quoted

_DEEPEST = 20


def parsed(path: Path, text: str) -> tuple[object, list[str]]:
    """Return the content of JSON text, or a list of that of its lines, and a note on lines that cannot be read.

    Raises
    ------
    CamError
        If it is no JSON, or more than a fifth of its lines are none.
    """
    try:
        return json.loads(text), []
    except (ValueError, RecursionError) as problem:
        if not (isinstance(problem, json.JSONDecodeError) and problem.msg.startswith("Extra data")):
            raise CamError(f"{path} cannot be read: {quoted(str(problem))}; needed is JSON") from problem
    lines = [(place, line) for place, line in enumerate(text.splitlines(), 1) if line.strip()]
    records, problems = [], {}
    for i, (_, line) in enumerate(lines):
        try:
            records.append(json.loads(line))
        except (ValueError, RecursionError) as problem:
            problems[i] = f"{quoted(str(problem))}; needed is JSON"
    return records, skip_notes(path, problems, "line", [place for place, _ in lines], CamError)


def read_cam_records(path: Path, content: object, notes: Sequence[str]) -> CamRecording:
    """Read a list of records, or the list in an object, as a table whose titles are the paths of their values.

    Messages of other kinds are left out. Of several lists in an object, that of the CAMs is read. ``notes`` are those
    on how the file was parsed.

    Raises
    ------
    CamError
        If no record has a time or a position, all are of other kinds, or as in `read_cam_csv`.
    """
    records, kinds = _list(content)
    numbered = cam_records(path, records, kinds)
    rows = [dict(_leaves(record, (), _DEEPEST)) for _, record in numbered]
    header = list(dict.fromkeys(title for row in rows for title in row))
    lacking = [column.name for column in REQUIRED if column.find(header) is None]
    if lacking:
        raise CamError(
            f"{path} is JSON, but no object of topics as {{'/v2x/cam': [...]}}, and its records lack "
            f"{', '.join(lacking)}; needed are timestamp, latitude and longitude in each, and they hold "
            f"{listed(header) or 'nothing'}"
        )
    cells = [(place, [row.get(title, "") for title in header]) for (place, _), row in zip(numbered, rows, strict=True)]
    table = table_of(path, header, cells, REQUIRED, CamError, "message")
    return recorded_table(table, "record", "JSON", [*notes, *left_out_note(kinds, "record")])


def _list(content: object) -> tuple[list[object], Counter[str]]:
    """Return the records in the content of a file, and how many there are of other kinds in lists of their own."""
    if isinstance(content, dict) and content.get("type") == "FeatureCollection":
        return _points(content.get("features"))
    if not isinstance(content, dict):
        return content if isinstance(content, list) else [content], Counter()
    lists = {name: part for name, part in content.items() if isinstance(part, list)}
    cams = [name for name in lists if kind_named(name) == CAM_KIND]
    chosen = cams if len(cams) == 1 else list(lists)
    if len(chosen) != 1:
        return [content], Counter()
    kinds = {kind_named(name): len(part) for name, part in lists.items()}
    return lists[chosen[0]], Counter({kind: count for kind, count in kinds.items() if kind not in (None, CAM_KIND)})


def _points(features: object) -> tuple[list[object], Counter[str]]:
    """Return the points of GeoJSON as records, and how many features there are of other kinds."""
    records: list[object] = []
    kinds: Counter[str] = Counter()
    for feature in features if isinstance(features, list) else []:
        match feature:
            case {"geometry": {"type": "Point", "coordinates": [longitude, latitude, *_]}, "properties": properties}:
                records.append({"longitude": longitude, "latitude": latitude, "properties": properties})
            case {"geometry": {"type": str(kind)}}:
                kinds[quoted(kind)] += 1
    return records, kinds


def _leaves(value: object, names: tuple[str, ...], deep: int) -> Iterator[tuple[str, str]]:
    """Yield the paths and texts of single values; lists are left out, as of the points of a vehicle's path."""
    if deep == 0:
        return
    if isinstance(value, dict):
        for name, inner in value.items():
            yield from _leaves(inner, (*names, name), deep - 1)
    elif (told := choice(value)) is not None:
        yield from _leaves(told[1], (*names, told[0]), deep - 1)
    elif isinstance(value, str | int | float):
        yield ".".join(names), str(value).strip()
