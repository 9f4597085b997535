"""Arrays of one length, side by side."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TypeVar

import numpy as np

from laci_stereo.core.frames import BoolArray, IntArray

_Columns = TypeVar("_Columns", bound="Columns")


@dataclass(frozen=True)
class Columns:
    """What has only arrays of one length, or others of its kind: some rows of it are the same rows of each."""

    def __getitem__(self: _Columns, keep: BoolArray | IntArray) -> _Columns:
        return type(self)(*(getattr(self, field.name)[keep] for field in fields(self)))

    def joined(self: _Columns, *others: _Columns) -> _Columns:
        """Return its rows, and below them those of others that have arrays only."""
        each = (self, *others)
        return type(self)(*(np.concatenate([getattr(one, field.name) for one in each]) for field in fields(self)))
