"""Parts of one vehicle are one passage, and two vehicles are two, however near each other they drive."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.settings import Settings
from laci_stereo.core.tracking.box import Box
from laci_stereo.core.tracking.sighting import Sighting
from laci_stereo.monitor.checkpoint import State, read_state, write_state
from laci_stereo.monitor.linking import Linker
from laci_stereo.monitor.passage import Passage, passage_of
from laci_stereo.monitor.settings import MonitorSettings

PERIOD_S = 0.1
SPACING_M = 0.03
"""Between the points of a side."""

LANE_M, GAP_M = 3.0, 1.0
"""From the middle of a lane to that of the next, and from bumper to bumper in a queue."""

FLANK = (-1.2, 1.0)
"""Where nothing is seen on a broken car, ahead of its centre: its parts are more than half a car apart."""


@dataclass(frozen=True)
class Road:
    """A straight road past the sensor, which is the origin, in the direction ``yaw_rad``; x = 0 is half of its way."""

    yaw_rad: float
    middle: tuple[float, float]


ROADS = {
    "across": Road(0.0, (0.0, 20.0)),
    "oblique": Road(np.radians(40.0), (4.0, 26.0)),
    "away": Road(np.radians(85.0), (3.0, 35.0)),
}


@dataclass(frozen=True)
class Vehicle:
    """A vehicle on a road: where its centre is in the middle of the recording, metres, and how it drives there.

    Attributes
    ----------
    ahead_m, left_m : float
    speed_mps : float
        Along the road; negative against its direction.
    length_m, width_m : float
    """

    ahead_m: float = 0.0
    left_m: float = 0.0
    speed_mps: float = 8.0
    length_m: float = 4.5
    width_m: float = 1.8

    def outline(self, road: Road, from_middle_s: float, hidden: tuple[float, float] | None = None) -> list[FloatArray]:
        """Return the sides that face the sensor, level frame: in one part, or in two beside what is hidden."""
        half = np.array([self.length_m, self.width_m]) / 2
        centre = np.array([self.ahead_m + self.speed_mps * from_middle_s, self.left_m])
        sensor = rotate_xy(-road.yaw_rad, -np.array(road.middle)) - centre
        near = np.sign(sensor) * half
        flank, face = np.arange(-half[0], half[0], SPACING_M), np.arange(-half[1], half[1], SPACING_M)
        sides = np.concatenate(
            [
                np.column_stack([flank, np.full(len(flank), near[1])]),
                np.column_stack([np.full(len(face), near[0]), face]),
            ]
        )
        parts = [sides] if hidden is None else [sides[sides[:, 0] < hidden[0]], sides[sides[:, 0] > hidden[1]]]
        return [np.array(road.middle) + rotate_xy(road.yaw_rad, centre + part) for part in parts]


def sighting(outline: FloatArray, stamp_s: float, sigma_m: float, chance: np.random.Generator) -> Sighting:
    sight = outline / np.linalg.norm(outline, axis=1)[:, None]
    noise = np.clip(chance.standard_normal(len(outline)), -2.5, 2.5)  # outliers are left out by their density
    xy = outline + sight * (sigma_m * noise)[:, None]
    middle, noises = np.median(xy, axis=0), np.full(len(xy), sigma_m)
    points, count = np.column_stack([xy, np.ones(len(xy))]), 10 * len(xy)
    return Sighting(stamp_s, stamp_s, points, noises, noises, count, middle, Box(middle, 4.0, 1.8, 0.0), None, sigma_m)


def passages(
    road: Road,
    sigma_m: float,
    *vehicles: Vehicle,
    broken: Callable[[int], bool] = lambda _: False,
    joined: Callable[[int], bool] = lambda _: False,
    frames: int = 60,
    after_frame: Callable[[int, Linker], Linker] = lambda _, linker: linker,
) -> list[Passage]:
    """Return the passages of vehicles that are broken, or whose outlines run together, in these frames."""
    chance, linker, over = np.random.default_rng(3), Linker(), []
    for number in range(frames):
        now_s = PERIOD_S * number
        hidden = FLANK if broken(number) else None
        outlines = [part for one in vehicles for part in one.outline(road, now_s - PERIOD_S * frames / 2, hidden)]
        if joined(number):
            outlines = [np.concatenate(outlines)]
        seen = [sighting(outline, now_s, sigma_m, chance) for outline in outlines]
        over += linker.add(number, now_s, seen, Settings(), 60.0)
        linker = after_frame(number, linker)
    found: Sequence[Passage | None] = [
        passage_of(live.kept, np.zeros(2), Settings().track, MonitorSettings())
        for live in over + linker.rest(Settings().track)
    ]
    return [one for one in found if one is not None]


every_view = pytest.mark.parametrize("road", ROADS.values(), ids=ROADS)
NOISES_M = (0.02, 0.15, 0.4)
every_noise = pytest.mark.parametrize("sigma_m", NOISES_M)
FEW = (("across", 0.02), ("oblique", 0.4), ("away", 0.15))

BREAKS = {
    "for a second": lambda number: 25 <= number < 37,
    "again and again": lambda number: 10 <= number < 50 and number % 5 < 3,
    "at first": lambda number: number < 35,
    "at last": lambda number: number >= 25,
}


@pytest.mark.parametrize("sigma_m", [0.02, 0.15])
@pytest.mark.parametrize("broken", BREAKS.values(), ids=BREAKS)
def test_parts_of_a_car_are_one_passage_at_the_place_of_the_car(broken: Callable[[int], bool], sigma_m: float) -> None:
    road, car = ROADS["across"], Vehicle()
    (found,) = passages(road, sigma_m, car, broken=broken)
    assert found.frames.tolist() == list(range(60))
    assert found.length_m == pytest.approx(car.length_m, abs=0.2 + sigma_m)
    truth = np.array(road.middle) + np.column_stack([car.speed_mps * (found.stamps_s - 3.0), np.zeros(60)])
    assert np.abs(found.centres - truth).max() < 0.2 + 2 * sigma_m


@pytest.mark.parametrize("broken", BREAKS.values(), ids=BREAKS)
def test_parts_of_a_car_seen_obliquely_are_one_passage(broken: Callable[[int], bool]) -> None:
    (found,) = passages(ROADS["oblique"], 0.1, Vehicle(), broken=broken)
    assert found.length_m == pytest.approx(4.5, abs=0.3)


def test_parts_are_one_passage_across_checkpoints(tmp_path: Path) -> None:
    def resumed(number: int, linker: Linker) -> Linker:
        if number % 10:
            return linker
        write_state(tmp_path / "state.json", State({}, linker=linker))
        return read_state(tmp_path / "state.json", Settings().track).linker

    road, broken = ROADS["across"], BREAKS["again and again"]
    (through,) = passages(road, 0.1, Vehicle(), broken=broken)
    (again,) = passages(road, 0.1, Vehicle(), broken=broken, after_frame=resumed)
    assert np.array_equal(again.centres, through.centres)
    assert (again.length_m, again.width_m) == (through.length_m, through.width_m)


@pytest.mark.parametrize(
    ("road", "sigma_m"),
    [
        pytest.param(road, sigma_m, marks=[] if (name, sigma_m) in FEW else pytest.mark.slow, id=f"{name}-{sigma_m}")
        for name, road in ROADS.items()
        for sigma_m in NOISES_M
    ],
)
def test_neighbours_are_two_passages(road: Road, sigma_m: float) -> None:
    car, lorry = Vehicle(), Vehicle(length_m=16.5, width_m=2.5)
    behind = (car.length_m + lorry.length_m) / 2 + GAP_M
    neighbours = {
        "abreast": (car, Vehicle(left_m=LANE_M)),
        "in a queue": (car, Vehicle(-car.length_m - GAP_M)),
        "two of the shortest": (Vehicle(length_m=2.7), Vehicle(-2.7 - GAP_M, length_m=2.7)),
        "overtaking": (car, Vehicle(left_m=LANE_M, speed_mps=11.0)),
        "oncoming": (car, Vehicle(left_m=LANE_M, speed_mps=-8.0)),
        "lorry with trailer, car behind": (lorry, Vehicle(-behind)),
        "lorry with trailer, car beside": (lorry, Vehicle(left_m=LANE_M)),
        "cyclist behind": (car, Vehicle(-car.length_m / 2 - GAP_M - 0.9, length_m=1.8, width_m=0.6)),
    }
    for name, (one, other) in neighbours.items():
        assert len(passages(road, sigma_m, one, other)) == 2, name


@every_noise
@every_view
def test_queue_that_runs_together_for_half_of_the_time_is_not_one_car(road: Road, sigma_m: float) -> None:
    """Where two cars are seen as one, that is as long as both; but no car is."""
    queue = Vehicle(), Vehicle(-4.5 - GAP_M)
    assert len(passages(road, sigma_m, *queue, joined=lambda number: number >= 30)) >= 2
