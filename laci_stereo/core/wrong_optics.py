"""Whether what a stereo camera saw fits the messages in another size: by another focal length, or another baseline."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from laci_stereo.core.association import chosen, log_odds_between
from laci_stereo.core.cam import VehicleTrack
from laci_stereo.core.choice import Choice, Likeness
from laci_stereo.core.laying import stretched_track
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.tracking import Track

MOST = 2.0
"""By so much: images of half the size that the calibration is for."""

STEP = 0.06
"""Of the logarithm; half of it is half a metre where a drive ends 15 m from its middle, which boxes are off by as
well."""

AROUND = 3
"""So many steps around the best by boxes are held against outlines, which are more exact: a box is of what is seen."""


@dataclass(frozen=True)
class _Stretched:
    """What fits best, by boxes, where all is so much deeper, or larger altogether."""

    what: str
    by: float
    choice: Choice | None

    def tracks(self, tracks: Iterable[Track]) -> list[Track]:
        aside = self.by if self.what == "baseline" else 1.0
        return [stretched_track(track, self.by, aside) for track in tracks]


def optics_off(
    tracks: Sequence[Track], vehicles: Mapping[int, VehicleTrack], settings: MatchSettings, likeness: Likeness
) -> str:
    """Say by how much longer a focal length or a baseline would have what moves fit the messages; empty if none would.

    Asked where nothing fits as it was seen. What is not a matcher's has no such optics.

    Parameters
    ----------
    tracks : sequence of Track
    vehicles : mapping of int to VehicleTrack
        By station.
    settings : MatchSettings
    likeness : callable
        See `choose_track`.
    """
    if not any(track.window_rad for track in tracks):
        return ""
    boxes = [track.without_points() for track in tracks]

    def stretched(what: str, by: float) -> _Stretched:
        tried = _Stretched(what, by, None)
        return replace(tried, choice=chosen(tried.tracks(boxes), vehicles, settings.any_fit))

    best = stretched("focal length", 1.0)
    as_seen, steps = best.choice, STEP * np.arange(-round(np.log(MOST) / STEP), round(np.log(MOST) / STEP) + 1)
    for what in ("focal length", "baseline"):
        best = _better(best, (stretched(what, float(by)) for by in np.exp(steps)))
    if best.by == 1.0 or log_odds_between(best.choice, as_seen) < settings.least_log_odds:
        return ""
    exact = _Stretched(best.what, 1.0, None)
    for by in best.by * np.exp(STEP / 2 * np.arange(-2 * AROUND, 2 * AROUND + 1)):
        tried = _Stretched(best.what, float(by), None)
        exact = _better(exact, [replace(tried, choice=chosen(tried.tracks(tracks), vehicles, settings, likeness))])
    if exact.choice is None:
        return ""
    return (
        f"were the stereo camera's {exact.what} {100.0 * abs(exact.by - 1.0):.0f} % "
        f"{'longer' if exact.by > 1.0 else 'shorter'}, station {exact.choice.station} would be seen where its messages "
        "say: is the stereo calibration that of these images?"
    )


def _better(best: _Stretched, others: Iterable[_Stretched]) -> _Stretched:
    for each in others:
        if log_odds_between(each.choice, best.choice) > 0.0:
            best = each
    return best
