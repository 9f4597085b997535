"""Reading the images of a recording as 8-bit grey; unreadable images are counted and named."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np

from laci_stereo.core.cloud import MAX_BAD_SHARE
from laci_stereo.core.errors import ImageError
from laci_stereo.core.frames import Raster
from laci_stereo.io.images import MOST_BITS, read_image
from laci_stereo.io.rig.stereo_rig import StereoRig

log = logging.getLogger(__name__)

FILLED_BITS = (10, 12, 14, 16)
"""Numbers of bits that cameras use of 16-bit images."""

LUMINANCE = np.array([[0.25, 0.5, 0.25]], np.float32)
"""Weights of blue, green and red, which are their fractions in a colour mosaic: with these, the pattern that the mosaic
superimposes along rows and columns cancels out (Alleysson, Suesstrunk and Herault, IEEE Trans. Image Processing 2005).
With other weights, it remains."""


class EightBit:
    """Converts the images of one camera to 8 bits; the number of bits that 16-bit images use is learnt from samples.

    Attributes
    ----------
    bits : int
        Number of bits in use; 0 until an image has been seen.
    """

    def __init__(self) -> None:
        self.bits = 0

    def learn(self, image: Raster) -> None:
        """Raise the number of bits in use to that of an image, if it is larger."""
        if image.dtype != np.uint8:
            self.bits = max(self.bits, next(bits for bits in FILLED_BITS if int(image.max()) < 2**bits))

    def learn_from(self, paths: Iterable[Path]) -> None:
        """Learn from all readable files: a dark image alone does not show how many bits brighter ones use."""
        for path in paths:
            try:
                image = read_image(path)
            except ImageError:
                continue
            if image.dtype == np.uint8:
                return
            self.learn(image)

    def exceeded_by(self, image: Raster) -> bool:
        """Return whether an image uses more bits than were learnt, so that its brightest parts are clipped to white."""
        return 0 < self.bits < MOST_BITS and image.dtype != np.uint8 and int(image.max()) >= 2**self.bits

    def grey(self, image: Raster) -> Raster:
        """Return an image as grey, uint8, shape (height, width)."""
        return self._scaled(cv2.transform(image, LUMINANCE) if image.ndim == 3 else image)

    def colour(self, image: Raster) -> Raster:
        """Return an image as blue-green-red, uint8, shape (height, width, 3)."""
        return self._scaled(image) if image.ndim == 3 else cv2.cvtColor(self._scaled(image), cv2.COLOR_GRAY2BGR)

    def _scaled(self, image: Raster) -> Raster:
        if image.dtype == np.uint8:
            return image
        if self.bits == 0:
            self.learn(image)
        return cv2.convertScaleAbs(image, alpha=255.0 / (2**self.bits - 1))


class GreyReader:
    """Reads the raw images of one rig.

    Attributes
    ----------
    skipped : dict of Path to str
        The images that could not be used, each with a one-line reason.
    eight_bit : EightBit
    brighter : dict of Path to int
        Images that use more bits than were learnt, each with its largest value.
    """

    def __init__(self, rig: StereoRig) -> None:
        self.skipped: dict[Path, str] = {}
        self._sizes = {rig.left.size, rig.right.size}
        self.eight_bit = EightBit()
        self.brighter: dict[Path, int] = {}

    def remarks(self) -> tuple[str, ...]:
        """Return a note on the images that use more bits than were learnt, if there are any."""
        if not self.brighter:
            return ()
        first = min(self.brighter)
        words = (
            f"{first}: the brightest pixel is {self.brighter[first]}, and in the images that were looked at first none "
            f"is above {2**self.eight_bit.bits - 1}, which is taken for white; {len(self.brighter)} images are like it"
        )
        return (words,)

    def read(self, path: Path) -> Raster | None:
        """Return an image as grey, uint8, shape (height, width); if unusable, None, and `skipped` gets the reason."""
        image = self.raw(path)
        return None if image is None else self.eight_bit.grey(image)

    def raw(self, path: Path) -> Raster | None:
        """Return an image as stored; if unusable, None, and `skipped` gets the reason."""
        try:
            image = read_image(path)
            self._check_size(path, image)
        except ImageError as error:
            if path not in self.skipped:
                log.info("%s", error)
            self.skipped[path] = str(error)
            return None
        if self.eight_bit.exceeded_by(image):
            self.brighter[path] = int(image.max())
        return image

    def colour(self, path: Path) -> Raster:
        """Return an image as 8-bit blue-green-red, shape (height, width, 3), for drawings.

        Raises
        ------
        ImageError
            If the image cannot be read.
        """
        return self.eight_bit.colour(read_image(path))

    def check(self, frames: Sequence[tuple[Path, ...]]) -> None:
        """Check the fraction of frames one of whose images could not be used.

        Raises
        ------
        ImageError
            If it is more than a fifth.
        """
        unusable = sum(any(path in self.skipped for path in images) for images in frames)
        if unusable > MAX_BAD_SHARE * len(frames):
            raise ImageError(
                f"of what was read so far, {unusable} of {len(frames)} frames are unusable; needed are at least "
                f"{1 - MAX_BAD_SHARE:.0%} usable ones; the first: {self.first_complaint()}"
            )

    def first_complaint(self) -> str:
        """Return the reason of the first unusable image, in order of paths."""
        return self.skipped[min(self.skipped)]

    def _check_size(self, path: Path, image: Raster) -> None:
        size = (image.shape[1], image.shape[0])
        if size not in self._sizes:
            wanted = " or ".join(f"{width}x{height}" for width, height in sorted(self._sizes))
            raise ImageError(f"{path}: the image is {size[0]}x{size[1]} pixels; the stereo calibration is for {wanted}")
