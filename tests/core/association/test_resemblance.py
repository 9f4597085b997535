"""What a body tells of whose it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.association.choice import Resemblance
from laci_stereo.core.association.resemblance import resemblance
from laci_stereo.core.frames import rotate_xy
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.tracking.tracks import Track
from tests.core.outlines import HEIGHT_M, SIZE, TRUTH, evidence
from tests.core.tracks import sighting

DRIVE = evidence(sigma_m=0.03, behind=0.1)


def seen() -> Track:
    """The evidence as the track that it was collected from."""
    sightings = []
    for number, stamp_s in enumerate(DRIVE.stamps_s):
        of_frame = DRIVE.frame == number
        points = DRIVE.points[of_frame]
        sightings.append(
            replace(
                sighting(float(stamp_s), DRIVE.middles[number], count=len(points)),
                points=points,
                sigma_along_m=DRIVE.sigma_along_m[of_frame],
                sigma_across_m=DRIVE.sigma_across_m[of_frame],
            )
        )
    return Track(tuple(sightings))


def odds(length_m: float) -> float:
    return resemblance(seen(), replace(DRIVE.vehicle, length_m=length_m), TRUTH, 0.0, HEIGHT_M).body


def way(track: Track, told: VehicleTrack = DRIVE.vehicle, start: PlanarMatch = TRUTH) -> Resemblance:
    found = resemblance(track, told, start, 0.0, HEIGHT_M)
    assert found.way is not None
    return found


def test_a_body_of_the_length_that_was_told_speaks_for_its_sender() -> None:
    # A stranger would be within the doubt of 0.1 m by one chance in three or less.
    assert odds(SIZE[0]) > np.log(3.0)


@pytest.mark.slow
@pytest.mark.parametrize("off_m", [-0.9, 0.6, 1.5])
def test_a_body_of_another_length_speaks_against_it(off_m: float) -> None:
    assert odds(SIZE[0] + off_m) < -2.0


@pytest.mark.parametrize(
    "part", ["slides", pytest.param("rear", marks=pytest.mark.slow), pytest.param("front", marks=pytest.mark.slow)]
)
def test_what_is_small_against_a_vehicle_speaks_against_it(part: str) -> None:
    """A metre of the side, as of a cyclist who overtakes it, or a piece of it."""
    kept = []
    for share, one in zip(np.linspace(-1.0, 1.0, len(DRIVE.stamps_s)), seen().sightings, strict=True):
        (xy,), (yaw,), _ = DRIVE.vehicle.at(np.array([one.stamp_s]))
        along = rotate_xy(-yaw, TRUTH(one.points[:, :2]) - xy)[:, 0]
        middle = {"slides": share, "rear": -1.0, "front": 1.0}[part] * (SIZE[0] / 2 - 0.5)
        near = np.abs(along - middle) < 0.5
        kept.append(
            replace(
                one,
                points=one.points[near],
                sigma_along_m=one.sigma_along_m[near],
                sigma_across_m=one.sigma_across_m[near],
            )
        )
    small = resemblance(Track(tuple(kept)), DRIVE.vehicle, TRUTH, 0.0, HEIGHT_M)
    assert small.body < odds(SIZE[0]) - np.log(9.0)


def test_the_start_need_not_be_exact() -> None:
    middle = DRIVE.middles.mean(axis=0)
    yaw = TRUTH.yaw_rad + np.radians(3.0)
    start = PlanarMatch(yaw, TRUTH(middle[None])[0] + np.array([0.5, -0.4]) - rotate_xy(yaw, middle))
    found = way(seen(), start=start)
    assert found.body > 0.0
    assert found.way > np.log(1000.0)
    assert found.fit is not None
    assert found.fit(DRIVE.middles) == pytest.approx(TRUTH(DRIVE.middles), abs=0.1)


@pytest.mark.slow
def test_a_clock_that_contradicts_speaks_against_it() -> None:
    # The turn tells time: a third of a second is beyond what clocks that agree to 10 ms can be.
    # As much as that a sender is mistaken about its reference point, which is the other explanation of the bend.
    vehicle = DRIVE.vehicle
    assert way(seen(), replace(vehicle, stamps_s=vehicle.stamps_s + 0.3)).way < way(seen()).way - np.log(50.0)


@pytest.mark.parametrize("ahead_m", [-1.5, 1.5])
def test_a_sender_that_is_mistaken_about_its_reference_point_is_no_stranger(ahead_m: float) -> None:
    told = DRIVE.vehicle
    off = rotate_xy(told.yaw_rad, np.tile([ahead_m, 0.0], (len(told.xy), 1)))
    assert way(seen(), replace(told, xy=told.xy + off)).way > 0.0


def test_what_shows_no_body_tells_nothing() -> None:
    bare = Track(tuple(replace(one, points=np.zeros((0, 3)), sigma_along_m=np.zeros(0), sigma_across_m=np.zeros(0))
                       for one in seen().sightings))  # fmt: skip
    assert resemblance(bare, DRIVE.vehicle, TRUTH, 0.0, HEIGHT_M) == Resemblance(0.0, None)


def test_an_outline_that_the_matchers_window_hides_leaves_the_way_to_boxes() -> None:
    # Where noise hides the bumpers in the road, and 0.4 m and more above the road are in one window with it.
    blurred = [replace(one, sigma_along_m=np.full(len(one.points), 1.2), window_rad=0.1) for one in seen().sightings]
    assert resemblance(Track(tuple(blurred)), DRIVE.vehicle, TRUTH, 0.0, HEIGHT_M).way is None


def test_an_outline_that_follows_the_way_to_centimetres_is_hardly_a_strangers() -> None:
    # Within 0.3 m, as boxes show it, one stranger in some ten would do the same.
    assert way(seen()).way > np.log(1000.0)


@pytest.mark.parametrize("faster", [0.9, pytest.param(1.1, marks=pytest.mark.slow)])
def test_another_speed_speaks_against_it(faster: float) -> None:
    vehicle = DRIVE.vehicle
    middle = vehicle.xy.mean(axis=0)
    told = replace(vehicle, xy=middle + faster * (vehicle.xy - middle))
    assert way(seen(), told).way < -2.0


def test_braking_elsewhere_speaks_against_it() -> None:
    vehicle = DRIVE.vehicle
    # By 1 m/s^2, which bends the path by 1 m from the middle of the drive to its ends some 3 s away.
    late_s = vehicle.stamps_s - DRIVE.stamps_s.mean()
    ahead = np.column_stack([np.cos(vehicle.yaw_rad), np.sin(vehicle.yaw_rad)])
    told = replace(vehicle, xy=vehicle.xy + ahead * (late_s**2 / 2)[:, None])
    assert way(seen(), told).way < -2.0


@pytest.mark.slow
def test_a_second_of_something_else_is_found_and_does_not_speak_against_it() -> None:
    track = seen()
    last_s = track.sightings[-1].stamp_s
    strayed = Track(tuple(
        replace(one, points=one.points + np.array([2.0, 1.0, 0.0])) if one.stamp_s > last_s - 0.8 else one
        for one in track.sightings
    ))  # fmt: skip
    assert way(track).strayed_s == ()
    found = way(strayed)
    assert found.way > np.log(100.0)
    assert found.strayed_s[0][0] < last_s - 0.3 < last_s < found.strayed_s[-1][1]
    assert sum(end_s - begin_s for begin_s, end_s in found.strayed_s) < 2.5
