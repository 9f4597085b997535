"""What kind of message each record or row of a log is, where CAMs are recorded among others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TypeAlias

from laci_stereo.core.errors import CamError
from laci_stereo.io.cam.etsi import CAM_KIND, kind_named, pdu_kind
from laci_stereo.io.cam.received import counted, left_out_note
from laci_stereo.io.stamps import number
from laci_stereo.io.table import Column, Table, plain_name

_ID = Column("messageID", ())
_TYPE = Column("messageType", ("msgtype", "messagename", "type"))
_TYPES = tuple(plain_name(name) for name in (_TYPE.name, *_TYPE.synonyms))

_Named: TypeAlias = Sequence[tuple[str, object]]
"""The names and values in a record."""

_ROADSIDE = "rsucontainerhighfrequency"
_ROADSIDE_KIND = "CAM of a roadside unit"

_DEEPEST = 20
_CHOICE = 2
"""Elements of a list that stands for a choice of ASN.1: its name and its value."""


def choice(value: object) -> tuple[str, object] | None:
    """Return the name and the value of a choice of ASN.1 that is written as a list of both; None for anything else."""
    if isinstance(value, list) and len(value) == _CHOICE and isinstance(value[0], str):
        return value[0], value[1]
    return None


def cam_records(path: Path, records: Sequence[object], kinds: Counter[str]) -> list[tuple[int, object]]:
    """Return the records of JSON that are of a vehicle's CAM or do not tell their kind, each with its number from 1.

    The kinds of the others are added to ``kinds``, those of messages that are left out.

    Raises
    ------
    CamError
        If all of them are of other kinds.
    """
    named = list(enumerate(records, 1))
    parts = [list(_walk(record)) for record in records]
    found = _kinds([_message_id(part) for part in parts], [_name(part) for part in parts])
    kinds.update(kind for kind in found if kind != CAM_KIND)
    kept = [item for item, kind in zip(named, found, strict=True) if kind == CAM_KIND]
    if kinds and not kept:
        raise CamError(f"{path} is JSON and holds no CAM of a vehicle, but {counted(kinds)}; needed are CAMs")
    return kept


def cam_rows(table: Table) -> tuple[Table, list[str]]:
    """Return the rows of a table that are of CAMs or do not tell their kind, and a note on the others.

    Raises
    ------
    CamError
        If all of them are of other kinds.
    """
    ids, names = table.texts(_ID), table.texts(_TYPE)
    if ids is None and names is None:
        return table, []
    count = len(table.rows)
    found = _kinds([_whole(text) for text in ids or [""] * count], [kind_named(text) for text in names or [""] * count])
    kept = [i for i, kind in enumerate(found) if kind == CAM_KIND]
    kinds = Counter(kind for kind in found if kind != CAM_KIND)
    if not kept:
        raise CamError(f"{table.path} holds no CAM of a vehicle, but {counted(kinds)}; needed are CAMs")
    left = replace(
        table,
        rows=[table.rows[i] for i in kept],
        line_numbers=[table.line_numbers[i] for i in kept],
        problems={place: table.problems[i] for place, i in enumerate(kept) if i in table.problems},
    )
    return left, left_out_note(kinds, "row")


def _kinds(ids: Sequence[int | None], names: Sequence[str | None]) -> list[str]:
    """Return the kind of each message by its name, else by its messageID, else that of a CAM."""
    known = [message_id for message_id in ids if message_id is not None]
    if len(set(known)) == len(known) > 1:
        ids = [None] * len(ids)  # a running number of the messages
    return [
        name or (CAM_KIND if message_id is None else pdu_kind(message_id))
        for message_id, name in zip(ids, names, strict=True)
    ]


def _message_id(named: _Named) -> int | None:
    return next((_whole(str(value)) for name, value in named if _last(name) == "messageid"), None)


def _name(named: _Named) -> str | None:
    """Return the kind of message that a record tells: its type, or what its parts are called, as ``denm``."""
    types = (kind_named(value) for name, value in named if _last(name) in _TYPES and isinstance(value, str))
    told = next((kind for kind in types if kind is not None), None)
    if told not in (None, CAM_KIND):
        return told
    parts = [name for name, value in named if isinstance(value, dict) or choice(value) is not None]
    if any(_last(name) == _ROADSIDE for name in parts):
        return _ROADSIDE_KIND
    found = [kind for name in parts if (kind := kind_named(name.partition(".")[0])) is not None]
    return CAM_KIND if CAM_KIND in (told, *found) else next(iter(found), None)


def _walk(value: object, deep: int = _DEEPEST) -> Iterator[tuple[str, object]]:
    """Yield the names and values in nested objects, and in choices; not those in lists."""
    told = choice(value)
    items = value.items() if isinstance(value, dict) else [told] if told is not None else []
    for name, inner in items:
        yield name, inner
        if deep > 1:
            yield from _walk(inner, deep - 1)


@lru_cache(maxsize=1 << 10)  # the names of all records are the same
def _last(path: str) -> str:
    return plain_name(path.rpartition(".")[2])


def _whole(text: str) -> int | None:
    value = number(text.strip())
    return int(value) if value is not None and 0 <= value < 1 << 8 and value % 1 == 0 else None
