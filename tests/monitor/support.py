"""A crossroads' traffic, minute after minute, with its exact truth: short drives one after the other, as frames."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.frames import FloatArray, IntArray
from laci_stereo.core.world import World
from laci_stereo.io.maps.lane_map import LaneMap
from laci_stereo.io.maps.lanelets import lane_between
from laci_stereo.monitor.lanes import Strip, strips_of
from laci_stereo.monitor.run import Monitor, Plan
from laci_stereo.monitor.settings import MonitorSettings
from tests.simulated import EPOCH_NS, HOUSES, Drive, Mover, Recording, Sensor, car, lidar, mounted

HZ = 10.0
EPISODE_S = 5.0
FINE, COARSE = lidar(32, 180), lidar(24, 100)
LANE_X = 22.0
EAST = np.array([1.75, 0.0])
"""Half of a lane's width."""
WORLD = World("EPSG:32632", (570000.0, 5364000.0), 0.9996)


def lane(from_y: float = 40.0, to_y: float = -40.0, *, one_way: bool = True) -> Strip:
    """A lane from north to south, across the view of a sensor that looks east."""
    south = np.array([[LANE_X, from_y], [LANE_X, to_y]])
    found = lane_between("1", south + EAST, south - EAST, one_way=one_way)
    assert found is not None
    (strip,) = strips_of(LaneMap((), ()), [found], 2.4)
    return strip


def drive(left_m: float = 0.0, speed_mps: float = 9.0, *, against: bool = False) -> Drive:
    """Through the lane's whole visible part, so far to the left of its middle, or against its direction."""
    start = (LANE_X + left_m, 22.0 if not against else -22.0)
    return Drive(start, -90.0 if not against else 90.0, speeds=((0.0, speed_mps),))


@dataclass(frozen=True)
class Traffic:
    """Episodes of some seconds, each with its movers (implements `Frames`)."""

    episodes: tuple[tuple[Mover, ...], ...]
    sensor: Sensor
    killed_at: int | None = None
    identity_: str = "first"
    hz: float = HZ
    uri = "simulated"

    @property
    def T_world_sensor(self) -> FloatArray:
        return mounted(self.sensor, (0.0, 0.0), 6.0, 0.0, 14.0, 1.5)

    @cached_property
    def _recordings(self) -> list[Recording]:
        times = np.arange(0.0, EPISODE_S, 1.0 / self.hz)
        return [
            Recording(self.sensor, self.T_world_sensor, HOUSES, movers, times, seed)
            for seed, movers in enumerate(self.episodes)
        ]

    @property
    def stamps_ns(self) -> IntArray:
        count = len(self.episodes) * round(EPISODE_S * self.hz)
        stamps: IntArray = EPOCH_NS + (np.arange(count) * (1e9 / self.hz)).round().astype(np.int64)
        return stamps

    @property
    def identity(self) -> dict[str, str]:
        return {"first scan": self.identity_}

    def refresh(self, whole: int) -> None:
        """It is all there."""

    def learn(self, frames: range) -> Seen:
        return Seen(self, frames)

    def frame(self, number: int) -> PointCloud:
        if number == self.killed_at:
            raise Killed
        episode, index = divmod(number, round(EPISODE_S * self.hz))
        cloud = self._recordings[episode].frame(index)
        return PointCloud(
            int(self.stamps_ns[number]), cloud.points, cloud.sigma_along_m, cloud.sigma_across_m, cloud.at_edge
        )


class Killed(BaseException):
    """The process is gone."""


@dataclass
class Seen:
    """What some of its frames show (implements `Scene`)."""

    traffic: Traffic
    frames: range
    unusable: int = 0

    def survey(self) -> Iterator[PointCloud]:
        return (self.traffic.frame(number) for number in self.frames[:: max(1, len(self.frames) // 10)])

    def section(self, frames: range) -> Iterator[PointCloud]:
        return map(self.traffic.frame, frames)


def plan(traffic: Traffic, *strips: Strip, **changes: float) -> Plan:
    settings = MonitorSettings(**{"block_s": 20.0, "section_frames": 25, **changes})  # type: ignore[arg-type]
    return Plan(WORLD, traffic.T_world_sensor, strips or (lane(),), {"calibration": "a"}, settings=settings)


def traffic(*movers: Sequence[Mover], sensor: Sensor | None = None) -> Traffic:
    return Traffic(tuple(tuple(one) for one in movers), sensor or FINE)


def one_by_one(*drives: Drive, sensor: Sensor | None = None) -> Traffic:
    """One car after the other, each alone in view."""
    return traffic(*((car(one),) for one in drives), sensor=sensor)


def gone_through(source: Traffic, asked: Plan, out: Path) -> Monitor:
    """Run a monitor to its end."""
    out.mkdir(exist_ok=True)
    monitor = Monitor(source, asked, out)
    monitor.refresh()
    monitor.check()
    while monitor.step(ended=True):
        pass
    monitor.finish()
    return monitor
