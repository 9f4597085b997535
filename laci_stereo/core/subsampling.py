"""Uniformly spaced subsets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from laci_stereo.core.frames import IntArray

Item = TypeVar("Item")


def evenly(count: int, most: int) -> IntArray:
    """Return at most ``most`` uniformly spaced indices below ``count``, ascending, including both ends."""
    kept: IntArray = np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))
    return kept


def spread(items: Sequence[Item], most: int) -> list[Item]:
    """Return at most ``most`` uniformly spaced items, including both ends."""
    return [items[index] for index in evenly(len(items), most)]
