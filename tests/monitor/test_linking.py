"""Bodies that fall apart for a moment stay one object."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from laci_stereo.core.settings import Settings
from laci_stereo.core.tracking.box import Box
from laci_stereo.core.tracking.sighting import Sighting
from laci_stereo.monitor.linking import Linker

PERIOD_S = 0.2

TURNS_LEFT = (
    *((-18.8, 20.4), (-17.6, 20.4), (-16.4, 20.4), (-15.3, 20.4), (-13.9, 20.4), (-13.2, 20.6), (-12.0, 20.9)),
    *((-11.2, 21.4), (-10.6, 21.4), (-11.0, 21.1), (-9.8, 21.9), (-9.1, 22.7), (-8.4, 24.9), (-8.0, 25.7)),
    *((-7.6, 26.8), (-7.3, 26.7), (-7.1, 28.8), (-7.0, 29.7), (-6.9, 30.0), (-7.0, 31.1), (-6.9, 32.0), (-7.2, 33.0)),
)
"""Where the demonstration's camera sees the middle of the car, level frame, metres."""

BROKEN, FRONT = 9, (-8.7, 23.0)
"""The frame in which matches are missing across the car, and where its front then is."""

WHOLE, PIECE = 4000, 1300
"""Points of the car, and of its front."""


def seen(frame: int, place: tuple[float, float]) -> Sighting:
    middle, stamp_s = np.array(place), PERIOD_S * frame
    points, noise = np.column_stack([np.tile(middle, (3, 1)), np.ones(3)]), np.full(3, 0.05)
    count = PIECE if place == FRONT else WHOLE
    return Sighting(stamp_s, stamp_s, points, noise, noise, count, middle, Box(middle, 4.0, 1.8, 0.0), "cut")


def linked(frames: Sequence[Sequence[tuple[float, float]]]) -> list[list[int]]:
    """Return the frames of each object, where something is seen at these places in each frame."""
    linker, over = Linker(), []
    for number, places in enumerate(frames):
        sightings = [seen(number, place) for place in places]
        over += linker.add(number, PERIOD_S * number, sightings, Settings(), 60.0)
    return [[kept.frame for kept in live.kept] for live in over + linker.rest(Settings().track)]


def test_car_that_falls_apart_in_one_frame_is_one_object() -> None:
    """Its front becomes a track of its own, which then takes the whole car over."""
    frames = [[place, FRONT] if number == BROKEN else [place] for number, place in enumerate(TURNS_LEFT)]
    assert linked(frames) == [list(range(len(TURNS_LEFT)))]


def test_car_behind_another_is_another_object() -> None:
    """The one ahead vanishes while the other, hidden for a moment, comes back 8 m behind it."""
    way = [(5.0 * PERIOD_S * number, 20.0) for number in range(40)]
    behind = [(x - 8.0, y) for x, y in way]
    frames = [[way[n]] if n < 12 else [behind[n]] for n in range(40)]
    frames[9] = [way[9], behind[9]]
    assert sorted(map(len, linked(frames))) == [12, 29]
