from __future__ import annotations

import inspect
import sys
import tracemalloc
from collections import Counter
from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest

from laci_stereo.core.settings import TrackSettings
from laci_stereo.core.tracking.sighting import Sighting
from laci_stereo.core.tracking.tracks import Moving, Track, _cut, backwards, link_tracks
from tests.core.tracks import CROSSING, DRIVE, Traffic, sighting, track, traffic
from tests.simulated import Drive

RATES = pytest.mark.parametrize("rate_hz", [5.0, 10.0, 20.0])


def frames_of(*tracks: Track) -> list[list[Sighting]]:
    """All sightings of some tracks, frame by frame."""
    every = sorted((sighting for track in tracks for sighting in track.sightings), key=lambda one: one.stamp_s)
    return [list(frame) for _, frame in groupby(every, key=lambda one: one.stamp_s)]


def driven(drive: Drive, rate_hz: float, last_s: float = 5.0, jitter_m: float = 0.0, **of_each: object) -> Track:
    stamps = np.arange(0.0, last_s, 1.0 / rate_hz)
    noise = np.random.default_rng(0).uniform(-jitter_m, jitter_m, (len(stamps), 2))
    return track(stamps, drive.at(stamps)[0] + noise, **of_each)


def same(found: Track, true: Track) -> bool:
    return {id(sighting) for sighting in found.sightings} == {id(sighting) for sighting in true.sightings}


@RATES
def test_one_vehicle_is_one_track(rate_hz: float) -> None:
    true = driven(DRIVE, rate_hz, jitter_m=0.4)
    (found,) = link_tracks(frames_of(true))
    assert same(found, true)
    assert (np.diff(found.stamps_s) > 0).all()


@RATES
def test_a_vehicle_that_brakes_hard_is_one_track(rate_hz: float) -> None:
    true = driven(
        Drive((0.0, 0.0), 0.0, speeds=((0.0, 15.0), (1.0, 15.0), (2.7, 0.0), (3.2, 0.0), (4.2, 4.0))), rate_hz
    )
    (found,) = link_tracks(frames_of(true))
    assert same(found, true)


@RATES
def test_vehicles_that_meet_keep_their_own_tracks(rate_hz: float) -> None:
    east = driven(Drive((-20.0, 0.0), 0.0, speeds=((0.0, 8.0),)), rate_hz)
    west = driven(Drive((20.0, 3.5), 180.0, speeds=((0.0, 8.0),)), rate_hz)
    found = link_tracks(frames_of(east, west))
    assert len(found) == 2
    assert all(any(same(one, true) for one in found) for true in (east, west))


@pytest.mark.parametrize("rate_hz", [10.0, 20.0])
def test_vehicles_whose_paths_cross_keep_their_own_tracks(rate_hz: float) -> None:
    one = driven(Drive((-20.0, 0.0), 0.0, speeds=((0.0, 8.0),)), rate_hz)
    other = driven(Drive((0.0, -26.0), 90.0, speeds=((0.0, 8.0),)), rate_hz)
    found = link_tracks(frames_of(one, other))
    assert len(found) == 2
    assert all(any(same(track, true) for track in found) for true in (one, other))


@pytest.mark.parametrize("gap_s", [0.9, 1.8])
def test_what_appears_on_the_way_back_is_something_else(gap_s: float) -> None:
    gone = driven(Drive((0.0, 0.0), 180.0, speeds=((0.0, 3.6),)), 10.0, last_s=1.5)
    stamps = 1.4 + gap_s + 0.1 * np.arange(15)
    come = track(stamps, Drive((-7.0, -1.0), 0.0, speeds=((0.0, 3.0),)).at(stamps - stamps[0])[0])
    found = link_tracks(frames_of(gone, come))
    assert len(found) == 2
    assert all(any(same(one, true) for one in found) for true in (gone, come))


@RATES
def test_an_occlusion_of_half_a_second_is_bridged(rate_hz: float) -> None:
    true = driven(DRIVE, rate_hz)
    seen = Track(tuple(s for s in true.sightings if not 2.0 < s.stamp_s < 2.5))
    (found,) = link_tracks(frames_of(seen))
    assert same(found, seen)


@pytest.mark.parametrize("period_s", [0.999, 1.001, 1.7])
def test_however_seldom_frames_come_one_that_is_missing_is_bridged(period_s: float) -> None:
    true = driven(replace(DRIVE, speeds=((0.0, 2.0),)), 1.0 / period_s, last_s=20.0)
    seen = Track(tuple(one for number, one in enumerate(true.sightings) if number not in (4, 8)))
    (found,) = link_tracks(frames_of(seen))
    assert same(found, seen)


@pytest.mark.slow
def test_strays_that_nothing_links_cost_little_memory() -> None:
    """Foliage that is seen for a moment here and there, for an hour: what may follow what is looked at by places."""
    rng = np.random.default_rng(3)
    strays = [
        track(np.array([at_s]), rng.uniform(-60.0, 60.0, (1, 2)), count=6)
        for at_s in 0.1 * rng.integers(0, 36_000, 3000)
    ]
    true = driven(DRIVE, 10.0)
    tracemalloc.start()
    found = link_tracks(frames_of(true, *strays))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert same(found[0], true)
    assert peak < 60e6  # a table of all pairs has 72 MB, and there were three


@pytest.mark.slow
def test_memory_grows_with_a_tracks_length_and_not_with_its_square() -> None:
    """What waits at a light is one track for minutes."""
    peaks = []
    for last_s in (50.0, 200.0):
        frames = frames_of(driven(Drive((0.0, 20.0), 0.0, speeds=((0.0, 0.1),)), 20.0, last_s, jitter_m=0.05))
        tracemalloc.start()
        assert len(link_tracks(frames)) == 1
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 6 * peaks[0]  # four times as many sightings


def test_what_was_lost_for_too_long_is_another_track() -> None:
    true = driven(DRIVE, 10.0)
    seen = Track(tuple(s for s in true.sightings if not 2.0 < s.stamp_s < 3.5))
    assert len(link_tracks(frames_of(seen), TrackSettings(max_lost_s=1.0))) == 2
    assert len(link_tracks(frames_of(seen), TrackSettings(max_lost_s=2.0))) == 1


@RATES
def test_debris_does_not_take_the_vehicles_track(rate_hz: float) -> None:
    true = driven(DRIVE, rate_hz, jitter_m=0.3, count=600)
    rng = np.random.default_rng(1)
    debris = [
        sighting(s.stamp_s, s.middle + rng.uniform(-2.0, 2.0, 2), count=15, flaw="thin")
        for s in true.sightings
        if rng.random() < 0.4
    ]
    found = link_tracks(frames_of(true, Track(tuple(debris))))
    assert same(found[0], true)


@pytest.mark.parametrize("away", [(8.0, 6.0), (-12.0, 0.0), (0.0, 11.5)])
def test_what_stood_still_does_not_leap_onto_a_vehicle(away: tuple[float, float]) -> None:
    stamps = np.arange(0.0, 2.0, 0.1)
    shrub = track(stamps, np.tile(away, (len(stamps), 1)))
    true = driven(Drive((0.0, 0.0), 0.0), 10.0)
    late = Track(tuple(s for s in true.sightings if s.stamp_s > 2.7))
    moved = Track(tuple(sighting(s.stamp_s, s.middle - late.sightings[0].middle) for s in late.sightings))
    found = link_tracks(frames_of(shrub, moved))
    assert len(found) == 2
    assert all(any(same(one, true) for one in found) for true in (shrub, moved))


@RATES
@pytest.mark.parametrize("lost_s", [1.0, 1.8])
def test_a_long_occlusion_is_bridged(rate_hz: float, lost_s: float) -> None:
    true = driven(DRIVE, rate_hz, jitter_m=0.3)
    seen = Track(tuple(s for s in true.sightings if not 2.0 < s.stamp_s < 2.0 + lost_s))
    (found,) = link_tracks(frames_of(seen))
    assert same(found, seen)


@pytest.mark.parametrize("rate_hz", [25.0, 100.0])
def test_however_often_frames_come_a_long_occlusion_is_bridged(rate_hz: float) -> None:
    """Three sightings within a tenth of a second determine no velocity, but are no reason to cut a track either."""
    true = driven(DRIVE, rate_hz, jitter_m=0.3)
    seen = Track(tuple(s for s in true.sightings if not 2.0 < s.stamp_s < 3.5))
    (found,) = link_tracks(frames_of(seen))
    assert same(found, seen)


def test_the_velocity_at_a_tracks_beginning_is_as_well_known_at_any_frame_rate() -> None:
    sigmas_mps = []
    for rate_hz in (10.0, 100.0):
        begin = backwards(driven(DRIVE, rate_hz, jitter_m=0.3).sightings, TrackSettings())
        sigmas_mps.append(np.sqrt(begin.covariance[1, 1]))
    assert sigmas_mps[1] < sigmas_mps[0] < 2.0


@pytest.mark.slow
def test_a_track_may_be_cut_hundreds_of_times() -> None:
    """Each leap to and fro is shorter than the one before, so the strongest change is always near the beginning."""
    count = 480
    leap_m = np.linspace(20.0, 8.0, count) * (np.arange(count) // 4 % 2)
    seen = track(0.1 * np.arange(count), np.column_stack([leap_m, np.full(count, 10.0)]))
    moving = Moving(seen.sightings[0], TrackSettings())
    for one in seen.sightings[1:]:
        moving.add(one, TrackSettings())
    limit = sys.getrecursionlimit()
    sys.setrecursionlimit(len(inspect.stack(0)) + 60)
    try:
        pieces = _cut(moving, TrackSettings())
    finally:
        sys.setrecursionlimit(limit)
    assert len(pieces) > 100
    assert [id(one) for _, piece in pieces for one in piece.sightings] == [id(one) for one in seen.sightings]


@pytest.mark.slow
def test_a_long_track_of_frequent_frames_is_linked() -> None:
    (found,) = link_tracks(frames_of(driven(Drive((0.0, 20.0), 0.0, speeds=((0.0, 1.0),)), 100.0, 40.0, jitter_m=0.1)))
    assert len(found.sightings) == pytest.approx(4000, abs=1)


@pytest.mark.parametrize("off_m", [(-4.5, 1.0), (-4.0, -2.0), (4.5, 0.0), (1.0, 4.0)])
@pytest.mark.parametrize("lost", [2, 3])
def test_a_track_that_ended_with_something_else_goes_on(lost: int, off_m: tuple[float, float]) -> None:
    true = driven(Drive((-20.0, 0.0), 0.0, speeds=((0.0, 8.0),)), 3.3, jitter_m=0.2)
    shown = true.sightings[:8] + true.sightings[8 + lost :]
    # While something passes before it, only a piece of that is seen.
    there = true.sightings[7 + lost]
    stray = sighting(there.stamp_s, there.middle + off_m)
    found = {id(one) for one in link_tracks(frames_of(Track(shown), Track((stray,))))[0].sightings}
    assert id(stray) not in found
    # The piece may have taken the next sighting with it.
    assert len({id(one) for one in shown} - found) <= 1


@pytest.mark.parametrize("lost", [1, 2])
@pytest.mark.parametrize("apart_m", [3.0, 4.0])
@pytest.mark.parametrize(("up_mps", "down_mps"), [(2.0, 6.0), (3.0, 8.0), (5.0, 10.0)])
def test_two_that_met_in_one_sighting_are_not_exchanged(
    up_mps: float, down_mps: float, apart_m: float, lost: int
) -> None:
    stamps = np.arange(20) / 3.3
    met = 8
    late_s = stamps - stamps[met] - 0.3
    still = np.zeros_like(stamps)
    down = track(stamps, np.column_stack([still, -down_mps * late_s]), count=1500)
    up = track(stamps, np.column_stack([still + apart_m, up_mps * late_s]), count=700)
    frames = [[one, other] for one, other in zip(down.sightings, up.sightings, strict=True)]
    both = sighting(stamps[met], down.sightings[met].middle + np.array([2.5, 0.0]), count=2700)
    found = link_tracks([*frames[:met], [both], *frames[met + lost :]])
    ids = [{id(one) for one in true.sightings} for true in (down, up)]
    # One beside the meeting may be taken for the other's.
    assert all(min(sum(id(one) in its for one in each.sightings) for its in ids) <= 1 for each in found)


def test_what_comes_the_other_way_does_not_take_over_what_is_lost() -> None:
    east = driven(Drive((-20.0, 0.0), 0.0, speeds=((0.0, 12.0),)), 10.0, last_s=2.0)
    west = driven(Drive((33.0, 3.5), 180.0, speeds=((0.0, 12.0),)), 10.0)
    late = Track(tuple(s for s in west.sightings if s.stamp_s > 2.3))
    found = link_tracks(frames_of(east, late))
    assert len(found) == 2
    assert all(any(same(one, true) for one in found) for true in (east, late))


def test_points_of_a_radar_without_size_are_linked() -> None:
    ways = [Drive((-30.0, 5.0 * n), 0.0, speeds=((0.0, 8.0 + n),)) for n in range(6)]
    cars = [driven(way, 10.0, jitter_m=0.4, count=1, size=(0.0, 0.0)) for way in ways]
    cars = [replace_points(car) for car in cars]
    found = link_tracks(frames_of(*cars))
    assert len(found) == 6
    assert all(any(same(one, true) for one in found) for true in cars)


def replace_points(found: Track) -> Track:
    nothing = np.zeros((0, 3))
    return Track(tuple(replace(one, points=nothing) for one in found.sightings))


@pytest.mark.parametrize("seed", [0, *(pytest.param(each, marks=pytest.mark.slow) for each in (1, 2))])
def test_dense_traffic_with_missing_sightings(seed: int) -> None:
    scene = traffic(seed, CROSSING)
    found = link_tracks(scene.frames)
    owners = [[scene.owner[id(one)] for one in part.sightings] for part in found]
    pure = [max(map(of.count, set(of))) for of in owners]
    assert sum(pure) >= 0.99 * sum(map(len, owners))
    whole = [max(of.count(number) for of in owners) / n for number, n in seen_of(scene).items() if n >= 20]
    assert np.mean(np.array(whole) > 0.9) > 0.8


def seen_of(scene: Traffic) -> Counter[int]:
    return Counter(scene.owner[id(one)] for frame in scene.frames for one in frame)


def test_the_longest_comes_first() -> None:
    short = driven(Drive((-20.0, 0.0), 0.0), 10.0, last_s=1.0)
    long = driven(Drive((20.0, 30.0), 180.0), 10.0)
    found = link_tracks(frames_of(short, long))
    assert [len(one.sightings) for one in found] == [50, 10]


def test_nothing_seen() -> None:
    assert link_tracks([]) == []
    assert link_tracks([[], []]) == []


def test_frames_are_consumed_as_a_stream() -> None:
    true = driven(DRIVE, 10.0)
    (found,) = link_tracks(iter(frames_of(true)))
    assert same(found, true)


def test_only_sightings_without_a_flaw_are_usable() -> None:
    flaws = ["cut", None, None, "far", "thin", "thin"]
    found = Track(tuple(sighting(float(i), np.array([i, 0.0]), flaw=flaw) for i, flaw in enumerate(flaws)))  # type: ignore[arg-type]
    assert found.stamps_s.tolist() == [1.0, 2.0]
    assert found.centres.tolist() == [[1.0, 0.0], [2.0, 0.0]]
    assert found.flaws() == {"cut": 1, "far": 1, "thin": 2}
    assert Track(()).centres.shape == (0, 2)


def test_joining() -> None:
    whole = driven(DRIVE, 10.0)
    even, odd = Track(whole.sightings[::2]), Track(whole.sightings[1::2])
    assert even.joined(odd) == odd.joined(even) == whole
    beside = Track(tuple(replace(one, middle=one.middle + 1.0) for one in whole.sightings))
    assert even.joined(beside) == Track(tuple(
        mine if index % 2 == 0 else other
        for index, (mine, other) in enumerate(zip(whole.sightings, beside.sightings, strict=True))
    ))  # fmt: skip


def test_what_was_seen_at_some_times_is_left_out() -> None:
    whole = driven(DRIVE, 10.0)
    stamps = [one.stamp_s for one in whole.sightings]
    begin_s, end_s = stamps[2], stamps[5]
    assert whole.without(((begin_s, end_s),)) == Track(whole.sightings[:2] + whole.sightings[5:])
    assert whole.without(()) == whole
