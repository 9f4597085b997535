"""What is learnt of the scene of a stationary camera: its appearance at rest, and the road plane in disparity space."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, Raster
from laci_stereo.core.ground.plane import GroundPlane
from laci_stereo.core.robust import NORMAL
from laci_stereo.stereo.disparity import Region
from laci_stereo.stereo.rectify import Rectification

SHRINK = 2
"""Factor by which images are downscaled before changes are detected; this also averages the noise."""

CHANGE_SIGMAS = 5.0
"""A grey value has changed when it deviates by this many standard deviations: one false pixel in 10^6."""

MOSTLY, AT_TIMES = 0.25, 0.1
"""Fractions of the frames. A grey value that at least a quarter of the frames agree on is the pixel's candidate for the
background. If another value occurs in a tenth of the frames, the candidate may be an object that dwells in front of
the scene, such as a vehicle that waits or shunts: a place must be seen empty that often, or an object there is taken
for background. Passing objects look different in each frame."""

FEWEST = 31
"""Least number of frames for that test; with fewer, the median is taken. A tenth of fewer frames is three at most,
which agree by chance where leaves sway."""

CENTRAL_QUARTER = 0.637
"""Width of the interval about the mean that contains a quarter of a normal distribution, in standard deviations."""

MIN_NOISE = 0.5
"""Lower limit of a grey value's standard deviation: rounding alone contributes 0.3, and both images are rounded."""

WHITE = np.float32(255.0)

SAMPLE_STRIDE = 4
"""Every fourth pixel in both directions determines the gain as well as all pixels do."""

MIN_GAIN = 1e-3

BLEED_PX = 12
"""Distance from a change, in full-size pixels, within which the windows of the matcher and of the refinement still
overlap what moved."""

EDGE = np.ones((BLEED_PX // SHRINK + 1,) * 2, dtype=np.uint8)
"""Structuring element that closes unsettled areas narrower than a vehicle. These are edges in the image, where a pixel
shows either side of the edge as the mast sways."""

TALLEST_VEHICLE_M = 4.0
"""Maximum height of road vehicles (EU directive 96/53/EC)."""

MIN_CLEARANCE_M = 1.0
"""No vehicle's roof is assumed nearer to the camera's height than this."""


@dataclass(frozen=True)
class Look:
    """The scene at rest in the downscaled left image.

    Attributes
    ----------
    image : ndarray of float32, shape (height, width)
        Median over the recording, without objects that stand in front of the scene for a while.
    noise : ndarray of float32, shape (height, width)
        Standard deviation of each pixel over the recording: large in foliage, small on walls.
    settled : ndarray of bool, shape (height, width)
        The pixel has only one appearance at rest. All other pixels always count as changed and are therefore matched,
        so that objects there are told apart by their position instead of their appearance.
    """

    image: Raster
    noise: Raster
    settled: BoolArray

    def changed(self, shrunken: Raster) -> BoolArray:
        """Return where an image differs from the scene at rest, at the downscaled size, with holes filled.

        The illumination may have changed: a gain for the whole image is applied first. A pixel that was saturated at
        rest may have any brightness above that.
        """
        gain = _gain(shrunken, self.image)
        brighter = shrunken.astype(np.float32) - np.minimum(gain * self.image, WHITE)
        limit = CHANGE_SIGMAS * max(gain, 1.0) * self.noise
        apart = (brighter < -limit) | ((brighter > limit) & (self.image < WHITE)) | ~self.settled
        mask = cv2.morphologyEx(apart.astype(np.uint8), cv2.MORPH_OPEN, np.ones((2, 2), np.uint8))
        reach = 2 * (BLEED_PX // SHRINK) + 1
        mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach)))
        outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        filled: BoolArray = cv2.drawContours(mask, outlines, -1, 1, cv2.FILLED) > 0
        return filled


def shrink(image: Raster) -> Raster:
    """Downscale an image by the factor `SHRINK`."""
    return cv2.resize(image, None, fx=1 / SHRINK, fy=1 / SHRINK, interpolation=cv2.INTER_AREA)


def learn_look(shrunken: list[Raster]) -> Look:
    """Return the median of frames from all over the recording, with each pixel's noise from its deviations.

    All frames are first scaled to the brightness of the brightest one.
    """
    brightest = max(shrunken, key=_brightness)
    stack = np.stack([np.minimum(image / np.float32(_gain(image, brightest)), WHITE) for image in shrunken])
    median = np.median(stack, axis=0)
    deviation = NORMAL * np.median(np.abs(stack - median), axis=0)
    # The median deviation is zero where fewer than half of the frames deviate: the typical noise is a lower limit.
    typical = max(float(np.median(deviation)), MIN_NOISE)
    settled = np.ones(median.shape, dtype=np.uint8)
    if len(stack) >= FEWEST:
        unlike = (np.abs(stack - median) >= CHANGE_SIGMAS * typical).mean(axis=0) >= AT_TIMES
        look, its_deviation, alone = _densest_look(stack[:, unlike], typical)
        median[unlike], deviation[unlike] = np.where(alone, (look, its_deviation), (median[unlike], deviation[unlike]))
        settled[unlike] = alone
        settled = cv2.morphologyEx(settled, cv2.MORPH_OPEN, np.ones((3, 3)))  # a few pixels agree by chance
        settled = cv2.morphologyEx(settled, cv2.MORPH_CLOSE, EDGE)
    return Look(median, np.maximum(cv2.GaussianBlur(deviation, (5, 5), 0), typical), settled > 0)


def _densest_look(grey: Raster, typical: float) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return each pixel's most frequent grey value, its deviation, and whether the pixel has no second such value.

    For swaying leaves, the narrowest interval with a quarter of the values is so wide that it accepts all others, too.

    Parameters
    ----------
    grey : ndarray, shape (frames, n)
    typical : float
        Standard deviation of a typical pixel, grey values.

    Returns
    -------
    median, deviation : ndarray, shape (n,)
        Of the frames that agree with the most frequent value.
    alone : ndarray of bool, shape (n,)
        No second value occurs in a fraction `AT_TIMES` of the frames.
    """
    mostly, at_times = (int(np.ceil(share * len(grey))) for share in (MOSTLY, AT_TIMES))
    low, width = _narrowest(grey, mostly)
    reach = CHANGE_SIGMAS * np.maximum(width / CENTRAL_QUARTER, typical)
    alike = np.abs(grey - (low + width / 2)) <= reach
    another_width = _narrowest(np.where(alike, np.inf, grey), at_times)[1]
    look = np.where(alike, grey, np.nan)
    median = np.nanmedian(look, axis=0)
    return median, NORMAL * np.nanmedian(np.abs(look - median), axis=0), another_width > reach


def _narrowest(grey: Raster, count: int) -> tuple[FloatArray, FloatArray]:
    """Return the lower end and the width of the narrowest interval that contains ``count`` values of each pixel.

    The width is infinite if a pixel has fewer values.

    Parameters
    ----------
    grey : ndarray, shape (frames, n)
        Infinite where a value is missing.
    count : int
    """
    ordered = np.sort(grey, axis=0)
    first, last = ordered[: len(grey) - count + 1], ordered[count - 1 :]
    widths = np.subtract(last, first, out=np.full_like(first, np.inf), where=np.isfinite(last))
    at = widths.argmin(axis=0)[None]
    low, width = (np.take_along_axis(each, at, axis=0)[0] for each in (first, widths))
    return low, width


def _brightness(image: Raster) -> float:
    return float(np.median(image[::SAMPLE_STRIDE, ::SAMPLE_STRIDE]))


def _gain(image: Raster, reference: Raster) -> float:
    """Return how many times brighter an image is than a reference of the same scene: the median ratio over pixels."""
    one, other = (each[::SAMPLE_STRIDE, ::SAMPLE_STRIDE].astype(np.float32) for each in (image, reference))
    return max(float(np.median(one / np.maximum(other, 1.0))), MIN_GAIN)


@dataclass(frozen=True)
class RoadDisparity:
    """The ground plane in disparity space: d = row . (u, v, 1).

    Attributes
    ----------
    row : ndarray, shape (3,)
    height_m : float
        Height of the camera above the road.
    """

    row: FloatArray
    height_m: float

    @classmethod
    def of(cls, ground: GroundPlane, rectification: Rectification) -> RoadDisparity:
        """Convert a plane: n . p = -h with p = ray f b / d gives d = -(f b / h) n . ray, which is linear in u and v."""
        corner, right, down = rectification.rays_at(np.array([0, 0, 1]), np.array([0, 1, 0])) @ ground.normal
        scale = -rectification.focal_px * rectification.baseline_m / ground.height_m
        return cls(scale * np.array([right - corner, down - corner, corner]), ground.height_m)

    def range(self, x0: int, y0: int, x1: int, y1: int) -> tuple[int, int]:
        """Return the smallest and largest disparity that can occur in a rectangle.

        Nothing lies below the road, but the road may descend behind the crossing: the lower limit is a fifth and two
        pixels below the plane's disparity. The disparity of the tallest vehicle's roof exceeds that of the road behind
        it by the factor h / (h - its height).
        """
        u, v = np.array([x0, x1, x0, x1]), np.array([y0, y0, y1, y1])
        road = self.row @ np.stack([u, v, np.ones(4)])
        clearance = max(self.height_m - TALLEST_VEHICLE_M, MIN_CLEARANCE_M)
        nearest = max(float(road.max()), 4.0) * self.height_m / min(clearance, self.height_m)
        return max(int(0.8 * road.min()) - 2, 0), int(np.ceil(nearest)) + 2


def regions(changed: BoolArray, size: tuple[int, int], road: RoadDisparity) -> list[Region]:
    """Return rectangles around the changes, at full size, with the disparity range that each can contain.

    Overlapping rectangles are merged, so that no pixel is matched twice.
    """
    width, height = size
    covered = cv2.dilate(changed.astype(np.uint8), np.ones((2 * BLEED_PX // SHRINK + 1,) * 2, np.uint8))
    while True:
        stats = cv2.connectedComponentsWithStats(covered)[2][1:, :4]
        rectangles = np.zeros_like(covered)
        for x, y, w, h in stats:
            rectangles[y : y + h, x : x + w] = 1
        if np.array_equal(rectangles, covered):
            break
        covered = rectangles
    found = []
    for x, y, w, h in SHRINK * stats.astype(int):
        x0, y0, x1, y1 = int(x), int(y), min(int(x + w), width), min(int(y + h), height)
        found.append(Region(x0, y0, x1, y1, *road.range(x0, y0, x1, y1)))
    return found
