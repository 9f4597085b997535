"""What a sensor saw: the road is looked for in what stands, whatever a mask takes for vehicles."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.frames import BoolArray, transform
from laci_stereo.core.messages.cam import FRONT
from laci_stereo.core.messages.stations import senders_of
from laci_stereo.core.observe import AROUND_S, Observation, observe
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


def test_points_are_kept_around_messages_only() -> None:
    """In an hour of traffic, of which a sender drives for a minute, those of all others would take gigabytes."""
    made = scene(LEFT_TURN, lidar(32, 180), last_s=2.0)
    (driven,) = senders_of(made.messages, made.recording.span_ns, FRONT, None, 0.01).vehicles.values()
    always, near, far = (
        observe(made.recording, vehicles=None if late_s is None else {1: replace(driven, stamps_s=late_s + times_s)})
        for times_s in [driven.stamps_s]
        for late_s in (None, AROUND_S - 1.0, AROUND_S + 5.0)
    )
    assert max(points_of(always)) > 10
    assert points_of(near) == points_of(always)
    assert max(points_of(far)) == 10
    boxes = [[one.box.centre for track in seen.tracks for one in track.sightings] for seen in (always, far)]
    np.testing.assert_array_equal(*boxes)


def points_of(seen: Observation) -> list[int]:
    return [len(one.points) for track in seen.tracks for one in track.sightings]
