from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from laci_stereo.core.cam import VehicleTrack
from laci_stereo.core.errors import MatchError, TrackError
from laci_stereo.core.frames import FloatArray, rotate_xy, wrap
from laci_stereo.core.matching import PlanarMatch, choose_track, match_track
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.tracking import Track
from tests.core.tracks import DRIVE, sighting, track, vehicle
from tests.simulated import Drive

STAMPS = np.arange(0.0, 6.0, 0.1)
TRUTH = PlanarMatch(2.3, np.array([40.0, -7.0]))

angles = st.floats(-np.pi, np.pi)
shifts = st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)).map(np.array)
motions = st.builds(PlanarMatch, angles, shifts)


def undone(motion: PlanarMatch, xy: FloatArray) -> FloatArray:
    return rotate_xy(-motion.yaw_rad, xy - motion.shift)


def seen(
    drive: Drive = DRIVE, stamps: FloatArray = STAMPS, noise_m: float = 0.1, seed: int = 0, **of_each: object
) -> Track:
    """What a sensor sees of a drive whose pose is `TRUTH`."""
    noise = np.random.default_rng(seed).normal(0.0, noise_m, (len(stamps), 2))
    return track(stamps, undone(TRUTH, drive.at(stamps)[0]) + noise, **of_each)


def shifted(drive: Drive, x: float, y: float, later_s: float = 0.0) -> Drive:
    return replace(drive, start=(drive.start[0] + x, drive.start[1] + y), start_s=drive.start_s + later_s)


# match_track


@given(motions)
def test_a_rigid_motion_is_recovered(motion: PlanarMatch) -> None:
    level = DRIVE.at(STAMPS)[0]
    found = match_track(level, motion(level))
    assert abs(float(wrap(found.yaw_rad - motion.yaw_rad))) < 1e-9
    assert found(level) == pytest.approx(motion(level), abs=1e-6)


@given(motions, motions, st.integers(0, 1000))
@settings(max_examples=50)
def test_equivariance(of_level: PlanarMatch, of_world: PlanarMatch, seed: int) -> None:
    level = DRIVE.at(STAMPS)[0]
    world = TRUTH(level) + np.random.default_rng(seed).normal(0.0, 0.5, level.shape)
    found = match_track(level, world)
    moved = match_track(of_level(level), of_world(world))
    assert moved(of_level(level)) == pytest.approx(of_world(found(level)), abs=1e-6)
    assert abs(float(wrap(moved.yaw_rad - found.yaw_rad - of_world.yaw_rad + of_level.yaw_rad))) < 1e-9


def test_the_yaw_is_the_circular_mean_of_the_difference_angles() -> None:
    # About +-180 deg, where an ordinary mean would be 0.
    level = np.array([[10.0, 0.0], [20.0, 0.0], [0.0, 0.0]])
    world = np.array([rotate_xy(np.radians(179.0), level[0]), rotate_xy(np.radians(-177.0), level[1]), [0.0, 0.0]])
    found = match_track(level, world)
    assert np.degrees(found.yaw_rad) % 360.0 == pytest.approx(181.0)
    assert found.shift == pytest.approx((world - rotate_xy(found.yaw_rad, level)).mean(axis=0))


def test_short_vectors_are_left_out() -> None:
    level = np.array([[20.0, 0.0], [10.0, 0.0], [4.9, 0.0], [0.0, 0.0]])
    world = TRUTH(level)
    exact = match_track(level, world)
    world[2] = TRUTH(np.array([[0.0, 4.9]]))[0]
    assert match_track(level, world).yaw_rad == pytest.approx(exact.yaw_rad, abs=1e-12)
    turned = match_track(level, world, MatchSettings(min_vector_m=4.0))
    assert float(wrap(turned.yaw_rad - exact.yaw_rad)) > 0.1


def test_a_vector_that_is_short_in_one_of_the_tracks_is_left_out() -> None:
    level = np.array([[20.0, 0.0], [0.0, 3.0], [0.0, 0.0]])
    world = np.array([[20.0, 0.0], [6.0, 0.0], [0.0, 0.0]])
    assert match_track(level, world).yaw_rad == 0.0


@pytest.mark.parametrize("count", [0, 1, 2, 10])
def test_too_short(count: int) -> None:
    xy = np.column_stack([np.linspace(0.0, 4.5, count), np.zeros(count)])
    with pytest.raises(MatchError, match=r"at most \d\.\d m away from its last position.*needed are 10\.0 m"):
        match_track(xy, xy)


# choose_track


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


@given(motions, st.integers(0, 100))
@settings(max_examples=20, deadline=None)
def test_the_choice_does_not_depend_on_where_the_sensor_stands(motion: PlanarMatch, seed: int) -> None:
    tracks = [seen(replace(DRIVE, legs=((15.0, 0.0), (16.0, -60.0))), seed=seed), seen(seed=seed)]
    moved = [track(one.stamps_s, motion(one.centres)) for one in tracks]
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


def test_nothing_that_moves_fits() -> None:
    turns_back = seen(replace(DRIVE, legs=((5.0, 0.0), (12.0, -180.0))))
    with pytest.raises(MatchError, match=r"no moving object fits the CAMs: \d+% .* of the best of 1 explained"):
        choose_track([turns_back], {42: vehicle()})


def test_a_sender_that_stands_still() -> None:
    parked = Drive((5.0, 5.0), 0.0, speeds=((0.0, 0.0),))
    with pytest.raises(TrackError, match=r"the vehicle of station 42 stands still: it moves 0\.00 m"):
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
    with pytest.raises(TrackError, match="while its CAMs tell its position"):
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
