"""Transforms in files of other tools: named numbers in text, YAML, JSON or XML."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

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
_ROTATIONS = ("rotation", "orientation", "quaternion", "q", "R", "rvec", "rpy", "euler_angles")
_TRANSLATIONS = ("translation", "position", "T", "t", "tvec", "xyz")
_TO_MAP = re.compile(r"T_(utm|map|world)_\w+|\w+_?(to|2)_?(utm|map|world)", re.IGNORECASE)
_FROM_MAP = re.compile(r"T_\w+_(utm|map|world)|(utm|map|world)_?(to|2)_?\w+", re.IGNORECASE)


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


def read_pose(path: Path, entry: str | None = None, kind: str | None = None) -> tuple[WrittenPose, Statement | None]:
    """Read the only transform in a file, or the one that ``entry`` names.

    Parameters
    ----------
    path : Path
    entry : str or None
    kind : str or None
        One of `KINDS`; None: recognised by the content.

    Returns
    -------
    pose : WrittenPose
    statement : Statement or None
        The file's statement about itself, if it is an export of this project.

    Raises
    ------
    CalibrationFileError
        If the file cannot be read, holds no transform, or several without ``entry``, or the numbers are no rigid
        transform.
    """
    text = read_text(path, CalibrationFileError)
    try:
        found = _READERS[kind or _kind_of(text)](text)
        return _chosen(found, entry), find_statement(text)
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
    words = re.findall(
        rf"--(x|y|z|qx|qy|qz|qw|roll|pitch|yaw)[\s\"',=]+({_NUMBER})(?=[\s\"',\]]|$)", _without_comments(text)
    )
    keys = [key for key, _ in words]
    if len(set(keys)) != len(keys):
        raise NoTransformError("it starts several static_transform_publisher; needed is a file with one")
    told: dict[str, Node] = {key: float(value) for key, value in words}
    return dict(_named(told, "static_transform_publisher", 0))


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


def _named(node: Node, name: str, depth: int) -> Iterator[tuple[str, _Unread]]:
    """Yield every transform in a node and below, with its name; the names of its entries identify it."""
    if depth > _DEEPEST:
        raise NoTransformError(f"it nests deeper than {_DEEPEST} levels")
    if not isinstance(node, dict):
        return
    numbers = {key: _numbers(value, 0) for key, value in node.items() if key != STATEMENT}
    whole = {key: found for key, found in numbers.items() if found is not None and len(found) in (12, 16)}
    for key, found in whole.items():
        yield _path(name, key), partial(_whole, _path(name, key), found)
    rotation, translation = _rotation_in(node, numbers), _translation_in(node, numbers)
    if not whole and rotation is not None and translation is not None:
        yield name or rotation[0], partial(_of_parts, name or rotation[0], node, rotation, translation)
        return
    for key, inner in node.items():
        if key != STATEMENT and numbers[key] is None:
            for i, each in enumerate(inner if isinstance(inner, list) else [inner]):
                yield from _named(each, _path(name, f"{key}[{i}]" if isinstance(inner, list) else key), depth + 1)


def _path(name: str, key: str) -> str:
    return f"{name}/{key}" if name else key


_Numbers = Mapping[str, "list[float] | None"]


def _rotation_in(node: Mapping[str, Node], numbers: _Numbers) -> tuple[str, list[float]] | None:
    """Return the name and the numbers of a node's rotation, if it has one."""
    for order in (("qx", "qy", "qz", "qw"), ("roll", "pitch", "yaw")):
        flat = _in_order(node, order)
        if flat is not None:
            return order[0], flat
    return next(((key, found) for key in _ROTATIONS if (found := numbers.get(key)) and len(found) in (3, 4, 9)), None)


def _translation_in(node: Mapping[str, Node], numbers: _Numbers) -> list[float] | None:
    flat = _in_order(node, ("x", "y", "z"))
    if flat is not None:
        return flat
    return next((found for key in _TRANSLATIONS if (found := numbers.get(key)) and len(found) == 3), None)


def _whole(name: str, numbers: list[float]) -> WrittenPose:
    return WrittenPose(name, transform_of(numbers, name), from_map=_direction(name.rpartition("/")[2]))


def _direction(name: str) -> bool | None:
    if _TO_MAP.fullmatch(name):
        return False
    return True if _FROM_MAP.fullmatch(name) else None


def _of_parts(
    name: str, node: Mapping[str, Node], rotation: tuple[str, list[float]], translation: list[float]
) -> WrittenPose:
    key, numbers = rotation
    notes: list[str] = []
    error = node.get("relative_error")
    if isinstance(error, dict):  # DAIR-V2X: a correction to be added to the translation
        delta = [error.get(axis) for axis in ("delta_x", "delta_y")]
        shift = (*(value if isinstance(value, float) else 0.0 for value in delta), 0.0)
        translation = [a + b for a, b in zip(translation, shift, strict=True)]
    if len(numbers) == 9:
        turned = rotation_of(np.reshape(numbers, (3, 3)), name)
    elif len(numbers) == 4:
        if isinstance(node.get(key), list):
            notes.append(f"the quaternion of {name} was taken as x, y, z, w")
        turned = rotation_of_quaternion(numbers, name)
    elif key == "rvec":
        turned = rotation_of_vector(numbers, name)
    else:
        notes.append(f"the angles of {name} were taken as roll, pitch and yaw about fixed axes, radians")
        turned = rotation_of_angles(numbers, "xyz", name)
    # OpenCV's rvec and tvec map points from the map to the camera.
    T = rigid(turned, translation_of(translation, name))
    return WrittenPose(name, T, from_map=True if key == "rvec" else None, notes=tuple(notes))


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
