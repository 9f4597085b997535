"""The content of a calibration file as a mapping of names to values, independent of the file's syntax."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from laci_stereo.core.errors import RigError
from laci_stereo.core.frames import FloatArray
from laci_stereo.io.file_storage import Node
from laci_stereo.io.rig.stereo_rig import Size
from laci_stereo.io.text_file import listed, shortened

Shape = tuple[int, ...]


@dataclass(frozen=True)
class Entry:
    """A quantity and the names that tools give it; case, underscores, hyphens and spaces do not matter."""

    what: str
    names: tuple[str, ...]

    @staticmethod
    def of_camera(what: str, stems: tuple[str, ...], side: Literal["left", "right"]) -> Entry:
        """Return the entry of one camera, named by a stem and a side: K1, cameraMatrixL, left_camera_matrix."""
        marks = ("1", "L", "Left") if side == "left" else ("2", "R", "Right")
        suffixed = tuple(f"{stem}{mark}" for mark in marks for stem in stems)
        prefixed = tuple(f"{side}_{stem}" for stem in stems)
        return Entry(f"{what} of the {side} camera", suffixed + prefixed)


_LONGEST_NAME = 60
"""Longest name that is quoted in messages: as hyphens and spaces do not matter, a file's name for an entry may hold any
number of them."""

WIDTH = Entry("image width", ("imageWidth", "width"))
HEIGHT = Entry("image height", ("imageHeight", "height"))
SIZE = Entry("image size", ("imageSize", "size", "resolution"))


@dataclass(frozen=True)
class Document:
    """The content of a file, or of a part of it; ``name`` names both in messages."""

    name: str
    root: Mapping[str, Node]

    def key(self, entry: Entry) -> str | None:
        """Return the document's name for an entry, or None if it has no such entry."""
        present = {plain(name): name for name in self.root}
        return next((present[plain(name)] for name in entry.names if plain(name) in present), None)

    def find(self, entry: Entry) -> tuple[str, Node] | None:
        """Return the document's name for an entry, shortened for messages, and its value; None without an entry."""
        found = self.key(entry)
        return None if found is None else (shortened(found, _LONGEST_NAME), self.root[found])

    def has(self, *names: str) -> bool:
        """Return whether the document has entries of all these names."""
        return all(self.find(Entry("", (name,))) is not None for name in names)

    def text(self, *names: str) -> str | None:
        """Return the text of the entry with one of these names, or None if there is none."""
        found = self.find(Entry("", names))
        return found[1] if found is not None and isinstance(found[1], str) else None

    def array(self, entry: Entry, *shapes: Shape) -> FloatArray:
        """Return an entry's numbers in the first of the given shapes that they fit.

        Raises
        ------
        RigError
            If the entry is missing, fits none of the shapes, or holds a number that is not finite.
        """
        found = self.find(entry)
        if found is None:
            raise RigError(
                f"{self.name} lacks the {entry.what}; needed is one of {listed(list(entry.names), 8)} "
                f"(case and underscores do not matter), it holds {listed(list(self.root))}"
            )
        name, node = found
        values = numbers(node)
        needed = " or ".join(_times(shape) for shape in shapes)
        if values is None:
            raise RigError(f"{self.name}: {name} is no matrix; needed are {needed} numbers ({entry.what})")
        shape = next((shape for shape in shapes if _fits(values.shape, shape)), None)
        if shape is None:
            raise RigError(
                f"{self.name}: {name} holds {_times(values.shape)} numbers; needed are {needed} numbers ({entry.what})"
            )
        if not np.isfinite(values).all():
            raise RigError(f"{self.name}: {name} holds a number that is not finite; needed are {needed} finite ones")
        return values.reshape(shape)

    def number(self, what: str, *names: str) -> float:
        """Return the number of the entry with one of these names.

        Raises
        ------
        RigError
            If it is missing, no single number, or not finite.
        """
        return float(self.array(Entry(what, names), (1,))[0])

    def part(self, name: str) -> Document:
        """Return the part of the document under a name as a document of its own.

        Raises
        ------
        RigError
            If there is no such part, or it has no entries.
        """
        found = self.find(Entry("", (name,)))
        if found is None or not isinstance(found[1], dict):
            has = "lacks it" if found is None else "has no entries there"
            raise RigError(f"{self.name}: {name} is needed, the file {has}; it holds {listed(list(self.root))}")
        return Document(f"{self.name}: {found[0]}", found[1])

    def size(self, order: tuple[int, int] = (0, 1)) -> Size | None:
        """Return the image size, None if not stated; ``order`` gives the indices of width and height in a pair.

        Raises
        ------
        RigError
            If it is no valid size.
        """
        if self.find(WIDTH) is not None or self.find(HEIGHT) is not None:
            values = np.concatenate([self.array(entry, (1,)) for entry in (WIDTH, HEIGHT)])
        elif self.find(SIZE) is not None:
            values = self.array(SIZE, (2,))[list(order)]
        else:
            return None
        return whole_size(self.name, values)


def whole_size(name: str, values: FloatArray) -> Size:
    """Return a width and a height, shape (2,), as an image size.

    Raises
    ------
    RigError
        If they are no positive whole numbers.
    """
    if not ((values >= 1) & (values <= 1e6) & (values == np.round(values))).all():
        raise RigError(f"{name}: the image size is {values[0]:g} x {values[1]:g}; needed are positive whole numbers")
    return int(values[0]), int(values[1])


def plain(name: str) -> str:
    """Return a name in lower case, without underscores, hyphens and spaces."""
    return name.lower().replace("_", "").replace("-", "").replace(" ", "")


def numbers(node: Node) -> FloatArray | None:
    """Return the numbers of a node in the node's own shape, or None if it holds anything else."""
    if isinstance(node, dict):
        # OpenCV 5 writes vectors with sizes, and everything else with rows and cols.
        sizes = numbers(node.get("sizes", [node.get("rows", ""), node.get("cols", "")]))
        values = numbers(node.get("data", ""))
        if sizes is None or values is None or not np.isin(sizes, np.arange(1, values.size + 1)).all():
            return None
        return values.reshape(sizes.astype(int)) if np.prod(sizes) == values.size else None
    inner = node if isinstance(node, list) else [node]
    found = [value for value in inner if isinstance(value, float)]
    if found:
        return np.array(found) if len(found) == len(inner) else None
    rows = [values for values in (numbers(row) for row in inner if isinstance(row, list)) if values is not None]
    if not rows or len(rows) != len(inner) or len({row.shape for row in rows}) != 1:
        return None
    return np.stack(rows)


def _times(shape: Shape) -> str:
    return "x".join(map(str, shape))


def _fits(found: Shape, needed: Shape) -> bool:
    """Return whether one shape fits another: equal, flattened, or, of a vector, a row or a column."""
    size = int(np.prod(needed))
    return found == needed or found == (size,) or (len(needed) == 1 and found in ((1, size), (size, 1)))
