"""Whether messages and recording, or its drives, overlap in time and, if not, which clock error is the likely cause."""

from __future__ import annotations

import numpy as np

from laci_stereo.core.errors import CamError, TrackError
from laci_stereo.core.frames import IntArray
from laci_stereo.core.messages.cam import MAX_GAP_S, CamLog
from laci_stereo.core.messages.clock_errors import CLOCK_ERRORS, ClockError
from laci_stereo.core.messages.repair import STANDING_MPS
from laci_stereo.core.settings import UNKNOWN_CLOCK_S
from laci_stereo.io.epochs import OTHER_CLOCKS, epoch_notes
from laci_stereo.io.stamps import iso_text

_S = 10**9

_CLOCK_ERRORS = (
    *CLOCK_ERRORS,
    *(
        ClockError(sign * behind_s, f"{who} {clock.count}; {clock.remedy(times)}")
        for clock in OTHER_CLOCKS
        for sign, who, times in ((-1, "the messages count", "their times"), (1, "the recording counts", "its times"))
        for behind_s in clock.behind_s
    ),
)


def check_overlap(log: CamLog, first_ns: int, last_ns: int) -> None:
    """Raise if no message was sent while the sensor recorded, or all that were are of vehicles that stood.

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
    TrackError
        If vehicles drove only before or after; the message states when, and the clock error that would explain it.
    """
    first_cam, last_cam = int(log.stamps_ns[0]), int(log.stamps_ns[-1])
    if first_cam <= last_ns and last_cam >= first_ns:
        _check_drives(log, first_ns, last_ns)
        return
    after_s = (first_cam - first_ns) / _S
    side = "after" if after_s > 0 else "before"
    explained = _explanation(first_cam, last_cam, first_ns, last_ns)
    hints = epoch_notes(log.stamps_ns) if explained is None else [f"likely: {explained.cause}"]
    needed = "; ".join(["messages of the recording's time", *hints])
    raise CamError(
        f"the CAM log ({iso_text(first_cam)} to {iso_text(last_cam)}) and the recording ({iso_text(first_ns)} to "
        f"{iso_text(last_ns)}) do not overlap: the log begins {abs(after_s):.1f} s {side} the recording; needed are "
        f"{needed}"
    )


def _check_drives(log: CamLog, first_ns: int, last_ns: int) -> None:
    driving = log.speed_mps >= STANDING_MPS
    margin_ns = round((MAX_GAP_S + 3.0 * UNKNOWN_CLOCK_S) * _S)
    if not driving.any() or _between(log.stamps_ns[log.may_drive], first_ns - margin_ns, last_ns + margin_ns):
        return
    driving_ns = log.stamps_ns[driving]
    nearest = int(driving_ns[np.argmin(np.abs(driving_ns - (first_ns + last_ns) // 2))])
    apart_s = (nearest - last_ns if nearest > last_ns else first_ns - nearest) / _S
    side = "after" if nearest > last_ns else "before"
    fitting = [error for error in _CLOCK_ERRORS if _between(driving_ns - error.ahead_s * _S, first_ns, last_ns)]
    explained = min(fitting, key=lambda error: abs(error.ahead_s), default=None)
    raise TrackError(
        f"while the sensor records ({iso_text(first_ns)} to {iso_text(last_ns)}), every vehicle stands still by its "
        f"CAMs; one drives at {iso_text(nearest)}, {apart_s:.1f} s {side}; needed is a drive that is recorded"
        + (f"; likely: {explained.cause}" if explained is not None else "")
    )


def _between(stamps_ns: IntArray, first_ns: int, last_ns: int) -> bool:
    return bool(((stamps_ns >= first_ns) & (stamps_ns <= last_ns)).any())


def _explanation(first_cam: int, last_cam: int, first_ns: int, last_ns: int) -> ClockError | None:
    """Return the clock error whose correction makes both overlap; of several, the one that best aligns the middles."""
    fitting = [
        error
        for error in _CLOCK_ERRORS
        if first_cam - error.ahead_s * _S <= last_ns and last_cam - error.ahead_s * _S >= first_ns
    ]
    ahead_ns = (first_cam + last_cam - first_ns - last_ns) // 2
    return min(fitting, key=lambda error: abs(ahead_ns - error.ahead_s * _S), default=None)
