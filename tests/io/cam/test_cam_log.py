from __future__ import annotations

import gzip
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from laci_stereo.core.errors import CamError
from laci_stereo.core.messages.cam import CamLog
from laci_stereo.io import file_content
from laci_stereo.io.cam.log import read_cam_log
from laci_stereo.io.cam.recording import CamRecording
from tests.io import cam_writers as writers
from tests.io.cam_writers import WGS84, drive
from tests.io.support import SHARED, fuzz, mutations, needs_shared, noise, read_or_refused

COMPLETE: dict[str, Callable[[Path, CamLog], Path]] = {
    "CSV, gzip": writers.write_csv_gz,
    "CSV, UTF-16, decimal commas": writers.write_csv_utf16,
    "hex lines": writers.write_hex,
    "hex lines of signed packets without times": writers.write_hex_gn,
    "pcap": writers.write_pcap,
    "pcap of Wi-Fi, big-endian, ns, gzip": writers.write_pcap_wifi_signed,
    "pcap of UDP": writers.write_pcap_udp,
    "pcapng": writers.write_pcapng,
    "ROS 1 bag": lambda folder, log: writers.write_bag1(folder / "a.bag", writers.ros_cams(log)),
    "ROS 2 bag, SQLite": lambda folder, log: writers.write_bag2(folder / "a", writers.ros_cams(log), "SQLITE3"),
    "ROS 2 bag, without definitions": lambda folder, log: (
        writers.write_bag2(folder / "a", writers.ros_cams(log), "SQLITE3", told="") / "a.db3"
    ),
    "MCAP": lambda folder, log: writers.write_bag2(folder / "a", writers.ros_cams(log)) / "a.mcap",
    "V2AIX JSON": writers.write_json,
    "JSON lines": writers.write_json_lines,
    "JSON list": writers.write_json_list,
    "GeoJSON": writers.write_geojson,
}
"""Formats that carry all of a log."""

POSITIONS: dict[str, Callable[[Path, CamLog], Path]] = {
    "ROS 1 bag, fixes": lambda folder, log: writers.write_bag1(folder / "a.bag", writers.ros_fixes(log)),
    "MCAP, fixes": lambda folder, log: writers.write_bag2(folder / "a", writers.ros_fixes(log)) / "a.mcap",
    "V2AIX JSON, fixes": writers.write_json_fixes,
    "NMEA": writers.write_nmea,
    "GPX": writers.write_gpx,
    "RTKLIB": writers.write_rtklib,
}
"""Formats of GNSS receivers: one vehicle, of unknown dimensions."""


def mixed(*logs: CamLog) -> CamLog:
    """Return the messages of several stations in the order of time."""
    together = logs[0].joined(*logs[1:])
    return together[np.lexsort((together.station_id, together.stamps_ns))]


def assert_same_track(found: CamLog, wanted: CamLog) -> None:
    """Compare times to 1 ms and positions to 1 cm."""
    np.testing.assert_allclose(found.stamps_ns, wanted.stamps_ns, rtol=0, atol=1_000_000)
    places = (found.longitude_deg, found.latitude_deg, wanted.longitude_deg, wanted.latitude_deg)
    assert WGS84.inv(*places)[2].max() < 0.01


def refusal(path: Path) -> str:
    with pytest.raises(CamError) as refused:
        read_cam_log(path)
    assert len(str(refused.value).splitlines()) == 1
    return str(refused.value)


@pytest.mark.parametrize("form", COMPLETE)
def test_every_format_gives_the_same_log(form: str, tmp_path: Path):
    log = mixed(drive(), drive(station=12, latitude=48.43), drive(station=13, turn_deg_s=-4.0))
    recording = read_cam_log(COMPLETE[form](tmp_path, log))
    assert_same_track(recording.log, log)
    for column in fields(CamLog)[1:]:
        np.testing.assert_allclose(
            getattr(recording.log, column.name), getattr(log, column.name), rtol=0, atol=1e-9, err_msg=column.name
        )


@pytest.mark.parametrize("form", COMPLETE)
def test_what_a_sender_does_not_know_is_missing(form: str, tmp_path: Path):
    log = drive()
    unknown = {
        "heading_deg": 360.1,
        "speed_mps": 163.83,
        "altitude_m": 8000.01,
        "length_m": 102.3,
        "width_m": 6.2,
        "semi_major_95_m": 40.95,
        "semi_minor_95_m": 40.95,
        "ellipse_orientation_deg": 360.1,
    }
    sent = replace(log, **{name: np.full(len(log), value) for name, value in unknown.items()})
    found = read_cam_log(COMPLETE[form](tmp_path, sent)).log
    assert all(np.isnan(getattr(found, name)).all() for name in unknown)


@pytest.mark.parametrize("form", POSITIONS)
@pytest.mark.parametrize("latitude", [48.42, -33.5])
def test_a_receiver_s_log_gives_the_same_track(form: str, latitude: float, tmp_path: Path):
    log = drive(latitude=latitude)
    recording = read_cam_log(POSITIONS[form](tmp_path, log))
    found = recording.log
    assert_same_track(found, log)
    assert found.stations() == [0]
    np.testing.assert_allclose(found.altitude_m, log.altitude_m, rtol=0, atol=0.006)
    assert np.isnan(found.length_m).all()
    assert any("no vehicle_length and vehicle_width" in note for note in recording.notes)
    # Positions are rounded to 1.11 cm, so that a step of 1.8 m from one to the next but one is off by 1.57 cm.
    turned = (found.heading_deg - log.heading_deg + 180.0) % 360.0 - 180.0
    assert np.abs(turned[1:-1]).max() < np.degrees(0.0157 / 1.8)
    np.testing.assert_allclose(found.speed_mps[1:-1], log.speed_mps[1:-1], rtol=0, atol=0.0157 / 0.2)


@needs_shared
def test_a_real_message_with_a_time_before_it(tmp_path: Path):
    digits = (SHARED / "formats/cam/real_cam_hamburg.hex").read_text()
    (tmp_path / "a.hex").write_text(f"2023-11-14T22:13:20.5Z {digits}")
    log = read_cam_log(tmp_path / "a.hex").log
    assert log.station_id.tolist() == [3725855973]
    assert (log.latitude_deg.tolist(), log.longitude_deg.tolist()) == ([53.5626518], [9.9761485])
    said = refusal(SHARED / "formats/cam/real_cam_hamburg.hex")
    assert "station 3725855973 at 53.5626518, 9.9761485 deg has no time of reception" in said


STAMPS: dict[str, Callable[[int], str]] = {
    "s": lambda ns: f"{ns // 10**9}.{ns % 10**9:09d} ",
    "ms": lambda ns: f"{ns // 10**6},",
    "us": lambda ns: f"{ns // 10**3}\t",
    "ns": lambda ns: f"{ns};",
    "ISO": lambda ns: f"{np.datetime64(ns, 'ns')}Z | ",
    "ISO, with a zone": lambda ns: f"{np.datetime64(ns + 7200 * 10**9, 'ns')}+02:00 ",
    "s, with other cells": lambda ns: f"{ns / 1e9:.6f}, rx, -71 dBm, ",
    "ISO, in brackets with words": lambda ns: f"[{str(np.datetime64(ns, 'ns')).replace('T', ' ')}] INFO cam received: ",
    "ISO, with a blank and a comma": lambda ns: f"{str(np.datetime64(ns, 'ns')).replace('T', ' ').replace('.', ',')}  ",
}
DIGITS: dict[str, Callable[[bytes], str]] = {
    "plain": bytes.hex,
    "upper case, 0x": lambda data: f"0x{data.hex().upper()}",
    "blanks": lambda data: data.hex(" "),
    "colons": lambda data: data.hex(":"),
    "packet": lambda data: writers.gn_packet(data).hex(),
}


@pytest.mark.parametrize("stamp", STAMPS)
@pytest.mark.parametrize("digits", DIGITS)
def test_hex_lines_as_people_write_them(stamp: str, digits: str, tmp_path: Path):
    log = drive(10)
    lines = [
        STAMPS[stamp](ns) + DIGITS[digits](data)
        for ns, data in zip(writers.received(log), writers.cams(log), strict=True)
    ]
    (tmp_path / "a.txt").write_text("# what was received\ntime, what\n" + "\r\n".join(lines) + "\n\n")
    assert_same_track(read_cam_log(tmp_path / "a.txt").log, log)
    assert_same_track(read_cam_log_of(tmp_path, "\n".join(lines)).log, log)


def test_bad_lines_are_counted_and_named(tmp_path: Path):
    lines = writers.hex_lines(drive(20)).splitlines()
    lines[3] = lines[3][:60]
    lines[7] = "yesterday " + lines[7].split()[1]
    recording = read_cam_log_of(tmp_path, "\n".join(lines))
    assert len(recording.log) == 18
    assert any("2 bad lines skipped, the first of them line 4: it has" in note for note in recording.notes)
    for i in range(10, 14):
        lines[i] = "1760000000 nothing"
    said = refusal_of(tmp_path, "\n".join(lines))
    assert "line 4: " in said
    assert "6 of 20 lines are bad" in said


def test_a_bare_message_lacks_its_time(tmp_path: Path):
    (tmp_path / "cam.bin").write_bytes(b"".join(writers.cams(drive(3))))
    said = refusal(tmp_path / "cam.bin")
    assert "holds 3 bare CAMs of station 3725855973" in said
    assert "without the time of their reception" in said


def read_cam_log_of(folder: Path, text: str | bytes) -> CamRecording:
    path = folder / "log"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_cam_log(path)


def refusal_of(folder: Path, text: str | bytes) -> str:
    path = folder / "log"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return refusal(path)


def test_what_is_no_log(tmp_path: Path):
    assert "is empty (0 bytes)" in refusal_of(tmp_path, b"")
    assert "is not a text file: byte 2 is 0xff" in refusal_of(tmp_path, b"\x41\x42\xff\xff")
    assert "lacks the column timestamp" in refusal_of(tmp_path, "hello, world\n1, 2\n")
    assert "does not exist" in refusal(tmp_path / "missing")
    (tmp_path / "log").unlink()
    assert "holds no .mcap or .db3 file" in refusal(tmp_path)


def test_gzip_that_unpacks_to_too_much_or_is_damaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    packed = gzip.compress(writers.csv_text(drive(2000)).encode())
    assert "is damaged: Compressed file ended" in refusal_of(tmp_path, packed[:-20])
    assert "is damaged: CRC check failed" in refusal_of(tmp_path, packed[:-8] + b"\0" * 8)
    monkeypatch.setattr(file_content, "LARGEST_UNPACKED", 1000)
    assert "unpacks to more than 1000 bytes" in refusal_of(tmp_path, packed)


def test_a_line_without_end_takes_no_time(tmp_path: Path):
    lines = writers.hex_lines(drive(1))
    assert "line 2: it ends in no hexadecimal digits" in refusal_of(tmp_path, lines + "02 " * 10_000_000 + "\n" + lines)
    assert "row 1: field larger than field limit" in refusal_of(tmp_path, "02 " * 10_000_000 + "\n" + lines)


def test_as_many_stations_as_messages(tmp_path: Path):
    header, *rows = writers.csv_text(drive(200)).splitlines()
    stations = [row.replace("3725855973", str(i)) for i, row in enumerate(rows * 100)]
    assert len(read_cam_log_of(tmp_path, "\n".join([header, *stations])).log.stations()) == 20_000


@pytest.mark.parametrize(
    "form",
    [
        *("hex lines", "hex lines of signed packets without times", "pcap", "pcapng", "ROS 1 bag", "MCAP"),
        *("ROS 2 bag, without definitions", "V2AIX JSON", "V2AIX JSON, fixes", "NMEA", "GPX", "MCAP, fixes"),
    ],
)
def test_damaged_files_are_read_or_refused(form: str, tmp_path: Path):
    path = {**COMPLETE, **POSITIONS}[form](tmp_path, drive(6))

    @fuzz
    @given(mutations(path.read_bytes()))
    def damaged(content: bytes) -> None:
        path.write_bytes(content)
        read_or_refused(lambda: read_cam_log(path), CamError)

    damaged()


@fuzz
@given(noise("1760000000 ", "0202", "1100", "de", " ", "\n", ",", "\x02\x02", "{", "<gpx>", "$GPGGA"))
def test_noise_is_refused(tmp_path: Path, content: bytes):
    (tmp_path / "log").write_bytes(content)
    read_or_refused(lambda: read_cam_log(tmp_path / "log"), CamError)


@fuzz
@given(st.binary(max_size=300), st.sampled_from(["a1b2c3d4", "d4c3b2a1", "0a0d0d0a", "0202", "1f8b08"]))
def test_noise_behind_a_format_s_first_bytes_is_refused(tmp_path: Path, content: bytes, magic: str):
    (tmp_path / "log").write_bytes(bytes.fromhex(magic) + content)
    read_or_refused(lambda: read_cam_log(tmp_path / "log"), CamError)
