from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from laci_stereo.core.frames import (
    FORWARD_LEFT_UP_AXES,
    OPENCV_AXES,
    Axes,
    FloatArray,
    invert,
    planar,
    rigid,
    rotate_xy,
    rotation_z,
    transform,
    wrap,
)

angles = st.one_of(
    st.floats(-math.pi, math.pi), st.sampled_from([0.0, 1e-9, -1e-12, math.pi, math.pi - 1e-9, -math.pi])
)
metres = st.floats(-1e4, 1e4)
vectors = st.tuples(metres, metres, metres).map(np.array)
motions = st.builds(
    lambda axis_angle, shift: rigid(Rotation.from_rotvec(axis_angle).as_matrix(), shift),
    st.tuples(angles, angles, angles).map(np.array),
    vectors,
)


@given(motions)
def test_inverse_undoes(T: FloatArray) -> None:
    assert T @ invert(T) == pytest.approx(np.eye(4), abs=1e-8)
    assert invert(T) @ T == pytest.approx(np.eye(4), abs=1e-8)
    assert invert(invert(T)) == pytest.approx(T, abs=1e-8)


@given(motions, motions, motions)
def test_associative(T_a_b: FloatArray, T_b_c: FloatArray, T_c_d: FloatArray) -> None:
    assert (T_a_b @ T_b_c) @ T_c_d == pytest.approx(T_a_b @ (T_b_c @ T_c_d), abs=1e-7)
    assert invert(T_a_b @ T_b_c) == pytest.approx(invert(T_b_c) @ invert(T_a_b), abs=1e-7)


@given(motions, motions, st.lists(vectors, min_size=0, max_size=4))
def test_transform_follows_composition(T_a_b: FloatArray, T_b_c: FloatArray, points: list[FloatArray]) -> None:
    points_c = np.array(points).reshape(-1, 3)
    points_a = transform(T_a_b @ T_b_c, points_c)
    assert points_a == pytest.approx(transform(T_a_b, transform(T_b_c, points_c)), abs=1e-7)
    assert transform(invert(T_a_b @ T_b_c), points_a) == pytest.approx(points_c, abs=1e-7)
    homogeneous = np.column_stack([points_c, np.ones(len(points_c))]) @ (T_a_b @ T_b_c).T
    assert points_a == pytest.approx(homogeneous[:, :3], abs=1e-7)


@given(motions, vectors, vectors)
def test_distances_stay(T: FloatArray, p: FloatArray, q: FloatArray) -> None:
    moved = transform(T, np.array([p, q]))
    assert np.linalg.norm(moved[0] - moved[1]) == pytest.approx(np.linalg.norm(p - q), abs=1e-7)


@given(angles, metres, metres, vectors)
def test_planar_turns_then_shifts_and_keeps_height(yaw: float, x: float, y: float, p: FloatArray) -> None:
    moved = transform(planar(yaw, np.array([x, y])), p[None])[0]
    assert moved[:2] == pytest.approx(rotate_xy(yaw, p[:2]) + np.array([x, y]), abs=1e-8)
    assert moved[2] == p[2]


@given(angles)
def test_rotation_is_proper_and_counter_clockwise(yaw: float) -> None:
    R = rotation_z(yaw)
    product = R @ R.T
    assert product == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    forward = R @ np.array([1.0, 0.0, 0.0])
    assert forward == pytest.approx([math.cos(yaw), math.sin(yaw), 0.0])
    quarter = rotate_xy(math.pi / 2, np.array([1.0, 0.0]))
    assert quarter == pytest.approx([0.0, 1.0], abs=1e-12)


def test_rotate_takes_one_angle_per_point() -> None:
    yaw = np.linspace(-3.0, 3.0, 7)
    turned = rotate_xy(yaw, np.tile([1.0, 2.0], (7, 1)))
    assert turned == pytest.approx(np.array([rotate_xy(angle, np.array([1.0, 2.0])) for angle in yaw]))


@given(st.floats(-100.0, 100.0))
def test_wrap(angle: float) -> None:
    wrapped = float(wrap(angle))
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)
    assert float(wrap(wrapped)) == pytest.approx(wrapped, abs=1e-12)


def test_wrap_at_the_border() -> None:
    assert float(wrap(math.pi)) == -math.pi
    assert float(wrap(-math.pi)) == -math.pi
    assert wrap(np.array([3 * math.pi, 0.0])) == pytest.approx([-math.pi, 0.0])


@pytest.mark.parametrize("axes", [OPENCV_AXES, FORWARD_LEFT_UP_AXES])
def test_axes_are_orthogonal_units(axes: Axes) -> None:
    lengths = np.linalg.norm([axes.forward, axes.up], axis=1)
    assert lengths.tolist() == [1.0, 1.0]
    assert np.dot(axes.forward, axes.up) == 0.0
