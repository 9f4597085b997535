"""Whether drives can be of one sensor, and are different drives."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from laci_stereo.core.errors import EvidenceError
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.frames import FloatArray, between


def check_alike(passages: Sequence[Passage]) -> None:
    """Check that drives are of one sensor, as far as their frames and maps tell, and that each is there once.

    Raises
    ------
    EvidenceError
    """
    first = passages[0]
    for other in passages[1:]:
        if other.world.crs != first.world.crs:
            raise EvidenceError(
                f"{other.name}: positions in {other.world.crs}; needed is {first.world.crs} as in {first.name}: "
                f"calibrate it again with --crs {first.world.crs}"
            )
        if not np.allclose((other.axes.forward, other.axes.up), (first.axes.forward, first.axes.up)):
            raise EvidenceError(
                f"{other.name}: the sensor's axes are {_in_words(other)}; needed are {_in_words(first)} as in "
                f"{first.name}"
            )
    for one, other in combinations(passages, 2):
        if one.station_id != other.station_id and _seen_apart_m(one, other) < _half_width_m(one, other):
            raise EvidenceError(
                f"{other.name}: is the same drive as {one.name}, or a part of it, under another station number "
                f"({other.station_id} and {one.station_id}): at the same times its vehicle is seen at the same place; "
                "needed is each drive once"
            )
        if one.is_also(other):
            begins_ns, ends_ns = zip(one.span_ns, other.span_ns, strict=True)
            both_s = (min(ends_ns) - max(begins_ns)) / 1e9
            apart_m = _apart_m(one, other)
            if apart_m > max(one.vehicle.length_m, other.vehicle.length_m):
                raise EvidenceError(
                    f"{other.name}: is of the same time as {one.name}, and station {one.station_id} is {apart_m:.0f} m "
                    f"away from itself in these {both_s:.1f} s: needed are two station numbers if these are two "
                    "vehicles, and the right times if it is one"
                )
            raise EvidenceError(
                f"{other.name}: is the same drive as {one.name}, or a part of it: station {one.station_id} drives in "
                f"both at the same time, for {both_s:.1f} s; needed is each drive once"
            )


def _apart_m(one: Passage, other: Passage) -> float:
    """Return the median distance between two vehicles while both send; 0 if they never do at the same time."""
    xy, other_xy = (each.world.to_utm(each.vehicle.xy) for each in (one, other))
    apart_m = _at_once_m(one, other, (one.vehicle.stamps_s, xy), (other.vehicle.stamps_s, other_xy))
    return float(np.median(apart_m)) if len(apart_m) else 0.0


def _seen_apart_m(one: Passage, other: Passage) -> float:
    """Return the median distance between what is seen of two vehicles at the same times; infinite without any."""
    tracks = ((each.track.stamps_s, each.track.centres) for each in (one, other))
    apart_m = _at_once_m(one, other, *tracks)
    return float(np.median(apart_m)) if len(apart_m) else float("inf")


def _at_once_m(
    one: Passage, other: Passage, path: tuple[FloatArray, FloatArray], other_path: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """Return the distances between two paths of times and places, (n,) and (n, 2), at the times of the first one."""
    (stamps_s, xy), (other_s, other_xy) = path, other_path
    there_s = stamps_s + (one.vehicle.epoch_ns - other.vehicle.epoch_ns) / 1e9
    both = (other_s[0] <= there_s) & (there_s <= other_s[-1])
    apart_m: FloatArray = np.linalg.norm(xy - between(there_s, other_s, other_xy), axis=1)[both]
    return apart_m


def _half_width_m(one: Passage, other: Passage) -> float:
    return min(one.vehicle.width_m, other.vehicle.width_m) / 2.0


def _in_words(passage: Passage) -> str:
    return f"{passage.axes.forward} forward, {passage.axes.up} up"
