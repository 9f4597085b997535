from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from laci_stereo.core.frames import FORWARD_LEFT_UP_AXES, OPENCV_AXES, Axes, FloatArray, rigid, rotation_z
from laci_stereo.core.result import Quality, Verdict, viewing_angles
from tests.simulated import R_FLU_OPENCV, lidar, mounted, stereo

AXES = pytest.mark.parametrize("axes", [OPENCV_AXES, FORWARD_LEFT_UP_AXES], ids=["opencv", "forward-left-up"])


def pose(R_world_flu: FloatArray, axes: Axes) -> FloatArray:
    return rigid(R_world_flu @ R_FLU_OPENCV if axes == OPENCV_AXES else R_world_flu, np.array([1.0, 2.0, 6.0]))


@AXES
def test_looking_east_along_the_horizon(axes: Axes) -> None:
    angles = viewing_angles(pose(np.eye(3), axes), axes)
    assert (angles.yaw_deg, angles.down_deg, angles.roll_deg) == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)


@AXES
def test_looking_north(axes: Axes) -> None:
    angles = viewing_angles(pose(rotation_z(np.pi / 2), axes), axes)
    assert (angles.yaw_deg, angles.down_deg, angles.roll_deg) == pytest.approx((90.0, 0.0, 0.0), abs=1e-9)


@AXES
def test_looking_down(axes: Axes) -> None:
    # A turn about the left axis brings forward down.
    angles = viewing_angles(pose(Rotation.from_rotvec([0.0, np.radians(30.0), 0.0]).as_matrix(), axes), axes)
    assert (angles.yaw_deg, angles.down_deg, angles.roll_deg) == pytest.approx((0.0, 30.0, 0.0), abs=1e-9)


@AXES
def test_rolled_clockwise_seen_from_behind(axes: Axes) -> None:
    # Its own up axis then points to the right: with forward east, to the south.
    T = pose(Rotation.from_rotvec([np.radians(5.0), 0.0, 0.0]).as_matrix(), axes)
    assert (T[:3, :3] @ np.array(axes.up))[1] < 0.0
    assert viewing_angles(T, axes).roll_deg == pytest.approx(5.0)


@given(
    st.floats(-179.0, 179.0), st.floats(-80.0, 80.0), st.floats(-60.0, 60.0), st.sampled_from([lidar(4, 4), stereo(16)])
)
def test_mounted_as_said(yaw: float, down: float, roll: float, sensor: object) -> None:
    T = mounted(sensor, (3.0, 4.0), 6.0, yaw, down, roll)  # type: ignore[arg-type]
    angles = viewing_angles(T, sensor.axes)  # type: ignore[attr-defined]
    assert (angles.yaw_deg, angles.down_deg, angles.roll_deg) == pytest.approx((yaw, down, roll), abs=1e-6)


@AXES
def test_straight_down_is_finite(axes: Axes) -> None:
    angles = viewing_angles(pose(Rotation.from_rotvec([0.0, np.pi / 2, 0.0]).as_matrix(), axes), axes)
    assert angles.down_deg == pytest.approx(90.0)
    assert np.isfinite([angles.yaw_deg, angles.roll_deg]).all()


@pytest.mark.parametrize(
    ("verdict", "failures", "expected"),
    [("pass", (), "pass"), ("warn", (), "warn"), ("pass", ("spoilt",), "fail"), ("warn", ("spoilt",), "fail")],
)
def test_what_surely_spoils_a_result_makes_it_fail(verdict: Verdict, failures: tuple[str, ...], expected: str) -> None:
    before = Quality(verdict, ("doubted",), 0.1, 0.1, 90.0, "", 0.1, 0.1, 0.01, 0.05, 31, 31, {})
    after = before.failed(*failures)
    assert (after.verdict, after.reasons) == (expected, (*failures, "doubted"))
