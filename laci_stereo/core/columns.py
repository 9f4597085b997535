"""Dataclasses of arrays of one length that are indexed and joined by rows."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TypeVar

import numpy as np

from laci_stereo.core.frames import BoolArray, IntArray

_Columns = TypeVar("_Columns", bound="Columns")


@dataclass(frozen=True)
class Columns:
    """Base of a dataclass whose fields are all arrays of one length, or `Columns` themselves.

    Indexing it selects the same rows of every field.
    """

    def __getitem__(self: _Columns, keep: BoolArray | IntArray) -> _Columns:
        return type(self)(*(getattr(self, field.name)[keep] for field in fields(self)))

    def joined(self: _Columns, *others: _Columns) -> _Columns:
        """Return these rows followed by those of others; only for dataclasses whose fields are all arrays."""
        each = (self, *others)
        return type(self)(*(np.concatenate([getattr(one, field.name) for one in each]) for field in fields(self)))
