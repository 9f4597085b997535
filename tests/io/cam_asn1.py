"""CAMs by asn1tools, from a description of EN 302 637-2's message in ASN.1, to hold the project's reader against."""

from __future__ import annotations

from functools import cache
from typing import Any

import asn1tools

# What EN 302 637-2 and TS 102 894-2 say about a CAM up to the low frequency container, written down anew.
DESCRIPTION = """
Awareness DEFINITIONS AUTOMATIC TAGS ::= BEGIN
CAM ::= SEQUENCE { header Header, cam CoopAwareness }
Header ::= SEQUENCE {
    protocolVersion INTEGER (0..255), messageID INTEGER (0..255), stationID INTEGER (0..4294967295) }
CoopAwareness ::= SEQUENCE { generationDeltaTime INTEGER (0..65535), camParameters Parameters }
Parameters ::= SEQUENCE {
    basicContainer Basic, highFrequencyContainer HighFrequency,
    lowFrequencyContainer LowFrequency OPTIONAL, specialVehicleContainer Special OPTIONAL, ... }
Basic ::= SEQUENCE { stationType INTEGER (0..255), referencePosition Position, ... ADDITION }
Position ::= SEQUENCE {
    latitude INTEGER (-900000000..900000001), longitude INTEGER (-1800000000..1800000001),
    positionConfidenceEllipse Ellipse, altitude Altitude }
Ellipse ::= SEQUENCE {
    semiMajorConfidence INTEGER (0..4095), semiMinorConfidence INTEGER (0..4095),
    semiMajorOrientation INTEGER (0..3601) }
Altitude ::= SEQUENCE {
    altitudeValue INTEGER (-100000..800001),
    altitudeConfidence ENUMERATED { a0, a1, a2, a3, a4, a5, a6, a7, a8, a9, a10, a11, a12, a13, a14, a15 } }
HighFrequency ::= CHOICE { basicVehicleContainerHighFrequency Vehicle, rsuContainerHighFrequency Roadside, ... }
Roadside ::= SEQUENCE { zones SEQUENCE (SIZE (1..16, ...)) OF INTEGER (0..7) OPTIONAL, ... }
Vehicle ::= SEQUENCE {
    heading Heading, speed Speed, driveDirection ENUMERATED { forward, backward, unavailable },
    vehicleLength Length, vehicleWidth INTEGER (1..62), longitudinalAcceleration Acceleration,
    curvature Curvature, curvatureCalculationMode ENUMERATED { yawRateUsed, yawRateNotUsed, unavailable, ... },
    yawRate YawRate, accelerationControl BIT STRING (SIZE (7)) OPTIONAL, lanePosition INTEGER (-1..14) OPTIONAL,
    steeringWheelAngle Steering OPTIONAL, lateralAcceleration Acceleration OPTIONAL,
    verticalAcceleration Acceleration OPTIONAL, performanceClass INTEGER (0..7) OPTIONAL, zone INTEGER (0..9) OPTIONAL }
Heading ::= SEQUENCE { headingValue INTEGER (0..3601), headingConfidence INTEGER (1..127) }
Speed ::= SEQUENCE { speedValue INTEGER (0..16383), speedConfidence INTEGER (1..127) }
Length ::= SEQUENCE {
    vehicleLengthValue INTEGER (1..1023), vehicleLengthConfidenceIndication ENUMERATED { l0, l1, l2, l3, l4 } }
Acceleration ::= SEQUENCE { value INTEGER (-160..161), confidence INTEGER (0..102) }
Curvature ::= SEQUENCE {
    value INTEGER (-1023..1023), confidence ENUMERATED { c0, c1, c2, c3, c4, c5, c6, c7 } }
YawRate ::= SEQUENCE {
    value INTEGER (-32766..32767), confidence ENUMERATED { y0, y1, y2, y3, y4, y5, y6, y7, y8 } }
Steering ::= SEQUENCE { value INTEGER (-511..512), confidence INTEGER (1..127) }
LowFrequency ::= CHOICE { basicVehicleContainerLowFrequency VehicleLow, ... }
VehicleLow ::= SEQUENCE {
    vehicleRole ENUMERATED { r0, r1, r2, r3, r4, r5, r6, r7, r8, r9, r10, r11, r12, r13, r14, r15 },
    exteriorLights BIT STRING (SIZE (8)), pathHistory SEQUENCE (SIZE (0..40)) OF PathPoint }
PathPoint ::= SEQUENCE { pathPosition Delta, pathDeltaTime INTEGER (1..65535, ...) OPTIONAL }
Delta ::= SEQUENCE {
    deltaLatitude INTEGER (-131071..131072), deltaLongitude INTEGER (-131071..131072),
    deltaAltitude INTEGER (-12700..12800) }
Special ::= CHOICE { none NULL, ... }
END
"""


@cache
def compiled(basic_addition: str = "", rules: str = "uper") -> Any:
    """Return the codec of some encoding rules.

    The basic container has what a later version might add to it, such as ``, a BOOLEAN``.
    """
    return asn1tools.compile_string(DESCRIPTION.replace(" ADDITION", basic_addition), rules)


def encode(message: dict[str, Any], basic_addition: str = "") -> bytes:
    """Return a CAM's bytes."""
    return bytes(compiled(basic_addition).encode("CAM", message))


def decode(data: bytes) -> Any:
    """Return what a CAM says."""
    return compiled().decode("CAM", data)


def vehicle_cam(
    *,
    version: int = 2,
    station: int = 4711,
    delta_ms: int = 0,
    latitude: int = 484226000,
    longitude: int = 99434000,
    ellipse: tuple[int, int, int] = (4095, 4095, 3601),
    altitude: int = 800001,
    heading: int = 3601,
    speed: int = 16383,
    direction: str = "forward",
    length: int = 1023,
    width: int = 62,
) -> dict[str, Any]:
    """Return the values of a vehicle's CAM with all that is required and no more."""
    position = {
        "latitude": latitude,
        "longitude": longitude,
        "positionConfidenceEllipse": dict(
            zip(("semiMajorConfidence", "semiMinorConfidence", "semiMajorOrientation"), ellipse, strict=True)
        ),
        "altitude": {"altitudeValue": altitude, "altitudeConfidence": "a15"},
    }
    vehicle = {
        "heading": {"headingValue": heading, "headingConfidence": 10},
        "speed": {"speedValue": speed, "speedConfidence": 5},
        "driveDirection": direction,
        "vehicleLength": {"vehicleLengthValue": length, "vehicleLengthConfidenceIndication": "l0"},
        "vehicleWidth": width,
        "longitudinalAcceleration": {"value": 3, "confidence": 102},
        "curvature": {"value": 0, "confidence": "c7"},
        "curvatureCalculationMode": "unavailable",
        "yawRate": {"value": -50, "confidence": "y8"},
    }
    return {
        "header": {"protocolVersion": version, "messageID": 2, "stationID": station},
        "cam": {
            "generationDeltaTime": delta_ms,
            "camParameters": {
                "basicContainer": {"stationType": 5, "referencePosition": position},
                "highFrequencyContainer": ("basicVehicleContainerHighFrequency", vehicle),
            },
        },
    }
