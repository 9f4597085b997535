from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from laci_stereo.core.messages.cam import CamLog
from laci_stereo.io.cam.export import to_csv, to_geojson
from laci_stereo.io.cam.log import read_cam_log
from laci_stereo.io.cam.recording import CamRecording
from laci_stereo.report.cam_map import draw_log
from laci_stereo.report.cam_summary import summarise_log
from tests.cli_support import DEMONSTRATION, run, run_installed
from tests.io import cam_writers as writers
from tests.io.cam.test_cam_log import COMPLETE, POSITIONS, mixed
from tests.io.cam_writers import START_NS, drive
from tests.io.support import fuzz


def test_it_tells_what_a_log_holds(tmp_path: Path):
    path = writers.write_pcapng(tmp_path, mixed(drive(), drive(30, station=12)))
    ran = run_installed(["cam", str(path)], tmp_path)
    assert ran.code == 0
    assert ran.err == ""
    lines = ran.out.splitlines()
    assert lines[0].endswith("a.pcapng: a capture (pcapng), 90 messages")
    assert "2025-10-09T08:53:22.237Z to 2025-10-09T08:53:28.137Z, 5.9 s" in lines[1]
    assert "centre of the vehicle's front side" in lines[2]
    assert "2: 3725855973, 12" in lines[3]
    text = " ".join(ran.out.split())
    assert "Messages 60, 10.0 per second (median), 0 gaps over 1.5 s" in text
    assert "Speed 9.00 to 10.77 m/s" in text
    assert "Vehicle 4.70 m x 1.80 m" in text
    assert "Accuracy 0.31 m x 0.24 m, axes of the 95 % ellipse" in text
    assert "note: timestamp: generationDeltaTime" in text
    assert "note: ETSI integers of latitude 1e-7 deg" in text
    assert list(tmp_path.iterdir()) == [path]


def wrong_speed(log: CamLog) -> CamLog:
    return replace(log, speed_mps=3.6 * log.speed_mps)


def counter_clockwise(log: CamLog) -> CamLog:
    return replace(log, heading_deg=(90.0 - log.heading_deg) % 360.0)


def rounded(log: CamLog) -> CamLog:
    return replace(log, latitude_deg=np.round(log.latitude_deg, 5), longitude_deg=np.round(log.longitude_deg, 5))


def exchanged(log: CamLog) -> CamLog:
    return replace(log, length_m=log.width_m, width_m=log.length_m)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (wrong_speed, "of no use: the messages of station 3725855973 contradict one another"),
        (wrong_speed, "likely: speed is in km/h"),
        (rounded, "likely: positions are rounded to 5 decimals, 1.1 m; ETSI's have 7"),
        (counter_clockwise, "likely: headings are counter-clockwise from east"),
        (exchanged, "exceeds its length, 1.80 m; exchanged?"),
        (lambda log: log[np.array([0])], "of no use: 1 messages with a position; needed are at least 2"),
        (lambda log: log, "60 of 60 messages follow from one another by speed and heading"),
    ],
)
def test_it_says_what_a_calibration_would(tmp_path: Path, change: Callable[[CamLog], CamLog], words: str):
    (tmp_path / "cam.csv").write_text(to_csv(change(drive())))
    ran = run(["cam", str(tmp_path / "cam.csv")], tmp_path)
    (check,) = (line for line in ran.out.splitlines() if line.startswith("  Check"))
    assert words in check
    assert ran.code == (1 if "of no use" in check else 0)


def test_a_sign_that_lacks_is_named_where_most_of_a_drive_is_straight_east(tmp_path: Path):
    log = read_cam_log(DEMONSTRATION / "cam.csv").log
    (tmp_path / "cam.csv").write_text(to_csv(replace(log, latitude_deg=-log.latitude_deg)))
    ran = run(["cam", str(tmp_path / "cam.csv")], tmp_path)
    assert "or the longitudes lack their sign, or the latitudes lack their sign" in ran.out
    assert ran.code == 1


def test_a_log_is_of_use_if_one_of_its_stations_is(tmp_path: Path):
    (tmp_path / "cam.csv").write_text(to_csv(mixed(wrong_speed(drive()), drive(30, station=12))))
    ran = run(["cam", str(tmp_path / "cam.csv")], tmp_path)
    assert ran.out.count("of no use") == 1
    assert ran.code == 0


def test_of_many_stations_the_one_of_use_may_send_the_fewest_messages(tmp_path: Path):
    parked = [wrong_speed(drive(40 + number, station=20 + number)) for number in range(5)]
    for last, words, code in ((drive(30, station=12), "one of them is of use", 0), (parked[0][np.arange(9)], "", 1)):
        log = mixed(*parked, last)
        (tmp_path / "cam.csv").write_text(to_csv(log))
        ran = run(["cam", str(tmp_path / "cam.csv")], tmp_path)
        assert ran.out.count("of no use") == 5
        assert words in ran.out
        assert ran.code == code


def test_it_writes_a_map_and_replaces_none(tmp_path: Path):
    path = writers.write_hex(tmp_path, mixed(drive(), drive(30, station=12)))
    out = tmp_path / "map.png"
    assert run(["cam", str(path), "--out", str(out)], tmp_path).code == 0
    picture = cv2.imread(str(out))
    assert picture is not None
    assert picture.shape == (960, 1280, 3)
    assert (picture < 200).any()
    out.write_text("mine")
    ran = run(["cam", str(path), "--out", str(out)], tmp_path)
    assert ran.code == 2
    assert "exists already" in ran.err
    assert out.read_text() == "mine"
    assert run(["cam", str(path), "--out", str(out), "--overwrite"], tmp_path).code == 0
    assert sorted(tmp_path.iterdir()) == sorted([path, out])


def test_it_converts_to_standard_output_and_into_a_file(tmp_path: Path):
    path = writers.write_pcap(tmp_path, drive())
    ran = run(["cam", str(path), "--to", "csv"], tmp_path)
    assert ran.code == 0
    assert ran.out == to_csv(read_cam_log(path).log)
    assert "note: " in ran.err
    out = tmp_path / "cam.json"
    assert run(["cam", str(path), "--to", "geojson", "--out", str(out)], tmp_path).out == ""
    assert json.loads(out.read_text())["type"] == "FeatureCollection"


def test_what_cannot_be_read_or_written_is_one_line(tmp_path: Path):
    (tmp_path / "log").write_bytes(b"\x00\xff" * 100)
    ran = run(["cam", str(tmp_path / "log")], tmp_path)
    assert ran.code == 2
    assert ran.err.startswith(f"laci-stereo: {tmp_path / 'log'} is not a text file")
    assert len(ran.err.splitlines()) == 1
    path = writers.write_pcap(tmp_path, drive())
    ran = run(["cam", str(path), "--to", "csv", "--out", str(tmp_path / "none" / "a.csv")], tmp_path)
    assert ran.code == 2
    assert "its folder does not exist" in ran.err


def test_a_map_is_written_under_no_other_name_than_a_picture(tmp_path: Path):
    path = writers.write_pcap(tmp_path, drive())
    ran = run(["cam", str(path), "--out", str(tmp_path / "cam.csv")], tmp_path)
    assert (ran.code, ran.out) == (2, "")
    assert "cam.csv: the picture's name ends in .csv; needed is .png" in ran.err
    assert list(tmp_path.iterdir()) == [path]


anything = st.one_of(st.just(float("nan")), st.floats(0.0, 1e3))
degrees = st.floats(-90.0, 90.0)


ONE_IS_ELSEWHERE = [(stamp_ns, 7, 0.0, longitude, *[float("nan")] * 8) for stamp_ns, longitude in enumerate([0, 0, 1])]


@fuzz
@example(ONE_IS_ELSEWHERE)
@given(
    st.lists(
        st.tuples(st.integers(0, 10**10), st.just(7), degrees, degrees, *([anything] * 8)), min_size=1, max_size=12
    )
)
def test_whatever_a_log_holds_is_said(rows: list[tuple[float, ...]]):
    rows = sorted({row[0]: row for row in rows}.values())
    stamps = START_NS + np.array([row[0] for row in rows], dtype=np.int64)
    values = [np.array(column, dtype=np.float64) for column in zip(*rows, strict=True)][2:]
    said = summarise_log(CamRecording(CamLog(stamps, np.full(len(rows), 7), *values), ()), "a").text
    assert "  Check" in said


numbers = st.one_of(st.just(float("nan")), st.floats(0.5, 1.5))


@fuzz
@given(
    st.lists(st.tuples(st.integers(0, 10**12), st.integers(0, 2**63 - 1), *([numbers] * 10)), min_size=1, max_size=8)
)
def test_what_is_converted_to_csv_comes_back_exactly(tmp_path: Path, rows: list[tuple[float, ...]]):
    rows = sorted({(row[0], row[1]): row for row in rows}.values())
    stamps = START_NS + np.array([row[0] for row in rows], dtype=np.int64)
    stations = np.array([row[1] for row in rows], dtype=np.int64)
    values = [np.array(column) for column in zip(*rows, strict=True)][2:]
    values[0] = np.where(np.isnan(values[0]), 1.0, values[0])
    values[1] = np.where(np.isnan(values[1]), 1.0, values[1])
    log = CamLog(stamps, stations, *values)
    (tmp_path / "cam.csv").write_text(to_csv(log))
    found = read_cam_log(tmp_path / "cam.csv").log
    for column in fields(CamLog):
        np.testing.assert_array_equal(getattr(found, column.name), getattr(log, column.name), column.name)


@pytest.mark.parametrize("form", [*COMPLETE, *POSITIONS])
def test_every_format_is_told_drawn_and_converted(form: str, tmp_path: Path):
    recording = read_cam_log({**COMPLETE, **POSITIONS}[form](tmp_path, drive()))
    said = summarise_log(recording, "a").text
    assert recording.format in said
    assert all(f"note: {note}" in said for note in recording.notes)
    assert (draw_log(recording) < 200).any()
    (tmp_path / "back.csv").write_text(to_csv(recording.log))
    back = read_cam_log(tmp_path / "back.csv").log
    for column in fields(CamLog):
        np.testing.assert_array_equal(getattr(back, column.name), getattr(recording.log, column.name), column.name)


def test_geojson_has_a_line_for_each_station_and_a_point_for_each_message():
    log = mixed(drive(20), drive(1, station=12))
    features = json.loads(to_geojson(log))["features"]
    lines = [feature for feature in features if feature["geometry"]["type"] == "LineString"]
    points = [feature for feature in features if feature["geometry"]["type"] == "Point"]
    assert [line["properties"] for line in lines] == [{"station_id": 3725855973, "messages": 20}]
    assert [point["geometry"]["coordinates"] for point in points] == [
        list(place) for place in zip(log.longitude_deg.tolist(), log.latitude_deg.tolist(), strict=True)
    ]
    assert points[0]["properties"]["timestamp"] == "2025-10-09T08:53:22.237Z"
    assert points[0]["properties"]["vehicle_length"] == 4.7


def test_the_map_turns_with_the_drive():
    def dark(heading_east: bool) -> tuple[int, int]:
        log = drive(40, turn_deg_s=0.0)
        along, across = log.longitude_deg, np.full(40, log.latitude_deg[0])
        if not heading_east:
            along, across = np.full(40, along[0]), 48.42 + (along - along[0])
        moved = CamLog(log.stamps_ns, log.station_id, across, along, *list(vars(log).values())[4:])
        # Above the scale and below the legend there is only the track.
        rows, columns = np.nonzero((draw_log(CamRecording(moved, ()))[100:850] < 200).any(axis=2))
        return int(np.ptp(columns)), int(np.ptp(rows))

    wide, high = dark(True), dark(False)
    assert wide[0] > 20 * wide[1]
    assert high[1] > 20 * high[0]
