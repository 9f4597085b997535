from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from laci_lidar.axes import forward_left_up

from laci_stereo.io.axes import parse_axes


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
