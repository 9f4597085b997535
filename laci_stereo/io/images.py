"""Folders of images with their times, pairs of images, and reading and writing images."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import cv2
import numpy as np
import numpy.typing as npt

from laci_stereo.core.errors import ImageError, OutputError
from laci_stereo.core.frames import IntArray, Raster
from laci_stereo.io.file_content import read_bytes
from laci_stereo.io.image_integrity import damage
from laci_stereo.io.image_size import stated_bits, stated_size
from laci_stereo.io.output import write_file
from laci_stereo.io.stamps import iso_text
from laci_stereo.io.timed_files import FileKind, in_time, names_in

Image: TypeAlias = npt.NDArray[np.uint8] | npt.NDArray[np.uint16]
"""Grey, shape (h, w), or blue-green-red, shape (h, w, 3)."""

IMAGES = FileKind(
    "image",
    frozenset({".bmp", ".jpe", ".jpeg", ".jpg", ".pgm", ".png", ".pnm", ".ppm", ".tif", ".tiff", ".webp"}),
    "PNG, JPEG, TIFF, PGM or BMP",
    ImageError,
)

MOST_PIXELS = 100_000_000
"""Most pixels of an image, four times as many as roadside cameras have. With four channels of 16 bits, such an image
decodes to 0.8 GB, and a header of a few bytes may state any size."""

MOST_BITS = 16
"""Most bits per channel; TIFFs may have 64."""

# We report a damaged image in one line; OpenCV's own warnings would repeat it with its source lines.
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)


@dataclass(frozen=True)
class ImageFolder:
    """The image files of one camera, ordered by time; no image has been read yet.

    ``stamps_ns``, shape (n,), are Unix times, strictly ascending.
    """

    path: Path
    files: tuple[Path, ...]
    stamps_ns: IntArray

    def __len__(self) -> int:
        return len(self.files)

    @classmethod
    def open(cls, path: Path) -> ImageFolder:
        """List the images in a folder, without hidden files and files in other formats.

        Raises
        ------
        ImageError
            If the folder is missing or holds no image, or an image has no time or the same time as another one.
        """
        return cls(path, *in_time(path, names_in(path, IMAGES), IMAGES))

    @property
    def period_ns(self) -> float:
        """The median interval between two images, nanoseconds."""
        return float(np.median(np.diff(self.stamps_ns)))


@dataclass(frozen=True)
class StereoPair:
    """Two images that were taken together, with the time of the left one (Unix, nanoseconds)."""

    stamp_ns: int
    left: Path
    right: Path

    @property
    def images(self) -> tuple[Path, Path]:
        """The left and the right image."""
        return self.left, self.right


@dataclass(frozen=True)
class Pairs:
    """The image pairs of a stereo recording, ordered by time.

    Attributes
    ----------
    pairs : tuple of StereoPair
    apart_ns : ndarray of int64, shape (n,)
        Absolute time difference between the images of each pair.
    unpaired_left, unpaired_right : int
        Numbers of images without a partner.
    """

    pairs: tuple[StereoPair, ...]
    apart_ns: IntArray
    unpaired_left: int
    unpaired_right: int

    def __len__(self) -> int:
        return len(self.pairs)


def pair_images(left: ImageFolder, right: ImageFolder) -> Pairs:
    """Pair the images of two cameras one to one by nearest time, within half a frame period.

    Raises
    ------
    ImageError
        If both folders are the same, one holds fewer than two images, or fewer than half of the images find a partner.
    """
    if left.path.resolve() == right.path.resolve():
        raise ImageError(f"{left.path} is given for the left and the right images; needed are two folders")
    for folder in (left, right):
        if len(folder) < 2:
            raise ImageError(f"{folder.path} holds {len(folder)} image; needed are at least 2")
    tolerance_ns = min(left.period_ns, right.period_ns) / 2
    partner = _nearest(left.stamps_ns, right.stamps_ns)
    gap_ns = np.abs(right.stamps_ns[partner] - left.stamps_ns)
    mutual = _nearest(right.stamps_ns, left.stamps_ns)[partner] == np.arange(len(left))
    paired = np.flatnonzero(mutual & (gap_ns <= tolerance_ns))
    pairs = tuple(StereoPair(int(left.stamps_ns[i]), left.files[i], right.files[partner[i]]) for i in paired)
    if 2 * len(pairs) < max(len(left), len(right)):
        difference_s = int(right.stamps_ns[0] - left.stamps_ns[0]) / 1e9
        raise ImageError(
            f"{len(pairs)} pairs are within half a frame period ({tolerance_ns / 1e6:.1f} ms); needed are at least "
            f"half of the images: {_span(left)}, {_span(right)}, difference {difference_s:.1f} s"
        )
    return Pairs(pairs, gap_ns[paired], len(left) - len(pairs), len(right) - len(pairs))


def write_picture(path: Path, picture: Raster) -> None:
    """Write a picture completely or not at all, in the format that the file's name determines.

    Raises
    ------
    OutputError
    """
    encoded, content = cv2.imencode(path.suffix, picture)
    if not encoded:
        raise OutputError(f"{path}: cannot be encoded as {path.suffix}")
    write_file(path, content.tobytes())


def read_image(path: Path) -> Image:
    """Read an image as stored: 8 or 16 bits, grey or colour, without alpha, not rotated by its EXIF data.

    Raises
    ------
    ImageError
        If the file is missing, no image, larger than `MOST_PIXELS`, cut off or otherwise damaged.
    """
    content = read_bytes(path, ImageError, "an image")
    damaged = damage(content)
    if damaged is not None:
        raise ImageError(f"{path} {damaged}; needed is a whole image")
    image = _decoded(path, content)
    if image.dtype not in (np.uint8, np.uint16):
        raise ImageError(f"{path} has pixels of type {image.dtype}; needed are 8 or 16 bit integers")
    return _without_alpha(image)


def _decoded(path: Path, content: bytes) -> npt.NDArray[np.generic]:
    image, problem = None, None
    size = stated_size(content)
    if size is not None:
        if size[0] * size[1] > MOST_PIXELS:
            raise ImageError(
                f"{path} has {size[0]} x {size[1]} pixels; needed are at most {MOST_PIXELS / 1e6:.0f} megapixels"
            )
        bits = stated_bits(content)
        if bits > MOST_BITS:
            raise ImageError(f"{path} has pixels of {bits} bits; needed are 8 or 16 bit integers")
        try:
            image = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error as error:
            problem = error
    if image is None:
        raise ImageError(f"{path} cannot be decoded ({len(content)} bytes); needed is a whole image") from problem
    return image


def first_size(files: Iterable[Path]) -> tuple[int, int]:
    """Return the width and height of the first image that can be read.

    Raises
    ------
    ImageError
        The error of the first image, if none can be read.
    """
    problem: ImageError | None = None
    for path in files:
        try:
            height, width = read_image(path).shape[:2]
        except ImageError as error:
            problem = problem or error
        else:
            return width, height
    assert problem is not None  # a folder of images holds at least one
    raise problem


def _without_alpha(image: npt.NDArray[np.generic]) -> Image:
    if image.ndim == 3:
        image = image[:, :, 0] if image.shape[2] < 3 else image[:, :, :3]
    return np.ascontiguousarray(image)


def _nearest(stamps_ns: IntArray, among_ns: IntArray) -> IntArray:
    """Return for each stamp the index of the nearest of the others; of two equally near ones, the earlier."""
    after = np.searchsorted(among_ns, stamps_ns).clip(1, len(among_ns) - 1)
    before = after - 1
    nearer_before = stamps_ns - among_ns[before] <= among_ns[after] - stamps_ns
    return np.where(nearer_before, before, after)


def _span(folder: ImageFolder) -> str:
    first, last = int(folder.stamps_ns[0]), int(folder.stamps_ns[-1])
    return f"{folder.path} ({len(folder)} images) spans {iso_text(first)} to {iso_text(last)}"
