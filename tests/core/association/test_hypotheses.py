from __future__ import annotations

import math
import re
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from laci_stereo.core.association.choice import Choice, Likeness, Resemblance
from laci_stereo.core.association.hypotheses import choose_track
from laci_stereo.core.errors import MatchError, TrackError
from laci_stereo.core.frames import wrap
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.tracking.tracks import Track, link_tracks
from tests.core.tracks import (
    CROSSING,
    DRIVE,
    STAMPS,
    STRAIGHT_ROAD,
    TRUTH,
    Traffic,
    seen,
    sighting,
    track,
    traffic,
    vehicle,
)
from tests.simulated import Drive

UNKNOWN_CLOCK = MatchSettings(clock_sigma_s=1.0)

angles = st.floats(-np.pi, np.pi)
shifts = st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)).map(np.array)
motions = st.builds(PlanarMatch, angles, shifts)


def shifted(drive: Drive, x: float, y: float, later_s: float = 0.0) -> Drive:
    return replace(drive, start=(drive.start[0] + x, drive.start[1] + y), start_s=drive.start_s + later_s)


@pytest.mark.parametrize("period_s", [0.999, 1.001, 1.4])
def test_frames_may_come_seldom(period_s: float) -> None:
    slow = replace(DRIVE, speeds=((0.0, 2.5),))
    stamps_s = np.arange(0.0, 20.0, period_s)
    choice = choose_track([track(stamps_s, slow.at(stamps_s)[0])], {42: vehicle(slow, last_s=20.0)})
    assert len(choice.track.usable) == len(stamps_s)


def test_what_drives_long_after_a_sender_was_heard_is_not_sought_at_every_centimetre() -> None:
    """Where nothing was sent nobody knows how fast it was: the clocks' offsets to try do not depend on it."""
    heard = vehicle(DRIVE, last_s=7.97)  # the table's last step is beyond the last message
    later_s = 300.0 + STAMPS
    tracks = [seen(), track(later_s, DRIVE.at(STAMPS)[0])]
    tracemalloc.start()
    choice = choose_track(tracks, {42: heard}, UNKNOWN_CLOCK)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert choice.track is tracks[0]
    assert peak < 30e6


def test_the_senders_track_is_found_among_others() -> None:
    tracks = [
        seen(replace(DRIVE, legs=((15.0, 0.0), (16.0, -90.0)))),
        seen(shifted(DRIVE, 10.0, 3.0, later_s=1.5)),
        seen(),
        seen(Drive((0.0, 0.0), 10.0, speeds=((0.0, 1.4),))),
        seen(Drive((5.0, 5.0), 0.0, speeds=((0.0, 0.0),))),
    ]
    choice = choose_track(tracks, {42: vehicle()})
    assert choice.station == 42
    assert choice.track is tracks[2]
    assert 0.95 * len(STAMPS) < choice.explained <= len(STAMPS)
    assert choice.second < 0.8 * choice.explained


@pytest.mark.slow
@given(motions, st.integers(0, 100))
@settings(max_examples=20, deadline=None)
def test_the_choice_does_not_depend_on_where_the_sensor_stands(motion: PlanarMatch, seed: int) -> None:
    drives = (replace(DRIVE, legs=((15.0, 0.0), (16.0, -60.0))), DRIVE)
    tracks = [seen(drive, seed=seed) for drive in drives]
    moved = [seen(drive, seed=seed, sensor=motion) for drive in drives]
    before, after = choose_track(tracks, {42: vehicle()}), choose_track(moved, {42: vehicle()})
    assert before.track is tracks[1]
    assert after.track is moved[1]
    assert after.explained == pytest.approx(before.explained, abs=1e-6)


def test_the_sender_is_found_among_the_stations() -> None:
    vehicles = {
        7: vehicle(replace(DRIVE, legs=((15.0, 0.0), (16.0, -90.0)))),
        42: vehicle(),
        9: vehicle(Drive((0.0, 0.0), 0.0, speeds=((0.0, 0.0),))),
    }
    assert choose_track([seen()], vehicles).station == 42


def test_fragments_of_one_drive_are_joined() -> None:
    whole = seen()
    first, second = Track(whole.sightings[:25]), Track(whole.sightings[32:])
    choice = choose_track([second, seen(Drive((5.0, 5.0), 0.0, speeds=((0.0, 0.0),))), first], {42: vehicle()})
    assert choice.track == Track(first.sightings + second.sightings)


def test_a_vehicle_whose_parts_of_the_drive_contradict_each_other_is_refused() -> None:
    """Its positions are of the rear axle and taken for those of its front: in a turn the error turns with it."""
    right = vehicle()
    ahead = np.column_stack([np.cos(right.yaw_rad), np.sin(right.yaw_rad)])
    wrong = replace(right, xy=right.xy - 3.6 * ahead)
    whole = seen()
    first, second = Track(whole.sightings[:26]), Track(whole.sightings[33:])
    for tracks in ([first, second], [second, first]):
        with pytest.raises(MatchError, match=r"seen in (27|26) frames, and in (26|27) frames right before or after"):
            choose_track(tracks, {42: wrong})


def test_what_comes_from_another_object_is_not_joined() -> None:
    whole = seen()
    first = Track(whole.sightings[:40])
    stranger = seen(Drive((-20.0, 10.0), -60.0, speeds=((0.0, 8.0),)), STAMPS[45:])
    assert choose_track([first, stranger], {42: vehicle()}).track is first


def test_another_part_of_the_same_vehicle_is_no_rival() -> None:
    whole = seen()
    part = track(STAMPS[5:], whole.centres[5:] + np.array([0.4, -0.6]))
    choice = choose_track([part, whole], {42: vehicle()})
    assert choice.track is whole
    assert choice.second == 0.0


def test_a_car_that_is_seen_as_one_with_its_trailer_now_and_then() -> None:
    braking = replace(STEADY, speeds=((0.0, 8.0), (2.0, 8.0), (4.0, 1.0)))
    as_one = np.random.default_rng(0).random(len(STAMPS)) < 0.45
    car = seen(braking, STAMPS[~as_one])
    trailer = seen(shifted(braking, -4.2, 0.0), STAMPS[~as_one], noise_m=0.02, size=(2.0, 1.6))
    both = seen(shifted(braking, -1.5, 0.0), STAMPS[as_one], size=(7.4, 1.8))
    # By their ways alone either may be the sender.
    with pytest.raises(MatchError, match=r"two moving objects, seen in 3\d and 3\d frames"):
        choose_track([trailer, both, car], {42: vehicle(braking)})
    assert choose_track([both, car], {42: vehicle(braking)}).track is car


def test_two_vehicles_that_drive_alike_are_a_tie() -> None:
    straight = Drive((0.0, 0.0), 0.0, speeds=((0.0, 10.0),))
    tracks = [seen(straight), seen(shifted(straight, -15.0, 0.0))]
    with pytest.raises(MatchError, match="two moving objects, seen in 60 and 60 frames, fit equally well"):
        choose_track(tracks, {42: vehicle(straight)})


def test_two_stations_of_one_vehicle_are_a_tie() -> None:
    with pytest.raises(MatchError, match=r"stations 7 and 8 fit equally well.*name the sender's station"):
        choose_track([seen()], {7: vehicle(), 8: vehicle()})


def test_two_senders_that_agree_are_no_tie() -> None:
    behind = replace(DRIVE, start_s=2.0)
    tracks = [seen(), seen(behind, seed=1)]
    choice = choose_track(tracks, {7: vehicle(behind), 42: vehicle()})
    assert choice.track is tracks[0 if choice.station == 42 else 1]


def test_two_senders_that_agree_by_their_outlines_are_no_tie() -> None:
    # Of the second one's boxes the centres are off by more than a vehicle's width, by its own outline it is not.
    behind, way_off = replace(DRIVE, start_s=2.0), PlanarMatch(TRUTH.yaw_rad, TRUTH.shift - np.array([3.0, 0.0]))
    tracks = [seen(), seen(behind, sensor=way_off, seed=1)]
    vehicles = {7: vehicle(behind), 42: vehicle()}
    with pytest.raises(MatchError, match=r"stations .* fit equally well.*a clock may be off"):
        choose_track(tracks, vehicles, likeness=exactly)

    def outlines(*_: object) -> Resemblance:
        return replace(exactly(), fit=TRUTH)

    choice = choose_track(tracks, vehicles, likeness=outlines)
    assert choice.track is tracks[0 if choice.station == 42 else 1]


def test_nothing_that_moves_fits() -> None:
    turns_back = seen(replace(DRIVE, legs=((5.0, 0.0), (12.0, -180.0))))
    with pytest.raises(MatchError, match=r"no moving object fits the CAMs: \d+% .* of the best of 1 explained"):
        choose_track([turns_back], {42: vehicle()})


def test_what_swerves_about_the_way_does_not_fit_it() -> None:
    driven = seen()
    aside = np.column_stack([np.zeros(len(driven.centres)), 1.5 * np.sin(np.arange(len(driven.centres)) / 4)])
    swerving = track(driven.stamps_s, driven.centres + aside)
    with pytest.raises(MatchError, match=r"[5-9]\d% .* explained, [2-9]\.\d sigma off .* are 50%, within 2 sigma"):
        choose_track([swerving], {42: vehicle()})


def test_a_sender_that_stands_still() -> None:
    parked = Drive((5.0, 5.0), 0.0, speeds=((0.0, 0.0),))
    with pytest.raises(TrackError, match=r"the vehicle of station 42 stands still, or hardly moves: 0\.00 m in the \d"):
        choose_track([seen()], {42: vehicle(parked)})


def test_nothing_found_says_what_was_seen() -> None:
    few = seen(stamps=STAMPS[:9])
    cut = Track(tuple(replace(one, flaw="cut") for one in seen(stamps=STAMPS[10:25]).sightings))
    message = r"2 moving objects, the longest seen in 9 frames, .* moving 6\.\d m \(left out: 15 cut\)"
    with pytest.raises(TrackError, match=message):
        choose_track([few, cut], {42: vehicle()})
    with pytest.raises(TrackError, match=r"no vehicle was found: 0 moving objects.*left out: none"):
        choose_track([], {42: vehicle()})


def test_frames_at_which_the_sender_was_silent_do_not_count() -> None:
    told = vehicle()
    early = told.stamps_s < 2.0
    brief = VehicleTrack(told.stamps_s[early], 0, told.xy[early], told.yaw_rad[early], 4.4, 1.8)
    assert choose_track([seen()], {42: brief}).explained <= 21
    with pytest.raises(TrackError, match="while its CAMs report its position"):
        choose_track([seen(stamps=STAMPS[30:])], {42: brief})


def test_a_few_wrong_frames_do_not_matter() -> None:
    right = seen()
    wrong = Track(
        tuple(
            sighting(one.stamp_s, one.box.centre + np.array([6.0, 8.0])) if 20 <= i < 26 else one
            for i, one in enumerate(right.sightings)
        )
    )
    choice = choose_track([wrong], {42: vehicle()})
    assert choice.explained == pytest.approx(len(STAMPS) - 6, abs=3.0)


# the motion and the clock


@pytest.mark.parametrize("offset_s", [-0.3, -0.02, 0.0, 0.15, 0.3])
def test_the_motion_and_the_clock_are_recovered(offset_s: float) -> None:
    told = vehicle()
    late = replace(told, stamps_s=told.stamps_s + offset_s)
    slows = replace(DRIVE, speeds=((0.0, 9.0), (2.0, 9.0), (4.0, 5.0)))
    slow = vehicle(slows)
    for drive, sent in ((DRIVE, late), (slows, replace(slow, stamps_s=slow.stamps_s + offset_s))):
        choice = choose_track([seen(drive, noise_m=0.05)], {42: sent}, UNKNOWN_CLOCK)
        assert choice.time_offset_s == pytest.approx(offset_s, abs=0.03)
        assert abs(float(wrap(choice.fit.yaw_rad - TRUTH.yaw_rad))) < 0.01
        assert choice.fit(choice.track.centres) == pytest.approx(TRUTH(choice.track.centres), abs=0.3)


def test_a_clock_that_is_known_is_not_moved_to_fit() -> None:
    told = vehicle()
    late = replace(told, stamps_s=told.stamps_s + 0.3)
    whatever = MatchSettings(least_log_odds=-math.inf)  # boxes alone leave room for chance here
    assert abs(choose_track([seen()], {42: late}, whatever).time_offset_s) <= 0.03


def test_near_sides_alone_do_not_move_the_motion() -> None:
    # Only the rear of the car is seen: half of its length is lacking, away from the sensor.
    drive = Drive((10.0, 0.0), 0.0, ((20.0, 0.0), (10.0, 30.0)), speeds=((0.0, 8.0), (3.0, 5.0)))
    xy, yaw = drive.at(STAMPS)
    rear = xy - 2.0 * np.column_stack([np.cos(yaw), np.sin(yaw)])
    boxes = [
        sighting(float(t), at, size=(1.8, 0.4), yaw_rad=float(turn) + np.pi / 2)
        for t, at, turn in zip(STAMPS, rear, yaw, strict=True)
    ]
    told = vehicle(drive)
    choice = choose_track([Track(tuple(boxes))], {42: told})
    assert np.median(np.linalg.norm(choice.fit(xy) - xy, axis=1)) < 0.4
    assert np.linalg.norm(choice.fit(rear) - xy, axis=1).min() > 1.5


# what tells one from another


STEADY = Drive((0.0, 0.0), 0.0, speeds=((0.0, 10.0),))


@pytest.mark.parametrize("settings", [MatchSettings(), UNKNOWN_CLOCK])
@pytest.mark.parametrize("behind_m", [12.0, 25.0])
def test_a_follower_at_constant_distance_is_a_tie(settings: MatchSettings, behind_m: float) -> None:
    tracks = [seen(STEADY), seen(shifted(STEADY, -behind_m, 0.0), seed=1)]
    with pytest.raises(MatchError, match=r"two moving objects, .* fit equally well"):
        choose_track(tracks, {42: vehicle(STEADY)}, settings)


def test_a_follower_that_sends_too_breaks_the_tie() -> None:
    follower = shifted(STEADY, -12.0, 0.0)
    tracks = [seen(STEADY), seen(follower, seed=1)]
    with pytest.raises(MatchError, match="fit equally well"):
        choose_track(tracks, {42: vehicle(STEADY)})
    choice = choose_track(tracks, {42: vehicle(STEADY), 43: vehicle(follower)})
    assert choice.track is tracks[0 if choice.station == 42 else 1]
    assert choice.fit(tracks[0].centres) == pytest.approx(TRUTH(tracks[0].centres), abs=0.5)


def test_a_piece_of_another_car_fits_but_does_not_rival() -> None:
    # A second of anything fits; but then the sender would be in view before and after it, and is not.
    drive = replace(DRIVE, speeds=((0.0, 10.0), (2.5, 8.0), (5.0, 10.0)))
    whole = seen(drive)
    piece = Track(seen(shifted(STEADY, 5.0, -20.0), seed=1).sightings[20:34])
    choice = choose_track([piece, whole], {42: vehicle(drive)})
    assert choice.track is whole
    assert choice.log_likelihood_margin > math.log(100.0)


def radar(drive: Drive, radial: bool, seed: int) -> Track:
    """Points with a noise of 1 m and, if so, their radial speed; the radar stands at the origin."""
    rng = np.random.default_rng(seed)
    stamps = np.arange(0.0, 4.0, 0.1)
    xy = drive.at(stamps)[0]
    distance = np.linalg.norm(np.stack([drive.at(stamps + step)[0] for step in (-0.05, 0.05)]), axis=2)
    speeds = (distance[1] - distance[0]) / 0.1
    noisy = xy + rng.normal(0.0, 1.0, xy.shape)
    return Track(
        tuple(
            sighting(float(t), at, 1, size=(0.0, 0.0), sigma_m=1.0, radial_mps=float(speed) if radial else None)
            for t, at, speed in zip(stamps, noisy, speeds, strict=True)
        )
    )


@pytest.mark.parametrize("seed", range(4))
def test_radial_speeds_decide(seed: int) -> None:
    drive, other = (Drive((10.0, y), 0.0, speeds=((0.0, speed),)) for y, speed in ((4.0, 12.0), (8.0, 13.0)))
    tracks = [radar(other, True, seed), radar(drive, True, seed + 10)]
    choice = choose_track(tracks, {42: vehicle(drive, 4.0)})
    assert choice.track is tracks[1]
    # Points alone are a tie, or nearly one.
    settings = MatchSettings(clear_log_odds=0.0, least_log_odds=0.0)
    points = choose_track(
        [radar(other, False, seed), radar(drive, False, seed + 10)], {42: vehicle(drive, 4.0)}, settings
    )
    assert points.log_likelihood_margin < choice.log_likelihood_margin - 3.0


def test_a_lorry_is_not_the_car() -> None:
    lorry = seen(shifted(STEADY, -40.0, 4.0), size=(12.0, 2.5))
    car = seen(STEADY, seed=1)
    choice = choose_track([lorry, car], {42: vehicle(STEADY)})
    assert choice.track is car


def test_fragments_are_joined_under_an_unknown_clock() -> None:
    told = vehicle()
    late = replace(told, stamps_s=told.stamps_s + 0.25)
    whole = seen()
    parts = [Track(whole.sightings[first:last]) for first, last in ((0, 15), (22, 38), (40, 60))]
    choice = choose_track(parts, {42: late}, UNKNOWN_CLOCK)
    assert choice.track == parts[0].joined(parts[1]).joined(parts[2])


def test_a_station_that_was_never_seen_is_named() -> None:
    turns_back = seen(replace(DRIVE, legs=((5.0, 0.0), (12.0, -180.0))))
    with pytest.raises(MatchError, match="not seen: station 42"):
        choose_track([turns_back], {42: vehicle()})


def test_the_second_best_is_said_in_words() -> None:
    tracks = [seen(shifted(replace(DRIVE, legs=((15.0, 0.0), (16.0, 80.0))), -60.0, 0.0)), seen()]
    assert choose_track([tracks[1]], {42: vehicle()}).second_is == "nothing else"
    choice = choose_track(tracks, {42: vehicle()})
    assert choice.second_is == "another moving object, seen in 60 frames"
    assert math.isfinite(choice.log_likelihood_margin)


def better_for(vehicle: VehicleTrack) -> Likeness:
    def likeness(_track: Track, of: VehicleTrack, *_: object) -> Resemblance:
        return Resemblance(0.0, 8.0 if of is vehicle else 2.0)

    return likeness


BACK_AND_FORTH = Drive(
    (5.0, 0.0), 20.0, speeds=((0.0, 4.0), (2.0, 0.0), (3.0, -3.0), (4.5, -3.0), (5.0, 0.0), (6.0, 4.0))
)
ROUND = Drive((0.0, 0.0), 0.0, ((200.0, 955.0),), ((0.0, 7.0),))
"""Round and round, on a circle of 12 m."""


def test_a_vehicle_that_reverses_is_found_by_its_path() -> None:
    right = seen(BACK_AND_FORTH, noise_m=0.05)
    settings = MatchSettings(min_path_m=10.0)
    assert np.linalg.norm(np.ptp(right.centres, axis=0)) < settings.min_path_m
    assert choose_track([right, seen(STEADY, seed=1)], {42: vehicle(BACK_AND_FORTH)}, settings).track is right


def test_a_vehicle_that_hardly_moves_while_it_is_seen() -> None:
    brief = seen(DRIVE, STAMPS[:10], noise_m=0.05)
    with pytest.raises(
        TrackError, match=r"the vehicle of station 42 moves \d\.\d m while it is seen; needed are 10\.0 m"
    ):
        choose_track([brief], {42: vehicle()}, MatchSettings(least_log_odds=-math.inf, min_path_m=10.0))


def test_a_lorry_that_is_only_seen_to_stand_is_told_that_it_articulates() -> None:
    # It turns while nothing is seen of it, and drives on until its trailer is straight again.
    speeds = ((0.0, 0.2), (1.0, 0.2), (2.0, 15.0), (7.0, 15.0), (8.0, 0.2), (10.0, 0.2))
    bend = Drive((0.0, 0.0), 0.0, ((5.0, 0.0), (12.0, 70.0)), speeds)
    stamps = np.arange(0.0, 9.5, 0.1)
    before, after = (seen(bend, part, noise_m=0.05) for part in (stamps[stamps < 1.0], stamps[stamps > 8.0]))
    permissive = MatchSettings(least_log_odds=-math.inf, least_seen_log_odds=-math.inf, min_frames=5)
    reason = r"moves 0\.\d m while it is seen; .*; station 42's, 15\.6 m long, articulates in bends"
    with pytest.raises(TrackError, match=reason):
        choose_track([before.joined(after)], {42: vehicle(bend, size=(15.6, 2.5))}, permissive)


def test_what_stands_where_a_vehicle_came_from_and_where_it_went_is_not_the_vehicle() -> None:
    # A bus leaves after two seconds and is there four seconds later; meanwhile nothing of it is seen.
    leaving = Drive((0.0, 0.0), 0.0, speeds=((0.0, 0.2), (2.0, 0.2), (3.0, 10.0), (5.0, 10.0), (6.0, 0.2), (8.0, 0.2)))
    stamps = np.arange(0.0, 8.0, 0.1)
    bus = vehicle(leaving, 9.0, (12.0, 2.5))
    before, after = (seen(leaving, part, noise_m=0.05) for part in (stamps[stamps < 2.0], stamps[stamps > 6.0]))
    permissive = MatchSettings(least_log_odds=-math.inf, least_seen_log_odds=-math.inf, min_frames=5)
    with pytest.raises(TrackError, match=r"moves 0\.0 m while it is seen; needed are 5\.0 m"):
        choose_track([before.joined(after)], {42: bus}, permissive)
    assert choose_track([seen(leaving, stamps, noise_m=0.05)], {42: bus}, permissive).station == 42
    # Nor does it stand in the way of another station's, however well it fits.
    elsewhere = PlanarMatch(TRUTH.yaw_rad + 1.0, TRUTH.shift + 40.0)
    before, after = (
        seen(leaving, part, 0.05, sensor=elsewhere) for part in (stamps[stamps < 2.0], stamps[stamps > 6.0])
    )
    tracks = [before.joined(after), seen(STEADY, STAMPS[:30], seed=1)]
    other = {42: bus, 7: vehicle(STEADY)}
    assert choose_track(tracks, other, permissive, likeness=better_for(bus)).station == 7


def test_whoever_rounds_the_same_circle_may_be_anyone() -> None:
    # Two seconds later it is elsewhere on the circle, which the motion takes up.
    other = seen(replace(ROUND, start_s=2.0), STAMPS[25:])
    permissive = MatchSettings(least_log_odds=0.0)
    doubt = choose_track([other], {42: vehicle(ROUND)}, permissive).by_chance
    assert "by chance" in doubt
    assert doubt.endswith("record a longer drive, or one with less traffic")


def test_a_drive_of_its_own_leaves_no_doubt() -> None:
    slows = replace(DRIVE, speeds=((0.0, 9.0), (2.0, 9.0), (4.0, 5.0)))
    choice = choose_track([seen(slows), seen(STEADY, seed=1)], {42: vehicle(slows)})
    assert choice.by_chance == ""
    assert misplaced_m(choice) < 0.5


def exactly(*_: object) -> Resemblance:
    """An outline that follows the way as only one stranger in 3000 does."""
    return Resemblance(0.0, 8.0)


def test_an_outline_on_the_way_leaves_no_doubt_of_a_short_drive() -> None:
    brief = seen(DRIVE, STAMPS[:20], noise_m=0.05)
    doubt = choose_track([brief], {42: vehicle()}).by_chance
    assert "by chance" in doubt
    assert doubt.endswith("record a longer drive, or one with a turn")
    assert choose_track([brief], {42: vehicle()}, likeness=exactly).by_chance == ""


@pytest.mark.slow
def test_what_is_taken_with_a_doubt_is_rather_the_vehicle_than_a_stranger() -> None:
    refused, odds = 0, []
    for way in np.arange(-6.0, 8.0, 0.25):
        try:
            choice = choose_track(
                [seen(DRIVE, STAMPS[:20], noise_m=0.05)],
                {42: vehicle()},
                likeness=lambda *_, way=way: Resemblance(0.0, float(way)),
            )
        except MatchError:
            refused += 1
        else:
            told = re.search(r"odds of ([\d.]+) to 1 that it is its vehicle", choice.by_chance)
            odds += [float(told[1])] if told else []
    assert refused > 0
    assert len(odds) > 3
    assert min(odds) >= 1.0


@pytest.mark.slow
def test_outlines_decide_between_many_that_boxes_do_not() -> None:
    tracks = [
        seen(DRIVE, STAMPS[:20], noise_m=0.2, seed=seed, sensor=PlanarMatch(seed, TRUTH.shift)) for seed in range(7)
    ]
    with pytest.raises(MatchError, match="fit equally well"):
        choose_track(tracks, {42: vehicle()})
    for right in tracks:

        def outline(one: Track, *_: object, right: Track = right) -> Resemblance:
            return exactly() if one is right else Resemblance(0.0, -4.0)

        assert choose_track(tracks, {42: vehicle()}, likeness=outline).track is right


def test_an_outline_on_another_way_speaks_against_it() -> None:
    brief = seen(DRIVE, STAMPS[:20], noise_m=0.05)

    def elsewhere(*_: object) -> Resemblance:
        return Resemblance(0.0, -4.0)

    with pytest.raises(MatchError, match="by chance"):
        choose_track([brief], {42: vehicle()}, likeness=elsewhere)
    # Whoever asks for a road only, on which strangers drive too, gets the track all the same.
    whoever = MatchSettings(least_seen_log_odds=-math.inf)
    assert choose_track([brief], {42: vehicle()}, whoever, likeness=elsewhere).track is brief


def test_pieces_among_clutter_tell_no_more_than_that_something_is_there() -> None:
    brief = seen(DRIVE, STAMPS[:20], noise_m=0.05)
    pieces = [Track(brief.sightings[start : start + 10]) for start in (0, 10)]
    around = brief.centres.mean(axis=0)
    standing = [
        track(STAMPS[:20], np.tile(around + np.array([x, y]), (20, 1)))
        for x in np.arange(-8.0, 8.5, 0.7)
        for y in np.arange(-8.0, 8.5, 0.7)
    ]
    assert choose_track([brief, *standing], {42: vehicle()}, likeness=exactly).by_chance == ""
    assert "by chance" in choose_track([*pieces, *standing], {42: vehicle()}, likeness=exactly).by_chance


def test_however_exactly_a_follower_fits_it_is_a_tie() -> None:
    drive, behind = seen(STEADY), seen(shifted(STEADY, -20.0, 0.0), seed=1)
    with pytest.raises(MatchError, match="fit equally well"):
        choose_track([drive, behind], {42: vehicle(STEADY)}, likeness=exactly)

    # What is seen a little worse is no less the sender's.
    def better(one: Track, *_: object) -> Resemblance:
        return Resemblance(0.0, 12.0 if one is drive else 8.0)

    with pytest.raises(MatchError, match="fit equally well"):
        choose_track([drive, behind], {42: vehicle(STEADY)}, likeness=better)


# live traffic


def chosen(scene: Traffic, senders: list[int], offset_s: float, settings: MatchSettings) -> Choice | None:
    sent = {number: scene.cars[number].sends(offset_s, seed=number) for number in senders}
    try:
        return choose_track(link_tracks(scene.frames), sent, settings)
    except MatchError:
        return None


def misplaced_m(choice: Choice) -> float:
    """By how much the vehicle is misplaced where it was seen."""
    return float(np.linalg.norm(choice.fit(choice.track.centres) - TRUTH(choice.track.centres), axis=1).mean())


def passing(scene: Traffic, seed: int, count: int) -> list[int]:
    """Some of the cars that pass the sensor in the middle of the recording."""
    nearest = [car.stamps_s[np.argmin(np.linalg.norm(car.xy - [0.0, 18.0], axis=1))] for car in scene.cars]
    inside = [number for number, stamp_s in enumerate(nearest) if 5.0 < stamp_s < scene.last_s - 5.0]
    return np.random.default_rng(seed).choice(inside, count, replace=False).tolist()


@pytest.mark.slow
@pytest.mark.parametrize("settings", [MatchSettings(), UNKNOWN_CLOCK])
@pytest.mark.parametrize("senders", [1, 3])
def test_thirty_vehicles_at_a_crossing(senders: int, settings: MatchSettings) -> None:
    right = 0
    for seed in range(3):
        scene = traffic(seed, CROSSING)
        offset_s = settings.clock_sigma_s * np.random.default_rng(seed).uniform(-0.3, 0.3)
        choice = chosen(scene, passing(scene, seed, senders), offset_s, settings)
        if choice is not None:
            assert misplaced_m(choice) < 2.0
            right += 1
    assert right >= 1


@pytest.mark.slow
@pytest.mark.parametrize(("senders", "needed"), [(1, 0), (3, 2)])
def test_thirty_vehicles_on_a_straight_road(senders: int, needed: int) -> None:
    # One sender among cars of nearly its speed is often undecided, but never wrong unsaid; three tell each other apart.
    right = 0
    for seed in range(3):
        scene = traffic(seed, STRAIGHT_ROAD)
        choice = chosen(scene, passing(scene, seed, senders), 0.0, MatchSettings())
        if choice is not None:
            assert misplaced_m(choice) < 1.0 or choice.by_chance
            right += misplaced_m(choice) < 1.0
    assert right >= needed


def test_a_sender_that_only_its_own_motion_shows_is_seen_as_well() -> None:
    """Both clocks are off, so that by boxes they are apart; by outlines they are by less than a vehicle's width."""
    straight = Drive((20.0, 22.0), -90.0, speeds=((0.0, 8.0),))
    senders = {42: vehicle(), 43: vehicle(straight)}
    late = {station: replace(one, stamps_s=one.stamps_s + 0.2) for station, one in senders.items()}
    tracks = [seen(), seen(straight, seed=1)]

    def outlines(_track: Track, station: int, *_: object) -> Resemblance:
        aside = np.array([0.6, 0.0]) if station == 43 else np.zeros(2)
        return Resemblance(0.0, 8.0, fit=PlanarMatch(TRUTH.yaw_rad, TRUTH.shift + aside))

    choice = choose_track(tracks, late, likeness=outlines)
    (other,) = choice.others
    assert {choice.station, other.station} == {42, 43}
    assert (other.track, other.late_s) == (tracks[other.station - 42], 0.0)
    # Of what may be a stranger's nothing is said.
    by_chance = choose_track(tracks, late, MatchSettings(clear_log_odds=20.0), outlines)
    assert by_chance.others == ()


def test_one_that_only_another_clock_shows_is_as_late_as_its_own_motion_is() -> None:
    straight = Drive((20.0, 22.0), -90.0, speeds=((0.0, 8.0),))
    turns = vehicle()
    senders = {42: replace(turns, stamps_s=turns.stamps_s + 0.3), 43: vehicle(straight)}
    choice = choose_track([seen(), seen(straight, seed=1)], senders, UNKNOWN_CLOCK, exactly_there)
    (other,) = choice.others
    late_s = other.late_s if other.station == 42 else -other.late_s
    assert late_s == pytest.approx(0.3, abs=0.1)


def exactly_there(*_: object) -> Resemblance:
    return Resemblance(0.0, 8.0, fit=TRUTH)
