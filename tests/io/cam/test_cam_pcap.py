from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import dpkt
import pytest

from laci_stereo.core.errors import CamError
from laci_stereo.io.cam.log import read_cam_log
from laci_stereo.io.cam.packet_capture import frames
from laci_stereo.io.cam.recording import CamRecording
from tests.io import cam_writers as writers
from tests.io.cam.test_cam_log import assert_same_track
from tests.io.cam_asn1 import encode, vehicle_cam
from tests.io.cam_writers import drive

LOG = drive(20)
CAMS = writers.cams(LOG)
TIMES = writers.received(LOG)


def read(folder: Path, content: bytes) -> CamRecording:
    (folder / "a.bin").write_bytes(content)
    return read_cam_log(folder / "a.bin")


def read_frames(folder: Path, sent: list[bytes], link_type: int = 1) -> CamRecording:
    return read(folder, writers.pcap(list(zip(TIMES, sent, strict=True)), link_type))


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("nanoseconds", [False, True])
def test_both_byte_orders_and_units(order: str, nanoseconds: bool, tmp_path: Path):
    sent = [writers.ethernet(writers.gn_packet(data)) for data in CAMS]
    assert_same_track(read(tmp_path, writers.pcap(list(zip(TIMES, sent, strict=True)), 1, order, nanoseconds)).log, LOG)


def test_captures_that_dpkt_writes(tmp_path: Path):
    sent = [writers.ethernet(writers.gn_packet(data)) for data in CAMS]
    for writer in (dpkt.pcap.Writer, dpkt.pcapng.Writer):
        with (tmp_path / "a").open("wb") as stream:
            capture = writer(stream)
            for ns, data in zip(TIMES, sent, strict=True):
                capture.writepkt(data, ns / 1e9)
        assert_same_track(read_cam_log(tmp_path / "a").log, LOG)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("resolution", [3, 6, 9, 0x80 | 10, 0x80 | 30])
def test_clocks_of_interfaces(order: str, resolution: int):
    capture = writers.pcapng([(1, ns, b"x") for ns in TIMES], [(1, 6), (1, resolution)], order)
    per_second = 2 ** (resolution & 127) if resolution & 128 else 10**resolution
    for frame, ns in zip(frames(capture), TIMES, strict=True):
        assert frame.stamp_ns is not None
        assert 0 <= frame.stamp_ns - ns <= 10**9 / per_second + 1


@pytest.mark.parametrize("kind", [0x20, 0x42, 0x50, 0x51])
def test_every_kind_of_packet(kind: int, tmp_path: Path):
    sent = [writers.ethernet(writers.gn_packet(data, kind=kind)) for data in CAMS]
    assert_same_track(read_frames(tmp_path, sent).log, LOG)


@pytest.mark.parametrize("quality", [False, True])
@pytest.mark.parametrize("snap", [False, True])
def test_wifi_with_and_without_what_may_be_left_out(quality: bool, snap: bool, tmp_path: Path):
    sent = [writers.wifi(writers.gn_packet(data), quality, snap) for data in CAMS]
    assert_same_track(read_frames(tmp_path, sent, 105).log, LOG)
    assert_same_track(read_frames(tmp_path, [writers.radiotap(frame) for frame in sent], 127).log, LOG)


def test_bare_packets_and_linux_cooked_ones(tmp_path: Path):
    packets = [writers.gn_packet(data) for data in CAMS]
    assert_same_track(read_frames(tmp_path, packets, 147).log, LOG)
    assert_same_track(read_frames(tmp_path, [bytes(14) + b"\x89\x47" + data for data in packets], 113).log, LOG)
    assert_same_track(read_frames(tmp_path, [b"\x89\x47" + bytes(18) + data for data in packets], 276).log, LOG)


def test_signed_packets_are_read_and_it_says_that_nobody_verified_them(tmp_path: Path):
    sent = [writers.ethernet(writers.signed_packet(data, ns)) for ns, data in zip(TIMES, CAMS, strict=True)]
    recording = read_frames(tmp_path, sent)
    assert_same_track(recording.log, LOG)
    assert "20 of 20 CAMs are signed; the signatures were not verified" in recording.notes


def test_other_packets_are_counted_by_kind(tmp_path: Path):
    roadside = vehicle_cam()
    roadside["cam"]["camParameters"]["highFrequencyContainer"] = ("rsuContainerHighFrequency", {})
    others = {
        "DENM": writers.ethernet(writers.gn_packet(CAMS[0], port=2002)),
        "SPATEM": writers.ethernet(writers.gn_packet(CAMS[0], port=2004)),
        "BTP port 4711": writers.ethernet(writers.gn_packet(CAMS[0], port=4711)),
        "GeoNetworking beacon": writers.ethernet(writers.gn_packet(b"", kind=0x10)),
        "IPv4": writers.ethernet(b"\x45" + bytes(30), 0x0800),
        "encrypted packet": writers.ethernet(b"\x12\0\x1a\x01\x03\x82" + bytes(50)),
        "CAM of a roadside unit": writers.ethernet(writers.gn_packet(encode(roadside))),
        "secured packet of version 2": writers.ethernet(b"\x12\0\x1a\x01\x02\x81" + bytes(50)),
        "cut-off frame (3 bytes)": b"\0\0\0",
    }
    sent = [writers.ethernet(writers.gn_packet(data)) for data in CAMS]
    both = [*zip(TIMES, sent, strict=True), *((TIMES[-1], frame) for frame in others.values())]
    recording = read(tmp_path, writers.pcap(both))
    assert_same_track(recording.log, LOG)
    note = next(note for note in recording.notes if "no CAM of a vehicle" in note)
    assert all(f"1 x {kind}" in note for kind in others)
    with pytest.raises(CamError, match=r"holds no CAM of a vehicle, but .*1 x DENM.*needed are CAMs"):
        read(tmp_path, writers.pcap([(TIMES[0], frame) for frame in others.values()]))


def test_a_capture_that_is_cut_off_is_used_as_far_as_it_goes(tmp_path: Path):
    sent = [writers.ethernet(writers.gn_packet(data)) for data in CAMS]
    for whole in (
        writers.pcap(list(zip(TIMES, sent, strict=True))),
        writers.pcapng([(0, ns, data) for ns, data in zip(TIMES, sent, strict=True)], [(1, 6)]),
    ):
        recording = read(tmp_path, whole[: len(whole) * 2 // 3])
        assert 8 < len(recording.log) < 14
        assert f"cut off after {len(recording.log)} packets" in recording.notes[0]


def test_packets_cut_short_by_the_capture_are_bad(tmp_path: Path):
    sent = [writers.ethernet(writers.gn_packet(data)) for data in CAMS]
    recording = read_frames(tmp_path, [sent[0][:70], *sent[1:]])
    assert len(recording.log) == 19
    assert any("1 bad packets skipped, the first of them packet 1" in note for note in recording.notes)


# UDP

ENVELOPES: dict[str, Callable[[bytes], bytes]] = {
    "bare": lambda cam: cam,
    "BTP": lambda cam: b"\x07\xd1\0\0" + cam,
    "GeoNetworking": writers.gn_packet,
    "GeoNetworking, signed": lambda cam: writers.signed_packet(cam, TIMES[0]),
    "Ethernet": lambda cam: writers.ethernet(writers.gn_packet(cam)),
}


@pytest.mark.parametrize("envelope", ENVELOPES)
@pytest.mark.parametrize("version", [4, 6])
def test_cams_that_are_forwarded_by_udp(envelope: str, version: int, tmp_path: Path):
    packets = [writers.udp(ENVELOPES[envelope](cam), version) for cam in CAMS]
    framed = [writers.ethernet(packet, 0x0800 if version == 4 else 0x86DD) for packet in packets]
    # Short frames are padded on Ethernet.
    assert_same_track(read_frames(tmp_path, [frame + bytes(6) for frame in framed]).log, LOG)
    assert_same_track(read_frames(tmp_path, packets, 101).log, LOG)


PTP = bytes.fromhex("0102002c00000000000000000000000000000000001b19fffe000001000100070100")
"""A Delay_Req of the Precision Time Protocol, which begins like a CAM."""


@pytest.mark.parametrize(
    "data",
    [
        PTP.ljust(44, b"\0"),
        b"",
        CAMS[0][:-1],
        CAMS[0] + b"\0",
        CAMS[0][:-1] + bytes([CAMS[0][-1] | 1]),
        b"\x03" + CAMS[0][1:],
        b"\x02\x01" + CAMS[0][2:],
        b"\x07\xd2\0\0" + CAMS[0],
        encode(vehicle_cam(latitude=900000001, longitude=1800000001)),
        writers.gn_packet(CAMS[0])[:60],
        writers.gn_packet(CAMS[0][:20]),
    ],
)
def test_other_datagrams_are_no_cams(data: bytes, tmp_path: Path):
    sent = [writers.ethernet(writers.udp(cam), 0x0800) for cam in CAMS]
    frames_sent = [*zip(TIMES, sent, strict=True), (TIMES[0], writers.ethernet(writers.udp(data), 0x0800))]
    recording = read(tmp_path, writers.pcap(frames_sent))
    assert_same_track(recording.log, LOG)
    assert "packets that are no CAM of a vehicle left out: 1 x UDP" in recording.notes


@pytest.mark.parametrize(
    "packet",
    [
        writers.udp(CAMS[0], protocol=6),
        writers.udp(CAMS[0], fragment=0x2000),
        writers.udp(CAMS[0], fragment=7),
        writers.udp(CAMS[0])[:60],
        writers.udp(CAMS[0])[:22],
        b"",
    ],
)
def test_other_ip_packets_are_no_cams(packet: bytes, tmp_path: Path):
    with pytest.raises(CamError, match=r"holds no CAM of a vehicle, but 1 x IPv4"):
        read(tmp_path, writers.pcap([(TIMES[0], writers.ethernet(packet, 0x0800))]))


def test_kinds_behind_headers_are_counted(tmp_path: Path):
    sent = [writers.udp(writers.gn_packet(cam, port=2002)) for cam in CAMS]
    with pytest.raises(CamError, match=r"but 20 x DENM"):
        read_frames(tmp_path, sent, 228)
