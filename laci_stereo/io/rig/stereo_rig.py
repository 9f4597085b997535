"""Stereo calibrations independent of their file format: two lenses, the transform between them, and checks of both."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from scipy.spatial.transform import Rotation

from laci_stereo.core.errors import RigError
from laci_stereo.core.frames import FloatArray

Size: TypeAlias = tuple[int, int]
"""Width and height of an image, pixels."""

Model: TypeAlias = Literal["pinhole", "fisheye"]

RAW_FRAME, RECTIFIED_FRAME = (
    f"{which} left camera: origin in the lens, x right, y down, z forward" for which in ("raw", "rectified")
)
"""Descriptions of the sensor frame of results from raw images and from already rectified images; these two frames
differ by a rotation."""

MIN_BASELINE_M = 0.02
MAX_BASELINE_M = 10.0

NARROWEST, WIDEST = 100.0, 0.1
"""Limits of the focal length, in image widths. At 100, an image covers 0.6 deg; 0.1 is half the value of the widest
fisheye lenses (0.32 covers 180 deg)."""

LARGEST_COEFFICIENT = 1e4
"""Largest plausible distortion coefficient: coefficients multiply powers of an image position in focal lengths, which
reaches about one in a wide image. Those of the rational model, whose numerator and denominator nearly cancel, reach
some hundred."""

OFF_MIDDLE = 0.1
"""Largest distance of a principal point from the image centre, as a fraction of half the image size; the lenses of real
cameras are centred better."""

_MAX_ROTATION_ERROR = 1e-3


@dataclass(frozen=True)
class Lens:
    """The projection of one camera, in OpenCV's conventions.

    Attributes
    ----------
    K : ndarray, shape (3, 3)
        Camera matrix, pixels.
    distortion : ndarray, shape (k,)
        Distortion coefficients: 4, 5, 8, 12 or 14 of the pinhole model (k1, k2, p1, p2, k3, ...), 4 of the fisheye
        model.
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
    """Two cameras and the transform from the left to the right one: ``p_right = R_right_left p_left + t_right_left_m``.

    Attributes
    ----------
    left, right : Lens
    R_right_left : ndarray, shape (3, 3)
    t_right_left_m : ndarray, shape (3,)
        OpenCV's ``T``, metres: approximately ``(-baseline, 0, 0)``.
    notes : tuple of str
        How the file was interpreted, where other interpretations are possible.
    rectified : StereoRig or None
        The same cameras for images that were rectified by the calibration's own tool, where the file describes these.
    """

    left: Lens
    right: Lens
    R_right_left: FloatArray
    t_right_left_m: FloatArray
    notes: tuple[str, ...] = ()
    rectified: StereoRig | None = None

    @property
    def baseline_m(self) -> float:
        """The distance between the two cameras, metres."""
        return math.hypot(*self.t_right_left_m)


@dataclass(frozen=True)
class ForImages:
    """The images that a calibration is read for; these and the user complete what a file does not state.

    Attributes
    ----------
    size : tuple of int or None
        Width and height, pixels.
    left : Path or None
        The folder of the left images.
    baseline_m : float or None
        The distance between the cameras, where the user states it: the unit of a file's lengths may be unknown.
    right : Path or None
        The folder of the right images.
    """

    size: Size | None = None
    left: Path | None = None
    baseline_m: float | None = None
    right: Path | None = None

    @property
    def left_camera(self) -> int | None:
        """The camera number in the name of the left folder or its parent, as in ``image_02/data``; None without one."""
        return _camera_in(self.left)

    @property
    def right_camera(self) -> int | None:
        """The same of the right folder."""
        return _camera_in(self.right)


def _camera_in(folder: Path | None) -> int | None:
    parts = () if folder is None else folder.absolute().parts[-2:]
    found = [re.fullmatch(r"(?:image|cam|camera)_?0*(\d{1,2})", part) for part in reversed(parts)]
    return next((int(match[1]) for match in found if match), None)


def rectified_pair(left_P: FloatArray, right_P: FloatArray, size: Size, notes: tuple[str, ...]) -> StereoRig:
    """Return the rig of rectified images from their projection matrices ``K (I | t)``, shape (3, 4), t in metres."""
    left, right = (Lens(P[:, :3].copy(), np.zeros(4), size, "pinhole") for P in (left_P, right_P))
    rig = StereoRig(left, right, np.eye(3), projection_shift(right_P) - projection_shift(left_P), notes)
    return replace(rig, rectified=rig)


def projection_shift(P: FloatArray) -> FloatArray:
    """Return t, shape (3,), of a projection matrix ``K (I | t)``, shape (3, 4), with an upper triangular K."""
    z = P[2, 3] / P[2, 2]
    y = (P[1, 3] - P[1, 2] * z) / P[1, 1]
    return np.array([(P[0, 3] - P[0, 1] * y - P[0, 2] * z) / P[0, 0], y, z])


def with_baseline(name: str, rig: StereoRig, baseline_m: float) -> StereoRig:
    """Return the rig with the baseline that the user states, in the direction that the file states.

    Raises
    ------
    RigError
        If the file's or the user's baseline is not positive and finite.
    """
    read = rig.baseline_m
    if not (0.0 < read < math.inf and 0.0 < baseline_m < math.inf):
        raise RigError(
            f"{name}: the length of T is {read:g}, --baseline says {baseline_m:g} m; needed are numbers above 0"
        )
    note = f"baseline {baseline_m:g} m, as --baseline says; T, read as metres, has {read:.6g} m"
    return _scaled(rig, baseline_m / read, note)


def _scaled(rig: StereoRig, factor: float, note: str) -> StereoRig:
    return replace(
        rig,
        t_right_left_m=rig.t_right_left_m * factor,
        notes=(*rig.notes, note),
        rectified=None if rig.rectified is None else _scaled(rig.rectified, factor, note),
    )


def side_by_side(size: Size, image_size: Size) -> str:
    """Return words on images of which each shows what two cameras see, if their size is twice as wide; else none."""
    twice = image_size == (2 * size[0], size[1])
    return " (are both cameras' side by side in each? cut them in two)" if twice else ""


def check_size(name: str, rig: StereoRig, image_size: Size) -> None:
    """Raise if a calibration is for images of another size.

    Raises
    ------
    RigError
    """
    if rig.left.size == image_size:
        return
    found, needed = ("{} x {}".format(*size) for size in (rig.left.size, image_size))
    factor = image_size[0] / rig.left.size[0]
    scaled = abs(rig.left.size[1] * factor - image_size[1]) <= 1 and factor != 1
    raise RigError(
        f"{name}: the image size is {found}; the images are {needed} pixels, needed is a calibration for these"
        + (f" (were they scaled by {factor:g}?)" if scaled else side_by_side(rig.left.size, image_size))
    )


def check_resolution(name: str, rig: StereoRig) -> None:
    """Raise if all principal points lie at the centre of images of another size; for files that state no image size.

    Raises
    ------
    RigError
    """
    shares = np.array([(lens.K[:2, 2] + 0.5) / np.array(lens.size) for lens in (rig.left, rig.right)])
    factor = 2.0 * float(shares.mean())
    off = np.abs(2.0 * shares - 1.0).min() > OFF_MIDDLE
    if not (factor > 0.0 and off and np.abs(2.0 * shares / factor - 1.0).max() <= OFF_MIDDLE):
        return
    (cx, cy), (width, height) = rig.left.K[:2, 2], rig.left.size
    raise RigError(
        f"{name}: the principal point is {cx:g}, {cy:g}, at {100 * factor / 2:.0f} % of the width and height of "
        f"the {width} x {height} images, and the file tells no image size; needed is a calibration for these, or their "
        f"size in the file (is it of another resolution, about {factor * width:.0f} x {factor * height:.0f}?)"
    )


def check_rig(name: str, rig: StereoRig) -> None:
    """Raise if a calibration does not describe a usable stereo camera.

    Raises
    ------
    RigError
    """
    for side, lens in (("left", rig.left), ("right", rig.right)):
        _check_lens(name, f"the {side} camera's", lens)
    if rig.left.model != rig.right.model:
        raise RigError(
            f"{name}: the left camera is {rig.left.model}, the right one {rig.right.model}; needed is one model"
        )
    _check_rotation(name, rig.R_right_left)
    _check_baseline(name, rig)


def _check_lens(name: str, whose: str, lens: Lens) -> None:
    fx, fy, cx, cy = lens.K[0, 0], lens.K[1, 1], lens.K[0, 2], lens.K[1, 2]
    if not (np.isfinite(lens.K).all() and np.isfinite(lens.distortion).all()):
        raise RigError(f"{name}: {whose} camera matrix or distortion is not finite; needed are finite numbers")
    largest = float(np.abs(lens.distortion).max(initial=0.0))
    if largest > LARGEST_COEFFICIENT:
        raise RigError(
            f"{name}: {whose} distortion has a coefficient of {largest:g}; needed are at most {LARGEST_COEFFICIENT:g}"
        )
    if not (fx > 0 and fy > 0):
        raise RigError(f"{name}: {whose} focal length is {fx:g}, {fy:g} pixels; needed are positive ones")
    if not np.allclose(lens.K[[1, 2, 2], [0, 0, 1]], 0.0) or not np.isclose(lens.K[2, 2], 1.0):
        raise RigError(f"{name}: {whose} camera matrix is no [fx 0 cx; 0 fy cy; 0 0 1]; needed is one")
    width, height = lens.size
    if not (0 <= cx <= width and 0 <= cy <= height):
        raise RigError(
            f"{name}: {whose} principal point is {cx:g}, {cy:g}; needed is one inside the image of {width} x {height}"
        )
    if not WIDEST * width <= min(fx, fy) <= max(fx, fy) <= NARROWEST * width:
        raise RigError(
            f"{name}: {whose} focal length is {fx:g}, {fy:g} pixels in an image {width} wide; needed are "
            f"{WIDEST:g} to {NARROWEST:g} widths"
        )


def _check_rotation(name: str, R: FloatArray) -> None:
    error = float(np.abs(R @ R.T - np.eye(3)).max())
    determinant = float(np.linalg.det(R))
    if not error <= _MAX_ROTATION_ERROR or determinant < 0:
        raise RigError(
            f"{name}: R is no rotation (R R^T is off the identity by {error:.3g}, det R is {determinant:.3g}); "
            "needed is an orthogonal matrix with determinant 1"
        )


def _check_baseline(name: str, rig: StereoRig) -> None:
    baseline = rig.baseline_m
    if not MIN_BASELINE_M <= baseline <= MAX_BASELINE_M:
        units = [
            f"{baseline * metres:.6g} if T is in {unit}"
            for unit, metres in (("millimetres", 1e-3), ("centimetres", 1e-2))
            if MIN_BASELINE_M <= baseline * metres <= MAX_BASELINE_M
        ]
        raise RigError(
            f"{name}: the baseline (length of T) is {baseline:g} m; a stereo rig's is {MIN_BASELINE_M:g} to "
            f"{MAX_BASELINE_M:g} m: needed is T in metres, or --baseline M with the metres between the cameras"
            + (f" ({', '.join(units)})" if units else "")
        )
    # The baseline in a frame half-way between the two orientations, as in rectification.
    half_back = Rotation.from_matrix(rig.R_right_left).as_rotvec() * -0.5
    along = np.abs(Rotation.from_rotvec(half_back).apply(rig.t_right_left_m))
    if along.argmax() == 1:
        raise RigError(
            f"{name}: the cameras stand one above the other (T is {_vector(rig.t_right_left_m)} m); disparity is "
            "searched along rows, needed are cameras side by side"
        )
    if along.argmax() == 2:
        raise RigError(
            f"{name}: the cameras stand one behind the other (T is {_vector(rig.t_right_left_m)} m); needed are "
            "cameras side by side"
        )


def _vector(values: FloatArray) -> str:
    return ", ".join(f"{value:g}" for value in values)
