from __future__ import annotations

import re
from datetime import datetime, timezone

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from laci_stereo.io.epochs import FIRST_CAMS_NS, epoch_notes

S = 10**9
TRUE_NS = int(datetime(2024, 5, 7, 12, tzinfo=timezone.utc).timestamp()) * S


def sent(first_ns: int, period_ns: int = S // 10) -> np.ndarray:
    return first_ns + period_ns * np.arange(100, dtype=np.int64)


@given(st.integers(FIRST_CAMS_NS, TRUE_NS))
def test_times_since_there_are_cams_need_no_remark(first_ns: int) -> None:
    assert epoch_notes(sent(first_ns)) == []


@pytest.mark.parametrize(
    ("epoch", "leaps_s"),
    [(datetime(2004, 1, 1, tzinfo=timezone.utc), 5), (datetime(1980, 1, 6, tzinfo=timezone.utc), 18)],
)
def test_what_the_remark_says_to_add_gives_the_true_time(epoch: datetime, leaps_s: int) -> None:
    """A clock counts since its epoch, leap seconds included; what reads it as Unix time is years behind."""
    true_ns = TRUE_NS if epoch.year == 2004 else int(datetime(2018, 5, 7, 12, tzinfo=timezone.utc).timestamp()) * S
    told_ns = true_ns - int(epoch.timestamp()) * S + leaps_s * S
    (note,) = epoch_notes(sent(told_ns))
    date = datetime.fromtimestamp(true_ns / S, timezone.utc).date().isoformat()
    added_s = re.search(rf"epoch, {epoch.date().isoformat()}, they are of {date}: add (\d+) s", note)
    assert added_s is not None
    assert told_ns + int(added_s[1]) * S == true_ns


def test_weeks_that_began_anew_are_a_cause() -> None:
    (note,) = epoch_notes(sent(TRUE_NS - 1024 * 7 * 86400 * S))
    assert "the weeks of GPS anew after 1024, they are of 2024-05-07: add 619315200 s" in note


def test_no_clock_is_named_by_which_the_messages_would_be_of_the_future() -> None:
    (note,) = epoch_notes(sent(int(datetime(2006, 1, 1, tzinfo=timezone.utc).timestamp()) * S))
    assert "ETSI" not in note
    assert "GPS" in note


def test_milliseconds_of_a_gps_week_pass_for_seconds_of_the_eighties() -> None:
    in_week_ms = 377_602_237
    (note,) = epoch_notes(sent(in_week_ms * S, 100 * S))
    assert "milliseconds of a GPS week, divide them by 1000" in note
    assert "milliseconds" not in epoch_notes(sent(in_week_ms * S))[0]
