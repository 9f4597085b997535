"""The common result of all formats: columns of numbers, one value per point, by the names of their fields."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from laci_lidar.errors import ScanError
from laci_stereo.io.text_file import quoted

LONGEST_HEADER = 1 << 16
"""Largest size of a file's header, bytes."""

Column: TypeAlias = npt.NDArray[Any]
Columns: TypeAlias = Mapping[str, Column]
"""The columns of a scan by name, each of shape (n,) or, for fields that repeat, (n, count)."""


@dataclass(frozen=True)
class Field:
    """A field of a point.

    Attributes
    ----------
    name : str
    dtype : dtype
        Type of one value.
    count : int
        Number of values per point.
    """

    name: str
    dtype: np.dtype[Any]
    count: int = 1

    @property
    def size(self) -> int:
        """Number of bytes per point."""
        return self.dtype.itemsize * self.count


def unpacked(content: bytes | memoryview, fields: Sequence[Field], points: int) -> Columns:
    """Return the columns of points that are stored one after another, each with all of its fields."""
    offsets = np.cumsum([0, *(field.size for field in fields)])
    layout = np.dtype(
        {
            "names": [str(i) for i in range(len(fields))],
            "formats": [(field.dtype, (field.count,)) if field.count != 1 else field.dtype for field in fields],
            "offsets": offsets[:-1].tolist(),
            "itemsize": int(offsets[-1]),
        }
    )
    records = np.frombuffer(content, layout, points)
    return named(fields, [records[str(i)] for i in range(len(fields))])


def from_text(text: bytes, fields: Sequence[Field], points: int, what: str) -> Columns:
    """Return the columns of points stored as text, one point in each row.

    Raises
    ------
    ScanError
        If there are fewer rows than points, or a row has other fields.
    """
    lines = text.split(b"\n", points)[:points]
    filled = sum(bool(line) and not line.isspace() for line in lines)
    if filled < points:
        raise ScanError(f"{what} is cut off: {filled} of {points} points are there")
    # 64-bit integers are times in nanoseconds, which float64 cannot represent.
    kinds = [field.dtype if field.dtype.kind in "iu" and field.dtype.itemsize == 8 else np.float64 for field in fields]
    layout = [(f"{i} {k}", kinds[i]) for i, field in enumerate(fields) for k in range(field.count)]
    if points == 0:
        return named(fields, [np.zeros(0) for _ in fields])
    try:
        records = np.loadtxt((line.decode("ascii") for line in lines), layout, comments=None, ndmin=1)
    except (ValueError, OverflowError) as problem:
        raise ScanError(f"{what}: {quoted(str(problem))}; needed are {len(layout)} numbers for each point") from problem
    columns = [np.column_stack([records[f"{i} {k}"] for k in range(field.count)]) for i, field in enumerate(fields)]
    return named(
        fields, [column[:, 0] if field.count == 1 else column for field, column in zip(fields, columns, strict=True)]
    )


def named(fields: Sequence[Field], columns: Sequence[Column]) -> Columns:
    """Return columns by their fields' names; of fields with equal names, such as padding, the first one is kept."""
    found: dict[str, Column] = {}
    for field, column in zip(fields, columns, strict=True):
        found.setdefault(field.name, column)
    return found
