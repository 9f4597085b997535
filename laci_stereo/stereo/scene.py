"""What a camera that stands still knows of its scene: what it looks like at rest, and where its road lies."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, Raster
from laci_stereo.core.ground import GroundPlane
from laci_stereo.core.robust import NORMAL
from laci_stereo.stereo.disparity import Region
from laci_stereo.stereo.rectify import Rectification

SHRINK = 2
"""Change is looked for in images that are smaller by this factor, which also averages the noise."""

CHANGE_SIGMAS = 5.0
"""A grey value has changed when it is this many standard deviations off: one false pixel in 10^6."""

MOSTLY, AT_TIMES = 0.25, 0.1
"""In so many of the frames a pixel has the look that it has most. It may be that of what dwells in front of the scene,
such as a vehicle that waits or shunts, if there is another look in a tenth of the frames: in so many a place must be
seen empty for what stands there not to be background. What passes looks otherwise in each frame."""

FEWEST = 31
"""A tenth of fewer frames are three at most, which are alike by chance where leaves sway: then the median is taken."""

CENTRAL_QUARTER = 0.637
"""The interval about the mean with a quarter of what is normally distributed is so many standard deviations wide."""

MIN_NOISE = 0.5
"""Standard deviation of a grey value at least: rounding alone is 0.3, and both images are rounded."""

WHITE = np.float32(255.0)

SAMPLE_STRIDE = 4
"""Every fourth pixel in both directions tells the gain as well as all."""

MIN_GAIN = 1e-3

BLEED_PX = 12
"""Around a change by so much (full size) the matcher's and the refinement's windows still touch what moved."""

EDGE = np.ones((BLEED_PX // SHRINK + 1,) * 2, dtype=np.uint8)
"""What is narrower is no vehicle: an edge in the picture, on whose either side a pixel is as the mast sways."""

TALLEST_VEHICLE_M = 4.0
"""Road vehicles are at most so tall (EU directive 96/53/EC)."""

MIN_CLEARANCE_M = 1.0
"""Nothing comes nearer to the camera's height than this."""


@dataclass(frozen=True)
class Look:
    """The scene at rest, in the shrunken left image.

    Attributes
    ----------
    image : ndarray of float32, shape (height, width)
        Median over the recording, without what is seen in front of it.
    noise : ndarray of float32, shape (height, width)
        Standard deviation per pixel over the recording: foliage moves, walls do not.
    settled : ndarray of bool, shape (height, width)
        It looks so and no other way. Elsewhere everything passes for a change, so that it is matched, and what stands
        there is told by where it is and not by how it looks.
    """

    image: Raster
    noise: Raster
    settled: BoolArray

    def changed(self, shrunken: Raster) -> BoolArray:
        """Return where an image differs from the scene at rest, at the shrunken size, holes filled.

        The light may have changed since: one gain for the whole image is put in first. What was brighter at rest than
        the camera can tell may have any brightness above that.
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
    """Make an image smaller by `SHRINK`."""
    return cv2.resize(image, None, fx=1 / SHRINK, fy=1 / SHRINK, interpolation=cv2.INTER_AREA)


def learn_look(shrunken: list[Raster]) -> Look:
    """Take the median of frames from all over the recording, and the noise of each pixel from its deviations.

    All frames are brought to the light of the brightest first.
    """
    brightest = max(shrunken, key=_brightness)
    stack = np.stack([np.minimum(image / np.float32(_gain(image, brightest)), WHITE) for image in shrunken])
    median = np.median(stack, axis=0)
    deviation = NORMAL * np.median(np.abs(stack - median), axis=0)
    # Where fewer than half of the frames deviate, the median deviation may be zero: no pixel is better than most.
    typical = max(float(np.median(deviation)), MIN_NOISE)
    settled = np.ones(median.shape, dtype=np.uint8)
    if len(stack) >= FEWEST:
        unlike = (np.abs(stack - median) >= CHANGE_SIGMAS * typical).mean(axis=0) >= AT_TIMES
        look, its_deviation, alone = _densest_look(stack[:, unlike], typical)
        median[unlike], deviation[unlike] = np.where(alone, (look, its_deviation), (median[unlike], deviation[unlike]))
        settled[unlike] = alone
        settled = cv2.morphologyEx(settled, cv2.MORPH_OPEN, np.ones((3, 3)))  # a few pixels are alike by chance
        settled = cv2.morphologyEx(settled, cv2.MORPH_CLOSE, EDGE)
    return Look(median, np.maximum(cv2.GaussianBlur(deviation, (5, 5), 0), typical), settled > 0)


def _densest_look(grey: Raster, typical: float) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Return how some pixels look when they do so most alike, how that deviates, and whether they have no other look.

    Of leaves that sway the narrowest interval with a quarter of the values is so wide that all others are like these.

    Parameters
    ----------
    grey : ndarray, shape (frames, n)
    typical : float
        Standard deviation of most pixels.
    """
    mostly, at_times = (int(np.ceil(share * len(grey))) for share in (MOSTLY, AT_TIMES))
    low, width = _narrowest(grey, mostly)
    reach = CHANGE_SIGMAS * np.maximum(width / CENTRAL_QUARTER, typical)
    alike = np.abs(grey - (low + width / 2)) <= reach
    another = _narrowest(np.where(alike, np.inf, grey), at_times)[1]
    look = np.where(alike, grey, np.nan)
    median = np.nanmedian(look, axis=0)
    return median, NORMAL * np.nanmedian(np.abs(look - median), axis=0), another > reach


def _narrowest(grey: Raster, count: int) -> tuple[FloatArray, FloatArray]:
    """Return where the narrowest interval with so many of each pixel's values begins, and its width; infinite if none.

    Parameters
    ----------
    grey : ndarray, shape (frames, n)
        Infinite where there is no value.
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
    """Return by how much an image is brighter than another one of the same scene: the median over pixels."""
    one, other = (each[::SAMPLE_STRIDE, ::SAMPLE_STRIDE].astype(np.float32) for each in (image, reference))
    return max(float(np.median(one / np.maximum(other, 1.0))), MIN_GAIN)


@dataclass(frozen=True)
class RoadDisparity:
    """The ground plane in disparity space: d = row . (u, v, 1).

    Attributes
    ----------
    row : ndarray, shape (3,)
    height_m : float
        Of the camera above the road.
    """

    row: FloatArray
    height_m: float

    @classmethod
    def of(cls, ground: GroundPlane, rectification: Rectification) -> RoadDisparity:
        """Write a plane as disparity: n . p = -h with p = ray f b / d gives d = -(f b / h) n . ray, linear in u, v."""
        corner, right, down = (rectification.rays[v, u] @ ground.normal for v, u in ((0, 0), (0, 1), (1, 0)))
        scale = -rectification.focal_px * rectification.baseline_m / ground.height_m
        return cls(scale * np.array([right - corner, down - corner, corner]), ground.height_m)

    def range(self, x0: int, y0: int, x1: int, y1: int) -> tuple[int, int]:
        """Return the smallest and largest disparity that can occur in a rectangle.

        Nothing lies beneath the road, but the road may fall off behind the crossing: a fifth below the plane's
        disparity and two pixels. The roof of the tallest vehicle is nearer than the road behind it by
        h / (h - its height).
        """
        u, v = np.array([x0, x1, x0, x1]), np.array([y0, y0, y1, y1])
        road = self.row @ np.stack([u, v, np.ones(4)])
        clearance = max(self.height_m - TALLEST_VEHICLE_M, MIN_CLEARANCE_M)
        nearest = max(float(road.max()), 4.0) * self.height_m / min(clearance, self.height_m)
        return max(int(0.8 * road.min()) - 2, 0), int(np.ceil(nearest)) + 2


def regions(changed: BoolArray, size: tuple[int, int], road: RoadDisparity) -> list[Region]:
    """Put rectangles around what has changed, at full size, with the disparities that each can hold.

    Rectangles that overlap become one, so that no pixel is matched twice.
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
