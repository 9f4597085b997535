"""What a monitor says of traffic whose truth is known."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from laci_stereo.core.errors import GroundError, MapError
from laci_stereo.io.maps.lane_map import LaneLine, LaneMap
from laci_stereo.monitor.lanes import Strip, strips_of
from laci_stereo.monitor.run import Monitor
from tests.monitor.support import (
    FINE,
    LANE_X,
    WORLD,
    Seen,
    Traffic,
    drive,
    gone_through,
    lane,
    one_by_one,
    plan,
    traffic,
)
from tests.simulated import Drive, car, pedestrian, stereo

SIDE_M = 0.05
"""A body's side is not flat: windows and roof are behind it by some centimetres."""

SENSORS = {"lidar": FINE, "stereo": stereo(120)}


def driven(tmp_path: Path, source: Traffic, *strips: Strip) -> Monitor:
    return gone_through(source, plan(source, *strips), tmp_path / "out")


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "left_m"), [("lidar", 0.4), ("stereo", -0.4)])
def test_offset_from_the_middle_of_a_lane_is_found_within_its_error(tmp_path: Path, kind: str, left_m: float) -> None:
    habits = np.array([-0.2, 0.0, 0.05, 0.15])
    source = one_by_one(*(drive(left_m + habit) for habit in habits), sensor=SENSORS[kind])
    found = driven(tmp_path, source).state.tally.strips["1"]
    assert found.along == len(habits)
    assert found.offset_m == pytest.approx(left_m + habits.mean(), abs=SIDE_M)
    assert found.error_m is not None
    assert found.offset_m == pytest.approx(left_m, abs=2 * found.error_m)
    # What passages differ by, not frames: 600 positions would claim a hundredth of it.
    assert found.error_m == pytest.approx(habits.std(ddof=1) / np.sqrt(len(habits)), rel=0.5)


@pytest.mark.parametrize("hz", [1.0, 2.0])
def test_vehicles_are_counted_in_few_frames(tmp_path: Path, hz: float) -> None:
    """At 12 m/s one is whole in view for four seconds."""
    left_m = 0.3
    source = replace(one_by_one(drive(left_m), drive(left_m, 12.0), drive(left_m, 7.0)), hz=hz)
    found = driven(tmp_path, source).state.tally.strips["1"]
    assert found.along == 3
    assert found.offset_m == pytest.approx(left_m, abs=0.1)


def test_one_passage_has_no_error(tmp_path: Path) -> None:
    found = driven(tmp_path, one_by_one(drive())).state.tally.strips["1"]
    assert found.along == 1
    assert found.error_m is None


def test_positions_of_objects_are_the_truth(tmp_path: Path) -> None:
    truth = drive(0.3, 8.0)
    monitor = driven(tmp_path, one_by_one(truth))
    with (monitor.out / "objects.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    epoch_s = monitor.state.epoch_ns / 1e9
    xy, yaw = truth.at(np.array([float(row["timestamp"]) - epoch_s for row in rows]))
    seen = np.array([[float(row["x"]), float(row["y"])] for row in rows])
    assert len(rows) > 25
    assert np.abs(np.median(seen - xy, axis=0)).max() < 0.1
    # For a moment a parked car hides half of it.
    assert np.quantile(np.abs(seen - xy), 0.9) < 0.2
    assert np.cos(yaw - [float(row["yaw"]) for row in rows]).min() > np.cos(np.radians(5.0))
    utm = np.array([[float(row["utm_east"]), float(row["utm_north"])] for row in rows])
    assert np.abs(utm - WORLD.to_utm(seen)).max() < 0.01
    assert float(rows[0]["length"]) == pytest.approx(4.4, abs=0.4)
    assert {row["lane"] for row in rows} == {"1"}
    assert float(rows[0]["speed"]) == pytest.approx(8.0, rel=0.1)


@pytest.mark.slow
def test_wrong_way_is_counted_as_such(tmp_path: Path) -> None:
    found = driven(tmp_path, one_by_one(drive(), drive(against=True), drive())).state.tally.strips["1"]
    assert (found.along, found.against) == (2, 1)


def test_lane_for_both_ways_has_no_wrong_way(tmp_path: Path) -> None:
    source = one_by_one(drive(), drive(against=True))
    found = driven(tmp_path, source, lane(one_way=False)).state.tally.strips["1"]
    assert (found.along, found.against) == (2, 0)


def test_two_cars_at_once_are_two_passages_in_their_own_lanes(tmp_path: Path) -> None:
    other = Drive((LANE_X + 4.0, -24.0), 90.0, speeds=((0.0, 9.0),))
    source = traffic([car(drive(0.2)), car(other)])
    line = LaneLine("line_thin", "", np.array([[LANE_X + 4.2, -40.0], [LANE_X + 4.2, 40.0]]), "2")
    lanes = [lane(), *strips_of(LaneMap((line,), ()), (), 2.0)]
    tally = driven(tmp_path, source, *lanes).state.tally
    assert tally.passages == 2
    assert {name: one.along for name, one in tally.strips.items() if name == "1"} == {"1": 1}
    assert sum(one.along for name, one in tally.strips.items() if name.startswith("2 ")) == 1


def test_share_off_the_road_is_that_of_the_way(tmp_path: Path) -> None:
    # The lane ends in the middle of the view: what is seen of the way before and after is known from the table.
    monitor = driven(tmp_path, one_by_one(drive(), drive()), lane(to_y=0.0))
    tally = monitor.state.tally
    with (monitor.out / "objects.csv").open() as stream:
        y = np.array([float(row["y"]) for row in csv.DictReader(stream) if row["object"] == "1"])
    assert tally.off_road / tally.positions == pytest.approx(-y.min() / np.ptp(y), abs=0.05)
    assert 0.2 < tally.off_road / tally.positions < 0.8


@pytest.mark.parametrize("kind", SENSORS)
def test_wait_does_not_outweigh_driving(tmp_path: Path, kind: str) -> None:
    stop = Drive((LANE_X, 18.0), -90.0, speeds=((0.0, 9.0), (1.5, 9.0), (2.5, 0.0), (4.0, 0.0), (5.0, 9.0)))
    monitor = driven(tmp_path, one_by_one(stop, sensor=SENSORS[kind]))
    tally = monitor.state.tally
    with (monitor.out / "objects.csv").open() as stream:
        y = [float(row["y"]) for row in csv.DictReader(stream)]
    assert tally.passages == 1
    assert max(tally.cells.values()) <= 2
    # A third of the frames is at rest, but one position for each quarter of a metre.
    assert tally.positions == pytest.approx(np.ptp(y) / 0.25, rel=0.1)
    assert np.ptp(y) > 12.0


def test_walkers_and_what_stands_are_no_passages(tmp_path: Path) -> None:
    walker = pedestrian(Drive((20.0, 5.0), -90.0, speeds=((0.0, 1.5),)))
    standing = car(Drive((30.0, 2.0), 30.0, speeds=((0.0, 0.0),)))
    tally = driven(tmp_path, traffic([walker], [standing, walker], [walker])).state.tally
    assert tally.passages == 0


def test_map_without_lanes_is_held_against_its_boundaries(tmp_path: Path) -> None:
    line = LaneLine("line_thin", "solid", np.array([[LANE_X + 1.75, 40.0], [LANE_X + 1.75, -40.0]]), "7")
    stop = LaneLine("stop_line", "solid", np.array([[LANE_X - 2.0, 0.0], [LANE_X + 2.0, 0.0]]), "8")
    strips = strips_of(LaneMap((line, stop), ()), (), 2.4)
    assert {strip.id for strip in strips} == {"7 left", "7 right"}
    found = driven(tmp_path, one_by_one(drive(0.3), drive(0.3)), *strips).state.tally.strips
    # Southbound, to the right of the line, which is on the left of who drives.
    assert set(found) == {"7 right"}
    assert found["7 right"].offset_m == pytest.approx(-1.45, abs=2 * SIDE_M)
    with pytest.raises(MapError, match="1 lines"):
        strips_of(LaneMap((stop,), ()), (), 2.4)


@pytest.mark.slow
def test_scene_is_learnt_from_the_stretch_before(tmp_path: Path) -> None:
    """Who parks is an object while he comes, and background afterwards, so that nothing is linked with him."""
    parks = car(Drive((28.0, 12.0), -90.0, speeds=((0.0, 6.0), (2.0, 0.0))))
    parked = car(Drive((28.0, 6.0), -90.0, speeds=((0.0, 0.0),)))
    source = traffic([parks], *[[parked]] * 4, [parked, car(drive())])
    monitor = gone_through(source, plan(source, block_s=10.0), tmp_path / "out")
    assert monitor._learnt is not None
    assert monitor._learnt.frames == range(100, 200)
    xy = np.array([[28.0, 6.0 - 0.5]])
    assert monitor._learnt.background.covers(xy).all()
    assert monitor.state.tally.strips["1"].along == 1


@pytest.mark.slow
def test_stretch_that_shows_nothing_is_seen_against_the_one_before(tmp_path: Path) -> None:
    class Fog(Traffic):
        def learn(self, frames: range) -> Seen:
            if frames.start == 50:
                raise GroundError("no ground")
            return super().learn(frames)

    source = Fog(tuple((car(drive(0.1)),) for _ in range(3)), FINE)
    monitor = gone_through(source, plan(source, block_s=5.0), tmp_path / "out")
    assert monitor.state.tally.passages == 3

    class Dark(Fog):
        def learn(self, frames: range) -> Seen:
            raise GroundError("no ground")

    with pytest.raises(GroundError, match="no ground"):
        gone_through(Dark(source.episodes, source.sensor), plan(source), tmp_path / "dark")
