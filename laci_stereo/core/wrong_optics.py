"""Whether what a stereo camera saw fits the messages by other optics: another focal length, or another baseline.

Or if all disparities are off by one offset, as by a camera that has turned sideways, or another principal point.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from laci_stereo.core.association_case import Alternative, Case, log_odds_between
from laci_stereo.core.choice import Choice
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.reframing import nearer_track, stretched_track
from laci_stereo.core.track_scene import extent

FOCAL, BASELINE, OFFSET = "focal length", "baseline", "offset"

MOST = 2.0
"""By so much: images of half the size that the calibration is for."""

STEP = 0.06
"""Of the logarithm; half of it is half a metre where a drive ends 15 m from its middle, which boxes are off by as
well."""

LADDER = 2
"""First every second step is tried, then those beside the best."""

OFFSETS = 12
"""So many half steps to either side are tried of an offset: it bends a drive, so that beside the right one nothing fits
at all. The last are a third of the depth."""

AROUND = 3
"""So many half steps around the best by boxes are held against outlines, which are more exact: a box is of what is
seen."""


@dataclass(frozen=True)
class _Stretched:
    """What fits best if all is so many times as deep, by another focal length, or as large, by another baseline.

    By an offset of all disparities it is so many times as deep at a typical distance.
    """

    what: str
    by: float
    choice: Choice | None


def _stretched(case: Case, what: str, by: float) -> _Stretched:
    if what == OFFSET:
        per_m = _nearer_per_m(case, by)
        tracks = [nearer_track(track, per_m) for track in case.tracks]
    else:
        tracks = [stretched_track(track, by, by if what == BASELINE else 1.0) for track in case.tracks]
    return _Stretched(what, by, replace(case, tracks=tracks).chosen())


def _nearer_per_m(case: Case, by: float) -> float:
    """Return by how much inverse distances are larger where all is so many times as deep at a typical distance."""
    return (1.0 / by - 1.0) / _typical_m(case)


def _typical_m(case: Case) -> float:
    return float(np.median(np.concatenate([np.linalg.norm(track.centres, axis=1) for track in case.tracks])))


def optics_off(case: Case) -> Alternative | None:
    """Say by how much longer a focal length or a baseline would have what moves fit the messages; None if none would.

    Asked where nothing fits as it was seen. What is not a matcher's has no such optics.
    """
    moving = _moving(case)
    if not case.matched or not moving.tracks:
        return None
    most = round(np.log(MOST) / STEP / LADDER) * LADDER
    ladder = np.exp(STEP * np.arange(-most, most + 1, LADDER))
    best, as_seen = _by_boxes(moving, (FOCAL, BASELINE), ladder)
    log_searched = float(np.log(2 * len(ladder)))
    if best.by == 1.0 or log_odds_between(best.choice, as_seen) < case.settings.least_log_odds + log_searched:
        return None
    exact = _by_outlines(moving, best)
    if exact.choice is None or exact.choice.doubt:
        return None
    way = "longer" if exact.by > 1.0 else "shorter"
    return Alternative(
        exact.choice,
        f"were the stereo camera's {exact.what} {100.0 * abs(exact.by - 1.0):.0f} % {way} than its calibration says, "
        f"station {exact.choice.station} would be seen where its messages say: is that the calibration of these "
        "images?",
        log_searched,
    )


def disparities_off(case: Case) -> Alternative | None:
    """Say the same of an offset of all disparities.

    One by which boxes fit about as well as they were seen may still be one by which outlines do, and else not.
    """
    moving = _moving(case)
    if not case.matched or not moving.tracks:
        return None
    ladder = np.exp(STEP / 2 * np.arange(-OFFSETS, OFFSETS + 1))
    best, _ = _by_boxes(moving, (OFFSET,), ladder)
    exact = _by_outlines(moving, best)
    if exact.choice is None or exact.choice.doubt:
        return None
    typical_m = _typical_m(moving)
    return Alternative(
        exact.choice,
        f"were all disparities off, so that what was measured {typical_m:.0f} m away is {exact.by * typical_m:.1f} m "
        f"away, station {exact.choice.station} would be seen where its messages say: has one of the cameras turned "
        "sideways since they were calibrated?",
        float(np.log(len(ladder))),
        _nearer_per_m(moving, exact.by),
    )


def _moving(case: Case) -> Case:
    return replace(case, tracks=[each for each in case.tracks if extent(each.centres) >= case.settings.min_path_m])


def _by_boxes(moving: Case, whats: Sequence[str], ladder: FloatArray) -> tuple[_Stretched, Choice | None]:
    """Return the likeliest of some optics by boxes, and what is chosen by them as they were seen."""
    boxes = replace(moving.by_boxes, tracks=[track.without_points() for track in moving.tracks])
    best = as_seen = _stretched(boxes, whats[0], 1.0)
    for what in whats:
        best = _better(best, (_stretched(boxes, what, float(by)) for by in ladder if by != 1.0))
    best = _better(best, [_stretched(boxes, best.what, best.by * float(np.exp(step))) for step in (-STEP, STEP)])
    return best, as_seen.choice


def _by_outlines(moving: Case, best: _Stretched) -> _Stretched:
    """Return what is likeliest by outlines around the best by boxes."""
    around = best.by * np.exp(STEP / 2 * np.arange(-AROUND, AROUND + 1))
    return _better(_Stretched(best.what, 1.0, None), (_stretched(moving, best.what, float(by)) for by in around))


def _better(best: _Stretched, others: Iterable[_Stretched]) -> _Stretched:
    for each in others:
        if log_odds_between(each.choice, best.choice) > 0.0:
            best = each
    return best
