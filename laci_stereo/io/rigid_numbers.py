"""Rotations from the numbers that people write for them, and what gives a wrong one away."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from laci_stereo.core.frames import FloatArray, rigid

WRITTEN = 2e-3
"""Numbers of three decimals are 5e-4 off at most, and the products of a rotation's rows 2 * sqrt(3) times that."""

LARGEST = 1e12
"""Metres, or millimetres of a UTM coordinate with room to spare: more is a mistake."""

NEEDED = "needed is a rotation, whose rows have the length 1 and are perpendicular"


class NoTransformError(ValueError):
    """The numbers are no rigid transform; why, in words."""


def transform_of(numbers: Sequence[float], name: str) -> FloatArray:
    """Return the transform, shape (4, 4), whose 16 numbers, or 12 of the first three rows, are given row by row.

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
    """Return the rotation, shape (3, 3), that a written matrix means: the nearest one.

    Raises
    ------
    NoTransformError
        If it is farther from one than rounding to three decimals takes it.
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
    # What is written in full comes back to the last digit.
    return matrix if off < 1e-12 else left @ right


def rotation_of_quaternion(xyzw: Sequence[float], name: str) -> FloatArray:
    """Return the rotation, shape (3, 3), of a quaternion, its real part last.

    Raises
    ------
    NoTransformError
    """
    norm = math.hypot(*xyzw)
    if not abs(norm - 1.0) <= WRITTEN:
        raise NoTransformError(f"the quaternion of {name} has the norm {norm:.6g}; needed is 1")
    return np.asarray(Rotation.from_quat(np.array(xyzw)).as_matrix())


def rotation_of_angles(angles: Sequence[float], sequence: str, name: str) -> FloatArray:
    """Return the rotation, shape (3, 3), of angles in radians, their axes in scipy's letters.

    Raises
    ------
    NoTransformError
        If one is more than a whole turn.
    """
    largest = max(angles, key=abs)
    if not abs(largest) <= 2 * np.pi:
        raise NoTransformError(f"an angle of {name} is {largest:.6g}; needed are radians: is it in degrees?")
    return np.asarray(Rotation.from_euler(sequence, list(angles)).as_matrix())


def rotation_of_vector(vector: Sequence[float], name: str) -> FloatArray:
    """Return the rotation, shape (3, 3), of a rotation vector in radians.

    Raises
    ------
    NoTransformError
        If it is more than a whole turn.
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
