from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from laci_lidar.axes import forward_left_up, parse_axes

from laci_stereo.core.errors import SettingError
from laci_stereo.core.frames import FORWARD_LEFT_UP_AXES, OPENCV_AXES, Axes


@pytest.mark.parametrize(
    ("text", "axes"),
    [
        ("x forward, z up", FORWARD_LEFT_UP_AXES),
        ("x forward", FORWARD_LEFT_UP_AXES),
        ("z forward, y down", OPENCV_AXES),
        ("+Z forward -y up", OPENCV_AXES),
        ("y forward", Axes((0.0, 1.0, 0.0), (0.0, 0.0, 1.0))),
        ("-x forward; z down", Axes((-1.0, 0.0, 0.0), (0.0, 0.0, -1.0))),
        ("x backward z down", Axes((-1.0, 0.0, 0.0), (0.0, 0.0, -1.0))),
        ("z down", Axes((1.0, 0.0, 0.0), (0.0, 0.0, -1.0))),
    ],
)
def test_axes_are_told_in_words(text: str, axes: Axes):
    assert parse_axes(text) == axes


@pytest.mark.parametrize(
    "text", ["", "x", "forward", "w forward", "z forward", "x forward, y forward", "x up", "x forward!"]
)
def test_other_words_are_refused(text: str):
    with pytest.raises(SettingError, match="needed is such as"):
        parse_axes(text)


@given(st.sampled_from("xyz"), st.sampled_from("xyz"), st.sampled_from(["", "-"]), st.sampled_from(["", "-"]))
def test_the_frame_is_a_rotation(forward, up, forward_sign, up_sign):
    if forward == up:
        return
    axes = parse_axes(f"{forward_sign}{forward} forward, {up_sign}{up} up")
    rotation = forward_left_up(axes)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(rotation @ axes.forward, [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(rotation @ axes.up, [0.0, 0.0, 1.0], atol=1e-12)
