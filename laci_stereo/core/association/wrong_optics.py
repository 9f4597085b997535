"""Whether a stereo camera's sightings fit the messages by another focal length, baseline, or disparity offset.

All disparities are off by one offset if a camera has yawed, or has another principal point.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from laci_stereo.core.association.case import Alternative, Case, log_odds_between
from laci_stereo.core.association.choice import Choice
from laci_stereo.core.association.scene import extent
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.tracking.reframing import nearer_track, stretched_track

FOCAL, BASELINE, OFFSET = "focal length", "baseline", "offset"

MOST = 2.0
"""Largest factor that is tried: images of half the size that the calibration is for."""

STEP = 0.06
"""Step of the factor's logarithm. Half of it displaces the end of a drive, 15 m from its middle, by half a metre, which
is also the error of boxes."""

LADDER = 2
"""Every second step is tried first, then those beside the best."""

OFFSETS = 12
"""Number of half steps to either side at which a disparity offset is tried: it bends a drive, so beside the right one
nothing fits at all. The outermost change the depth by a third."""

AROUND = 3
"""Number of half steps on either side of the best by boxes that are compared by outlines, which are more exact: a box
only encloses the visible part."""


@dataclass(frozen=True)
class _Stretched:
    """The choice with everything ``by`` times as deep (another focal length) or as large (another baseline).

    With an offset of all disparities, the depth at a typical distance is ``by`` times as large.
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
    """Return the increase of inverse distances, 1/m, that scales the depth at a typical distance by ``by``."""
    return (1.0 / by - 1.0) / _typical_m(case)


def _typical_m(case: Case) -> float:
    return float(np.median(np.concatenate([np.linalg.norm(track.centres, axis=1) for track in case.tracks])))


def optics_off(case: Case) -> Alternative | None:
    """Return the focal length or the baseline by which moving objects fit the messages; None if there is none.

    Called where nothing fits as it was seen. Only the points of a stereo matcher depend on either.
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
    if exact.choice is None or exact.choice.by_chance:
        return None
    way = "longer" if exact.by > 1.0 else "shorter"
    return Alternative(
        exact.choice,
        f"if the stereo camera's {exact.what} were {100.0 * abs(exact.by - 1.0):.0f} % {way} than its calibration has "
        f"it, station {exact.choice.station} would match its messages: is that the calibration of these images?",
        log_searched,
    )


def disparities_off(case: Case) -> Alternative | None:
    """Return the offset of all disparities by which moving objects fit the messages; None if there is none.

    Boxes may fit hardly better with the offset than as seen, while outlines fit only with it, so outlines decide.
    """
    moving = _moving(case)
    if not case.matched or not moving.tracks:
        return None
    ladder = np.exp(STEP / 2 * np.arange(-OFFSETS, OFFSETS + 1))
    best, _ = _by_boxes(moving, (OFFSET,), ladder)
    exact = _by_outlines(moving, best)
    if exact.choice is None or exact.choice.by_chance:
        return None
    typical_m = _typical_m(moving)
    return Alternative(
        exact.choice,
        f"if all disparities were off by one amount, so that what was measured {typical_m:.0f} m away is "
        f"{exact.by * typical_m:.1f} m away, station {exact.choice.station} would match its messages: has one of the "
        "cameras yawed since they were calibrated, or are left and right images of different moments?",
        float(np.log(len(ladder))),
        _nearer_per_m(moving, exact.by),
    )


def _moving(case: Case) -> Case:
    return replace(case, tracks=[each for each in case.tracks if extent(each.centres) >= case.settings.min_path_m])


def _by_boxes(moving: Case, whats: Sequence[str], ladder: FloatArray) -> tuple[_Stretched, Choice | None]:
    """Return the likeliest factor of some quantities by boxes, and what is chosen by boxes as they were seen."""
    boxes = replace(moving.by_boxes, tracks=[track.without_points() for track in moving.tracks])
    best = as_seen = _stretched(boxes, whats[0], 1.0)
    for what in whats:
        best = _better(best, (_stretched(boxes, what, float(by)) for by in ladder if by != 1.0))
    best = _better(best, [_stretched(boxes, best.what, best.by * float(np.exp(step))) for step in (-STEP, STEP)])
    return best, as_seen.choice


def _by_outlines(moving: Case, best: _Stretched) -> _Stretched:
    """Return the likeliest factor by outlines, of those around the best by boxes."""
    around = best.by * np.exp(STEP / 2 * np.arange(-AROUND, AROUND + 1))
    return _better(_Stretched(best.what, 1.0, None), (_stretched(moving, best.what, float(by)) for by in around))


def _better(best: _Stretched, others: Iterable[_Stretched]) -> _Stretched:
    for each in others:
        if log_odds_between(each.choice, best.choice) > 0.0:
            best = each
    return best
