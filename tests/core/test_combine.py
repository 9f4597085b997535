from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.combine import Combined, combine
from laci_stereo.core.errors import CombineError, EvidenceError
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.estimation.recordings import LASTING_PLACE, SAME_SIZE
from laci_stereo.core.frames import Axes, FloatArray
from laci_stereo.core.result import Calibration
from laci_stereo.core.settings import JointSettings, Settings
from laci_stereo.core.world import World
from tests.passages import DAY_NS, ahead, meeting, misplaced, off_by, passages, recorded


@cache
def combined(*numbers: int) -> Combined:
    """Return the result of some of the drives as they are."""
    return combine([passages()[number] for number in numbers])


@pytest.mark.slow
def test_two_drives_of_different_vehicles_place_the_sensor_to_centimetres_and_are_surer_than_each() -> None:
    found = combined(0, 1)
    position_m, angle_deg = misplaced(found.calibration)
    assert position_m < 0.03
    assert angle_deg < 0.06
    quality = found.calibration.quality
    for _, alone in recorded()[:2]:
        assert quality.track_xy_sigma_m < 0.9 * alone.quality.track_xy_sigma_m
        assert quality.yaw_sigma_deg < alone.quality.yaw_sigma_deg
    assert position_m < 3 * quality.track_xy_sigma_m
    assert found.left_out == ()
    assert quality.frames_used + sum(quality.left_out.values()) == quality.frames_seen
    assert {share.station_id for share in found.shares} == {42, 43}
    for share in found.shares:
        assert abs(share.time_offset_s) < 3 * share.time_sigma_s


@pytest.mark.slow
def test_one_drive_gives_what_it_gave() -> None:
    for passage, (_, alone) in zip(passages(), recorded(), strict=True):
        found = combine([passage]).calibration
        # It begins elsewhere, and ends where steps are a thirtieth of the doubt.
        within_m = 0.1 * alone.quality.track_xy_sigma_m
        assert found.T_utm_sensor[:3, 3] == pytest.approx(alone.T_utm_sensor[:3, 3], abs=within_m)
        assert found.T_utm_sensor[:3, :3] == pytest.approx(
            alone.T_utm_sensor[:3, :3], abs=np.radians(0.1 * alone.quality.yaw_sigma_deg)
        )
        sigma = np.sqrt(np.diag(alone.covariance))
        assert found.covariance / np.outer(sigma, sigma) == pytest.approx(
            alone.covariance / np.outer(sigma, sigma), abs=0.02
        )
        assert found.quality.frames_seen == alone.quality.frames_seen


@pytest.mark.slow
def test_a_drive_that_was_estimated_by_the_papers_method_is_sought_in_a_car_s_width_around() -> None:
    for passage, (_, alone) in zip(passages(), recorded(), strict=True):
        rough = replace(passage.match, shift=passage.match.shift + np.array([0.8, -0.6]))
        found = combine([replace(passage, method="paper", match=rough)]).calibration
        within_m = 0.1 * alone.quality.track_xy_sigma_m
        assert found.T_utm_sensor[:3, 3] == pytest.approx(alone.T_utm_sensor[:3, 3], abs=within_m)
        assert {each.method for each in found.passages} == {"joint"}


@pytest.mark.slow
def test_the_order_of_the_drives_does_not_matter() -> None:
    one, other = (combined(*order).calibration for order in ((0, 1, 2), (2, 1, 0)))
    assert one.T_utm_sensor[:3, :3] == pytest.approx(other.T_utm_sensor[:3, :3], abs=1e-5)
    place = one.centre_world - one.T_world_sensor[:3, 3]
    there = [found.T_utm_sensor[:3, 3] + place for found in (one, other)]
    assert there[0] == pytest.approx(there[1], abs=2e-3)


@pytest.mark.parametrize("wrong", [*(pytest.param(wrong, marks=pytest.mark.slow) for wrong in (0, 2)), 1])
def test_a_drive_whose_messages_are_a_metre_off_is_named_and_left_out(wrong: int) -> None:
    drives = passages()
    drives[wrong] = off_by(drives[wrong], 0.8, -0.6)
    found = combine(drives)
    assert [left.name for left in found.left_out] == [f"run {wrong}"]
    assert found.left_out[0].shift_m == pytest.approx(1.0, abs=0.15)
    assert f"run {wrong} left out" in str(found.left_out[0])
    quality = found.calibration.quality
    assert quality.verdict == "warn"
    (reason,) = (reason for reason in quality.reasons if "1 of 3 drives contradicts the others" in reason)
    # The drives are of successive days: the first or the last is another one if the sensor was moved.
    when = {0: "all earlier than those", 1: "was left out", 2: "all later than those"}[wrong]
    assert when in reason
    assert ("if the sensor was moved between 20" in reason) == (wrong != 1)
    without = combined(*(number for number in range(3) if number != wrong))
    assert found.calibration.T_utm_sensor == pytest.approx(without.calibration.T_utm_sensor, abs=2e-3)
    assert misplaced(found.calibration)[0] < 0.05


@pytest.mark.slow
@pytest.mark.parametrize("alike", [True, False])
def test_positions_of_another_place_on_the_vehicle_are_told_whether_drives_agree_or_not(alike: bool) -> None:
    """What both drives err by alike puts the sensor at one wrong place; by one drive alone it contradicts the other."""
    one, other = passages()[:2]
    mistaken = ahead(one, -2.2)
    if alike:
        epoch_ns = one.vehicle.epoch_ns + 5 * DAY_NS
        other = replace(mistaken, name="run 5", vehicle=replace(mistaken.vehicle, epoch_ns=epoch_ns))
    found = combine([mistaken, other])
    assert found.left_out == ()
    position_m, angle_deg = misplaced(found.calibration)
    assert position_m < 3 * found.calibration.quality.track_xy_sigma_m < 0.15
    assert angle_deg < 0.06
    told = [reason for reason in found.calibration.quality.reasons if "behind the point that --cam-reference" in reason]
    assert [reason.split(":")[0] for reason in told] == (["run 0", "run 5"] if alike else ["run 0"])


def test_two_drives_that_contradict_each_other_are_refused() -> None:
    drives = passages()[:2]
    with pytest.raises(CombineError, match="no majority of the 2 drives"):
        combine([drives[0], off_by(drives[1], 1.0, 0.0)])


def test_a_sensor_that_was_moved_between_the_drives_is_refused() -> None:
    drives = passages()
    ground = drives[0].ground
    higher = replace(drives[1], ground=replace(ground, height_m=ground.height_m + 0.2))
    with pytest.raises(CombineError, match=r"moved between the drives: in run 1 .*\+0\.2"):
        combine([drives[0], higher])
    found = combine([drives[0], higher, drives[2]]).calibration
    assert {each.name for each in found.passages} == {"run 0", "run 2"}
    assert found.quality.verdict == "warn"
    assert any(reason.startswith("run 1 left out: ") and "height +0.2" in reason for reason in found.quality.reasons)
    c, s = np.cos(np.radians(1.0)), np.sin(np.radians(1.0))
    tilted = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]) @ ground.normal
    with pytest.raises(CombineError, match=r"in run 1 its tilt is (0\.9|1\.0)\d deg"):
        combine([drives[0], replace(drives[1], ground=replace(ground, normal=tilted))])


@pytest.mark.slow
def test_another_origin_of_the_world_changes_nothing() -> None:
    drives = passages()[:2]
    own = drives[1].world
    far = World(own.crs, (own.origin_utm[0] + 300.0, own.origin_utm[1] - 200.0), own.grid_scale)
    xy, shift = (far.from_utm(own.to_utm(xy)) for xy in (drives[1].vehicle.xy, drives[1].match.shift[None]))
    moved = replace(
        drives[1],
        world=far,
        vehicle=replace(drives[1].vehicle, xy=xy),
        match=replace(drives[1].match, shift=shift[0]),
    )
    here, there = (found.calibration for found in (combined(0, 1), combine([drives[0], moved])))
    assert here.T_utm_sensor == pytest.approx(there.T_utm_sensor, abs=1e-4)


def test_the_same_drive_twice_is_refused() -> None:
    drive = passages()[0]
    with pytest.raises(EvidenceError, match="again: is the same drive as run 0"):
        combine([drive, replace(drive, name="again")])


def test_one_station_number_in_two_places_at_once_is_refused() -> None:
    drive = passages()[0]
    vehicle = replace(drive.vehicle, xy=drive.vehicle.xy + np.array([30.0, -40.0]))
    with pytest.raises(EvidenceError, match=r"again: is of the same time as run 0, .* \d+ is 50 m away from it"):
        combine([drive, replace(drive, name="again", vehicle=vehicle)])


def test_drives_of_different_zones_or_axes_are_refused() -> None:
    one, other = passages()[:2]
    zone = replace(other, world=replace(other.world, crs="EPSG:32633"))
    with pytest.raises(EvidenceError, match="run 1: positions in EPSG:32633; needed is EPSG:32632 as in run 0"):
        combine([one, zone])
    with pytest.raises(EvidenceError, match="run 1: the sensor's axes are"):
        combine([one, replace(other, axes=Axes((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))])


@pytest.mark.slow
@pytest.mark.parametrize("late_s", [-0.2, 0.2])
def test_each_drive_has_its_own_clock(late_s: float) -> None:
    one, other = (replace(passage, clock_sigma_s=1.0) for passage in passages()[:2])
    late = replace(other, vehicle=replace(other.vehicle, stamps_s=other.vehicle.stamps_s + late_s))
    before, after = combine([one, other]), combine([one, late])
    offsets = [{share.station_id: share.time_offset_s for share in found.shares} for found in (before, after)]
    sigma_s = max(share.time_sigma_s for share in after.shares)
    assert sigma_s < 0.02
    assert offsets[1][other.station_id] - offsets[0][other.station_id] == pytest.approx(late_s, abs=sigma_s)
    assert offsets[1][one.station_id] == pytest.approx(offsets[0][one.station_id], abs=sigma_s)


@cache
def cut() -> tuple[Calibration, list[Passage]]:
    """Calibrate with a steady drive, in one recording and in two that share it, and tell no accuracy of positions."""
    made = recorded()[2][0]
    times_s = made.recording.times_s
    halves = np.array_split(times_s, 2)
    whole, *parts = (calibrate(replace(made.recording, times_s=part), made.messages) for part in (times_s, *halves))
    return whole, [replace(each.passages[0], name=f"part {number}") for number, each in enumerate(parts)]


@pytest.mark.slow
def test_a_drive_that_is_cut_in_two_recordings_is_known_no_better_than_as_a_whole() -> None:
    whole, parts = cut()
    found = combine(parts)
    assert found.left_out == ()
    assert found.calibration.quality.weakest_sigma_m > 0.95 * whole.quality.weakest_sigma_m
    assert found.calibration.T_utm_sensor[:2, 3] == pytest.approx(
        whole.T_utm_sensor[:2, 3], abs=0.5 * whole.quality.weakest_sigma_m
    )


@pytest.mark.slow
def test_a_sender_errs_alike_on_all_days_and_others_in_part() -> None:
    """A steady drive does not tell the clocks' offset, nor how a sender stamps, nor where its antenna is.

    Errors of which a share lasts have a mean of four whose variance is that share and a quarter of the rest.
    """
    _, alone = recorded()[2]
    first = replace(alone.passages[0], name="first")

    def again(day: int, station: int) -> Passage:
        epoch_ns = first.vehicle.epoch_ns + day * DAY_NS
        return replace(first, name=f"day {day}", station_id=station, vehicle=replace(first.vehicle, epoch_ns=epoch_ns))

    same, others = (
        combine([first, *(again(day, first.station_id + way * day) for day in range(1, 4))]).calibration.quality
        for way in (0, 1)
    )
    least, most = (np.sqrt(share + (1.0 - share) / 4.0) for share in (LASTING_PLACE, SAME_SIZE))
    assert least < others.weakest_sigma_m / alone.quality.weakest_sigma_m < most
    assert same.weakest_sigma_m > 1.1 * others.weakest_sigma_m


@cache
def met(late_s: float) -> tuple[Calibration, Calibration, FloatArray]:
    """Calibrate with each of two cars that meet, by a clock that is late; return where the sensor is, UTM, as well."""
    recording, logs, truth = meeting(late_s)
    settings = Settings(joint=JointSettings(clock_sigma_s=0.03))
    one, other = (calibrate(recording, log, settings) for log in logs)
    return one, other, truth


@pytest.mark.slow
def test_in_one_recording_cars_that_meet_tell_the_clock_which_neither_does_alone() -> None:
    """What a late clock moves along the road it moves against the road for the one that comes the other way."""
    one, other, truth = met(0.03)
    for alone in (one, other):
        assert np.linalg.norm(alone.T_utm_sensor[:2, 3] - truth) > 0.15
    found = combine([replace(each.passages[0], name=str(each.drive.station_id)) for each in (one, other)])
    quality = found.calibration.quality
    assert np.linalg.norm(found.calibration.T_utm_sensor[:2, 3] - truth) < 0.05
    assert quality.track_xy_sigma_m < 0.5 * min(each.quality.track_xy_sigma_m for each in (one, other))
    for share in found.shares:
        assert share.time_offset_s == pytest.approx(0.03, abs=3 * share.time_sigma_s)
        assert share.time_sigma_s < 0.03 / 3
    first, second = found.shares
    assert first.time_offset_s == pytest.approx(second.time_offset_s, abs=0.003)


@pytest.mark.slow
def test_a_recording_s_clock_is_known_no_better_by_two_cars_that_follow_each_other() -> None:
    one, _, _ = met(0.03)
    passage = replace(one.passages[0], name="one")
    behind_ns = passage.vehicle.epoch_ns + 3_000_000_000
    follower = replace(passage, name="other", station_id=passage.station_id + 1)
    follower = replace(follower, vehicle=replace(follower.vehicle, epoch_ns=behind_ns))
    next_day = replace(follower, vehicle=replace(follower.vehicle, epoch_ns=follower.vehicle.epoch_ns + DAY_NS))
    together, apart = (combine([passage, each]).calibration.quality for each in (follower, next_day))
    assert together.track_xy_sigma_m == pytest.approx(one.quality.track_xy_sigma_m, rel=0.05)
    # Of two means, one share lasts and half of the rest remains.
    assert apart.track_xy_sigma_m < np.sqrt((1.0 + SAME_SIZE) / 2.0) * one.quality.track_xy_sigma_m


@pytest.mark.slow
def test_the_clocks_are_as_loose_as_in_the_loosest_drive() -> None:
    one, other = passages()[:2]
    tight = combine([one, other], Settings(joint=JointSettings(clock_sigma_s=1.0)))
    loose = combine([one, replace(other, clock_sigma_s=1.0)])
    assert tight.calibration.drive.clock_sigma_s == other.clock_sigma_s
    assert loose.calibration.drive.clock_sigma_s == 1.0
    # Without the prior, the information on a clock is less by what the prior tells.
    without = (tight.shares[0].time_sigma_s ** -2 - other.clock_sigma_s**-2) ** -0.5
    assert loose.shares[0].time_sigma_s == pytest.approx(without, rel=0.1)


@pytest.mark.slow
def test_a_combined_result_can_be_combined_further() -> None:
    third = passages()[2]
    stepwise = combine([*combined(0, 1).calibration.passages, third]).calibration
    at_once = combined(0, 1, 2).calibration
    assert stepwise.T_utm_sensor == pytest.approx(at_once.T_utm_sensor, abs=5e-3)
    assert len(stepwise.passages) == 3


def test_what_was_objected_to_a_drive_is_repeated_and_chance_is_refuted_by_a_drive_of_another_day() -> None:
    one, other = passages()[:2]
    doubted = replace(one, objections=("something rides along",), by_chance="it may be by chance")
    alone = combine([doubted]).calibration.quality
    assert alone.verdict == "warn"
    assert {"run 0: something rides along", "run 0: it may be by chance"} <= set(alone.reasons)
    both = combine([doubted, replace(other, objections=("something rides along",))]).calibration
    assert "run 0, run 1: something rides along" in {
        ", ".join(sorted(words.split(": ")[0].split(", "))) + ": " + words.split(": ")[1]
        for words in both.quality.reasons
    }
    assert not any("by chance" in reason for reason in both.quality.reasons)
    assert {each.by_chance for each in both.passages} == {"it may be by chance", ""}


def test_one_vehicle_under_two_station_numbers_is_one_drive() -> None:
    one = passages()[0]
    with pytest.raises(EvidenceError, match=r"is the same drive as run 0.*under another station number"):
        combine([one, replace(one, name="copy", station_id=777)])
