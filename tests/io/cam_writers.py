"""A log of messages written in every format in which people record CAMs."""

from __future__ import annotations

import gzip
import json
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime, timezone
from functools import reduce
from operator import xor
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import Geod
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from laci_stereo.core.messages.cam import CamLog
from laci_stereo.io.cam.export import to_geojson
from tests.io.cam_asn1 import encode, vehicle_cam

EPOCH_NS = 1_072_915_200 * 10**9
LEAP_NS = 5 * 10**9
"""Leap seconds from 2004 until now."""

START_NS = 1_760_000_002_237_000_000
LATENCY_NS = 12_345_678
WGS84 = Geod(ellps="WGS84")


def drive(n: int = 60, station: int = 3725855973, latitude: float = 48.42, turn_deg_s: float = 6.0) -> CamLog:
    """Return messages of a car on a curve on the ellipsoid, as exact as ETSI's integers are."""
    seconds = np.arange(n) * 0.1
    heading = (80.0 + turn_deg_s * seconds) % 360.0
    speed = 9.0 + 0.3 * seconds
    places = [(9.9434, latitude)]
    for i in range(n - 1):
        # Midway between two messages the direction is the mean of both; it goes through no north.
        step_m = 0.05 * (speed[i] + speed[i + 1])
        east, north, _ = WGS84.fwd(*places[-1], (heading[i] + heading[i + 1]) / 2, step_m)
        places.append((east, north))
    longitudes, latitudes = np.array(places).T
    return CamLog(
        stamps_ns=START_NS + np.arange(n, dtype=np.int64) * 100_000_000,
        station_id=np.full(n, station, dtype=np.int64),
        latitude_deg=np.round(latitudes, 7),
        longitude_deg=np.round(longitudes, 7),
        heading_deg=np.round(heading, 1),
        speed_mps=np.round(speed, 2),
        altitude_m=np.full(n, 560.25),
        length_m=np.full(n, 4.7),
        width_m=np.full(n, 1.8),
        semi_major_95_m=np.full(n, 0.31),
        semi_minor_95_m=np.full(n, 0.24),
        ellipse_orientation_deg=np.full(n, 12.5),
    )


def raw(value: float, per_unit: float) -> int:
    return round(float(value) * per_unit)


def cams(log: CamLog, leap_ns: int = LEAP_NS, version: int = 2) -> list[bytes]:
    """Return the messages as they go over the air; a sender that forgets the leap seconds has ``leap_ns`` 0."""
    return [
        encode(
            vehicle_cam(
                version=version,
                station=int(log.station_id[i]),
                delta_ms=(int(log.stamps_ns[i]) - EPOCH_NS + leap_ns) // 10**6 % 65536,
                latitude=raw(log.latitude_deg[i], 1e7),
                longitude=raw(log.longitude_deg[i], 1e7),
                ellipse=(
                    raw(log.semi_major_95_m[i], 100),
                    raw(log.semi_minor_95_m[i], 100),
                    raw(log.ellipse_orientation_deg[i], 10),
                ),
                altitude=raw(log.altitude_m[i], 100),
                heading=raw(log.heading_deg[i], 10),
                speed=raw(log.speed_mps[i], 100),
                length=raw(log.length_m[i], 10),
                width=raw(log.width_m[i], 10),
            )
        )
        for i in range(len(log))
    ]


# GeoNetworking and BTP


def position_vector() -> bytes:
    return bytes(24)


def gn_common(payload: bytes, port: int = 2001, kind: int = 0x50) -> bytes:
    """Return a packet behind its basic header: common and extended one (of a single hop by default), BTP-B, payload."""
    extended = {
        0x10: position_vector(),
        0x20: bytes(4) + position_vector() + bytes(20),
        0x42: bytes(4) + position_vector() + bytes(16),
        0x50: position_vector() + bytes(4),
        0x51: bytes(4) + position_vector(),
    }[kind]
    btp = struct.pack(">HH", port, 0)
    return bytes([0x20, kind, 0x02, 0x80]) + struct.pack(">HBB", 4 + len(payload), 1, 0) + extended + btp + payload


def gn_packet(payload: bytes, port: int = 2001, kind: int = 0x50) -> bytes:
    return bytes([0x11, 0, 0x1A, 1]) + gn_common(payload, port, kind)


def coer_length(size: int) -> bytes:
    if size < 128:
        return bytes([size])
    digits = size.to_bytes((size.bit_length() + 7) // 8, "big")
    return bytes([0x80 | len(digits)]) + digits


def signed_packet(payload: bytes, stamp_ns: int | None = None) -> bytes:
    """Return a secured packet: EtsiTs103097Data-Signed with a digest for a signer and a signature of nonsense."""
    inner = gn_common(payload)
    its_us = 0 if stamp_ns is None else (stamp_ns - EPOCH_NS + LEAP_NS) // 1000
    header = bytes([0x00 if stamp_ns is None else 0x40]) + b"\x01\x24"
    header += b"" if stamp_ns is None else its_us.to_bytes(8, "big")
    to_be_signed = b"\x40\x03\x80" + coer_length(len(inner)) + inner + header
    signer, signature = b"\x80" + bytes(range(8)), b"\x80\x80" + bytes(64)
    return bytes([0x12, 0, 0x1A, 1]) + b"\x03\x81\x00" + to_be_signed + signer + signature


def ethernet(packet: bytes, ether_type: int = 0x8947, vlan: bool = False) -> bytes:
    tag = struct.pack(">HH", 0x8100, 7) if vlan else b""
    return b"\xff" * 6 + bytes(6) + tag + struct.pack(">H", ether_type) + packet


def udp(data: bytes, version: int = 4, protocol: int = 17, fragment: int = 0) -> bytes:
    """Return an IP packet with a UDP datagram, from and to ports that mean nothing."""
    inner = struct.pack(">HHHH", 40000, 50000, 8 + len(data), 0) + data
    if version == 6:
        return struct.pack(">IHBB", 6 << 28, len(inner), protocol, 64) + bytes(32) + inner
    size = struct.pack(">HHHBBH", 20 + len(inner), 0, fragment, 64, protocol, 0)
    return b"\x45\0" + size + bytes(8) + inner


def wifi(packet: bytes, quality: bool = True, snap: bool = True) -> bytes:
    """Return a data frame outside the context of a BSS, as 802.11p sends it."""
    header = bytes([0x88 if quality else 0x08, 0]) + bytes(2) + b"\xff" * 6 + bytes(6) + b"\xff" * 6 + bytes(2)
    logical = b"\xaa\xaa\x03\x00\x00\x00" if snap else b""
    return header + (bytes(2) if quality else b"") + logical + b"\x89\x47" + packet


def radiotap(frame: bytes, padded: bool = False) -> bytes:
    """Put a receiver's header before a frame: clock, flags and rate; with padding behind the frame's own if asked."""
    if padded:
        frame = frame[:26] + bytes(2) + frame[26:]
    fields = bytes(8) + bytes([0x10 | (0x20 if padded else 0), 12])
    return struct.pack("<BBHI", 0, 0, 8 + len(fields), 0b111) + fields + frame + bytes(4)


# captures


def pcap(frames: Sequence[tuple[int, bytes]], link_type: int = 1, order: str = "<", nanoseconds: bool = False) -> bytes:
    magic, unit = (0xA1B23C4D, 1) if nanoseconds else (0xA1B2C3D4, 1000)
    parts = [struct.pack(order + "IHHiIII", magic, 2, 4, 0, 0, 65535, link_type)]
    for stamp_ns, data in frames:
        seconds, fraction = divmod(stamp_ns, 10**9)
        parts.append(struct.pack(order + "IIII", seconds, fraction // unit, len(data), len(data)) + data)
    return b"".join(parts)


def pcapng_block(order: str, kind: int, body: bytes) -> bytes:
    body += bytes(-len(body) % 4)
    size = struct.pack(order + "I", 12 + len(body))
    return struct.pack(order + "I", kind) + size + body + size


def pcapng(frames: Sequence[tuple[int, int, bytes]], interfaces: Sequence[tuple[int, int]], order: str = "<") -> bytes:
    """Return a capture; a frame is its interface, time and bytes, an interface its link type and if_tsresol."""
    parts = [pcapng_block(order, 0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1))]
    for link_type, resolution in interfaces:
        options = struct.pack(order + "HHB3xHH", 9, 1, resolution, 0, 0)
        parts.append(pcapng_block(order, 1, struct.pack(order + "HHI", link_type, 0, 0) + options))
    for number, stamp_ns, data in frames:
        resolution = interfaces[number][1]
        per_second = 2 ** (resolution & 127) if resolution & 128 else 10**resolution
        ticks = -(-stamp_ns * per_second // 10**9)
        head = struct.pack(order + "IIIII", number, ticks >> 32, ticks & 0xFFFFFFFF, len(data), len(data))
        parts.append(pcapng_block(order, 6, head + data))
    return b"".join(parts)


def received(log: CamLog) -> list[int]:
    return [int(stamp) + LATENCY_NS for stamp in log.stamps_ns]


# whole files, by what they are


def hex_lines(log: CamLog, stamp: Callable[[int], str] = lambda ns: f"{ns / 1e9:.6f} ") -> str:
    return "".join(f"{stamp(ns)}{data.hex()}\n" for ns, data in zip(received(log), cams(log), strict=True))


def write_hex(folder: Path, log: CamLog) -> Path:
    (folder / "log.txt").write_text(hex_lines(log))
    return folder / "log.txt"


def write_hex_gn(folder: Path, log: CamLog) -> Path:
    """Write secured packets without times of reception: their headers tell when they were signed."""
    signed = [signed_packet(data, ns + 1000) for data, ns in zip(cams(log), log.stamps_ns.tolist(), strict=True)]
    (folder / "signed.hex").write_text("\n".join(data.hex(" ") for data in signed))
    return folder / "signed.hex"


def write_pcap_udp(folder: Path, log: CamLog) -> Path:
    """Write what a unit forwards: IP packets, with a CAM and nothing else in each."""
    frames = [(ns, udp(data)) for ns, data in zip(received(log), cams(log), strict=True)]
    (folder / "a.pcap").write_bytes(pcap(frames, 101))
    return folder / "a.pcap"


def write_pcap(folder: Path, log: CamLog) -> Path:
    frames = [ethernet(gn_packet(data)) for data in cams(log)]
    (folder / "a.pcap").write_bytes(pcap(list(zip(received(log), frames, strict=True))))
    return folder / "a.pcap"


def write_pcap_wifi_signed(folder: Path, log: CamLog) -> Path:
    frames = [radiotap(wifi(signed_packet(data))) for data in cams(log)]
    content = pcap(list(zip(received(log), frames, strict=True)), 127, ">", nanoseconds=True)
    (folder / "a.pcap.gz").write_bytes(gzip.compress(content))
    return folder / "a.pcap.gz"


def write_pcapng(folder: Path, log: CamLog) -> Path:
    """Write what three interfaces with clocks of their own received, taking turns."""
    links = [(1, 9), (127, 6), (105, 0x80 | 20)]
    wrap = [
        lambda data: ethernet(gn_packet(data), vlan=True),
        lambda data: radiotap(wifi(signed_packet(data)), padded=True),
        lambda data: wifi(gn_packet(data, kind=0x51), quality=False, snap=False),
    ]
    frames = [(i % 3, ns, wrap[i % 3](data)) for i, (ns, data) in enumerate(zip(received(log), cams(log), strict=True))]
    (folder / "a.pcapng").write_bytes(pcapng(frames, links))
    return folder / "a.pcapng"


COLUMNS = (
    ("timestamp", lambda log, i: f"{log.stamps_ns[i] // 10**9}.{log.stamps_ns[i] % 10**9:09d}"),
    ("station_id", lambda log, i: f"{log.station_id[i]}"),
    ("latitude", lambda log, i: f"{log.latitude_deg[i]:.7f}"),
    ("longitude", lambda log, i: f"{log.longitude_deg[i]:.7f}"),
    ("heading", lambda log, i: f"{log.heading_deg[i]:.1f}"),
    ("speed", lambda log, i: f"{log.speed_mps[i]:.2f}"),
    ("vehicle_length", lambda log, i: f"{log.length_m[i]:.1f}"),
    ("vehicle_width", lambda log, i: f"{log.width_m[i]:.1f}"),
    ("altitude", lambda log, i: f"{log.altitude_m[i]:.2f}"),
    ("semi_major_95", lambda log, i: f"{log.semi_major_95_m[i]:.2f}"),
    ("semi_minor_95", lambda log, i: f"{log.semi_minor_95_m[i]:.2f}"),
    ("ellipse_orientation", lambda log, i: f"{log.ellipse_orientation_deg[i]:.1f}"),
)


def csv_text(log: CamLog, separator: str = ",") -> str:
    rows = [[name for name, _ in COLUMNS], *([cell(log, i) for _, cell in COLUMNS] for i in range(len(log)))]
    return "".join(separator.join(row) + "\n" for row in rows)


def write_csv_gz(folder: Path, log: CamLog) -> Path:
    (folder / "cam.csv").write_bytes(gzip.compress(csv_text(log).encode()))
    return folder / "cam.csv"


def write_csv_utf16(folder: Path, log: CamLog) -> Path:
    """Write what a German spreadsheet calls Unicode text."""
    (folder / "cam.txt").write_text(csv_text(log, "\t").replace(".", ","), encoding="utf-16")
    return folder / "cam.txt"


# bags, with the elements of etsi_its_cam_msgs up to those that are needed, and something behind them

CAM_TYPE = "etsi_its_cam_msgs/msg/CAM"
_PARTS = {
    "CAM": "ItsPduHeader header\nCoopAwareness cam",
    "ItsPduHeader": "uint8 protocol_version\nuint8 MESSAGE_ID_CAM = 2\nuint8 message_id\nStationID station_id",
    "StationID": "uint32 value\nuint32 MAX = 4294967295",
    "CoopAwareness": "GenerationDeltaTime generation_delta_time\nCamParameters cam_parameters",
    "GenerationDeltaTime": "uint16 value",
    "CamParameters": "BasicContainer basic_container\nHighFrequencyContainer high_frequency_container\n"
    "bool low_frequency_container_is_present",
    "BasicContainer": "StationType station_type\nReferencePosition reference_position",
    "StationType": "uint8 value",
    "ReferencePosition": "Latitude latitude\nLongitude longitude\nPosConfidenceEllipse position_confidence_ellipse\n"
    "Altitude altitude",
    "Latitude": "int32 value\nint32 UNAVAILABLE = 900000001",
    "Longitude": "int32 value",
    "PosConfidenceEllipse": "SemiAxisLength semi_major_confidence\nSemiAxisLength semi_minor_confidence\n"
    "HeadingValue semi_major_orientation",
    "SemiAxisLength": "uint16 value",
    "Altitude": "AltitudeValue altitude_value\nAltitudeConfidence altitude_confidence",
    "AltitudeValue": "int32 value",
    "AltitudeConfidence": "uint8 value",
    "HighFrequencyContainer": "uint8 choice\nBasicVehicleContainerHighFrequency basic_vehicle_container_high_frequency",
    "BasicVehicleContainerHighFrequency": "Heading heading\nSpeed speed\nDriveDirection drive_direction\n"
    "VehicleLength vehicle_length\nVehicleWidth vehicle_width\nfloat64[] what_follows",
    "Heading": "HeadingValue heading_value\nHeadingConfidence heading_confidence",
    "HeadingValue": "uint16 value",
    "HeadingConfidence": "uint8 value",
    "Speed": "SpeedValue speed_value\nSpeedConfidence speed_confidence",
    "SpeedValue": "uint16 value",
    "SpeedConfidence": "uint8 value",
    "DriveDirection": "uint8 value",
    "VehicleLength": "VehicleLengthValue vehicle_length_value\n"
    "VehicleLengthConfidenceIndication vehicle_length_confidence_indication",
    "VehicleLengthValue": "uint16 value",
    "VehicleLengthConfidenceIndication": "uint8 value",
    "VehicleWidth": "uint8 value",
}


def definition(parts: Mapping[str, str] = _PARTS) -> str:
    """Return the definition of a CAM as a bag holds it."""
    rest = [f"MSG: etsi_its_cam_msgs/{name}\n{text}\n" for name, text in parts.items() if name != "CAM"]
    return ("=" * 80 + "\n").join([parts["CAM"] + "\n", *rest])


ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
for _store in (ROS1, ROS2):
    _store.register(get_types_from_msg(definition(), CAM_TYPE))


def ros_values(log: CamLog, i: int, choice: int = 0) -> dict[str, Any]:
    """Return a message's elements by their names, each number in an element ``value`` as etsi_its_messages has it."""
    delta_ms = (int(log.stamps_ns[i]) - EPOCH_NS + LEAP_NS) // 10**6 % 65536

    def value(number: int) -> dict[str, int]:
        return {"value": number}

    position = {
        "latitude": value(raw(log.latitude_deg[i], 1e7)),
        "longitude": value(raw(log.longitude_deg[i], 1e7)),
        "position_confidence_ellipse": {
            "semi_major_confidence": value(raw(log.semi_major_95_m[i], 100)),
            "semi_minor_confidence": value(raw(log.semi_minor_95_m[i], 100)),
            "semi_major_orientation": value(raw(log.ellipse_orientation_deg[i], 10)),
        },
        "altitude": {"altitude_value": value(raw(log.altitude_m[i], 100)), "altitude_confidence": value(15)},
    }
    vehicle = {
        "heading": {"heading_value": value(raw(log.heading_deg[i], 10)), "heading_confidence": value(10)},
        "speed": {"speed_value": value(raw(log.speed_mps[i], 100)), "speed_confidence": value(5)},
        "drive_direction": value(0),
        "vehicle_length": {
            "vehicle_length_value": value(raw(log.length_m[i], 10)),
            "vehicle_length_confidence_indication": value(0),
        },
        "vehicle_width": value(raw(log.width_m[i], 10)),
        "what_follows": [1.0, 2.0],
    }
    return {
        "header": {"protocol_version": 2, "message_id": 2, "station_id": value(int(log.station_id[i]))},
        "cam": {
            "generation_delta_time": value(delta_ms),
            "cam_parameters": {
                "basic_container": {"station_type": value(5), "reference_position": position},
                "high_frequency_container": {"choice": choice, "basic_vehicle_container_high_frequency": vehicle},
                "low_frequency_container_is_present": False,
            },
        },
    }


def ros_message(store: Typestore, name: str, values: Mapping[str, Any]) -> Any:
    """Return a message of a type with these elements."""
    elements = {}
    for field_name, (node, detail) in store.fielddefs[name][1]:
        given = values[field_name]
        if node.name == "NAME":
            given = ros_message(store, detail, given)
        elif node.name in ("ARRAY", "SEQUENCE"):
            given = np.array(given, dtype=np.float64)
        elements[field_name] = given
    return store.types[name](**elements)


Sent = Sequence[tuple[int, Mapping[str, Any]]]
"""When each message was recorded, and its elements."""


def write_bag1(path: Path, topics: Mapping[str, tuple[str, Sent]]) -> Path:
    with Writer1(path) as writer:
        for topic, (name, sent) in topics.items():
            told = {"msgdef": definition(), "md5sum": "0" * 32} if name == CAM_TYPE else {"typestore": ROS1}
            connection = writer.add_connection(topic, name, **told)
            for ns, values in sent:
                writer.write(connection, ns, ROS1.serialize_ros1(ros_message(ROS1, name, values), name))
    return path


def write_bag2(
    path: Path, topics: Mapping[str, tuple[str, Sent]], storage: str = "MCAP", told: str | None = None
) -> Path:
    with Writer2(path, version=9, storage_plugin=StoragePlugin[storage]) as writer:
        for topic, (name, sent) in topics.items():
            text = definition() if told is None else told
            known = {"msgdef": text, "rihs01": "RIHS01_0"} if name == CAM_TYPE else {"typestore": ROS2}
            connection = writer.add_connection(topic, name, **known)
            for ns, values in sent:
                writer.write(connection, ns, ROS2.serialize_cdr(ros_message(ROS2, name, values), name))
    return path


def ros_cams(log: CamLog) -> dict[str, tuple[str, Sent]]:
    return {"/v2x/cam": (CAM_TYPE, [(ns, ros_values(log, i)) for i, ns in enumerate(received(log))])}


def ros_fixes(log: CamLog) -> dict[str, tuple[str, Sent]]:
    fixes = []
    for i, ns in enumerate(log.stamps_ns.tolist()):
        seconds, nanoseconds = divmod(ns, 10**9)
        header = {"seq": i, "stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": "antenna"}
        fix = {
            "header": header,
            "status": {"status": 2, "service": 1},
            "latitude": float(log.latitude_deg[i]),
            "longitude": float(log.longitude_deg[i]),
            "altitude": float(log.altitude_m[i]),
            "position_covariance": [0.04, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0, 1.0],
            "position_covariance_type": 2,
        }
        fixes.append((ns + 3_000_000, fix))
    return {"/gps/fix": ("sensor_msgs/msg/NavSatFix", fixes)}


def asn1_values(log: CamLog, i: int) -> dict[str, Any]:
    """Return a message with the names of the standard, as ASN.1 compilers write it."""
    vehicle = {
        "heading": {"headingValue": raw(log.heading_deg[i], 10), "headingConfidence": 10},
        "speed": {"speedValue": raw(log.speed_mps[i], 100), "speedConfidence": 5},
        "driveDirection": "forward",
        "vehicleLength": {"vehicleLengthValue": raw(log.length_m[i], 10)},
        "vehicleWidth": raw(log.width_m[i], 10),
    }
    position = {
        "latitude": raw(log.latitude_deg[i], 1e7),
        "longitude": raw(log.longitude_deg[i], 1e7),
        "positionConfidenceEllipse": {
            "semiMajorConfidence": raw(log.semi_major_95_m[i], 100),
            "semiMinorConfidence": raw(log.semi_minor_95_m[i], 100),
            "semiMajorOrientation": raw(log.ellipse_orientation_deg[i], 10),
        },
        "altitude": {"altitudeValue": raw(log.altitude_m[i], 100), "altitudeConfidence": "unavailable"},
    }
    path = [{"pathPosition": {"deltaLatitude": 10, "deltaLongitude": 20, "deltaAltitude": 12800}}] * 3
    containers = {
        "basicContainer": {"stationType": 5, "referencePosition": position},
        "highFrequencyContainer": ("basicVehicleContainerHighFrequency", vehicle),
        "lowFrequencyContainer": ("basicVehicleContainerLowFrequency", {"pathHistory": path}),
    }
    delta_ms = (int(log.stamps_ns[i]) - EPOCH_NS + LEAP_NS) // 10**6 % 65536
    header = {"protocolVersion": 2, "messageID": 2, "stationID": int(log.station_id[i])}
    return {"header": header, "cam": {"generationDeltaTime": delta_ms, "camParameters": containers}}


def write_json_lines(folder: Path, log: CamLog) -> Path:
    lines = [
        json.dumps({"timestamp": ns / 1e9, "rssi": -70, "fields": asn1_values(log, i)}) for i, ns in records_of(log)
    ]
    (folder / "a.jsonl").write_text("\n".join(lines) + "\n")
    return folder / "a.jsonl"


def write_json_list(folder: Path, log: CamLog) -> Path:
    """Write packets as tshark dissects them: numbers as text, and each name with its protocol's."""
    packets = []
    for i, ns in records_of(log):
        flat = dict(leaves(asn1_values(log, i)))
        its = {f"its.{name}": str(value) for name, value in flat.items() if name != "generationDeltaTime"}
        cam = {"cam.generationDeltaTime": str(flat["generationDeltaTime"]), "cam.camParameters_element": its}
        layers = {"frame": {"frame.time_epoch": f"{ns // 10**9}.{ns % 10**9:09d}"}, "its": cam}
        packets.append({"_index": "packets", "_source": {"layers": layers}})
    (folder / "a.json").write_text(json.dumps(packets))
    return folder / "a.json"


def records_of(log: CamLog) -> list[tuple[int, int]]:
    return list(enumerate(received(log)))


def leaves(values: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        inner = value[1] if isinstance(value, tuple) else value
        if isinstance(inner, dict):
            yield from leaves(inner)
        elif not isinstance(inner, list):
            yield name, inner


def write_json(folder: Path, log: CamLog) -> Path:
    """Write what V2AIX has of a scenario."""
    records = [{"recording_timestamp_nsec": ns, "message": ros_values(log, i)} for i, ns in enumerate(received(log))]
    fixes = [{"recording_timestamp_nsec": ns, "message": values} for ns, values in ros_fixes(log)["/gps/fix"][1]]
    (folder / "a.json").write_text(json.dumps({"/v2x/cam": records, "/gps/cohda_mk5/fix": fixes, "/v2x/denm": []}))
    return folder / "a.json"


def write_json_fixes(folder: Path, log: CamLog) -> Path:
    """Write GNSS fixes alone, recorded when they were measured."""
    fixes = [
        {"recording_timestamp_nsec": ns, "message": values}
        for ns, (_, values) in zip(log.stamps_ns.tolist(), ros_fixes(log)["/gps/fix"][1], strict=True)
    ]
    (folder / "a.json").write_text(json.dumps({"/gps/cohda_mk5/fix": fixes}))
    return folder / "a.json"


# what GNSS receivers write


def sentence(body: str) -> str:
    return f"${body}*{reduce(xor, body.encode()):02X}"


def angle(value: float, digits: int, sides: str) -> str:
    side = sides[1] if value < 0 else sides[0]
    degrees, minutes = divmod(round(abs(value) * 60 * 1e7), 60 * 10**7)
    return f"{degrees:0{digits}d}{minutes / 1e7:010.7f},{side}"


def nmea_lines(log: CamLog) -> list[str]:
    """Return GGA, GST, RMC and VTG of each moment."""
    lines = []
    for i, ns in enumerate(log.stamps_ns.tolist()):
        at = datetime.fromtimestamp(ns // 10**9, timezone.utc)
        time = f"{at:%H%M%S}.{ns % 10**9 // 10**6:03d}"
        place = f"{angle(log.latitude_deg[i], 2, 'NS')},{angle(log.longitude_deg[i], 3, 'EW')}"
        heading, speed = float(log.heading_deg[i]), float(log.speed_mps[i])
        lines += [
            sentence(f"GNGGA,{time},{place},4,20,0.6,{log.altitude_m[i] - 47.5:.2f},M,47.50,M,1.0,0000"),
            sentence(f"GNGST,{time},0.02,0.020,0.010,30.0,0.018,0.013,0.040"),
            sentence(f"GNRMC,{time},A,{place},{speed / 1852 * 3600:.4f},{heading:.2f},{at:%d%m%y},,,R,V"),
            sentence(f"GNVTG,{heading:.2f},T,,M,{speed / 1852 * 3600:.4f},N,{speed * 3.6:.4f},K,R"),
        ]
    return lines


def write_nmea(folder: Path, log: CamLog) -> Path:
    (folder / "a.nmea").write_text("\r\n".join(["$PUBX,00,x*33", "noise", *nmea_lines(log)]) + "\r\n")
    return folder / "a.nmea"


def write_gpx(folder: Path, log: CamLog) -> Path:
    points = [
        f'<trkpt lat="{log.latitude_deg[i]:.8f}" lon="{log.longitude_deg[i]:.8f}"><ele>{log.altitude_m[i]:.2f}</ele>'
        f"<time>{np.datetime64(int(ns), 'ns')}Z</time></trkpt>"
        for i, ns in enumerate(log.stamps_ns)
    ]
    half = len(points) // 2
    segments = "".join(f"<trkseg>{''.join(part)}</trkseg>" for part in (points[:half], points[half:]))
    (folder / "a.gpx").write_text(
        '<?xml version="1.0" encoding="UTF-8"?>\n<gpx version="1.1" creator="t" '
        f'xmlns="http://www.topografix.com/GPX/1/1"><trk><name>drive</name>{segments}</trk></gpx>\n'
    )
    return folder / "a.gpx"


def write_geojson(folder: Path, log: CamLog) -> Path:
    (folder / "a.geojson").write_text(to_geojson(log))
    return folder / "a.geojson"


def write_rtklib(folder: Path, log: CamLog, scale: str = "GPST", weeks: bool = False) -> Path:
    """Write what RTKLIB's rnx2rtkp does, with positions in degrees."""
    lines = ["% program   : RTKLIB ver.2.4.3", "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix)", "%"]
    lines += [f"%  {scale}   latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)  sdne(m)"]
    for i, ns in enumerate(log.stamps_ns.tolist()):
        ns += 18 * 10**9 if scale == "GPST" else 0
        since_ns = ns - 315_964_800 * 10**9
        week, rest_ns = divmod(since_ns, 7 * 86_400 * 10**9)
        at = datetime.fromtimestamp(ns // 10**9, timezone.utc)
        time = f"{week} {rest_ns / 1e9:.3f}" if weeks else f"{at:%Y/%m/%d %H:%M:%S}.{ns % 10**9 // 10**6:03d}"
        place = f"{log.latitude_deg[i]:.9f} {log.longitude_deg[i]:.9f} {log.altitude_m[i]:.4f}"
        lines.append(f"{time}   {place}   1  20   0.0200   0.0100   0.0100  -0.0050")
    (folder / "a.pos").write_text("\n".join(lines) + "\n")
    return folder / "a.pos"
