"""The stage: every frame comes out in order, and what the mask did is counted and said."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from laci_stereo.mask.detect import Vehicle
from laci_stereo.mask.errors import MaskError
from laci_stereo.mask.picture import Crop
from laci_stereo.mask.stage import MOST_WAITING, VehicleMask
from tests.mask.test_apply import CAR, HALF_WINDOW, OTHER_CAR, WALKER, Patch, box, moving, within


class Fixed:
    """Finds the same in every crop, except in those of some frames."""

    least_px = 32

    def __init__(self, vehicles: Sequence[Vehicle], slots: int = 3, blind: Sequence[int] = ()) -> None:
        self.vehicles, self.slots, self.blind = tuple(vehicles), slots, set(blind)
        self.runs, self.seconds, self.most = 0, 0.0, 0

    def find(self, crops: Sequence[Crop]) -> list[tuple[Vehicle, ...]]:
        self.runs += 1
        self.most = max(self.most, len(crops))
        return [() if crop.stamp_ns in self.blind else self.vehicles for crop in crops]


def frame(stamp_ns: int, *patches: Patch):  # type: ignore[no-untyped-def]
    seen = moving(*patches)
    crop = Crop(stamp_ns, 0, 0, np.zeros((300, 500, 3), dtype=np.uint8))
    return replace(seen, cloud=replace(seen.cloud, stamp_ns=stamp_ns), crops=(crop,))


def test_frames_come_out_in_order_and_the_empty_ones_too() -> None:
    frames = [number if number % 3 else frame(number, CAR, WALKER) for number in range(20)]
    finder = Fixed([box(CAR)])
    clouds = list(VehicleMask(finder, "net").apply(frames, HALF_WINDOW))
    assert [cloud.stamp_ns for cloud in clouds] == list(range(20))
    expected = int(within(moving(CAR, WALKER), CAR).sum())
    assert [len(cloud) for cloud in clouds] == [0 if number % 3 else expected for number in range(20)]
    assert finder.most == 3


def test_what_is_dropped_goes_along_as_what_else_moves() -> None:
    (cloud,) = VehicleMask(Fixed([box(CAR)]), "net").apply([frame(0, CAR, WALKER)], HALF_WINDOW)
    whole = moving(CAR, WALKER)
    assert cloud.others is not None
    assert cloud.others.points.tolist() == whole.cloud.points[~within(whole, CAR)].tolist()


def test_few_frames_wait_for_the_network() -> None:
    frames = iter(range(10 * MOST_WAITING))
    next(VehicleMask(Fixed([]), "net").apply(frames, HALF_WINDOW))
    assert next(frames) <= MOST_WAITING


def test_a_frame_without_a_vehicle_falls_back_and_is_counted() -> None:
    stage = VehicleMask(Fixed([box(CAR)], blind=[1]), "net")
    clouds = list(stage.apply([frame(number, CAR, WALKER) for number in range(3)], HALF_WINDOW))
    everything = len(moving(CAR, WALKER).cloud)
    assert [len(cloud) == everything for cloud in clouds] == [False, True, False]
    tally = stage.tally
    assert (tally.frames, tally.fallback, tally.vehicles) == (3, 1, 2)
    assert tally.kept == sum(map(len, clouds))
    assert tally.kept + tally.dropped == 3 * everything
    assert tally.warning is None
    assert any("in 1 of them it found none" in sentence for sentence in tally.sentences())


def test_a_mask_that_finds_nothing_is_warned_of_with_reasons(caplog: pytest.LogCaptureFixture) -> None:
    stage = VehicleMask(Fixed([]), "net.onnx")
    with caplog.at_level(logging.WARNING):
        clouds = list(stage.apply([frame(number, CAR) for number in range(6)], HALF_WINDOW))
    assert all(len(cloud) == len(moving(CAR).cloud) for cloud in clouds)
    for word in ("net.onnx", "6 of 6 frames", "colours", "scale", "class ids"):
        assert word in caplog.text
        assert word in str(stage.tally.warning)


def test_disagreements_are_counted() -> None:
    stage = VehicleMask(Fixed([box(CAR, dx=20), box(OTHER_CAR)]), "net")
    list(stage.apply([frame(0, CAR)], HALF_WINDOW))
    assert (stage.tally.grown, stage.tally.at_rest) == (1, 1)
    crops = (Crop(0, 0, 0, np.zeros((9, 9, 3), np.uint8)), Crop(1, 0, 0, np.zeros((9, 9, 3), np.uint8)))
    two = replace(frame(0, CAR, WALKER), crops=crops)
    other = VehicleMask(Fixed([box(CAR)], blind=[1]), "net")
    list(other.apply([two], HALF_WINDOW))
    assert other.tally.unmasked == 1
    assert sum("disagree" in sentence for sentence in stage.tally.sentences()) == 2


def test_a_mask_that_fills_all_crops_is_refused() -> None:
    whole = Vehicle(np.array([0.0, 0.0, 500.0, 300.0]), 0.9, 2)
    stage = VehicleMask(Fixed([whole]), "net.onnx")
    with pytest.raises(MaskError, match=r"net\.onnx: marks all of 6 of 6 crops"):
        list(stage.apply([frame(number, CAR) for number in range(6)], HALF_WINDOW))


def test_a_second_pass_counts_anew() -> None:
    stage = VehicleMask(Fixed([box(CAR)]), "net")
    for _ in range(2):
        list(stage.apply([frame(number, CAR) for number in range(4)], HALF_WINDOW))
        assert (stage.tally.frames, stage.tally.crops, stage.tally.runs) == (4, 4, 2)
