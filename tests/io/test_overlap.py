from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from laci_stereo.core.errors import CamError, TrackError
from laci_stereo.core.messages.cam import CamLog
from laci_stereo.io.overlap import check_overlap

S = 10**9
FIRST_NS = 1760000000 * S
LAST_NS = FIRST_NS + 11 * S


def log_between(first_ns: int, last_ns: int) -> CamLog:
    stamps = np.linspace(first_ns, last_ns, 5).astype(np.int64)
    stamps[[0, -1]] = first_ns, last_ns
    unknown = np.full(5, np.nan)
    return CamLog(stamps, np.zeros(5, dtype=np.int64), *[unknown] * 10)


def refusal(ahead_s: float) -> str:
    ahead_ns = round(ahead_s * S)
    with pytest.raises(CamError) as refused:
        check_overlap(log_between(FIRST_NS + 2 * S + ahead_ns, LAST_NS + ahead_ns), FIRST_NS, LAST_NS)
    return str(refused.value)


MOMENT = st.integers(FIRST_NS - 40 * S, FIRST_NS + 40 * S)


@given(MOMENT, MOMENT, MOMENT, MOMENT)
def test_it_raises_exactly_when_no_moment_is_common(a: int, b: int, c: int, d: int) -> None:
    (first_cam, last_cam), (first, last) = sorted((a, b)), sorted((c, d))
    log = log_between(first_cam, last_cam)
    if max(first_cam, first) <= min(last_cam, last):
        check_overlap(log, first, last)
    else:
        with pytest.raises(CamError, match="do not overlap"):
            check_overlap(log, first, last)


def test_both_intervals_and_their_difference_are_named() -> None:
    message = refusal(1000.0)
    assert (
        "the CAM log (2025-10-09T09:10:02.000Z to 2025-10-09T09:10:11.000Z)".replace("09:10:02", "09:10:02") in message
    )
    assert "the recording (2025-10-09T08:53:20.000Z to 2025-10-09T08:53:31.000Z)" in message
    assert "the log begins 1002.0 s after the recording" in message
    assert "likely" not in message
    assert "the log begins 998.0 s before the recording" in refusal(-1000.0)
    assert len(message.splitlines()) == 1


def drive_in_a_long_log(ahead_s: float, speed_mps: float = 8.0) -> CamLog:
    """Return an hour of messages at 10 Hz of a vehicle that drives from the 2nd to the 9th second of the recording."""
    stamps = FIRST_NS + np.arange(-18_000, 18_000) * S // 10
    drives = (stamps >= FIRST_NS + 2 * S) & (stamps <= FIRST_NS + 9 * S)
    unknown = np.full(len(stamps), np.nan)
    shifted = stamps + round(ahead_s * S)
    motion = (unknown, np.where(drives, speed_mps, 0.1))
    return CamLog(shifted, np.zeros(len(stamps), dtype=np.int64), unknown, unknown, *motion, *[unknown] * 6)


@pytest.mark.parametrize(
    ("ahead_s", "words"),
    [
        (
            18,
            "one drives at 2025-10-09T08:53:40.000Z, 9.0 s after; .* likely: GPS time is 18 s ahead of UTC; subtract",
        ),
        (
            -37,
            "drives at 2025-10-09T08:52:52.000Z, 28.0 s before; .* likely: TAI is 37 s .* the times of the recording",
        ),
        (1200, "drives at 2025-10-09T09:13:22.000Z, 1191.0 s after; needed is a drive that is recorded$"),
    ],
)
def test_a_drive_before_or_after_the_recording_is_told_with_the_clock_that_would_explain_it(
    ahead_s: float, words: str
) -> None:
    with pytest.raises(TrackError, match=rf"every vehicle stands still by its CAMs; .*{words}") as refused:
        check_overlap(drive_in_a_long_log(ahead_s), FIRST_NS, LAST_NS)
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize(("ahead_s", "speed_mps"), [(0, 8.0), (-9, 8.0), (10, 8.0), (18, 0.2), (18, np.nan)])
def test_what_drives_or_may_drive_while_it_is_recorded_is_left_to_the_calibration(
    ahead_s: float, speed_mps: float
) -> None:
    check_overlap(drive_in_a_long_log(ahead_s, speed_mps), FIRST_NS, LAST_NS)


def test_a_vehicle_of_unknown_speed_may_drive() -> None:
    log = drive_in_a_long_log(18)
    still = np.where(log.speed_mps > 1.0, log.speed_mps, np.nan)
    check_overlap(replace(log, speed_mps=still), FIRST_NS, LAST_NS)


@pytest.mark.parametrize(
    ("ahead_s", "cause"),
    [
        (3600, "a time zone of 1 h; give the times of both in UTC"),
        (-7200, "a time zone of 2 h"),
        (18, "GPS time is 18 s ahead of UTC; subtract 18 s from the times of the messages"),
        (-18, "GPS time is 18 s ahead of UTC; subtract 18 s from the times of the recording"),
        (37, "TAI is 37 s ahead of UTC; subtract 37 s from the times of the messages"),
        (5 - 1072915200, "the messages count from ETSI's epoch, 2004-01-01; add 1072915195 s to their times"),
        (
            -1072915200,
            "the messages count from ETSI's epoch, 2004-01-01; add 1072915195 s to their times, or 1072915200 s",
        ),
        (18 - 315964800, "the messages count from GPS's epoch, 1980-01-06; add 315964782 s to their times"),
        (-315964800, "the messages count from GPS's epoch, 1980-01-06; add 315964782 s to their times, or 315964800 s"),
        (315964800 - 18, "the recording counts from GPS's epoch, 1980-01-06; add 315964782 s to its times"),
        (-619315200, "the messages count the weeks of GPS anew after 1024; add 619315200 s to their times"),
        (1072915195, "the recording counts from ETSI's epoch, 2004-01-01; add 1072915195 s to its times"),
        (315964800, "the recording counts from GPS's epoch, 1980-01-06; add 315964782 s to its times, or 315964800 s"),
    ],
)
def test_a_known_clock_error_is_named_with_its_cure(ahead_s: int, cause: str) -> None:
    assert f"likely: {cause}" in refusal(ahead_s)
    # A log that does not begin with the recording hides no clock error.
    assert f"likely: {cause}" in refusal(ahead_s + 1.5)


@pytest.mark.parametrize("ahead_s", [25 * 3600, 1800, 100, -1072915200 + 4000])
def test_an_unknown_difference_is_not_explained(ahead_s: int) -> None:
    assert "likely" not in refusal(ahead_s)
