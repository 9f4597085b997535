"""What a sensor saw: the road is looked for in what stands, whatever a mask takes for vehicles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.frames import BoolArray, transform
from laci_stereo.core.observe import observe
from tests.simulated import LEFT_TURN, Drive, Mover, Recording, lidar, pedestrian, scene

WALKER = pedestrian(Drive((24.0, 6.0), -90.0, speeds=((0.0, 1.4),)))


class Masked(Recording):
    """A recording whose last mover is none of the mask's vehicles."""

    def __iter__(self) -> Iterator[PointCloud]:
        for index in range(len(self)):
            cloud = self.frame(index)
            walks = self.near(self.movers[-1], index, cloud, 0.6)
            yield replace(cloud[~walks], others=cloud[walks])

    def near(self, mover: Mover, index: int, cloud: PointCloud, within_m: float) -> BoolArray:
        xy, _ = mover.drive.at(self.times_s[[index]])
        points = transform(self.T_world_sensor, cloud.points)
        found: BoolArray = np.linalg.norm(points[:, :2] - xy, axis=1) < within_m
        return found


@pytest.mark.slow
def test_what_a_mask_leaves_out_is_no_road() -> None:
    made = scene(LEFT_TURN, lidar(), others=(WALKER,)).recording
    recording = Masked(made.sensor, made.T_world_sensor, made.static, made.movers, made.times_s)
    whole, masked = observe(made), observe(recording)
    indices = [made.stamps_ns.index(cloud.stamp_ns) for cloud in masked.survey]
    walks = [
        int(recording.near(recording.movers[-1], index, cloud, 0.4).sum())
        for index, cloud in zip(indices, masked.survey, strict=True)
    ]
    assert sum(count > 10 for count in walks) > 3
    for index, cloud, without in zip(indices, masked.standing, whole.standing, strict=True):
        assert not recording.near(recording.movers[-1], index, cloud, 0.4).any()
        assert len(cloud) == len(without)
