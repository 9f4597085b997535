"""Transforms in files of other tools: named numbers in text, YAML, JSON or XML."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np

from laci_stereo.core.errors import CalibrationFileError
from laci_stereo.core.frames import FloatArray, rigid
from laci_stereo.io.file_storage import Node, StorageError, parse_file_storage
from laci_stereo.io.result.siting import STATEMENT, Statement, find_statement
from laci_stereo.io.rigid_numbers import (
    LARGEST,
    WRITTEN,
    NoTransformError,
    rotation_of,
    rotation_of_angles,
    rotation_of_quaternion,
    rotation_of_vector,
    transform_of,
    translation_of,
)
from laci_stereo.io.text_file import listed, quoted, read_text, shortened

_DEEPEST = 20
_LONGEST_TEXT = 4000
_NUMBER = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?"
_NUMBERS = re.compile(rf"\s*{_NUMBER}(?:[\s,;]+{_NUMBER})*[\s,;]*")
_ORDERS = (("x", "y", "z", "w"), ("x", "y", "z"), ("qx", "qy", "qz", "qw"), ("roll", "pitch", "yaw"))
_QUATERNIONS = ("rotation", "orientation", "quaternion", "quat", "q")
_ROLL_FIRST, _YAW_FIRST = ("rpy", "roll_pitch_yaw"), ("ypr", "yaw_pitch_roll")
_DEGREES = "_deg"
_UNITS = ("", "_rad", _DEGREES)
_ROTATIONS = (
    *_QUATERNIONS,
    *(f"{name}_{order}" for name in _QUATERNIONS for order in ("xyzw", "wxyz")),
    *("R", "rvec"),
    *(f"{name}{unit}" for name in (*_ROLL_FIRST, *_YAW_FIRST, "euler", "euler_angles") for unit in _UNITS),
)
_TRANSLATIONS = tuple(
    f"{name}{unit}" for unit in ("", "_m") for name in ("translation", "position", "T", "t", "tvec", "xyz")
)
_MAP = r"(?:utm|map|world|odom|earth|global|enu)"
_MAP_FRAME = re.compile(rf"(?:.*/)?{_MAP}(?:_?(?:frame|link|origin|{_MAP}|(?<!\d)\d+[a-z]?))*", re.IGNORECASE)
_FRAME = re.compile(r"/?[A-Za-z][\w/.-]*")
"""A frame's name in ROS."""


@dataclass(frozen=True)
class WrittenPose:
    """A transform as written in a file.

    Attributes
    ----------
    name : str
        Name of the entry.
    T : ndarray, shape (4, 4)
        Rigid transform, in the direction in which it is written.
    grid_scale : float or None
        Scale of the map's x and y that is applied after ``T``; None if the file's transform is rigid.
    from_map : bool or None
        Whether it maps from the map to the sensor; None if the file does not state it.
    notes : tuple of str
        How the file was interpreted.
    """

    name: str
    T: FloatArray
    grid_scale: float | None = None
    from_map: bool | None = None
    notes: tuple[str, ...] = ()


def read_pose(path: Path, entry: str | None, kind: str | None) -> tuple[WrittenPose, Statement | None]:
    """Read the only transform in a file, or the one that ``entry`` names, and the statement that exports of ours hold.

    ``kind`` is one of `KINDS`; None: recognised by the content.

    Raises
    ------
    CalibrationFileError
        If the file cannot be read, holds no transform, or several without ``entry``, or the numbers are no rigid
        transform.
    """
    text = read_text(path, CalibrationFileError)
    try:
        pose = _chosen(_READERS[kind or _kind_of(text)](text), entry)
        if pose.from_map is None and (named := _direction(path.stem)) is not None:
            pose = replace(pose, from_map=named, notes=(*pose.notes, "the direction is told by the file's name alone"))
        return pose, find_statement(text)
    except NoTransformError as problem:
        raise CalibrationFileError(f"{path}: {shortened(str(problem), 600)}") from problem


def _chosen(found: Mapping[str, _Unread], entry: str | None) -> WrittenPose:
    if not found:
        raise NoTransformError(
            "it holds no transform; needed are 16 numbers, or names such as rotation and translation, R and T, or x, "
            "y, z, roll, pitch and yaw"
        )
    if entry is None and len(found) > 1:
        raise NoTransformError(f"it holds {len(found)} transforms, {listed(list(found))}; needed is --entry NAME")
    if entry is not None and entry not in found:
        raise NoTransformError(f"it holds no {quoted(entry)}; needed is --entry with one of {listed(list(found))}")
    return found[entry or next(iter(found))]()


_Unread = Callable[[], WrittenPose]
"""Reads a transform that was found in a file; its numbers are checked only if it is the requested one."""


def _kind_of(text: str) -> str:
    bare = _without_comments(text)
    if "+proj=pipeline" in bare:
        return "proj"
    if "static_transform_publisher" in bare:
        return "ros2"
    if _from_text(bare) is not None:
        return "matrix"
    spaced = re.search(rf"(?m)^\w+:(?:[ \t]+{_NUMBER}){{3,}}[ \t]*$", bare)
    return "kitti" if spaced and text.lstrip()[:1] not in "{<%" else "named"


def _without_comments(text: str) -> str:
    return re.sub(r"(?m)^[ \t]*(#|//|%(?!YAML)).*$", "", text)


def _read_matrix(text: str) -> dict[str, _Unread]:
    numbers = _from_text(_without_comments(text))
    if numbers is None or len(numbers) not in (12, 16):
        found = "no plain numbers" if numbers is None else f"{len(numbers)} numbers"
        raise NoTransformError(f"it holds {found}; needed are the 16 of a 4 x 4 matrix, or the 12 of its first 3 rows")
    return {"matrix": partial(_whole, "matrix", numbers)}


def _read_kitti(text: str) -> dict[str, _Unread]:
    entries: dict[str, Node] = {}
    for line in text.splitlines():
        key, _, value = line.partition(":")
        if _from_text(value) is not None:
            entries[key.strip()] = value
    # Most KITTI files have R and T; other entries beside these repeat the same transform.
    parts: dict[str, Node] = {key: entries[key] for key in ("R", "T") if key in entries}
    return dict(_named(parts if len(parts) == 2 else entries, "", 0))


def _read_proj(text: str) -> dict[str, _Unread]:
    return {"affine": partial(_affine, text)}


def _affine(text: str) -> WrittenPose:
    """Read PROJ's affine step, which may scale x and y by the grid scale."""
    if len(re.findall(r"\+step\b", text)) != 1 or "+proj=affine" not in text or re.search(r"\+inv\b", text):
        raise NoTransformError("the pipeline has other steps than one +proj=affine; needed is that alone")
    given = dict(re.findall(rf"\+([xyz]off|s[123][123])=({_NUMBER})(?=\s|$)", text))
    matrix = np.array([[float(given.get(f"s{i}{j}", i == j)) for j in (1, 2, 3)] for i in (1, 2, 3)])
    scales = np.linalg.norm(np.clip(matrix, -LARGEST, LARGEST), axis=1)
    if not (np.abs(scales - 1.0) < WRITTEN).all() or abs(scales[0] - scales[1]) > 1e-6:
        lengths = " ".join(f"{scale:.7g}" for scale in scales)
        raise NoTransformError(f"the affine step stretches by {lengths}; needed are a grid's scale, twice, and 1")
    scale = float(np.mean(scales[:2]))
    offsets = [float(given.get(f"{axis}off", 0.0)) for axis in "xyz"]
    rotation = rotation_of(matrix / np.array([scale, scale, 1.0])[:, None], "affine")
    return WrittenPose("affine", rigid(rotation, translation_of(offsets, "affine")), scale, from_map=False)


def _read_ros2(text: str) -> dict[str, _Unread]:
    """Read the arguments of static_transform_publisher, at any place in the text."""
    bare = _without_comments(text)
    words = re.findall(rf"--(x|y|z|qx|qy|qz|qw|roll|pitch|yaw)[\s\"',=]+({_NUMBER})(?=[\s\"',\]]|$)", bare)
    keys = [key for key, _ in words]
    rows = _without_names(bare)
    if len(set(keys)) != len(keys) or len(rows) + bool(keys) > 1:
        raise NoTransformError("it starts several static_transform_publisher; needed is a file with one")
    told: dict[str, Node] = rows[0] if rows else {key: float(value) for key, value in words}
    if not rows:
        frames = re.findall(r"--(frame-id|child-frame-id)[\s\"',=]+([^\s\"',=\]]+)", bare)
        told |= {key.replace("-", "_"): frame for key, frame in frames}
    return dict(_named(told, "static_transform_publisher", 0))


def _without_names(text: str) -> list[dict[str, Node]]:
    """Return the arguments in ROS 1's style: x y z, yaw pitch roll or qx qy qz qw, two frames, and maybe a period."""
    words = [word for word in re.split(r"[\s\"',=<>()\[\]]+", text) if word]
    rows: list[dict[str, Node]] = []
    first = 0
    for i, word in enumerate(words):
        if re.fullmatch(_NUMBER, word):
            continue
        turn = {6: ("yaw", "pitch", "roll"), 7: ("qx", "qy", "qz", "qw")}.get(i - first)
        frames = words[i : i + 2]
        if turn and len(frames) == 2 and all(map(_FRAME.fullmatch, frames)):
            row: dict[str, Node] = dict(zip(("x", "y", "z", *turn), map(float, words[first:i]), strict=True))
            rows.append({**row, "frame_id": frames[0], "child_frame_id": frames[1]})
        first = i + 1
    return rows


def _read_named(text: str) -> dict[str, _Unread]:
    try:
        root = parse_file_storage(text)
    except StorageError as problem:
        raise NoTransformError(f"it is neither a matrix nor YAML, JSON or XML: {problem}") from problem
    return dict(_named(dict(root), "", 0))


_READERS: Mapping[str, Callable[[str], dict[str, _Unread]]] = {
    "matrix": _read_matrix,
    "kitti": _read_kitti,
    "proj": _read_proj,
    "ros2": _read_ros2,
    "opencv": _read_named,
    "autoware": _read_named,
    "openlabel": _read_named,
    "dair": _read_named,
    "named": _read_named,
}

KINDS = tuple(_READERS)


@dataclass(frozen=True)
class _Frames:
    """The frames between which a file says that a transform leads, as ROS has it: from the child to its parent."""

    parent: str
    child: str

    @property
    def from_map(self) -> bool | None:
        """Whether they say that the transform leads from the map; None: neither, or both, are named like a map."""
        parent, child = (_MAP_FRAME.fullmatch(each[:200]) is not None for each in (self.parent, self.child))
        return child if parent != child else None


def _named(node: Node, name: str, depth: int, frames: _Frames | None = None) -> Iterator[tuple[str, _Unread]]:
    """Yield every transform in a node and below, with its name; the names of its entries identify it."""
    if depth > _DEEPEST:
        raise NoTransformError(f"it nests deeper than {_DEEPEST} levels")
    if not isinstance(node, dict):
        return
    frames = _frames_of(node) or frames
    numbers = {key: _numbers(value, 0) for key, value in node.items() if key != STATEMENT}
    whole = {key: found for key, found in numbers.items() if found is not None and len(found) in (12, 16)}
    for key, found in whole.items():
        yield _path(name, key), partial(_whole, _path(name, key), found, frames)
    rotation, translation = _rotation_in(node, numbers), _translation_in(node, numbers)
    if not whole and rotation is not None and translation is not None:
        if rotation.name == "roll" and frames is None and "/" in name:  # Autoware writes a frame below its parent
            below = _Frames(*name.split("/")[-2:])
            frames = below if below.from_map is False else None
        called = name or rotation.name
        yield called, partial(_of_parts, called, node, rotation, translation, frames)
        return
    for key, inner in node.items():
        if key != STATEMENT and numbers[key] is None:
            for i, each in enumerate(inner if isinstance(inner, list) else [inner]):
                inside = _path(name, f"{key}[{i}]" if isinstance(inner, list) else key)
                yield from _named(each, inside, depth + 1, frames)


def _frames_of(node: Mapping[str, Node]) -> _Frames | None:
    """Return the frames that a message of ROS states: of a pose it is the parent alone."""
    header = node.get("header")
    parent = node.get("frame_id", header.get("frame_id") if isinstance(header, dict) else None)
    child = node.get("child_frame_id", "")
    return _Frames(parent, child) if isinstance(parent, str) and isinstance(child, str) else None


def _path(name: str, key: str) -> str:
    return f"{name}/{key}" if name else key


_Numbers = Mapping[str, "list[float] | None"]


@dataclass(frozen=True)
class _Rotation:
    """A rotation as written: its entry's name, its kind, its numbers, and what had to be assumed of them.

    Quaternions are in the order x, y, z, w; radians and degrees are roll, pitch and yaw; of an unclear one, the order
    of the three numbers is unknown.
    """

    name: str
    kind: Literal["matrix", "quaternion", "vector", "radians", "degrees", "unclear"]
    numbers: list[float]
    assumed: str = ""


def _rotation_in(node: Mapping[str, Node], numbers: _Numbers) -> _Rotation | None:
    """Return a node's rotation, if it has one."""
    flat = _in_order(node, ("qx", "qy", "qz", "qw"))
    if flat is not None:
        return _Rotation("qx", "quaternion", flat)
    clear = _angles_in(node) or next(
        (found for key in _ROTATIONS if key in node and (found := _rotation_of(key, node[key], numbers[key]))), None
    )
    unclear = (
        _Rotation(key, "unclear", found)
        for key, found in numbers.items()
        if found is not None and len(found) == 3 and (key in _ROTATIONS or key.lower().startswith("euler"))
    )
    return clear or next(unclear, None)


def _rotation_of(key: str, node: Node, numbers: list[float] | None) -> _Rotation | None:
    """Return the rotation of an entry, if its name and the number of its numbers make clear what they are."""
    angles = _angles_in(node, key) if isinstance(node, dict) else None
    if angles is not None or numbers is None:
        return angles
    if len(numbers) == 9:
        return _Rotation(key, "matrix", numbers)
    if len(numbers) == 4 and key.startswith(_QUATERNIONS):
        stated = key.endswith(("_xyzw", "_wxyz"))
        if key.endswith("_wxyz") and not (isinstance(node, dict) and "w" in node):
            numbers = [*numbers[1:], numbers[0]]
        return _Rotation(key, "quaternion", numbers, "x, y, z, w" if isinstance(node, list) and not stated else "")
    if len(numbers) == 3 and key == "rvec":
        return _Rotation(key, "vector", numbers)
    if len(numbers) == 3 and key.startswith((*_ROLL_FIRST, *_YAW_FIRST)):
        return _angles(key, numbers if key.startswith(_ROLL_FIRST) else numbers[::-1], key.endswith(_DEGREES))
    return None


def _angles_in(node: Mapping[str, Node], key: str = "") -> _Rotation | None:
    """Return the angles that a node has by name; ``key``, its own name, may tell their unit."""
    for unit in _UNITS:
        found = _in_order(node, (f"roll{unit}", f"pitch{unit}", f"yaw{unit}"))
        if found is not None:
            return _angles(key or "roll", found, (unit or key).endswith(_DEGREES))
    return None


def _angles(name: str, roll_pitch_yaw: list[float], in_degrees: bool) -> _Rotation:
    unit: Literal["radians", "degrees"] = "degrees" if in_degrees else "radians"
    return _Rotation(name, unit, roll_pitch_yaw, f"roll, pitch and yaw about fixed axes, {unit}")


def _translation_in(node: Mapping[str, Node], numbers: _Numbers) -> list[float] | None:
    for unit in ("", "_m"):
        flat = _in_order(node, (f"x{unit}", f"y{unit}", f"z{unit}"))
        if flat is not None:
            return flat
    return next((found for key in _TRANSLATIONS if (found := numbers.get(key)) and len(found) == 3), None)


def _whole(name: str, numbers: list[float], frames: _Frames | None = None) -> WrittenPose:
    from_map, notes = _stated(name, frames)
    return WrittenPose(name, transform_of(numbers, name), from_map=from_map, notes=notes)


def _stated(name: str, frames: _Frames | None) -> tuple[bool | None, tuple[str, ...]]:
    """Return whether frames, or else names from the innermost on, state the way from the map; and a note if not."""
    if frames is not None and frames.from_map is not None:
        return frames.from_map, ()
    told = (_direction(re.sub(r"\[\d+\]$", "", part)) for part in reversed(name.split("/")))
    from_map = next((each for each in told if each is not None), None)
    if from_map is not None or frames is None:
        return from_map, ()
    between = listed([quoted(each) for each in (frames.parent, frames.child) if each])
    return None, (f"the frames of {name}, {between}, do not say which of them is the map's",)


def _direction(name: str) -> bool | None:
    """Return whether a name such as T_lidar_map or map_to_lidar leads from the map; None if it does not say."""
    apart = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Za-z])(?=2[A-Za-z])|(?<=[A-Za-z]2)(?=[A-Za-z])", "_", name[:200])
    words = ["to" if word == "2" else word for word in re.split(r"[_\W]+", apart.lower()) if word]
    if words.count("to") == 1:
        i = words.index("to")
        sides = words[:i][-1:], words[i + 1 :][:1]
    elif len(words) > 2 and words[0] == "t":
        sides = words[2:] if _of_map(words[1:2]) else words[-1:], words[1:2]
    else:
        return None
    source, target = (_of_map(side) if side else None for side in sides)
    return None if source is None or target is None or source == target else source


def _of_map(words: list[str]) -> bool:
    return all(re.fullmatch(rf"{_MAP}(?:\d+[a-z]?)?", word) for word in words)


def _of_parts(
    name: str,
    node: Mapping[str, Node],
    rotation: _Rotation,
    translation: list[float],
    frames: _Frames | None,
) -> WrittenPose:
    from_map, unclear = _stated(name, frames)
    notes = list(unclear)
    error = node.get("relative_error")
    if isinstance(error, dict):  # DAIR-V2X: a correction to be added to the translation
        delta = [error.get(axis) for axis in ("delta_x", "delta_y")]
        shift = (*(value if isinstance(value, float) else 0.0 for value in delta), 0.0)
        translation = [a + b for a, b in zip(translation, shift, strict=True)]
    if rotation.assumed:
        written = f"quaternion of {name} was" if rotation.kind == "quaternion" else f"angles of {name} were"
        notes.append(f"the {written} taken as {rotation.assumed}")
    turned = _turned(rotation, name)
    T = rigid(turned, translation_of(translation, name))
    if from_map is None and rotation.kind == "vector":  # OpenCV's rvec and tvec map points from the map to the camera
        from_map = True
    return WrittenPose(name, T, from_map=from_map, notes=tuple(notes))


def _turned(rotation: _Rotation, name: str) -> FloatArray:
    """Return the rotation, shape (3, 3)."""
    match rotation.kind:
        case "matrix":
            return rotation_of(np.reshape(rotation.numbers, (3, 3)), name)
        case "quaternion":
            return rotation_of_quaternion(rotation.numbers, name)
        case "vector":
            return rotation_of_vector(rotation.numbers, name)
        case "radians" | "degrees":
            return rotation_of_angles(rotation.numbers, name, degrees=rotation.kind == "degrees")
        case "unclear":
            raise NoTransformError(
                f"{rotation.name} is three numbers, whose order and axes nobody knows; needed is a name that tells "
                "them: roll, pitch and yaw, rpy or ypr (yaw first), in radians about fixed axes, or the same with _deg "
                "(roll_deg, rpy_deg), a rotation matrix, quaternion_xyzw or quaternion_wxyz"
            )


def _numbers(node: Node, depth: int) -> list[float] | None:
    """Return the numbers of a sequence, a matrix, a point with named coordinates or a text; None for anything else."""
    if isinstance(node, float):
        return [node]
    if isinstance(node, str):
        return _from_text(node)
    if depth > 3:
        return None
    if isinstance(node, dict):
        return _numbers(node["data"], depth + 1) if "data" in node else _of_point(node)
    inner = [_numbers(each, depth + 1) for each in node[: _LONGEST_TEXT // 2]]
    return None if any(each is None for each in inner) else [number for each in inner for number in each or []]


def _of_point(node: Mapping[str, Node]) -> list[float] | None:
    return next((found for order in _ORDERS if len(order) == len(node) and (found := _in_order(node, order))), None)


def _in_order(node: Mapping[str, Node], keys: tuple[str, ...]) -> list[float] | None:
    values = [value for value in map(node.get, keys) if isinstance(value, float)]
    return values if len(values) == len(keys) else None


def _from_text(text: str) -> list[float] | None:
    if len(text) > _LONGEST_TEXT or not _NUMBERS.fullmatch(text):
        return None
    return [float(word) for word in re.split(r"[\s,;]+", text) if word]
