"""Detection of vehicles in crops of images; several crops share one run of the network."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray
from laci_stereo.mask.contract import Contract
from laci_stereo.mask.decode import Found
from laci_stereo.mask.network import Network
from laci_stereo.mask.picture import Cell, Crop, Placed, place, tensor

CELL_PX = 320
"""Least side of a cell: a moving object covers at least a third of its crop, and so about 96 pixels or more of the
cell. From that size on, COCO counts an object as large, and small detectors no longer improve."""

MOST_SHRUNK = 0.5
"""A crop that must be scaled by less than this to fit a cell gets an input of its own."""


@dataclass(frozen=True)
class Vehicle:
    """A vehicle in an image.

    Attributes
    ----------
    box : ndarray, shape (4,)
        Left, top, right, bottom, pixels of the image.
    score : float
    class_id : int
    mask : ndarray of bool, shape (height, width), or None
        Mask whose top left corner is at ``corner``; None if the network has no masks.
    corner : tuple of int
        Column and row in the image.
    """

    box: FloatArray
    score: float
    class_id: int
    mask: BoolArray | None = None
    corner: tuple[int, int] = (0, 0)


class Finder(Protocol):
    """Finds vehicles in crops; ``runs`` and ``seconds`` are the number of runs so far and their total duration."""

    runs: int
    seconds: float

    @property
    def slots(self) -> int:
        """Number of crops that are best processed together."""

    @property
    def least_px(self) -> int:
        """Side below which a crop would only be magnified."""

    def find(self, crops: Sequence[Crop]) -> list[tuple[Vehicle, ...]]:
        """Return the vehicles in each crop."""


class NetworkFinder:
    """Finds vehicles in crops with a network.

    Parameters
    ----------
    network : Network
    cells : tuple of Cell or None
        Cells of the network's input for one crop each. None: those of `cells_of`.

    Attributes
    ----------
    runs : int
        Number of runs so far.
    seconds : float
        Total duration of these runs.
    """

    def __init__(self, network: Network, cells: tuple[Cell, ...] | None = None) -> None:
        self.network = network
        self.runs = 0
        self.seconds = 0.0
        self._cells = cells or cells_of(network.size, network.contract)

    @property
    def slots(self) -> int:
        """Number of crops that fit into one input."""
        return len(self._cells)

    @property
    def least_px(self) -> int:
        """Half of a cell: magnification by more than two only adds blur."""
        return min(self._cells[0].width, self._cells[0].height) // 2

    def find(self, crops: Sequence[Crop]) -> list[tuple[Vehicle, ...]]:
        """Return the vehicles in each crop.

        Raises
        ------
        MaskError
        """
        found: list[tuple[Vehicle, ...]] = [() for _ in crops]
        for numbers, placed in self._inputs(crops):
            start = time.perf_counter()
            seen = self.network.find(tensor(placed, self.network.size, self.network.contract.input))
            self.seconds += time.perf_counter() - start
            self.runs += 1
            for number, each in zip(numbers, placed, strict=True):
                found[number] = tuple(_in_image(vehicle, each) for vehicle in seen if each.holds(_middle(vehicle.box)))
        return found

    def _inputs(self, crops: Sequence[Crop]) -> Iterator[tuple[list[int], list[Placed]]]:
        """Yield, for each input, the indices of its crops and their placement."""
        resize = self.network.contract.input.resize
        cell = self._cells[0]
        small: list[int] = []
        for number, crop in enumerate(crops):
            if len(self._cells) > 1 and min(cell.width / crop.size[0], cell.height / crop.size[1]) >= MOST_SHRUNK:
                small.append(number)
            else:
                yield [number], [place(crop, Cell(0, 0, *self.network.size), resize)]
        for first in range(0, len(small), len(self._cells)):
            numbers = small[first : first + len(self._cells)]
            yield numbers, [place(crops[number], at, resize) for number, at in zip(numbers, self._cells, strict=False)]


def cells_of(size: tuple[int, int], contract: Contract) -> tuple[Cell, ...]:
    """Divide an input into cells, one for each crop.

    A network with attention to the whole input (detr) processes one crop at a time, and so does one whose input is not
    larger than one cell.
    """
    columns, rows = contract.input.crops or (
        (1, 1) if contract.kind == "detr" else (max(size[0] // CELL_PX, 1), max(size[1] // CELL_PX, 1))
    )
    width, height = size[0] // columns, size[1] // rows
    return tuple(Cell(x * width, y * height, width, height) for y in range(rows) for x in range(columns))


def _middle(box: FloatArray) -> FloatArray:
    middle: FloatArray = (box[:2] + box[2:]) / 2
    return middle


def _in_image(found: Found, placed: Placed) -> Vehicle:
    box = placed.to_image(found.box.reshape(2, 2)).ravel()
    mask = None if found.mask is None else placed.cut(found.mask)
    return Vehicle(box, found.score, found.class_id, mask, (placed.crop.x0, placed.crop.y0))


def covers_all(vehicle: Vehicle, crop: Crop, share: float) -> bool:
    """Return whether a vehicle covers at least this fraction of a crop."""
    width, height = crop.size
    area = float(np.prod(vehicle.box[2:] - vehicle.box[:2])) if vehicle.mask is None else float(vehicle.mask.sum())
    return area >= share * width * height
