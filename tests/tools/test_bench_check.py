"""The benchmark of the lane check counts what it should, of cameras and errors that are what they are called."""

from __future__ import annotations

import numpy as np
import pytest

from laci_stereo.core.frames import invert, transform
from laci_stereo.io.maps.lane_map import LaneMap
from tests.check.support import BARREL, CENTRE, LENS, looking_north
from tools.bench_check import RIGHT, Shown, Trial, errors_of, report, scaled
from tools.scenes.cameras import project


def trial(wrong: str, outcome: str, seed: int = 1) -> Trial:
    return Trial(seed, wrong, outcome, (), 4, 5, 2.0, True)


def test_errors_are_right_ones_that_fail_and_wrong_ones_that_pass() -> None:
    trials = [trial("right", "pass")] * 7 + [trial("right", "fail", 2)] + [trial("right", "cannot tell")] * 2
    trials += [trial("shifted", "fail")] * 3 + [trial("shifted", "pass", 3)] + [trial("turned", "cannot tell")]
    right, shifted, turned = (line.split() for line in report(trials).splitlines()[1:4])
    assert right == ["right", "10", "7", "1", "2", "10.0%"]
    assert shifted == ["shifted", "4", "1", "3", "0", "25.0%"]
    assert turned == ["turned", "1", "0", "0", "1", "0.0%"]
    assert "seed 2 right (1), seed 3 shifted (1)" in report(trials)


@pytest.mark.parametrize("lens", [LENS, BARREL])
def test_scaled_lens_sees_the_same_in_a_smaller_image(lens: object) -> None:
    points = np.array([[0.4, 0.1, 2.0], [-1.0, -0.5, 3.0]])
    half = scaled(lens, 0.5)
    assert half.size == (400, 300)
    assert project(half, points) == pytest.approx((project(lens, points) + 0.5) * 0.5 - 0.5)


def test_what_is_tried_is_as_wrong_as_it_is_called() -> None:
    T = looking_north()
    shown = Shown(LaneMap((), ()), T, np.zeros((0, 6)), CENTRE, np.zeros((600, 800), np.uint8), LENS)
    tried = list(errors_of(shown, 5))
    assert [name for name, _ in tried].count("right") == RIGHT
    for name, wrong in tried:
        apart = wrong @ invert(T)
        shift_m = np.linalg.norm((transform(apart, CENTRE[None])[0] - CENTRE)[:2])
        turn_deg = np.degrees(np.arctan2(apart[1, 0], apart[0, 0]))
        if name == "shifted":
            assert (shift_m, turn_deg) == pytest.approx((0.3, 0.0), abs=1e-9)
        elif name == "turned":
            assert abs(turn_deg) == pytest.approx(0.5)
            assert wrong[:3, 3] == pytest.approx(T[:3, 3])
        else:
            assert shift_m < 0.3
