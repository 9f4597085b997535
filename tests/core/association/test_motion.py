"""Boxes that are smaller than the vehicle, completed to its size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.association.motion import completed
from laci_stereo.core.association.scene import Scene, lay_out
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.tracking.box import Box
from laci_stereo.core.tracking.sighting import NOTHING_LOW, Sighting
from laci_stereo.core.tracking.tracks import Track

LENGTH_M, WIDTH_M = 4.6, 1.8


def laid_out(count: int, length_m: float) -> tuple[Scene, int]:
    """Return a box without width that stands 20 m ahead, seen from behind, and its sender's station."""
    sighting = Sighting(
        stamp_s=1.0,
        frame_s=1.0,
        points=NOTHING_LOW.points,
        sigma_along_m=NOTHING_LOW.sigma_along_m,
        sigma_across_m=NOTHING_LOW.sigma_across_m,
        count=count,
        middle=np.array([20.0, 0.0]),
        box=Box(np.array([20.0, 0.0]), length_m, 0.0, 0.0),
        flaw=None,
    )
    stamps_s = np.arange(0.0, 2.0, 0.1)
    xy = np.column_stack([20.0 + stamps_s, np.zeros(len(stamps_s))])
    vehicle = VehicleTrack(stamps_s, 0, xy, np.zeros(len(stamps_s)), LENGTH_M, WIDTH_M, (0.0, 0.0))
    return lay_out([Track((sighting,))], {7: vehicle}, MatchSettings()), 7


@pytest.mark.parametrize("length_m", [0.0, 2.0])
def test_what_a_cluster_lacks_is_behind_it_and_a_detectors_box_may_be_the_middle(length_m: float) -> None:
    behind_m = (LENGTH_M - length_m) / 2
    for count, expected_m in ((200, behind_m), (1, behind_m / 2)):
        scene, station = laid_out(count, length_m)
        sender = scene.senders[station]
        poses = sender.at(scene.knots.stamp_s)
        xy, sigma_m = completed(scene.knots, poses, np.zeros(1), sender, MatchSettings())
        assert xy[0, 0] - 20.0 == pytest.approx(expected_m)
        whole = replace(scene.knots, length_m=np.full(1, LENGTH_M), width_m=np.full(1, WIDTH_M))
        least_m = completed(whole, poses, np.zeros(1), sender, MatchSettings())[1]
        assert np.sqrt(sigma_m**2 - least_m**2)[0] >= behind_m / 2  # reaches back in one or two of these
