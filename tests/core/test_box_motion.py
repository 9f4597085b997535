from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.box_motion import contradictions
from laci_stereo.core.detections import DetectionLog, observe_detections
from laci_stereo.core.frames import FloatArray, transform
from laci_stereo.core.settings import MatchSettings
from tests.detections import EXACT, Noise, Traffic, traffic

SETTINGS = MatchSettings()


def said(made: Traffic, log: DetectionLog | None = None) -> tuple[str, ...]:
    return contradictions(observe_detections(log or made.detections, made.axes).tracks, SETTINGS)


def radial_mps(made: Traffic) -> FloatArray:
    """Return how fast the distance of each box changes."""
    xy = transform(made.T_world_sensor, made.detections.points_sensor)[:, :2]
    speeds = np.zeros(len(xy))
    for number in range(len(made.vehicles)):
        rows = np.flatnonzero(made.of_vehicle == number)
        if len(rows) > 1:
            stamps_s = (made.detections.stamps_ns[rows] - made.detections.stamps_ns[0]) / 1e9
            speeds[rows] = np.gradient(np.linalg.norm(xy[rows], axis=1), stamps_s)
    return speeds


@pytest.mark.parametrize("seed", range(5))
def test_right_boxes_contradict_nothing(seed: int) -> None:
    made = traffic(seed, 12, Noise(position_m=0.2, yaw_deg=5.0))
    assert said(made) == ()
    assert said(made, replace(made.detections, yaw_rad=made.detections.yaw_rad + np.pi)) == ()


def test_yaws_from_the_other_axis_and_exchanged_sides_are_across_the_motion() -> None:
    made = traffic(3, 12)
    log = made.detections
    from_y = replace(log, yaw_rad=log.yaw_rad - np.pi / 2)
    exchanged = replace(log, length_m=log.width_m, width_m=log.length_m)
    for wrong in (from_y, exchanged):
        (words,) = said(made, wrong)
        assert words.startswith(("the boxes' longer sides are 8", "the boxes' longer sides are 90"))
        assert "deg off the direction of their motion, in the median of " in words


def test_yaws_that_say_nothing_are_named() -> None:
    made = traffic(3, 12)
    yaw = np.random.default_rng(0).uniform(-np.pi, np.pi, len(made.detections))
    (words,) = said(made, replace(made.detections, yaw_rad=yaw))
    assert "the boxes' longer sides are 4" in words


def test_boxes_without_a_longer_side_or_without_any_say_nothing() -> None:
    made = traffic(3, 12)
    across = replace(made.detections, yaw_rad=made.detections.yaw_rad + np.pi / 2)
    assert said(made, replace(across, length_m=1.2 * across.width_m)) == ()
    assert said(made, replace(across, length_m=np.full(len(across), np.nan))) == ()


def test_speeds_towards_the_sensor_are_named() -> None:
    made = traffic(3, 12, EXACT)
    away = radial_mps(made)
    assert said(made, replace(made.detections, radial_mps=away)) == ()
    (words,) = said(made, replace(made.detections, radial_mps=-away))
    assert words.startswith("radial_speed is ")
    assert "needed is a speed that is positive away from the sensor" in words


def test_nothing_that_moves_says_nothing() -> None:
    assert contradictions((), SETTINGS) == ()
