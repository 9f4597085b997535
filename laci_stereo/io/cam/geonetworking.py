"""GeoNetworking packets (ETSI EN 302 636-4-1) with BTP (EN 302 636-5-1), plain or signed (TS 103 097, IEEE 1609.2)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from laci_stereo.io.cam.etsi import DamagedError, OtherKindError
from laci_stereo.io.cam.its_time import unix_ns
from laci_stereo.io.stamps import POSSIBLE_NS

ETHER_TYPE = 0x8947
CAM_PORT = 2001

_PORTS: Mapping[int, str] = dict(
    enumerate(("CAM", "DENM", "MAPEM", "SPATEM", "SAEM", "IVIM", "SREM", "SSEM", "CPM"), start=CAM_PORT)
) | {2018: "VAM"}
"""Message types by BTP destination port (TS 103 248)."""

_COMMON, _SECURED = 1, 2
_BTP = (1, 2)
_BEACON, _LOCATION_SERVICE = 1, 6
_EXTENDED_BYTES: Mapping[int, int] = {2: 48, 3: 44, 4: 44, 5: 28}
"""Sizes of the extended headers by header type: unicast, anycast, broadcast, and single- or multi-hop packets."""

_SIGNED_VERSION = 3
_UNSECURED, _SIGNED = 0x80, 0x81
_CONTENTS: Mapping[int, str] = {0x82: "encrypted packet", 0x83: "certificate request"}
_PAYLOAD_OF_DATA, _PAYLOAD_WITH_HASH = 0x40, 0x20
_HAS_GENERATION_TIME = 0x40


class Payload(NamedTuple):
    """The payload of a packet for a BTP port; ``signed_ns`` is the Unix time of signing, if the packet contains it."""

    data: bytes
    is_signed: bool = False
    signed_ns: int | None = None


def looks_like_packet(data: bytes) -> bool:
    """Return whether the version, next header and reserved byte are those of a GeoNetworking packet."""
    return len(data) >= 12 and data[0] >> 4 <= 1 and data[0] & 15 in (_COMMON, _SECURED) and data[1] == 0


def cam_payload(packet: bytes) -> Payload:
    """Return the CAM in a packet, still encoded; a signature is not verified.

    Raises
    ------
    OtherKindError
        If the packet is for another purpose, or encrypted.
    DamagedError
        If it is cut off or inconsistent.
    """
    rest = _Bytes(packet)
    next_header = rest.take(4)[0] & 15
    if next_header == _COMMON:
        return Payload(_to_cam_port(rest))
    if next_header == _SECURED:
        signed, signed_ns = _signed_data(rest)
        return Payload(_to_cam_port(_Bytes(signed)), True, signed_ns)
    raise OtherKindError(f"GeoNetworking packet with next header {next_header}")


def _to_cam_port(rest: _Bytes) -> bytes:
    """Strip the common, the extended and the BTP header, and return the rest."""
    common = rest.take(8)
    header_type = common[1] >> 4
    if header_type == _BEACON:
        raise OtherKindError("GeoNetworking beacon")
    if header_type == _LOCATION_SERVICE:
        raise OtherKindError("GeoNetworking location service packet")
    if header_type not in _EXTENDED_BYTES or common[0] >> 4 not in _BTP:
        raise OtherKindError("GeoNetworking packet without BTP")
    rest.take(_EXTENDED_BYTES[header_type])
    port = int.from_bytes(rest.take(4)[:2], "big")
    if port != CAM_PORT:
        raise OtherKindError(_PORTS.get(port, f"BTP port {port}"))
    return rest.rest()


def _signed_data(rest: _Bytes) -> tuple[bytes, int | None]:
    """Return the signed data and the time of signing from Ieee1609Dot2Data in octet encoding rules (COER)."""
    version, content = rest.take(2)
    if version != _SIGNED_VERSION:
        raise OtherKindError(f"secured packet of version {version}")
    if content == _UNSECURED:
        return rest.take(rest.length()), None
    if content != _SIGNED:
        raise OtherKindError(_CONTENTS.get(content, f"secured packet with content {content:#04x}"))
    rest.take(1)  # the hash algorithm
    present = rest.take(1)[0]
    if not present & _PAYLOAD_OF_DATA:
        raise OtherKindError("signed packet without data")
    inner_version, inner = rest.take(2)
    if (inner_version, inner) != (_SIGNED_VERSION, _UNSECURED):
        raise OtherKindError("signed packet with secured data")
    data = rest.take(rest.length())
    return data, None if present & _PAYLOAD_WITH_HASH else _generation_time(rest)


def _generation_time(header: _Bytes) -> int | None:
    has_time = header.take(1)[0] & _HAS_GENERATION_TIME
    header.take(header.length())  # the application's identifier (PSID)
    stamp_ns = unix_ns(int.from_bytes(header.take(8), "big")) if has_time else 0
    return stamp_ns if stamp_ns in POSSIBLE_NS else None


class _Bytes:
    """A reader that takes bytes from the front."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._taken = 0

    def take(self, count: int) -> bytes:
        """Return the next ``count`` bytes."""
        end = self._taken + count
        if end > len(self._data):
            raise DamagedError(f"the packet has {len(self._data)} bytes; needed are at least {end}")
        taken = self._data[self._taken : end]
        self._taken = end
        return taken

    def length(self) -> int:
        """Read a length determinant."""
        first = self.take(1)[0]
        return int.from_bytes(self.take(first & 0x7F), "big") if first & 0x80 else first

    def rest(self) -> bytes:
        """Return the remaining bytes."""
        return self._data[self._taken :]
