from __future__ import annotations

from datetime import datetime, timezone

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from laci_stereo.io.cam.its_time import DELTA_PERIOD_MS, generation_times, unix_ns

EPOCH = datetime(2004, 1, 1, tzinfo=timezone.utc)
LEAPS = {
    datetime(2005, 12, 31, tzinfo=timezone.utc): 0,
    datetime(2006, 1, 2, tzinfo=timezone.utc): 1,
    datetime(2010, 1, 1, tzinfo=timezone.utc): 2,
    datetime(2013, 1, 1, tzinfo=timezone.utc): 3,
    datetime(2016, 12, 31, tzinfo=timezone.utc): 4,
    datetime(2017, 1, 2, tzinfo=timezone.utc): 5,
    datetime(2025, 10, 9, tzinfo=timezone.utc): 5,
}


def its_ms(unix_ms: int, leap_s: int) -> int:
    return unix_ms - int(EPOCH.timestamp()) * 1000 + 1000 * leap_s


@pytest.mark.parametrize("day", LEAPS)
def test_the_clock_counts_leap_seconds_on(day: datetime):
    unix_ms = int(day.timestamp()) * 1000
    assert unix_ns(its_ms(unix_ms, LEAPS[day]) * 1000) == unix_ms * 10**6


@given(
    st.integers(1_600_000_000_000, 1_900_000_000_000),
    st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 900)), min_size=1, max_size=20),
)
def test_the_time_of_generation_is_found_again(start_ms: int, messages: list[tuple[int, int]]):
    generated = np.array([start_ms + at for at, _ in messages])
    received = generated + np.array([late for _, late in messages])
    delta = its_ms(generated, 5) % DELTA_PERIOD_MS
    stamps, _ = generation_times(received * 10**6 + 4321, delta, np.zeros(len(messages), dtype=np.int64))
    np.testing.assert_array_equal(stamps, generated * 10**6)


@pytest.mark.parametrize("ahead_s", [-20.0, -2.0, 2.0, 20.0])
def test_a_receiver_s_clock_that_is_off_does_not_matter_but_is_told(ahead_s: float):
    generated = 1_760_000_000_000 + 100 * np.arange(700)
    stamps, notes = generation_times(
        (generated + round(ahead_s * 1000)) * 10**6,
        its_ms(generated, 5) % DELTA_PERIOD_MS,
        np.ones(700, dtype=np.int64),
    )
    np.testing.assert_array_equal(stamps, generated * 10**6)
    assert f"received {ahead_s:.3f} s later: the clocks of senders and receiver differ" in notes[-1]


def test_a_sender_that_leaves_the_leap_seconds_out_is_put_right():
    generated = 1_760_000_000_000 + 100 * np.arange(100)
    stations = np.arange(100) % 2
    delta = its_ms(generated, np.where(stations == 1, 0, 5)) % DELTA_PERIOD_MS
    stamps, notes = generation_times((generated + 30) * 10**6, delta, stations)
    np.testing.assert_array_equal(stamps, generated * 10**6)
    assert "clock of 1 stations without the 5 leap seconds" in notes[0]
    assert "50 messages" in notes[0]
    assert "differ" not in notes[1]
