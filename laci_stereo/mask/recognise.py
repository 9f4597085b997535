"""Recognition of networks that come without a contract, if the shapes of their outputs are unambiguous."""

from __future__ import annotations

import ast
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from laci_stereo.mask.contract import Contract, InputSpec, Kind, OutputSpec
from laci_stereo.mask.errors import MaskError

Shape = tuple[int | None, ...]
"""Shape of an input or output; None where a length is free."""

COCO_VEHICLES = {80: (2, 3, 5, 7), 91: (3, 4, 6, 8)}
"""Class ids of car, motorcycle, bus and lorry in COCO, by the number of classes: 80, or 91 ids with gaps."""

VEHICLE_NAMES = frozenset({"bus", "car", "lorry", "motorbike", "motorcycle", "tram", "truck", "van", "vehicle"})

STRIDES = (8, 16, 32)

UNIT = 1 / 255


@dataclass(frozen=True)
class Ports:
    """The inputs and outputs that a network's file declares, their names and shapes, and its metadata."""

    inputs: tuple[tuple[str, Shape], ...]
    outputs: tuple[tuple[str, Shape], ...]
    metadata: Mapping[str, str]


def recognise(path: Path, ports: Ports, size: tuple[int, int]) -> tuple[Contract, str]:
    """Assume the contract that fits a network's outputs.

    Parameters
    ----------
    path : Path
        Path of the model, for messages.
    ports : Ports
    size : tuple of int
        Width and height of its input.

    Returns
    -------
    contract : Contract
    assumed : str
        The assumptions, as text.

    Raises
    ------
    MaskError
        If the outputs are ambiguous, or it is not known which of the classes are vehicles.
    """
    guess = _kind(ports, size)
    shapes = ", ".join(f"{name} {_text(shape)}" for name, shape in ports.outputs)
    if guess is None:
        raise MaskError(
            f"{path}: its outputs ({shapes}) are not unmistakable; needed is a contract, {path.stem}.contract.json"
        )
    kind, classes = guess
    ids = _named(ports.metadata) or COCO_VEHICLES.get(classes or 80)
    if ids is None:
        raise MaskError(
            f"{path}: looks like {kind} with {classes} classes, of which it is not known which are vehicles; needed is "
            f"a contract with vehicle_ids, {path.stem}.contract.json"
        )
    spec = INPUTS[kind]
    boxes = OutputSpec(box_format="cxcywh", normalized=True) if kind == "detr" else OutputSpec()
    words = (
        f"no contract; from its outputs ({shapes}) assumed: {kind}, {spec.color}, pixels * {spec.scale:.4g}"
        f"{', ImageNet mean and deviation' if len(spec.mean) == 3 else ''}, {spec.resize}, "
        f"vehicles are the classes {', '.join(map(str, ids))}"
    )
    return Contract(kind, ids, spec, boxes), words


_ULTRALYTICS = InputSpec(scale=UNIT)
INPUTS: dict[Kind, InputSpec] = {
    "yolox_raw": InputSpec(color="BGR", resize="letterbox_topleft"),
    "yolov8_raw": _ULTRALYTICS,
    "yolo_e2e": _ULTRALYTICS,
    "yolo_seg": _ULTRALYTICS,
    "detr": InputSpec(scale=UNIT, mean=(0.485, 0.456, 0.406), std=(0.229, 0.224, 0.225), resize="stretch"),
}
"""Inputs that the published networks of each kind expect."""


def _kind(ports: Ports, size: tuple[int, int]) -> tuple[Kind, int | None] | None:
    """Return the kind and the number of classes; None if the kind is ambiguous."""
    shapes = [shape for _, shape in ports.outputs]
    if len(shapes) == 1 and len(shapes[0]) == 3:
        return _of_one(shapes[0], size)
    if [name for name, _ in ports.outputs] == ["logits", "pred_boxes"]:
        classes = shapes[0][-1]
        return "detr", None if classes is None else classes - 1
    if len(shapes) == 2 and [len(shape) for shape in shapes] == [3, 4]:
        rows, prototypes = shapes[0][1], shapes[1][1]
        if rows is not None and prototypes is not None and rows > 4 + prototypes:
            return "yolo_seg", rows - 4 - prototypes
    return None


def _of_one(shape: Shape, size: tuple[int, int]) -> tuple[Kind, int | None] | None:
    cells = sum((size[0] // stride) * (size[1] // stride) for stride in STRIDES)
    rows, columns = shape[1:]
    if columns == 6 and rows != cells:
        return "yolo_e2e", None
    if rows == cells and columns is not None and columns > 6:
        return "yolox_raw", columns - 5
    if columns in (cells, None) and rows is not None and rows > 4:
        return "yolov8_raw", rows - 4
    return None


def _named(metadata: Mapping[str, str]) -> tuple[int, ...]:
    """Return the ids of the classes with names of vehicles, if the file stores names as Ultralytics does."""
    try:
        names = ast.literal_eval(metadata.get("names", "{}"))
    except (ValueError, SyntaxError, RecursionError, MemoryError):
        return ()
    if not isinstance(names, dict):
        return ()
    return tuple(
        key for key, name in names.items() if isinstance(key, int) and str(name).strip().lower() in VEHICLE_NAMES
    )


def shape_of(values: Sequence[object]) -> Shape:
    """Return a shape given by the runtime, with None for free lengths."""
    return tuple(value if isinstance(value, int) and value > 0 else None for value in values)


def _text(shape: Shape) -> str:
    return "[" + ", ".join("?" if value is None else str(value) for value in shape) + "]"
