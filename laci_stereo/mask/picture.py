"""Conversion of image crops to the input of a network: resized, side by side if there is room; and of results back."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from laci_stereo.core.frames import FloatArray, Raster
from laci_stereo.mask.contract import InputSpec, Resize


@dataclass(frozen=True)
class Crop:
    """A part of an image for the network to process.

    Attributes
    ----------
    stamp_ns : int
        Stamp of the image.
    x0, y0 : int
        First column and row of the crop in the image.
    image : ndarray of uint8, shape (height, width, 3)
        Blue-green-red.
    """

    stamp_ns: int
    x0: int
    y0: int
    image: Raster

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.image.shape[1], self.image.shape[0]


@dataclass(frozen=True)
class Cell:
    """A rectangle of the network's input for one crop, pixels."""

    x: int
    y: int
    width: int
    height: int


@dataclass(frozen=True)
class Placed:
    """Placement of a crop in the network's input: input = scale * crop + offset.

    Attributes
    ----------
    crop : Crop
    scale : ndarray, shape (2,)
    offset : ndarray, shape (2,)
        Position of the crop's top left corner in the input, pixels.
    size : tuple of int
        Width and height in the input, pixels.
    """

    crop: Crop
    scale: FloatArray
    offset: FloatArray
    size: tuple[int, int]

    def to_image(self, points: FloatArray) -> FloatArray:
        """Map points of the input, shape (n, 2), to the image, limited to the crop."""
        inside = np.clip((points - self.offset) / self.scale, 0, self.crop.size)
        moved: FloatArray = inside + np.array([self.crop.x0, self.crop.y0])
        return moved

    def holds(self, point: FloatArray) -> bool:
        """Return whether a point of the input, shape (2,), lies in the crop."""
        return bool(((point >= self.offset) & (point < self.offset + self.size)).all())

    def cut(self, mask: Raster) -> Raster:
        """Return the crop's part of a mask over the input, resized to the crop's own size."""
        x, y = self.offset.astype(int).tolist()
        part = mask[y : y + self.size[1], x : x + self.size[0]].astype(np.uint8)
        return cv2.resize(part, self.crop.size, interpolation=cv2.INTER_NEAREST) > 0


def place(crop: Crop, cell: Cell, resize: Resize) -> Placed:
    """Return the placement of a crop in a cell."""
    width, height = crop.size
    if resize == "stretch":
        size = (cell.width, cell.height)
    else:
        factor = min(cell.width / width, cell.height / height)
        size = (max(round(width * factor), 1), max(round(height * factor), 1))
    spare = (cell.width - size[0], cell.height - size[1]) if resize == "letterbox_center" else (0, 0)
    offset = np.array([cell.x + spare[0] // 2, cell.y + spare[1] // 2], dtype=np.float64)
    return Placed(crop, np.array([size[0] / width, size[1] / height]), offset, size)


def tensor(placed: list[Placed], size: tuple[int, int], spec: InputSpec) -> Raster:
    """Draw crops into an input and convert it to the network's layout, type, colour order and value range.

    ``size`` is the input's width and height. Its shape is (1, channels, height, width) or (1, height, width, channels).
    """
    canvas: Raster = np.full((size[1], size[0], 3), round(spec.pad), dtype=np.uint8)
    for placement in placed:
        x, y = placement.offset.astype(int).tolist()
        shrinks = bool((placement.scale < 1).any())
        method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        canvas[y : y + placement.size[1], x : x + placement.size[0]] = cv2.resize(
            placement.crop.image, placement.size, interpolation=method
        )
    if spec.color == "GRAY":
        canvas = cv2.cvtColor(canvas, cv2.COLOR_BGR2GRAY)[:, :, None]
    elif spec.color == "RGB":
        canvas = canvas[:, :, ::-1]
    values = canvas if spec.dtype == "uint8" else _scaled(canvas, spec)
    return np.ascontiguousarray((values.transpose(2, 0, 1) if spec.layout == "NCHW" else values)[None])


def _scaled(canvas: Raster, spec: InputSpec) -> Raster:
    mean, std = (np.array(each, dtype=np.float32) for each in (spec.mean, spec.std))
    values = (canvas.astype(np.float32) * np.float32(spec.scale) - mean) / std
    typed: Raster = values.astype(spec.dtype)
    return typed
