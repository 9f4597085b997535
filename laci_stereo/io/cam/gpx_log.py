"""GPX tracks recorded by a GNSS receiver or a phone."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element

from laci_stereo.core.errors import CamError
from laci_stereo.io.cam.columns import ALTITUDE, HEADING, LATITUDE, LONGITUDE, SPEED, Quantity
from laci_stereo.io.cam.etsi import DamagedError
from laci_stereo.io.cam.gnss import Fix, fixes_in, gnss_messages, recorded_drive
from laci_stereo.io.cam.recording import CamRecording
from laci_stereo.io.safe_xml import XmlError, parse_xml
from laci_stereo.io.stamps import iso_time, number
from laci_stereo.io.text_file import quoted

_FORMAT = "a GPX track"

_TAGS: dict[str, Quantity] = {"ele": ALTITUDE, "speed": SPEED, "course": HEADING}
"""Tags in a track point (GPX 1.0), or in its extensions in any namespace (GPX 1.1)."""

_HINTS = {
    **dict.fromkeys(("osm", "OpenDRIVE"), " (a lane map is given with --map)"),
    "pdml": " (tshark's JSON is read: -T json)",
}

_OF_CAM = re.compile(r"<(generationDeltaTime|messageI[dD])>\s*\d")
"""What XER, ASN.1's rules for XML, makes of elements that each CAM has."""

_FIRST_CHARACTERS = 1 << 16

_DEEPEST = 3
"""Levels below a track point that are searched: its extensions, in these a device's own element, in that the values."""


def looks_like_xml(text: str) -> bool:
    """Return whether a text begins like XML."""
    return text.lstrip()[:1] == "<"


def read_cam_gpx(path: Path, text: str) -> CamRecording:
    """Read the track points of all tracks.

    Raises
    ------
    CamError
        If it is no GPX, or as in `recorded_drive`.
    """
    if _OF_CAM.search(text, 0, _FIRST_CHARACTERS):
        raise CamError(
            f"{path} holds messages as ASN.1's XML (XER), which tell no time of reception, and generationDeltaTime "
            "begins anew every 65.536 s; needed are lines of JSON with a timestamp and the decoded message in each, or "
            "of a time and the message's hexadecimal digits (UPER)"
        )
    try:
        root = parse_xml(text)
    except XmlError as problem:
        raise CamError(f"{path} cannot be read: {problem}") from problem
    if _name(root) != "gpx":
        hint = _HINTS.get(_name(root), "")
        raise CamError(f"{path} is XML with the root element {quoted(_name(root))}, no log{hint}; needed is gpx")
    points = (element for element in root.iter() if _name(element) == "trkpt")
    return recorded_drive(gnss_messages(path, "point", *fixes_in(enumerate(points, 1), _fix)), [], _FORMAT)


def _fix(point: Element) -> Fix:
    values = {LATITUDE: _float("lat", point.get("lat")), LONGITUDE: _float("lon", point.get("lon"))}
    stamp_ns = None
    for element in _within(point, _DEEPEST):
        name = _name(element)
        if name == "time":
            moment = iso_time(element.text or "")
            stamp_ns = None if moment is None else moment.ns
        elif name in _TAGS and (element.text or "").strip():
            values[_TAGS[name]] = _float(name, element.text)
    if stamp_ns is None:
        raise DamagedError("it has no time; needed is one as 2025-10-09T08:53:22.25Z")
    return stamp_ns, values


def _within(element: Element, deep: int) -> Iterator[Element]:
    """Yield the elements below one, down to a limited depth, because a file may nest points without end."""
    for inner in element:
        yield inner
        if deep > 1:
            yield from _within(inner, deep - 1)


def _float(name: str, text: str | None) -> float:
    value = number((text or "").strip())
    if value is None:
        raise DamagedError(f"{name} is {quoted(text or '')}; needed is a number")
    return float(value)


def _name(element: Element) -> str:
    """Return an element's name without its namespace."""
    return str(element.tag).rpartition("}")[2]
