"""CAMs, or a vehicle's GNSS fixes, in ROS 1 bags, ROS 2 bags and MCAP files. Requires the extra ``bag``."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from laci_stereo.core.errors import CamError
from laci_stereo.io.bag.files import Bag, open_bag
from laci_stereo.io.bag.message_types import known_types, types_told
from laci_stereo.io.bag.records import CutOffError, Message, Topic
from laci_stereo.io.cam.columns import ALTITUDE, LATITUDE, LONGITUDE
from laci_stereo.io.cam.etsi import Cam, DamagedError, OtherKindError
from laci_stereo.io.cam.gnss import Fix, ellipse_95, gnss_messages, recorded_drive
from laci_stereo.io.cam.received import Packet, Source, read_received
from laci_stereo.io.cam.recording import CamRecording
from laci_stereo.io.stamps import POSSIBLE_NS
from laci_stereo.io.text_file import listed, quoted

CAM_TYPES = ("etsi_its_cam_msgs/msg/CAM", "etsi_its_cam_ts_msgs/msg/CAM")
FIX_TYPE = "sensor_msgs/msg/NavSatFix"
ODOMETRY_TYPE = "nav_msgs/msg/Odometry"

_NO_FIX = -1
_ROADSIDE_UNIT = 1

# All elements up to the last one that a `Cam` needs, in ROS's order of serialisation.
_ELEMENTS: tuple[tuple[str, str], ...] = (
    ("protocol_version", "uint8"),
    ("message_id", "uint8"),
    ("station_id", "uint32"),
    ("delta_ms", "uint16"),
    ("station_type", "uint8"),
    ("latitude", "int32"),
    ("longitude", "int32"),
    ("semi_major", "uint16"),
    ("semi_minor", "uint16"),
    ("orientation", "uint16"),
    ("altitude", "int32"),
    ("altitude_confidence", "uint8"),
    ("choice", "uint8"),
    ("heading", "uint16"),
    ("heading_confidence", "uint8"),
    ("speed", "uint16"),
    ("speed_confidence", "uint8"),
    ("drive_direction", "uint8"),
    ("length", "uint16"),
    ("length_confidence", "uint8"),
    ("width", "uint8"),
)
_CODES: Mapping[str, str] = {"uint8": "B", "uint16": "H", "uint32": "I", "int32": "i"}


def read_cam_bag(path: Path) -> CamRecording:
    """Read all topics with CAMs of etsi_its_messages or, if there are none, the one topic with GNSS fixes.

    Raises
    ------
    CamError
        If the path is no bag, holds neither, or holds several topics with fixes, or as in `read_received` and
        `recorded_drive`.
    """
    bag = open_bag(path, CamError)
    topics = bag.topics()
    cams = [topic for topic in topics if topic.type_name in CAM_TYPES]
    if cams:
        return _read_cams(path, bag, cams, len(topics) - len(cams))
    return _read_fixes(path, bag, _fix_topic(path, topics))


def _read_cams(path: Path, bag: Bag, topics: Sequence[Topic], left_out: int) -> CamRecording:
    for topic in topics:
        _check_definition(path, topic)
    notes = [f"topics read: {listed([topic.name for topic in topics])}; {left_out} others left out"]
    # If the bag is cut off, `_messages` appends to the notes while the packets are consumed.
    packets = (_packet(place, message) for place, message in _messages(path, bag, topics, notes))
    return read_received(Source(path, "message", "a bag"), packets, notes)


def _messages(path: Path, bag: Bag, topics: Sequence[Topic], notes: list[str]) -> Iterator[tuple[int, Message]]:
    """Yield the messages of topics with a running number; of a damaged bag the intact ones."""
    place = 0
    for topic in topics:
        try:
            for message in bag.messages(topic.name):
                place += 1
                yield place, message
        except CutOffError as problem:
            notes.append(f"{path}: {problem}; the {place} whole messages are used")


def _packet(place: int, message: Message) -> Packet:
    stamp_ns = message.recorded_ns if message.recorded_ns in POSSIBLE_NS else None
    try:
        return Packet(place, _cam(message.data, message.topic.ros1), stamp_ns)
    except (DamagedError, OtherKindError) as problem:
        return Packet(place, problem, stamp_ns)


def _cam(data: bytes, ros1: bool) -> Cam:
    layout = _layout(ros1, ros1 or bool(data[1:2] and data[1] & 1))
    if len(data) < layout.size:
        raise DamagedError(f"it has {len(data)} bytes; needed are at least {layout.size}")
    elements = dict(zip((name for name, _ in _ELEMENTS), layout.unpack_from(data), strict=True))
    if elements["choice"] == _ROADSIDE_UNIT:
        raise OtherKindError("CAM of a roadside unit")
    return Cam(**{name: elements[name] for name in Cam._fields})


@cache
def _layout(ros1: bool, little_endian: bool) -> struct.Struct:
    """Return the layout of the elements: packed in ROS 1; aligned, after a header of four bytes, in ROS 2 (CDR)."""
    codes, place = ["<" if little_endian else ">", "" if ros1 else "4x"], 0
    for _, kind in _ELEMENTS:
        size = struct.calcsize("=" + _CODES[kind])
        gap = 0 if ros1 else -place % size
        codes.append(f"{gap}x{_CODES[kind]}")
        place += gap + size
    return struct.Struct("".join(codes))


def _check_definition(path: Path, topic: Topic) -> None:
    """Raise if the bag's definition of the message has the elements in another order than etsi_its_messages."""
    if not topic.definition.strip():
        return
    needed = [kind for _, kind in _ELEMENTS]
    try:
        found = _leaves(types_told(topic.definition, topic.type_name), topic.type_name, {})
    except Exception as problem:  # of many types, all of which mean that this is no definition
        raise CamError(
            f"{path}: the definition of {topic.type_name} on {topic.shown} cannot be read: {quoted(str(problem))}; "
            "needed is that of etsi_its_messages"
        ) from problem
    if found != needed:
        i = next((i for i, pair in enumerate(zip(found, needed, strict=False)) if pair[0] != pair[1]), len(found))
        raise CamError(
            f"{path}: the topic {topic.shown} has a definition of {topic.type_name} of its own: element {i + 1} is "
            f"{found[i] if i < len(found) else 'missing'}; needed is {needed[i]}, as in etsi_its_messages"
        )


def _leaves(types: Mapping[str, Any], name: str, known: dict[str, list[str]]) -> list[str]:
    """Return the primitive types of a message's first elements, as many as `_ELEMENTS` has, in order of serialisation.

    ``known`` caches the result of each nested type, so that the time stays proportional to the definition's length.
    """
    if name not in known:
        known[name] = ["itself"]
        leaves: list[str] = []
        for _, (node, detail) in types[name][1]:
            if len(leaves) >= len(_ELEMENTS):
                break
            if node.name == "NAME":
                leaves += _leaves(types, detail, known)
            else:
                leaves.append(str(detail[0]) if node.name == "BASE" else "several")
        known[name] = leaves[: len(_ELEMENTS)]
    return known[name]


def _fix_topic(path: Path, topics: Sequence[Topic]) -> Topic:
    fixes = [topic for topic in topics if topic.type_name == FIX_TYPE]
    if len(fixes) == 1:
        return fixes[0]
    needed = "needed are etsi_its_cam_msgs/CAM, or one topic of sensor_msgs/NavSatFix"
    if fixes:
        raise CamError(f"{path} has {len(fixes)} topics with fixes: {listed([fix.name for fix in fixes])}; {needed}")
    odometry = [topic.name for topic in topics if topic.type_name == ODOMETRY_TYPE]
    if odometry:
        raise CamError(
            f"{path} has odometry on {listed(odometry)}, whose frame a bag does not tie to UTM; {needed}, or a CSV log"
        )
    described = listed([f"{topic.name} ({topic.type_name})" for topic in topics])
    raise CamError(f"{path} is a bag with the topics {described or 'none'}; {needed}")


def _read_fixes(path: Path, bag: Bag, topic: Topic) -> CamRecording:
    notes = [f"topic read: {topic.shown}"]
    fixes: dict[int, Fix] = {}
    problems = {}
    unlocated = 0
    for place, message in _messages(path, bag, [topic], notes):
        try:
            found = _fix(message)
        except DamagedError as problem:
            problems[place] = str(problem)
            continue
        unlocated += found is None
        if found is not None:
            fixes[place] = found
    if unlocated:
        notes.append(f"{unlocated} messages without a fix left out")
    return recorded_drive(gnss_messages(path, "message", fixes, problems), notes, "a bag")


def _fix(message: Message) -> Fix | None:
    types = known_types(message.topic.ros1)
    read = types.deserialize_ros1 if message.topic.ros1 else types.deserialize_cdr
    try:
        fix: Any = read(message.data, FIX_TYPE)
    except Exception as problem:  # of many types: the bytes may be anything
        raise DamagedError(
            f"it cannot be decoded: {quoted(str(problem))}; needed is sensor_msgs/NavSatFix"
        ) from problem
    header_ns = fix.header.stamp.sec * 10**9 + fix.header.stamp.nanosec
    stamp_ns = header_ns if header_ns in POSSIBLE_NS else message.recorded_ns
    if stamp_ns not in POSSIBLE_NS:
        raise DamagedError(f"its time is {stamp_ns} ns; needed is a Unix time")
    if fix.status.status == _NO_FIX:
        return None
    values = {LATITUDE: float(fix.latitude), LONGITUDE: float(fix.longitude), ALTITUDE: float(fix.altitude)}
    if fix.position_covariance_type:
        values.update(ellipse_95(np.asarray(fix.position_covariance, dtype=np.float64).reshape(3, 3)[:2, :2]))
    return stamp_ns, values
