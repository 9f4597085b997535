"""The calibration of a stereo camera, from the files that calibration tools write."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from laci_stereo.core.errors import RigError
from laci_stereo.core.frames import FloatArray
from laci_stereo.io.file_storage import Node, StorageError, parse_file_storage
from laci_stereo.io.text_file import listed, quoted, read_text

Size: TypeAlias = tuple[int, int]
"""Width and height of an image, pixels."""

Model: TypeAlias = Literal["pinhole", "fisheye"]

CALIBRATION_FILES = ("stereo.yaml", "stereo.yml", "stereo.json", "stereo.xml")
MIN_BASELINE_M = 0.02
MAX_BASELINE_M = 10.0

_COEFFICIENTS: Mapping[Model, tuple[int, ...]] = {"pinhole": (4, 5, 8, 12, 14), "fisheye": (4,)}
_MAX_ROTATION_ERROR = 1e-3


@dataclass(frozen=True)
class Lens:
    """How one camera projects, in OpenCV's conventions.

    Attributes
    ----------
    K : ndarray, shape (3, 3)
        Camera matrix, pixels.
    distortion : ndarray, shape (k,)
        Of the pinhole model 4, 5, 8, 12 or 14 coefficients (k1, k2, p1, p2, k3, ...), of the fisheye model 4.
    size : tuple of int
        Width and height of the image, pixels.
    model : {"pinhole", "fisheye"}
    """

    K: FloatArray
    distortion: FloatArray
    size: Size
    model: Model


@dataclass(frozen=True)
class StereoRig:
    """Two cameras and where the left one is seen from the right one: ``p_right = R_right_left p_left + t``.

    Attributes
    ----------
    left, right : Lens
    R_right_left : ndarray, shape (3, 3)
    t_right_left_m : ndarray, shape (3,)
        OpenCV's ``T``, metres: about ``(-baseline, 0, 0)``.
    """

    left: Lens
    right: Lens
    R_right_left: FloatArray
    t_right_left_m: FloatArray

    @property
    def baseline_m(self) -> float:
        """The distance between the two cameras, metres."""
        return float(np.linalg.norm(self.t_right_left_m))


def find_stereo_calibration(left_folder: Path) -> Path | None:
    """Return the calibration that lies beside the folder of left images, if there is one."""
    beside = left_folder.absolute().parent
    return next((beside / name for name in CALIBRATION_FILES if (beside / name).is_file()), None)


def read_stereo_calibration(path: Path, image_size: Size | None = None) -> StereoRig:
    """Read a stereo calibration and check that it can be one.

    Parameters
    ----------
    path : Path
        OpenCV FileStorage (YAML, JSON or XML).
    image_size : tuple of int, optional
        Width and height of the images that it is for.

    Raises
    ------
    RigError
        If it cannot be read, lacks an entry, is for images of another size, or describes no usable stereo camera.
    """
    text = read_text(path, RigError)
    for read in _FORMATS:
        rig = read(path, text, image_size)
        if rig is not None:
            _check_rig(path, rig, image_size)
            return rig
    raise RigError(f"{path} is in no known format; needed is an OpenCV FileStorage file (YAML, JSON or XML)")


@dataclass(frozen=True)
class _Entry:
    """A quantity in a FileStorage file, and the names that tools give it; case and underscores do not matter."""

    what: str
    names: tuple[str, ...]

    @staticmethod
    def of_camera(what: str, stems: tuple[str, ...], side: Literal["left", "right"]) -> _Entry:
        """Combine names of a quantity with the ways of naming a camera: K1, cameraMatrixL, left_camera_matrix."""
        marks = ("1", "L", "Left") if side == "left" else ("2", "R", "Right")
        suffixed = tuple(f"{stem}{mark}" for mark in marks for stem in stems)
        prefixed = tuple(f"{side}_{stem}" for stem in stems)
        return _Entry(f"{what} of the {side} camera", suffixed + prefixed)


_MATRIX = ("K", "M", "cameraMatrix", "intrinsics", "intrinsicMatrix", "mtx")
_DISTORTION = ("D", "distCoeffs", "distCoeff", "distortion", "distortionCoefficients", "distortionCoeffs", "dist")
_ROTATION = _Entry("rotation between the cameras", ("R", "rotation", "rotationMatrix", "stereoR"))
_TRANSLATION = _Entry("translation between the cameras", ("T", "translation", "translationVector", "trans", "stereoT"))
_WIDTH = _Entry("image width", ("imageWidth", "width"))
_HEIGHT = _Entry("image height", ("imageHeight", "height"))
_SIZE = _Entry("image size", ("imageSize", "size", "resolution"))
_MODEL_NAMES = ("model", "distortionmodel", "cameramodel")
_MODELS: Mapping[str, Model] = {
    **dict.fromkeys(("fisheye", "equidistant", "kannalabrandt"), "fisheye"),
    **dict.fromkeys(("pinhole", "plumbbob", "radtan", "rationalpolynomial", "rational", "thinprism"), "pinhole"),
    **dict.fromkeys(("tilted", "standard", "opencv", "brown", "brownconrady"), "pinhole"),
}


@dataclass(frozen=True)
class _Storage:
    """A FileStorage file whose entries are found by any of their names."""

    path: Path
    root: Mapping[str, Node]

    def find(self, entry: _Entry) -> tuple[str, Node] | None:
        """Return the name under which an entry stands in the file, and what stands there."""
        present = {_plain(name): name for name in self.root}
        found = next((present[_plain(name)] for name in entry.names if _plain(name) in present), None)
        return None if found is None else (found, self.root[found])

    def array(self, entry: _Entry, shapes: tuple[tuple[int, ...], ...]) -> FloatArray:
        """Return an entry's numbers in the first of the shapes that has as many."""
        found = self.find(entry)
        if found is None:
            raise RigError(
                f"{self.path} lacks the {entry.what}; needed is one of {listed(list(entry.names), 8)} "
                f"(case and underscores do not matter), it holds {listed(list(self.root))}"
            )
        name, node = found
        values = _numbers(node)
        needed = " or ".join(_times(shape) for shape in shapes)
        if values is None:
            raise RigError(f"{self.path}: {name} is no matrix; needed are {needed} numbers ({entry.what})")
        shape = next((shape for shape in shapes if _fits(values.shape, shape)), None)
        if shape is None:
            raise RigError(
                f"{self.path}: {name} holds {_times(values.shape)} numbers; needed are {needed} numbers ({entry.what})"
            )
        if not np.isfinite(values).all():
            raise RigError(f"{self.path}: {name} holds a number that is not finite; needed are {needed} finite ones")
        return values.reshape(shape)


def _read_opencv(path: Path, text: str, image_size: Size | None) -> StereoRig | None:
    try:
        storage = _Storage(path, parse_file_storage(text))
    except StorageError as problem:
        raise RigError(f"{path} is no OpenCV FileStorage file (YAML, JSON or XML): {problem}") from problem
    model = _model(storage)
    size = _size(storage) or image_size
    if size is None:
        raise RigError(
            f"{path} lacks the image size; needed are image_width and image_height, it holds "
            f"{listed(list(storage.root))}"
        )
    left, right = (_lens(storage, side, size, model) for side in ("left", "right"))
    rotation = storage.array(_ROTATION, ((3, 3), (3,)))
    if rotation.shape == (3,):
        rotation = Rotation.from_rotvec(rotation).as_matrix()
    return StereoRig(left, right, rotation, storage.array(_TRANSLATION, ((3,),)))


_FORMATS: tuple[Callable[[Path, str, Size | None], StereoRig | None], ...] = (_read_opencv,)
"""Readers in the order in which they are tried; one that does not know the text returns None."""


def _lens(storage: _Storage, side: Literal["left", "right"], size: Size, model: Model) -> Lens:
    K = storage.array(_Entry.of_camera("camera matrix", _MATRIX, side), ((3, 3),))
    counts = _COEFFICIENTS[model]
    distortion = storage.array(
        _Entry.of_camera(f"{model} distortion", _DISTORTION, side), tuple((count,) for count in counts)
    )
    return Lens(K, distortion, size, model)


def _model(storage: _Storage) -> Model:
    models: list[Model] = []
    for name, node in storage.root.items():
        if _plain(name) in _MODEL_NAMES:
            model = _MODELS.get(_plain(node)) if isinstance(node, str) else None
            if model is None:
                raise RigError(f"{storage.path}: {name} is {quoted(str(node))}; needed is pinhole or fisheye")
            models.append(model)
    return "fisheye" if "fisheye" in models else "pinhole"


def _size(storage: _Storage) -> Size | None:
    if storage.find(_WIDTH) is not None or storage.find(_HEIGHT) is not None:
        values = np.concatenate([storage.array(entry, ((1,),)) for entry in (_WIDTH, _HEIGHT)])
    elif storage.find(_SIZE) is not None:
        values = storage.array(_SIZE, ((2,),))
    else:
        return None
    if not ((values >= 1) & (values <= 1e6) & (values == np.round(values))).all():
        raise RigError(
            f"{storage.path}: the image size is {values[0]:g} x {values[1]:g}; needed are positive whole numbers"
        )
    return int(values[0]), int(values[1])


def _times(shape: tuple[int, ...]) -> str:
    return "x".join(map(str, shape))


def _plain(name: str) -> str:
    return name.lower().replace("_", "").replace("-", "").replace(" ", "")


def _numbers(node: Node) -> FloatArray | None:
    """Return a node's numbers in its own shape, or None if it holds something else."""
    if isinstance(node, dict):
        # OpenCV 5 writes vectors with sizes, everything else has rows and cols.
        sizes = _numbers(node.get("sizes", [node.get("rows", ""), node.get("cols", "")]))
        values = _numbers(node.get("data", ""))
        if sizes is None or values is None or not np.isin(sizes, np.arange(1, values.size + 1)).all():
            return None
        return values.reshape(sizes.astype(int)) if np.prod(sizes) == values.size else None
    inner = node if isinstance(node, list) else [node]
    numbers = [value for value in inner if isinstance(value, float)]
    if numbers:
        return np.array(numbers) if len(numbers) == len(inner) else None
    rows_found = [values for values in (_numbers(row) for row in inner if isinstance(row, list)) if values is not None]
    if not rows_found or len(rows_found) != len(inner) or len({row.shape for row in rows_found}) != 1:
        return None
    return np.stack(rows_found)


def _fits(found: tuple[int, ...], needed: tuple[int, ...]) -> bool:
    """Whether numbers of one shape are those of another: the same, flat, or for a vector a row or a column."""
    size = int(np.prod(needed))
    return found == needed or found == (size,) or (len(needed) == 1 and found in ((1, size), (size, 1)))


def _check_rig(path: Path, rig: StereoRig, image_size: Size | None) -> None:
    for side, lens in (("left", rig.left), ("right", rig.right)):
        _check_lens(path, f"the {side} camera's", lens)
    if image_size is not None and rig.left.size != image_size:
        found, needed = ("{} x {}".format(*size) for size in (rig.left.size, image_size))
        raise RigError(
            f"{path}: the image size is {found}; the images are {needed} pixels, needed is a calibration for these"
        )
    _check_rotation(path, rig.R_right_left)
    _check_baseline(path, rig)


def _check_lens(path: Path, whose: str, lens: Lens) -> None:
    fx, fy, cx, cy = lens.K[0, 0], lens.K[1, 1], lens.K[0, 2], lens.K[1, 2]
    if not (fx > 0 and fy > 0):
        raise RigError(f"{path}: {whose} focal length is {fx:g}, {fy:g} pixels; needed are positive ones")
    if not np.allclose(lens.K[[1, 2, 2], [0, 0, 1]], 0.0) or not np.isclose(lens.K[2, 2], 1.0):
        raise RigError(f"{path}: {whose} camera matrix is no [fx 0 cx; 0 fy cy; 0 0 1]; needed is one")
    width, height = lens.size
    if not (0 <= cx <= width and 0 <= cy <= height):
        raise RigError(
            f"{path}: {whose} principal point is {cx:g}, {cy:g}; needed is one inside the image of {width} x {height}"
        )


def _check_rotation(path: Path, R: FloatArray) -> None:
    error = float(np.abs(R @ R.T - np.eye(3)).max())
    determinant = float(np.linalg.det(R))
    if error > _MAX_ROTATION_ERROR or determinant < 0:
        raise RigError(
            f"{path}: R is no rotation (R R^T is off the identity by {error:.3g}, det R is {determinant:.3g}); "
            "needed is an orthogonal matrix with determinant 1"
        )


def _check_baseline(path: Path, rig: StereoRig) -> None:
    baseline = rig.baseline_m
    if not MIN_BASELINE_M <= baseline <= MAX_BASELINE_M:
        units = [
            name
            for name, metres in (("millimetres", 1e-3), ("centimetres", 1e-2))
            if MIN_BASELINE_M <= baseline * metres <= MAX_BASELINE_M
        ]
        hint = f"; is T in {' or '.join(units)}?" if units and baseline > MAX_BASELINE_M else ""
        raise RigError(
            f"{path}: the baseline (length of T) is {baseline:g} m; a stereo rig's is {MIN_BASELINE_M:g} to "
            f"{MAX_BASELINE_M:g} m{hint}"
        )
    # Seen from half-way between the two orientations, as rectification does.
    half_back = Rotation.from_matrix(rig.R_right_left).as_rotvec() * -0.5
    along = np.abs(Rotation.from_rotvec(half_back).apply(rig.t_right_left_m))
    if along.argmax() == 1:
        raise RigError(
            f"{path}: the cameras stand one above the other (T is {_vector(rig.t_right_left_m)} m); disparity is "
            "searched along rows, needed are cameras side by side"
        )
    if along.argmax() == 2:
        raise RigError(
            f"{path}: the cameras stand one behind the other (T is {_vector(rig.t_right_left_m)} m); needed are "
            "cameras side by side"
        )


def _vector(values: FloatArray) -> str:
    return ", ".join(f"{value:g}" for value in values)
