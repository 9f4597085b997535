"""NMEA 0183 sentences of a GNSS receiver: GGA, RMC, VTG, GST and ZDA."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime, timedelta, timezone
from functools import reduce
from operator import xor
from pathlib import Path

from laci_stereo.core.errors import CamError
from laci_stereo.core.messages.cam import ELLIPSE_SIGMAS
from laci_stereo.io.cam.columns import (
    ALTITUDE,
    ELLIPSE_ORIENTATION,
    HEADING,
    LATITUDE,
    LONGITUDE,
    SEMI_MAJOR,
    SEMI_MINOR,
    SPEED,
    Quantity,
)
from laci_stereo.io.cam.etsi import DamagedError
from laci_stereo.io.cam.gnss import gnss_messages, recorded_drive
from laci_stereo.io.cam.recording import CamRecording
from laci_stereo.io.stamps import POSSIBLE_NS, UNIX_EPOCH
from laci_stereo.io.text_file import quoted

_FORMAT = "a log of NMEA sentences"
_FIRST_LINES = 20
_LONGEST_LINE = 1000

# A talker of two characters and a type of three, as in $GNRMC; a logger may write its own text before it.
_SENTENCE = re.compile(r"\$([A-Z]{2})([A-Z]{3}),([^*$]*)(?:\*([0-9A-Fa-f]{2}))?\s*$")
_TIME = re.compile(r"([01][0-9]|2[0-3])([0-5][0-9])([0-5][0-9]|60)(?:\.([0-9]{1,9}))?")
_ANGLE = re.compile(r"([0-9]{1,3})([0-9]{2}(?:\.[0-9]{1,12})?)")
_NUMBER = re.compile(r"-?[0-9]{1,9}(?:\.[0-9]{0,12})?")

_MEANINGS: Mapping[Quantity, str] = {
    HEADING: "heading: course over ground (RMC, VTG)",
    SPEED: "speed: over ground, from knots (RMC) or km/h (VTG)",
    ALTITUDE: "altitude: over the ellipsoid, that is GGA's with its geoid separation",
    SEMI_MAJOR: "semi_major_95, semi_minor_95: 2.4477 times GST's standard deviations",
}
_KNOT_MPS = 1852 / 3600
_KM_PER_H_MPS = 1 / 3.6
_DAY_NS = 86_400 * 10**9


@dataclass
class _Epoch:
    """The content of all sentences with the same time."""

    place: int
    of_day_ns: int
    day: int | None
    values: dict[Quantity, float] = field(default_factory=dict)


@dataclass
class _Drive:
    """The epochs read so far, and the current date in days since 1970."""

    day: int | None = None
    epochs: list[_Epoch] = field(default_factory=list)

    def at(self, place: int, time: str) -> _Epoch:
        """Return the epoch of a sentence's time: the latest one, or a new one."""
        found = _TIME.fullmatch(time)
        if found is None:
            raise DamagedError(f"its time is {quoted(time)}; needed is hhmmss.ss")
        hours, minutes, seconds, fraction = found.groups()
        of_day_ns = (int(hours) * 3600 + int(minutes) * 60 + int(seconds)) * 10**9 + int(
            (fraction or "0").ljust(9, "0")
        )
        if not self.epochs or self.epochs[-1].of_day_ns != of_day_ns:
            if self.epochs and self.day is not None and of_day_ns - self.epochs[-1].of_day_ns < -_DAY_NS // 2:
                self.day += 1
            self.epochs.append(_Epoch(place, of_day_ns, self.day))
        return self.epochs[-1]

    def date(self, epoch: _Epoch, day: int) -> None:
        """Set the date of an epoch and of those after it."""
        self.day = epoch.day = day


def looks_like_nmea(text: str) -> bool:
    """Return whether one of the first lines is a sentence."""
    head = text[: _FIRST_LINES * _LONGEST_LINE].splitlines()[:_FIRST_LINES]
    return any(len(line) <= _LONGEST_LINE and _SENTENCE.search(line) for line in head)


def read_cam_nmea(path: Path, text: str) -> CamRecording:
    """Read sentences; those with the same time form one position.

    Raises
    ------
    CamError
        If no sentence contains the date, or as in `recorded_drive`.
    """
    drive, problems = _Drive(), {}
    for place, line in enumerate(text.splitlines(), 1):
        # Proprietary sentences begin with $P.
        if "$" not in line or "$P" in line:
            continue
        try:
            _read(drive, place, line)
        except DamagedError as problem:
            problems[place] = str(problem)
    dated = [epoch for epoch in drive.epochs if epoch.day is not None]
    if drive.epochs and not dated:
        raise CamError(f"{path} is {_FORMAT} without a date; needed are RMC or ZDA sentences")
    # Epochs before the first dated one are on the same day or, if their time of day is later, on the day before.
    first = next((i for i, epoch in enumerate(drive.epochs) if epoch.day is not None), 0)
    for epoch in drive.epochs[:first]:
        epoch.day = (dated[0].day or 0) - (epoch.of_day_ns - dated[0].of_day_ns > _DAY_NS // 2)
    fixes = {
        epoch.place: ((epoch.day or 0) * _DAY_NS + epoch.of_day_ns, epoch.values)
        for epoch in drive.epochs
        if LATITUDE in epoch.values
    }
    without = len(drive.epochs) - len(fixes)
    notes = [_MEANINGS[quantity] for quantity in _MEANINGS if any(quantity in values for _, values in fixes.values())]
    if without:
        notes.append(f"{without} moments without a position")
    return recorded_drive(gnss_messages(path, "line", fixes, problems), notes, _FORMAT)


def _read(drive: _Drive, place: int, line: str) -> None:
    found = _SENTENCE.search(line) if len(line) <= _LONGEST_LINE else None
    if found is None:
        raise DamagedError(f"{quoted(line)}; needed is a sentence such as $GPRMC,...*hh")
    talker, kind, body, checksum = found.groups()
    if checksum is not None and int(checksum, 16) != reduce(xor, f"{talker}{kind},{body}".encode()):
        raise DamagedError(f"the checksum of {quoted(found[0].strip())} is wrong")
    if kind in _KINDS:
        cells = body.split(",")
        # Newer versions append cells; a receiver without a fix sends empty ones.
        _KINDS[kind](drive, place, cells + [""] * (_CELLS - len(cells)))


def _gga(drive: _Drive, place: int, cells: list[str]) -> None:
    if cells[5] in ("", "0"):
        return
    position = _position(cells[1:5])
    altitude, separation = _number(cells[8]), _number(cells[10])
    epoch = drive.at(place, cells[0])
    epoch.values.update(position)
    if altitude is not None:
        epoch.values[ALTITUDE] = altitude + (separation or 0.0)


def _rmc(drive: _Drive, place: int, cells: list[str]) -> None:
    if not cells[0]:
        return
    position = _position(cells[2:6]) if cells[1] == "A" else {}
    epoch = drive.at(place, cells[0])
    if cells[8]:
        drive.date(epoch, _day(cells[8][:2], cells[8][2:4], cells[8][4:]))
    if not position:
        return
    # A position from GGA is kept, as some receivers write it with more digits.
    epoch.values.update({**position, **epoch.values})
    _set_motion(epoch, _number(cells[7]), _number(cells[6]), _KNOT_MPS)


def _vtg(drive: _Drive, _place: int, cells: list[str]) -> None:
    if drive.epochs:
        _set_motion(drive.epochs[-1], _number(cells[0]), _number(cells[6]), _KM_PER_H_MPS)


def _gst(drive: _Drive, place: int, cells: list[str]) -> None:
    major, minor, orientation = (_number(cell) for cell in cells[2:5])
    north, east = _number(cells[5]), _number(cells[6])
    if not cells[0]:
        return
    epoch = drive.at(place, cells[0])
    if major is not None and minor is not None and orientation is not None:
        epoch.values.update({SEMI_MAJOR: ELLIPSE_SIGMAS * major, SEMI_MINOR: ELLIPSE_SIGMAS * minor})
        epoch.values[ELLIPSE_ORIENTATION] = orientation
    elif north is not None and east is not None:
        epoch.values.update(
            {SEMI_MAJOR: ELLIPSE_SIGMAS * max(north, east), SEMI_MINOR: ELLIPSE_SIGMAS * min(north, east)}
        )
        epoch.values[ELLIPSE_ORIENTATION] = 0.0 if north >= east else 90.0


def _zda(drive: _Drive, place: int, cells: list[str]) -> None:
    if cells[0] and cells[1]:
        drive.date(drive.at(place, cells[0]), _day(cells[1], cells[2], cells[3]))


_KINDS: Mapping[str, Callable[[_Drive, int, list[str]], None]] = {
    "GGA": _gga,
    "RMC": _rmc,
    "VTG": _vtg,
    "GST": _gst,
    "ZDA": _zda,
}
_CELLS = 14


def _set_motion(epoch: _Epoch, heading_deg: float | None, speed: float | None, unit_mps: float) -> None:
    if heading_deg is not None:
        epoch.values[HEADING] = heading_deg
    if speed is not None:
        epoch.values[SPEED] = speed * unit_mps


def _position(cells: list[str]) -> dict[Quantity, float]:
    latitude, north, longitude, east = cells
    if north not in ("N", "S") or east not in ("E", "W"):
        raise DamagedError(f"its position is {quoted(','.join(cells))}; needed is ddmm.mm,N or S,dddmm.mm,E or W")
    return {
        LATITUDE: _angle(latitude) * (1 if north == "N" else -1),
        LONGITUDE: _angle(longitude) * (1 if east == "E" else -1),
    }


def _angle(cell: str) -> float:
    found = _ANGLE.fullmatch(cell)
    if found is None:
        raise DamagedError(f"an angle is {quoted(cell)}; needed are degrees and minutes as dddmm.mm")
    return int(found[1]) + float(found[2]) / 60


def _number(cell: str) -> float | None:
    return float(cell) if _NUMBER.fullmatch(cell) else None


def _day(day: str, month: str, year: str) -> int:
    """Return a date in days since 1970; a year may have two digits, which mean 1980 to 2079."""
    try:
        number = int(year)
        full = number + (0 if len(year) == 4 else 1900 if number >= 80 else 2000)
        days = (datetime(full, int(month), int(day), tzinfo=timezone.utc) - UNIX_EPOCH) // timedelta(days=1)
    except ValueError as problem:
        raise DamagedError(f"its date is {quoted(f'{day} {month} {year}')}; needed is day, month and year") from problem
    if days * 86_400 * 10**9 not in POSSIBLE_NS:
        raise DamagedError(f"its date is {quoted(f'{day} {month} {year}')}; needed is one from 1974 to 2254")
    return days
