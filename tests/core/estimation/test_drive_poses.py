from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.estimation.drive_poses import FINEST_RAD, heading_noise, poses_at, smooth
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.messages.cam import VehicleTrack
from tests.core.outlines import ROUNDABOUT, told, without_messages


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


LOST_S = (2.0, 4.0)


@pytest.mark.parametrize("lost", [False, True])
def test_rates_are_those_of_the_arc(lost: bool) -> None:
    """Beside a gap in the messages as elsewhere."""
    vehicle = told(ROUNDABOUT, 6.0)
    if lost:
        vehicle = without_messages(vehicle, *LOST_S)
    at = np.arange(0.5, 5.5, 0.1)
    at = at[vehicle.at(at)[2]]
    assert len(at) > 25
    poses = poses_at(at, vehicle, 0.0, 0.0)
    heading = vehicle.at(at)[1]
    true = 7.0 * np.column_stack([np.cos(heading), np.sin(heading)])
    for rates in (poses.rates, poses.now):
        assert np.abs(rates.velocity - true).max() < 0.05
        assert np.abs(rates.yaw - 7.0 * np.radians(600.0) / 200.0).max() < 0.005


def test_at_the_ends_and_at_a_gap_the_track_is_as_it_is_told() -> None:
    vehicle = without_messages(told(ROUNDABOUT, 6.0), *LOST_S)
    begin = int(np.argmax(np.diff(vehicle.stamps_s)))
    ends = [0, begin, begin + 1, -1]
    xy, yaw, known = smooth(vehicle, vehicle.stamps_s[ends])
    assert known.all()
    assert np.allclose(xy, vehicle.xy[ends])
    assert np.allclose(yaw, vehicle.yaw_rad[ends])
    assert not smooth(vehicle, vehicle.stamps_s[ends] + np.array([-0.1, 0.1, -0.1, 0.1]))[2].any()


def test_near_a_gap_a_place_is_smoothed_over_what_is_known() -> None:
    exact = without_messages(told(ROUNDABOUT, 6.0), *LOST_S)
    noisy = replace(exact, xy=exact.xy + np.random.default_rng(5).normal(0.0, 0.02, exact.xy.shape))
    near = np.concatenate([np.arange(LOST_S[0] - 0.45, LOST_S[0] - 0.25, 0.003), np.arange(4.25, 4.45, 0.003)])
    assert np.std(smooth(noisy, near)[0] - smooth(exact, near)[0]) < 0.8 * np.std(noisy.at(near)[0] - exact.at(near)[0])


def turning(interval_s: float, sigma_deg: float, seed: int) -> VehicleTrack:
    """Return a vehicle that turns by 90 deg in 4 s, with noise in its headings."""
    stamps = np.arange(0.0, 20.0, interval_s)
    yaw = np.radians(
        22.5 * np.clip(stamps - 6.0, 0.0, 4.0) + sigma_deg * np.random.default_rng(seed).normal(size=len(stamps))
    )
    return VehicleTrack(stamps, 0, np.column_stack([8.0 * stamps, 0.0 * stamps]), yaw, 4.6, 1.8)


@pytest.mark.parametrize("interval_s", [0.1, 0.2, 0.3])
@pytest.mark.parametrize("sigma_deg", [0.1, 0.5])
def test_the_noise_of_headings_is_what_cubics_leave(interval_s: float, sigma_deg: float) -> None:
    found = [heading_noise(turning(interval_s, sigma_deg, seed), 1.0) for seed in range(20)]
    assert np.degrees(np.mean(found)) == pytest.approx(sigma_deg, rel=0.25)


def test_messages_that_come_seldom_do_not_tell_the_noise_of_their_headings() -> None:
    assert heading_noise(turning(0.6, 0.5, 0), 0.123) == 0.123


@pytest.mark.parametrize("sigma_deg", [0.0, 0.3])
def test_messages_at_any_times_tell_it(sigma_deg: float) -> None:
    rng = np.random.default_rng(4)
    stamps = np.cumsum(rng.uniform(0.05, 0.5, 3000))
    yaw_deg = 3e-6 * (stamps - 400.0) ** 3 + sigma_deg * rng.normal(size=len(stamps))
    vehicle = VehicleTrack(stamps, 0, np.zeros((len(stamps), 2)), np.radians(yaw_deg), 4.6, 1.8)
    assert np.degrees(heading_noise(vehicle, 1.0)) == pytest.approx(max(sigma_deg, np.degrees(FINEST_RAD)), rel=0.1)


def swerving(stamps_s: FloatArray) -> FloatArray:
    """Return the heading, rad, of a front that swings from one side to the other within two seconds."""
    return np.radians(35.0) * np.sin(np.pi * np.clip(stamps_s - 5.0, -1.0, 1.0) / 2.0)


@pytest.mark.parametrize("phase", [0.0, 0.3, 0.6, 0.9])
@pytest.mark.parametrize("interval_s", [0.5, 0.8, 1.0])
def test_between_messages_headings_are_as_unsure_as_they_may_be_off(interval_s: float, phase: float) -> None:
    stamps = np.arange(-phase * interval_s, 11.0, interval_s)
    vehicle = VehicleTrack(stamps, 0, np.column_stack([8.0 * stamps, 0.0 * stamps]), swerving(stamps), 4.6, 1.8)
    at = np.linspace(1.0, 9.0, 161)
    off = vehicle.at(at)[1] - swerving(at)
    sigma = np.sqrt(poses_at(at, vehicle, 0.0, 0.0).unsure / interval_s)
    assert (np.abs(off) < 3.0 * sigma + np.radians(0.5)).all()
    assert np.sqrt(np.mean(off**2)) < np.sqrt(np.mean(sigma**2))


def test_headings_that_change_evenly_are_sure_however_seldom_they_are_told() -> None:
    stamps = np.array([0.0, 0.4, 1.3, 2.3, 2.5, 3.5])
    vehicle = VehicleTrack(stamps, 0, np.column_stack([8.0 * stamps, 0.0 * stamps]), 0.4 * stamps, 4.6, 1.8)
    assert poses_at(np.linspace(0.0, 3.5, 71), vehicle, 0.0, 0.0).unsure.max() < 1e-20
