"""The contract of a network: a file that describes the network's input and output."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, TypeAlias

from jsonschema import Draft202012Validator
from jsonschema.exceptions import ValidationError

from laci_stereo.io.file_content import read_bytes
from laci_stereo.io.text_file import listed, shortened
from laci_stereo.mask.errors import MaskError

Kind: TypeAlias = Literal[
    "yolox_raw", "yolov8_raw", "yolo_e2e", "ssd", "detr", "instance_masks", "yolo_seg", "semantic"
]
Resize: TypeAlias = Literal["stretch", "letterbox_topleft", "letterbox_center"]
BoxFormat: TypeAlias = Literal["xyxy", "yxyx", "cxcywh"]

SCHEMA = "contract.schema.json"
MOST_BYTES = 1_000_000
"""Maximum size of a contract file, which is a page of text."""


@dataclass(frozen=True)
class InputSpec:
    """The input that a network expects; each field is explained in ``contract.schema.json``."""

    layout: Literal["NCHW", "NHWC"] = "NCHW"
    dtype: Literal["float32", "float16", "uint8"] = "float32"
    color: Literal["RGB", "BGR", "GRAY"] = "RGB"
    scale: float = 1.0
    mean: tuple[float, ...] = (0.0,)
    std: tuple[float, ...] = (1.0,)
    resize: Resize = "letterbox_center"
    pad: float = 114
    size: tuple[int, int] | None = None
    crops: tuple[int, int] | None = None

    @property
    def channels(self) -> int:
        """Number of channels of the input."""
        return 1 if self.color == "GRAY" else 3


@dataclass(frozen=True)
class OutputSpec:
    """The output that a network returns; each field is explained in ``contract.schema.json``."""

    names: tuple[str, ...] = ()
    strides: tuple[int, ...] = (8, 16, 32)
    score: float = 0.3
    nms_iou: float = 0.5
    box_format: BoxFormat = "xyxy"
    normalized: bool = False
    activation: Literal["softmax", "sigmoid"] = "softmax"
    mask_frame: Literal["image", "box"] = "image"


@dataclass(frozen=True)
class Contract:
    """Description of a network's input and output.

    Attributes
    ----------
    kind : str
        How the outputs are decoded.
    vehicle_ids : tuple of int
        The class ids of vehicles.
    input : InputSpec
    output : OutputSpec
    source : Path or None
        The contract file; None if the contract was assumed.
    """

    kind: Kind
    vehicle_ids: tuple[int, ...]
    input: InputSpec = field(default_factory=InputSpec)
    output: OutputSpec = field(default_factory=OutputSpec)
    source: Path | None = None


@cache
def schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a contract."""
    read: dict[str, Any] = json.loads(files("laci_stereo.mask").joinpath(SCHEMA).read_text(encoding="utf-8"))
    return read


def contract_beside(model: Path) -> Path | None:
    """Return the path of ``MODEL.contract.json`` beside ``MODEL.onnx``, or None if there is no such file."""
    path = model.with_suffix(".contract.json")
    return path if path.exists() else None


def read_contract(path: Path) -> Contract:
    """Read a contract.

    Raises
    ------
    MaskError
        If it cannot be read, is no JSON, or does not follow the schema; unknown keys are named.
    """
    try:
        document = json.loads(read_bytes(path, MaskError, "a contract (JSON)", MOST_BYTES).decode("utf-8"))
    except (ValueError, RecursionError) as problem:
        raise MaskError(
            f"{path}: is no JSON ({problem}); needed is a contract as docs/vehicle_mask.md has it"
        ) from None
    problems = sorted(Draft202012Validator(schema()).iter_errors(document), key=lambda each: each.json_path)
    if problems:
        raise MaskError(f"{path}: {_in_words(problems[0])}")
    return _contract(document, path)


def _in_words(problem: ValidationError) -> str:
    place = problem.json_path.removeprefix("$").removeprefix(".") or "contract"
    if problem.validator == "additionalProperties":
        assert isinstance(problem.schema, dict)
        known = problem.schema["properties"]
        unknown = listed([repr(key) for key in problem.instance if key not in known])
        return f"{place} has the unknown keys {unknown}; known are {', '.join(known)}"
    return f"{place}: {shortened(problem.message)}"


def _contract(document: dict[str, Any], path: Path) -> Contract:
    kind: Kind = document["kind"]
    given: list[dict[str, Any]] = [  # the schema has checked their types
        {key: tuple(value) if isinstance(value, list) else value for key, value in document.get(part, {}).items()}
        for part in ("input", "output")
    ]
    spec = InputSpec(**given[0])
    for name in ("mean", "std"):
        count = len(getattr(spec, name))
        if count not in (1, spec.channels):
            raise MaskError(f"{path}: input.{name} has {count} numbers; needed are 1 or {spec.channels} ({spec.color})")
    boxes: dict[str, Any] = {"box_format": "cxcywh", "normalized": True} if kind == "detr" else {}
    return Contract(kind, tuple(document["vehicle_ids"]), spec, OutputSpec(**{**boxes, **given[1]}), path)
