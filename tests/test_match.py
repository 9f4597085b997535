"""Boxes of a detector and messages of a vehicle, through Python and through the installed command."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator

from laci_stereo.core.errors import GroundError, InputError, MatchError
from laci_stereo.core.messages.cam import CamLog
from laci_stereo.core.settings import Settings
from laci_stereo.core.tracking.box_point import BoxPoint
from laci_stereo.io.result.calibration_file import schema
from laci_stereo.job import Result
from laci_stereo.match import MatchOptions, match, prepare
from tests.cli_support import document_in, refusal, refused, run, run_installed
from tests.detections import (
    EXACT,
    Noise,
    Passing,
    Rows,
    Traffic,
    by_bottom,
    by_point,
    cam_rows,
    cars_and_vans,
    detection_rows,
    errors,
    is_senders,
    traffic,
)
from tests.io.cam_writers import write_gpx, write_nmea
from tests.simulated import Drive

NOT_CALIBRATED, UNUSABLE = 1, 2
SEEDS = range(100, 110)
TURNS = 104
"""A seed whose sender turns."""
PERHAPS = [(108, 0.1), (108, -0.1), (113, -0.1), (115, 0.1)]
"""Seeds whose senders drive nearly straight and steadily, and by how much clocks are off."""


@dataclass(frozen=True)
class Site:
    """A folder with the two logs of some traffic."""

    root: Path
    made: Traffic

    @property
    def detections(self) -> Path:
        return self.root / "detections.csv"

    @property
    def cam(self) -> Path:
        return self.root / "cam.csv"

    @property
    def out(self) -> Path:
        return self.root / "result"

    def document(self) -> dict[str, Any]:
        return document_in(self.out)

    def arguments(self, *options: str) -> list[str]:
        return ["match", str(self.detections), str(self.cam), "--out", str(self.out), *options]

    def refused(self, code: int, *words: str, options: tuple[str, ...] = ()) -> None:
        refused(lambda: run(self.arguments(*options), self.root), self.root, code, *words)


def lay(folder: Path, made: Traffic, track_ids: bool = True) -> Site:
    site = Site(folder, made)
    detection_rows(made, track_ids).write(site.detections)
    cam_rows(made.messages).write(site.cam)
    return site


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return lay(tmp_path, traffic(SEEDS[0]))


def matched(folder: Path, made: Traffic, options: MatchOptions | None = None, track_ids: bool = True) -> Result:
    site = lay(folder, made, track_ids)
    return match(site.detections, site.cam, options)


# ------------------------------------------------------------------------------------- how well it does


@pytest.mark.slow
def test_boxes_whose_y_points_to_the_right(tmp_path: Path) -> None:
    site = lay(tmp_path, traffic(TURNS))
    rows, log = detection_rows(site.made), site.made.detections
    rows.column("y", (-log.points_sensor[:, 1]).round(4).tolist())
    rows.column("yaw", (-log.yaw_rad).round(4).tolist())
    rows.write(site.detections)
    site.refused(NOT_CALIBRATED, "with left and right exchanged", "left-handed", "y left", options=("--quiet",))


def test_an_angle_that_is_known_worse_than_asked_for_is_a_fail_which_is_written_to_be_looked_at(site: Site) -> None:
    ran = run(site.arguments("--max-sigma-deg", "0.0001"), site.root)
    assert ran.code == NOT_CALIBRATED, ran
    assert "the verdict is fail: yaw is known to" in ran.err
    quality = site.document()["quality"]
    assert (quality["verdict"], len(quality["reasons"])) == ("fail", 2)


@pytest.mark.slow
def test_a_stranger_that_appears_where_the_sender_is_lost_says_nothing(tmp_path: Path) -> None:
    """By another motion it fits the messages a little, as one of many may by chance."""
    made = traffic(522)
    assert is_senders(made, matched(tmp_path, made, track_ids=False).calibration)


@pytest.mark.parametrize("seeds", [SEEDS[:3], pytest.param(SEEDS, marks=pytest.mark.slow)], ids=len)
@pytest.mark.parametrize("track_ids", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_one_vehicle_among_thirty_tells_where_the_sensor_is(
    tmp_path: Path, track_ids: bool, seeds: Sequence[int]
) -> None:
    found = []
    for seed in seeds:
        made = traffic(seed)
        calibration = matched(tmp_path, made, track_ids=track_ids).calibration
        assert is_senders(made, calibration)
        error = errors(made, calibration)
        assert error.track_xy_m < 3 * calibration.quality.track_xy_sigma_m
        assert abs(error.yaw_deg) < 3 * calibration.quality.yaw_sigma_deg
        assert calibration.height_m == pytest.approx(made.T_world_sensor[2, 3], abs=0.05)
        found.append((error.track_xy_m, error.rotation_deg))
    position_m, angle_deg = np.median(found, axis=0)
    assert position_m < 0.15
    assert angle_deg < 0.3


@pytest.mark.parametrize(
    ("seed", "late_s"),
    [
        (103, 0.1),
        (106, -0.1),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in ((103, -0.1), (106, 0.1))),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in product((100, 101, 102, 105, 109), (0.1, -0.1))),
        pytest.param(107, 0.1, marks=pytest.mark.slow),
    ],
)
def test_a_clock_that_nobody_set_is_told_where_speed_changes(tmp_path: Path, seed: int, late_s: float) -> None:
    """To 25 ms at the least; and without a turn, in which it may look like another place on the vehicle."""
    made = traffic(seed)
    sent = replace(made.messages, stamps_ns=made.messages.stamps_ns + round(late_s * 1e9))
    found = matched(tmp_path, replace(made, messages=sent)).calibration
    assert is_senders(made, found)
    assert errors(made, found).track_xy_m < 3 * found.quality.track_xy_sigma_m
    assert abs(found.drive.time_offset_s - late_s) < 3 * found.time_sigma_s
    assert found.quality.verdict == "warn"
    assert any("the clocks are" in reason for reason in found.quality.reasons)


@pytest.mark.slow
def test_in_a_turn_a_late_clock_may_look_like_another_place_on_the_vehicle_with_the_same_result(tmp_path: Path) -> None:
    made = traffic(107)
    sent = replace(made.messages, stamps_ns=made.messages.stamps_ns - round(0.1 * 1e9))
    found = matched(tmp_path, replace(made, messages=sent)).calibration
    assert errors(made, found).track_xy_m < 3 * found.quality.track_xy_sigma_m < 0.4
    assert any("the point that --cam-reference gives" in reason for reason in found.quality.reasons)


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "late_s"), PERHAPS)
def test_a_clock_that_was_perhaps_not_set_is_a_doubt(tmp_path: Path, seed: int, late_s: float) -> None:
    """Where it is known worse than to 25 ms; whoever says that clocks are unknown gets the right result."""
    made = traffic(seed)
    sent = replace(made, messages=replace(made.messages, stamps_ns=made.messages.stamps_ns + round(late_s * 1e9)))
    found = matched(tmp_path, sent).calibration
    assert found.quality.verdict == "warn"
    assert any("a clock offset of" in reason and "--clock unknown" in reason for reason in found.quality.reasons)
    unknown = Settings().with_clock(1.0)
    found = matched(tmp_path, sent, MatchOptions(core=unknown)).calibration
    assert errors(sent, found).track_xy_m < 3 * found.quality.track_xy_sigma_m
    assert abs(found.drive.time_offset_s - late_s) < 3 * found.time_sigma_s


@pytest.mark.slow
def test_messages_that_pause_while_the_vehicle_is_seen(tmp_path: Path) -> None:
    """From so soon that one half of the drive has a frame or two, or none, at which its place is known."""
    made = traffic(SEEDS[0])
    begin_ns = np.sort(made.detections.stamps_ns[made.of_vehicle == 0])[0]
    for first_s in (0.2, 0.4, 0.6, 0.8, 1.0):
        late = made.messages.stamps_ns - begin_ns
        kept = (late < first_s * 1e9) | (late > 7.0e9)
        found = matched(tmp_path, replace(made, messages=made.messages[kept])).calibration
        assert errors(made, found).track_xy_m < 3 * found.quality.track_xy_sigma_m


def test_exact_boxes_give_the_exact_transform(tmp_path: Path) -> None:
    """Up to the messages' resolution (1 cm, 0.1 deg) and the spline between them; and what was claimed covers it."""
    for seed in (1, 2, 3):
        made = traffic(seed, 5, EXACT)
        calibration = matched(tmp_path, made).calibration
        error = errors(made, calibration)
        assert error.track_xy_m < 0.03
        assert error.rotation_deg < 0.1
        assert calibration.quality.verdict == "pass"


def levelled(made: Traffic, height_m: float) -> Traffic:
    """Return the same traffic, seen by a sensor that is level."""
    level = np.eye(4)
    level[:2, :2] = made.T_world_sensor[:2, :2] / np.linalg.norm(made.T_world_sensor[:2, 0])
    level[:2, 1] = [-level[1, 0], level[0, 0]]
    level[2, 3] = height_m
    world = made.detections.points_sensor @ made.T_world_sensor[:3, :3].T + made.T_world_sensor[:3, 3]
    points = (world - level[:3, 3]) @ level[:3, :3]
    return replace(made, T_world_sensor=level, detections=replace(made.detections, points_sensor=points))


@pytest.mark.slow
def test_another_yaw_of_the_sensor_is_another_yaw_of_the_result(tmp_path: Path) -> None:
    made = levelled(traffic(3, 8), 6.0)
    turned_rad = 0.7
    c, s = np.cos(turned_rad), np.sin(turned_rad)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    log = made.detections
    other = replace(
        made, detections=replace(log, points_sensor=log.points_sensor @ R.T, yaw_rad=log.yaw_rad + turned_rad)
    )
    level = MatchOptions(level_m=6.0)
    here, there = (matched(tmp_path, one, level).calibration.T_world_sensor for one in (made, other))
    # The files hold tenths of millimetres.
    assert there[:3, :3] @ R == pytest.approx(here[:3, :3], abs=1e-5)
    assert there[:3, 3] == pytest.approx(here[:3, 3], abs=1e-3)


@pytest.mark.parametrize("position_m", [0.0, pytest.param(0.3, marks=pytest.mark.slow)])
def test_level_that_the_boxes_contradict_is_refused(tmp_path: Path, position_m: float) -> None:
    """The road rises by 4 % across the sensor's way; what is told is right, or 2 m too low."""
    made = levelled(traffic(6, 10, Noise(position_m=position_m)), 6.0)
    points = made.detections.points_sensor.copy()
    points[:, 2] += 0.04 * points[:, 0]
    site = lay(tmp_path, replace(made, detections=replace(made.detections, points_sensor=points)))
    words = ("detections.csv: the boxes stand 6.", "m below the sensor", "--level is 4 m: needed is one height")
    site.refused(UNUSABLE, *words, options=("--level", "4"))
    assert match(site.detections, site.cam, MatchOptions(level_m=6.0)).calibration.height_m == 6.0
    notes = match(site.detections, site.cam, MatchOptions(level_m=6.0)).job.provenance.notes
    assert any(re.search(r"by the boxes' z it falls or rises by (3\.[5-9]|4\.[0-5])%", note) for note in notes)
    detection_rows(made).without("z").write(site.detections)
    assert match(site.detections, site.cam, MatchOptions(level_m=4.0)).calibration.height_m == 4.0


def test_level_that_the_boxes_doubt_is_known_worse(tmp_path: Path) -> None:
    """By 7 %, as few roads rise: the tilt is off by nothing, or by all of it."""
    made = levelled(traffic(6, 10), 6.0)
    points = made.detections.points_sensor.copy()
    points[:, 2] += 0.07 * points[:, 0]
    tilted = replace(made, detections=replace(made.detections, points_sensor=points))
    level = MatchOptions(level_m=6.0)
    right, doubted = (matched(tmp_path, one, level).calibration.quality for one in (made, tilted))
    assert right.tilt_sigma_deg == pytest.approx(0.25)
    assert not any("--level" in reason for reason in right.reasons)
    assert doubted.verdict == "warn"
    assert any("falls or rises by 7." in one and "not level as --level says" in one for one in doubted.reasons)
    assert doubted.tilt_sigma_deg == pytest.approx(4.0 / np.sqrt(2.0), abs=0.2)


def test_a_sensor_that_is_tilted_by_more_than_roads_is_not_level(tmp_path: Path) -> None:
    """By 9 deg, and so high above the middle of the boxes as is told."""
    made = levelled(traffic(6, 10), 6.0)
    points = made.detections.points_sensor.copy()
    points[:, 2] += np.tan(np.radians(9.0)) * points[:, 0]
    site = lay(tmp_path, replace(made, detections=replace(made.detections, points_sensor=points)))
    words = (
        "detections.csv: the ground below the boxes falls or rises by 16%, 9.",
        "level to 0.25 deg",
        "needed is no --level",
    )
    site.refused(UNUSABLE, *words, options=("--level", "6"))


@pytest.mark.slow
def test_boxes_by_the_middle_of_their_bottom(tmp_path: Path) -> None:
    made = traffic(5, 8)
    log, up = made.detections, made.T_world_sensor[2, :3]
    bottom = replace(made, detections=replace(log, points_sensor=log.points_sensor - log.above_ground_m[:, None] * up))
    by_centre = matched(tmp_path, made).calibration
    by_bottom = matched(tmp_path, bottom, MatchOptions(box_origin="bottom")).calibration
    wrong = matched(tmp_path, bottom).calibration
    assert by_bottom.T_world_sensor == pytest.approx(by_centre.T_world_sensor, abs=2e-3)
    assert wrong.height_m - by_bottom.height_m == pytest.approx(log.above_ground_m.mean(), abs=0.1)


@pytest.mark.parametrize(
    "point", [*(pytest.param(point, marks=pytest.mark.slow) for point in ("front", "rear", "near-end")), "near-corner"]
)
def test_boxes_by_another_point_seen_from_above(tmp_path: Path, point: BoxPoint) -> None:
    made = traffic(TURNS)
    other = by_point(made, point)
    at_all = np.linalg.norm(other.detections.points_sensor - made.detections.points_sensor, axis=1)
    assert at_all.min() > 1.0
    found = matched(tmp_path, other, MatchOptions(box_point=point)).calibration
    assert errors(made, found).track_xy_m < 0.05
    assert found.quality.verdict == "pass"


@pytest.mark.slow
def test_another_point_is_named_where_a_turn_shows_it(tmp_path: Path) -> None:
    site = lay(tmp_path, by_point(traffic(TURNS), "near-corner"))
    ran = run(site.arguments(), site.root)
    assert "if the boxes' positions were not of their centres, station 42 would match" in ran.out + ran.err
    assert "--box-point near-corner" in ran.out + ran.err


@pytest.mark.slow
def test_only_boxes_have_another_point(tmp_path: Path) -> None:
    site = lay(tmp_path, by_point(traffic(TURNS), "rear"))
    rows = detection_rows(site.made)
    unknown = [str(length) if i % 5 else "" for i, length in enumerate(site.made.detections.length_m)]
    rows.column("length", unknown)
    rows.write(site.detections)
    task = prepare(site.detections, site.cam, MatchOptions(box_point="rear"))
    assert len(task.detections) == sum(map(bool, unknown))
    notes = task.provenance.notes
    dropped = f"{unknown.count('')} of {len(unknown)} detections dropped, which lack yaw, length or width"
    assert any(note.startswith(dropped) for note in notes)
    assert any(note == "x and y taken for the rear of the boxes (--box-point)" for note in notes)
    rows.without("length").write(site.detections)
    site.refused(UNUSABLE, "has yaw, length and width", "--box-point rear", options=("--box-point", "rear"))


@pytest.mark.slow
def test_the_wrong_point_of_the_boxes_is_a_doubt(tmp_path: Path) -> None:
    made = traffic(3, vehicles=cars_and_vans())
    bottom = MatchOptions(box_origin="bottom")
    unknown = Settings().with_clock(1.0)
    for right, wrong, options in ((made, by_bottom(made), MatchOptions()), (by_bottom(made), made, bottom)):
        options = replace(options, core=unknown)
        reasons = [matched(tmp_path, one, options).calibration.quality.reasons for one in (right, wrong)]
        other = "bottom" if options.box_origin == "centre" else "centre"
        assert not any("--box-origin" in reason for reason in reasons[0])
        assert any(f"needed is --box-origin {other}" in reason for reason in reasons[1])


def test_a_refusal_names_the_wrong_point_of_the_boxes(tmp_path: Path) -> None:
    site = lay(tmp_path, by_bottom(traffic(3, vehicles=cars_and_vans())))
    words = ("not calibrated: ", "objects of different heights are ", "needed is --box-origin bottom")
    core = Settings()
    strict = replace(core, ground=replace(core.ground, max_tilt_sigma_deg=0.001))
    with pytest.raises(GroundError, match=f".*{words[1]}.*{words[2]}"):
        match(site.detections, site.cam, MatchOptions(core=strict))
    # And where a ground is found, but no vehicle.
    cam_rows(traffic(4).messages).write(site.cam)
    site.refused(NOT_CALIBRATED, *words, options=("-q",))


def test_a_z_that_points_down_is_told(tmp_path: Path) -> None:
    made = traffic(SEEDS[0])
    log = made.detections
    down = replace(
        made, detections=replace(log, points_sensor=log.points_sensor * [1.0, -1.0, -1.0], yaw_rad=-log.yaw_rad)
    )
    site = lay(tmp_path, down)
    site.refused(NOT_CALIBRATED, "plane below the boxes", "there is a ground with --axes 'z down'", options=("-q",))
    assert run(site.arguments("--axes", "z down"), site.root).code == 0


def across(made: Traffic) -> Traffic:
    """Return the boxes with yaws that count from y."""
    return replace(made, detections=replace(made.detections, yaw_rad=made.detections.yaw_rad - np.pi / 2))


def test_yaws_across_the_motion_are_named_where_nothing_fits(tmp_path: Path) -> None:
    site = lay(tmp_path, across(traffic(5, 8)))
    site.refused(NOT_CALIBRATED, "the boxes' longer sides are ", "off the direction of their motion", options=("-q",))


def test_yaws_across_the_motion_are_named_where_the_centres_fit(tmp_path: Path) -> None:
    made = traffic(SEEDS[0])
    found = matched(tmp_path, across(made)).calibration
    assert errors(made, found).track_xy_m < 3.0 * found.quality.track_xy_sigma_m
    assert any("the boxes' longer sides are " in remark for remark in found.found)


def test_radial_speeds_of_the_other_sign_are_noted_where_the_result_is_right(tmp_path: Path) -> None:
    """From the boxes' own motion, and at so few of them that they do not decide."""
    made = traffic(TURNS)
    site = lay(tmp_path, made)
    rows, log = detection_rows(made), made.detections
    level_xy = (log.points_sensor @ made.T_world_sensor[:3, :3].T)[:, :2]
    towards = np.full(len(log), np.nan)
    for number in set(made.of_vehicle.tolist()) - {0}:
        its = np.flatnonzero(made.of_vehicle == number)
        if len(its) > 1:
            towards[its] = -np.gradient(np.linalg.norm(level_xy[its], axis=1), log.stamps_ns[its] / 1e9)
    rows.column("radial_speed", ["" if np.isnan(speed) else f"{speed:.2f}" for speed in towards])
    rows.write(site.detections)
    ran = run(site.arguments(), site.root)
    assert ran.code == 0, ran
    assert "needed is a speed that is positive away from the sensor" in ran.err
    assert any("positive away from the sensor" in note for note in site.document()["notes"])


def test_a_radar_with_neither_size_nor_height(tmp_path: Path) -> None:
    """Level, 5 m high, and what it detects is the vehicle's middle; that this cannot be known is said."""
    radar = levelled(traffic(6, 10, Noise(position_m=0.3)), 5.0)
    site = lay(tmp_path, radar)
    rows = detection_rows(radar).without("z", "yaw", "length", "width", "height", "track_id")
    rows.write(site.detections)
    result = match(site.detections, site.cam, MatchOptions(level_m=5.0))
    error, quality = errors(radar, result.calibration), result.calibration.quality
    assert is_senders(radar, result.calibration)
    assert error.track_xy_m < 0.3
    assert error.rotation_deg < 1.0
    assert quality.verdict == "warn"
    assert any("taken for the vehicle's centre" in reason and "off by up to 2." in reason for reason in quality.reasons)
    assert result.calibration.height_m == 5.0
    assert any("taken for points at the vehicle's centre" in note for note in result.job.provenance.notes)


@pytest.mark.parametrize("seed", [6, pytest.param(8, marks=pytest.mark.slow)])
def test_a_vehicle_that_is_longer_than_its_messages_report_is_a_doubt(tmp_path: Path, seed: int) -> None:
    """Its middle is farther behind its front, by half of that."""
    made = traffic(seed, 10)
    short = replace(made, messages=replace(made.messages, length_m=made.messages.length_m - 1.0))
    right, wrong = (matched(tmp_path, each) for each in (made, short))
    words = "m long in the median, and its messages report"
    assert not any(words in reason for reason in right.calibration.quality.reasons)
    quality = wrong.calibration.quality
    assert quality.verdict == "warn"
    assert any(words in reason for reason in quality.reasons)
    assert errors(made, wrong.calibration).track_xy_m < 3.0 * quality.track_xy_sigma_m


# ------------------------------------------------------------------------------------- the installed command


def test_the_command_writes_a_whole_result(site: Site) -> None:
    ran = run_installed(site.arguments("--name", "radar 3"), site.root)
    assert ran.code == 0, ran
    assert (
        "note: x, y and z taken for the centre of the boxes (see --box-origin and --box-point)" in ran.err.splitlines()
    )
    assert {"calibration.json", "topdown.png"} <= {path.name for path in site.out.iterdir()}
    document = site.document()
    Draft202012Validator(schema()).validate(document)
    assert document["sensor"] == {
        "name": "radar 3",
        "kind": "detections",
        "frame": "as in the detections: x forward, z up",
    }
    hashes = {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in (site.detections, site.cam)}
    assert document["inputs"] == hashes
    assert document["config"]["box_origin"] == "centre"
    assert document["background_boxes"] == []
    here = match(site.detections, site.cam)
    assert np.array(document["T_world_sensor"]) == pytest.approx(here.calibration.T_world_sensor)
    assert f"{'Height':<11}{here.calibration.height_m:.2f} m above the ground" in ran.out
    refusal(run(site.arguments(), site.root), UNUSABLE, "holds a result already", "--overwrite")


@pytest.mark.parametrize("write", [write_gpx, pytest.param(write_nmea, marks=pytest.mark.slow)])
def test_an_antennas_positions_need_its_place_on_the_vehicle(site: Site, write: Callable[[Path, CamLog], Path]) -> None:
    messages = site.made.messages
    log = write(site.root, replace(messages, altitude_m=np.full(len(messages), 500.0)))
    converted = site.root / "converted.csv"
    assert run(["cam", str(log), "--to", "csv", "--out", str(converted)], site.root).code == 0
    for path in (log, converted):
        ran = run(["match", str(site.detections), str(path), "--out", str(site.out)], site.root)
        refusal(ran, UNUSABLE, path.name, "positions are the antenna's; needed is", "--cam-reference=-0.4,0, or front")
        assert not site.out.exists()
    ran = run(["match", str(site.detections), str(log), "--cam-reference", "front", "--out", str(site.out)], site.root)
    assert ran.code == 0, ran


def test_result_that_must_not_be_used_is_written_and_no_success(tmp_path: Path) -> None:
    """The paper's method on 2.5 s of boxes that are 0.4 m off."""
    made = traffic(100, noise=Noise(position_m=0.4))
    site = lay(tmp_path, made)
    rows, stamps_ns = detection_rows(made), made.detections.stamps_ns
    middle_ns = (made.messages.stamps_ns[0] + made.messages.stamps_ns[-1]) // 2
    near = np.abs(stamps_ns - middle_ns) < 1_250_000_000
    Rows(rows.header, [row for row, kept in zip(rows.rows, near, strict=True) if kept]).write(site.detections)
    ran = run(site.arguments("--method", "paper"), site.root)
    assert ran.code == NOT_CALIBRATED, ran
    document = site.document()
    assert document["quality"]["verdict"] == "fail"
    assert "Verdict    FAIL: " in ran.out
    line = ran.err.splitlines()[-1]
    assert line.startswith("laci-stereo: not calibrated: the verdict is fail: position along the track is known to ")
    assert line.endswith(f"{site.out} shows what was found")
    quiet = run(site.arguments("--method", "paper", "--quiet", "--overwrite"), site.root)
    assert (quiet.code, quiet.out, quiet.err.splitlines()) == (NOT_CALIBRATED, "", [line])


def test_what_makes_no_sense_for_detections_is_no_option(site: Site) -> None:
    offered = run(["match", "--help"], site.root).out
    for option in (
        "--box-origin",
        "--box-point",
        "--level",
        "--axes",
        "--station",
        "--cam-reference",
        "--crs",
        "--out",
        "--map",
    ):
        assert option in offered
    assert "radial_speed (m/s, positive away from the sensor)" in " ".join(offered.split())
    for option in ("--workers", "--background", "--stereo", "--disparities"):
        assert option not in offered
    assert "--workers" in run(["calibrate", "--help"], site.root).out


@pytest.mark.slow
def test_yaw_in_degrees_and_doubled_rows_are_put_right_and_said(site: Site) -> None:
    rows = detection_rows(site.made)
    rows.column("yaw", [f"{v:.3f}" for v in np.degrees(site.made.detections.yaw_rad)])
    doubled = Rows(rows.header, [*rows.rows, *rows.rows[100:150]])
    plain = match(site.detections, site.cam).calibration.T_world_sensor
    doubled.write(site.detections)
    ran = run(site.arguments(), site.root)
    assert ran.code == 0, ran
    assert "note: yaw: degrees (up to " in ran.err
    assert "note: 50 doubled rows dropped" in ran.err.splitlines()
    document = site.document()
    assert np.array(document["T_world_sensor"]) == pytest.approx(plain, abs=1e-6)


Damage = Callable[[Site], None]


def lacks_y(site: Site) -> None:
    detection_rows(site.made).without("y").write(site.detections)


def lacks_z(site: Site) -> None:
    detection_rows(site.made).without("z").write(site.detections)


def lacks_height(site: Site) -> None:
    detection_rows(site.made).without("height").write(site.detections)


def has_centimetres(site: Site) -> None:
    rows = detection_rows(site.made)
    rows.column("height", (100.0 * site.made.heights_m).round().tolist())
    rows.write(site.detections)


def is_empty(site: Site) -> None:
    site.detections.write_bytes(b"")


def has_words(site: Site) -> None:
    rows = detection_rows(site.made)
    rows.column("x", ["far away" for _ in rows.rows])
    rows.write(site.detections)


def is_of_another_hour(site: Site) -> None:
    log = replace(site.made.detections, stamps_ns=site.made.detections.stamps_ns - 3600 * 10**9)
    detection_rows(replace(site.made, detections=log)).write(site.detections)


def is_on_the_map(site: Site) -> None:
    rows = detection_rows(site.made)
    rows.column("x", [f"{569805.5 + i:.1f}" for i in range(len(rows.rows))])
    rows.write(site.detections)


def tells_two_places(site: Site) -> None:
    rows = detection_rows(site.made)
    rows.column("track_id", ["1" for _ in rows.rows])
    rows.column("timestamp", [rows.rows[i - i % 2][0] for i in range(len(rows.rows))])
    rows.write(site.detections)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lacks_y, ("detections.csv lacks the column y", "needed are timestamp, x, y")),
        (lacks_z, ("detections.csv lacks z", "--level HEIGHT")),
        (lacks_height, ("detections.csv lacks height", "--box-origin bottom", "--level HEIGHT")),
        (has_centimetres, ("detections.csv holds no possible height: height is 1", " m in row 2, possible is")),
        (is_empty, ("detections.csv is empty (0 bytes)",)),
        (has_words, ("detections.csv, row 2: x is 'far away'; needed is a number", "rows are bad")),
        (is_on_the_map, ("row 2: x is 569805.5 m; needed is -1000 to 1000 m from the sensor",)),
        (is_of_another_hour, ("cam.csv", "do not overlap", "time zone of 1 h")),
        (tells_two_places, ("timestamp and track_id are those of another row", "one row for each object and time")),
        (lambda site: site.detections.unlink(), ("detections.csv does not exist",)),
        (lambda site: site.cam.unlink(), ("cam.csv does not exist",)),
    ],
)
def test_input_that_makes_no_sense_is_refused(site: Site, damage: Damage, words: tuple[str, ...]) -> None:
    damage(site)
    site.refused(UNUSABLE, *words)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--level", "0"), ("--level is 0.0 m; needed is a number above 0",)),
        (("--level", "nan"), ("--level is nan m; needed is a number above 0",)),
        (("--axes", "x forward, x up"), ("the axes 'x forward, x up' make forward and up parallel",)),
        (("--axes", "sideways"), ("the axes are 'sideways'",)),
        (("--box-origin", "top"), ("--box-origin", "'top'")),
        (("--box-point", "left"), ("--box-point", "'left'")),
        (("--station", "7"), ("station 7 is not in the log; needed is one of 42",)),
    ],
)
def test_options_that_make_no_sense_are_refused(site: Site, options: tuple[str, ...], words: tuple[str, ...]) -> None:
    site.refused(UNUSABLE, *words, options=options)


def queue(n: int = 8) -> list[Passing]:
    lane = Drive((28.0, -30.0), 90.0, speeds=((0.0, 8.0), (3.0, 8.0), (5.0, 3.0), (8.0, 9.0)))
    return [Passing(lane, 20.0 + 10.0 * i, (4.4, 1.8, 1.5)) for i in range(n)]


def test_boxes_on_one_line_do_not_tell_the_ground(tmp_path: Path) -> None:
    site = lay(tmp_path, traffic(3, vehicles=queue()))
    words = ("not calibrated: the boxes lie on one line", "at least 0.9 m needed", "--level HEIGHT")
    site.refused(NOT_CALIBRATED, *words, options=("-q",))
    with pytest.raises(GroundError):
        match(site.detections, site.cam)


def test_a_sender_that_stands_still_tells_nothing(tmp_path: Path) -> None:
    standing = Passing(Drive((30.0, 5.0), 90.0, speeds=((0.0, 0.0),)), 30.0, (4.4, 1.8, 1.5))
    made = traffic(3)
    site = lay(tmp_path, traffic(3, vehicles=[standing, *made.vehicles[1:12]]))
    site.refused(NOT_CALIBRATED, "not calibrated: ", "stands still", "needed are", options=("-q",))


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS[:4])
@pytest.mark.parametrize(
    ("ahead_s", "words"),
    [
        (18, "GPS time is 18 s ahead of UTC; subtract 18 s from the times of the messages"),
        (-18, "GPS time is 18 s ahead of UTC; subtract 18 s from the times of the recording"),
        (5, "ETSI's clock is 5 s ahead of UTC, by the leap seconds since 2004; subtract 5 s"),
    ],
)
def test_a_clock_that_is_not_utc_is_named(tmp_path: Path, seed: int, ahead_s: int, words: str) -> None:
    made = traffic(seed)
    messages = replace(made.messages, stamps_ns=made.messages.stamps_ns + ahead_s * 10**9)
    said = f"if times were of another clock, station 42 would match its messages: {words}"
    site = lay(tmp_path, replace(made, messages=messages))
    ran = run(site.arguments(), tmp_path)
    assert said in ran.out + ran.err


@pytest.mark.slow
@pytest.mark.parametrize("seed", SEEDS[:4])
def test_a_sender_that_is_not_seen_is_not_found_by_another_clock(tmp_path: Path, seed: int) -> None:
    made = traffic(seed)
    others = made.of_vehicle != 0
    seen = {"detections": made.detections[others], "of_vehicle": made.of_vehicle[others]}
    unseen = replace(made, **seen, heights_m=made.heights_m[others])
    with pytest.raises(MatchError) as refused:
        matched(tmp_path, unseen)
    assert "another clock" not in str(refused.value)


def test_without_axes_that_tell_the_plane_z_is_needed(site: Site) -> None:
    lacks_z(site)
    site.refused(UNUSABLE, "lacks z", "y up", options=("--level", "5", "--axes", "z forward, y up"))
    with pytest.raises(InputError, match="lacks z"):
        match(site.detections, site.cam)
