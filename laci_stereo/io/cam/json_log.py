"""Logs in JSON: topics as in the V2AIX data set, of CAMs with ROS's element names or of GNSS fixes; or records."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from laci_stereo.io.cam.columns import ALTITUDE, LATITUDE, LONGITUDE, Quantity
from laci_stereo.io.cam.etsi import Cam, DamagedError, OtherKindError
from laci_stereo.io.cam.gnss import ellipse_95, fixes_in, gnss_messages, recorded_drive
from laci_stereo.io.cam.json_records import parsed, read_cam_records
from laci_stereo.io.cam.received import Packet, Source, read_received
from laci_stereo.io.cam.recording import CamRecording
from laci_stereo.io.stamps import POSSIBLE_NS
from laci_stereo.io.text_file import listed, quoted

_FORMAT = "JSON (V2AIX)"
_TIME = "recording_timestamp_nsec"
_LARGEST = 1 << 40
_PARAMETERS = "cam.cam_parameters"
_POSITION = f"{_PARAMETERS}.basic_container.reference_position"
_ELLIPSE = f"{_POSITION}.position_confidence_ellipse"
_HIGH = f"{_PARAMETERS}.high_frequency_container"
_VEHICLE = f"{_HIGH}.basic_vehicle_container_high_frequency"
_ELEMENTS: Mapping[str, tuple[str, ...]] = {
    "station_id": ("header.station_id",),
    "delta_ms": ("cam.generation_delta_time",),
    "latitude": (f"{_POSITION}.latitude",),
    "longitude": (f"{_POSITION}.longitude",),
    "semi_major": (f"{_ELLIPSE}.semi_major_confidence", f"{_ELLIPSE}.semi_major_axis_length"),
    "semi_minor": (f"{_ELLIPSE}.semi_minor_confidence", f"{_ELLIPSE}.semi_minor_axis_length"),
    "orientation": (f"{_ELLIPSE}.semi_major_orientation", f"{_ELLIPSE}.semi_major_axis_orientation"),
    "altitude": (f"{_POSITION}.altitude.altitude_value",),
    "heading": (f"{_VEHICLE}.heading.heading_value",),
    "speed": (f"{_VEHICLE}.speed.speed_value",),
    "drive_direction": (f"{_VEHICLE}.drive_direction",),
    "length": (f"{_VEHICLE}.vehicle_length.vehicle_length_value",),
    "width": (f"{_VEHICLE}.vehicle_width",),
}
"""Paths of a CAM's elements, by the names of EN 302 637-2 or of TS 103 900."""


def looks_like_json(text: str) -> bool:
    """Return whether a text begins like JSON."""
    return text.lstrip()[:1] in ("{", "[")


def read_cam_json(path: Path, text: str) -> CamRecording:
    """Read an object of topics, each a list of messages with their recording times; or records as of other stacks.

    Raises
    ------
    CamError
        As in `parsed`, `read_received`, `recorded_drive` and `read_cam_records`.
    """
    topics, notes = parsed(path, text)
    if not isinstance(topics, dict) or not any(name.startswith("/") for name in topics):
        return read_cam_records(path, topics, notes)
    cams = [name for name, records in topics.items() if isinstance(records, list) and any(map(_is_cam, records))]
    fixes = [name for name, records in topics.items() if isinstance(records, list) and any(map(_is_fix, records))]
    if cams or len(fixes) != 1:
        notes = [f"topics read: {listed(cams)}"] if cams else []
        return read_received(Source(path, "message", _FORMAT), _packets(topics), notes)
    return _read_fixes(path, fixes[0], topics[fixes[0]])


def _is_cam(record: object) -> bool:
    return isinstance(_at(record, "message.cam"), dict)


def _is_fix(record: object) -> bool:
    return _at(record, "message.latitude") is not None


def _packets(topics: Mapping[str, object]) -> Iterator[Packet]:
    place = 0
    for name, records in topics.items():
        for record in records if isinstance(records, list) else []:
            place += 1
            if not _is_cam(record):
                yield Packet(place, OtherKindError(f"message of {quoted(name)}"), None)
                continue
            try:
                yield Packet(place, _cam(_at(record, "message")), _stamp_ns(record))
            except (DamagedError, OtherKindError) as problem:
                yield Packet(place, problem, None)


def _cam(message: object) -> Cam:
    if _at(message, f"{_HIGH}.choice") == 1:
        raise OtherKindError("CAM of a roadside unit")
    return Cam(**{name: _element(message, paths) for name, paths in _ELEMENTS.items()})


def _element(message: object, paths: tuple[str, ...]) -> int:
    found = [value for path in paths if (value := _at(message, path)) is not None]
    value = found[0] if found else None
    value = value.get("value") if isinstance(value, dict) else value
    if not isinstance(value, int) or isinstance(value, bool) or abs(value) > _LARGEST:
        raise DamagedError(f"{paths[0]} is {quoted(str(value))}; needed is a whole number")
    return value


def _stamp_ns(record: object) -> int:
    stamp_ns = _at(record, _TIME)
    if not isinstance(stamp_ns, int) or stamp_ns not in POSSIBLE_NS:
        raise DamagedError(f"{_TIME} is {quoted(str(stamp_ns))}; needed is a Unix time in nanoseconds")
    return stamp_ns


def _read_fixes(path: Path, topic: str, records: list[object]) -> CamRecording:
    fixes, problems = fixes_in(enumerate(records, 1), lambda record: (_stamp_ns(record), _fix(_at(record, "message"))))
    notes = [f"topic read: {quoted(topic)}, with the times of recording"]
    return recorded_drive(gnss_messages(path, "message", fixes, problems), notes, _FORMAT)


def _fix(message: object) -> Mapping[Quantity, float]:
    values = {quantity: _number(message, quantity.name) for quantity in (LATITUDE, LONGITUDE, ALTITUDE)}
    covariance = _at(message, "position_covariance")
    if not isinstance(covariance, list) or len(covariance) != 9 or _at(message, "position_covariance_type") == 0:
        return values
    try:
        return {**values, **ellipse_95(np.array(covariance, dtype=np.float64).reshape(3, 3)[:2, :2])}
    except (TypeError, ValueError, OverflowError) as problem:
        raise DamagedError(f"position_covariance is {quoted(str(covariance))}; needed are 9 numbers") from problem


def _number(message: object, name: str) -> float:
    value = _at(message, name)
    if isinstance(value, bool) or not isinstance(value, int | float) or abs(value) > _LARGEST:
        raise DamagedError(f"{name} is {quoted(str(value))}; needed is a number")
    return float(value)


def _at(found: object, path: str) -> object:
    """Return the value at a path of names separated by dots, or None."""
    for name in path.split("."):
        found = found.get(name) if isinstance(found, dict) else None
    return found
