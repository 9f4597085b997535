"""Reading the images of a recording as 8-bit grey, with the unreadable ones counted and named."""

from __future__ import annotations

import logging
from pathlib import Path

import cv2
import numpy as np

from laci_stereo.core.errors import ImageError
from laci_stereo.core.frames import Raster
from laci_stereo.io.images import read_image
from laci_stereo.io.stereo_calibration import StereoRig

log = logging.getLogger(__name__)

MAX_BAD_SHARE = 0.2
"""A larger share of unreadable frames is an error."""

FILLED_BITS = (10, 12, 14, 16)
"""What cameras with 16-bit images fill of them."""


class EightBit:
    """Brings the images of one camera to 8 bit; how many of 16 bits are filled, the first image tells."""

    def __init__(self) -> None:
        self._scale: float | None = None

    def grey(self, image: Raster) -> Raster:
        """Return an image as grey, uint8, shape (height, width)."""
        return self._scaled(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image)

    def colour(self, image: Raster) -> Raster:
        """Return an image as blue-green-red, uint8, shape (height, width, 3)."""
        return self._scaled(image) if image.ndim == 3 else cv2.cvtColor(self._scaled(image), cv2.COLOR_GRAY2BGR)

    def _scaled(self, image: Raster) -> Raster:
        if image.dtype == np.uint8:
            return image
        if self._scale is None:
            self._scale = 255.0 / next(2**bits - 1 for bits in FILLED_BITS if int(image.max()) < 2**bits)
        return cv2.convertScaleAbs(image, alpha=self._scale)


class GreyReader:
    """Reads raw images of one rig.

    Attributes
    ----------
    skipped : dict of Path to str
        The images that could not be used, each with the reason, in one line.
    eight_bit : EightBit
    """

    def __init__(self, rig: StereoRig) -> None:
        self.skipped: dict[Path, str] = {}
        self._sizes = {rig.left.size, rig.right.size}
        self.eight_bit = EightBit()

    def read(self, path: Path) -> Raster | None:
        """Return an image as grey, uint8, shape (height, width); None, and a line in `skipped`, if it is unusable."""
        image = self.raw(path)
        return None if image is None else self.eight_bit.grey(image)

    def raw(self, path: Path) -> Raster | None:
        """Return an image as it was stored; None, and a line in `skipped`, if it is unusable."""
        try:
            image = read_image(path)
            self._check_size(path, image)
        except ImageError as error:
            if path not in self.skipped:
                log.info("%s", error)
            self.skipped[path] = str(error)
            return None
        return image

    def colour(self, path: Path) -> Raster:
        """Return an image as 8-bit blue-green-red, shape (height, width, 3), to draw on.

        Raises
        ------
        ImageError
            If it is unusable.
        """
        return self.eight_bit.colour(read_image(path))

    def check(self, attempted: int) -> None:
        """Raise if more than a fifth of the frames could not be read.

        Raises
        ------
        ImageError
        """
        if len(self.skipped) > MAX_BAD_SHARE * attempted:
            raise ImageError(
                f"{len(self.skipped)} of {attempted} frames are unusable; needed are at least "
                f"{1 - MAX_BAD_SHARE:.0%} usable ones; the first: {self.first_complaint()}"
            )

    def first_complaint(self) -> str:
        """Return the reason of the first image that could not be used."""
        return self.skipped[min(self.skipped)]

    def _check_size(self, path: Path, image: Raster) -> None:
        size = (image.shape[1], image.shape[0])
        if size not in self._sizes:
            wanted = " or ".join(f"{width}x{height}" for width, height in sorted(self._sizes))
            raise ImageError(f"{path}: the image is {size[0]}x{size[1]} pixels; the stereo calibration is for {wanted}")
