from __future__ import annotations

import json
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from laci_lidar.axes import forward_left_up
from laci_lidar.errors import ScanError
from laci_lidar.recording import LidarRecording, group_scans
from laci_lidar.run import stamp_errors
from laci_lidar.scan import Scan
from laci_lidar.scans import open_scans
from laci_lidar.settings import LidarSettings, Sweep

from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.errors import SettingError
from laci_stereo.core.frames import FloatArray, invert, rigid, transform
from laci_stereo.core.observe import GROUND_POINTS
from laci_stereo.core.tracking.background import BACKGROUND_FRAMES
from laci_stereo.io.axes import parse_axes
from laci_stereo.io.cam.csv_log import read_cam_csv
from tests.io.support import SHARED, needs_shared
from tests.lidar.scanner import Listed, listed, road
from tests.lidar.support import (
    EPOCH_NS,
    FILE_FORMATS,
    PERIOD_NS,
    Array,
    write_bag1,
    write_bag2,
    write_folder,
    write_pcd,
    xyz_of,
)
from tests.simulated import lidar
from tests.simulated import scene as crossing

EXACT = LidarSettings(range_sigma_m=0.02, angle_sigma_rad=1e-3)


def scans(count: int, offset: bool = True, layers: int = 16) -> list[Scan]:
    found = []
    for seed in range(count):
        points = road(sigma_m=0.02, seed=seed, layers=layers, step_deg=0.8)
        found.append(Scan(points, None, np.linspace(0.0, 0.09, len(points)) if offset else None))
    return found


def test_scans_that_hold_those_before_are_refused():
    """As mapping tools write them: of each sweep and the two before."""
    sweeps = [road(sigma_m=0.02, seed=seed, layers=8, step_deg=0.8) for seed in range(8)]
    late_s = np.linspace(0.0, 0.09, len(sweeps[0]))
    times_s = np.concatenate([late_s - 0.1 * back for back in range(3)])
    window = [Scan(np.concatenate(sweeps[i : i + 3][::-1]), None, times_s) for i in range(6)]
    with pytest.raises(
        ScanError, match=r"memory: scans 3 and 4 have \d+ points in common: .* within 0\.29 s, .* 0\.10 s"
    ):
        _ = LidarRecording(listed(window), EXACT).scanner
    # Two scanners in one cloud, each at its own time.
    both = [Scan(np.concatenate([one, -one]), None, np.append(late_s, late_s - 0.1)) for one in sweeps]
    assert LidarRecording(listed(both), EXACT).scanner.timed


def test_fields_that_may_be_times_are_named():
    fields = [replace(scan, unused=("ring", "dt")) for scan in scans(4, offset=False)]
    (remark,) = LidarRecording(listed(fields), EXACT).remarks()
    assert "do not tell when each point was taken (not by their fields ring, dt), so whether" in remark
    assert "(" not in LidarRecording(listed(scans(4, offset=False)), EXACT).remarks()[0]


def test_a_frame_holds_its_scan_with_noise_edges_and_times():
    sequence = listed(scans(4))
    recording = LidarRecording(sequence, EXACT, name="mast 3")
    assert (recording.kind, recording.name, len(recording)) == ("lidar", "mast 3", 4)
    assert recording.span_ns == (EPOCH_NS, EPOCH_NS + 3 * PERIOD_NS)
    for _ in range(2):
        for cloud, scan, stamp in zip(recording, sequence.scans, sequence.stamps_ns, strict=True):
            assert scan is not None
            assert cloud.stamp_ns == stamp
            np.testing.assert_array_equal(cloud.points, scan.points)
            np.testing.assert_array_equal(cloud.offset_s, scan.offset_s)
            assert (cloud.sigma_along_m == 0.02).all()
            np.testing.assert_allclose(cloud.sigma_across_m, 1e-3 * np.linalg.norm(scan.points, axis=1))
            azimuth = np.degrees(np.abs(np.arctan2(scan.points[:, 1], scan.points[:, 0])))
            np.testing.assert_array_equal(cloud.at_edge, azimuth > 59.51)


def test_noise_that_is_not_set_is_estimated():
    sequence = listed(scans(6))
    noise = LidarRecording(sequence).scanner.noise
    assert noise.range_sigma_m == pytest.approx(0.02, rel=0.25)
    assert noise.angle_sigma_rad == pytest.approx(np.radians(0.8) / np.sqrt(12), rel=0.1)
    half_set = LidarRecording(sequence, LidarSettings(angle_sigma_rad=5e-4)).scanner.noise
    assert half_set.angle_sigma_rad == 5e-4
    assert half_set.range_sigma_m == pytest.approx(0.02, rel=0.25)


def test_a_scanner_that_sees_too_little_ground_gets_the_usual_noise_and_says_so():
    few = [Scan(road(sigma_m=0.01, step_deg=0.8, seed=seed)[::40], None, None) for seed in range(2)]
    recording = LidarRecording(listed(few))
    assert recording.scanner.noise.range_sigma_m == 0.03
    assert "3 cm; --range-sigma" in recording.remarks()[0]
    assert not any("--range-sigma" in remark for remark in LidarRecording(listed(few), EXACT).remarks())


def test_where_scans_do_not_tell_the_times_of_points_it_says_so_and_the_scanner_may_turn():
    untimed = LidarRecording(listed(scans(3, offset=False)), EXACT)
    (remark,) = untimed.remarks()
    assert "--sweep tells it" in remark
    period_s = float(np.median(np.diff(untimed.scans.stamps_ns))) / 1e9
    assert [cloud.turn_s for cloud in untimed] == [period_s] * 3
    told = LidarRecording(listed(scans(3, offset=False)), replace(EXACT, sweep=Sweep("start", "ccw", 10.0)))
    flash = LidarRecording(listed(scans(3, offset=False)), replace(EXACT, sweep="none"))
    for known in (LidarRecording(listed(scans(3)), EXACT), told, flash):
        assert known.remarks() == ()
        assert [cloud.turn_s for cloud in known] == [0.0] * 3


def test_without_times_of_points_there_are_none_unless_the_sweep_is_told():
    sequence = listed(scans(3, offset=False))
    assert all(cloud.offset_s is None for cloud in LidarRecording(sequence, EXACT))
    told = LidarRecording(sequence, replace(EXACT, sweep=Sweep("start", "ccw", 10.0)))
    for cloud in told:
        azimuth = np.degrees(np.arctan2(cloud.points[:, 1], cloud.points[:, 0]))
        np.testing.assert_allclose(cloud.offset_s, (azimuth + 60.0) / 3600.0, atol=1e-9)


def test_scans_that_were_motion_compensated_may_still_tell_times_which_are_no_more_those_of_points():
    compensated = LidarRecording(listed(scans(3)), replace(EXACT, sweep="none"))
    assert all(cloud.offset_s is None for cloud in compensated)


def test_what_is_near_the_sensor_is_left_out():
    points = road()
    mast = np.array([[0.3, 0.2, -0.5], [0.0, 0.9, 0.0]])
    sequence = listed([Scan(np.concatenate([mast, points]), None, np.zeros(len(points) + 2))])
    (cloud,) = LidarRecording(sequence, EXACT)
    np.testing.assert_array_equal(cloud.points, points)
    (cloud,) = LidarRecording(sequence, replace(EXACT, min_range_m=0.0))
    assert len(cloud) == len(points) + 2


def test_scans_are_gathered_each_point_at_its_own_time():
    sequence = listed(scans(7), gaps=[3])
    recording = LidarRecording(sequence, replace(EXACT, accumulate=3))
    frames = list(recording)
    assert len(frames) == len(recording) == 3
    for cloud, members in zip(frames, ([0, 1, 2], [3], [4, 5, 6]), strict=True):
        middle = sequence.stamps_ns[members[len(members) // 2]]
        assert cloud.stamp_ns == middle
        parts = [sequence.scans[i] for i in members]
        np.testing.assert_array_equal(cloud.points, np.concatenate([part.points for part in parts]))
        own = [(sequence.stamps_ns[i] - middle) / 1e9 + sequence.scans[i].offset_s for i in members]
        np.testing.assert_allclose(cloud.offset_s, np.concatenate(own))


def test_gathered_scans_without_times_still_have_those_of_their_stamps():
    sequence = listed(scans(2, offset=False))
    (cloud,) = LidarRecording(sequence, replace(EXACT, accumulate=2))
    assert cloud.stamp_ns == EPOCH_NS + PERIOD_NS
    assert set(np.round(cloud.offset_s, 9)) == {-0.1, 0.0}


@pytest.mark.parametrize("size", [1, 2, 5, 100])
def test_every_scan_is_in_one_group(size: int):
    stamps = listed([None] * 23, gaps=[4, 11]).stamps_ns
    groups = group_scans(stamps, size)
    assert np.concatenate(groups).tolist() == list(range(23))
    assert max(len(group) for group in groups) <= size
    assert all(np.ptp(stamps[group]) <= (size - 1) * PERIOD_NS for group in groups)


def test_unreadable_scans_are_empty_frames_until_they_are_too_many():
    some = scans(30)
    recording = LidarRecording(listed([None if i % 10 == 3 else scan for i, scan in enumerate(some)]), EXACT)
    assert [len(cloud) == 0 for cloud in recording] == [i % 10 == 3 for i in range(30)]
    assert all(len(cloud) for cloud in recording.survey())
    assert sorted(recording.scans.skipped) == ["13", "23", "3"]
    with pytest.raises(ScanError, match="needed are at least 80% usable"):
        list(LidarRecording(listed([None if i % 3 == 1 else scan for i, scan in enumerate(some)]), EXACT))


def test_the_survey_is_spread_or_what_is_told_to_be_quiet():
    sequence = listed(scans(50, offset=False, layers=100))
    spread = [cloud.stamp_ns for cloud in LidarRecording(sequence, EXACT).survey()]
    assert len(spread) == BACKGROUND_FRAMES
    assert (spread[0], spread[-1]) == (sequence.stamps_ns[0], sequence.stamps_ns[-1])
    assert np.ptp(np.diff(spread)) <= PERIOD_NS
    told = LidarRecording(sequence, EXACT, background=range(10, 14)).survey()
    assert [cloud.stamp_ns for cloud in told] == sequence.stamps_ns[10:14].tolist()
    other = Listed(scans(3), EPOCH_NS - 10**12 + np.arange(3) * PERIOD_NS)
    assert [
        cloud.stamp_ns for cloud in LidarRecording(sequence, EXACT, background=other).survey()
    ] == other.stamps_ns.tolist()
    for wrong in (range(48, 51), range(0), range(-1, 3)):
        with pytest.raises(SettingError, match="background scans are"):
            LidarRecording(sequence, EXACT, background=wrong)


@pytest.mark.parametrize("accumulate", [1, 2])
def test_of_sparse_scans_the_survey_has_as_many_as_the_ground_needs(accumulate: int):
    sparse = scans(150, offset=False)
    recording = LidarRecording(listed(sparse), replace(EXACT, accumulate=accumulate))
    counts = [len(cloud) for cloud in recording.survey()]
    assert BACKGROUND_FRAMES < len(counts) < len(recording)
    assert GROUND_POINTS <= sum(counts) < GROUND_POINTS + max(counts)
    few = LidarRecording(listed(sparse[:30]), EXACT)
    assert len(list(few.survey())) == 30


@pytest.mark.parametrize("form", ["folder", "bag"])
def test_memory_does_not_grow_with_the_number_of_scans(form: str, tmp_path: Path):
    points = road(layers=64, step_deg=0.2)
    columns = {axis: points[:, i].astype(np.float32) for i, axis in enumerate("xyz")}

    def peak(count: int) -> int:
        if form == "folder":
            path = write_folder(tmp_path / str(count), [columns] * count)
        else:
            path = write_bag1(tmp_path / f"{count}.bag", {"/points": [columns] * count})
        recording = LidarRecording(open_scans(path), replace(EXACT, workers=1))
        tracemalloc.start()
        try:
            assert sum(1 for cloud in recording if len(cloud)) == count
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    # Which scans are decoded ahead is chance; what is kept of each would make it six times as much.
    assert peak(90) < 1.5 * peak(15)


def test_a_view_of_nothing_but_the_mast():
    sequence = listed([Scan(np.full((50, 3), 0.2))] * 3)
    with pytest.raises(ScanError, match="nearer than 1 m"):
        list(LidarRecording(sequence, EXACT))


@pytest.mark.parametrize(
    "wrong",
    [
        {"range_sigma_m": 0.0},
        {"angle_sigma_rad": 1.0},
        {"accumulate": 0},
        {"min_range_m": -1.0},
        {"range_sigma_m": np.nan},
    ],
)
def test_settings_out_of_range(wrong):
    with pytest.raises(SettingError, match="needed is"):
        LidarSettings(**wrong)


# The shared crossing, through files.

CROSSING = SHARED / "data/crossing"


def calibrated(recording: LidarRecording) -> FloatArray:
    return calibrate(recording, read_cam_csv(CROSSING / "cam.csv").log).T_utm_sensor


@pytest.fixture(scope="module")
def plain() -> FloatArray:
    return calibrated(LidarRecording(open_scans(CROSSING / "lidar_8")))


@needs_shared
def test_eight_layers_are_calibrated(plain: FloatArray):
    shift_m, turn_deg = errors(plain, "lidar_8")
    assert shift_m < 1.0
    assert turn_deg < 2.0


@needs_shared
@pytest.mark.slow
def test_thirty_two_layers_are_calibrated():
    shift_m, turn_deg = errors(calibrated(LidarRecording(open_scans(CROSSING / "lidar_32"))), "lidar_32")
    assert shift_m < 1.0
    assert turn_deg < 2.0


def errors(T_utm_sensor: FloatArray, sensor: str) -> tuple[float, float]:
    """Return the error at the vehicle's track, root mean square in metres, and that of the rotation in degrees."""
    truth = json.loads((CROSSING / "truth.json").read_text())
    T_true = np.array(truth["lidar"][sensor]["T_world_lidar_utm"])
    track = np.array(truth["vehicle_centres_utm"])[:, 1:]
    track = track[np.linalg.norm(track - T_true[:2, 3], axis=1) < 60.0]
    points = np.column_stack([track, np.zeros(len(track)), np.ones(len(track))])
    moved = points @ (T_utm_sensor @ np.linalg.inv(T_true)).T - points
    cosine = (np.trace(T_utm_sensor[:3, :3] @ T_true[:3, :3].T) - 1.0) / 2.0
    return float(np.sqrt((moved[:, :2] ** 2).sum(axis=1).mean())), float(np.degrees(np.arccos(min(cosine, 1.0))))


@pytest.mark.slow
@needs_shared
def test_a_sensor_whose_axes_point_elsewhere_gives_the_same_place(plain: FloatArray, tmp_path: Path):
    axes = parse_axes("y forward, z down")
    R = forward_left_up(axes)
    folder = open_scans(CROSSING / "lidar_8")
    for stamp, scan in zip(folder.stamps_ns, folder.read(range(len(folder)), 1), strict=True):
        assert scan is not None
        write_pcd(tmp_path / f"{stamp}.pcd", dict(zip("xyz", (scan.points @ R).T, strict=True)))
    turned = calibrated(LidarRecording(open_scans(tmp_path), LidarSettings(axes=axes))) @ rigid(R.T, np.zeros(3))
    # The fit of the ground looks at cells along the axes, so that it is not the same to the last digit.
    np.testing.assert_allclose(turned[:3, :3], plain[:3, :3], atol=2e-3)
    np.testing.assert_allclose(turned[:3, 3], plain[:3, 3], rtol=0.0, atol=0.05)


# One scene in every format.

BAGS = {
    "ros 1 bag": lambda path, scans, stamps: write_bag1(path, {"/points": scans}, stamps_ns=stamps),
    "ros 2 bag": lambda path, scans, stamps: write_bag2(path, {"/points": scans}, stamps_ns=stamps),
    "mcap": lambda path, scans, stamps: write_bag2(path, {"/points": scans}, "mcap", stamps_ns=stamps),
}
MADE = crossing(sensor=lidar(layers=48, columns=160))


@pytest.fixture(scope="module")
def columns() -> list[dict[str, Array]]:
    scans = []
    for cloud in MADE.recording:
        xyz = dict(zip("xyz", cloud.points.T.astype(np.float32), strict=True))
        still = {"t": np.zeros(len(cloud), np.uint32), "intensity": np.ones(len(cloud), np.float32)}
        scans.append(xyz | still)
    return scans


@pytest.fixture(scope="module")
def from_memory(columns: list[dict[str, Array]]) -> FloatArray:
    scans = [Scan(xyz_of(scan), None, None) for scan in columns]
    return seen_on_map(LidarRecording(Listed(scans, np.array(MADE.recording.stamps_ns))))


def seen_on_map(recording: LidarRecording) -> FloatArray:
    """Return where the calibrated sensor sees the vehicle's way, and 2 m above it, on the map; shape (n, 3)."""
    xy, _ = MADE.vehicle.drive.at(MADE.recording.times_s)
    way = np.concatenate([np.column_stack([xy, np.full(len(xy), z)]) for z in (0.0, 2.0)])
    found = calibrate(recording, MADE.messages)
    return transform(found.T_utm_sensor, transform(invert(MADE.recording.T_world_sensor), way))


@pytest.mark.slow
@pytest.mark.parametrize("form", [*FILE_FORMATS, "ros 1 bag", "ros 2 bag", "mcap"])
def test_every_format_gives_the_same_place_to_a_millimetre(
    form: str, columns: list[dict[str, Array]], from_memory: FloatArray, tmp_path: Path
):
    stamps = MADE.recording.stamps_ns
    if form in BAGS:
        written = open_scans(BAGS[form](tmp_path / "a.bag", columns, stamps))
    else:
        written = open_scans(write_folder(tmp_path / "scans", columns, form, stamps))
    apart_m = np.linalg.norm(seen_on_map(LidarRecording(written)) - from_memory, axis=1)
    assert apart_m.max() < 1e-3


@pytest.mark.parametrize(("clock", "told"), [("stamp", True), ("Unix", False)])
def test_times_of_arrival_are_told(clock: Literal["stamp", "Unix"], told: bool) -> None:
    """Points with Unix times of their own do not depend on them."""
    late_ns = np.random.default_rng(1).exponential(0.04e9, 60).astype(np.int64)
    some = [replace(scan, clock=clock) for scan in scans(60)]
    stamps_ns = np.sort(EPOCH_NS + np.arange(60) * PERIOD_NS + late_ns)
    found = stamp_errors(Listed(some, stamps_ns))
    assert bool(found.notes) == told
    assert found.sigma_s == (pytest.approx(0.04, rel=0.4) if told else 0.0)
    steady = stamp_errors(listed(some))
    assert not steady.notes
