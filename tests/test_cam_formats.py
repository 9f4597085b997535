"""The demonstration's log in every format that CAMs are recorded in calibrates its camera alike."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest

from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.cloud import PointCloud, PointCloudSource
from laci_stereo.core.frames import Axes, FloatArray, invert, transform
from laci_stereo.core.messages.cam import CamLog
from laci_stereo.core.result import Calibration
from laci_stereo.io.cam.log import read_cam_log
from laci_stereo.run import prepare
from tests.cli_support import DEMONSTRATION
from tests.io.cam.test_cam_log import COMPLETE, POSITIONS, assert_same_track

pytestmark = pytest.mark.slow

UNKNOWN = {"semi_major_95_m": 40.95, "semi_minor_95_m": 40.95, "ellipse_orientation_deg": 360.1}
"""ETSI's codes for what the demonstration's messages do not tell."""


@dataclass(frozen=True)
class Kept:
    """The point clouds of a recording, matched once (implements `PointCloudSource`)."""

    axes: Axes
    span_ns: tuple[int, int]
    frames: list[PointCloud]
    looks: list[PointCloud]

    @classmethod
    def of(cls, source: PointCloudSource) -> Kept:
        return cls(source.axes, source.span_ns, list(source), list(source.survey()))

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> Iterator[PointCloud]:
        return iter(self.frames)

    def survey(self) -> Iterator[PointCloud]:
        return iter(self.looks)


class Recorded:
    """Its log, and what a log makes of its images."""

    log: CamLog = read_cam_log(DEMONSTRATION / "cam.csv").log

    @cached_property
    def clouds(self) -> Kept:
        return Kept.of(prepare(*(DEMONSTRATION / name for name in ("left", "right", "cam.csv"))).recording)

    def calibrated(self, log: CamLog) -> Calibration:
        return calibrate(self.clouds, log)

    @cached_property
    def plain(self) -> Calibration:
        return self.calibrated(self.log)

    def written(self, write: Callable[[Path, CamLog], Path], folder: Path) -> CamLog:
        told = {name: np.full(len(self.log), value) for name, value in UNKNOWN.items()}
        return read_cam_log(write(folder, replace(self.log, **told))).log


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    return Recorded()


@pytest.mark.parametrize("form", COMPLETE)
def test_whatever_carries_all_of_a_log_gives_the_same_calibration(
    recorded: Recorded, form: str, tmp_path: Path
) -> None:
    log = recorded.written(COMPLETE[form], tmp_path)
    assert_same_track(log, recorded.log)
    found = recorded.calibrated(log)
    assert abs(found.drive.time_offset_s - recorded.plain.drive.time_offset_s) < 1e-3
    assert np.linalg.norm(off(recorded, found), axis=1).max() < 1e-3


@pytest.mark.parametrize("form", POSITIONS)
def test_a_receivers_positions_calibrate_alike_within_the_doubt(recorded: Recorded, form: str, tmp_path: Path) -> None:
    """They lack the vehicle's size, which is added, and some lack its heading or tell other accuracies."""
    log = recorded.written(POSITIONS[form], tmp_path)
    assert_same_track(log, recorded.log)
    found = recorded.calibrated(replace(log, length_m=recorded.log.length_m, width_m=recorded.log.width_m))
    squares = np.sum(off(recorded, found)[:, :2] ** 2, axis=1)
    assert np.sqrt(np.mean(squares)) < found.quality.track_xy_sigma_m


def off(recorded: Recorded, found: Calibration) -> FloatArray:
    """Return by how much a calibration misplaces what the plain one puts on the vehicle's way, shape (n, 3)."""
    plain, log = recorded.plain, recorded.log
    xy = plain.world.from_geodetic(log.latitude_deg, log.longitude_deg)
    points_sensor = transform(invert(plain.T_world_sensor), np.column_stack([xy, np.zeros(len(xy))]))
    return transform(found.T_utm_sensor, points_sensor) - transform(plain.T_utm_sensor, points_sensor)
