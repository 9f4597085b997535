"""CAMs in packet captures: GeoNetworking over Ethernet or IEEE 802.11p, or forwarded by UDP."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path

from laci_stereo.io.cam.datagrams import datagram, forwarded_cam
from laci_stereo.io.cam.etsi import DamagedError, OtherKindError
from laci_stereo.io.cam.geonetworking import ETHER_TYPE, Payload, cam_payload
from laci_stereo.io.cam.packet_capture import PCAPNG_MAGIC, CaptureError, frames
from laci_stereo.io.cam.received import Packet, Source, packet_of, read_received
from laci_stereo.io.cam.recording import CamRecording
from laci_stereo.io.stamps import POSSIBLE_NS

_IP = (0x0800, 0x86DD)
_VLAN = (0x8100, 0x88A8)
_ETHERNET_TYPES: Mapping[int, str] = {0x0800: "IPv4", 0x86DD: "IPv6", 0x0806: "ARP", 0x88DC: "WSMP"}

_SNAP = bytes.fromhex("aaaa03000000")
_WIFI_DATA = 2
_FROM_AND_TO_DS, _PROTECTED, _ORDER = 3, 0x40, 0x80

_HAS_CLOCK, _HAS_FLAGS, _MORE_MASKS = 1, 2, 1 << 31
_PADDED = 0x20


def read_cam_capture(path: Path, content: bytes) -> CamRecording:
    """Read a pcap or pcapng file.

    Raises
    ------
    CamError
        As in `read_received`.
    """
    notes: list[str] = []
    kind = "pcapng" if content[:4] == PCAPNG_MAGIC else "pcap"

    def packets() -> Iterator[Packet]:
        place = 0
        try:
            for place, frame in enumerate(frames(content), 1):
                stamp_ns = frame.stamp_ns if frame.stamp_ns in POSSIBLE_NS else None
                yield packet_of(place, stamp_ns, partial(_payload, frame.link_type, frame.data))
        except CaptureError as problem:
            notes.append(f"{path} is damaged or cut off after {place} packets: {problem}; these are used")

    # If the capture is cut off, `packets` appends to the notes while it is consumed.
    return read_received(Source(path, "packet", f"a capture ({kind})"), packets(), notes)


def _payload(link_type: int, frame: bytes) -> Payload:
    if link_type not in _LINKS:
        raise OtherKindError(f"frame of link type {link_type}")
    try:
        ether_type, rest = _LINKS[link_type](frame)
    except DamagedError as problem:
        # The frame is too short to identify it as a CAM, so it does not count as a damaged one.
        raise OtherKindError(f"cut-off frame ({problem})") from problem
    if ether_type in _IP and (data := datagram(rest)) is not None:
        return forwarded_cam(data)
    if ether_type != ETHER_TYPE:
        raise OtherKindError(_ETHERNET_TYPES.get(ether_type, f"frame of ether type {ether_type:#06x}"))
    return cam_payload(rest)


def _ethernet(frame: bytes) -> tuple[int, bytes]:
    place = 12
    while (ether_type := _number(frame, place)) in _VLAN:
        place += 4
    return ether_type, frame[place + 2 :]


def _linux_cooked(frame: bytes) -> tuple[int, bytes]:
    return _number(frame, 14), frame[16:]


def _linux_cooked_2(frame: bytes) -> tuple[int, bytes]:
    return _number(frame, 0), frame[20:]


def _bare(frame: bytes) -> tuple[int, bytes]:
    return ETHER_TYPE, frame


def _ip(frame: bytes) -> tuple[int, bytes]:
    return _IP[_bytes(frame, 0, 1)[0] >> 4 == 6], frame


def _wifi(frame: bytes, padded: bool = False) -> tuple[int, bytes]:
    """Strip the header of an IEEE 802.11 frame, and LLC and SNAP, which 802.11-2016 omits at 5.9 GHz."""
    control, flags = divmod(_number(frame, 0), 256)
    if control >> 2 & 3 != _WIFI_DATA or control & 0x40:
        raise OtherKindError("Wi-Fi frame without data")
    if flags & _PROTECTED:
        raise OtherKindError("encrypted Wi-Fi frame")
    has_quality = control & 0x80
    size = 24 + (6 if flags & 3 == _FROM_AND_TO_DS else 0)
    size += (2 + (4 if flags & _ORDER else 0)) if has_quality else 0
    rest = frame[size + (-size % 4 if padded else 0) :]
    if rest[: len(_SNAP)] == _SNAP:
        rest = rest[len(_SNAP) :]
    return _number(rest, 0), rest[2:]


def _radiotap(frame: bytes) -> tuple[int, bytes]:
    """Strip the radiotap header of the receiver, whose flags say whether the frame's own header is padded."""
    size = int.from_bytes(_bytes(frame, 2, 2), "little")
    mask = first = int.from_bytes(_bytes(frame, 4, 4), "little")
    place = 8
    while mask & _MORE_MASKS:
        mask = int.from_bytes(_bytes(frame, place, 4), "little")
        place += 4
    if first & _HAS_CLOCK:
        place += -place % 8 + 8
    padded = bool(first & _HAS_FLAGS and _bytes(frame, place, 1)[0] & _PADDED)
    return _wifi(frame[size:], padded)


def _number(frame: bytes, place: int) -> int:
    return int.from_bytes(_bytes(frame, place, 2), "big")


def _bytes(frame: bytes, place: int, size: int) -> bytes:
    part = frame[place : place + size]
    if len(part) != size:
        raise DamagedError(f"{len(frame)} bytes")
    return part


_LINKS: Mapping[int, Callable[[bytes], tuple[int, bytes]]] = {
    1: _ethernet,
    105: _wifi,
    113: _linux_cooked,
    127: _radiotap,
    276: _linux_cooked_2,
    **dict.fromkeys((101, 228, 229), _ip),
    **dict.fromkeys(range(147, 163), _bare),
}
"""Parsers by link type; 147 to 162 are for private use, and some stacks use them for bare GeoNetworking packets."""
