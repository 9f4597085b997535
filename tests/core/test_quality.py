from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from laci_stereo.core.estimation.joint import JointFit
from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.matching import PlanarMatch, match_track
from laci_stereo.core.quality import Placement, Uncertainty, covariance_of, judge, uncertainty_by_paper
from laci_stereo.core.result import Quality
from laci_stereo.core.settings import MatchSettings, QualitySettings
from laci_stereo.core.tracking.tracks import Track
from tests.core.tracks import DRIVE, sighting, vehicle
from tests.simulated import Drive

STAMPS = np.arange(0.0, 5.0, 0.1)
SIZE = np.array([4.4, 1.8])
TRUTH = PlanarMatch(0.7, np.array([-30.0, 12.0]))
SURE = np.diag([1e-5, 1e-5, 1e-3]) ** 2


def seen(
    noise_m: float = 0.0, lacking: float = 0.0, sigma_m: float = 0.0, drive: Drive = DRIVE, seed: int = 0
) -> Track:
    """Boxes of the right orientation; they lack so much of each side that faces away from the sensor."""
    rng = np.random.default_rng(seed)
    xy, yaw = drive.at(STAMPS)
    centres = rotate_xy(-TRUTH.yaw_rad, xy - TRUTH.shift)
    yaw = yaw - TRUTH.yaw_rad
    away = np.sign(rotate_xy(-yaw, centres))
    centres = centres - rotate_xy(yaw, away * lacking / 2) + rng.normal(0.0, noise_m, centres.shape)
    length, width = SIZE - lacking
    return Track(
        tuple(
            sighting(t, at, 200, size=(length, width), yaw_rad=angle, sigma_m=sigma_m)
            for t, at, angle in zip(STAMPS, centres, yaw, strict=True)
        )
    )


def of(position_m: float, yaw_rad: float, spread_m: float) -> Uncertainty:
    """A doubt that is alike in all directions, over a track that reaches so far from its middle."""
    return Uncertainty(np.diag([yaw_rad, position_m, position_m]) ** 2, np.array([[spread_m, 0.0], [-spread_m, 0.0]]))


def position_m(doubt: Uncertainty) -> float:
    return float(np.sqrt(doubt.covariance[1, 1]))


def doubt(track: Track, drive: Drive = DRIVE) -> Uncertainty:
    told = vehicle(drive)
    match = match_track(track.centres, told.at(track.stamps_s)[0])
    return uncertainty_by_paper(match, track, told, np.ones(len(track.usable), dtype=bool), MatchSettings())


def verdict(value: Uncertainty, ground: FloatArray = SURE, track: Track | None = None) -> Quality:
    track = track or seen()
    placement = Placement(JointFit(TRUTH, (0.0,), value.covariance, np.zeros(2), (0.0,), ((),), 0.1, 31), value)
    return judge(placement, ground, len(track.sightings), QualitySettings())


def test_exact_boxes_leave_no_doubt() -> None:
    sure = doubt(seen())
    assert position_m(sure) < 0.01
    assert np.degrees(sure.yaw_rad) < 0.05


def test_doubt_grows_with_noise() -> None:
    found = [doubt(seen(noise)) for noise in (0.0, 0.05, 0.2, 0.8)]
    assert np.diff([position_m(one) for one in found]).min() > 0.02
    assert np.diff([one.yaw_rad for one in found]).min() > 0.0
    assert position_m(found[2]) == pytest.approx(0.2, rel=0.4)


def test_doubt_grows_with_what_the_boxes_lack() -> None:
    found = [doubt(seen(lacking=lacking)).track_xy_m for lacking in (0.0, 0.3, 0.6, 1.2)]
    assert np.diff(found).min() > 0.05


@pytest.mark.parametrize("lacking", [0.4, 0.8, 1.4])
def test_the_error_that_lacking_boxes_cause_is_known(lacking: float) -> None:
    track = seen(lacking=lacking)
    told = vehicle()
    world = told.at(track.stamps_s)[0]
    match = match_track(track.centres, world)
    true_level = rotate_xy(-TRUTH.yaw_rad, world - TRUTH.shift)
    error = np.sqrt(((match(true_level) - world) ** 2).sum(axis=1).mean())
    claimed = uncertainty_by_paper(match, track, told, np.ones(len(track.usable), dtype=bool), MatchSettings())
    assert error == pytest.approx(claimed.track_xy_m, rel=0.3)
    assert abs(match.yaw_rad - TRUTH.yaw_rad) < 1.5 * claimed.yaw_rad


def test_noise_that_makes_boxes_large_does_not_hide_what_they_lack() -> None:
    # By the noise of their points the boxes are as large as the vehicle.
    assert doubt(seen(sigma_m=0.3)).track_xy_m > doubt(seen(sigma_m=0.1)).track_xy_m > doubt(seen()).track_xy_m + 0.1


def test_a_short_drive_leaves_the_yaw_in_doubt() -> None:
    slow = replace(DRIVE, speeds=((0.0, 2.6),))
    assert doubt(seen(0.1, drive=slow), slow).yaw_rad > 2 * doubt(seen(0.1)).yaw_rad


def test_track_xy_joins_position_and_yaw() -> None:
    assert of(0.3, 0.0, 10.0).track_xy_m == pytest.approx(0.3 * np.sqrt(2))
    assert of(0.0, 0.02, 10.0).track_xy_m == pytest.approx(0.2)


# covariance


@st.composite
def covariances(draw: st.DrawFn) -> FloatArray:
    A = np.random.default_rng(draw(st.integers(0, 10_000))).normal(size=(3, 3)) * draw(st.floats(1e-6, 0.1))
    return A @ A.T


@given(
    covariances(),
    st.floats(0.0, 2.0),
    st.floats(0.0, 0.2),
    st.floats(-3.2, 3.2),
    st.tuples(st.floats(-60.0, 60.0), st.floats(-60.0, 60.0)),
)
def test_the_covariance_is_symmetric_and_positive_semidefinite(
    ground: FloatArray, position: float, yaw: float, turn: float, middle: tuple[float, float]
) -> None:
    found = covariance_of(of(position, yaw, 10.0), ground, PlanarMatch(turn, np.zeros(2)), np.array(middle))
    assert found.shape == (6, 6)
    assert found == pytest.approx(found.T, abs=1e-12)
    values = np.linalg.eigvalsh(found)
    assert values.min() >= -1e-9 * max(values.max(), 1e-9)
    assert found[2, 2] >= yaw * yaw
    assert min(found[3, 3], found[4, 4]) >= position * position


@settings(max_examples=20, deadline=None)
@given(covariances(), st.floats(-3.2, 3.2), st.tuples(st.floats(-60.0, 60.0), st.floats(-60.0, 60.0)))
def test_the_covariance_is_that_of_drawn_errors(ground: FloatArray, turn: float, middle: tuple[float, float]) -> None:
    ground = ground * 1e-4
    match = PlanarMatch(turn, np.array([5.0, 6.0]))
    found = covariance_of(of(0.0, 0.0, 10.0), ground, match, np.array(middle))
    drawn = np.random.default_rng(0).multivariate_normal(np.zeros(3), ground, 4000)
    # Apply each error in the level frame, and see by how much it moves the ground at the track's middle.
    point = np.array([*middle, 0.0])
    lifted = (
        Rotation.from_rotvec(np.column_stack([drawn[:, :2], np.zeros(len(drawn))])).apply(point)[:, 2] + drawn[:, 2]
    )
    assert lifted.var() == pytest.approx(found[5, 5], rel=0.15, abs=1e-15)
    axis = rotate_xy(turn, drawn[:, :2])
    assert np.cov(axis.T) == pytest.approx(found[:2, :2], rel=0.2, abs=0.1 * np.abs(found[:2, :2]).max())


def test_a_turned_world_turns_the_covariance() -> None:
    ground = np.diag([1e-3, 3e-3, 0.01]) ** 2
    one = covariance_of(of(0.2, 0.01, 10.0), ground, PlanarMatch(0.3, np.zeros(2)), np.array([20.0, 4.0]))
    other = covariance_of(of(0.2, 0.01, 10.0), ground, PlanarMatch(0.3 + 1.1, np.zeros(2)), np.array([20.0, 4.0]))
    R = np.eye(6)
    R[:3, :3] = R[3:, 3:] = Rotation.from_rotvec([0.0, 0.0, 1.1]).as_matrix()
    assert R @ one @ R.T == pytest.approx(other)


# verdict


@pytest.mark.parametrize(
    ("position", "yaw_deg", "expected", "reasons"),
    [
        (0.1, 0.1, "pass", 0),
        (0.35, 0.1, "pass", 0),
        (0.36, 0.1, "warn", 1),
        (1.0, 0.1, "warn", 1),
        (1.1, 0.1, "fail", 1),
        (0.1, 0.6, "warn", 1),
        (0.1, 1.6, "fail", 1),
        (0.6, 1.6, "fail", 2),
    ],
)
def test_verdict(position: float, yaw_deg: float, expected: str, reasons: int) -> None:
    quality = verdict(of(position, float(np.radians(yaw_deg)), 0.0))
    assert quality.verdict == expected
    assert len(quality.reasons) == reasons
    assert quality.track_xy_sigma_m == pytest.approx(position * np.sqrt(2))
    assert quality.yaw_sigma_deg == pytest.approx(yaw_deg)


def test_a_doubtful_tilt_is_named() -> None:
    quality = verdict(of(0.1, 0.0, 10.0), np.diag([*np.radians([1.2, 0.1]), 0.02]) ** 2)
    assert quality.verdict == "warn"
    assert quality.reasons == ("tilt is known to 1.2 deg; the limit is 1 deg",)
    assert quality.height_sigma_m == pytest.approx(0.02)


@pytest.mark.parametrize(("yaw_deg", "told"), [(0.503, "0.503"), (0.500031, "0.50003")])
def test_a_reason_shows_that_the_limit_is_exceeded(yaw_deg: float, told: str) -> None:
    (reason,) = verdict(of(0.0, float(np.radians(yaw_deg)), 0.0)).reasons
    assert reason == f"yaw is known to {told} deg; the limit is 0.5 deg"


def test_the_weakest_direction_is_that_of_the_least_known_axis() -> None:
    turn = rotate_xy(0.4, np.eye(2)).T
    covariance = np.zeros((3, 3))
    covariance[1:, 1:] = turn @ np.diag([0.25, 0.01]) @ turn.T
    quality = verdict(Uncertainty(covariance, np.zeros((1, 2))))
    assert quality.weakest_sigma_m == pytest.approx(0.5)
    assert quality.weakest_yaw_deg == pytest.approx(np.degrees(0.4))


def test_an_unsure_yaw_is_weakest_across_the_track() -> None:
    quality = verdict(of(0.0, 0.02, 10.0))
    assert quality.weakest_sigma_m == pytest.approx(0.2)
    assert quality.weakest_yaw_deg == pytest.approx(90.0)
