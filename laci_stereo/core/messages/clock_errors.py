"""How far the clocks that messages and recordings are stamped by are ahead of one another where they are not UTC."""

from __future__ import annotations

from dataclasses import dataclass

_GPS_AHEAD_S = 18
_TAI_AHEAD_S = 37
_ETSI_AHEAD_S = 5
_FARTHEST_ZONE_H = 14


@dataclass(frozen=True)
class ClockError:
    """A clock error: how far the messages are ahead of the recording, and its cause with a remedy."""

    ahead_s: int
    cause: str


CLOCK_ERRORS = (
    ClockError(_GPS_AHEAD_S, "GPS time is 18 s ahead of UTC; subtract 18 s from the times of the messages"),
    ClockError(-_GPS_AHEAD_S, "GPS time is 18 s ahead of UTC; subtract 18 s from the times of the recording"),
    ClockError(_TAI_AHEAD_S, "TAI is 37 s ahead of UTC; subtract 37 s from the times of the messages"),
    ClockError(-_TAI_AHEAD_S, "TAI is 37 s ahead of UTC; subtract 37 s from the times of the recording"),
    ClockError(
        _ETSI_AHEAD_S,
        "ETSI's clock is 5 s ahead of UTC, by the leap seconds since 2004; subtract 5 s from the times of the messages",
    ),
    *(
        ClockError(sign * 3600 * hours, f"a time zone of {hours} h; give the times of both in UTC")
        for hours in range(1, _FARTHEST_ZONE_H + 1)
        for sign in (1, -1)
    ),
)
"""Of the same day; clocks that count from another epoch are off by years."""
