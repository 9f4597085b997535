"""RTKLIB's solutions (``.pos``), as post-processing of a receiver's observations writes them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from laci_stereo.core.errors import CamError
from laci_stereo.io.cam.columns import ALTITUDE, LATITUDE, LONGITUDE
from laci_stereo.io.cam.etsi import DamagedError
from laci_stereo.io.cam.gnss import Fix, ellipse_95, fixes_in, gnss_messages, recorded_drive
from laci_stereo.io.cam.recording import CamRecording
from laci_stereo.io.epochs import GPS_LEAP_NS, times_of_weeks
from laci_stereo.io.stamps import iso_time, number
from laci_stereo.io.text_file import quoted

_FORMAT = "a solution of RTKLIB"
_HEADER = re.compile(r"^%\s*(GPST|UTC|JST)\s+(\S.*?)\s*$", re.MULTILINE)
_SEPARATOR = re.compile(r"[\s,;]+")
_PLACES = ("latitude(deg)", "longitude(deg)", "height(m)")
_DEVIATIONS = ("sdn(m)", "sde(m)", "sdne(m)")
_TIME_WORDS = 2


def looks_like_rtklib(text: str) -> bool:
    """Return whether a comment at the beginning names the columns of a solution."""
    return text.startswith("%") and _HEADER.search(text) is not None


def read_cam_rtklib(path: Path, text: str) -> CamRecording:
    """Read the positions of a solution, with their accuracy.

    Raises
    ------
    CamError
        If its times or positions are in another form, or as in `recorded_drive`.
    """
    found = _HEADER.search(text)
    scale, titles = (found[1], _SEPARATOR.split(found[2])) if found else ("", [])
    if scale == "JST" or not set(_PLACES) <= set(titles):
        raise CamError(
            f"{path} is {_FORMAT} with times in {scale} and the columns {quoted(' '.join(titles[:3]))}; needed are "
            "GPST or UTC, and latitude and longitude in degrees (out-solformat llh, out-degform deg)"
        )
    lines = enumerate(text.splitlines(), 1)
    rows = ((i, _SEPARATOR.split(line.strip())) for i, line in lines if line.strip() and not line.startswith("%"))
    fixes, problems = fixes_in(rows, lambda words: _fix(words, titles, scale))
    notes = ["times: GPS time, less the 18 leap seconds of UTC"] if scale == "GPST" else []
    return recorded_drive(gnss_messages(path, "line", fixes, problems), notes, _FORMAT)


def _fix(words: Sequence[str], titles: Sequence[str], scale: str) -> Fix:
    values = {title: number(word) for title, word in zip(titles, words[_TIME_WORDS:], strict=False)}
    latitude, longitude, altitude = (values.get(title) for title in _PLACES)
    if latitude is None or longitude is None or altitude is None:
        raise DamagedError(
            f"{quoted(' '.join(words))} lacks numbers; needed are those of latitude, longitude and height"
        )
    place = {LATITUDE: float(latitude), LONGITUDE: float(longitude), ALTITUDE: float(altitude)}
    deviations = [value for title in _DEVIATIONS if (value := values.get(title)) is not None]
    if len(deviations) == len(_DEVIATIONS):
        north, east, both = map(float, deviations)
        # RTKLIB writes the root of the covariance, with its sign.
        covariance = np.array([[east**2, both * abs(both)], [both * abs(both), north**2]])
        place |= ellipse_95(covariance)
    return _stamp_ns(words[:_TIME_WORDS], scale), place


def _stamp_ns(words: Sequence[str], scale: str) -> int:
    moment = iso_time(" ".join(words))
    if moment is not None:
        return moment.ns - (GPS_LEAP_NS if scale == "GPST" else 0)
    week = times_of_weeks(words[:1], words[1:], 10**9)[0] if len(words) == _TIME_WORDS else ""
    if not week.isdigit():
        raise DamagedError(
            f"time is {quoted(' '.join(words))}; needed is a date and time, or a GPS week and its seconds"
        )
    return int(week) + (0 if scale == "GPST" else GPS_LEAP_NS)
