from __future__ import annotations

import numpy as np
import pytest

from laci_stereo.core.errors import GroundError
from laci_stereo.core.frames import FORWARD_LEFT_UP_AXES, OPENCV_AXES, Axes, FloatArray
from laci_stereo.core.ground.axes import UPS, ground_below
from laci_stereo.core.settings import GroundSettings
from laci_stereo.io.axes import parse_axes
from tests.lidar.scanner import road

SETTINGS = GroundSettings()


def turned(axes: Axes) -> FloatArray:
    """Return a road below a scanner with these axes."""
    up, forward = np.array(axes.up), np.array(axes.forward)
    return road(sigma_m=0.01, step_deg=0.4) @ np.stack([forward, np.cross(up, forward), up])


def ground(points: FloatArray, axes: Axes) -> FloatArray:
    sigma = np.full(len(points), 0.01)
    return ground_below(points, sigma, 0.1 * sigma, axes, SETTINGS).normal


@pytest.mark.parametrize("told", UPS)
def test_where_the_axes_are_right_it_is_found(told: str) -> None:
    axes = parse_axes(told)
    assert tuple(axes.up) == UPS[told]
    assert np.dot(ground(turned(axes), axes), axes.up) > 0.9


@pytest.mark.parametrize("true", [name for name in UPS if name != "z up"])
def test_where_they_are_wrong_the_right_ones_are_named(true: str) -> None:
    with pytest.raises(GroundError, match=f"there is a ground with --axes '{true}'$"):
        ground(turned(parse_axes(true)), FORWARD_LEFT_UP_AXES)


def test_a_camera_is_told_no_axes() -> None:
    with pytest.raises(GroundError) as raised:
        ground(turned(FORWARD_LEFT_UP_AXES), OPENCV_AXES)
    assert "--axes" not in str(raised.value)


def test_where_there_is_no_ground_at_all_nothing_is_promised() -> None:
    with pytest.raises(GroundError) as raised:
        ground(np.random.default_rng(0).normal(size=(50, 3)) * 5.0, FORWARD_LEFT_UP_AXES)
    assert "--axes" not in str(raised.value)
