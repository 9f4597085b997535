"""A clock that nobody has set is told by what only a later or earlier one explains."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace

import pytest

from laci_stereo.core.association.case import Case
from laci_stereo.core.association.choice import Resemblance, no_likeness
from laci_stereo.core.association.unset_clock import clocks_apart
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.settings import UNKNOWN_CLOCK_S, MatchSettings
from tests.core.tracks import DRIVE, STRAIGHT_ON, seen, vehicle

SYNCHRONISED = MatchSettings()


def sent(**late_s: float) -> dict[int, VehicleTrack]:
    """What the vehicle that turns and the one that drives straight on send, by clocks that are late."""
    told = {42: (vehicle(), "turns"), 43: (vehicle(STRAIGHT_ON), "straight")}
    return {
        station: replace(one, stamps_s=one.stamps_s + late_s.get(drives, 0.0))
        for station, (one, drives) in told.items()
    }


def said(vehicles: Mapping[int, VehicleTrack], settings: MatchSettings = SYNCHRONISED) -> str:
    tracks = [seen(), seen(STRAIGHT_ON, seed=1)]
    case = Case(tracks, vehicles, settings)
    told = clocks_apart(case, case.chosen(), no_likeness)
    return told.words if told else ""


def exactly(*_: object) -> Resemblance:
    """By its outline, what is seen follows the sender's way exactly."""
    return Resemblance(0.0, 8.0)


@pytest.mark.parametrize("late_s", [-0.8, -0.3, 0.2, 0.8])
def test_what_all_senders_are_late_by_is_told(late_s: float) -> None:
    told = re.fullmatch(
        r"with the clocks (\d\.\d\d) s apart, stations (42 and 43|43 and 42) would match their messages: "
        r"--clock unknown",
        said(sent(turns=late_s, straight=late_s)),
    )
    assert told is not None
    assert float(told[1]) == pytest.approx(abs(late_s), abs=0.05)


@pytest.mark.parametrize("late_s", [0.0, 0.03, -0.03])
def test_of_clocks_that_are_set_nothing_is_said(late_s: float) -> None:
    assert said(sent(turns=late_s, straight=late_s)) == ""


@pytest.mark.parametrize("sender", ["turns", "straight"])
def test_one_clock_of_two_is_no_clock_of_all(sender: str) -> None:
    assert said(sent(**{sender: 0.3})) == ""


@pytest.mark.parametrize("sigma_s", [0.1, UNKNOWN_CLOCK_S])
def test_what_was_asked_for_is_not_asked_for_again(sigma_s: float) -> None:
    assert said(sent(turns=0.3, straight=0.3), MatchSettings(clock_sigma_s=sigma_s)) == ""


def test_one_sender_that_turns_tells_it_where_nothing_fits_otherwise() -> None:
    late = {42: replace(vehicle(), stamps_s=vehicle().stamps_s + 1.2)}
    tracks = [seen()]
    found = clocks_apart(Case(tracks, late, SYNCHRONISED), None, exactly)
    assert found is not None
    assert re.match(r"with the clocks 1\.[12]\d s apart, station 42 would match its messages: ", found.words)
    # By boxes alone it may be by chance, and by clocks that are set there is nothing to be said.
    assert clocks_apart(Case(tracks, late, SYNCHRONISED), None, no_likeness) is None
    assert clocks_apart(Case(tracks, {42: vehicle()}, SYNCHRONISED), None, exactly) is None


def test_one_sender_on_a_straight_road_tells_nothing() -> None:
    """It fits by any clock, and so by the one that was asked for."""
    late = {43: replace(vehicle(STRAIGHT_ON), stamps_s=vehicle(STRAIGHT_ON).stamps_s + 1.2)}
    tracks = [seen(STRAIGHT_ON)]
    assert Case(tracks, late, SYNCHRONISED, exactly).chosen() is not None
    assert clocks_apart(Case(tracks, late, SYNCHRONISED), None, exactly) is None


@pytest.mark.parametrize("seed", range(8))
def test_noise_is_no_other_clock(seed: int) -> None:
    """Even where the choice is in doubt, and the other one is not."""
    slow = replace(DRIVE, speeds=((0.0, 3.0),))
    tracks, sends = [seen(slow, noise_m=0.3, seed=seed)], {42: vehicle(slow)}
    choice = Case(tracks, sends, replace(SYNCHRONISED, clear_log_odds=math.inf), exactly).chosen()
    assert choice is not None
    assert choice.by_chance
    assert clocks_apart(Case(tracks, sends, SYNCHRONISED), choice, exactly) is None


def test_without_tracks_nothing_is_said() -> None:
    assert clocks_apart(Case([], sent(), SYNCHRONISED), None, exactly) is None
