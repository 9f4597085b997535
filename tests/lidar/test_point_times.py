from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from laci_lidar.columns import Column
from laci_lidar.point_times import is_own_clock, point_times

from laci_stereo.core.frames import FloatArray
from tests.lidar.support import EPOCH_NS

UNITS_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}


def offsets_s(times: Column, stamp_ns: int | None) -> FloatArray | None:
    found = point_times(times, stamp_ns)
    return None if found is None else found.offset_s


sweeps = st.builds(
    lambda length_ns, points: np.linspace(0, length_ns, points).astype(np.int64),
    st.integers(20_000_000, 999_000_000),
    st.integers(2, 200),
)


@given(sweeps, st.sampled_from(sorted(UNITS_NS)))
def test_the_unit_follows_from_the_length_of_the_scan(offsets_ns, unit):
    found = offsets_s(offsets_ns / UNITS_NS[unit], EPOCH_NS)
    np.testing.assert_allclose(found, offsets_ns / 1e9, atol=1e-9)


@given(sweeps, st.sampled_from(sorted(UNITS_NS)), st.integers(-1_000_000_000, 1_000_000_000))
def test_unix_times_count_from_the_stamp(offsets_ns, unit, late_ns):
    times = (
        (EPOCH_NS + late_ns + offsets_ns) // UNITS_NS[unit] if unit != "s" else (EPOCH_NS + late_ns + offsets_ns) / 1e9
    )
    found = offsets_s(times, EPOCH_NS)
    # Whole milliseconds, or a float64 of Unix seconds.
    np.testing.assert_allclose(found, (late_ns + offsets_ns) / 1e9, atol=1e-3 if unit == "ms" else 2e-6)


@given(sweeps, st.integers(5_000_000_000, 10**15))
def test_a_clock_of_its_own_starts_at_the_stamp(offsets_ns, since_power_on_ns):
    for stamp_ns in (EPOCH_NS, None):
        found = offsets_s(since_power_on_ns + offsets_ns, stamp_ns)
        np.testing.assert_allclose(found, offsets_ns / 1e9, atol=1e-9)


@given(sweeps)
def test_times_before_the_stamp_stay_before_it(offsets_ns):
    found = offsets_s((offsets_ns - offsets_ns[-1]).astype(np.float64) / 1e9, EPOCH_NS)
    np.testing.assert_allclose(found, (offsets_ns - offsets_ns[-1]) / 1e9, atol=1e-9)


@given(sweeps, st.randoms(use_true_random=False))
def test_the_order_of_points_does_not_matter(offsets_ns, random):
    order = list(range(len(offsets_ns)))
    random.shuffle(order)
    np.testing.assert_array_equal(offsets_s(offsets_ns[order], None), offsets_s(offsets_ns, None)[order])


@pytest.mark.parametrize(
    "times",
    [
        np.zeros(50, dtype=np.uint32),
        np.full(50, EPOCH_NS),
        np.linspace(0.0, 1e12, 50),
        # Unix seconds as float32 have steps of two minutes.
        np.float32(EPOCH_NS / 1e9) + np.linspace(0.0, 200.0, 50).astype(np.float32),
    ],
)
def test_numbers_that_are_no_times_of_one_scan(times):
    assert offsets_s(times, EPOCH_NS) is None


def test_unsigned_numbers_do_not_wrap():
    times = np.array([2**64 - 50_000_000, 2**64 - 1], dtype=np.uint64)
    np.testing.assert_allclose(offsets_s(times, EPOCH_NS), [0.0, 0.05], atol=1e-8)


@pytest.mark.parametrize(("turn_s", "unit"), [(1, "ns"), (3600, "us"), (604800, "s"), (60, "ms")])
def test_a_clock_that_begins_anew_within_a_scan(turn_s: int, unit: str) -> None:
    offsets_ns = np.linspace(0, 99_000_000, 100).astype(np.int64)
    times = (offsets_ns - 40_000_000) % (turn_s * 10**9) / UNITS_NS[unit]
    found = point_times(times if unit == "s" else np.floor(times).astype(np.uint64), EPOCH_NS)
    assert found is not None
    assert found.clock == "own"
    np.testing.assert_allclose(found.offset_s, offsets_ns / 1e9, atol=1.1e-3 if unit == "ms" else 2e-6)


PERIOD_S, SCANS = 0.1, np.arange(90)


def starts(first_s: FloatArray, stamps_s: FloatArray) -> list[tuple[float, str]]:
    """Of scans whose first point has these times, in microseconds."""
    found = []
    for start_s, stamp_s in zip(first_s, stamps_s, strict=True):
        times = np.round(1e6 * (start_s + np.linspace(0.0, 0.099, 30))).astype(np.int64)
        told = point_times(times, round(1e9 * stamp_s))
        assert told is not None
        found.append((float(told.offset_s.min()), told.clock))
    return found


@pytest.mark.parametrize(
    ("first_s", "own"),
    [
        (PERIOD_S * SCANS, True),
        (0.03 + PERIOD_S * SCANS % 1.0, True),
        ((3596.0 + PERIOD_S * SCANS) % 3600.0, True),
        (5000.0 + PERIOD_S * SCANS, True),
        (0.0 * SCANS, False),
        (-0.099 + 0.02 * np.sin(SCANS), False),
        (EPOCH_NS / 1e9 + PERIOD_S * SCANS, False),
    ],
    ids=["since the first scan", "within a second", "within an hour", "since power-on", "stamp", "its end", "Unix"],
)
def test_what_times_count_from_is_told_by_all_scans(first_s: FloatArray, own: bool) -> None:
    found = starts(first_s, EPOCH_NS / 1e9 + PERIOD_S * SCANS)
    some = [found[i] for i in np.linspace(0, len(found) - 1, 20).round().astype(int)]
    assert is_own_clock(some, PERIOD_S) == own  # type: ignore[arg-type]
