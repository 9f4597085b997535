"""CAMs in ASN.1's unaligned packed encoding rules (UPER), as they are transmitted.

The required elements are at the beginning of a CAM: the header, generationDeltaTime, the basic container, and the first
five elements of the vehicle's high frequency container. EN 302 637-2 (protocolVersion 1 and 2) and TS 103 900 encode
these identically, bit by bit, so a table of fields is enough to read them. An ASN.1 compiler such as asn1tools would
add two dependencies, take longer, and reject messages for errors in elements that are not needed; the tests compare
this reader with it. Where nothing but its content shows that some bytes are a CAM, what follows these elements is read
as well, up to the low frequency container.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from laci_stereo.io.cam.etsi import Cam, DamagedError, OtherKindError, pdu_kind

CAM_ID = 2
VERSIONS = (1, 2, 3)
"""Values of protocolVersion in use."""

HEADER_BYTES = 6

_FIRST_BYTES = 64


class _Field(NamedTuple):
    """A field: an INTEGER (lowest..highest) or an ENUMERATED counted from 0."""

    name: str
    bits: int
    lowest: int
    highest: int


_BASIC = (
    _Field("stationType", 8, 0, 255),
    _Field("latitude", 31, -900_000_000, 900_000_001),
    _Field("longitude", 32, -1_800_000_000, 1_800_000_001),
    _Field("semiMajorConfidence", 12, 0, 4095),
    _Field("semiMinorConfidence", 12, 0, 4095),
    _Field("semiMajorOrientation", 12, 0, 3601),
    _Field("altitudeValue", 20, -100_000, 800_001),
    _Field("altitudeConfidence", 4, 0, 15),
)
_VEHICLE = (
    _Field("which optional elements follow", 7, 0, 127),
    _Field("headingValue", 12, 0, 3601),
    _Field("headingConfidence", 7, 1, 127),
    _Field("speedValue", 14, 0, 16383),
    _Field("speedConfidence", 7, 1, 127),
    _Field("driveDirection", 2, 0, 2),
    _Field("vehicleLengthValue", 10, 1, 1023),
    _Field("vehicleLengthConfidenceIndication", 3, 0, 4),
    _Field("vehicleWidth", 6, 1, 62),
)
_ACCELERATION = (_Field("accelerationValue", 9, -160, 161), _Field("accelerationConfidence", 7, 0, 102))
_CURVATURE = (_Field("curvatureValue", 11, -1023, 1023), _Field("curvatureConfidence", 3, 0, 7))
_CURVATURE_MODE = (_Field("is extended", 1, 0, 0), _Field("curvatureCalculationMode", 2, 0, 2))
_YAW_RATE = (_Field("yawRateValue", 16, -32766, 32767), _Field("yawRateConfidence", 4, 0, 8))
_OPTIONAL: tuple[tuple[_Field, ...], ...] = (
    (_Field("accelerationControl", 7, 0, 127),),
    (_Field("lanePosition", 4, -1, 14),),
    (_Field("steeringWheelAngleValue", 10, -511, 512), _Field("steeringWheelAngleConfidence", 7, 1, 127)),
    _ACCELERATION,
    _ACCELERATION,
    (_Field("performanceClass", 3, 0, 7),),
)
_LOW = (
    _Field("is extended", 1, 0, 0),
    _Field("vehicleRole", 4, 0, 15),
    _Field("exteriorLights", 8, 0, 255),
    _Field("points of pathHistory", 6, 0, 40),
)
_PATH_POINT = (
    _Field("deltaLatitude", 18, -131071, 131072),
    _Field("deltaLongitude", 18, -131071, 131072),
    _Field("deltaAltitude", 15, -12700, 12800),
)
_PATH_TIME = (_Field("is extended", 1, 0, 0), _Field("pathDeltaTime", 16, 1, 65535))

_CERTAIN_VERSIONS = (1, 2)
_POLE = 900_000_000


def is_cam(data: bytes) -> bool:
    """Return whether the bytes begin with the header of a CAM."""
    return len(data) >= HEADER_BYTES and data[0] in VERSIONS and data[1] == CAM_ID


def decode_cam(data: bytes) -> Cam:
    """Decode a CAM from its ItsPduHeader on.

    Raises
    ------
    OtherKindError
        If it is another kind of message, or the CAM is not a vehicle's.
    DamagedError
        If it is too short, or an element is outside its range.
    """
    return _decode(_Bits(data)).cam


def is_whole_cam(data: bytes) -> bool:
    """Return whether the bytes are one vehicle's CAM at a known position, from the first bit to the last.

    Those of special vehicles, and with extensions, are not told from other data.
    """
    if not is_cam(data) or data[0] not in _CERTAIN_VERSIONS:
        return False
    bits = _Bits(data)
    try:
        start = _decode(bits)
        if start.is_special or abs(start.cam.latitude) >= _POLE:
            return False
        bits.fields((*_ACCELERATION, *_CURVATURE, *_CURVATURE_MODE, *_YAW_RATE))
        *optional, has_zone = start.optional
        for there, fields in zip(optional, _OPTIONAL, strict=True):
            bits.fields(fields if there else ())
        if start.has_low:
            *_, points = bits.fields(_LOW)
            for _ in range(points):
                has_time = bits.take(1)
                bits.fields((*_PATH_POINT, *(_PATH_TIME if has_time else ())))
    except (DamagedError, OtherKindError):
        return False
    return not has_zone and bits.is_at_end()


class _Start(NamedTuple):
    """The required elements of a CAM, and what follows them: the containers, and the optional elements of its own."""

    cam: Cam
    has_low: bool
    is_special: bool
    optional: Sequence[bool]


def _decode(bits: _Bits) -> _Start:
    version, message_id, station_id = bits.take(8), bits.take(8), bits.take(32)
    if message_id != CAM_ID:
        raise OtherKindError(pdu_kind(message_id))
    if version not in VERSIONS:
        raise OtherKindError(f"CAM of protocolVersion {version}")
    delta_ms = bits.take(16)
    # CamParameters: extension bit, presence bits of the two optional containers after the required ones.
    additions, low, special = (bool(bits.take(1)) for _ in range(3))
    extended = bits.take(1)
    _, latitude, longitude, major, minor, orientation, altitude, _ = bits.fields(_BASIC)
    if extended:
        bits.skip_additions()
    if bits.take(1):
        raise OtherKindError("CAM with an unknown high frequency container")
    if bits.take(1):
        raise OtherKindError("CAM of a roadside unit")
    follow, heading, _, speed, _, direction, length, _, width = bits.fields(_VEHICLE)
    ellipse = (major, minor, orientation)
    cam = Cam(station_id, delta_ms, latitude, longitude, *ellipse, altitude, heading, speed, direction, length, width)
    return _Start(cam, low, additions or special, [bool(follow >> i & 1) for i in range(6, -1, -1)])


class _Bits:
    """A reader that takes bits from the front of some bytes."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._load(_FIRST_BYTES)
        self._taken = 0

    def take(self, count: int) -> int:
        """Return the next ``count`` bits as an unsigned number."""
        self._taken += count
        if self._taken > self._length:
            self._load(len(self._data))
        if self._taken > self._length:
            raise DamagedError(f"it has {len(self._data)} bytes; needed are at least {(self._taken + 7) // 8}")
        return self._value >> (self._length - self._taken) & ((1 << count) - 1)

    def fields(self, fields: tuple[_Field, ...]) -> list[int]:
        """Return the values of the next fields."""
        values = [field.lowest + self.take(field.bits) for field in fields]
        for field, value in zip(fields, values, strict=True):
            if value > field.highest:
                raise DamagedError(f"{field.name} is {value}; needed is {field.lowest} to {field.highest}")
        return values

    def is_at_end(self) -> bool:
        """Return whether nothing is left but the padding of the last byte."""
        left = 8 * len(self._data) - self._taken
        return left < 8 and self._data[-1] & ((1 << left) - 1) == 0

    def skip_additions(self) -> None:
        """Skip the extension additions that a later version of the standard appended to a sequence."""
        if self.take(1):
            raise DamagedError("it has more than 64 additions; needed are at most 64")
        present = self.take(self.take(6) + 1).bit_count()
        for _ in range(present):
            size = self.take(8)
            if size >= 0xC0:
                raise DamagedError("it has an addition of more than 16,383 bytes")
            self.take(8 * ((size & 0x3F) << 8 | self.take(8) if size & 0x80 else size))

    def _load(self, size: int) -> None:
        head = self._data[:size]
        self._value, self._length = int.from_bytes(head, "big"), 8 * len(head)
