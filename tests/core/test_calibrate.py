from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.errors import BackgroundError, CamError, GroundError, InputError, MatchError, TrackError
from laci_stereo.core.frames import FloatArray, invert, rotate_xy, transform
from laci_stereo.core.messages.cam import CENTRE, VehicleTrack
from laci_stereo.core.messages.stations import world_around
from laci_stereo.core.result import Calibration
from laci_stereo.core.settings import Method, Settings
from tests.simulated import (
    CURVE,
    EPOCH_NS,
    EQUATOR,
    LEFT_TURN,
    RIGHT_TURN,
    STOP_AND_GO,
    STRAIGHT,
    SYDNEY,
    TROMSO,
    ULM,
    ZONE_BORDER,
    Drive,
    Recording,
    Scene,
    cam_log,
    car,
    lidar,
    pedestrian,
    scene,
    shrub,
    stereo,
    together,
)

pytestmark = pytest.mark.usefixtures("observed_once")

SHRUB = shrub((16.0, -6.0), 0.4, 0.8)
PASSER_BY = pedestrian(Drive((14.0, -9.0), 90.0, speeds=((0.0, 1.4),)))
OTHER_CAR = car(Drive((36.5, 16.0), -90.0, speeds=((0.0, 7.0),), start_s=0.5), 4.2, 1.75)


@dataclass(frozen=True)
class Errors:
    track_xy_m: float
    track_z_m: float
    rotation_deg: float
    yaw_deg: float


def errors(made: Scene, found: Calibration) -> Errors:
    """Compare with the truth in UTM, at the places on the road where the vehicle was used."""
    xy, _ = made.vehicle.drive.at(found.drive.track.stamps_s)
    sensor = transform(invert(made.recording.T_world_sensor), np.column_stack([xy, np.zeros(len(xy))]))
    utm = transform(found.T_utm_sensor, sensor)
    off = utm[:, :2] - made.place.to_utm(xy)
    R = found.T_world_sensor[:3, :3] @ made.recording.T_world_sensor[:3, :3].T
    return Errors(
        track_xy_m=float(np.sqrt((off**2).sum(axis=1).mean())),
        track_z_m=float(np.abs(utm[:, 2]).max()),
        rotation_deg=float(np.degrees(np.arccos(np.clip((np.trace(R) - 1) / 2, -1, 1)))),
        yaw_deg=float(np.degrees(np.arctan2(R[1, 0], R[0, 0]))),
    )


def check(made: Scene, found: Calibration, most_m: float = 0.25, most_deg: float = 0.3) -> None:
    """Within the reach of a method, and aware of how good it is."""
    error = errors(made, found)
    assert error.track_xy_m < most_m
    assert error.rotation_deg < most_deg
    assert error.track_z_m < 0.02
    assert error.track_xy_m < 3 * found.quality.track_xy_sigma_m
    assert abs(error.yaw_deg) < 3 * found.quality.yaw_sigma_deg
    assert found.quality.track_xy_sigma_m < 2.0
    assert found.drive.station_id == 42
    assert found.height_m == pytest.approx(6.0, abs=0.02)
    angles = found.viewing_angles
    assert (angles.down_deg, angles.roll_deg) == pytest.approx((14.0, 1.5), abs=0.05)
    values = np.linalg.eigvalsh(found.covariance)
    assert found.covariance == pytest.approx(found.covariance.T)
    assert values.min() >= 0.0


# Across the border of two zones and across the equator the user says which is meant.
SCENES: dict[str, tuple[Scene, str | None]] = {
    "lidar-left": (scene(LEFT_TURN, lidar(), ULM, others=[PASSER_BY]), None),
    "lidar-right": (scene(RIGHT_TURN, lidar(), SYDNEY, yaw_deg=-120.0, rate_hz=4.0), None),
    "lidar-late": (scene(replace(STRAIGHT, start_s=4.0), lidar(), ZONE_BORDER, 8.0, yaw_deg=170.0), "EPSG:32633"),
    "stereo-early": (scene(STRAIGHT, stereo(), EQUATOR, 8.0, others=[SHRUB]), "EPSG:32617"),
    "stereo-left": (scene(LEFT_TURN, stereo(), SYDNEY, yaw_deg=80.0, frames_hz=5.0), None),
    "stereo-curve": (scene(CURVE, stereo(), TROMSO, yaw_deg=-60.0), None),
}

FEW = ("lidar-left", "stereo-left")
NAMES = [*FEW, *(pytest.param(name, marks=pytest.mark.slow) for name in SCENES if name not in FEW)]


PAPER = Settings(method="paper")


@cache
def solved_by(method: Method, name: str) -> Calibration:
    made, crs = SCENES[name]
    return calibrate(made.recording, made.messages, Settings(method=method), crs=crs)


def solved(name: str, method: Method = "joint") -> Calibration:
    return solved_by(method, name)


@pytest.mark.parametrize("method", ["joint", pytest.param("paper", marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", NAMES)
def test_the_truth_is_found(name: str, method: Method) -> None:
    made, _ = SCENES[name]
    found = solved(name, method)
    within = {"joint": (0.25, 0.3), "paper": (0.8, 1.5)}[method]
    check(made, found, *within)
    assert found.drive.method == method
    assert found.world.crs == made.place.crs
    assert sum(found.quality.left_out.values()) + found.quality.frames_used == found.quality.frames_seen


@pytest.mark.parametrize("name", [FEW[0], *(pytest.param(name, marks=pytest.mark.slow) for name in [*SCENES][1:])])
def test_every_result_shows_what_the_paper_says(name: str) -> None:
    joint, paper = solved(name), solved(name, "paper")
    assert joint.paper is not None
    assert joint.paper.yaw_rad == paper.drive.match.yaw_rad
    assert joint.paper.shift == pytest.approx(paper.drive.match.shift)
    assert 0 < paper.quality.frames_used <= len(paper.drive.track.usable)


@pytest.mark.slow
@pytest.mark.parametrize(("method", "most"), [("joint", 1.5), ("paper", 1.5)])
def test_the_doubt_is_as_large_as_the_errors(method: Method, most: float) -> None:
    ratios = [
        errors(made, solved(name, method)).track_xy_m / solved(name, method).quality.track_xy_sigma_m
        for name, (made, _) in SCENES.items()
    ]
    assert 0.2 < np.sqrt(np.mean(np.square(ratios))) < most


@pytest.mark.slow
@pytest.mark.parametrize("sensor", [pytest.param(lidar(), id="lidar"), pytest.param(stereo(), id="stereo")])
def test_a_drive_that_stops_in_view(sensor: object) -> None:
    # All of the drive passes at the same side, so the paper's yaw is poor; and the result says so.
    made = scene(STOP_AND_GO, sensor, last_s=7.0)  # type: ignore[arg-type]
    check(made, calibrate(made.recording, made.messages))
    found = calibrate(made.recording, made.messages, PAPER)
    check(made, found, 0.8, 4.0)
    assert found.quality.verdict != "pass"
    assert found.quality.frames_used > 45


@pytest.mark.slow
def test_a_turned_world_gives_the_turned_answer() -> None:
    one, _ = SCENES["lidar-left"]
    other = scene(LEFT_TURN, lidar(), ULM, others=[PASSER_BY], yaw_deg=35.0 + 77.0)
    found_one, found_other = solved("lidar-left"), calibrate(other.recording, other.messages)
    T_one, T_other = (in_place(made, found) for made, found in ((one, found_one), (other, found_other)))
    turn = T_other[:3, :3] @ T_one[:3, :3].T
    assert np.degrees(np.arctan2(turn[1, 0], turn[0, 0])) == pytest.approx(77.0, abs=0.05)
    assert T_other[:3, 3] == pytest.approx(turn @ T_one[:3, 3], abs=0.03)
    assert found_one.quality.track_xy_sigma_m == pytest.approx(found_other.quality.track_xy_sigma_m, abs=0.02)


def in_place(made: Scene, found: Calibration) -> FloatArray:
    """Return ``T_world_sensor`` in the frame of the simulated place."""
    T = found.T_world_sensor.copy()
    utm = found.world.to_utm(T[None, :2, 3])[0]
    T[:2, 3] = (utm - made.place.origin_utm) / made.place.scale
    return T


@pytest.mark.slow
def test_traffic() -> None:
    made = scene(RIGHT_TURN, others=[OTHER_CAR, PASSER_BY, shrub((15.0, -4.0), 0.4, 0.8)], last_s=7.0)
    check(made, calibrate(made.recording, made.messages))


@pytest.mark.slow
def test_two_senders_in_view() -> None:
    made = scene(LEFT_TURN, others=[OTHER_CAR])
    other = cam_log(ULM, made.recording.movers[1], 6.0, station=7)
    found = calibrate(made.recording, together([made.messages, other]))
    assert found.drive.station_id in (7, 42)
    assert errors(made, found).track_xy_m < 1.0


@pytest.mark.slow
def test_a_roadside_unit_that_sends_too_is_no_vehicle() -> None:
    made = scene(LEFT_TURN)
    unit = cam_log(ULM, car(Drive((3.0, 2.0), 0.0, speeds=((0.0, 0.0),))), 6.0, rate_hz=1.0, station=900)
    nothing = np.full(len(unit), np.nan)
    unit = replace(unit, length_m=nothing, width_m=nothing, heading_deg=nothing, speed_mps=nothing)
    assert calibrate(made.recording, together([made.messages, unit])).drive.station_id == 42


@pytest.mark.slow
def test_the_reference_point_matters() -> None:
    made, _ = SCENES["lidar-left"]
    sent_centre = cam_log(ULM, made.vehicle, 6.0, reference=(0.0, 0.0))
    right = calibrate(made.recording, sent_centre, PAPER, reference=CENTRE)
    assert errors(made, right).track_xy_m == pytest.approx(
        errors(made, solved("lidar-left", "paper")).track_xy_m, abs=0.02
    )
    assert errors(made, calibrate(made.recording, sent_centre, PAPER)).track_xy_m > errors(made, right).track_xy_m + 0.5


@pytest.mark.slow
def test_a_wrong_reference_point_is_noticed_where_the_vehicle_turns() -> None:
    made, _ = SCENES["lidar-left"]
    found = calibrate(made.recording, cam_log(ULM, made.vehicle, 6.0, reference=(0.0, 0.0)))
    assert found.quality.verdict == "warn"
    (reason,) = (reason for reason in found.quality.reasons if "--cam-reference" in reason)
    # The positions are of the box's centre and were taken for its front.
    behind = float(reason.split()[4])
    assert 0.5 < behind < made.vehicle.length / 2 + 0.3  # the rest passes for the heading of a point farther ahead
    assert "behind" in reason
    assert not any("--cam-reference" in reason for reason in solved("lidar-left").quality.reasons)


@pytest.mark.slow
def test_another_zone_gives_the_same_place() -> None:
    made, _ = SCENES["lidar-late"]
    own = solved("lidar-late")
    found = calibrate(made.recording, made.messages, crs="EPSG:32632")
    assert found.world.crs == "EPSG:32632"
    # Grid north of the two zones differs by the convergence of both.
    turned = found.viewing_angles.yaw_deg - own.viewing_angles.yaw_deg
    assert turned % 360.0 == pytest.approx(2 * 3.0 * np.sin(np.radians(52.0)), abs=0.02)
    places = [result.world.to_geodetic(result.T_world_sensor[None, :2, 3])[0] for result in (found, own)]
    assert places[0] == pytest.approx(places[1], abs=2e-7)


def test_stamps_are_exact_far_from_1970() -> None:
    stamps = np.array(SCENES["lidar-left"][0].recording.stamps_ns)
    used = (solved("lidar-left").drive.track.stamps_s * 1e9).round().astype(np.int64) + stamps[0]
    assert np.isin(used, stamps).all()


# what cannot be calibrated


class Unsurveyed(Recording):
    def survey(self) -> Iterator[PointCloud]:
        return iter(())


def test_an_empty_survey() -> None:
    made = scene(last_s=1.0).recording
    with pytest.raises((GroundError, BackgroundError), match="0 whole frames"):
        calibrate(
            Unsurveyed(made.sensor, made.T_world_sensor, made.static, made.movers, made.times_s), scene().messages
        )


def test_no_vehicle_in_view() -> None:
    made = scene(LEFT_TURN)
    with pytest.raises(TrackError, match="no vehicle was found"):
        calibrate(replace(made.recording, movers=()), made.messages)


def test_messages_of_another_time() -> None:
    made = scene(LEFT_TURN)
    late = replace(made.messages, stamps_ns=made.messages.stamps_ns + 3_600_000_000_000)
    with pytest.raises(CamError, match="0 CAMs with a position fall into the recording's time"):
        calibrate(made.recording, late)


@pytest.mark.slow
def test_a_sender_elsewhere() -> None:
    made = scene(LEFT_TURN)
    with pytest.raises(MatchError, match="no moving object fits the CAMs"):
        calibrate(made.recording, cam_log(ULM, car(Drive((20.0, 0.0), 0.0, speeds=((0.0, 16.0),))), 6.0))


def test_a_sender_that_is_parked() -> None:
    made = scene(LEFT_TURN)
    with pytest.raises(TrackError, match="stands still"):
        calibrate(made.recording, cam_log(ULM, car(Drive((17.0, 9.5), 0.0, speeds=((0.0, 0.0),))), 6.0))


@pytest.mark.parametrize("change", [{"latitude_deg": -48.4}, {"longitude_deg": 0.9}, {"latitude_deg": 88.0}])
def test_a_wrong_position_does_not_choose_the_world(change: dict[str, float]) -> None:
    """Nor does the antimeridian: messages on both sides of it are near one another."""
    log = scene(LEFT_TURN).messages
    (name, value), middle = next(iter(change.items())), len(log) // 2
    told = getattr(log, name).copy()
    told[middle] = value
    wrong, right = world_around(replace(log, **{name: told})), world_around(log)
    assert wrong.crs == right.crs
    assert np.hypot(*np.subtract(wrong.origin_utm, right.origin_utm)) < 100.0
    fiji = replace(log, longitude_deg=np.where(np.arange(len(log)) % 2, -179.999, 179.999))
    assert world_around(fiji).crs in ("EPSG:32601", "EPSG:32660")


def test_the_world_needs_a_position() -> None:
    log = scene(last_s=1.0).messages
    with pytest.raises(InputError):
        world_around(replace(log, latitude_deg=np.full(len(log), np.nan)))


@pytest.mark.slow
def test_the_body_is_found_where_the_messages_tell_how_the_front_moves() -> None:
    made = scene(LEFT_TURN, lidar(32, 160), frames_hz=5.0, seed=1)
    mover = made.vehicle
    log = cam_log(made.place, mover, 6.0)

    def front(times: FloatArray) -> FloatArray:
        xy, yaw = mover.drive.at(times)
        return xy + rotate_xy(yaw, np.tile([mover.length / 2, 0.0], (len(times), 1)))

    sent_s = (log.stamps_ns - EPOCH_NS) / 1e9
    moved = front(sent_s + 0.01) - front(sent_s - 0.01)
    heading = made.place.heading_deg(front(sent_s), np.arctan2(moved[:, 1], moved[:, 0])) % 360.0
    found = calibrate(made.recording, replace(log, heading_deg=heading.round(1)))
    assert found.drive.body is not None

    def off_m(track: VehicleTrack) -> float:
        stamps_s = found.drive.track.stamps_s
        xy, _, known = track.at(stamps_s + found.drive.time_offset_s)
        true = found.world.from_utm(made.place.to_utm(mover.drive.at(stamps_s)[0]))
        return float(np.linalg.norm(xy - true, axis=1)[known].max())

    assert off_m(found.drive.vehicle) > 0.4
    assert off_m(found.drive.body) < 0.1
