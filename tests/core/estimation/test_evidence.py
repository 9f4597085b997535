from __future__ import annotations

import numpy as np
import pytest

from laci_stereo.core.estimation.evidence import FRAMES_PER_PLACE, SAME_VIEW_M, way_driven
from tests.core.outlines import TURN, evidence, stopping


def test_the_way_of_what_moves_is_its_length_and_what_stands_has_none() -> None:
    step = np.array([[0.3, 0.4]])
    moving = step * np.arange(40)[:, None]
    assert way_driven(moving, SAME_VIEW_M) == pytest.approx(0.5 * np.arange(40))
    noisy = 0.1 * np.random.default_rng(0).normal(size=(9000, 2)).clip(-2.0, 2.0)
    way_m = way_driven(np.concatenate([moving, moving[-1] + noisy, moving + moving[-1]]), 0.8)
    assert way_m[[38, -1]] == pytest.approx([19.0, 39.0], abs=0.8)
    assert np.ptp(way_m[40:9040]) < 0.8
    assert (np.diff(way_m) >= 0.0).all()
    assert way_driven(np.zeros((0, 2)), 0.5).shape == (0,)


def test_of_a_stop_some_frames_are_left_from_the_first_to_the_last() -> None:
    drive = stopping(TURN, 60.0)
    seen = evidence(drive, per_frame=3, last_s=70.0)
    left = seen.thinned(10_000)
    stands = (left.stamps_s > 4.0) & (left.stamps_s < 64.0)
    assert stands.sum() <= FRAMES_PER_PLACE
    assert np.ptp(left.stamps_s[stands]) > 0.6 * 60.0
    moves = (seen.stamps_s < 3.0) | (seen.stamps_s > 65.0)
    assert set(seen.stamps_s[moves]) <= set(left.stamps_s)
    at = np.searchsorted(seen.stamps_s, left.stamps_s)
    assert left.middles == pytest.approx(seen.middles[at])
    assert left.points == pytest.approx(seen.points.reshape(-1, 3, 3)[at].reshape(-1, 3))
    assert left.frame.tolist() == np.repeat(np.arange(len(left)), 3).tolist()
    assert seen.thinned(100).points == pytest.approx(left.points[:: len(left.points) // 100])
