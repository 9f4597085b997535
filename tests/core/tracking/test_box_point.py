from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from laci_stereo.core.frames import dot_xy, perpendicular, rotate_xy
from laci_stereo.core.tracking.box import Box
from laci_stereo.core.tracking.box_point import BoxPoint, recentred, to_centre
from laci_stereo.core.tracking.tracks import Track
from tests.core.tracks import sighting

POINTS = get_args(BoxPoint)
RNG = np.random.default_rng(3)


def test_the_centre_is_found_from_every_point() -> None:
    n = 500
    yaw, length, width = RNG.uniform(-np.pi, np.pi, n), RNG.uniform(3.0, 18.0, n), RNG.uniform(1.5, 2.6, n)
    ahead = np.column_stack([np.cos(yaw), np.sin(yaw)])
    centre = rotate_xy(RNG.uniform(-np.pi, np.pi, n), np.column_stack([RNG.uniform(5.0, 80.0, n), np.zeros(n)]))
    front, side = length[:, None] / 2 * ahead, width[:, None] / 2 * perpendicular(ahead)
    away = (np.abs(dot_xy(centre, ahead)) > length) & (np.abs(dot_xy(centre, perpendicular(ahead))) > width)
    assert away.sum() > n / 2
    points = {
        "centre": [0.0 * front],
        "front": [front],
        "rear": [-front],
        "near-end": [front, -front],
        "near-corner": [a * front + b * side for a in (1, -1) for b in (1, -1)],
    }
    for point in POINTS:
        each = np.array([centre + by for by in points[point]])
        nearest = each[np.linalg.norm(each, axis=2).argmin(axis=0), np.arange(n)]
        found = nearest + to_centre(nearest, 7.0 * ahead, length, width, point)
        told = away if point.startswith("near") else np.ones(n, dtype=bool)
        assert found[told] == pytest.approx(centre[told])


@pytest.mark.parametrize("yaw_rad", [0.4, 0.4 - np.pi])
def test_the_front_is_where_a_box_moves_to(yaw_rad: float) -> None:
    ahead = np.array([np.cos(0.4), np.sin(0.4)])
    track = Track(
        tuple(
            sighting(float(t), 20.0 + 8.0 * t * ahead, size=(4.4, 1.8), yaw_rad=yaw_rad)
            for t in np.arange(0.0, 2.0, 0.1)
        )
    )
    for point, along_m in (("front", -2.2), ("rear", 2.2), ("centre", 0.0)):
        moved = recentred(track, point)
        assert moved.centres - track.centres == pytest.approx(np.tile(along_m * ahead, (20, 1)))
        assert [one.box.yaw_rad for one in moved.sightings] == [yaw_rad] * 20
        assert all(isinstance(one.box, Box) and tuple(one.middle) == tuple(one.box.centre) for one in moved.sightings)
