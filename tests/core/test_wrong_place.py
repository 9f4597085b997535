"""Positions of another place on the vehicle are told where nothing fits as it was said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.cam import ReferencePoint, VehicleTrack
from laci_stereo.core.case import Case
from laci_stereo.core.choice import Resemblance
from laci_stereo.core.errors import MatchError
from laci_stereo.core.frames import rotate_xy
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.tracking import Track
from laci_stereo.core.wrong_place import PLACES, place_off
from tests.core.tracks import DRIVE, seen, vehicle
from tests.simulated import LEFT_TURN, RIGHT_TURN, Drive, lidar, scene

LORRY = (12.0, 2.5)
STRAIGHT_ON = Drive((20.0, 22.0), -90.0, speeds=((0.0, 8.0),))


def by_outline(track: Track, sent: VehicleTrack, fit: PlanarMatch, time_offset_s: float) -> Resemblance:
    """An outline shows where the middle of the vehicle is; a box may be half a length off."""
    off_m = fit(track.centres) - sent.at(track.stamps_s + time_offset_s)[0]
    return Resemblance(0.0, 8.0 if np.sqrt((off_m**2).sum(axis=1).mean()) < 0.3 else -8.0)


def taken_for(true: str, told: str, drive: Drive = DRIVE) -> VehicleTrack:
    """What a lorry sends of one place on it, if that is taken for another."""
    sent = vehicle(drive, size=LORRY)
    is_at, said_at = (np.array([PLACES[name] * LORRY[0], 0.0]) for name in (true, told))
    by = rotate_xy(sent.yaw_rad, np.tile(is_at - said_at, (len(sent.yaw_rad), 1)))
    return replace(sent, xy=sent.xy + by, reference=(float(said_at[0]), 0.0))


def said(sent: VehicleTrack, drive: Drive = DRIVE) -> str:
    told = place_off(Case([seen(drive, size=LORRY)], {42: sent}, MatchSettings(), by_outline))
    return told.words if told else ""


@pytest.mark.parametrize(
    ("true", "told", "option"),
    [("centre", "front", "center"), ("front", "centre", "front"), ("rear", "front", "-6.00,0")],
)
def test_the_place_is_told(true: str, told: str, option: str) -> None:
    assert said(taken_for(true, told)) == (
        f"were the messages' positions those of the vehicle's {true}, station 42 would be seen where they say: "
        f"--cam-reference {option}"
    )


@pytest.mark.parametrize("place", PLACES)
def test_of_what_fits_as_it_was_said_nothing_is_told(place: str) -> None:
    assert said(taken_for(place, place)) == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drive", "size", "ahead_m"), [(LEFT_TURN, (4.4, 1.8), -2.2), (RIGHT_TURN, (8.0, 2.4), 0.0)], ids=["car", "van"]
)
def test_the_refusal_of_a_wrong_place_names_the_right_one(
    drive: Drive, size: tuple[float, float], ahead_m: float
) -> None:
    made = scene(drive, lidar(), size=size)
    with pytest.raises(MatchError, match=r"were .* those of the vehicle's front, .*: --cam-reference front"):
        calibrate(made.recording, made.messages, reference=ReferencePoint(ahead_m))


def test_straight_on_any_place_fits() -> None:
    assert said(taken_for("rear", "front", STRAIGHT_ON), STRAIGHT_ON) == ""
