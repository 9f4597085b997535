from __future__ import annotations

from dataclasses import replace

import numpy as np

from laci_stereo.core.drive_poses import poses_at, smooth
from laci_stereo.core.tractrix import body_yaw
from tests.core.outlines import ROUNDABOUT, told


def test_messages_are_smoothed_along_an_arc() -> None:
    exact, at = told(ROUNDABOUT, 6.0), np.arange(0.5, 5.5, 0.03)
    noise = np.random.default_rng(5).normal(0.0, 0.02, exact.xy.shape)
    noisy = replace(exact, xy=exact.xy + noise)
    (true, as_told), (place, later) = (
        [smooth(vehicle, at + shift)[0] for shift in (0.0, 0.01)] for vehicle in (exact, noisy)
    )
    assert np.abs(true - exact.at(at)[0]).max() < 0.005
    assert np.std(place - true) < 0.5 * 0.02
    assert np.std((later - place) - (as_told - true)) / 0.01 < 0.05  # m/s; between two messages it is 0.28


def test_rates_are_those_of_the_arc() -> None:
    vehicle, at = told(ROUNDABOUT, 6.0), np.arange(0.5, 5.5, 0.1)
    poses = poses_at(at, vehicle, body_yaw(vehicle), 0.0, 0.0)
    heading = vehicle.at(at)[1]
    true = 7.0 * np.column_stack([np.cos(heading), np.sin(heading)])
    for rates in (poses.rates, poses.now):
        assert np.abs(rates.velocity - true).max() < 0.05
        assert np.abs(rates.yaw - 7.0 * np.radians(600.0) / 200.0).max() < 0.005


def test_at_the_ends_the_track_is_as_it_is_told() -> None:
    vehicle = told(ROUNDABOUT, 6.0)
    ends = vehicle.stamps_s[[0, -1]]
    assert np.allclose(smooth(vehicle, ends)[0], vehicle.xy[[0, -1]])
    assert not smooth(vehicle, ends + np.array([-0.1, 0.1]))[2].any()
