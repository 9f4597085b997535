"""The points' own times within a scan: any unit, counted from the scan's stamp, from 1970 or from anywhere."""

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
"""A sweep lasts 0.02 to 1 s. Units are a thousand apart, so that its length fits exactly one of them."""

FAR_FROM_STAMP_S = 2.0
"""A sweep begins or ends at its stamp; times that are farther from it are of another clock."""

CLOCKS_S = (1, 60, 3600, 86_400, 604_800)
"""So long clocks count that begin anew: within a second, a minute, an hour (Velodyne), a day, a week (GPS)."""

FINEST_SHARE = 0.02
"""Numbers whose rounding is coarser than this share of a sweep, such as Unix seconds as float32, are no times."""


Clock: TypeAlias = Literal["stamp", "Unix", "own"]
"""What times count from: the scan's stamp, 1970, or anything else."""


@dataclass(frozen=True)
class PointTimes:
    """When the points of a scan were taken.

    Attributes
    ----------
    offset_s : ndarray, shape (n,)
        After the scan's stamp, seconds.
    clock : {"stamp", "Unix", "own"}
        What the times were taken to count from.
    """

    offset_s: FloatArray
    clock: Clock


def point_times(times: Column, stamp_ns: int | None) -> PointTimes | None:
    """Return the time of each point after the scan's stamp.

    The unit follows from how long the whole scan takes. Times around zero count from the stamp; times around the stamp
    are Unix times; any others are of a clock of their own, and the first of them is taken to be at the stamp.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Finite, n > 0.
    stamp_ns : int or None
        The scan's Unix time, nanoseconds.

    Returns
    -------
    PointTimes or None
        None if all times are the same, or are no times of one scan.
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
    """Return the times of a scan during which its clock began anew; None where it did not."""
    low, high = float(times.min()), float(times.max())
    for turn in (clock_s * 10**9 / unit.ns for clock_s in CLOCKS_S for unit in UNITS):
        if 0.0 <= low < 0.1 * turn and 0.9 * turn < high <= turn:
            since = np.where(times > turn / 2, times.astype(np.float64) - turn, times)
            unit = _unit(span := float(np.ptp(since)))
            # What is left out in the middle is no part of a sweep; from before to after there is a step like others.
            if unit is not None and 2 * (low + turn - high) < span < turn / 2:
                return PointTimes((since - since.min()) / (10**9 / unit.ns), "own")
    return None


def is_own_clock(starts: Sequence[tuple[float, Clock]], period_s: float) -> bool:
    """Tell whether times that may count from the stamps do not: by when some scans of a recording begin.

    A clock that began with the recording, or begins anew each second or hour, is near zero now and then only, or
    anywhere in a second. After its stamp a scan always begins alike.

    Parameters
    ----------
    starts : sequence of (float, Clock)
        Of each scan the first point's time after its stamp, and what that was taken to count from.
    period_s : float
        From one scan to the next.
    """
    by_stamp = [start_s for start_s, clock in starts if clock == "stamp"]
    others = sum(clock == "own" for _, clock in starts)
    return others > len(by_stamp) or bool(by_stamp and np.ptp(np.quantile(by_stamp, [0.1, 0.9])) > period_s)


def _unit(span: float) -> TimeUnit | None:
    """Return the unit in which a scan of this length lasts at most `LONGEST_S`, but more than a thousandth of that."""
    fits = (unit for unit in UNITS if LONGEST_S / 1000 < span * unit.ns / 1e9 <= LONGEST_S)
    return next(fits, None)


def _start(first: np.generic, unit: TimeUnit, stamp_ns: int | None) -> tuple[float, Clock]:
    """Return the first point's time after the stamp, and what it counts from."""
    first_ns = round(Decimal(first.item()) * unit.ns)
    if abs(first_ns) <= LONGEST_S * 1e9:
        return first_ns / 1e9, "stamp"
    if stamp_ns is not None and abs(first_ns - stamp_ns) <= FAR_FROM_STAMP_S * 1e9:
        return (first_ns - stamp_ns) / 1e9, "Unix"
    return 0.0, "own"
