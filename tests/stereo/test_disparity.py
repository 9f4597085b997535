"""Matching: against the truth of rendered scenes, and its laws."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest

from laci_stereo.core.errors import RigError
from laci_stereo.core.frames import BoolArray, FloatArray, Raster
from laci_stereo.stereo.disparity import Disparity, Region, check_matched, match
from laci_stereo.stereo.settings import StereoSettings
from tests.stereo.render import NOTHING, ROAD, Box, expose
from tests.stereo.rigs import RIGS
from tests.stereo.support import FAR, NEAR, STATIC, Truth, rectification, robust_std, truth, views

SETTINGS = StereoSettings()
LARGEST = 31
every_rig = pytest.mark.parametrize("name", RIGS)


@dataclass(frozen=True)
class Matched:
    left: Raster
    right: Raster
    disparity: Disparity
    truth: Truth

    @property
    def kept(self) -> BoolArray:
        kept: BoolArray = np.isfinite(self.disparity.values)
        return kept

    @property
    def error(self) -> FloatArray:
        error: FloatArray = self.disparity.values - self.truth.disparity
        return error


def cut_out(left: Raster, right: Raster, region: Region) -> list[Raster]:
    """Return a region of both images with the context that it needs."""
    start = region.x0 - region.reach
    parts = [image[region.y0 : region.y1, max(start, 0) : region.x1] for image in (left, right)]
    return [cv2.copyMakeBorder(part, 0, 0, max(-start, 0), 0, cv2.BORDER_REPLICATE) for part in parts]


def match_region(left: Raster, right: Raster, region: Region) -> Disparity:
    return match(*cut_out(left, right, region), region, SETTINGS)


def whole(image: Raster, smallest: int = 0, largest: int = LARGEST) -> Region:
    height, width = image.shape
    return Region(0, 0, width, height, smallest, largest)


@lru_cache(maxsize=16)
def matched(name: str, mover: Box = NEAR) -> Matched:
    rng = np.random.default_rng(0)
    plane = rectification(name)
    left, right = (
        side.look_up(expose(view, rng))
        for side, view in zip((plane.left, plane.right), views(name, mover), strict=True)
    )
    return Matched(left, right, match_region(left, right, whole(left)), truth(name, (*STATIC, mover)))


def usable(name: str, found: Matched) -> BoolArray:
    """Where both cameras see the same point inside of their images, whatever stands about."""
    plane = rectification(name)
    height, width = found.left.shape
    u_right = np.rint(np.arange(width) - found.truth.disparity).astype(int).clip(0, width - 1)
    both: BoolArray = plane.left.inner & plane.right.inner[np.arange(height)[:, None], u_right] & found.truth.seen
    return both


@every_rig
def test_disparity_is_unbiased_and_its_sigma_is_honest(name: str) -> None:
    found = matched(name)
    there = usable(name, found)
    for owner in (ROAD, 1, 3):
        mine = found.kept & there & (found.truth.owner == owner)
        error, sigma = found.error[mine], found.disparity.sigma[mine]
        assert mine.sum() > 0.7 * (there & (found.truth.owner == owner)).sum()
        assert abs(np.median(error)) < 0.03
        assert abs(error[np.abs(error) < 2].mean()) < 0.05
        # A rendered rig is perfect, so the floor that real ones need is most of sigma here.
        assert 0.2 < robust_std(error / sigma) < 1.3
        assert np.mean(np.abs(error) > 3 * sigma) < 0.04


@every_rig
def test_what_cannot_be_matched_is_dropped_and_not_filled(name: str) -> None:
    found = matched(name)
    inside = usable(name, found) | ~found.truth.seen
    shown = found.kept & inside & (found.truth.owner != NOTHING)
    assert np.mean(np.abs(found.error[shown]) > 2) < 0.02
    hidden = inside & ~found.truth.seen & (found.truth.owner != NOTHING)
    assert found.kept[hidden].mean() < 0.5


def test_the_noise_of_the_images_is_in_sigma() -> None:
    plain = StereoSettings(disparity_floor_px=0.0, max_disparity_sigma_px=1.0)
    for noise in (2.0, 6.0):
        rng = np.random.default_rng(1)
        left, right = (expose(view, rng, noise=noise) for view in views("ideal", NEAR))
        region = whole(left)
        disparity = match(*cut_out(left, right, region), region, plain)
        known = truth("ideal", (*STATIC, NEAR))
        wall = np.isfinite(disparity.values) & (known.owner == 1)
        error = (disparity.values - known.disparity)[wall]
        assert 0.8 < robust_std(error / disparity.sigma[wall]) < 1.4


@pytest.mark.parametrize("fraction", [0.0, 0.25, 0.5, 0.75])
@pytest.mark.parametrize("wavelength_px", [4.0, 8.0])
def test_no_fraction_of_a_pixel_is_preferred(fraction: float, wavelength_px: float) -> None:
    finer = 8
    rng = np.random.default_rng(3)
    noise = rng.normal(size=(100, 240 * finer)).astype(np.float32)
    texture = cv2.GaussianBlur(noise, (0, 0), sigmaX=wavelength_px * finer / 4, sigmaY=wavelength_px / 4)
    texture = 110 + 25 * texture / texture.std()
    shift = 10 + fraction
    first = int(shift * finer)
    left, right = texture[:, : -first or None : finer], texture[:, first::finer]
    width = min(left.shape[1], right.shape[1])
    left, right = (
        np.clip(np.rint(part[:, :width] + rng.normal(size=(100, width))), 0, 255).astype(np.uint8)
        for part in (left, right)
    )
    disparity = match_region(left, right, whole(left)).values[10:-10, 30:-10]
    assert np.isfinite(disparity).mean() > 0.95
    assert np.nanmean(disparity) == pytest.approx(shift, abs=0.02)


def test_hardly_anything_is_strewn_between_a_box_and_what_is_behind() -> None:
    found = matched("ideal", FAR)
    near_by = [np.roll(found.truth.disparity, shift, (0, 1)) for shift in product(range(-3, 4), repeat=2)]
    missed = np.min([np.abs(found.disparity.values - disparity) for disparity in near_by], axis=0)
    box = cv2.dilate((found.truth.owner == 3).astype(np.uint8), np.ones((11, 11), np.uint8)) > 0
    kept = box & found.kept
    assert np.mean(missed[kept] > 3 * found.disparity.sigma[kept]) < 0.03


def test_without_texture_there_is_no_disparity() -> None:
    rng = np.random.default_rng(0)
    left, right = (np.rint(rng.normal(120, 1.5, (120, 200))).astype(np.uint8) for _ in range(2))
    assert np.isfinite(match_region(left, right, whole(left)).values).mean() < 0.01


def test_what_is_saturated_has_no_disparity() -> None:
    left, right = matched("ideal").left.copy(), matched("ideal").right.copy()
    left[150:200, 100:200] = right[150:200, 80:180] = 255
    values = match_region(left, right, whole(left)).values
    assert not np.isfinite(values[154:196, 104:196]).any()


@pytest.mark.parametrize("name", ["ideal", "askew"])
@pytest.mark.parametrize(
    "region",
    [Region(120, 80, 280, 200, 0, 31), Region(0, 60, 140, 220, 0, 31), Region(150, 100, 260, 190, 5, 28)],
    ids=["inside", "left border", "from a smallest disparity"],
)
def test_a_region_is_matched_as_in_the_whole(name: str, region: Region) -> None:
    found = matched(name)
    part = match_region(found.left, found.right, region)
    inner = (slice(12, -12), slice(0 if region.x0 == 0 else 12, -12))
    values = part.values[inner]
    same = found.disparity.values[region.y0 : region.y1, region.x0 : region.x1][inner]
    both = np.isfinite(values) & np.isfinite(same)
    assert both.sum() > 0.95 * np.isfinite(same).sum()
    apart = np.abs((values - same)[both])
    assert np.mean(apart > part.sigma[inner][both]) < 0.05
    assert np.mean(apart > 0.5) < 0.02


def test_disparities_that_are_not_searched_are_not_found() -> None:
    found = matched("ideal")
    values = match_region(found.left, found.right, whole(found.left, 12, 27)).values
    kept = np.isfinite(values)
    assert values[kept].min() > 11
    assert values[kept].max() < 28
    beyond = (found.truth.disparity < 9) | (found.truth.disparity > 31)
    assert kept[beyond].mean() < 0.1
    within = (found.truth.disparity > 14) & (found.truth.disparity < 26) & usable("ideal", found)
    assert kept[within].mean() > 0.9


def test_unrelated_images_do_not_match() -> None:
    rng = np.random.default_rng(0)
    images = [cv2.GaussianBlur(rng.integers(0, 255, (150, 300)).astype(np.uint8), (0, 0), 1.5) for _ in range(2)]
    disparity = match_region(*images, whole(images[0]))
    with pytest.raises(RigError, match=r"scene: after rectification .*%.* another rig's"):
        check_matched(disparity, Path("scene"), images, SETTINGS)


def test_exchanged_images_are_said_to_be_so() -> None:
    found = matched("ideal")
    images = [found.right, found.left]
    with pytest.raises(RigError, match="are the folders swapped"):
        check_matched(match_region(*images, whole(found.left)), Path("scene"), images, SETTINGS)


def test_half_of_sky_is_no_mismatch() -> None:
    rng = np.random.default_rng(2)
    images = [np.array(image) for image in (matched("ideal").left, matched("ideal").right)]
    for image in images:
        image[:150] = np.rint(rng.normal(235, 1.5, image[:150].shape)).astype(np.uint8)
    disparity = match_region(*images, whole(images[0]))
    check_matched(disparity, Path("scene"), images, SETTINGS)


def test_a_thin_post_is_not_lost() -> None:
    post = Box(15.0, 1.0, length_m=0.25, width_m=0.25, height_m=5.0, seed=5, grey=150.0)
    rng = np.random.default_rng(0)
    left, right = (expose(view, rng) for view in views("ideal", post))
    values = match_region(left, right, whole(left)).values
    known = truth("ideal", (*STATIC, post))
    mine = (known.owner == 3) & known.seen
    assert np.mean(np.abs(values - known.disparity)[mine] < 0.5) > 0.5
