"""Rotations and translations from the numbers that describe them in files, and checks that reveal wrong ones."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from laci_stereo.core.frames import FloatArray, rigid

WRITTEN = 2e-3
"""Tolerance for numbers with three decimals: they are off by at most 5e-4, and the products of a rotation's rows by at
most 2 * sqrt(3) times that."""

LARGEST = 1e12
"""Largest plausible number, well above metres or millimetres of a UTM coordinate."""

NEEDED = "needed is a rotation, whose rows have the length 1 and are perpendicular"


class NoTransformError(ValueError):
    """The numbers are no rigid transform; the text is the reason."""


def transform_of(numbers: Sequence[float], name: str) -> FloatArray:
    """Return the transform, shape (4, 4), from its 16 numbers, or the 12 of its first three rows, row by row.

    Raises
    ------
    NoTransformError
    """
    T = np.vstack([np.reshape(numbers, (-1, 4)), np.eye(4)[4 - (16 - len(numbers)) // 4 :]])
    if np.abs(T[3] - np.eye(4)[3]).max() > WRITTEN:
        if np.abs(T[:, 3] - np.eye(4)[3]).max() <= WRITTEN:
            raise NoTransformError(f"{name} is transposed, its last column is 0 0 0 1; needed is that as its last row")
        raise NoTransformError(f"the last row of {name} is {' '.join(f'{x:.4g}' for x in T[3])}; needed is 0 0 0 1")
    return rigid(rotation_of(T[:3, :3], name), translation_of(T[:3, 3], name))


def rotation_of(matrix: FloatArray, name: str) -> FloatArray:
    """Return the rotation, shape (3, 3), nearest to a written matrix.

    Raises
    ------
    NoTransformError
        If the matrix deviates from a rotation by more than rounding to three decimals explains.
    """
    if not (np.isfinite(matrix).all() and np.abs(matrix).max() < LARGEST):
        raise NoTransformError(f"the rotation of {name} has numbers that are not finite; {NEEDED}")
    lengths = np.linalg.norm(matrix, axis=1)
    even = np.ptp(lengths) < WRITTEN * lengths.max()
    if even and abs(lengths.mean() - 1.0) > WRITTEN:
        raise NoTransformError(f"the rotation of {name} is scaled by {lengths.mean():.6g}; {NEEDED}")
    off = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if off > WRITTEN:
        raise NoTransformError(f"the rotation of {name} is none, its rows' products are off by {off:.3g}; {NEEDED}")
    if np.linalg.det(matrix) < 0:
        raise NoTransformError(f"the rotation of {name} mirrors (determinant -1); needed are right-handed frames")
    left, _, right = np.linalg.svd(matrix)
    # A matrix written with all digits is returned unchanged.
    return matrix if off < 1e-12 else left @ right


def rotation_of_quaternion(xyzw: Sequence[float], name: str) -> FloatArray:
    """Return the rotation, shape (3, 3), of a unit quaternion, real part last.

    Raises
    ------
    NoTransformError
    """
    norm = math.hypot(*xyzw)
    if not abs(norm - 1.0) <= WRITTEN:
        raise NoTransformError(f"the quaternion of {name} has the norm {norm:.6g}; needed is 1")
    return np.asarray(Rotation.from_quat(np.array(xyzw)).as_matrix())


def rotation_of_angles(angles: Sequence[float], name: str, *, degrees: bool) -> FloatArray:
    """Return the rotation, shape (3, 3), of roll, pitch and yaw in radians, or degrees, about fixed axes.

    Raises
    ------
    NoTransformError
        If an angle exceeds a full turn.
    """
    largest = max(angles, key=abs)
    if not abs(largest) <= (360.0 if degrees else 2 * np.pi):
        needed = "degrees, at most 360" if degrees else "radians: is it in degrees? A name such as roll_deg says so"
        raise NoTransformError(f"an angle of {name} is {largest:.6g}; needed are {needed}")
    return np.asarray(Rotation.from_euler("xyz", list(angles), degrees=degrees).as_matrix())


def rotation_of_vector(vector: Sequence[float], name: str) -> FloatArray:
    """Return the rotation, shape (3, 3), of a rotation vector in radians.

    Raises
    ------
    NoTransformError
        If its angle exceeds a full turn.
    """
    angle = math.hypot(*vector)
    if not angle <= 2 * np.pi:
        raise NoTransformError(f"the rotation vector of {name} has the length {angle:.6g}; needed are radians")
    return np.asarray(Rotation.from_rotvec(np.array(vector)).as_matrix())


def translation_of(numbers: Sequence[float] | FloatArray, name: str) -> FloatArray:
    """Return a translation, shape (3,).

    Raises
    ------
    NoTransformError
    """
    translation = np.array(numbers, dtype=np.float64)
    if not (np.isfinite(translation).all() and np.abs(translation).max() < LARGEST):
        raise NoTransformError(f"the translation of {name} is {' '.join(map(str, numbers))}; needed are metres")
    return translation
