"""The coordinate frames, defined once, and the rigid transforms between them.

All frames are right-handed, in metres. ``T_a_b`` maps coordinates in b to coordinates in a: ``p_a = T_a_b @ p_b``.

=========== ==========================================================================================
sensor      what is calibrated. Stereo: the raw left camera, OpenCV axes. LiDAR: as in its files
rectified   the left camera after rectification; ``T_sensor_rectified`` is a pure rotation
level       origin under the sensor on the ground plane, z up along the plane's normal,
            x = the sensor's forward axis projected onto the plane (the paper's S-tilde)
world       x = grid east, y = grid north, z = height over ground, metres true to scale;
            origin at a whole-metre UTM point near the track
vehicle     origin on the ground under the box's centre, x forward, y left
=========== ==========================================================================================

Yaw is counter-clockwise from x, in radians. CAM heading is clockwise from true north, in degrees.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

FloatArray: TypeAlias = npt.NDArray[np.float64]
IntArray: TypeAlias = npt.NDArray[np.int64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]
Raster: TypeAlias = npt.NDArray[Any]
"""An image of any depth, shape (height, width) or (height, width, 3)."""


@dataclass(frozen=True)
class Axes:
    """The directions of a sensor frame's axes when the sensor is mounted upright.

    Attributes
    ----------
    forward, up : tuple of float
        Unit vectors in the sensor frame, along the viewing direction and roughly against gravity.
    """

    forward: tuple[float, float, float]
    up: tuple[float, float, float]


OPENCV_AXES = Axes(forward=(0.0, 0.0, 1.0), up=(0.0, -1.0, 0.0))
"""Camera: x right, y down, z forward."""

FORWARD_LEFT_UP_AXES = Axes(forward=(1.0, 0.0, 0.0), up=(0.0, 0.0, 1.0))
"""Most LiDARs (REP 103): x forward, y left, z up."""


def rigid(rotation: FloatArray, translation: FloatArray) -> FloatArray:
    """Return the transform, shape (4, 4), of a rotation, shape (3, 3), and a translation, shape (3,)."""
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = translation
    return T


def invert(T_a_b: FloatArray) -> FloatArray:
    """Return ``T_b_a``, shape (4, 4), of the rigid ``T_a_b``."""
    return rigid(T_a_b[:3, :3].T, -T_a_b[:3, :3].T @ T_a_b[:3, 3])


def transform(T_a_b: FloatArray, points_b: FloatArray) -> FloatArray:
    """Map points, shape (n, 3), from frame b to frame a."""
    moved: FloatArray = points_b @ T_a_b[:3, :3].T + T_a_b[:3, 3]
    return moved


def planar(yaw_rad: float, xy: FloatArray) -> FloatArray:
    """Return the transform, shape (4, 4), that rotates by yaw about z and then translates by xy, shape (2,)."""
    return rigid(rotation_z(yaw_rad), np.array([xy[0], xy[1], 0.0]))


def rotation_z(yaw_rad: float) -> FloatArray:
    """Return the rotation about z, shape (3, 3)."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def rotate_xy(yaw_rad: FloatArray | float, xy: FloatArray) -> FloatArray:
    """Rotate points in the plane, shape (..., 2), counter-clockwise by yaw."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    x, y = xy[..., 0], xy[..., 1]
    moved = np.empty((*np.broadcast_shapes(np.shape(c), x.shape), 2))
    moved[..., 0], moved[..., 1] = c * x - s * y, s * x + c * y
    return moved


def dot_xy(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the scalar products of vectors in the plane, shape (..., 2)."""
    product: FloatArray = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]
    return product


def perpendicular(xy: FloatArray) -> FloatArray:
    """Return vectors, shape (n, 2), rotated by 90 deg counter-clockwise."""
    return np.column_stack([-xy[:, 1], xy[:, 0]])


def along_line(xy: FloatArray) -> FloatArray:
    """Return the distance of each point along a line through all of them, shape (n,); the points' shape is (n, d)."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1)))


def between(at: FloatArray, along: FloatArray, xy: FloatArray) -> FloatArray:
    """Interpolate linearly on a line through points of shape (n, d), and return shape (m, d).

    ``at`` and ``along``, shape (m,) and (n,), are the distances along the line, or the times, of the places returned
    and of the points. Before the first point and after the last one the place stays that of the point.
    """
    return np.column_stack([np.interp(at, along, column) for column in xy.T])


def wrap(angle_rad: FloatArray | float) -> FloatArray:
    """Return angles wrapped to [-pi, pi)."""
    wrapped: FloatArray = (np.asarray(angle_rad, dtype=np.float64) + np.pi) % (2 * np.pi) - np.pi
    return wrapped
