from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.association.pieces import LARGEST_GAP_M, LEAST_FRAMES, whole
from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.errors import MatchError
from laci_stereo.core.frames import FloatArray, invert, rotate_xy, transform
from laci_stereo.core.result import Calibration
from laci_stereo.core.settings import Settings
from laci_stereo.core.tracking.sighting import KEPT_POINTS, together
from laci_stereo.core.tracking.tracks import Track
from tests.core.tracks import body_sighting, vehicle
from tests.simulated import LEFT_TURN, ULM, Drive, Mover, Scene, Solid, cam_log, scene

PASSES = Drive((24.0, 26.0), -90.0, speeds=((0.0, 8.0),))
TURNS = Drive((24.0, 26.0), -90.0, ((34.0, 0.0), (14.0, -80.0)), ((0.0, 8.0),))
BUS, CAR = (12.0, 2.5), (4.6, 1.8)


def part(first_m: float, last_m: float, width_m: float = 2.5, top_m: float = 3.0) -> Solid:
    """What is seen of a vehicle from so far to so far ahead of its middle."""
    return Solid(((first_m + last_m) / 2, 0.0), 0.0, last_m - first_m, width_m, 0.3, top_m)


CARAVAN = (part(-2.3, 2.3, 1.8, 1.5), part(-9.0, -3.6, 2.3, 2.6))


def seen_as(parts: tuple[Solid, ...], told: tuple[float, float], drive: Drive = PASSES) -> Scene:
    """A vehicle that sends one size, and of which only some parts send light back."""
    made = scene(drive, yaw_deg=0.0)
    recording = replace(made.recording, movers=(Mover(drive, parts),)).turned(float(np.radians(35.0)))
    sends = Mover(recording.movers[0].drive, (Solid((0.0, 0.0), 0.0, *told, 0.3, 3.0),))
    return Scene(made.place, recording, cam_log(ULM, sends, 6.0, 10.0))


def calibrated(made: Scene) -> Calibration:
    return calibrate(made.recording, made.messages, crs=ULM.crs)


def error_m(made: Scene, found: Calibration) -> float:
    """Root mean square along the vehicle's way."""
    xy, _ = made.vehicle.drive.at(found.drive.track.stamps_s)
    level = np.column_stack([xy, np.zeros(len(xy))])
    off = transform(found.T_utm_sensor, transform(invert(made.recording.T_world_sensor), level))[:, :2] - ULM.to_utm(xy)
    return float(np.sqrt((off**2).sum(axis=1).mean()))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gap_m", "drive"),
    [
        (1.0, TURNS),
        (1.8, PASSES),
        (1.0, PASSES),
        (1.8, TURNS),
    ],
)
def test_a_bus_whose_middle_is_dark_is_one_vehicle(drive: Drive, gap_m: float) -> None:
    made = seen_as((part(-6.0, 2.0 - gap_m), part(2.0, 6.0)), BUS, drive)
    found = calibrated(made)
    assert found.quality.verdict == "pass"
    assert error_m(made, found) < 3.0 * found.quality.track_xy_sigma_m
    assert np.quantile([one.box.length_m for one in found.drive.track.usable], 0.9) == pytest.approx(12.0, abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("piece", [pytest.param(part(-6.0, 1.4), id="rear"), pytest.param(part(-1.0, 6.0), id="front")])
def test_a_piece_of_a_bus_is_no_whole_one(piece: Solid) -> None:
    made = seen_as((piece,), BUS)
    found = calibrated(made)
    assert found.quality.verdict == "fail"
    (reason,) = (one for one in found.quality.reasons if "never seen, although" in one)
    assert "of the vehicle's 12.0 m were never seen, although its side was" in reason
    assert error_m(made, found) < min(12.0 - piece.length + 0.5, 2.0 * found.quality.track_xy_sigma_m)
    assert "an end of the vehicle was never seen" in found.quality.advice


@pytest.mark.slow
def test_of_a_vehicle_that_is_as_long_as_it_tells_nothing_is_missing() -> None:
    found = calibrated(seen_as((part(-2.3, 2.3, *CAR[1:]),), CAR, LEFT_TURN))
    assert found.quality.verdict == "pass"


@pytest.mark.slow
@pytest.mark.parametrize("drive", [PASSES, LEFT_TURN])
def test_what_a_car_tows_is_warned_of(drive: Drive) -> None:
    made = seen_as(CARAVAN, CAR, drive)
    found = calibrated(made)
    assert found.quality.verdict == "warn"
    assert any("something else moves with the vehicle, right behind or ahead" in one for one in found.quality.reasons)
    assert error_m(made, found) < 3.0 * found.quality.track_xy_sigma_m


@pytest.mark.slow
def test_of_two_that_move_as_one_the_sender_is_the_one_ahead() -> None:
    """Of the car the rear is not seen, so that its caravan is more like what it tells: 5.3 m off if it is taken."""
    made = seen_as((part(-1.5, 2.3, 1.7, 0.8), part(-7.6, -3.0, 1.8, 2.6)), CAR)
    found = calibrated(made)
    assert any("something else moves with the vehicle" in one for one in found.quality.reasons)
    assert error_m(made, found) < 3.0 * found.quality.track_xy_sigma_m


@pytest.mark.slow
def test_where_either_of_two_may_be_the_vehicle_it_is_refused() -> None:
    # The length that is told is neither the car's, nor the caravan's, nor that of both.
    with pytest.raises(MatchError, match=r"moves with the vehicle.*were never seen.*which of them is the vehicle"):
        calibrated(seen_as((part(-0.9, 3.5, 2.1), part(-7.6, -2.2, 2.1)), (7.0, 2.1), LEFT_TURN))


@pytest.mark.slow
def test_beside_another_in_the_next_lane_nothing_is_towed() -> None:
    beside = Solid((1.0, 3.3), 0.0, *CAR, 0.3, 1.5)
    made = seen_as((part(-2.3, 2.3, *CAR[1:], 1.5), beside), CAR, LEFT_TURN)
    assert not any("moves with" in one for one in calibrated(made).quality.reasons)


# Tracks made by hand: points along a body that drives along x.

FRAMES_S = 0.1 * np.arange(20)


def body(first_m: float, last_m: float, width_m: float = 2.0) -> FloatArray:
    along = np.arange(first_m, last_m + 0.01, 0.1)
    return np.column_stack([along, np.where(np.arange(len(along)) % 2, 0.5, -0.5) * width_m, np.ones(len(along))])


def driving(points: FloatArray, speed_mps: float = 10.0, yaw_rad: float = 0.0) -> Track:
    sightings = []
    for stamp_s in FRAMES_S.tolist():
        at = points + np.array([speed_mps * stamp_s, 0.0, 0.0])
        at[:, :2] = rotate_xy(yaw_rad, at[:, :2])
        sightings.append(body_sighting(stamp_s, at))
    return Track(tuple(sightings))


def joined(tracks: list[Track], length_m: float = 12.0, width_m: float = 2.5) -> list[Track]:
    return whole(tracks, [vehicle(size=(length_m, width_m))], Settings())


REAR, FRONT = body(-6.0, 0.0), body(1.0, 6.0)


@pytest.mark.parametrize("yaw_rad", [0.0, 0.4, 1.2, 2.5, -1.5])
def test_pieces_are_joined_whichever_way_they_drive(yaw_rad: float) -> None:
    tracks = [driving(REAR, yaw_rad=yaw_rad), driving(FRONT, yaw_rad=yaw_rad)]
    (one,) = joined(tracks)
    assert len(one.sightings) == len(FRAMES_S)
    assert one.sightings[0].count == len(REAR) + len(FRONT)
    assert one.sightings[0].box.length_m == pytest.approx(12.0, abs=0.1)


def test_in_whatever_order_they_come() -> None:
    parts = [driving(body(-6.0, -2.5)), driving(body(-1.0, 1.5)), driving(body(3.0, 6.0))]
    for order in ([0, 1, 2], [2, 0, 1], [1, 2, 0]):
        assert len(joined([parts[index] for index in order])) == 1


def test_what_is_seen_of_one_piece_alone_is_kept() -> None:
    front = driving(FRONT)
    (one,) = joined([driving(REAR), front.where(FRAMES_S > 0.45)])
    assert [sighting.count for sighting in one.sightings[:5]] == [len(REAR)] * 5
    assert [sighting.count for sighting in one.sightings[5:]] == [len(REAR) + len(FRONT)] * 15


@pytest.mark.parametrize(
    "other",
    [
        driving(body(0.0 + LARGEST_GAP_M + 0.2, 5.0)),
        driving(body(1.0, 9.0)),
        driving(FRONT + np.array([-4.0, 3.0, 0.0])),
        driving(FRONT, 5.0),
        driving(FRONT).where(np.arange(len(FRAMES_S)) < LEAST_FRAMES - 1),
    ],
    ids=["too far ahead", "too long together", "side by side", "slower", "too seldom"],
)
def test_what_may_be_another_vehicle_is_not_joined(other: Track) -> None:
    assert len(joined([driving(REAR), other])) == 2


def test_what_folds_in_a_bend_is_one_by_what_is_seen_of_it_straight() -> None:
    trailer, cab, hitch = body(-7.8, 4.4, 2.5), body(5.4, 7.8, 2.5), np.array([4.0, 0.0])
    pulls = driving(cab)
    turned = [
        replace(one, points=np.column_stack([rotate_xy(yaw_rad, cab[:, :2] - hitch) + hitch + at, cab[:, 2]]))
        for one, yaw_rad in zip(pulls.sightings, np.clip(3.0 * (FRAMES_S - 0.6), 0.0, 1.2), strict=True)
        for at in [np.array([10.0 * one.stamp_s, 0.0])]
    ]
    tracks = [driving(trailer), Track(tuple(turned))]
    bends = Drive((0.0, 0.0), 0.0, ((5.0, 0.0), (12.0, 70.0)), ((0.0, 8.0),))
    for drive, pieces in ((bends, 1), (PASSES, 2)):
        folds = vehicle(drive, size=(15.6, 2.5))
        assert folds.folded.any() == (drive is bends)
        assert len(whole(tracks, [folds], Settings())) == pieces


def test_what_looks_too_long_at_times_is_joined() -> None:
    front = driving(FRONT)
    for share, pieces in ((0.3, 1), (0.7, 2)):
        longer = np.arange(len(FRAMES_S)) < share * len(FRAMES_S)
        noisy = [
            replace(
                one, points=one.points + [[3.0 * far * (at == len(FRONT) - 1), 0.0, 0.0] for at in range(len(FRONT))]
            )
            for one, far in zip(front.sightings, longer, strict=True)
        ]
        assert len(joined([driving(REAR), Track(tuple(noisy))])) == pieces


def test_what_hardly_moves_is_not_joined() -> None:
    assert len(joined([driving(REAR, 5.0), driving(FRONT, 5.0)])) == 2
    assert len(joined([driving(REAR, 6.5), driving(FRONT, 6.5)])) == 1


def test_what_comes_into_view_bit_by_bit_is_joined() -> None:
    whole_rear = driving(REAR, 6.5)
    begins = np.linspace(-0.6, -6.0, len(FRAMES_S))
    emerging = [
        replace(one, points=part_of, middle=np.median(part_of[:, :2], axis=0))
        for one, begin in zip(whole_rear.sightings, begins, strict=True)
        for part_of in [one.points[one.points[:, 0] > 6.5 * one.frame_s + begin]]
    ]
    assert np.ptp([one.middle[0] for one in emerging]) < 12.0 < np.ptp([one.middle[0] for one in whole_rear.sightings])
    assert len(joined([Track(tuple(emerging)), driving(FRONT, 6.5)])) == 1


def test_two_pieces_count_as_their_points_do() -> None:
    (big, *_), (small, *_) = driving(body(-6.0, 0.0)).sightings, driving(body(1.0, 2.0)).sightings
    one = together(small, replace(big, count=50 * len(small.points)), Settings())
    assert one.count == 51 * len(small.points)
    assert len(one.points) <= KEPT_POINTS + 2
    assert np.count_nonzero(one.points[:, 0] > 0.5) <= KEPT_POINTS / 51 + 2
    assert one.middle[0] < 0.0


def test_times_of_points_stay_what_they_were() -> None:
    (big, *_), (small, *_) = driving(REAR).sightings, driving(FRONT).sightings
    big = replace(big, stamp_s=0.2, late_s=np.linspace(-0.01, 0.01, len(big.points)))
    small = replace(small, stamp_s=0.23, late_s=np.zeros(len(small.points)))
    one = together(big, small, Settings())
    assert 0.2 < one.stamp_s < 0.23
    times_s = one.stamp_s + np.asarray(one.late_s)
    assert times_s[one.points[:, 0] > 0.5] == pytest.approx(0.23)
    assert times_s[one.points[:, 0] < 0.5].min() == pytest.approx(0.19)
    assert times_s[one.points[:, 0] < 0.5].max() == pytest.approx(0.21)
