"""A recording with a mask: the survey stays whole, and of what moves the vehicle's points stay."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.frames import FloatArray
from laci_stereo.io.images import StereoPair
from laci_stereo.mask.detect import Vehicle
from laci_stereo.mask.picture import Crop
from laci_stereo.mask.stage import VehicleMask
from laci_stereo.stereo.recording import StereoRecording
from tests.stereo.render import Box
from tests.stereo.rigs import RIGS
from tests.stereo.support import FAR, NEAR, STATIC, exposed, off_surfaces, standing, truth, views, write_pairs

MOVERS: tuple[Box | None, ...] = (None, NEAR, None, None, FAR, None, None)
WALKER = Box(17.0, -5.5, length_m=0.5, width_m=0.6, height_m=1.8, seed=5, grey=190.0)
"""Who is there when a mover is, and behind one of them."""


class TrueBoxes:
    """Finds what moves where it truly is in the rectified image."""

    slots, least_px = 2, 64
    runs, seconds = 0, 0.0

    def __init__(self, name: str, pairs: Sequence[StereoPair], shift: int = 0) -> None:
        self.seen: list[Crop] = []
        self.boxes = {
            pair.stamp_ns: true_box(name, mover) + shift
            for pair, mover in zip(pairs, MOVERS, strict=True)
            if mover is not None
        }

    def find(self, crops: Sequence[Crop]) -> list[tuple[Vehicle, ...]]:
        self.seen += crops
        return [(Vehicle(self.boxes[crop.stamp_ns], 0.9, 2),) for crop in crops]


def true_box(name: str, mover: Box) -> FloatArray:
    v, u = np.nonzero(truth(name, (*STATIC, WALKER, mover)).owner == len(STATIC) + 2)
    return np.array([u.min(), v.min(), u.max() + 1, v.max() + 1], dtype=np.float64)


def frames(name: str, folder: Path, **options: object) -> list[StereoPair]:
    seen = [views(name) if mover is None else views(name, mover, (*STATIC, WALKER)) for mover in MOVERS]
    return write_pairs(folder, exposed(seen, **options))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "colour"), [("ideal", True), pytest.param("mirrored askew", False, marks=pytest.mark.slow)]
)
def test_the_vehicle_stays_in_grey_and_in_colour(name: str, colour: bool, tmp_path: Path) -> None:
    pairs = frames(name, tmp_path, colour=colour)
    finder = TrueBoxes(name, pairs)
    masked = StereoRecording(pairs, RIGS[name], mask=VehicleMask(finder, "truth"))
    plain = list(StereoRecording(pairs, RIGS[name]))
    for cloud, whole, mover in zip(masked, plain, MOVERS, strict=True):
        assert cloud.stamp_ns == whole.stamp_ns
        if mover is None:
            assert len(cloud) == 0
            continue
        assert len(cloud) < len(whole)
        of_walker = [only_on(WALKER, mover, some) for some in (whole, cloud)]
        assert of_walker[0] > 100
        assert of_walker[1] < 0.1 * of_walker[0]
        assert on_mover(cloud, mover) > 0.9 * on_mover(whole, mover)
        assert on_mover(cloud, mover) / len(cloud) > on_mover(whole, mover) / len(whole)
    assert {crop.image.dtype for crop in finder.seen} == {np.dtype(np.uint8)}
    for stamp_ns, box in finder.boxes.items():
        seen = [crop for crop in finder.seen if crop.stamp_ns == stamp_ns]
        assert any(holds(crop, box) for crop in seen)
    assert {crop.stamp_ns for crop in finder.seen} == set(finder.boxes)


def holds(crop: Crop, box: FloatArray) -> bool:
    first = np.array([crop.x0, crop.y0])
    return bool((first <= box[:2]).all() and (box[2:] <= first + crop.size).all())


def on_mover(cloud: PointCloud, mover: Box) -> int:
    """Count the points on the box, above the road."""
    return int((off_surfaces(standing(cloud), [mover]) < 3).sum())


def only_on(one: Box, other: Box, cloud: PointCloud) -> int:
    """Count the points on one box, above the road, that are not on another."""
    points = standing(cloud)
    return int(((off_surfaces(points, [one]) < 3) & (off_surfaces(points, [other]) > 3)).sum())


@pytest.mark.slow
def test_the_survey_is_the_same_as_without(tmp_path: Path) -> None:
    pairs = frames("ideal", tmp_path)
    masked = StereoRecording(pairs, RIGS["ideal"], mask=VehicleMask(TrueBoxes("ideal", pairs), "truth"))
    for one, other in zip(masked.survey(), StereoRecording(pairs, RIGS["ideal"]).survey(), strict=True):
        np.testing.assert_array_equal(one.points, other.points)


def test_what_the_mask_did_can_be_drawn(tmp_path: Path) -> None:
    pairs = frames("ideal", tmp_path)
    recording = StereoRecording(pairs, RIGS["ideal"], mask=VehicleMask(TrueBoxes("ideal", pairs), "truth"))
    list(recording)
    drawn = recording.mask_rays(pairs[1].stamp_ns)
    assert drawn is not None
    plane = recording.rectification
    [outline] = drawn.outlines
    x0, y0, x1, y1 = true_box("ideal", NEAR).astype(int)
    np.testing.assert_allclose(outline[0], plane.rays[y0, x0], atol=1e-9)
    np.testing.assert_allclose(outline[2], plane.rays[y1, x1], atol=1e-9)
    assert len(drawn.kept)
    assert len(drawn.dropped)
    empty = recording.mask_rays(pairs[0].stamp_ns)
    assert empty is not None
    assert empty.outlines == ()
    assert StereoRecording(pairs, RIGS["ideal"]).mask_rays(pairs[1].stamp_ns) is None
