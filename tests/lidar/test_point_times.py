from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from laci_lidar.point_times import offsets_s

from tests.lidar.support import EPOCH_NS

UNITS_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
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
