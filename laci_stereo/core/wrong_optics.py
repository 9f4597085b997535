"""Whether what a stereo camera saw fits the messages in another size: by another focal length, or another baseline."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from laci_stereo.core.case import Case, Instead, log_odds_between
from laci_stereo.core.choice import Choice
from laci_stereo.core.laying import stretched_track
from laci_stereo.core.track_scene import extent

FOCAL, BASELINE = "focal length", "baseline"

MOST = 2.0
"""By so much: images of half the size that the calibration is for."""

STEP = 0.06
"""Of the logarithm; half of it is half a metre where a drive ends 15 m from its middle, which boxes are off by as
well."""

LADDER = 2
"""First every second step is tried, then those beside the best."""

AROUND = 3
"""So many half steps around the best by boxes are held against outlines, which are more exact: a box is of what is
seen."""


@dataclass(frozen=True)
class _Stretched:
    """What fits best if all is so many times as deep, by another focal length, or as large, by another baseline."""

    what: str
    by: float
    choice: Choice | None


def _stretched(case: Case, what: str, by: float) -> _Stretched:
    aside = by if what == BASELINE else 1.0
    tracks = [stretched_track(track, by, aside) for track in case.tracks]
    return _Stretched(what, by, replace(case, tracks=tracks).chosen())


def optics_off(case: Case) -> Instead | None:
    """Say by how much longer a focal length or a baseline would have what moves fit the messages; None if none would.

    Asked where nothing fits as it was seen. What is not a matcher's has no such optics.
    """
    if not case.matched:
        return None
    moving = replace(case, tracks=[each for each in case.tracks if extent(each.centres) >= case.settings.min_path_m])
    boxes = replace(moving.by_boxes, tracks=[track.without_points() for track in moving.tracks])
    best = _stretched(boxes, FOCAL, 1.0)
    as_seen, most = best.choice, round(np.log(MOST) / STEP / LADDER) * LADDER
    ladder = np.exp(STEP * np.arange(-most, most + 1, LADDER))
    for what in (FOCAL, BASELINE):
        best = _better(best, (_stretched(boxes, what, float(by)) for by in ladder if by != 1.0))
    best = _better(best, [_stretched(boxes, best.what, best.by * float(np.exp(step))) for step in (-STEP, STEP)])
    log_searched = float(np.log(2 * len(ladder)))
    if best.by == 1.0 or log_odds_between(best.choice, as_seen) < case.settings.least_log_odds + log_searched:
        return None
    exact = _Stretched(best.what, 1.0, None)
    around = best.by * np.exp(STEP / 2 * np.arange(-AROUND, AROUND + 1))
    exact = _better(exact, (_stretched(moving, best.what, float(by)) for by in around))
    if exact.choice is None or exact.choice.doubt:
        return None
    way = "longer" if exact.by > 1.0 else "shorter"
    return Instead(
        exact.choice,
        f"were the stereo camera's {exact.what} {100.0 * abs(exact.by - 1.0):.0f} % {way} than its calibration says, "
        f"station {exact.choice.station} would be seen where its messages say: is that the calibration of these "
        "images?",
        log_searched,
    )


def _better(best: _Stretched, others: Iterable[_Stretched]) -> _Stretched:
    for each in others:
        if log_odds_between(each.choice, best.choice) > 0.0:
            best = each
    return best
