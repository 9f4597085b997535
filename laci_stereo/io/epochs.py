"""Clocks that do not count from Unix's epoch, 1970-01-01, and what makes Unix times of theirs."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal

import numpy as np

from laci_stereo.core.frames import IntArray
from laci_stereo.core.messages.cam import MAX_GAP_S
from laci_stereo.io.stamps import iso_text, number

_S = 10**9
_WEEK_S = 7 * 86_400
_GPS_EPOCH_S = 315_964_800
_GPS_LEAP_S = 18

FIRST_CAMS_NS = 1_262_304_000 * _S
"""Unix time of 2010-01-01; ETSI TS 102 637-2, by which the first CAMs were sent, is of that year."""

GPS_LEAP_NS = _GPS_LEAP_S * _S
"""How far GPS time is ahead of UTC since 2017."""

WEEK_MS = 1000 * _WEEK_S

GPS_WEEK_NOTE = f"timestamp: from the GPS week and the time in it, less the {_GPS_LEAP_S} leap seconds of UTC"

OF_GPS_WEEK = f"{_GPS_EPOCH_S - _GPS_LEAP_S} s, and {_WEEK_S} s for each week since 1980-01-06"
"""What added to the seconds of a GPS week makes them a Unix time."""

_WEEKS = 1 << 13
"""Weeks of GPS that its messages can count, until 2137."""


def times_of_weeks(weeks: Sequence[str], times: Sequence[str], unit_ns: int) -> list[str]:
    """Return Unix times, nanoseconds as text, of weeks of GPS and the times in them, by the leap seconds since 2017.

    Where a pair is none, the text is both. ``unit_ns`` is the unit of the times, unless one of them is too large for
    it: then it is milliseconds.
    """
    pairs = [(number(week), number(time)) for week, time in zip(weeks, times, strict=True)]
    if any(time is not None and time > _WEEK_S for _, time in pairs):
        unit_ns = 10**6
    found = [_time_of_week(week, time, unit_ns) for week, time in pairs]
    return [f"{weeks[i]} {times[i]}" if ns is None else str(ns) for i, ns in enumerate(found)]


def _time_of_week(week: Decimal | None, time: Decimal | None, unit_ns: int) -> int | None:
    if week is None or time is None or week % 1 or not 0 <= week < _WEEKS or not 0 <= time * unit_ns < _WEEK_S * _S:
        return None
    return (_GPS_EPOCH_S - _GPS_LEAP_S + int(week) * _WEEK_S) * _S + int(time * unit_ns)


@dataclass(frozen=True)
class OtherClock:
    """A clock whose times look like Unix times of years ago.

    Attributes
    ----------
    count : str
        From where it counts, in words that follow "count" or "counts".
    epoch_s : int
        How far it is behind if, like Unix time, it leaves out leap seconds.
    leap_s : int
        The leap seconds since its epoch, which such clocks usually count.
    """

    count: str
    epoch_s: int
    leap_s: int

    @property
    def behind_s(self) -> tuple[int, ...]:
        """How far it may be behind, the usual way first."""
        return tuple(dict.fromkeys((self.epoch_s - self.leap_s, self.epoch_s)))

    def remedy(self, times: str) -> str:
        """Return what to add to ``times``, such as "their times"."""
        first, *without_leaps = self.behind_s
        others = (f", or {behind_s} s if leap seconds are left out" for behind_s in without_leaps)
        return "".join((f"add {first} s to {times}", *others))


OTHER_CLOCKS = (
    OtherClock("from ETSI's epoch, 2004-01-01", 1_072_915_200, 5),
    OtherClock("the weeks of GPS anew after 1024", 1024 * _WEEK_S, 0),
    OtherClock("from GPS's epoch, 1980-01-06", _GPS_EPOCH_S, _GPS_LEAP_S),
)


def epoch_notes(stamps_ns: IntArray) -> list[str]:
    """Return a note on messages from before there were CAMs, and on the clocks by which they would be of later years.

    Their times, ``stamps_ns``, are ascending; there is at least one.
    """
    middle_ns, last_ns = int(stamps_ns[len(stamps_ns) // 2]), int(stamps_ns[-1])
    if middle_ns >= FIRST_CAMS_NS:
        return []
    said = f"the times are of {_date(middle_ns)}, before there were CAMs (2010); needed are Unix times"
    if last_ns < WEEK_MS * _S and np.median(np.diff(stamps_ns, prepend=stamps_ns[:1])) > MAX_GAP_S * _S:
        return [f"{said}; if they are milliseconds of a GPS week, divide them by 1000 and add {OF_GPS_WEEK}"]
    later = [(clock, middle_ns + clock.behind_s[0] * _S) for clock in OTHER_CLOCKS]
    told = [
        f"if they count {clock.count}, they are of {_date(then_ns)}: {clock.remedy('them')}"
        for clock, then_ns in later
        if FIRST_CAMS_NS <= then_ns <= time.time_ns()
    ]
    return ["; ".join((said, *told))]


def _date(stamp_ns: int) -> str:
    return iso_text(stamp_ns)[:10]
