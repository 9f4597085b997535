from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as effort
from hypothesis import strategies as st
from scipy.stats import chi2

from laci_stereo.core.detections import DetectionLog, observe_detections
from laci_stereo.core.errors import GroundError
from laci_stereo.core.frames import Axes, FloatArray, invert, planar, rigid, transform
from laci_stereo.core.ground.box_heights import BENT_PER_M
from laci_stereo.core.ground.plane import GroundPlane
from laci_stereo.core.settings import GroundSettings, Settings
from tests.detections import EXACT, Noise, Passing, Traffic, traffic
from tests.simulated import EPOCH_NS, Drive

UPRIGHT_YAW = {
    # From forward, left, up to other ways in which sensors count their axes; each row is an axis of theirs.
    "y forward, z up": (Axes((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "x forward, z down": (Axes((1.0, 0.0, 0.0), (0.0, 0.0, -1.0)), [[1, 0, 0], [0, -1, 0], [0, 0, -1]]),
    "camera": (Axes((0.0, 0.0, 1.0), (0.0, -1.0, 0.0)), [[0, -1, 0], [0, 0, -1], [1, 0, 0]]),
    "x up": (Axes((0.0, 0.0, 1.0), (1.0, 0.0, 0.0)), [[0, 0, 1], [0, -1, 0], [1, 0, 0]]),
}

LANE = Drive((28.0, -30.0), 90.0, speeds=((0.0, 8.0),))


def ground_errors(made: Traffic, found: GroundPlane) -> FloatArray:
    """Return by how much the truth is turned about level x and y, and lifted, from what was found [rad, rad, m]."""
    level = found.T_level_sensor(made.axes)[:3, :3]
    x, y, _ = np.cross(level @ made.T_world_sensor[2, :3], [0.0, 0.0, 1.0])
    return np.array([x, y, made.T_world_sensor[2, 3] - found.height_m])


def lifted(made: Traffic, by_m: FloatArray) -> DetectionLog:
    """Shift detections along the true vertical."""
    up = made.T_world_sensor[2, :3]
    return replace(made.detections, points_sensor=made.detections.points_sensor + by_m[:, None] * up)


@given(st.integers(0, 10_000))
@effort(max_examples=8, deadline=None)
def test_exact_boxes_give_the_exact_ground_and_tracks(seed: int) -> None:
    made = traffic(seed, 12, EXACT)
    seen = observe_detections(made.detections, made.axes)
    assert ground_errors(made, seen.ground) == pytest.approx([0, 0, 0], abs=1e-6)
    assert sum(len(track.sightings) for track in seen.tracks) == len(made.detections)
    # The level frame is a turn and a shift of the plan away from the world.
    T_world_level = made.T_world_sensor @ invert(seen.T_level_sensor)
    assert T_world_level == pytest.approx(planar(np.arctan2(*T_world_level[[1, 0], 0]), T_world_level[:2, 3]), abs=1e-6)
    epoch_s = (made.detections.stamps_ns[0] - EPOCH_NS) / 1e9
    for track in seen.tracks:
        centres = transform(T_world_level, np.column_stack([track.centres, np.zeros(len(track.centres))]))[:, :2]
        off = [np.linalg.norm(one.at(track.stamps_s + epoch_s)[0] - centres, axis=1).max() for one in made.vehicles]
        one = made.vehicles[int(np.argmin(off))]
        assert min(off) < 1e-4
        yaw = one.at(track.stamps_s + epoch_s)[1] - np.arctan2(*T_world_level[[1, 0], 0])
        found = np.array([sighting.box.yaw_rad for sighting in track.sightings])
        # What the tilted sensor calls yaw is not the ground's: by up to 1.8 deg at 20 deg.
        assert np.abs(np.sin(found - yaw)).max() < 1e-4
        assert {(s.box.length_m, s.box.width_m) for s in track.sightings} == {one.size[:2]}


@pytest.mark.parametrize("name", list(UPRIGHT_YAW))
def test_a_sensor_that_counts_its_axes_otherwise_sees_the_same(name: str) -> None:
    made = traffic(3, 10)
    axes, into = UPRIGHT_YAW[name]
    R = np.array(into, dtype=np.float64)
    log = made.detections
    heading = np.column_stack([np.cos(log.yaw_rad), np.sin(log.yaw_rad), np.zeros(len(log))]) @ R.T
    upright = int(np.argmax(np.abs(axes.up)))
    zero, about = np.eye(3)[1 if upright == 0 else 0], np.eye(3)[upright]
    yaw = np.arctan2(heading @ np.cross(about, zero), heading @ zero)
    turned = replace(log, points_sensor=log.points_sensor @ R.T, yaw_rad=yaw)
    here = observe_detections(log, made.axes)
    there = observe_detections(turned, axes)
    assert there.ground.height_m == pytest.approx(here.ground.height_m)
    assert there.T_level_sensor[:3, :3] @ R == pytest.approx(here.T_level_sensor[:3, :3])
    assert there.ground.covariance_level(axes) == pytest.approx(here.ground.covariance_level(made.axes))
    for one, other in zip(here.tracks, there.tracks, strict=True):
        assert other.centres == pytest.approx(one.centres)
        boxes = [(a.box.yaw_rad, b.box.yaw_rad) for a, b in zip(one.sightings, other.sightings, strict=True)]
        assert max(abs(np.sin(a - b)) for a, b in boxes) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("bias_m", [0.0, 0.15])
def test_the_covariance_of_the_ground_is_honest(bias_m: float) -> None:
    """Also where a detector errs for each vehicle alike, so that many boxes say little more than one."""
    squared = []
    for seed in range(40):
        made = traffic(seed, 12)
        bias = bias_m * np.random.default_rng(seed).normal(size=len(made.vehicles))
        ground = observe_detections(lifted(made, bias[made.of_vehicle]), made.axes).ground
        error = ground_errors(made, ground)
        squared.append(error @ np.linalg.solve(ground.covariance_level(made.axes), error))
    # Fewer than 35 of 40 in the 95 % region are chance once in 70 times; a claim ten times too small has none there.
    assert np.mean(np.array(squared) < chi2(3).ppf(0.95)) >= 35 / 40
    assert np.mean(squared) > 0.3  # and it claims no more than a few times of what it errs by


@pytest.mark.slow
def test_on_a_bent_road_the_tilt_holds_where_vehicles_are() -> None:
    """As the road's slope differs there from that of one plane, as seldom beyond three sigma as of a plane's own error.

    Roads are bent as any are (`BENT_PER_M`), along the line on which vehicles are spread most.
    """
    beyond = []
    for seed in range(20):
        made = traffic(seed, 12)
        xy = transform(made.T_world_sensor, made.detections.points_sensor)[:, :2]
        along = (xy - xy.mean(axis=0)) @ np.linalg.eigh(np.cov(xy.T))[1][:, 1]
        per_m = np.random.default_rng(seed).normal(0.0, BENT_PER_M)
        ground = observe_detections(lifted(made, per_m / 2 * along**2), made.axes).ground
        tilt = np.sqrt(np.linalg.eigvalsh(ground.covariance_level(made.axes)[:2, :2])[1])
        beyond.append(np.mean(np.abs(per_m * along) > 3.0 * tilt))
    assert np.mean(beyond) < 0.05


def test_boxes_that_err_together_count_for_less() -> None:
    made = traffic(5, 12)
    bias = 0.15 * np.random.default_rng(5).normal(size=len(made.vehicles))[made.of_vehicle]
    shuffled = np.random.default_rng(0).permutation(bias)
    alike, mixed = (observe_detections(lifted(made, by), made.axes).ground for by in (bias, shuffled))
    assert alike.support_cells < mixed.support_cells / 5
    # What a vehicle's boxes share is told from a tilt along its way: it costs no accuracy.
    assert np.linalg.norm(ground_errors(made, alike)[:2]) < np.radians(0.05)


def test_detections_that_float_do_not_lift_the_ground() -> None:
    made = traffic(2, 12)
    rng = np.random.default_rng(0)
    floating = np.where(rng.random(len(made.detections)) < 0.2, rng.uniform(1.0, 5.0, len(made.detections)), 0.0)
    clean = observe_detections(made.detections, made.axes).ground
    ground = observe_detections(lifted(made, floating), made.axes).ground
    assert np.degrees(np.abs(ground_errors(made, ground)[:2])).max() < 0.1
    assert ground.height_m == pytest.approx(clean.height_m, abs=0.02)
    assert ground.inlier_share == pytest.approx(0.8, abs=0.02)


def test_how_long_a_vehicle_waits_does_not_matter() -> None:
    """Alone in its place and seen 0.3 m too high, it makes up most of the rows."""
    drives = [Drive((x, -30.0), 90.0, speeds=((0.0, 8.0),)) for x in (20.0, 28.0, 36.0)]
    waiting = Drive((44.0, 0.0), 90.0, speeds=((0.0, 0.0),))
    moving = [Passing(drives[i % 3], 5.0 + 4.0 * i, (4.4, 1.8, 1.5)) for i in range(9)]
    standing = [Passing(waiting, begin, (4.4, 1.8, 1.5)) for begin in (9.0, 38.0, 67.0, 96.0)]
    made = traffic(1, vehicles=[*moving, *standing])
    waits = made.of_vehicle >= len(moving)
    assert waits.mean() > 0.5
    # One number for one standing vehicle, as a tracker gives it.
    log = replace(lifted(made, np.where(waits, 0.3, 0.0)), track_id=np.where(waits, len(moving), made.of_vehicle))
    shorter = ~waits | (np.cumsum(waits) <= 100)
    # So much tilts the ground that its doubt is at the limit.
    settings = Settings(ground=GroundSettings(max_tilt_sigma_deg=2.0))
    long, short = (observe_detections(one, made.axes, settings).ground for one in (log, log[shorter]))
    sigma = np.sqrt(np.diag(short.covariance_level(made.axes)))
    assert (np.abs(ground_errors(made, long) - ground_errors(made, short)) < sigma).all()


@pytest.mark.parametrize("drive", [LANE, Drive((10.0, 0.0), 0.0, speeds=((0.0, 8.0),))])
def test_one_lane_does_not_tell_the_tilt_across_it(drive: Drive) -> None:
    made = traffic(4, vehicles=[Passing(drive, 5.0 + 6 * i, (4.4, 1.8, 1.5)) for i in range(12)])
    with pytest.raises(GroundError, match=r"on one line: 0\.\d+ m of spread .* at least 0\.9 m needed .* --level"):
        observe_detections(made.detections, made.axes)
    assert observe_detections(made.detections, made.axes, level_m=6.0).ground.height_m == 6.0


def test_too_few_boxes_are_no_ground() -> None:
    made = traffic(4, 12)
    with pytest.raises(GroundError, match=r"boxes with z and height: 49 found, at least 50 needed .* --level"):
        observe_detections(made.detections[np.arange(49)], made.axes)


@pytest.mark.parametrize("limits", [GroundSettings(max_height_m=2.0), GroundSettings(max_tilt_deg=0.001)])
def test_a_plane_that_can_be_no_ground_is_refused(limits: GroundSettings) -> None:
    made = traffic(4, 12)
    with pytest.raises(GroundError, match=r"plane below the boxes: .* deg from up, .* m below found, .* --level"):
        observe_detections(made.detections, made.axes, Settings(ground=limits))


def test_boxes_at_the_sensors_own_height_stand_on_no_ground() -> None:
    made = traffic(4, 12)
    log = made.detections
    flat = np.column_stack([log.points_sensor[:, :2], log.above_ground_m])
    with pytest.raises(GroundError, match=r"plane below the boxes: .* deg from up, -?0.00 m below found, .* --level"):
        observe_detections(replace(log, points_sensor=flat), made.axes)


def test_a_level_sensor_needs_no_third_coordinate() -> None:
    made = traffic(6, 8)
    log = made.detections
    flat = replace(log, points_sensor=log.points_sensor * [1.0, 1.0, np.nan])
    seen = observe_detections(flat, made.axes, level_m=5.5)
    assert seen.T_level_sensor == pytest.approx(rigid(np.eye(3), np.array([0.0, 0.0, 5.5])))
    rows = np.concatenate([np.flatnonzero(log.track_id == number) for number in range(8)])
    xy = np.concatenate([track.centres for track in seen.tracks])
    assert sorted(map(tuple, xy)) == sorted(map(tuple, log.points_sensor[rows, :2]))
    covariance = seen.ground.covariance_level(made.axes)
    assert (np.diag(covariance) > 0).all()
    assert np.linalg.matrix_rank(seen.ground.covariance_sensor) == 3


def test_points_without_a_box_have_no_size() -> None:
    made = traffic(6, 8)
    log = made.detections
    unknown = np.where(np.arange(len(log)) % 2 == 0, np.nan, 1.0)
    tracks = observe_detections(replace(log, length_m=unknown * log.length_m), made.axes).tracks
    sizes = [s.box.length_m * s.box.width_m for track in tracks for s in track.sightings]
    assert sizes.count(0.0) == np.isnan(unknown).sum()
    assert all(s.points.shape == (0, 3) for track in tracks for s in track.sightings)


def test_the_longer_side_is_the_length() -> None:
    made = traffic(6, 8, EXACT)
    log = made.detections
    crossed = replace(log, length_m=log.width_m, width_m=log.length_m, yaw_rad=log.yaw_rad + 0.5 * np.pi)
    here, there = (observe_detections(one, made.axes).tracks for one in (log, crossed))
    for one, other in zip(here, there, strict=True):
        for a, b in zip(one.sightings, other.sightings, strict=True):
            assert (b.box.length_m, b.box.width_m) == (a.box.length_m, a.box.width_m)
            assert abs(np.sin(a.box.yaw_rad - b.box.yaw_rad)) < 1e-9
            assert -np.pi / 2 <= b.box.yaw_rad <= np.pi / 2


def test_speeds_away_from_the_sensor_are_kept() -> None:
    made = traffic(6, 8)
    speeds = np.where(np.arange(len(made.detections)) % 3 == 0, np.nan, np.arange(len(made.detections)))
    tracks = observe_detections(replace(made.detections, radial_mps=speeds), made.axes).tracks
    found = [s.radial_mps for track in tracks for s in track.sightings]
    assert found.count(None) == np.isnan(speeds).sum()
    assert sorted(s for s in found if s is not None) == sorted(speeds[np.isfinite(speeds)])


def test_a_number_that_is_given_again_is_another_object() -> None:
    """A tracker with one number for all, so that only lost time and jumps tell vehicles apart."""
    made = traffic(7, vehicles=[Passing(LANE, begin, (4.4, 1.8, 1.5)) for begin in (10.0, 30.0, 60.0)])
    log = replace(made.detections, track_id=np.zeros(len(made.detections), dtype=np.int64))
    tracks = observe_detections(log, made.axes, level_m=6.0).tracks
    assert sorted(len(track.sightings) for track in tracks) == sorted(np.bincount(made.of_vehicle))


@pytest.mark.parametrize("every", [1, 10])
def test_detections_without_numbers_are_linked_by_motion_however_slow_the_detector(every: int) -> None:
    made = traffic(8, vehicles=[Passing(LANE, begin, (4.4, 1.8, 1.5)) for begin in (10.0, 30.0, 60.0)], noise=Noise())
    frame = np.round((made.detections.stamps_ns - made.detections.stamps_ns[0]) / 1e8).astype(int)
    log = replace(made.detections, track_id=np.full(len(made.detections), -1))[frame % every == 0]
    tracks = observe_detections(log, made.axes, level_m=6.0).tracks
    assert len(tracks) == 3
    assert sum(len(track.sightings) for track in tracks) == len(log)
