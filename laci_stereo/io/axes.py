"""The forward and up axes of a sensor's frame, as a user writes them."""

from __future__ import annotations

import re

import numpy as np

from laci_stereo.core.errors import SettingError
from laci_stereo.core.frames import Axes
from laci_stereo.io.text_file import quoted

_PART = re.compile(r"([+-]?)([xyz])\s*(forward|backward|up|down)")
_NEEDED = "needed is such as 'x forward, z up', '-y forward' or 'z down'"


def parse_axes(text: str) -> Axes:
    """Return the axes that a text such as ``x forward, z down`` describes.

    Directions that the text omits are as in most sensors: x forward, z up.

    Raises
    ------
    SettingError
        If the text cannot be parsed, or forward and up are not perpendicular.
    """
    directions: dict[str, tuple[float, float, float]] = {}
    for part in re.split(r"[,;]\s*", text.strip().lower()):
        for sign, axis, way in _parts(part, text):
            backwards = (sign == "-") != (way in ("backward", "down"))
            direction = "forward" if way in ("forward", "backward") else "up"
            if direction in directions:
                raise SettingError(f"the axes {quoted(text)} tell {direction} twice; {_NEEDED}")
            unit = [0.0, 0.0, 0.0]
            unit["xyz".index(axis)] = -1.0 if backwards else 1.0
            directions[direction] = (unit[0], unit[1], unit[2])
    axes = Axes(directions.get("forward", (1.0, 0.0, 0.0)), directions.get("up", (0.0, 0.0, 1.0)))
    if np.dot(axes.forward, axes.up) != 0.0:
        raise SettingError(f"the axes {quoted(text)} make forward and up parallel; {_NEEDED}")
    return axes


def _parts(part: str, text: str) -> list[tuple[str, str, str]]:
    found = _PART.findall(part)
    if not found or re.sub(r"[\s]+", "", _PART.sub("", part)):
        raise SettingError(f"the axes are {quoted(text)}; {_NEEDED}")
    return [(sign, axis, way) for sign, axis, way in found]
