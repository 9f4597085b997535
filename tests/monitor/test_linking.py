"""Bodies that fall apart for a moment stay one object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

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


def seen(frame: int, place: tuple[float, float], period_s: float = PERIOD_S) -> Sighting:
    middle, stamp_s = np.array(place), period_s * frame
    points, noise = np.column_stack([np.tile(middle, (3, 1)), np.ones(3)]), np.full(3, 0.05)
    count = PIECE if place == FRONT else WHOLE
    return Sighting(stamp_s, stamp_s, points, noise, noise, count, middle, Box(middle, 4.0, 1.8, 0.0), "cut")


def linked(frames: Sequence[Sequence[tuple[float, float]]], period_s: float = PERIOD_S) -> list[list[int]]:
    """Return the frames of each object, where something is seen at these places in each frame."""
    linker, over = Linker(), []
    for number, places in enumerate(frames):
        sightings = [seen(number, place, period_s) for place in places]
        over += linker.add(number, period_s * number, sightings, Settings(), 60.0)
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


STANDS = (-60.0, 5.0)
"""Another object, so that no frame is empty."""


def hidden(hz: float) -> list[list[tuple[float, float]]]:
    """Return the places of a car at 5 m/s that a lorry hides for a second; of its rear the last bit comes out last."""
    frames = []
    for since_s in np.arange(-3.0, 4.0, 1.0 / hz) - 1.0:
        ahead_m = 2.0 * (1.0 - since_s / 0.25) if 0.0 <= since_s < 0.25 else 0.0
        car = [] if -1.0 < since_s < 0.0 else [(5.0 * since_s + ahead_m, 20.0)]
        frames.append([*car, STANDS])
    return frames


@pytest.mark.parametrize("hz", [5.0, 10.0, 30.0, 60.0])
def test_car_that_comes_out_bit_by_bit_is_one_object_at_any_rate(hz: float) -> None:
    """For a quarter of a second, ten frames at 40 Hz, its middle moves backwards."""
    frames = hidden(hz)
    assert sorted(map(len, linked(frames, 1.0 / hz))) == [sum(len(frame) > 1 for frame in frames), len(frames)]


def test_car_that_is_missing_in_one_of_few_frames_is_one_object() -> None:
    """With a frame a second and a quarter, one that is missing leaves it unseen for two seconds and a half."""
    frames = [[] if number == 6 else [(10.0 * number, 20.0)] for number in range(12)]
    assert list(map(len, linked(frames, 1.25))) == [11]


def test_pause_of_a_recording_is_no_missing_frame() -> None:
    """What comes a minute later, where the car would be by now, is another object."""
    linker, over = Linker(), []
    for number, stamp_s in enumerate([*np.arange(0.0, 4.0, 0.2), *np.arange(64.0, 68.0, 0.2)]):
        sighting = replace(seen(0, (0.1 * stamp_s, 20.0)), stamp_s=stamp_s, frame_s=stamp_s)
        over += linker.add(number, stamp_s, [sighting], Settings(), 600.0)
    assert [len(live.kept) for live in over + linker.rest(Settings().track)] == [20, 20]
