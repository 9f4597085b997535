"""The file formats of packet captures, pcap and pcapng: frames with their link type and time.

Only these two are needed, and little of them, so they are read here; dpkt, which also reads them, applies the clock of
a pcapng file's first interface to all interfaces, and its latest release is from 2022.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

PCAP_FORMATS: Mapping[bytes, tuple[str, int]] = {
    b"\xd4\xc3\xb2\xa1": ("<", 1000),
    b"\xa1\xb2\xc3\xd4": (">", 1000),
    b"\x4d\x3c\xb2\xa1": ("<", 1),
    b"\xa1\xb2\x3c\x4d": (">", 1),
}
"""By magic number: byte order, and nanoseconds per unit of a time stamp's fraction."""

PCAPNG_MAGIC = b"\x0a\x0d\x0d\x0a"

_INTERFACE, _SIMPLE, _ENHANCED = 1, 3, 6
_BYTE_ORDERS: Mapping[bytes, str] = {b"\x4d\x3c\x2b\x1a": "<", b"\x1a\x2b\x3c\x4d": ">"}
_TIME_RESOLUTION, _TIME_OFFSET = 9, 14


class Frame(NamedTuple):
    """A frame that an interface received; ``stamp_ns`` is Unix time, None where the file does not record it."""

    link_type: int
    stamp_ns: int | None
    data: bytes


class CaptureError(Exception):
    """A capture cannot be read beyond this point."""


@dataclass(frozen=True)
class _Interface:
    """An interface: the link type of its frames, and its clock, in ticks of ``1 / per_second`` s since ``offset_s``."""

    link_type: int
    per_second: int
    offset_s: int

    def stamp_ns(self, ticks: int) -> int:
        return self.offset_s * 10**9 + ticks * 10**9 // self.per_second


def is_capture(content: bytes) -> bool:
    """Return whether a file is a capture, by its first bytes."""
    return content[:4] in PCAP_FORMATS or content[:4] == PCAPNG_MAGIC


def frames(content: bytes) -> Iterator[Frame]:
    """Yield the frames of a capture.

    Raises
    ------
    CaptureError
        Where it is damaged or cut off, after the intact frames.
    """
    return _pcapng(content) if content[:4] == PCAPNG_MAGIC else _pcap(content)


def _pcap(content: bytes) -> Iterator[Frame]:
    order, fraction_ns = PCAP_FORMATS[content[:4]]
    if len(content) < 24:
        raise CaptureError(f"its header has {len(content)} of 24 bytes")
    link_type = struct.unpack_from(order + "I", content, 20)[0] & 0xFFFF
    place = 24
    while place < len(content):
        seconds, fraction, size = struct.unpack(order + "III", _part(content, place, 12))
        yield Frame(link_type, seconds * 10**9 + fraction * fraction_ns, _part(content, place + 16, size))
        place += 16 + size


def _pcapng(content: bytes) -> Iterator[Frame]:
    order, place = "<", 0
    interfaces: list[_Interface] = []
    while place < len(content):
        if content[place : place + 4] == PCAPNG_MAGIC:
            order, interfaces = _section_order(content, place), []
        kind, size = struct.unpack(order + "II", _part(content, place, 8))
        if size < 12 or size % 4:
            raise CaptureError(f"a block of {size} bytes")
        body = _part(content, place + 8, size - 12)
        if kind == _INTERFACE:
            interfaces.append(_interface(order, body))
        elif kind in (_ENHANCED, _SIMPLE):
            yield _block_frame(order, kind, body, interfaces)
        place += size


def _section_order(content: bytes, place: int) -> str:
    mark = _part(content, place + 8, 4)
    if mark not in _BYTE_ORDERS:
        raise CaptureError(f"a section with the byte order mark {mark.hex()}")
    return _BYTE_ORDERS[mark]


def _interface(order: str, body: bytes) -> _Interface:
    link_type = struct.unpack(order + "H", _part(body, 0, 2))[0]
    per_second, offset_s, place = 1_000_000, 0, 8
    while place + 4 <= len(body):
        code, size = struct.unpack_from(order + "HH", body, place)
        value = _part(body, place + 4, size)
        if code == _TIME_RESOLUTION and size == 1:
            per_second = 2 ** (value[0] & 0x7F) if value[0] & 0x80 else 10 ** value[0]
        elif code == _TIME_OFFSET and size == 8:
            offset_s = struct.unpack(order + "q", value)[0]
        place += 4 + size + -size % 4
    return _Interface(link_type, per_second, offset_s)


def _block_frame(order: str, kind: int, body: bytes, interfaces: list[_Interface]) -> Frame:
    if kind == _SIMPLE:
        return Frame(_of(interfaces, 0).link_type, None, body[4:])
    number, high, low, size = struct.unpack(order + "IIII", _part(body, 0, 16))
    interface = _of(interfaces, number)
    return Frame(interface.link_type, interface.stamp_ns(high << 32 | low), _part(body, 20, size))


def _of(interfaces: list[_Interface], number: int) -> _Interface:
    if number >= len(interfaces):
        raise CaptureError(f"a packet of interface {number}, of which it tells nothing")
    return interfaces[number]


def _part(content: bytes, start: int, size: int) -> bytes:
    part = content[start : start + size]
    if len(part) != size:
        raise CaptureError(f"{len(part)} of {size} bytes are there")
    return part
