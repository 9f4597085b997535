"""Small networks, built on the spot, whose outputs are known: they find what is bright.

Each one is a real ONNX graph: the picture is averaged over squares of 8 x 8 pixels, and a square is a vehicle where it
is brighter than `BRIGHT`. The kinds differ in how that is told.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto, helper, numpy_helper

from laci_stereo.core.frames import Raster

SIDE = 64
"""Of the pictures."""

STRIDE = 8
CELLS = SIDE // STRIDE
COUNT = CELLS * CELLS
BRIGHT = 128.0
OPSET = 17


def square(x0: int, y0: int, x1: int, y1: int, side: int = SIDE) -> Raster:
    """A dark picture with a bright rectangle."""
    picture = np.full((side, side, 3), 20, dtype=np.uint8)
    picture[y0:y1, x0:x1] = 230
    return picture


class Graph:
    """Nodes and constants on their way to a model."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def constant(self, value: npt.ArrayLike, dtype: type = np.float32) -> str:
        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.asarray(value, dtype=dtype), name))
        return name

    def node(self, operator: str, *inputs: str, name: str | None = None, **attributes: object) -> str:
        output = name or f"n{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, list(inputs), [output], **attributes))
        return output

    def shaped(self, value: str, shape: Sequence[int], name: str | None = None) -> str:
        return self.node("Reshape", value, self.constant(shape, np.int64), name=name)

    def brightness(self, channels: int = 3) -> str:
        """The mean of each square, from 0 to 255, shape (1, COUNT, 1)."""
        mean = self.node("ReduceMean", "images", axes=[1], keepdims=1) if channels > 1 else "images"
        pooled = self.node("AveragePool", mean, kernel_shape=[STRIDE, STRIDE], strides=[STRIDE, STRIDE])
        return self.shaped(pooled, [1, COUNT, 1])

    def score(self) -> str:
        """1 where it is bright, else 0, shape (1, COUNT, 1)."""
        bright = self.node("Greater", self.brightness(), self.constant(BRIGHT))
        return self.node("Cast", bright, to=TensorProto.FLOAT)

    def model(
        self, outputs: Sequence[str], channels: int = 3, size: Sequence[int | str] = (SIDE, SIDE), opset: int = OPSET
    ) -> onnx.ModelProto:
        graph = helper.make_graph(
            self.nodes,
            "bright",
            [helper.make_tensor_value_info("images", TensorProto.FLOAT, [1, channels, *size])],
            [onnx.ValueInfoProto(name=name) for name in outputs],
            self.constants,
        )
        made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)])
        made.ir_version = 8
        if opset == OPSET:
            made = onnx.shape_inference.infer_shapes(made)
            onnx.checker.check_model(made)
        return made


def corners(unit: float = 1.0) -> npt.NDArray[np.float32]:
    """Left, top, right and bottom of each square, shape (1, COUNT, 4)."""
    row, column = np.divmod(np.arange(COUNT), CELLS)
    boxes = np.column_stack([column, row, column + 1, row + 1]) * STRIDE * unit
    return boxes[None].astype(np.float32)


def middles(unit: float = 1.0) -> npt.NDArray[np.float32]:
    """Middle, width and height of each square, shape (1, COUNT, 4)."""
    boxes = corners(unit)
    return np.concatenate([(boxes[..., :2] + boxes[..., 2:]) / 2, boxes[..., 2:] - boxes[..., :2]], axis=2)


def yolox_raw() -> onnx.ModelProto:
    """Grids of one stride; the class 1 of 2 is where it is bright. Middles lie half a cell from its corner."""
    graph = Graph()
    score = graph.score()
    raw = graph.constant(np.tile([0.5, 0.5, 0.0, 0.0], (1, COUNT, 1)))
    zero = graph.constant(np.zeros((1, COUNT, 1)))
    graph.node("Concat", raw, score, zero, score, axis=2, name="output")
    return graph.model(["output"])


def yolov8_raw(classes: int = 2) -> onnx.ModelProto:
    graph = Graph()
    none = graph.constant(np.zeros((1, COUNT, classes - 1)))
    rows = graph.node("Concat", graph.constant(middles()), none, graph.score(), axis=2)
    graph.node("Transpose", rows, perm=[0, 2, 1], name="output0")
    return graph.model(["output0"])


def yolo_e2e() -> onnx.ModelProto:
    graph = Graph()
    score = graph.score()
    graph.node("Concat", graph.constant(corners()), score, score, axis=2, name="output0")
    return graph.model(["output0"])


def ssd(unit: float = 1.0 / SIDE) -> onnx.ModelProto:
    graph = Graph()
    score = graph.score()
    graph.node("Gather", graph.constant(corners(unit)), graph.constant([1, 0, 3, 2], np.int64), axis=2, name="boxes")
    graph.shaped(score, [1, COUNT], name="scores")
    graph.shaped(score, [1, COUNT], name="classes")
    return graph.model(["boxes", "scores", "classes"])


def ssd_per_class() -> onnx.ModelProto:
    graph = Graph()
    score = graph.score()
    graph.node("Identity", graph.constant(corners()), name="boxes")
    graph.node("Concat", graph.constant(np.zeros((1, COUNT, 1))), score, axis=2, name="scores")
    return graph.model(["boxes", "scores"])


def detr() -> onnx.ModelProto:
    """Classes 0 and 1, and 'nothing' as the third; the bright squares have a large logit of class 1."""
    graph = Graph()
    sure = graph.node("Mul", graph.score(), graph.constant(20.0))
    zero, ten = (graph.constant(np.full((1, COUNT, 1), value)) for value in (0.0, 10.0))
    graph.node("Concat", zero, sure, ten, axis=2, name="logits")
    graph.node("Identity", graph.constant(middles(1 / SIDE)), name="pred_boxes")
    return graph.model(["logits", "pred_boxes"])


def instance_masks() -> onnx.ModelProto:
    """One instance over the whole picture whose mask is what is bright, without an axis for the batch."""
    graph = Graph()
    mean = graph.node("ReduceMean", "images", axes=[1], keepdims=1)
    bright = graph.node("Greater", mean, graph.constant(BRIGHT))
    mask = graph.node("Cast", bright, to=TensorProto.FLOAT, name="masks")
    some = graph.node("ReduceMax", mask, keepdims=0)
    graph.shaped(some, [1], name="scores")
    graph.node("Identity", graph.constant([[0.0, 0.0, SIDE, SIDE]]), name="boxes")
    graph.node("Identity", graph.constant([1], np.int64), name="labels")
    return graph.model(["boxes", "labels", "scores", "masks"])


def yolo_seg() -> onnx.ModelProto:
    """One prototype, at a quarter of the size: large where it is bright; each box has the coefficient 1."""
    graph = Graph()
    score = graph.score()
    whole = graph.constant(np.tile([SIDE / 2, SIDE / 2, SIDE, SIDE], (1, COUNT, 1)))
    none, one = (graph.constant(np.full((1, COUNT, 1), value)) for value in (0.0, 1.0))
    rows = graph.node("Concat", whole, none, score, one, axis=2)
    graph.node("Transpose", rows, perm=[0, 2, 1], name="output0")
    mean = graph.node("ReduceMean", "images", axes=[1], keepdims=1)
    small = graph.node("AveragePool", mean, kernel_shape=[4, 4], strides=[4, 4])
    graph.node("Sub", small, graph.constant(BRIGHT), name="output1")
    return graph.model(["output0", "output1"])


def semantic(*, as_classes: bool = False) -> onnx.ModelProto:
    """Logits of two classes, or the class itself, for each pixel."""
    graph = Graph()
    mean = graph.node("ReduceMean", "images", axes=[1], keepdims=1)
    if as_classes:
        graph.node("Cast", graph.node("Greater", mean, graph.constant(BRIGHT)), to=TensorProto.INT64, name="classes")
        return graph.model(["classes"])
    limit = graph.node("Add", graph.node("Mul", mean, graph.constant(0.0)), graph.constant(BRIGHT))
    graph.node("Concat", limit, mean, axis=1, name="logits")
    return graph.model(["logits"])


def constant_output(value: float, shape: Sequence[int], name: str = "output") -> onnx.ModelProto:
    """A network that returns the same whatever it sees."""
    graph = Graph()
    nothing = graph.node("Mul", graph.node("ReduceMin", "images", keepdims=0), graph.constant(0.0))
    graph.node("Add", nothing, graph.constant(np.full(shape, value)), name=name)
    return graph.model([name])


def save(model: onnx.ModelProto, folder: Path, contract: dict[str, object] | None = None, name: str = "net") -> Path:
    """Write a model, and its contract beside it."""
    path = folder / f"{name}.onnx"
    path.write_bytes(model.SerializeToString())
    if contract is not None:
        (folder / f"{name}.contract.json").write_text(json.dumps(contract))
    return path
