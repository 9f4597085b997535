"""Whether messages and recording overlap in time and, if not, which clock error is the likely cause."""

from __future__ import annotations

from dataclasses import dataclass

from laci_stereo.core.errors import CamError
from laci_stereo.core.messages.cam import CamLog
from laci_stereo.io.stamps import iso_text

_S = 10**9
_GPS_AHEAD_S = 18
_TAI_AHEAD_S = 37
_GPS_EPOCH_S = 315_964_800
_ETSI_EPOCH_S = 1_072_915_200
# ETSI's clock has counted the leap seconds since 2004.
_ETSI_AHEAD_S = 5
_FARTHEST_ZONE_H = 14


@dataclass(frozen=True)
class _ClockError:
    """A clock error: how far the messages are ahead of the recording, and its cause with a remedy."""

    ahead_s: int
    cause: str


_CLOCK_ERRORS = (
    _ClockError(_GPS_AHEAD_S, "GPS time is 18 s ahead of UTC; subtract 18 s from the times of the messages"),
    _ClockError(-_GPS_AHEAD_S, "GPS time is 18 s ahead of UTC; subtract 18 s from the times of the recording"),
    _ClockError(_TAI_AHEAD_S, "TAI is 37 s ahead of UTC; subtract 37 s from the times of the messages"),
    _ClockError(-_TAI_AHEAD_S, "TAI is 37 s ahead of UTC; subtract 37 s from the times of the recording"),
    *(
        _ClockError(sign * 3600 * hours, f"a time zone of {hours} h; give the times of both in UTC")
        for hours in range(1, _FARTHEST_ZONE_H + 1)
        for sign in (1, -1)
    ),
    *(
        _ClockError(
            ahead_s - _ETSI_EPOCH_S,
            f"the messages count from ETSI's epoch, 2004-01-01; add {_ETSI_EPOCH_S - _ETSI_AHEAD_S} s to their times, "
            f"or {_ETSI_EPOCH_S} s if leap seconds are left out",
        )
        for ahead_s in (_ETSI_AHEAD_S, 0)
    ),
    *(
        _ClockError(
            ahead_s - _GPS_EPOCH_S,
            f"the messages count from GPS's epoch, 1980-01-06; add {_GPS_EPOCH_S - _GPS_AHEAD_S} s to their times, "
            f"or {_GPS_EPOCH_S} s if leap seconds are left out",
        )
        for ahead_s in (_GPS_AHEAD_S, 0)
    ),
    *(
        _ClockError(
            _GPS_EPOCH_S - ahead_s,
            f"the recording counts from GPS's epoch, 1980-01-06; add {_GPS_EPOCH_S - _GPS_AHEAD_S} s to its times, "
            f"or {_GPS_EPOCH_S} s if leap seconds are left out",
        )
        for ahead_s in (_GPS_AHEAD_S, 0)
    ),
)


def check_overlap(log: CamLog, first_ns: int, last_ns: int) -> None:
    """Raise if no message was sent while the sensor recorded.

    Parameters
    ----------
    log : CamLog
        At least one message.
    first_ns, last_ns : int
        Begin and end of the recording (Unix time, nanoseconds).

    Raises
    ------
    CamError
        If none was; the message states both intervals, their difference, and the clock error that would explain it.
    """
    first_cam, last_cam = int(log.stamps_ns[0]), int(log.stamps_ns[-1])
    if first_cam <= last_ns and last_cam >= first_ns:
        return
    after_s = (first_cam - first_ns) / _S
    side = "after" if after_s > 0 else "before"
    explained = _explanation(first_cam, last_cam, first_ns, last_ns)
    hint = "" if explained is None else f"; likely: {explained.cause}"
    raise CamError(
        f"the CAM log ({iso_text(first_cam)} to {iso_text(last_cam)}) and the recording ({iso_text(first_ns)} to "
        f"{iso_text(last_ns)}) do not overlap: the log begins {abs(after_s):.1f} s {side} the recording; needed are "
        f"messages of the recording's time{hint}"
    )


def _explanation(first_cam: int, last_cam: int, first_ns: int, last_ns: int) -> _ClockError | None:
    """Return the clock error whose correction makes both overlap; of several, the one that best aligns the middles."""
    fitting = [
        error
        for error in _CLOCK_ERRORS
        if first_cam - error.ahead_s * _S <= last_ns and last_cam - error.ahead_s * _S >= first_ns
    ]
    ahead_ns = (first_cam + last_cam - first_ns - last_ns) // 2
    return min(fitting, key=lambda error: abs(ahead_ns - error.ahead_s * _S), default=None)
