from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.frames import FloatArray
from laci_stereo.core.ground.road_crowns import Crowns

ALONG_RAD = 0.3


def crossing(off: FloatArray, at_m: FloatArray, askew_rad: float) -> FloatArray:
    """Return how high the nearer of two crowns, one of them along the way, makes places if roads fall by 1."""
    across_rad = ALONG_RAD + np.array([askew_rad, np.pi / 2])
    away_m = (off - at_m) @ np.stack([np.cos(across_rad), np.sin(across_rad)])
    return -np.abs(away_m).min(axis=1)


@pytest.mark.parametrize("askew_deg", [0.0, 22.5, -45.0])
def test_where_two_roads_cross_is_found_among_all_places(askew_deg: float) -> None:
    rng = np.random.default_rng(1)
    off, at_m = rng.uniform(-12.0, 12.0, (400, 2)), np.array([2.3, -4.1])
    height = 0.02 * crossing(off, at_m, np.radians(askew_deg))

    def evidence(pairs: FloatArray) -> FloatArray:
        """Heights are exact to 1 cm."""
        told: FloatArray = -0.5 * (((height[:, None] - 0.02 * pairs) / 0.01) ** 2).sum(axis=0)
        return told

    one = Crowns.of_road(off, ALONG_RAD)
    crowns = one.and_crossings(off, evidence)
    raised = crowns.raised(off, np.zeros(len(off)))
    pairs = len(crowns.pairs_m)
    told = evidence(raised[:, -pairs:]) + np.log(crowns.likely[-pairs:])
    likeliest = raised[:, -pairs:][:, told.argmax()]
    # Places are 0.25 m apart: off by no more than half of that, and by half in the other direction.
    assert np.abs(likeliest - height / 0.02).max() < 0.25
    assert (raised[:, :-pairs] == one.raised(off, np.zeros(len(off)))).all()


def test_crowns_of_one_road_are_as_likely_along_the_way_as_across_it() -> None:
    crowns = Crowns.of_road(np.random.default_rng(2).uniform(-9.0, 9.0, (50, 2)), ALONG_RAD)
    straight = crowns.at_m.size
    assert crowns.likely.sum() == pytest.approx(1.0)
    assert crowns.likely[-straight:].sum() == pytest.approx(0.5)


def test_beyond_where_a_road_was_seen_to_end_a_crown_is_a_tenth_as_likely() -> None:
    off = np.random.default_rng(2).uniform(-9.0, 9.0, (50, 2))
    open_, ended = Crowns.of_road(off, ALONG_RAD), Crowns.of_road(off, ALONG_RAD, (-2.0, 5.0))
    assert ended.likely.sum() == pytest.approx(1.0)
    odds = ended.likely / open_.likely
    at_m = -Crowns.of_road(off, ALONG_RAD).raised(np.zeros((1, 2)), np.zeros(1))[0]  # how far from the way each is
    along = odds[: -open_.at_m.size]
    assert along.max() / along.min() == pytest.approx(10.0)
    assert (along[at_m[: len(along)] < 1.9] == along.max()).all()
    assert (along[at_m[: len(along)] > 5.1] == along.min()).all()


def test_what_is_smaller_than_a_square_shows_no_crossing() -> None:
    off = np.random.default_rng(3).uniform(0.0, 0.3, (40, 2))
    crowns = Crowns.of_road(off, ALONG_RAD).and_crossings(off, lambda pairs: np.zeros(pairs.shape[1]))
    assert len(crowns.pairs_m) == 0


def seen_across(wide_m: float) -> FloatArray:
    """Return places of a square to the left of a straight way along x."""
    x, y = np.meshgrid(np.linspace(0.0, wide_m, 31), np.linspace(0.0, wide_m, 31))
    return np.column_stack([x.ravel(), y.ravel()])


def test_of_the_road_that_the_way_is_on_the_other_side_is_there_and_of_one_that_it_crosses_it_may_be() -> None:
    off = seen_across(20.0)
    crowns = Crowns.of_road(off, 0.0)
    flat = np.column_stack([np.ones(len(off)), off])
    tilts = np.linalg.lstsq(flat, crowns.raised(off, off[:, 1]), rcond=None)[0][1:]
    other, there = (each[..., -crowns.at_m.size :] for each in crowns.other_sides(tilts, off)[0])
    along, across = (
        np.flatnonzero((np.abs(crowns.at_m - 7.0) < 1.0).ravel() & (np.tile(crowns.towards[i], 7) > 0.99))[0]
        for i in (1, 0)
    )
    for crown, direction in ((along, [0.0, 1.0]), (across, [1.0, 0.0])):
        # Two thirds of what is seen are beyond the crown, and fall away from the way.
        slope = tilts[:, -crowns.at_m.size :][:, crown] @ direction
        assert -1.0 < slope < -0.3
        assert other[:, crown] == pytest.approx(np.multiply(slope, direction), abs=1e-9)
    assert there[along] == 1.0
    assert 0.0 < there[across] < 0.5


def test_the_wider_another_road_had_to_be_the_less_likely_its_other_side_is_there() -> None:
    """The way crosses its crown, where two thirds of what is seen are behind that."""
    likely = []
    for wide_m in (4.0, 7.5, 12.0, 20.0):
        off = seen_across(wide_m)
        crowns = Crowns.of_road(off, 0.0)
        crowns = replace(crowns, at_m=np.full_like(crowns.at_m, wide_m / 3.0))
        likely.append(crowns.other_sides(np.ones((2, len(crowns.likely))), off)[0][1][-crowns.at_m.size])
    assert 1.0 == likely[0] > likely[1] > likely[2] > likely[3]
    assert likely[3] == pytest.approx(0.5 ** (20.0 / 3.0 / 3.5))


def test_of_two_roads_that_cross_each_may_have_another_side() -> None:
    rng = np.random.default_rng(4)
    off = rng.uniform(-12.0, 12.0, (400, 2))
    crowns = Crowns.of_road(off, ALONG_RAD).and_crossings(off, lambda pairs: rng.normal(0.0, 9.0, pairs.shape[1]))
    tilts = rng.normal(size=(2, len(crowns.likely)))
    (first, _), (second, likely) = crowns.other_sides(tilts, off)
    pairs = slice(len(crowns.likely) - len(crowns.pairs_m), None)
    assert (crowns.crossing != 0).any()  # askew
    assert (first + second)[:, pairs] == pytest.approx(tilts[:, pairs])
    for part, way in ((first, crowns.crossing), (second, np.full(len(crowns.pairs_m), 4))):
        across = crowns.towards[:, way]
        assert part[0, pairs] * across[1] == pytest.approx(part[1, pairs] * across[0])
    assert (likely[: pairs.start] == 0.0).all()
    assert (second[:, : pairs.start] == 0.0).all()
