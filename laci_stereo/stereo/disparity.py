"""Disparity of a rectified pair: semi-global matching, sub-pixel refinement and removal of unreliable pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from laci_stereo.core.errors import RigError
from laci_stereo.core.frames import BoolArray, FloatArray, Raster
from laci_stereo.stereo.refine import Refined, refine
from laci_stereo.stereo.settings import StereoSettings

SATURATED = 254
MIN_MATCHED_SHARE = 0.1
BAND_ROWS = 128

LARGEST_PX = 2031
"""Largest disparity that can be searched: OpenCV returns sixteenths of a pixel as 16-bit integers, up to 2047, and the
number searched is rounded up to a multiple of 16."""


@dataclass(frozen=True)
class Region:
    """A rectangle of the rectified left image with the disparities that can occur in it.

    Attributes
    ----------
    x0, y0, x1, y1 : int
        First column and row, and last column and row plus one.
    smallest, largest : int
        Range of disparities, pixels.
    """

    x0: int
    y0: int
    x1: int
    y1: int
    smallest: int
    largest: int

    @property
    def reach(self) -> int:
        """Columns of context that the matcher needs on the left: the smallest disparity plus the number searched."""
        return self.smallest + self.count

    @property
    def count(self) -> int:
        """Number of disparities to search, a multiple of 16 as SGBM requires."""
        return max(16, -(-(self.largest - self.smallest + 1) // 16) * 16)


@dataclass(frozen=True)
class Disparity:
    """Disparities of a region.

    Attributes
    ----------
    values : ndarray, shape (height, width)
        Disparity, pixels; NaN where there is no reliable one.
    sigma : ndarray, shape (height, width)
        Standard deviation of the disparity, pixels.
    """

    values: FloatArray
    sigma: FloatArray


def match(left: Raster, right: Raster, region: Region, settings: StereoSettings) -> Disparity:
    """Match a region of a rectified pair.

    Semi-global matching (Hirschmueller, PAMI 2008; OpenCV's variant) yields whole-pixel disparities and rejects pixels
    that are ambiguous, inconsistent between left and right, or speckles. Its sub-pixel part is biased towards whole
    numbers and fronto-parallel surfaces, so it is estimated again by `refine`, which also yields the variance and shows
    which pixels lack texture.

    Parameters
    ----------
    left, right : ndarray of uint8, shape (height, width)
        The region with ``region.reach`` columns of context on its left.
    region : Region
    settings : StereoSettings

    Returns
    -------
    Disparity
        Of the region, without the context columns.
    """
    area = settings.block_size**2
    matcher = cv2.StereoSGBM.create(
        minDisparity=region.smallest,
        numDisparities=region.count,
        blockSize=settings.block_size,
        P1=8 * area,
        P2=32 * area,
        disp12MaxDiff=settings.left_right_px,
        uniquenessRatio=settings.uniqueness_percent,
        speckleWindowSize=settings.speckle_px,
        speckleRange=2,
    )
    coarse = (matcher.compute(left, _exposed_like(left, right)).astype(np.float32) / 16)[:, region.reach :]
    inner = np.ascontiguousarray(left[:, region.reach :])
    # A best match at either end of the range is no minimum.
    found = (coarse > region.smallest) & (coarse < region.smallest + region.count - 1)
    refined = _refine_in_bands(inner, right, region.reach, coarse, found, settings.refine_window_px)
    sigma = np.sqrt(refined.variance + settings.disparity_floor_px**2)
    white = cv2.blur((inner >= SATURATED).astype(np.float32), (settings.block_size, settings.block_size)) > 0.5
    # A shift of a pixel or more means that the window contains something other than the matched surface.
    keep = found & (np.abs(refined.values - coarse) < 1) & (sigma <= settings.max_disparity_sigma_px) & ~white
    values = np.where(keep, refined.values, np.nan)
    return Disparity(values.astype(np.float64), sigma.astype(np.float64))


def _exposed_like(image: Raster, other: Raster) -> Raster:
    """Bring another image to this one's mean and standard deviation: block matching is sensitive to exposure."""
    mean, deviation = (float(value.item()) for value in cv2.meanStdDev(image))
    other_mean, other_deviation = (float(value.item()) for value in cv2.meanStdDev(other))
    gain = deviation / max(other_deviation, 1.0)
    return cv2.addWeighted(other, gain, other, 0.0, mean - gain * other_mean)


def _refine_in_bands(left: Raster, right: Raster, reach: int, coarse: Raster, found: BoolArray, side: int) -> Refined:
    """Refine bands of rows one after another, so that the working set fits the processor's cache and memory stays flat.

    A band's margin is three windows, the reach of the derivative, the sums and the windows beside a jump together.
    """
    margin, height = 3 * side, len(left)
    values, variance = np.empty_like(coarse), np.empty_like(coarse)
    for first in range(0, height, BAND_ROWS):
        last = min(first + BAND_ROWS, height)
        top = max(first - margin, 0)
        rows = slice(top, min(last + margin, height))
        part = refine(left[rows], right[rows], reach, coarse[rows], found[rows], side)
        values[first:last] = part.values[first - top : last - top]
        variance[first:last] = part.variance[first - top : last - top]
    return Refined(values, variance)


def check_matched(disparity: Disparity, folder: Path, images: Sequence[Raster], settings: StereoSettings) -> None:
    """Raise if a pair does not match, and state whether it would with the cameras exchanged.

    Of random images, less than a twentieth of the pixels pass the tests of `match`; of a scene with sky, shadow and
    bare asphalt, several times as many do.

    Parameters
    ----------
    disparity : Disparity
        Of ``images``.
    folder : Path
        Named in the error.
    images : sequence of ndarray of uint8
        The left and right rectified image, whole and without context columns.
    settings : StereoSettings

    Raises
    ------
    RigError
        If less than a tenth of the pixels match.
    """
    share = float(np.isfinite(disparity.values).mean())
    if share >= MIN_MATCHED_SHARE:
        return
    height, width = images[0].shape
    region = Region(0, 0, width, height, 0, min(width // 4, 128))
    flipped = [cv2.copyMakeBorder(np.fliplr(image), 0, 0, region.reach, 0, cv2.BORDER_REPLICATE) for image in images]
    exchanged = float(np.isfinite(match(flipped[0], flipped[1], region, settings).values).mean())
    hint = (
        f"with the cameras exchanged {exchanged:.0%} would: are the folders swapped, or is T given in the other "
        "direction?"
        if exchanged >= max(2 * share, MIN_MATCHED_SHARE)
        else "is the calibration another rig's, or stale, or are the images dark? `laci-stereo rig` looks for the cause"
    )
    raise RigError(
        f"{folder}: after rectification {share:.1%} of the pixels match between left and right; "
        f"needed are {MIN_MATCHED_SHARE:.0%}; {hint}"
    )
