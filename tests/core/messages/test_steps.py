from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.messages.cam import ELLIPSE_SIGMAS, CamLog, VehicleTrack, vehicle_track
from laci_stereo.core.messages.stations import world_around
from tests.simulated import (
    CURVE,
    EPOCH_NS,
    LEFT_TURN,
    RIGHT_TURN,
    STOP_AND_GO,
    STRAIGHT,
    ULM,
    Drive,
    cam_log,
    car,
    lidar,
    scene,
)

TOLD_M = 0.015
PER_DEG_M = 111_200.0


def sent(drive: Drive, step_m: float = 0.0, at_s: float = 3.0, sigma_m: float = TOLD_M, seed: int = 0) -> CamLog:
    """Return messages of a receiver with noise that jumps aside once, to the north-east."""
    log = cam_log(ULM, car(drive), 6.0)
    rng = np.random.default_rng(seed)
    off_m = 0.007 * rng.normal(size=(len(log), 2))
    off_m[(log.stamps_ns - EPOCH_NS) / 1e9 > at_s] += step_m * np.sqrt(0.5)
    return replace(
        log,
        latitude_deg=log.latitude_deg + off_m[:, 1] / PER_DEG_M,
        longitude_deg=log.longitude_deg + off_m[:, 0] / (PER_DEG_M * np.cos(np.radians(log.latitude_deg))),
        heading_deg=log.heading_deg + rng.normal(0.0, 0.3, len(log)),
        speed_mps=np.abs(log.speed_mps + rng.normal(0.0, 0.05, len(log))),
        semi_major_95_m=np.full(len(log), ELLIPSE_SIGMAS * sigma_m),
        semi_minor_95_m=np.full(len(log), ELLIPSE_SIGMAS * sigma_m),
    )


def track(log: CamLog) -> VehicleTrack:
    return vehicle_track(log, world_around(log), EPOCH_NS)


@pytest.mark.parametrize("drive", [STRAIGHT, LEFT_TURN, RIGHT_TURN, CURVE, STOP_AND_GO])
def test_positions_that_go_where_they_should_have_no_step(drive: Drive) -> None:
    for seed in range(5):
        found = track(sent(drive, seed=seed))
        assert found.objections == ()
        assert found.position_sigma_m == pytest.approx(TOLD_M)


@pytest.mark.parametrize("drive", [LEFT_TURN, RIGHT_TURN, CURVE])
def test_inexact_headings_are_no_steps_of_the_front(drive: Drive) -> None:
    for seed in range(20):
        log = sent(drive, seed=seed)
        more_deg = np.random.default_rng(100 + seed).normal(0.0, 0.6, len(log))
        assert track(replace(log, heading_deg=log.heading_deg + more_deg)).objections == ()


@pytest.mark.parametrize("step_m", [0.15, 0.25])
@pytest.mark.parametrize("drive", [STRAIGHT, LEFT_TURN, RIGHT_TURN, CURVE, STOP_AND_GO])
def test_positions_are_no_better_than_their_largest_step(drive: Drive, step_m: float) -> None:
    found = track(sent(drive, step_m))
    (doubt,) = found.objections
    told = re.fullmatch(
        "the positions of station 42 jump sideways by (.*) m, (.*) s into the recording: those before or those after "
        "it are wrong by as much",
        doubt,
    )
    assert told is not None
    assert float(told[1]) == pytest.approx(step_m, rel=0.4)
    assert float(told[2]) == pytest.approx(3.0, abs=0.2)
    assert found.position_sigma_m == pytest.approx(step_m / np.sqrt(2.0), rel=0.4)


@pytest.mark.parametrize("step_m", [0.5, 1.5])
@pytest.mark.parametrize("drive", [STRAIGHT, LEFT_TURN, RIGHT_TURN, CURVE])
def test_of_two_parts_of_a_log_that_are_as_long_neither_is_surely_right(drive: Drive, step_m: float) -> None:
    found = track(sent(drive, step_m))
    assert "jump sideways" in found.objections[-1]
    assert found.position_sigma_m == pytest.approx(step_m / np.sqrt(2.0), rel=0.4)


def test_a_step_within_what_messages_tell_is_none() -> None:
    found = track(sent(STRAIGHT, 0.3, sigma_m=0.5))
    assert found.objections == ()
    assert found.position_sigma_m == pytest.approx(0.5)


@pytest.mark.slow
def test_a_result_is_as_sure_as_positions_that_step() -> None:
    """A sudden other solution of the receiver's looks like another direction of the way."""
    made = scene(STRAIGHT, lidar(32, 160), frames_hz=5.0)
    truth = made.place.to_utm(made.recording.T_world_sensor[None, :2, 3])[0]
    logs = [sent(made.vehicle.drive, step_m, at_s=2.5) for step_m in (0.0, 0.3)]
    for log, verdict in zip(logs, ("pass", "warn"), strict=True):
        found = calibrate(made.recording, log)
        assert found.quality.verdict == verdict
        turned = found.T_utm_sensor[:3, :3] @ made.recording.T_world_sensor[:3, :3].T
        yaw_deg = float(np.degrees(np.arctan2(turned[1, 0], turned[0, 0])))
        assert abs(yaw_deg) < 3.0 * found.quality.yaw_sigma_deg
        assert np.linalg.norm(found.T_utm_sensor[:2, 3] - truth) < 4.0 * found.quality.track_xy_sigma_m
