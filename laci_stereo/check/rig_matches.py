"""Matching of scene points between the raw images of a pair, independently of any stereo calibration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import cv2
import numpy as np

from laci_stereo.core.errors import ImageError
from laci_stereo.core.frames import BoolArray, FloatArray, Raster
from laci_stereo.io.images import StereoPair, read_image
from laci_stereo.stereo.reader import EightBit

FEATURES = 2000
"""Features detected per image: some hundred in each twelfth of the image, even if texture is unevenly distributed."""

SEARCHED_PIXELS = 2_800_000
"""Features of larger images are searched at a size below this, and refined at full size: at 20 megapixels the search
takes 5 GB."""

DISTINCT = 0.8
"""A match is kept if its descriptor distance is less than this fraction of the second-best one's: Lowe's ratio."""

WINDOW_PX = 15
"""Side of the window in which a match is refined: that of the disparity's sub-pixel estimate, plus a margin of two
pixels."""

LEAST_CONTRAST, EVEN_CONTRAST = 2.0, 40.0
"""Grey values: the standard deviation of noise in an 8-bit image, and the standard deviation to which texture is
scaled, three of which fit into 128."""

MOST_REFINED_PX = 3.0
"""Feature positions are accurate to this; a refinement that moves farther has found something else."""

RETURNED_PX = 0.5
"""A refined match must lead back to its starting point within half a pixel; otherwise the window has too little texture
to determine it."""


MOVED_PX = 1.0
"""Points that move less than this until the next image count as stationary."""


@dataclass(frozen=True)
class Partners:
    """Number of points of a left image, and how many of them have a match in the right image."""

    points: int = 0
    matched: int = 0


@dataclass(frozen=True)
class PairMatches:
    """Matched points of a pair, raw pixels.

    Attributes
    ----------
    left, right : ndarray, shape (n, 2)
    later : ndarray, shape (n, 2)
        Position of the left point in the following left image; NaN if it was not found there.
    later_s : float
        Time between these two left images.
    moving, still : Partners
        Counts of all points of the left image that were tracked to the next one, by whether they move.
    """

    left: FloatArray
    right: FloatArray
    later: FloatArray
    later_s: float
    moving: Partners
    still: Partners

    def __len__(self) -> int:
        return len(self.left)

    def swapped(self) -> PairMatches:
        """Return the matches with left and right exchanged."""
        return replace(self, left=self.right, right=self.left, later=np.full(self.later.shape, np.nan))


@dataclass(frozen=True)
class Compared:
    """A pair of images and the following left image, as grey, uint8, shape (height, width).

    ``later`` is None at the end of the recording, if it cannot be read, its size differs, or the times are unknown.
    """

    left: Raster
    right: Raster
    later: Raster | None
    later_s: float


def read_compared(pairs: Sequence[StereoPair], number: int) -> Compared:
    """Read a pair and the following left image.

    Raises
    ------
    ImageError
        If an image of the pair cannot be read, or left and right differ in size.
    """
    pair = pairs[number]
    eight_bit = EightBit()
    eight_bit.learn_from(pair.images)
    left, right = (eight_bit.grey(read_image(path)) for path in pair.images)
    if left.shape != right.shape:
        (h, w), (right_h, right_w) = left.shape, right.shape
        raise ImageError(f"{pair.right}: the image is {right_w}x{right_h} pixels; needed are {w}x{h}, as the left one")
    later, later_s = None, 0.0
    if number + 1 < len(pairs):
        following = pairs[number + 1]
        later_s = (following.stamp_ns - pair.stamp_ns) / 1e9
        with suppress(ImageError):  # the pair itself is good all the same
            image = eight_bit.grey(read_image(following.left))
            later = image if image.shape == left.shape and later_s > 0 else None
    return Compared(left, right, later, later_s)


def match_pair(images: Compared) -> PairMatches:
    """Match points between both images anywhere, with sub-pixel precision.

    No calibration is used, so the matches show whatever is wrong with it.
    """
    even_left, even_right = _evened(images.left), _evened(images.right)
    finder = cv2.SIFT.create(nfeatures=FEATURES)
    height, width = images.left.shape
    factor = math.ceil(math.sqrt(width * height / SEARCHED_PIXELS))
    left_keys, left_words = finder.detectAndCompute(_shrunken(_stretched(images.left), factor), None)
    right_keys, right_words = finder.detectAndCompute(_shrunken(_stretched(images.right), factor), None)
    if left_words is None or right_words is None or min(len(left_keys), len(right_keys)) < 2:
        nothing = np.zeros((0, 2))
        return PairMatches(nothing, nothing, nothing, images.later_s, Partners(), Partners())
    at = (np.array([key.pt for key in keys], dtype=np.float32) for keys in (left_keys, right_keys))
    left, right = (points * factor + np.float32((factor - 1) / 2) for points in at)
    there, back = _distinct(left_words, right_words), _distinct(right_words, left_words)
    mutual = np.array([(i, j) for i, j in there.items() if back.get(j) == i], dtype=np.int64).reshape(-1, 2)
    found = np.full(left.shape, np.nan, dtype=np.float32)

    refined, usable = _refined(even_left, even_right, left[mutual[:, 0]], right[mutual[:, 1]])
    found[mutual[usable, 0]] = refined[usable]
    later = np.full(left.shape, np.nan, dtype=np.float32)
    if images.later is not None:
        followed, seen = _refined(even_left, _evened(images.later), left, left, most_px=np.inf, levels=3)
        later[seen] = followed[seen]
    # A feature that is detected at two scales is one point.
    _, once = np.unique(np.rint(left * 4), axis=0, return_index=True)
    return _gathered(left[once], found[once], later[once], images.later_s)


def _gathered(left: Raster, right: Raster, later: Raster, later_s: float) -> PairMatches:
    """Keep the matched points and count partners. Points are float32, NaN if they were not found."""
    matched, followed = (np.isfinite(there).all(axis=1) for there in (right, later))
    flow = later - left
    shake = np.median(flow[followed], axis=0) if followed.any() else np.zeros(2)
    moved = np.linalg.norm(flow - shake, axis=1)
    moving, still = followed & (moved > MOVED_PX), followed & (moved <= MOVED_PX)
    kept = [points[matched].astype(np.float64) for points in (left, right, later)]
    partners = [Partners(int(those.sum()), int((those & matched).sum())) for those in (moving, still)]
    return PairMatches(kept[0], kept[1], kept[2], later_s, partners[0], partners[1])


def _stretched(image: Raster) -> Raster:
    """Return an image stretched to the full 8-bit range, so that dark images yield as many features as bright ones."""
    low, high = np.percentile(image, [0.5, 99.5])
    stretched: Raster = np.clip((image - low) * (255.0 / max(high - low, 1.0)), 0, 255).astype(np.uint8)
    return stretched


def _shrunken(image: Raster, factor: int) -> Raster:
    return cv2.resize(image, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA) if factor > 1 else image


def _evened(image: Raster) -> Raster:
    """Return an image with uniform brightness and contrast, uint8: the cameras of a pair seldom have equal exposure.

    Texture below the noise of an 8-bit image is not amplified to full contrast.
    """
    grey = image.astype(np.float32)
    detail = grey - cv2.GaussianBlur(grey, (0, 0), WINDOW_PX)
    contrast = np.sqrt(cv2.GaussianBlur(detail**2, (0, 0), WINDOW_PX))
    return np.clip(detail / (contrast + LEAST_CONTRAST) * EVEN_CONTRAST + 128.0, 0, 255).astype(np.uint8)


def _distinct(words: Raster, others: Raster) -> dict[int, int]:
    found = cv2.BFMatcher(cv2.NORM_L2).knnMatch(words, others, k=2)
    return {two[0].queryIdx: two[0].trainIdx for two in found if two[0].distance < DISTINCT * two[1].distance}


def _refined(
    image: Raster, other: Raster, points: Raster, start: Raster, most_px: float = MOST_REFINED_PX, levels: int = 0
) -> tuple[Raster, BoolArray]:
    """Return the positions of points in another image, shape (n, 2), and which of them are reliable."""
    if not len(points):
        return start, np.zeros(0, dtype=bool)
    found, seen = _followed(image, other, points, start, levels)
    back, seen_back = _followed(other, image, found, points, levels)
    returned = np.linalg.norm(back - points, axis=1) < RETURNED_PX
    near = np.linalg.norm(found - start, axis=1) <= most_px
    usable: BoolArray = seen & seen_back & returned & near
    return found, usable


def _followed(image: Raster, other: Raster, points: Raster, start: Raster, levels: int) -> tuple[Raster, BoolArray]:
    """Track points from start positions (Lucas-Kanade); return their positions, shape (n, 2), and which were found."""
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        image,
        other,
        points[:, None],
        start[:, None].copy(),
        winSize=(WINDOW_PX, WINDOW_PX),
        maxLevel=levels,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.005),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.asarray(found)[:, 0], np.asarray(status)[:, 0] == 1
