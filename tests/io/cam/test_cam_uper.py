from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from laci_stereo.io.cam.columns import AXES, HEADING, LATITUDE, LENGTH, LONGITUDE, QUANTITIES, SPEED, WIDTH
from laci_stereo.io.cam.etsi import Cam, DamagedError, OtherKindError, in_units, value_notes
from laci_stereo.io.cam.uper import decode_cam, is_cam, is_whole_cam
from tests.io.cam_asn1 import decode, encode, vehicle_cam
from tests.io.support import SHARED, mutations, needs_shared

VALUES = {
    "version": st.sampled_from([1, 2, 3]),
    "station": st.integers(0, 2**32 - 1),
    "delta_ms": st.integers(0, 65535),
    "latitude": st.integers(-900_000_000, 900_000_001),
    "longitude": st.integers(-1_800_000_000, 1_800_000_001),
    "ellipse": st.tuples(st.integers(0, 4095), st.integers(0, 4095), st.integers(0, 3601)),
    "altitude": st.integers(-100_000, 800_001),
    "heading": st.integers(0, 3601),
    "speed": st.integers(0, 16383),
    "direction": st.sampled_from(["forward", "backward", "unavailable"]),
    "length": st.integers(1, 1023),
    "width": st.integers(1, 62),
}
OPTIONAL: dict[str, Any] = {
    "accelerationControl": (b"\xa0", 7),
    "lanePosition": 3,
    "steeringWheelAngle": {"value": 7, "confidence": 2},
    "lateralAcceleration": {"value": 7, "confidence": 2},
    "performanceClass": 1,
}


def told(message: dict[str, Any]) -> Cam:
    """Return what a description of a message says."""
    parameters = message["cam"]["camParameters"]
    place = parameters["basicContainer"]["referencePosition"]
    vehicle = parameters["highFrequencyContainer"][1]
    ellipse = place["positionConfidenceEllipse"]
    return Cam(
        message["header"]["stationID"],
        message["cam"]["generationDeltaTime"],
        place["latitude"],
        place["longitude"],
        ellipse["semiMajorConfidence"],
        ellipse["semiMinorConfidence"],
        ellipse["semiMajorOrientation"],
        place["altitude"]["altitudeValue"],
        vehicle["heading"]["headingValue"],
        vehicle["speed"]["speedValue"],
        ("forward", "backward", "unavailable").index(vehicle["driveDirection"]),
        vehicle["vehicleLength"]["vehicleLengthValue"],
        vehicle["vehicleWidth"],
    )


@given(st.fixed_dictionaries(VALUES), st.sets(st.sampled_from(sorted(OPTIONAL))), st.integers(0, 40))
def test_what_a_general_encoder_writes_is_read(values: dict[str, Any], optional: set[str], history: int):
    message = vehicle_cam(**values)
    parameters = message["cam"]["camParameters"]
    parameters["highFrequencyContainer"][1].update({name: OPTIONAL[name] for name in optional})
    point = {"pathPosition": {"deltaLatitude": 5, "deltaLongitude": -6, "deltaAltitude": 12800}}
    low = {"vehicleRole": "r0", "exteriorLights": (b"\x00", 8), "pathHistory": [point] * history}
    parameters["lowFrequencyContainer"] = ("basicVehicleContainerLowFrequency", low)
    data = encode(message)
    assert is_cam(data)
    assert decode_cam(data) == told(message)
    assert is_whole_cam(data) == (values["version"] < 3 and abs(values["latitude"]) < 900_000_000)


def test_a_message_is_whole_with_its_last_bit_and_no_more():
    message = vehicle_cam()
    parameters = message["cam"]["camParameters"]
    point = {"pathPosition": {"deltaLatitude": 5, "deltaLongitude": -6, "deltaAltitude": 12800}, "pathDeltaTime": 7}
    low = {"vehicleRole": "r0", "exteriorLights": (b"\x00", 8), "pathHistory": [point] * 3}
    assert is_whole_cam(encode(message))
    parameters["lowFrequencyContainer"] = ("basicVehicleContainerLowFrequency", low)
    data = encode(message)
    assert is_whole_cam(data)
    assert not any(is_whole_cam(data[:size]) for size in range(len(data)))
    assert not is_whole_cam(data + b"\0")
    parameters["specialVehicleContainer"] = ("none", None)
    assert not is_whole_cam(encode(message))


@given(mutations(encode(vehicle_cam(heading=100, speed=500))).filter(lambda data: data[:2] == b"\x02\x02"))
@settings(max_examples=300, deadline=None)
def test_what_is_whole_is_what_a_general_encoder_writes(data: bytes):
    assert not is_whole_cam(data) or encode(decode(data)) == data


@given(mutations(encode(vehicle_cam(heading=100, speed=500))).filter(lambda data: data[:2] == b"\x02\x02"))
@settings(max_examples=300, deadline=None)
def test_what_is_read_is_what_a_general_decoder_reads(data: bytes):
    try:
        found = decode_cam(data)
    except (DamagedError, OtherKindError):
        return
    try:
        message = decode(data)
    except Exception:  # of many kinds: it reads to the end, where the bytes may be wrong
        return
    if message["cam"]["camParameters"]["highFrequencyContainer"][0] == "basicVehicleContainerHighFrequency":
        assert found == told(message)


@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(data: bytes):
    for start in (b"", b"\x02\x02\x00\x00\x00\x01"):
        with suppress(DamagedError, OtherKindError):
            assert decode_cam(start + data).width <= 62


@given(st.binary(max_size=130))
def test_what_a_later_version_adds_to_the_basic_container_is_skipped(addition: bytes):
    message = vehicle_cam(station=7, heading=1234, width=21)
    message["cam"]["camParameters"]["basicContainer"].update({"a": addition, "b": True})
    data = encode(message, ", a OCTET STRING, b BOOLEAN")
    assert decode_cam(data) == told(message)


def test_a_message_is_read_however_short_it_is_behind_the_width():
    data = encode(vehicle_cam(width=18))
    assert decode_cam(data[:34]).width == 18
    with pytest.raises(DamagedError, match="it has 33 bytes; needed are at least 34"):
        decode_cam(data[:33])


def test_other_messages_are_named():
    message = vehicle_cam()
    message["cam"]["camParameters"]["highFrequencyContainer"] = ("rsuContainerHighFrequency", {})
    with pytest.raises(OtherKindError, match="CAM of a roadside unit"):
        decode_cam(encode(message))
    data = encode(vehicle_cam())
    for header, kind in ((b"\x02\x01", "DENM"), (b"\x02\x63", "ITS message 99"), (b"\x09\x02", "protocolVersion 9")):
        with pytest.raises(OtherKindError, match=kind):
            decode_cam(header + data[2:])


def test_values_beyond_their_range_are_damage():
    # The heading stands behind header, time, what follows, extended, basic container, choice, and optional elements.
    data = bytearray(encode(vehicle_cam(heading=0)))
    bits = int.from_bytes(data, "big")
    shift = 8 * len(data) - (48 + 16 + 3 + 1 + 131 + 2 + 7 + 12)
    with pytest.raises(DamagedError, match="headingValue is 4095; needed is 0 to 3601"):
        decode_cam((bits | 4095 << shift).to_bytes(len(data), "big"))


def test_unavailable_and_out_of_range_are_missing():
    unknown = decode_cam(encode(vehicle_cam(latitude=900000001, longitude=1800000001)))
    outside = unknown._replace(semi_major=4094, semi_minor=4094, altitude=800000, speed=16382, length=1022, width=61)
    values = in_units([unknown, outside])
    for quantity in QUANTITIES:
        assert np.isnan(values[quantity]).tolist() == [True, quantity not in AXES]
    assert [values[quantity][1] for quantity in AXES] == [40.94, 40.94]  # or more, says TS 102 894-2
    notes = value_notes(values, np.array([True, True]))
    assert "semi_major_95 is out of range in 1: taken as 40.94 m, the least that it means" in notes


@needs_shared
def test_a_real_message():
    data = bytes.fromhex((SHARED / "formats/cam/real_cam_hamburg.hex").read_text())
    cam = decode_cam(data)
    assert is_whole_cam(data)
    assert cam == told(decode(data))
    assert cam.station_id == 3725855973
    values = in_units([cam])
    found = {quantity: float(values[quantity][0]) for quantity in (LATITUDE, LONGITUDE, HEADING, SPEED, LENGTH, WIDTH)}
    assert found == {LATITUDE: 53.5626518, LONGITUDE: 9.9761485, HEADING: 199.4, SPEED: 12.77, LENGTH: 4.2, WIDTH: 1.8}
