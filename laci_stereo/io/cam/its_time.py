"""ETSI's clock: milliseconds since 2004-01-01 UTC, leap seconds included; and generationDeltaTime, derived from it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from laci_stereo.core.frames import IntArray

ITS_EPOCH_NS = 1_072_915_200 * 10**9
"""Unix time of 2004-01-01T00:00:00Z."""

LEAP_SECONDS_FROM_S = (1_136_073_600, 1_230_768_000, 1_341_100_800, 1_435_708_800, 1_483_228_800)
"""Unix times right after the leap seconds that were inserted since 2004 (2006, 2009, 2012, 2015, 2017)."""

DELTA_PERIOD_MS = 1 << 16

SAME_CLOCK_NS = 10**9
"""Largest difference between clocks that count as synchronous: a message is received some 0.1 s after its position was
measured, and users' clocks agree to some tenths of a second. A sender that ignores the leap seconds is off by five
times as much."""


def unix_ns(its_us: int) -> int:
    """Return the Unix time, nanoseconds, of a time in microseconds on ETSI's clock."""
    ns = ITS_EPOCH_NS + its_us * 1000
    return ns - 10**9 * int(_leap_seconds(np.array([min(ns, 2**63 - 1)]))[0])


def generation_times(received_ns: IntArray, delta_ms: IntArray, stations: IntArray) -> tuple[IntArray, list[str]]:
    """Return generation times (Unix), shape (n,), and notes on how the clocks of senders and receiver differ.

    They are the times nearest to the reception that agree with ``generationDeltaTime``, the time of ETSI's clock in
    milliseconds modulo 65,536 (EN 302 637-2, B.3).

    Parameters
    ----------
    received_ns : ndarray of int64, shape (n,)
        Time of reception, Unix time.
    delta_ms : ndarray of int64, shape (n,)
        Each message's ``generationDeltaTime``.
    stations : ndarray of int64, shape (n,)
        Each message's sender. A sender whose clock omits the leap seconds is recognised by the median delay of its
        messages, and its times are corrected.
    """
    leap_ns = 10**9 * _leap_seconds(received_ns)
    its_ms = (received_ns - ITS_EPOCH_NS + leap_ns) // 10**6
    late_ms = (its_ms - delta_ms + DELTA_PERIOD_MS // 2) % DELTA_PERIOD_MS - DELTA_PERIOD_MS // 2
    stamps = (its_ms - late_ms) * 10**6 + ITS_EPOCH_NS - leap_ns
    forgets = np.abs(_medians(received_ns - stamps, stations) - leap_ns) < SAME_CLOCK_NS
    forgets &= leap_ns > 0
    stamps = stamps + np.where(forgets, leap_ns, 0)
    notes = []
    if forgets.any():
        notes.append(
            f"clock of {len(np.unique(stations[forgets]))} stations without the {leap_ns[forgets][0] // 10**9} leap "
            f"seconds since 2004, as {int(forgets.sum())} messages seem so much late; put right"
        )
    return stamps, [*notes, _delay_note(received_ns - stamps)]


def _delay_note(delay_ns: IntArray) -> str:
    middle_ns = int(np.median(delay_ns))
    note = (
        "timestamp: generationDeltaTime, of which 65.536 s the time of reception tells; "
        f"received {middle_ns / 1e9:.3f} s later"
    )
    if abs(middle_ns) < SAME_CLOCK_NS:
        return note
    return f"{note}: the clocks of senders and receiver differ, and the senders' is used"


def _leap_seconds(stamps_ns: IntArray) -> IntArray:
    """Return the number of leap seconds inserted between 2004 and each Unix time."""
    inserted = np.searchsorted(np.array(LEAP_SECONDS_FROM_S) * 10**9, stamps_ns, side="right")
    return inserted.astype(np.int64)


def _medians(values: IntArray, groups: Sequence[int] | IntArray) -> IntArray:
    """Return for each value the median of its group (of an even number, the upper one), shape (n,)."""
    _, group, counts = np.unique(groups, return_inverse=True, return_counts=True)
    ordered = values[np.lexsort((values, group))]
    medians: IntArray = ordered[np.cumsum(counts) - counts + counts // 2][group]
    return medians
