"""The fraction of a pixel: least squares over windows that stay on one surface."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np

from laci_stereo.core.frames import BoolArray, IntArray, Raster

JUMP_PX = 1.5
"""Within a pixel on either side a surface changes by less: the matcher's own steps are one pixel high."""

STEPS = 2
"""Of Newton's method: the first leaves a tenth of what the matcher's fraction is off, the second a hundredth."""

FINER = 4
"""The right image is interpolated to so many columns for each of its own, and linearly between these."""

DERIVATIVE = np.array([[-1, 9, -45, 0, 45, -9, 1]], np.float32) / 60
"""Central difference of the sixth order: a shorter one is too flat for fine texture, and the shift too large."""

SMOOTHING = np.array([[-1, 0, 9, 16, 9, 0, -1]], np.float32) / 32
"""Takes away what alternates from column to column, and leaves what has eight columns to a wave.

That is the flattest half-band filter of seven taps. A mosaic of colours lays such a pattern over both images: it stays
where the sensor's pixels are, whatever these show, and draws shifts towards whole pairs of pixels, by 0.07 px on grey
asphalt. And of what has two columns to a wave it cannot be told how far it is shifted.
"""

LEAST_INFORMATION = 1e-3

EXPOSURE_WINDOWS = 4
"""Side of the larger window that tells gain and offset, in windows.

A mean over 2000 pixels of it is off by a fiftieth of the image's noise, while an offset of each window's own would take
the texture that is longer than the window. Vignetting changes by less than a tenth within it, evenly.
"""

SMEAR = 3
"""Side of the square whose pixels err together, pixels: a mosaic of colours is interpolated from three by three, a lens
shows a point no smaller, and what a glossy side mirrors is as smooth.

White noise of variance s^2 makes a sum over n of them vary by n s^2, noise in common by n^2 s^2; over n, the first is
s^2 whatever n is, the second what it adds to the variance of a least-squares shift of texture that is as smooth.
"""

LEFT_OF_NOISE = 0.826
"""Of the variance of white noise's sums over such a square what `SMOOTHING` leaves: the squares of its own sums over
three taps, added up, over three."""

ROUNDING = 1 / 6
"""Variance of the difference of two grey values from their rounding alone."""


@dataclass(frozen=True)
class Refined:
    """Disparities and their variance, shape (height, width); NaN where no window on one surface tells it."""

    values: Raster
    variance: Raster


def refine(left: Raster, right: Raster, reach: int, coarse: Raster, found: BoolArray, side: int) -> Refined:
    """Estimate disparities to a fraction of a pixel from whole ones.

    The sum over a window of the squared differences between left and shifted right image is minimised (Lucas and
    Kanade, IJCAI 1981), starting from the mean of the coarse disparities over the window: their steps are the
    matcher's, and a mean over a symmetrical window keeps a slant.

    Where the coarse disparity jumps within the window, it holds two surfaces, and a common shift would strew points
    between them. There the pixel's disparity is continued along a straight line from two windows beside it that hold
    one surface each (shiftable windows, Kang, Szeliski and Chai, CVPR 2001), the line that misses the coarse disparity
    least. Without such a line a pixel at a jump belongs to no surface and is dropped; one inside of something thinner
    than a window keeps the window of its own.

    What alternates from column to column is a colour mosaic's and not the scene's, and is taken away first.

    The cameras may be exposed differently, and their lenses lose different amounts of light to the borders: the left
    image is first brought to the gain and the offset of the right one, both from a larger window.

    The variance is that of least squares, from the window's own residual: it tells the image's noise there, and also
    occlusion, gloss and other surfaces. Neighbours have most of that in common, so it is taken from sums over so many
    as do: what errs together is not averaged out, and noise that is each pixel's own counts as before.

    Parameters
    ----------
    left : ndarray of uint8, shape (height, width)
    right : ndarray of uint8, shape (height, reach + width)
        With ``reach`` columns more on the left.
    reach : int
    coarse : ndarray of float32, shape (height, width)
    found : ndarray of bool, shape (height, width)
        Where it is meaningful.
    side : int
        Of the window, pixels, odd.
    """
    left, right = (cv2.filter2D(image, cv2.CV_32F, SMOOTHING) for image in (left, right))
    weight = found.astype(np.float32)
    count = _sums(weight, side)
    known = coarse * weight
    jump = _jumps(np.where(found, coarse, _dilated(known, side)))
    straddles = _dilated(jump.astype(np.uint8), side) > 0
    start = np.where(straddles & found, coarse, _sums(known, side) / np.maximum(count, 1.0))

    fine = _upsampled(right)
    u = FINER * np.arange(reach, reach + left.shape[1], dtype=np.float32)
    v = np.repeat(np.arange(len(left), dtype=np.float32)[:, None], left.shape[1], axis=1)
    shifted = _shifted(fine, u - FINER * start, v)
    grey = _exposed_alike(left, shifted, weight, side)
    gradient = cv2.filter2D(grey, cv2.CV_32F, DERIVATIVE) * weight
    shift = held = np.zeros_like(start)
    for step in range(STEPS):
        if step:
            shifted = _shifted(fine, u - FINER * (start + held), v)
        apart = (shifted - grey) * weight
        other = cv2.filter2D(shifted, cv2.CV_32F, DERIVATIVE) * weight
        mean = (gradient + other) / 2
        # The product of both images' gradients, since the square of one would count its noise as texture.
        texture = gradient * other
        information = np.maximum(_sums(texture, side), LEAST_INFORMATION)
        # A pixel's difference holds its own shift already; what is wanted is the shift of the whole window.
        shift = _sums(mean * apart + texture * held, side) / information
        held = np.where(straddles, 0, shift)
    common = _sums(apart, SMEAR)
    noise = np.maximum(_sums(common * common, side) / np.maximum(LEFT_OF_NOISE * SMEAR**2 * count, 1.0), ROUNDING)
    variance = noise * np.maximum(_sums(mean * mean, side), information) / information**2
    return _continued(Refined(start + shift, variance), coarse, found, straddles, jump, side)


def _shifted(fine: Raster, u: Raster, v: Raster) -> Raster:
    return cv2.remap(fine, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _exposed_alike(grey: Raster, other: Raster, weight: Raster, side: int) -> Raster:
    """Bring an image to the gain and offset of another one of the same surfaces, pixel for pixel.

    The gain is the ratio of standard deviations: a regression's is too small where there is noise in both.
    """
    window = EXPOSURE_WINDOWS * side | 1
    count = np.maximum(_sums(weight, window), 1.0)
    own_mean, own_deviation = _moments(grey * weight, count, window)
    other_mean, other_deviation = _moments(other * weight, count, window)
    gain = other_deviation / own_deviation
    alike: Raster = gain * (grey - own_mean) + other_mean
    return alike


def _moments(values: Raster, count: Raster, side: int) -> tuple[Raster, Raster]:
    """Return mean and standard deviation over windows, the latter not below what rounding leaves."""
    mean = _sums(values, side) / count
    return mean, np.sqrt(np.maximum(_sums(values * values, side) / count - mean * mean, ROUNDING))


def _upsampled(image: Raster) -> Raster:
    """Interpolate rows by Lanczos' kernel of three lobes; OpenCV's cubic one draws shifts towards whole pixels."""
    height, width = image.shape
    fine = np.empty((height, width, FINER), np.float32)
    fine[:, :, 0] = image
    for part in range(1, FINER):
        away = np.arange(-2, 4) - part / FINER
        kernel = (np.sinc(away) * np.sinc(away / 3)).astype(np.float32)[None]
        fine[:, :, part] = cv2.filter2D(
            image, cv2.CV_32F, kernel / kernel.sum(), anchor=(2, 0), borderType=cv2.BORDER_REPLICATE
        )
    return fine.reshape(height, width * FINER)


def _sums(values: Raster, side: int) -> Raster:
    return cv2.boxFilter(values, cv2.CV_32F, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)


def _dilated(values: Raster, side: int) -> Raster:
    return cv2.dilate(values, np.ones((side, side), np.uint8))


def _jumps(filled: Raster) -> BoolArray:
    """Tell where disparity jumps; holes are filled from the nearer surface, so that one hidden behind is found."""
    jumps: BoolArray = cv2.morphologyEx(filled, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > JUMP_PX
    return jumps


def _continued(
    refined: Refined, coarse: Raster, found: BoolArray, straddles: BoolArray, jump: BoolArray, side: int
) -> Refined:
    """Continue whole windows one step of half a window and a pixel, d = 2 d1 - d2, to the pixels that have none."""
    step = side // 2 + 1
    clean = np.where(straddles | ~found, np.float32(np.nan), refined.values)
    field = cv2.copyMakeBorder(clean, *(4 * (2 * step,)), cv2.BORDER_CONSTANT, value=float("nan"))
    width = field.shape[1]
    v, u = np.nonzero(straddles & found)
    place: IntArray = (v + 2 * step) * width + u + 2 * step
    wanted = coarse[v, u]
    variance = refined.variance[v, u]
    value = np.where(jump[v, u], np.float32(np.nan), refined.values[v, u])
    least = np.ones(len(v), np.float32)
    flat = field.ravel()
    for down, across in product((-1, 0, 1), repeat=2):
        offset = step * (down * width + across)
        continued = 2 * flat.take(place + offset) - flat.take(place + 2 * offset)
        missed = np.abs(continued - wanted)
        better = np.flatnonzero(missed < least)
        least[better], value[better] = missed[better], continued[better]
        # Two windows share what they overlap, and as much of their noise.
        shared = (1 - abs(down) * step / side) * (1 - abs(across) * step / side)
        variance[better] = (5 - 4 * shared) * refined.variance[v[better] + step * down, u[better] + step * across]
    values, variances = clean, refined.variance.copy()
    values[v, u], variances[v, u] = value, variance
    return Refined(values, variances)
