"""Decoding of network outputs into boxes and masks: one function for each kind of output."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from laci_stereo.core.frames import BoolArray, FloatArray, IntArray, Raster
from laci_stereo.mask.contract import BoxFormat, Contract, Kind
from laci_stereo.mask.errors import MaskError

Masks = Callable[[int], BoolArray]
"""Returns the mask of the detection with this index, at the size of the input."""

SMALLEST_AREA_PX = 64
"""Least area of a connected component of a semantic segmentation: one below 8 x 8 input pixels is no vehicle that could
be measured."""

MASK_LEVEL = 0.5
"""Probability above which a pixel belongs to the object."""


@dataclass(frozen=True)
class Found:
    """A vehicle in the input of the network.

    Attributes
    ----------
    box : ndarray, shape (4,)
        Left, top, right, bottom, pixels.
    score : float
    class_id : int
    mask : ndarray of bool, shape (height, width), or None
        Over the whole input; None if the network has no masks.
    """

    box: FloatArray
    score: float
    class_id: int
    mask: BoolArray | None = None


@dataclass(frozen=True)
class Candidates:
    """All detections of a network before any selection.

    Attributes
    ----------
    boxes : ndarray, shape (n, 4)
        Left, top, right, bottom, pixels of the input.
    scores : ndarray, shape (n,)
    classes : ndarray of int, shape (n,)
    count : int or None
        Number of classes, if the shapes of the outputs determine it.
    masks : callable or None
    """

    boxes: FloatArray
    scores: FloatArray
    classes: IntArray
    count: int | None = None
    masks: Masks | None = None


@dataclass(frozen=True)
class Returned:
    """The outputs of a network, in the order of their roles.

    Attributes
    ----------
    values : tuple of ndarray
    names : tuple of str
    size : tuple of int
        Width and height of the input.
    contract : Contract
    model : str
        Path of the model file, for messages.
    """

    values: tuple[npt.NDArray[np.generic], ...]
    names: tuple[str, ...]
    size: tuple[int, int]
    contract: Contract
    model: str

    def needs(self, role: int, fits: bool, needed: str) -> None:
        """Raise if the shape of an output does not fit the contract.

        Raises
        ------
        MaskError
        """
        if not fits:
            raise MaskError(
                f"{self.model}: the output {self.names[role]!r} has the shape {list(self.values[role].shape)}; needed "
                f"for the kind {self.contract.kind} is {needed}"
            )

    def single(self, role: int, needed: str, ndim: int = 2) -> FloatArray:
        """Return an output without its batch axis, as float32."""
        value = self.values[role]
        self.needs(role, value.ndim == ndim + 1 and value.shape[0] == 1, needed)
        without: FloatArray = value[0].astype(np.float32)
        return without


ROLES: dict[Kind, tuple[int, int]] = {
    "yolox_raw": (1, 1), "yolov8_raw": (1, 1), "yolo_e2e": (1, 1), "ssd": (2, 3), "detr": (2, 2),
    "instance_masks": (4, 4), "yolo_seg": (2, 2), "semantic": (1, 1),
}  # fmt: skip
"""Least and greatest number of outputs of each kind."""


def decode(returned: Returned) -> tuple[Found, ...]:
    """Decode the outputs of a network, and select the vehicles with a sufficient score.

    Raises
    ------
    MaskError
        If an output's shape does not fit, holds NaN, or has fewer classes than the contract's class ids need.
    """
    for name, value in zip(returned.names, returned.values, strict=True):
        if value.dtype.kind == "f" and bool(np.isnan(value).any()):
            raise MaskError(f"{returned.model}: the output {name!r} holds NaN; needed are numbers")
    contract = returned.contract
    given = DECODERS[contract.kind](returned)
    highest = max(contract.vehicle_ids)
    if given.count is not None and highest >= given.count:
        raise MaskError(
            f"{contract.source or returned.model}: vehicle_ids has {highest}; the output has {given.count} classes, "
            f"needed are numbers from 0 to {given.count - 1}"
        )
    good = np.flatnonzero((given.scores >= contract.output.score) & np.isin(given.classes, contract.vehicle_ids))
    width, height = returned.size
    boxes = given.boxes[good].clip(0, [width, height, width, height])
    good, boxes = good[has_area(boxes)], boxes[has_area(boxes)]
    kept = suppressed(boxes, given.scores[good], contract.output.nms_iou)
    return tuple(
        Found(
            boxes[index].astype(np.float64),
            float(given.scores[good[index]]),
            int(given.classes[good[index]]),
            None if given.masks is None else given.masks(int(good[index])),
        )
        for index in kept
    )


def has_area(boxes: FloatArray) -> BoolArray:
    """Return which boxes, shape (n, 4), have a positive area."""
    some: BoolArray = (boxes[:, 2] > boxes[:, 0]) & (boxes[:, 3] > boxes[:, 1])
    return some


def suppressed(boxes: FloatArray, scores: FloatArray, most_iou: float) -> list[int]:
    """Return the indices of the boxes that no better one overlaps by more than ``most_iou``, best first.

    Classes are not distinguished: an object that resembles both a car and a lorry is one vehicle.
    """
    left = np.argsort(-scores, kind="stable")
    kept: list[int] = []
    while len(left):
        best, left = int(left[0]), left[1:]
        kept.append(best)
        left = left[iou(boxes[best], boxes[left]) <= most_iou]
    return kept


def iou(box: FloatArray, others: FloatArray) -> FloatArray:
    """Return the intersection over union of boxes, shape (n, 4), with one box, shape (4,)."""
    sides = np.minimum(box[2:], others[:, 2:]) - np.maximum(box[:2], others[:, :2])
    common = sides.clip(0).prod(axis=1)
    areas = (others[:, 2:] - others[:, :2]).prod(axis=1) + (box[2:] - box[:2]).prod() - common
    share: FloatArray = common / np.maximum(areas, 1e-9)
    return share


def _best(scores: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return the best class's score for each row, and its index; ``scores`` has shape (n, classes)."""
    classes = scores.argmax(axis=1) if scores.shape[1] else np.zeros(len(scores), dtype=np.int64)
    return scores[np.arange(len(scores)), classes], classes.astype(np.int64)


def _from_middle(boxes: FloatArray) -> FloatArray:
    half = boxes[:, 2:4] / 2
    return np.concatenate([boxes[:, :2] - half, boxes[:, :2] + half], axis=1)


def _corners(boxes: FloatArray, returned: Returned) -> FloatArray:
    """Convert boxes from the contract's format to left, top, right, bottom in pixels."""
    output = returned.contract.output
    by_format: dict[BoxFormat, Callable[[], FloatArray]] = {
        "xyxy": lambda: boxes,
        "yxyx": lambda: boxes[:, [1, 0, 3, 2]],
        "cxcywh": lambda: _from_middle(boxes),
    }
    unit = np.tile(returned.size, 2) if output.normalized else np.ones(4)
    scaled: FloatArray = by_format[output.box_format]() * unit
    return scaled


def _yolox_raw(returned: Returned) -> Candidates:
    """Decode boxes given relative to grid cells (Ge et al., YOLOX, 2021): centre offsets, and logarithms of sizes."""
    width, height = returned.size
    grids = [(stride, height // stride, width // stride) for stride in returned.contract.output.strides]
    total = sum(rows * columns for _, rows, columns in grids)
    needed = f"[1, {total}, 5 + classes] for an input of {width}x{height}"
    values = returned.single(0, needed)
    returned.needs(0, len(values) == total and values.shape[1] > 5, needed)
    cells = np.concatenate([_cells(stride, rows, columns) for stride, rows, columns in grids])
    middle = (values[:, :2] + cells[:, :2]) * cells[:, 2:]
    with np.errstate(over="ignore"):
        boxes = _from_middle(np.concatenate([middle, np.exp(values[:, 2:4]) * cells[:, 2:]], axis=1))
    scores, classes = _best(values[:, 5:])
    return Candidates(boxes, scores * values[:, 4], classes, values.shape[1] - 5)


def _cells(stride: int, rows: int, columns: int) -> FloatArray:
    """Return the column, row and stride of each cell of a grid, shape (n, 3)."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    return np.column_stack([column, row, np.full(len(row), stride)]).astype(np.float32)


def _yolov8_raw(returned: Returned) -> Candidates:
    needed = "[1, 4 + classes, n] with more boxes than classes"
    values = returned.single(0, needed)
    values = values.T if values.shape[0] < values.shape[1] else values
    returned.needs(0, values.shape[1] > 4, needed)
    scores, classes = _best(values[:, 4:])
    return Candidates(_from_middle(values), scores, classes, values.shape[1] - 4)


def _yolo_e2e(returned: Returned) -> Candidates:
    needed = "[1, n, 6]: a box, a score, a class"
    values = returned.single(0, needed)
    returned.needs(0, values.shape[1] == 6, needed)
    return Candidates(_corners(values[:, :4], returned), values[:, 4], values[:, 5].astype(np.int64))


def _ssd(returned: Returned) -> Candidates:
    boxes = returned.single(0, "[1, n, 4]")
    returned.needs(0, boxes.shape[1] == 4, "[1, n, 4]")
    boxes = _corners(boxes, returned)
    if len(returned.values) == 2:
        per_class = returned.single(1, f"[1, {len(boxes)}, classes]")
        returned.needs(1, len(per_class) == len(boxes), f"[1, {len(boxes)}, classes]")
        return Candidates(boxes, *_best(per_class), per_class.shape[1])
    needed = f"[1, {len(boxes)}]"
    scores, classes = (returned.single(role, needed, ndim=1) for role in (1, 2))
    for role, values in ((1, scores), (2, classes)):
        returned.needs(role, len(values) == len(boxes), needed)
    return Candidates(boxes, scores, classes.astype(np.int64))


def _detr(returned: Returned) -> Candidates:
    """Decode queries with class logits and boxes (Carion et al., 2020)."""
    logits, boxes = (returned.single(role, needed) for role, needed in ((0, "[1, n, classes]"), (1, "[1, n, 4]")))
    returned.needs(1, boxes.shape == (len(logits), 4), f"[1, {len(logits)}, 4]")
    if returned.contract.output.activation == "sigmoid":
        likely = _sigmoid(logits)
    else:
        powers = np.exp(logits - logits.max(axis=1, keepdims=True))
        likely = (powers / powers.sum(axis=1, keepdims=True))[:, :-1]  # the last class is "nothing"
    return Candidates(_corners(boxes, returned), *_best(likely), likely.shape[1])


def _sigmoid(values: FloatArray) -> FloatArray:
    powers: FloatArray = 1 / (1 + np.exp(-values.clip(-60, 60)))
    return powers


def _instance_masks(returned: Returned) -> Candidates:
    """Decode boxes, scores, classes and one mask each, with or without a batch axis (as in Mask R-CNN)."""
    boxes, scores, classes, masks = (
        value[0] if value.ndim == ndim + 1 and value.shape[0] == 1 else value
        for value, ndim in zip(returned.values, (2, 1, 1, 3), strict=True)
    )
    if masks.ndim == 4 and masks.shape[1] == 1:
        masks = masks[:, 0]
    n = len(boxes)
    returned.needs(0, boxes.ndim == 2 and boxes.shape[1] == 4, "[n, 4]")
    for role, value in ((1, scores), (2, classes)):
        returned.needs(role, value.shape == (n,), f"[{n}]")
    returned.needs(3, masks.ndim == 3 and len(masks) == n, f"[{n}, 1, height, width]")
    corners = _corners(boxes.astype(np.float32), returned)

    def mask_of(index: int) -> BoolArray:
        level = masks[index].astype(np.float32)
        if returned.contract.output.mask_frame == "image":
            return _enlarged(level, returned.size)
        return _pasted(level, corners[index], returned.size)

    return Candidates(corners, scores.astype(np.float32), classes.astype(np.int64), None, mask_of)


def _enlarged(level: Raster, size: tuple[int, int]) -> BoolArray:
    mask: BoolArray = cv2.resize(level, size, interpolation=cv2.INTER_LINEAR) > MASK_LEVEL
    return mask


def _pasted(level: Raster, box: FloatArray, size: tuple[int, int]) -> BoolArray:
    """Return the mask over the whole input, from one that covers only its box."""
    mask, (x0, y0, x1, y1) = np.zeros(size[::-1], dtype=bool), _inside(box, size)
    if x1 > x0 and y1 > y0:
        mask[y0:y1, x0:x1] = _enlarged(level, (x1 - x0, y1 - y0))
    return mask


def _inside(box: FloatArray, size: tuple[int, int]) -> list[int]:
    """Return the left, top, right and bottom of a box, whole pixels, within an input of this width and height."""
    whole: list[int] = np.rint(box.clip(0, np.tile(size, 2))).astype(int).tolist()
    return whole


def _yolo_seg(returned: Returned) -> Candidates:
    """Decode boxes with mask coefficients for prototypes (Bolya et al., YOLACT, 2019, in the order of YOLOv8-seg)."""
    prototypes = returned.single(1, "[1, prototypes, height, width]", ndim=3)
    count = len(prototypes)
    needed = f"[1, 4 + classes + {count}, n]"
    values = returned.single(0, needed)
    values = values.T if values.shape[0] < values.shape[1] else values
    classes_count = values.shape[1] - 4 - count
    returned.needs(0, classes_count > 0, needed)
    boxes = _from_middle(values)
    scores, classes = _best(values[:, 4 : 4 + classes_count])

    def mask_of(index: int) -> BoolArray:
        level = _sigmoid(np.tensordot(values[index, 4 + classes_count :], prototypes, axes=1))
        mask, (x0, y0, x1, y1) = np.zeros(returned.size[::-1], dtype=bool), _inside(boxes[index], returned.size)
        mask[y0:y1, x0:x1] = _enlarged(level.astype(np.float32), returned.size)[y0:y1, x0:x1]
        return mask

    return Candidates(boxes, scores, classes, classes_count, mask_of)


def _semantic(returned: Returned) -> Candidates:
    """Decode one class per pixel, given as a map or as logits; its connected components are the vehicles."""
    values = returned.values[0]
    needed = "[1, classes, height, width] (logits) or [1, height, width] or [1, 1, height, width] (classes)"
    returned.needs(0, values.ndim in (3, 4) and values.shape[0] == 1, needed)
    count = int(values.shape[1]) if values.ndim == 4 and values.shape[1] > 1 else None
    of_pixel = values[0].argmax(axis=0) if count is not None else values.reshape(values.shape[-2:]).astype(np.int64)
    is_vehicle = np.isin(of_pixel, returned.contract.vehicle_ids).astype(np.uint8)
    vehicle = cv2.resize(is_vehicle, returned.size, interpolation=cv2.INTER_NEAREST)
    _, islands, stats, _ = cv2.connectedComponentsWithStats(vehicle)
    large = 1 + np.flatnonzero(stats[1:, cv2.CC_STAT_AREA] >= SMALLEST_AREA_PX)
    corner, extent = stats[large, :2], stats[large, 2:4]
    boxes = np.concatenate([corner, corner + extent], axis=1).astype(np.float64)
    classes = np.full(len(large), returned.contract.vehicle_ids[0])
    return Candidates(boxes, np.ones(len(large)), classes, count, lambda index: islands == large[index])


DECODERS: dict[Kind, Callable[[Returned], Candidates]] = {
    "yolox_raw": _yolox_raw,
    "yolov8_raw": _yolov8_raw,
    "yolo_e2e": _yolo_e2e,
    "ssd": _ssd,
    "detr": _detr,
    "instance_masks": _instance_masks,
    "yolo_seg": _yolo_seg,
    "semantic": _semantic,
}


def in_roles(
    names: Sequence[str],
    values: Sequence[npt.NDArray[np.generic]],
    contract: Contract,
    model: str,
    size: tuple[int, int],
) -> Returned:
    """Arrange outputs in the order of their roles.

    Raises
    ------
    MaskError
        If the contract names an output that does not exist, or there are too few or too many.
    """
    wanted = contract.output.names or tuple(names)
    missing = [name for name in wanted if name not in names]
    if missing:
        raise MaskError(f"{model}: has no output {missing[0]!r}; its outputs are {', '.join(names)}")
    least, most = ROLES[contract.kind]
    if not least <= len(wanted) <= most:
        needed = str(least) if least == most else f"{least} or {most}"
        raise MaskError(
            f"{model}: has {len(wanted)} outputs ({', '.join(wanted)}); needed for the kind {contract.kind} are "
            f"{needed}; output.names chooses among them"
        )
    by_name = dict(zip(names, values, strict=True))
    return Returned(tuple(by_name[name] for name in wanted), wanted, size, contract, model)
