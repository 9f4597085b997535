"""CAMs as lines of hexadecimal digits, each after its time of reception; and CAMs in bare binary files."""

from __future__ import annotations

import re
from decimal import Decimal
from pathlib import Path

from laci_stereo.core.errors import CamError
from laci_stereo.io.cam.etsi import DamagedError, OtherKindError
from laci_stereo.io.cam.geonetworking import Payload, cam_payload, looks_like_packet
from laci_stereo.io.cam.received import Packet, Source, packet_of, read_received
from laci_stereo.io.cam.recording import CamRecording
from laci_stereo.io.cam.uper import HEADER_BYTES, decode_cam, is_cam
from laci_stereo.io.stamps import iso_time, number, unit_of
from laci_stereo.io.text_file import quoted

_FIRST_LINES = 20
_LONGEST_LINE = 20_000
"""Longest line that is read, characters; a packet on the air has at most 2,304 bytes."""

_SEPARATORS = " \t,;|"

# Matched against the reversed line, so that a long line is scanned once: "02 02 de", "02:02:de", "0202de", "0x0202de".
_BYTES_REVERSED = re.compile(
    r"(?:[0-9a-fA-F]{2}([ :])[0-9a-fA-F]{2}(?:\1[0-9a-fA-F]{2})*|(?:[0-9a-fA-F]{2}){6,})(?:[xX]0)?(?=$|[\s,;|])"
)


def looks_like_hex(text: str) -> bool:
    """Return whether one of the first lines ends in the digits of a CAM or a GeoNetworking packet."""
    head = (_parts(line) for line in text[: 1 << 16].splitlines()[:_FIRST_LINES])
    return any(data is not None and (is_cam(data) or looks_like_packet(data)) for _, data in head)


def read_cam_hex(path: Path, text: str) -> CamRecording:
    """Read lines that end in the digits of a CAM or of its packet, after the time of reception or nothing.

    Times are Unix times, in a unit that follows from their magnitude, or ISO 8601; where they are missing, the time in
    the header of a signed packet is used.

    Raises
    ------
    CamError
        As in `read_received`.
    """
    lines = [(i, line.strip()) for i, line in enumerate(text.splitlines(), 1)]
    parts = [(i, *_parts(line)) for i, line in lines if line and not line.startswith("#")]
    if parts and parts[0][2] is None:
        parts = parts[1:]  # a header line
    stamps = [_number(head) for _, head, _ in parts]
    unit = unit_of([value for value in stamps if value is not None])

    def packet(place: int, head: str, data: bytes | None) -> Packet:
        value, moment = _number(head), _moment(head)
        stamp_ns = unit.to_ns(value) if unit is not None and value is not None else moment
        if head and stamp_ns is None:
            problem = DamagedError(f"{quoted(head)} begins with no time; needed is a Unix or ISO 8601 time, or nothing")
            return Packet(place, problem, None)
        return packet_of(place, stamp_ns, lambda: _payload(data))

    packets = (packet(*part) for part in parts)
    notes = [f"times of reception: Unix time in {unit.name}"] if unit is not None else []
    return read_received(Source(path, "line", "lines of hexadecimal digits"), packets, notes)


def _number(head: str) -> Decimal | None:
    """Return the number at the beginning of the text before the digits, or None."""
    return next((value for text in _first(head) if (value := number(text)) is not None), None)


def _moment(head: str) -> int | None:
    """Return the ISO 8601 time at the beginning of the text before the digits, Unix nanoseconds, or None."""
    return next((moment.ns for text in _first(head) if (moment := iso_time(text)) is not None), None)


def _first(head: str) -> tuple[str, ...]:
    """Return candidates for a time: the whole text, its first cell, its first two words (date, time), its first one."""
    words = head.split()
    texts = (head, re.split(r"[,;|\t]", head)[0], " ".join(words[:2]), *words[:1])
    return tuple(text.strip(" []()") for text in texts)


def read_cam_binary(path: Path, content: bytes) -> CamRecording:
    """Refuse a file of one or several CAMs without times of reception, with a description of its content.

    Raises
    ------
    CamError
        Always: the file does not determine in which period of 65.536 s its times lie.
    """
    try:
        cam = decode_cam(content)
    except (DamagedError, OtherKindError) as problem:
        raise CamError(f"{path} begins like a CAM, but: {problem}; needed is a log of CAMs with times") from problem
    raise CamError(
        f"{path} holds {content.count(content[:HEADER_BYTES])} bare CAMs of station {cam.station_id}, the first at "
        f"{cam.latitude / 1e7:.7f}, {cam.longitude / 1e7:.7f} deg, without the time of their reception, and "
        "generationDeltaTime begins anew every 65.536 s; needed is a capture (pcap), or lines of a time and the CAM's "
        "hexadecimal digits"
    )


def _parts(line: str) -> tuple[str, bytes | None]:
    """Split a line into the text before the digits, and the bytes that the digits encode; None if there are none."""
    found = _BYTES_REVERSED.match(line[::-1].lstrip()) if len(line) <= _LONGEST_LINE else None
    if found is None:
        return "", None
    line = line.rstrip()
    start = len(line) - found.end()
    digits = line[start:].removeprefix("0x").removeprefix("0X").replace(":", " ")
    return line[:start].strip(_SEPARATORS), bytes.fromhex(digits)


def _payload(data: bytes | None) -> Payload:
    if data is None:
        raise DamagedError("it ends in no hexadecimal digits; needed are those of a CAM")
    return cam_payload(data) if looks_like_packet(data) else Payload(data)
