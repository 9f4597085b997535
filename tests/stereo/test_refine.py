"""The fraction of a pixel holds whatever the two cameras make of the same light: their gain, offset and vignetting."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
import pytest

from laci_stereo.core.frames import BoolArray, FloatArray, Raster
from laci_stereo.stereo.disparity import Disparity, Region, match
from laci_stereo.stereo.reader import EightBit
from laci_stereo.stereo.rectify import rectify
from laci_stereo.stereo.refine import Refined, refine
from laci_stereo.stereo.settings import StereoSettings
from tests.stereo.render import ROAD, View, expose
from tests.stereo.rigs import lens, rig
from tests.stereo.support import FAR, STATIC, robust_std, truth, views

WALL, CAR = 1, 3
SIDE = 11
NO_FLOOR = StereoSettings(disparity_floor_px=0.0)


@dataclass(frozen=True)
class Exposure:
    """Grey value = gain (1 - lost r^2) light + offset, r = 1 in the corners."""

    gain: float = 1.0
    offset: float = 0.0
    lost: float = 0.0

    def of(self, view: View, rng: np.random.Generator) -> Raster:
        height, width = view.grey.shape
        v, u = np.mgrid[:height, :width].astype(np.float64)
        middle = np.array([height - 1, width - 1]) / 2
        far = ((v - middle[0]) ** 2 + (u - middle[1]) ** 2) / (middle @ middle)
        return expose(replace(view, grey=self.gain * (1 - self.lost * far) * view.grey + self.offset), rng)


EXPOSURES = [
    pytest.param(Exposure(gain=0.8), id="darker"),
    pytest.param(Exposure(gain=0.95), id="a little darker"),
    pytest.param(Exposure(gain=1.1), id="brighter"),
    pytest.param(Exposure(gain=1.25), id="much brighter"),
    pytest.param(Exposure(offset=10.0), id="lifted"),
    pytest.param(Exposure(offset=-10.0), id="lowered"),
    pytest.param(Exposure(lost=0.2), id="vignetting"),
    pytest.param(Exposure(gain=1.25, offset=-10.0, lost=0.2), id="all, brighter"),
    pytest.param(Exposure(gain=0.8, offset=10.0, lost=0.2), id="all, darker"),
]


@lru_cache(maxsize=32)
def matched(left: Exposure, right: Exposure) -> Disparity:
    rng = np.random.default_rng(0)
    images = [side.of(view, rng) for side, view in zip((left, right), views("ideal", FAR), strict=True)]
    height, width = images[0].shape
    region = Region(0, 0, width, height, 0, 31)
    wide = [cv2.copyMakeBorder(image, 0, 0, region.reach, 0, cv2.BORDER_REPLICATE) for image in images]
    return match(wide[0], wide[1], region, NO_FLOOR)


def seen(owner: int) -> BoolArray:
    """Return where both cameras see a surface, away from its outline, where windows hold two surfaces."""
    known = truth("ideal", (*STATIC, FAR))
    mine = known.seen & (known.owner == owner)
    inner: BoolArray = cv2.erode(mine.astype(np.uint8), np.ones((SIDE, SIDE), np.uint8)) > 0
    return inner


@pytest.mark.parametrize("owner", [ROAD, WALL, CAR], ids=["road", "wall", "car"])
@pytest.mark.parametrize("right", EXPOSURES)
def test_a_difference_in_exposure_is_no_shift_and_no_noise(right: Exposure, owner: int) -> None:
    there, known = seen(owner), truth("ideal", (*STATIC, FAR)).disparity
    apart = matched(Exposure(), right)
    gaps, *gaps_alike = (
        1 - np.isfinite(found.values[there]).mean()
        for found in (apart, matched(Exposure(), Exposure()), matched(right, right))
    )
    # The darker an image, the more of its texture is lost in noise: one of the two loses half of what both would.
    assert gaps < np.mean(gaps_alike) + 0.03
    kept = there & np.isfinite(apart.values)
    error = (apart.values - known)[kept]
    assert np.median(np.abs(error)) < 0.1
    # The car's sides are hardly wider than a window, whose error the floor stands for, which is left out here.
    assert owner == CAR or 0.6 < robust_std(error / apart.sigma[kept]) < 1.5


def textured(shift_px: float, offset: float, gain: float, noise: float) -> tuple[Raster, Raster]:
    """Return images of random texture; a point at u in the left one is at u - shift in the right one."""
    finer = 10
    rng = np.random.default_rng(5)
    fine = cv2.GaussianBlur(rng.normal(size=(120, 260 * finer)), (0, 0), sigmaX=1.5 * finer, sigmaY=1.5)
    fine *= 20 / fine.std()
    first = round(shift_px * finer)
    left, right = fine[:, : 240 * finer : finer], fine[:, first : first + 240 * finer : finer]
    images = (110 + left, gain * (110 + right) + offset)
    one, two = (np.clip(np.rint(i + noise * rng.normal(size=i.shape)), 0, 255).astype(np.uint8) for i in images)
    return one, two


def refined(left: Raster, right: Raster, coarse_px: float) -> Refined:
    coarse = np.full(left.shape, coarse_px, dtype=np.float32)
    return refine(left, right, 0, coarse, np.ones(left.shape, dtype=bool), SIDE)


@pytest.mark.parametrize(("gain", "offset"), [(0.8, 0.0), (1.25, 0.0), (1.0, 10.0), (0.8, 10.0), (1.25, -10.0)])
def test_the_variance_holds_the_noise_and_not_the_exposure(gain: float, offset: float) -> None:
    inner = (slice(20, -20), slice(40, -20))
    of = [refined(*textured(10.3, off, by, noise=2.0), coarse_px=10.0) for by, off in ((1.0, 0.0), (gain, offset))]
    for found in of:
        error = found.values[inner] - 10.3
        assert abs(np.median(error)) < 0.01
        assert 0.8 < robust_std(error / np.sqrt(found.variance[inner])) < 1.2
    # Texture grows with the gain while the noise is the sensor's: one image of the two has its part of it.
    alike, apart = (float(np.sqrt(np.median(found.variance[inner]))) for found in of)
    assert apart / alike == pytest.approx(np.sqrt((1 + 1 / gain**2) / 2), rel=0.1)


def test_an_exposure_that_changes_within_the_image_is_followed() -> None:
    left, right = textured(10.3, 0.0, 1.0, noise=1.0)
    ramp = np.linspace(0.8, 1.2, right.shape[1])
    values = refined(left, np.rint(ramp * right).astype(np.uint8), coarse_px=10.0).values[20:-20, 40:-20]
    assert abs(np.median(values) - 10.3) < 0.01
    assert np.mean(np.abs(values - 10.3) > 0.1) < 0.01


def layer(seed: int, shift_px: float, strength: float, blur_px: float = 1.5) -> tuple[FloatArray, FloatArray]:
    """Return random texture of two images without noise; a point at u in the left one is at u - shift in the right."""
    finer = 10
    fine = np.random.default_rng(seed).normal(size=(120, 260 * finer))
    fine = cv2.GaussianBlur(fine, (0, 0), blur_px * finer, sigmaY=blur_px)
    fine *= strength / fine.std()
    first = round(shift_px * finer)
    return fine[:, : 240 * finer : finer], fine[:, first : first + 240 * finer : finer]


def spread_over_sigma(left: FloatArray, right: FloatArray, shift_px: float) -> tuple[float, float]:
    """Return the scatter of the error over the sigma that is promised, and that sigma."""
    images = [np.clip(np.rint(110 + image), 0, 255).astype(np.uint8) for image in (left, right)]
    found = refined(images[0], images[1], coarse_px=10.0)
    inner = (slice(20, -20), slice(40, -20))
    sigma = np.sqrt(found.variance[inner])
    return robust_std((found.values[inner] - shift_px) / sigma), float(np.median(sigma))


@pytest.mark.parametrize("noise", [1.0, 2.0, 4.0])
@pytest.mark.parametrize("kernel", [[0.0, 1.0, 0.0], [0.25, 0.5, 0.25]], ids=["of each pixel", "of a mosaic"])
def test_the_variance_holds_noise_that_is_interpolated_and_noise_that_is_not(kernel: list[float], noise: float) -> None:
    rng = np.random.default_rng(9)
    spread = np.array(kernel)
    left, right = (
        side + noise / (spread @ spread) * cv2.sepFilter2D(rng.normal(size=side.shape), cv2.CV_64F, spread, spread)
        for side in layer(5, 10.3, 20.0)
    )
    assert 0.8 < spread_over_sigma(left, right, 10.3)[0] < 1.2


def noisy(light: FloatArray, rng: np.random.Generator) -> Raster:
    """Return what a sensor with little noise makes of light."""
    return np.clip(np.rint(light + 0.7 * rng.normal(size=light.shape)), 0, 255).astype(np.uint8)


def through_mosaic(grey: FloatArray, light: tuple[float, float, float], rng: np.random.Generator) -> Raster:
    """Return what a sensor with a mosaic of red, green, green and blue pixels makes of something grey in some light."""
    red, green, blue = (part * (110 + grey) for part in light)
    mosaic = green.copy()
    mosaic[::2, ::2], mosaic[1::2, 1::2] = red[::2, ::2], blue[1::2, 1::2]
    return np.asarray(cv2.cvtColor(noisy(mosaic, rng), cv2.COLOR_BayerRGGB2BGR))


@pytest.mark.parametrize("light", [(1.0, 1.0, 1.0), (1.0, 0.95, 0.87), (0.7, 1.0, 0.8)], ids=["white", "sun", "raw"])
@pytest.mark.parametrize("shift_px", [9.5, 9.7, 10.3, 10.5, 10.7, 11.0, 11.3, 11.5])
def test_a_mosaic_of_colours_draws_no_shift(light: tuple[float, float, float], shift_px: float) -> None:
    rng = np.random.default_rng(3)
    # Texture as fine as a sharp lens leaves it: a smoother one shows less of the mosaic.
    sides = layer(8, shift_px, 12.0, blur_px=0.6)
    left, right = (EightBit().grey(through_mosaic(side, light, rng)) for side in sides)
    values = refined(left, right, coarse_px=round(shift_px)).values[20:-20, 40:-20]
    # A third of the floor; by the usual weights for grey, and unsmoothed, it is 0.1 px.
    assert abs(np.median(values) - shift_px) < 0.035


@pytest.mark.parametrize("blur_px", [0.6, 1.0])
@pytest.mark.parametrize("aside_px", [(0.25, -0.25), (-0.25, 0.25), (0.5, 0.0)])
def test_what_is_rectified_by_parts_of_a_pixel_is_shifted_by_those(
    aside_px: tuple[float, float], blur_px: float
) -> None:
    rng = np.random.default_rng(4)
    sides = layer(8, 10.0, 12.0, blur_px)
    height, width = sides[0].shape
    first, second = (lens(shift=(aside, 0.0), size=(width, height)) for aside in aside_px)
    plane = rectify(rig(first, second))
    views = zip((plane.left, plane.right), sides, strict=True)
    left, right = (view.look_up(noisy(110 + side, rng), to_match=True) for view, side in views)
    true_px = 10.0 - (aside_px[0] - aside_px[1])
    values = refined(left, right, coarse_px=10.0).values[20:-20, 40:-20]
    assert abs(np.median(values) - true_px) < 0.01


@pytest.mark.parametrize("away_px", [-10.0, -8.0, -6.0])
def test_the_variance_holds_what_a_surface_mirrors(away_px: float) -> None:
    # Farther than the texture's waves are long, 4 px: nearer, both images of it become one that lies between.
    rng = np.random.default_rng(3)
    before = 0.0
    for strength in (0.0, 2.0, 4.0, 8.0):
        left, right = (
            own + mirrored + rng.normal(size=own.shape)
            for own, mirrored in zip(layer(5, 10.3, 20.0), layer(6, 10.3 + away_px, strength), strict=True)
        )
        ratio, sigma = spread_over_sigma(left, right, 10.3)
        assert 0.8 < ratio < 1.3
        assert sigma > 1.3 * before
        before = sigma
