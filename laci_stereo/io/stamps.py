"""Times in text: numbers whose magnitude determines their unit, and ISO 8601."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from decimal import Decimal

_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]{1,3})?")
_ISO = re.compile(
    r"([0-9]{4})[-/]?([0-9]{2})[-/]?([0-9]{2})[Tt ]+([0-9]{2}):?([0-9]{2}):?([0-9]{2})(?:[.,]([0-9]+))?"
    r"\s*(?:([Zz]|UTC|GMT)|([+-])([0-9]{2}):?([0-9]{2})?)?"
)
_DAY_FIRST = re.compile(r"([0-9]{2})\.([0-9]{2})\.([0-9]{4})(?= )")
_SECONDS = re.compile(r"[0-9]{10}")
_FRACTION = re.compile(r"[0-9]{1,9}")
UNIX_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)


POSSIBLE_NS = range(10**17, 9 * 10**18)
"""Plausible Unix times, 1973 to 2255: a number is in this range in one unit at most, and times of clocks that count
from 1980 (GPS) or 2004 (ETSI) are in it, too."""


@dataclass(frozen=True)
class TimeUnit:
    """A unit of Unix times, and its length in nanoseconds."""

    name: str
    ns: int

    def to_ns(self, value: Decimal) -> int | None:
        """Return the time in nanoseconds, or None if its magnitude shows that it is in another unit."""
        if not POSSIBLE_NS.start <= value * self.ns < POSSIBLE_NS.stop:
            return None
        return int((value * self.ns).to_integral_value())


UNITS = (
    TimeUnit("seconds", 10**9),
    TimeUnit("milliseconds", 10**6),
    TimeUnit("microseconds", 10**3),
    TimeUnit("nanoseconds", 1),
)


def number(text: str) -> Decimal | None:
    """Return the number that a text consists of, exactly, or None."""
    return Decimal(text) if _NUMBER.fullmatch(text) else None


def with_fractions(pairs: Sequence[tuple[str, str]]) -> list[str] | None:
    """Return times whose seconds and milli-, micro- or nanoseconds are two numbers; None if they cannot be that.

    The latter may lack their leading zeros: the longest of them tells which they are.
    """
    if not all(_SECONDS.fullmatch(before) and _FRACTION.fullmatch(after) for before, after in pairs):
        return None
    longest = max((len(after) for _, after in pairs), default=0)
    digits = next(count for count in (3, 6, 9) if longest <= count)
    return [f"{before}.{after:0>{digits}}" for before, after in pairs]


def unit_of(values: Sequence[Decimal]) -> TimeUnit | None:
    """Return the unit of times by the magnitude of their median, or None if they are no Unix times."""
    if not values:
        return None
    middle = sorted(values)[len(values) // 2]
    return next((unit for unit in UNITS if unit.to_ns(middle) is not None), None)


@dataclass(frozen=True)
class IsoTime:
    """A time written as ISO 8601.

    Attributes
    ----------
    ns : int
        Unix time, nanoseconds.
    has_zone : bool
        Whether the text has an offset from UTC; without one, UTC is assumed.
    """

    ns: int
    has_zone: bool


def iso_time(text: str) -> IsoTime | None:
    """Return the time of an ISO 8601 text such as ``2011-09-26 13:02:25.964389445``, exactly, or None.

    Dates may have slashes, or points with the day first, and the zone may be named UTC.
    """
    match = _ISO.fullmatch(_DAY_FIRST.sub(r"\3-\2-\1", text.strip(), count=1))
    if match is None:
        return None
    *clock, fraction, zulu, sign, hours, minutes = match.groups()
    try:
        moment = datetime(*map(int, clock), tzinfo=timezone.utc)  # type: ignore[misc, arg-type]
        offset = timedelta(hours=int(hours or 0), minutes=int(minutes or 0))
        since_epoch = moment - UNIX_EPOCH - (-offset if sign == "-" else offset)
    except (ValueError, OverflowError):
        return None
    ns = (since_epoch // timedelta(seconds=1)) * 10**9 + int((fraction or "0")[:9].ljust(9, "0"))
    # Somewhat beyond these years, nanoseconds overflow an int64.
    return IsoTime(ns, bool(zulu or sign)) if 1700 <= moment.year <= 2200 else None


def iso_text(stamp_ns: int) -> str:
    """Return a Unix time as ISO 8601 in UTC, to the millisecond."""
    return (UNIX_EPOCH + timedelta(milliseconds=round(stamp_ns / 10**6))).strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z"
