"""A calibration file as names and what stands under them, whatever language it is written in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from laci_stereo.core.errors import RigError
from laci_stereo.core.frames import FloatArray
from laci_stereo.io.file_storage import Node
from laci_stereo.io.rig import Size
from laci_stereo.io.text_file import listed, shortened

Shape = tuple[int, ...]


@dataclass(frozen=True)
class Entry:
    """A quantity, and the names that tools give it; case, underscores, hyphens and spaces do not matter."""

    what: str
    names: tuple[str, ...]

    @staticmethod
    def of_camera(what: str, stems: tuple[str, ...], side: Literal["left", "right"]) -> Entry:
        """Combine names of a quantity with the ways of naming a camera: K1, cameraMatrixL, left_camera_matrix."""
        marks = ("1", "L", "Left") if side == "left" else ("2", "R", "Right")
        suffixed = tuple(f"{stem}{mark}" for mark in marks for stem in stems)
        prefixed = tuple(f"{side}_{stem}" for stem in stems)
        return Entry(f"{what} of the {side} camera", suffixed + prefixed)


_LONGEST_NAME = 60
"""For hyphens and spaces do not matter, and may be many."""

WIDTH = Entry("image width", ("imageWidth", "width"))
HEIGHT = Entry("image height", ("imageHeight", "height"))
SIZE = Entry("image size", ("imageSize", "size", "resolution"))


@dataclass(frozen=True)
class Document:
    """What stands in a file, or in a part of it.

    Attributes
    ----------
    name : str
        The file, and the part of it; for messages.
    root : mapping of str to node
    """

    name: str
    root: Mapping[str, Node]

    def key(self, entry: Entry) -> str | None:
        """Return the name under which an entry stands here."""
        present = {plain(name): name for name in self.root}
        return next((present[plain(name)] for name in entry.names if plain(name) in present), None)

    def find(self, entry: Entry) -> tuple[str, Node] | None:
        """Return the name under which an entry stands here, for messages, and what stands there."""
        found = self.key(entry)
        return None if found is None else (shortened(found, _LONGEST_NAME), self.root[found])

    def has(self, *names: str) -> bool:
        """Tell whether each of these stands here."""
        return all(self.find(Entry("", (name,))) is not None for name in names)

    def text(self, *names: str) -> str | None:
        """Return the text under one of some names, None if there is none."""
        found = self.find(Entry("", names))
        return found[1] if found is not None and isinstance(found[1], str) else None

    def array(self, entry: Entry, *shapes: Shape) -> FloatArray:
        """Return an entry's numbers in the first of the shapes that has as many.

        Raises
        ------
        RigError
            If there are none, or not as many, or not finite ones.
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
        """Return a number.

        Raises
        ------
        RigError
            If it is missing or not finite.
        """
        return float(self.array(Entry(what, names), (1,))[0])

    def part(self, name: str) -> Document:
        """Return what stands under a name as a document of its own.

        Raises
        ------
        RigError
            If there is nothing, or no names in it.
        """
        found = self.find(Entry("", (name,)))
        if found is None or not isinstance(found[1], dict):
            has = "lacks it" if found is None else "has no entries there"
            raise RigError(f"{self.name}: {name} is needed, the file {has}; it holds {listed(list(self.root))}")
        return Document(f"{self.name}: {found[0]}", found[1])

    def size(self, order: tuple[int, int] = (0, 1)) -> Size | None:
        """Return the image size, None if it is not told; ``order`` is where width and height stand in a pair.

        Raises
        ------
        RigError
            If it is no size.
        """
        if self.find(WIDTH) is not None or self.find(HEIGHT) is not None:
            values = np.concatenate([self.array(entry, (1,)) for entry in (WIDTH, HEIGHT)])
        elif self.find(SIZE) is not None:
            values = self.array(SIZE, (2,))[list(order)]
        else:
            return None
        return whole_size(self.name, values)


def whole_size(name: str, values: FloatArray) -> Size:
    """Return a width and a height as an image size.

    Raises
    ------
    RigError
        If they are none.
    """
    if not ((values >= 1) & (values <= 1e6) & (values == np.round(values))).all():
        raise RigError(f"{name}: the image size is {values[0]:g} x {values[1]:g}; needed are positive whole numbers")
    return int(values[0]), int(values[1])


def plain(name: str) -> str:
    """Return a name without what does not matter in it."""
    return name.lower().replace("_", "").replace("-", "").replace(" ", "")


def numbers(node: Node) -> FloatArray | None:
    """Return a node's numbers in its own shape, or None if it holds something else."""
    if isinstance(node, dict):
        # OpenCV 5 writes vectors with sizes, everything else has rows and cols.
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
    """Whether numbers of one shape are those of another: the same, flat, or for a vector a row or a column."""
    size = int(np.prod(needed))
    return found == needed or found == (size,) or (len(needed) == 1 and found in ((1, size), (size, 1)))
