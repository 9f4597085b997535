"""The points' own times within a scan: in any unit, relative to the scan's stamp, to 1970 or to any other origin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from typing import Literal, TypeAlias

import numpy as np

from laci_lidar.columns import Column
from laci_stereo.core.frames import FloatArray
from laci_stereo.io.stamps import UNITS, TimeUnit

LONGEST_S = 1.0
"""Maximum duration of a sweep, which is 0.02 to 1 s. Units differ by a factor of 1000, so that the duration fits
exactly one."""

FAR_FROM_STAMP_S = 2.0
"""A sweep begins or ends at its stamp; times farther from it come from another clock."""

CLOCKS_S = (1, 60, 3600, 86_400, 604_800)
"""Periods of clocks that wrap around: a second, a minute, an hour (Velodyne), a day, a week (GPS)."""

FINEST_SHARE = 0.02
"""Numbers with a rounding error above this fraction of a sweep, such as Unix seconds as float32, are no usable
times."""


Clock: TypeAlias = Literal["stamp", "Unix", "own"]
"""Origin of times: the scan's stamp, 1970, or anything else."""


@dataclass(frozen=True)
class PointTimes:
    """Acquisition times of the points of a scan.

    Attributes
    ----------
    offset_s : ndarray, shape (n,)
        Time after the scan's stamp, seconds.
    clock : {"stamp", "Unix", "own"}
        Assumed origin of the times.
    """

    offset_s: FloatArray
    clock: Clock


def point_times(times: Column, stamp_ns: int | None) -> PointTimes | None:
    """Return the time of each point after the scan's stamp.

    The unit follows from the duration of the whole scan. Times near zero are relative to the stamp; times near the
    stamp are Unix times; all others come from a clock of their own, and the first of them is assumed to be at the
    stamp.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Finite, n > 0.
    stamp_ns : int or None
        The scan's Unix time, nanoseconds.

    Returns
    -------
    PointTimes or None
        None if all times are equal, or cannot be times of one scan.
    """
    if (anew := _begun_anew(times)) is not None:
        return anew
    first = times.min()
    if times.dtype.kind == "f":
        since_first = times.astype(np.float64) - float(first)
        rounding = float(np.spacing(np.abs(times).max()))
    else:
        since_first = (times - first).astype(np.uint64).astype(np.float64)
        rounding = 0.0
    span = float(since_first.max())
    unit = _unit(span)
    if unit is None or rounding > FINEST_SHARE * span:
        return None
    start_s, clock = _start(first, unit, stamp_ns)
    return PointTimes(since_first / (10**9 / unit.ns) + start_s, clock)


def _begun_anew(times: Column) -> PointTimes | None:
    """Return the times of a scan during which its clock wrapped around; None if it did not."""
    low, high = float(times.min()), float(times.max())
    for turn in (clock_s * 10**9 / unit.ns for clock_s in CLOCKS_S for unit in UNITS):
        if 0.0 <= low < 0.1 * turn and 0.9 * turn < high <= turn:
            since = np.where(times > turn / 2, times.astype(np.float64) - turn, times)
            unit = _unit(span := float(np.ptp(since)))
            # A sweep has no gap in its middle: the step across the wrap-around is like the others.
            if unit is not None and 2 * (low + turn - high) < span < turn / 2:
                return PointTimes((since - since.min()) / (10**9 / unit.ns), "own")
    return None


def is_own_clock(starts: Sequence[tuple[float, Clock]], period_s: float) -> bool:
    """Return whether times that may be relative to the stamps are not, from the start times of a recording's scans.

    The times of a clock that began with the recording, or wraps around each second or hour, are near zero only
    occasionally, or anywhere within a second. Relative to its stamp, every scan begins at about the same time.

    Parameters
    ----------
    starts : sequence of (float, Clock)
        For each scan, the first point's time after its stamp, and the assumed origin.
    period_s : float
        Time from one scan to the next.
    """
    by_stamp = [start_s for start_s, clock in starts if clock == "stamp"]
    others = sum(clock == "own" for _, clock in starts)
    return others > len(by_stamp) or bool(by_stamp and np.ptp(np.quantile(by_stamp, [0.1, 0.9])) > period_s)


def _unit(span: float) -> TimeUnit | None:
    """Return the unit in which a scan of this duration takes at most `LONGEST_S`, but over a thousandth of that."""
    fits = (unit for unit in UNITS if LONGEST_S / 1000 < span * unit.ns / 1e9 <= LONGEST_S)
    return next(fits, None)


def _start(first: np.generic, unit: TimeUnit, stamp_ns: int | None) -> tuple[float, Clock]:
    """Return the first point's time after the stamp, seconds, and the origin of times."""
    first_ns = round(Decimal(first.item()) * unit.ns)
    if abs(first_ns) <= LONGEST_S * 1e9:
        return first_ns / 1e9, "stamp"
    if stamp_ns is not None and abs(first_ns - stamp_ns) <= FAR_FROM_STAMP_S * 1e9:
        return (first_ns - stamp_ns) / 1e9, "Unix"
    return 0.0, "own"
