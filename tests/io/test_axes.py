from __future__ import annotations

import pytest

from laci_stereo.core.errors import SettingError
from laci_stereo.core.frames import FORWARD_LEFT_UP_AXES, OPENCV_AXES, Axes
from laci_stereo.io.axes import parse_axes


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
