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
from laci_stereo.core.track_scene import extent
from laci_stereo.core.tracking import Track

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

    def tracks(self, tracks: Iterable[Track]) -> list[Track]:
        aside = self.by if self.what == BASELINE else 1.0
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
    moving = [track for track in tracks if extent(track.centres) >= settings.min_path_m]
    boxes = [track.without_points() for track in moving]

    def stretched(what: str, by: float) -> _Stretched:
        tried = _Stretched(what, by, None)
        return replace(tried, choice=chosen(tried.tracks(boxes), vehicles, settings.any_fit))

    best = stretched(FOCAL, 1.0)
    as_seen, most = best.choice, round(np.log(MOST) / STEP / LADDER) * LADDER
    ladder = np.exp(STEP * np.arange(-most, most + 1, LADDER))
    for what in (FOCAL, BASELINE):
        best = _better(best, (stretched(what, float(by)) for by in ladder if by != 1.0))
    best = _better(best, [stretched(best.what, best.by * float(np.exp(step))) for step in (-STEP, STEP)])
    searched = np.log(2 * len(ladder))  # one of so many fits so well by chance more often than a single one
    if best.by == 1.0 or log_odds_between(best.choice, as_seen) < settings.least_log_odds + searched:
        return ""
    exact = _Stretched(best.what, 1.0, None)
    for by in best.by * np.exp(STEP / 2 * np.arange(-AROUND, AROUND + 1)):
        tried = _Stretched(best.what, float(by), None)
        exact = _better(exact, [replace(tried, choice=chosen(tried.tracks(moving), vehicles, settings, likeness))])
    if exact.choice is None:
        return ""
    way = "longer" if exact.by > 1.0 else "shorter"
    return (
        f"were the stereo camera's {exact.what} {100.0 * abs(exact.by - 1.0):.0f} % {way} than its calibration says, "
        f"station {exact.choice.station} would be seen where its messages say: is that the calibration of these images?"
    )


def _better(best: _Stretched, others: Iterable[_Stretched]) -> _Stretched:
    for each in others:
        if log_odds_between(each.choice, best.choice) > 0.0:
            best = each
    return best
