"""CAMs in a receiver's log: packets with the time of their reception, among messages of other kinds."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from laci_stereo.core.errors import CamError
from laci_stereo.core.frames import BoolArray, IntArray
from laci_stereo.io.cam.etsi import BACKWARD, UNKNOWN, Cam, DamagedError, OtherKindError, in_units, value_notes
from laci_stereo.io.cam.geonetworking import Payload
from laci_stereo.io.cam.its_time import generation_times
from laci_stereo.io.cam.recording import CamRecording, Messages, recorded
from laci_stereo.io.cam.uper import decode_cam
from laci_stereo.io.text_file import listed

_MOST_KINDS = 10


def counted(kinds: Counter[str]) -> str:
    """Return how many messages there are of each kind, in words."""
    return listed([f"{count} x {kind}" for kind, count in kinds.most_common()], _MOST_KINDS)


def left_out_note(kinds: Counter[str], noun: str) -> list[str]:
    """Return a note on the messages that are no CAM of a vehicle, if any."""
    return [f"{noun}s that are no CAM of a vehicle left out: {counted(kinds)}"] if kinds else []


@dataclass(frozen=True)
class Packet:
    """A received packet.

    Attributes
    ----------
    place : int
        Its running number in the file.
    cam : Cam or DamagedError or OtherKindError
        The message, or the reason why there is none.
    received_ns : int or None
        Unix time of reception; None where the file does not record it.
    is_signed : bool
    """

    place: int
    cam: Cam | DamagedError | OtherKindError
    received_ns: int | None
    is_signed: bool = False


def packet_of(place: int, received_ns: int | None, payload: Callable[[], Payload]) -> Packet:
    """Return the packet with the CAM in its payload, or with the error that opening the payload raises.

    Without a time of reception, the time of signing replaces it.
    """
    try:
        sent = payload()
        cam = decode_cam(sent.data)
    except (DamagedError, OtherKindError) as problem:
        return Packet(place, problem, received_ns)
    return Packet(place, cam, sent.signed_ns if received_ns is None else received_ns, sent.is_signed)


@dataclass(frozen=True)
class Source:
    """The source of packets: the file, the format's noun for a packet, and the format's name in words."""

    path: Path
    noun: str
    file_format: str


@dataclass
class _Gathered:
    """The CAMs, problems and other kinds of message found so far."""

    places: list[int] = field(default_factory=list)
    cams: list[Cam] = field(default_factory=list)
    received_ns: list[int] = field(default_factory=list)
    problems: dict[int, str] = field(default_factory=dict)
    kinds: Counter[str] = field(default_factory=Counter)
    signed: int = 0

    def add(self, packet: Packet) -> None:
        """Add a packet."""
        if isinstance(packet.cam, OtherKindError):
            self.kinds[str(packet.cam)] += 1
            return
        problem, cam = "", packet.cam
        if isinstance(cam, DamagedError):
            problem, cam = str(cam), UNKNOWN
        elif packet.received_ns is None:
            problem = (
                f"a CAM of station {cam.station_id} at {cam.latitude / 1e7:.7f}, {cam.longitude / 1e7:.7f} deg has no "
                "time of reception, and its generationDeltaTime begins anew every 65.536 s; needed is a Unix or ISO "
                "8601 time"
            )
        if problem:
            self.problems[len(self.cams)] = problem
        self.signed += packet.is_signed
        self.places.append(packet.place)
        self.cams.append(cam)
        self.received_ns.append(packet.received_ns or 0)


def read_received(source: Source, packets: Iterable[Packet], notes: Sequence[str] = ()) -> CamRecording:
    """Return the log of the CAMs among received packets; ``notes`` are on how their file was interpreted.

    Raises
    ------
    CamError
        If there is no CAM of a vehicle, or as in `recorded`.
    """
    found = _Gathered()
    for packet in packets:
        found.add(packet)
    if not found.cams:
        raise CamError(
            f"{source.path} is {source.file_format} and holds no CAM of a vehicle, but "
            f"{counted(found.kinds) or 'nothing at all'}; "
            "needed are CAMs (BTP port 2001)"
        )
    stations = np.array([cam.station_id for cam in found.cams], dtype=np.int64)
    good = np.array([i not in found.problems for i in range(len(found.cams))], dtype=bool)
    stamps, time_notes = _stamps(found, stations, good)
    values = in_units(found.cams)
    backward = np.array([cam.drive_direction == BACKWARD for cam in found.cams], dtype=bool)
    messages = Messages(source.path, source.noun, found.places, stamps, stations, values, found.problems, backward)
    other_notes = left_out_note(found.kinds, source.noun)
    if found.signed:
        other_notes.append(f"{found.signed} of {len(found.cams)} CAMs are signed; the signatures were not verified")
    return recorded(
        messages,
        [*notes, *time_notes, *other_notes, *value_notes(values, good)],
        source.file_format,
    )


def _stamps(found: _Gathered, stations: IntArray, good: BoolArray) -> tuple[IntArray, Sequence[str]]:
    """Return the messages' generation times, 0 where unknown, and notes."""
    stamps = np.zeros(len(stations), dtype=np.int64)
    if not good.any():
        return stamps, ()
    received = np.array(found.received_ns, dtype=np.int64)[good]
    delta = np.array([cam.delta_ms for cam in found.cams], dtype=np.int64)[good]
    stamps[good], notes = generation_times(received, delta, stations[good])
    return stamps, notes
