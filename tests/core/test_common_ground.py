from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from laci_stereo.core.common_ground import GROWTH_M, SWAY_RAD, lay, merge_grounds
from laci_stereo.core.errors import CombineError
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.frames import OPENCV_AXES, FloatArray
from laci_stereo.core.ground.box_ground import level_ground
from laci_stereo.core.ground.plane import GroundPlane
from laci_stereo.core.tracking.sighting import Low
from laci_stereo.core.tracking.tracks import Track
from tests.report.support import calibration

TILT = np.radians(15.0)
NORMAL = np.array([0.0, -np.cos(TILT), -np.sin(TILT)])
SIGMA_RAD, SIGMA_M = 0.003, 0.02
DAY_NS = 86_400_000_000_000
CASES = 300


def ground(turn: FloatArray, height_m: float, scale: float = 1.0) -> GroundPlane:
    """Return a plane whose normal is off by a small turn, and which says how uncertain it is."""
    normal = NORMAL + np.cross(turn, NORMAL)
    made = level_ground(height_m, OPENCV_AXES)
    across = np.eye(3) - np.outer(NORMAL, NORMAL)
    covariance = np.zeros((4, 4))
    covariance[:3, :3] = SIGMA_RAD**2 * across
    covariance[3, 3] = SIGMA_M**2
    return replace(made, normal=normal / np.linalg.norm(normal), covariance_sensor=scale**2 * covariance)


@cache
def plain() -> Passage:
    return calibration().passages[0]


def passage(seen: GroundPlane, name: str = "run") -> Passage:
    return replace(plain(), ground=seen, name=name)


def drawn(count: int, rng: np.random.Generator) -> list[Passage]:
    return [
        passage(ground(SIGMA_RAD * rng.normal(size=3), 6.0 + SIGMA_M * rng.normal()), f"run {i}") for i in range(count)
    ]


@pytest.mark.slow
def test_many_grounds_are_nearer_to_the_truth_than_one() -> None:
    rng = np.random.default_rng(0)
    tilts, heights = [], []
    for _ in range(100):
        merged = merge_grounds(drawn(9, rng)).ground
        tilts.append(np.linalg.norm(np.cross(merged.normal, NORMAL)))
        heights.append(merged.height_m - 6.0)
        assert np.linalg.norm(merged.normal) == pytest.approx(1.0)
    assert np.sqrt(np.mean(np.square(tilts))) == pytest.approx(np.sqrt(2) * SIGMA_RAD / 3, rel=0.2)
    assert np.sqrt(np.mean(np.square(heights))) == pytest.approx(SIGMA_M / 3, rel=0.2)


def test_what_errs_in_every_drive_is_not_averaged_away() -> None:
    drives = drawn(9, np.random.default_rng(1))
    one, nine = (made.covariance_level(OPENCV_AXES) for made in (drives[0].ground, merge_grounds(drives).ground))
    # But for the mast, which bends by a sixth of the tilt's sigma here.
    assert np.diag(nine) == pytest.approx(np.diag(one), rel=0.05)


def test_the_better_ground_counts_for_more() -> None:
    exact, vague = ground(np.zeros(3), 6.0, 0.1), ground(np.array([2 * SIGMA_RAD, 0.0, 0.0]), 6.03)
    for order in ([exact, vague], [vague, exact]):
        merged = merge_grounds([passage(each) for each in order]).ground
        assert abs(merged.height_m - 6.0) < 0.003
        assert np.linalg.norm(np.cross(merged.normal, NORMAL)) < 0.1 * 2 * SIGMA_RAD


def test_a_sensor_that_was_moved_is_told_by_its_tilt_or_height() -> None:
    still = passage(ground(np.zeros(3), 6.0), "monday")
    for turn_rad, height_m in ((10 * SIGMA_RAD, 6.0), (0.0, 6.0 + 10 * SIGMA_M)):
        moved = passage(ground(np.array([turn_rad, 0.0, 0.0]), height_m), "tuesday")
        with pytest.raises(CombineError, match=r"moved between the drives: in tuesday .* off monday"):
            merge_grounds([still, moved])


def test_a_mast_in_the_sun_was_not_moved() -> None:
    """However sharp the grounds are: 0.1 deg is what the sun bends it."""
    sharp = [ground(np.array([turn, 0.0, 0.0]), 6.0, 1e-3) for turn in (0.0, 0.0017)]
    merged = merge_grounds([passage(each) for each in sharp])
    assert merged.ground.height_m == pytest.approx(6.0)
    assert merged.objections == ()


def on_days(heights_m: Sequence[float], turns_rad: Sequence[float] | None = None) -> list[Passage]:
    """Return a drive a day, which sees the sensor so high and turned so far; no two see quite the same ground."""
    found = []
    for day, (height_m, turn_rad) in enumerate(zip(heights_m, turns_rad or [0.0] * len(heights_m), strict=True)):
        made = passage(ground(np.array([turn_rad, 0.0, 0.0]), height_m + 1e-6 * day), f"day {day}")
        vehicle = made.vehicle
        found.append(replace(made, vehicle=replace(vehicle, epoch_ns=vehicle.epoch_ns + day * DAY_NS)))
    return found


@pytest.mark.parametrize("count", [2, 5, pytest.param(10, marks=pytest.mark.slow)])
def test_grounds_as_good_as_they_claim_are_one_ground(count: int) -> None:
    """Neither is anything said in more than 1 % of cases, nor is the truth beyond three sigma in more."""
    rng = np.random.default_rng(count)
    said, beyond = 0, 0
    for _ in range(CASES):
        merged = merge_grounds(drawn(count, rng))
        said += merged.objections != () or len(merged.kept) < count
        sigma_m = np.sqrt(merged.ground.covariance_level(OPENCV_AXES)[2, 2])
        beyond += abs(merged.ground.height_m - 6.0) > 3 * sigma_m
    assert said <= 0.02 * CASES
    assert beyond <= 0.01 * CASES


@pytest.mark.parametrize("turned", [False, True])
def test_a_sensor_that_was_moved_a_little_is_told_and_the_claim_covers_both(turned: bool) -> None:
    """Between the sigmas of one in a hundred pairs (3.4) and of `GROUND_GATE`, which refuses."""
    for sigmas, told in ((3.0, False), (4.0, True), (4.9, True)):
        apart = sigmas * np.sqrt(2) * (SIGMA_RAD if turned else SIGMA_M)
        if turned:
            drives = on_days([6.0, 6.0], [0.0, np.hypot(1.0, SWAY_RAD / SIGMA_RAD) * apart])
        else:
            drives = on_days([6.0, 6.0 + np.hypot(1.0, GROWTH_M / SIGMA_M) * apart])
        merged = merge_grounds(drives)
        assert merged.kept == (0, 1)
        assert bool(merged.objections) == told
        if told:
            (objection,) = merged.objections
            assert "in day 1 the sensor's tilt is" in objection
            assert f"off day 0 ({sigmas:.1f} sigma)" in objection
            assert "was the sensor moved?" in objection
            assert (
                "+0.000 m" in objection if turned else f"height {drives[1].ground.height_m - 6.0:+.3f} m" in objection
            )
        off_m, off_rad = merged.ground.height_m - 6.0, np.linalg.norm(np.cross(merged.ground.normal, NORMAL))
        variances = merged.ground.covariance_level(OPENCV_AXES)[[0, 2], [0, 2]]  # the drives are turned about x
        assert (off_rad if turned else off_m) == pytest.approx(apart / 2, rel=0.05)
        # Half of the difference is k / sqrt(2) sigma, and Birge's ratio is k / sqrt(3).
        assert (off_rad if turned else off_m) < 1.3 * np.sqrt(variances[0 if turned else 1])


def test_the_claim_grows_with_the_disagreement() -> None:
    """By Birge's ratio: by chi-square per degree of freedom."""
    sigmas_m = [
        np.sqrt(merge_grounds(on_days([6.0, 6.0 + apart])).ground.covariance_level(OPENCV_AXES)[2, 2])
        for apart in (0.0, SIGMA_M, 3.0 * np.sqrt(2) * SIGMA_M, 4.5 * np.sqrt(2) * SIGMA_M)
    ]
    assert sigmas_m[1] == pytest.approx(sigmas_m[0])
    assert sigmas_m[0] == pytest.approx(SIGMA_M, rel=0.01)
    assert np.array(sigmas_m[2:]) == pytest.approx(np.array([3.0, 4.5]) / np.sqrt(3) * SIGMA_M, rel=0.01)


@pytest.mark.parametrize("wrong", range(5))
def test_one_wrong_ground_of_five_is_left_out_and_named(wrong: int) -> None:
    heights_m = [6.0, 6.01, 5.99, 6.015, 5.985]
    heights_m[wrong] = 6.0 + 10 * SIGMA_M
    drives = on_days(heights_m)
    merged = merge_grounds(drives)
    others = [i for i in range(5) if i != wrong]
    assert merged.kept == tuple(others)
    (objection,) = merged.objections
    assert objection.startswith(f"day {wrong} left out: in it the sensor's tilt is 0.00 deg and its height +0.")
    assert "off the 4 other drives" in objection
    without = merge_grounds([drives[i] for i in others])
    assert without.objections == ()
    assert merged.ground.height_m == pytest.approx(without.ground.height_m)


def test_wrong_grounds_at_odds_times_are_left_out() -> None:
    merged = merge_grounds(on_days([6.0, 6.3, 6.01, 5.99, 5.7, 6.0]))
    assert merged.kept == (0, 2, 3, 5)
    assert [text.split(":")[0] for text in merged.objections] == ["day 1 left out", "day 4 left out"]


@pytest.mark.parametrize("since", [2, 3, 4])
def test_a_sensor_that_was_moved_for_good_is_refused_with_both_dates(since: int) -> None:
    """Also if most of the drives are of one side."""
    drives = on_days([6.0 if day < since else 6.0 + 10 * SIGMA_M for day in range(6)])
    last, first = (np.datetime64(ns, "ns") for ns in (drives[since - 1].span_ns[1], drives[since].span_ns[0]))
    dates = [str(at.astype("datetime64[s]")).replace("T", " ") for at in (last, first)]
    with pytest.raises(CombineError, match=f"moved between {dates[0]} and {dates[1]} UTC: in day {since}, .*off day 0"):
        merge_grounds(drives)


def test_the_moment_is_found_though_one_drive_saw_the_ground_badly() -> None:
    """It would agree with either side."""
    drives = on_days([6.0, 6.0, 6.0, 6.2, 6.2, 6.2])
    for vague in range(6):
        seen = list(drives)
        seen[vague] = replace(seen[vague], ground=ground(np.zeros(3), seen[vague].ground.height_m, 8.0))
        with pytest.raises(CombineError, match=r"moved between \d{4}-\d\d-\d\d "):
            merge_grounds(seen)


def test_without_a_majority_both_groups_are_named() -> None:
    with pytest.raises(CombineError, match=r"in day 1, day 3 its .* height \+0\.200 m off day 0, day 2"):
        merge_grounds(on_days([6.0, 6.2, 6.0, 6.2]))


def test_of_two_that_contradict_each_other_a_vague_third_does_not_tell_the_wrong_one() -> None:
    drives = on_days([6.0, 6.2, 6.1])
    drives[2] = replace(drives[2], ground=ground(np.zeros(3), 6.1, 8.0))
    with pytest.raises(CombineError, match=r"in day 1 its .* off day 0 .*agree with either; needed is one more drive"):
        merge_grounds(drives)


def test_drives_of_one_recording_have_one_ground_and_one_vote() -> None:
    """Three senders of one recording do not outvote two others."""
    one, *others = on_days([6.2, 6.0, 6.01])
    alike = [replace(one, name=f"sender {i}", ground=replace(one.ground)) for i in range(3)]
    merged = merge_grounds(alike)
    assert merged.ground is alike[0].ground
    assert (merged.kept, merged.objections) == ((0, 1, 2), ())
    merged = merge_grounds([*alike, *others])
    assert merged.kept == (3, 4)
    assert merged.objections[0].startswith("sender 0, sender 1, sender 2 left out")
    alone, together = (merge_grounds([*some, passage(ground(np.zeros(3), 6.19))]) for some in (alike[:1], alike))
    assert together.ground.height_m == alone.ground.height_m
    assert together.ground.covariance_sensor == pytest.approx(alone.ground.covariance_sensor)


def test_all_that_was_seen_is_laid_onto_the_other_ground() -> None:
    own, other = ground(np.zeros(3), 6.0), ground(np.array([0.03, 0.0, 0.02]), 6.2)
    at = np.array([[20.0, 1.0, 0.5], [22.0, -1.0, 0.3]])
    drive = passage(own)
    first = drive.track.sightings[0]
    sighting = replace(first, points=at, low=Low(at, np.ones(2), np.ones(2)), borders=at)
    (laid,) = lay(replace(drive, track=Track((sighting,))), other, drive.world).track.sightings
    assert np.linalg.norm(laid.points - at, axis=1).min() > 0.1  # higher, and tilted
    assert laid.low.points == pytest.approx(laid.points)
    assert laid.borders == pytest.approx(laid.points)
