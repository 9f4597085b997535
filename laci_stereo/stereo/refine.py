"""Sub-pixel refinement of disparities: least squares over windows that lie on one surface."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np

from laci_stereo.core.frames import BoolArray, IntArray, Raster

JUMP_PX = 1.5
"""Disparity range in a 3 x 3 neighbourhood above which it holds a depth discontinuity. On one surface the range is
smaller: the matcher's own steps are one pixel high."""

STEPS = 2
"""Newton iterations: the first leaves a tenth of the error of the matcher's sub-pixel part, the second a hundredth."""

FINER = 4
"""Factor by which the right image is upsampled along rows; values between these columns are interpolated linearly."""

DERIVATIVE = np.array([[-1, 9, -45, 0, 45, -9, 1]], np.float32) / 60
"""Central difference of sixth order: a shorter one underestimates the gradient of fine texture and so overestimates the
shift."""

SMOOTHING = np.array([[-1, 0, 9, 16, 9, 0, -1]], np.float32) / 32
"""Low-pass filter along rows that removes what alternates from column to column and keeps wavelengths from eight
columns.

It is the maximally flat half-band filter with seven taps. A colour mosaic superimposes an alternating pattern on both
images that is fixed to the sensor's pixels whatever these show; it pulls shifts towards even numbers of pixels, by 0.07
px on grey asphalt. Besides, the shift of a signal with a wavelength of two columns is ambiguous.
"""

LEAST_INFORMATION = 1e-3

EXPOSURE_WINDOWS = 4
"""Side of the larger window from which gain and offset are estimated, in windows.

A mean over its 2000 pixels has an error of a fiftieth of the image's noise, while an offset per matching window would
remove texture with wavelengths above the window's size. Vignetting changes by less than a tenth within it, and
linearly.
"""

SMEAR = 3
"""Side of the square within which the errors of pixels are correlated, pixels: a colour mosaic is interpolated from 3 x
3 pixels, a lens's point spread is no smaller, and specular reflections in a glossy side are as smooth.

White noise of variance s^2 gives a sum over n pixels the variance n s^2, shared noise n^2 s^2. Divided by n, the former
is s^2 for any n, the latter what shared noise contributes to the variance of a least-squares shift of equally smooth
texture.
"""

LEFT_OF_NOISE = 0.826
"""Fraction that `SMOOTHING` leaves of the variance of white noise's sums over such a square: the sum of squares of the
filter's own three-tap sums, divided by three."""

ROUNDING = 1 / 6
"""Variance of the difference of two grey values due to their rounding alone."""


@dataclass(frozen=True)
class Refined:
    """Disparities and their variance, pixels and pixels^2, shape (height, width).

    The disparity is NaN where no window that lies on one surface determines it.
    """

    values: Raster
    variance: Raster


def refine(left: Raster, right: Raster, reach: int, coarse: Raster, found: BoolArray, side: int) -> Refined:
    """Refine coarse disparities to sub-pixel precision.

    The sum of squared differences between the left and the shifted right image over a window is minimised (Lucas and
    Kanade, IJCAI 1981), starting from the mean of the coarse disparities over the window: the steps of these are the
    matcher's, and a mean over a symmetrical window preserves a slant.

    Where the coarse disparity jumps within the window, the window holds two surfaces, and a single shift would place
    points between them. There the pixel's disparity is extrapolated along a straight line from two adjacent windows
    that lie on one surface each (shiftable windows, Kang, Szeliski and Chai, CVPR 2001); of all such lines the one that
    differs least from the coarse disparity is taken. Without such a line, a pixel at a jump belongs to no surface and
    is dropped; one inside an object thinner than a window keeps its own window's estimate.

    Patterns that alternate from column to column come from a colour mosaic and not from the scene; they are removed
    first.

    The cameras may be exposed differently, and vignetting differs between lenses: the left image is first brought to
    the gain and offset of the right one, both estimated over a larger window.

    The variance is that of least squares with the window's own residual, which contains the image noise and also
    occlusion, specular reflection and other surfaces. Adjacent pixels share most of these errors, so the residual is
    taken from sums over `SMEAR` x `SMEAR` pixels: correlated errors are not averaged out, while independent noise of
    single pixels counts as before.

    Parameters
    ----------
    left : ndarray of uint8, shape (height, width)
    right : ndarray of uint8, shape (height, reach + width)
        With ``reach`` additional columns on the left.
    reach : int
    coarse : ndarray of float32, shape (height, width)
        Disparities of the matcher, pixels.
    found : ndarray of bool, shape (height, width)
        Where ``coarse`` is valid.
    side : int
        Side of the window, pixels, odd.
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
        other_gradient = cv2.filter2D(shifted, cv2.CV_32F, DERIVATIVE) * weight
        mean = (gradient + other_gradient) / 2
        # The product of both images' gradients, because the square of one would count its noise as texture.
        texture = gradient * other_gradient
        information = np.maximum(_sums(texture, side), LEAST_INFORMATION)
        # A pixel's difference already includes its own start value; wanted is one shift for the whole window.
        shift = _sums(mean * apart + texture * held, side) / information
        held = np.where(straddles, 0, shift)
    common = _sums(apart, SMEAR)
    noise = np.maximum(_sums(common * common, side) / np.maximum(LEFT_OF_NOISE * SMEAR**2 * count, 1.0), ROUNDING)
    variance = noise * np.maximum(_sums(mean * mean, side), information) / information**2
    return _continued(Refined(start + shift, variance), coarse, found, straddles, jump, side)


def _shifted(fine: Raster, u: Raster, v: Raster) -> Raster:
    return cv2.remap(fine, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def _exposed_alike(grey: Raster, other: Raster, weight: Raster, side: int) -> Raster:
    """Bring an image to the gain and offset of another one that shows the same surfaces at the same pixels.

    The gain is the ratio of standard deviations: regression underestimates it if both images are noisy.
    """
    window = EXPOSURE_WINDOWS * side | 1
    count = np.maximum(_sums(weight, window), 1.0)
    own_mean, own_deviation = _moments(grey * weight, count, window)
    other_mean, other_deviation = _moments(other * weight, count, window)
    gain = other_deviation / own_deviation
    alike: Raster = gain * (grey - own_mean) + other_mean
    return alike


def _moments(values: Raster, count: Raster, side: int) -> tuple[Raster, Raster]:
    """Return mean and standard deviation over windows, the latter with the rounding noise as its lower limit."""
    mean = _sums(values, side) / count
    return mean, np.sqrt(np.maximum(_sums(values * values, side) / count - mean * mean, ROUNDING))


def _upsampled(image: Raster) -> Raster:
    """Upsample rows with Lanczos' kernel of three lobes; OpenCV's cubic kernel biases shifts towards whole pixels."""
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
    """Return where disparity jumps; with holes filled from the nearer surface, jumps inside holes are found, too."""
    jumps: BoolArray = cv2.morphologyEx(filled, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > JUMP_PX
    return jumps


def _continued(
    refined: Refined, coarse: Raster, found: BoolArray, straddles: BoolArray, jump: BoolArray, side: int
) -> Refined:
    """Extrapolate to pixels without a window of their own: d = 2 d1 - d2 at steps of half a window and one pixel.

    ``straddles`` marks pixels whose window contains a jump of the disparity, ``jump`` those at the jump itself.
    """
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
        # Overlapping windows share noise in proportion to their overlap.
        shared = (1 - abs(down) * step / side) * (1 - abs(across) * step / side)
        variance[better] = (5 - 4 * shared) * refined.variance[v[better] + step * down, u[better] + step * across]
    values, variances = clean, refined.variance.copy()
    values[v, u], variances[v, u] = value, variance
    return Refined(values, variances)
