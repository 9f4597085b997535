"""Positions of another place on the vehicle are told where nothing fits as it was said."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.commands.options import parse_reference
from laci_stereo.core.association.case import Alternative, Case
from laci_stereo.core.association.choice import Choice, Resemblance
from laci_stereo.core.association.vehicle_choice import in_words
from laci_stereo.core.association.wrong_place import place_off
from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.errors import MatchError
from laci_stereo.core.frames import rotate_xy
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import CENTRE, FRONT, ReferencePoint, VehicleTrack
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.tracking.tracks import Track
from tests.core.tracks import DRIVE, STRAIGHT_ON, seen, vehicle
from tests.simulated import LEFT_TURN, RIGHT_TURN, Drive, lidar, scene

LORRY, CAR = (12.0, 2.5), (4.4, 1.8)
AXLE = ReferencePoint(-3.6)


def by_outline(track: Track, sent: VehicleTrack, fit: PlanarMatch, time_offset_s: float) -> Resemblance:
    """An outline shows where the middle of the vehicle is; a box may be half a length off."""
    off_m = fit(track.centres) - sent.at(track.stamps_s + time_offset_s)[0]
    return Resemblance(0.0, 8.0 if np.sqrt((off_m**2).sum(axis=1).mean()) < 0.3 else -8.0)


def taken_for(
    true: ReferencePoint, said: ReferencePoint, drive: Drive = DRIVE, size: tuple[float, float] = LORRY
) -> VehicleTrack:
    """What a vehicle sends of one place on it, if that is taken for another."""
    sent = vehicle(drive, size=size)
    is_at, said_at = (place.offset(size[0]) for place in (true, said))
    by = rotate_xy(sent.yaw_rad, np.tile(is_at - said_at, (len(sent.yaw_rad), 1)))
    return replace(sent, xy=sent.xy + by, reference=(float(said_at[0]), float(said_at[1])))


def words(
    sent: Mapping[int, VehicleTrack], *drives: tuple[Drive, tuple[float, float]], settings: MatchSettings | None = None
) -> str:
    tracks = [seen(drive, size=size, seed=seed) for seed, (drive, size) in enumerate(drives or ((DRIVE, LORRY),))]
    instead = place_off(Case(tracks, sent, settings or MatchSettings(), by_outline))
    return instead.words if instead else ""


@pytest.mark.parametrize(
    ("true", "said", "option"),
    [(CENTRE, FRONT, "center"), (FRONT, CENTRE, "front"), (AXLE, FRONT, "rear-axle:3.6"), (FRONT, AXLE, "front")],
)
def test_the_place_is_told(true: ReferencePoint, said: ReferencePoint, option: str) -> None:
    assert words({42: taken_for(true, said)}) == (
        "if the messages' positions were of another point on the vehicle, station 42 would match its messages: "
        f"--cam-reference {option}"
    )
    assert parse_reference(option) == true


@pytest.mark.parametrize("place", [FRONT, CENTRE, AXLE, ReferencePoint(2.0, 0.5)])
def test_of_what_fits_as_it_was_said_nothing_is_told(place: ReferencePoint) -> None:
    assert words({42: taken_for(place, place)}) == ""


def test_an_offset_to_the_left_that_was_said_goes_with_its_place() -> None:
    told_aside = taken_for(FRONT, ReferencePoint(-3.6, 0.8))
    assert words({42: told_aside}).endswith("--cam-reference front")


def test_the_option_is_of_all_senders() -> None:
    """A car and a lorry that tell their centres: one option is right for both, whatever they are long."""
    drives = (DRIVE, LORRY), (STRAIGHT_ON, CAR)
    centres = {7: taken_for(CENTRE, FRONT), 42: taken_for(CENTRE, FRONT, STRAIGHT_ON, CAR)}
    assert words(centres, *drives).endswith("--cam-reference center")
    # No option has the lorry's positions at its rear axle and leaves the car's at its front.
    assert words({7: taken_for(AXLE, FRONT), 42: taken_for(FRONT, FRONT, STRAIGHT_ON, CAR)}, *drives) == ""


def test_what_may_be_by_chance_is_not_told() -> None:
    never = MatchSettings(clear_log_odds=math.inf)
    assert words({42: taken_for(CENTRE, FRONT)}, settings=never) == ""


def test_straight_on_any_place_fits() -> None:
    assert words({42: taken_for(AXLE, FRONT, STRAIGHT_ON)}, (STRAIGHT_ON, LORRY)) == ""


def instead(text: str, log_likelihood: float, log_searched: float = 0.0) -> Alternative:
    choice = Choice(42, seen(), 1.0, 0.0, PlanarMatch(0.0, np.zeros(2)), 0.0, log_likelihood, math.inf, "nothing else")
    return Alternative(choice, text, log_searched)


def test_of_what_would_fit_the_likeliest_is_told_and_what_is_nearly_as_likely() -> None:
    settings = MatchSettings()
    assert in_words([], settings) == ""
    assert in_words([instead("clocks", 5.0), instead("place", 9.0)], settings) == "place"
    assert in_words([instead("clocks", 8.5), instead("place", 9.0)], settings) == "place; or clocks"
    assert in_words([instead("optics", 12.0, 4.0), instead("place", 11.0)], settings) == "place"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drive", "size", "said"),
    [(LEFT_TURN, CAR, ReferencePoint(-2.2)), (RIGHT_TURN, (8.0, 2.4), CENTRE)],
    ids=["car", "van"],
)
def test_the_refusal_of_a_wrong_place_names_the_right_one(
    drive: Drive, size: tuple[float, float], said: ReferencePoint
) -> None:
    made = scene(drive, lidar(), size=size)
    with pytest.raises(MatchError, match=r"if .* were of another point on the vehicle, .*: --cam-reference front"):
        calibrate(made.recording, made.messages, reference=said)
    assert calibrate(made.recording, made.messages, reference=FRONT).quality.verdict == "pass"
