"""CAMs in ASN.1's unaligned packed encoding rules (UPER), as they are transmitted.

The required elements are at the beginning of a CAM: the header, generationDeltaTime, the basic container, and the first
five elements of the vehicle's high frequency container. EN 302 637-2 (protocolVersion 1 and 2) and TS 103 900 encode
these identically, bit by bit, so a table of fields is enough to read them. An ASN.1 compiler such as asn1tools would
add two dependencies, take longer, and reject messages for errors in elements that are not needed; the tests compare
this reader with it.
"""

from __future__ import annotations

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
    bits = _Bits(data)
    version, message_id, station_id = bits.take(8), bits.take(8), bits.take(32)
    if message_id != CAM_ID:
        raise OtherKindError(pdu_kind(message_id))
    if version not in VERSIONS:
        raise OtherKindError(f"CAM of protocolVersion {version}")
    delta_ms = bits.take(16)
    bits.take(3)  # CamParameters: extension bit, presence bits of the two optional containers after the required ones
    extended = bits.take(1)
    _, latitude, longitude, major, minor, orientation, altitude, _ = bits.fields(_BASIC)
    if extended:
        bits.skip_additions()
    if bits.take(1):
        raise OtherKindError("CAM with an unknown high frequency container")
    if bits.take(1):
        raise OtherKindError("CAM of a roadside unit")
    _, heading, _, speed, _, direction, length, _, width = bits.fields(_VEHICLE)
    ellipse = (major, minor, orientation)
    return Cam(station_id, delta_ms, latitude, longitude, *ellipse, altitude, heading, speed, direction, length, width)


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
