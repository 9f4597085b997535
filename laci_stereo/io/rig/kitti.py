"""KITTI: calib_cam_to_cam.txt of the raw data, and P0 to P3 of the odometry and object data."""

from __future__ import annotations

import re

from laci_stereo.core.errors import RigError
from laci_stereo.io.rig.document import Document, Entry, whole_size
from laci_stereo.io.rig.stereo_rig import ForImages, Lens, Size, StereoRig, rectified_pair
from laci_stereo.io.text_file import listed

_PAIRS = ((2, 3), (0, 1))
"""The colour and the grey pair of cameras; all four are side by side."""


def read_kitti(document: Document, images: ForImages) -> StereoRig | None:
    """Read a calib_cam_to_cam.txt for raw or, by their size, rectified images; None if the file is in another format.

    Raises
    ------
    RigError
    """
    cameras = {int(name[-1]) for name in document.root if re.fullmatch(r"(?:K|P_rect)_0[0-3]", name)}
    if not cameras:
        return None
    (left, right), chosen = _pair(document.name, cameras, images)
    rectified = None
    if document.has(f"P_rect_0{left}", f"P_rect_0{right}", f"S_rect_0{left}"):
        size = whole_size(document.name, document.array(_entry("S_rect", left), (2,)))
        rectified = _rectified(document, f"P_rect_0{left}", f"P_rect_0{right}", size, (chosen,))
    left_lens, right_lens = (_lens(document, camera, images.size) for camera in (left, right))
    if rectified is not None and rectified.left.size == images.size != left_lens.size:
        return rectified
    R_left, R_right = (document.array(_entry("R", camera), (3, 3)) for camera in (left, right))
    T_left, T_right = (document.array(_entry("T", camera), (3,)) for camera in (left, right))
    R_right_left = R_right @ R_left.T
    notes = ("KITTI raw data: for the images before rectification (K, D, R, T)", chosen)
    return StereoRig(left_lens, right_lens, R_right_left, T_right - R_right_left @ T_left, notes, rectified)


def read_kitti_rectified(document: Document, images: ForImages) -> StereoRig | None:
    """Read P0 to P3, the projection matrices of rectified images; None if the file has none.

    Raises
    ------
    RigError
    """
    cameras = {int(name[1]) for name in document.root if re.fullmatch(r"P[0-3]", name)}
    if not any(set(pair) <= cameras for pair in _PAIRS):
        return None
    (left, right), chosen = _pair(document.name, cameras, images)
    if images.size is None:
        raise RigError(f"{document.name} lacks the image size, as KITTI's do; needed are the images that it is for")
    return _rectified(document, f"P{left}", f"P{right}", images.size, (chosen, "image size taken from the images"))


def _rectified(document: Document, left: str, right: str, size: Size, notes: tuple[str, ...]) -> StereoRig:
    left_P, right_P = (document.array(Entry("projection", (name,)), (3, 4)) for name in (left, right))
    said = f"KITTI, for rectified images: {left} and {right}; the sensor is the rectified left camera"
    return rectified_pair(left_P, right_P, size, (said, *notes))


def _pair(name: str, cameras: set[int], images: ForImages) -> tuple[tuple[int, int], str]:
    """Return the numbers of the left and the right camera, and a note on the reason for this choice."""
    pair, chosen = _pair_by_left(name, cameras, images.left_camera)
    if images.left_camera in cameras and images.right_camera in cameras and images.right_camera != pair[1]:
        raise RigError(
            f"{name}: the images are of cameras {images.left_camera} and {images.right_camera}, as their folders are "
            "numbered; needed are those of cameras 0 and 1, or 2 and 3, the left one first"
        )
    return pair, chosen


def _pair_by_left(name: str, cameras: set[int], named: int | None) -> tuple[tuple[int, int], str]:
    if named is not None and {named, named + 1} <= cameras:
        return (named, named + 1), f"cameras {named} and {named + 1}, as the folder of the left images is numbered"
    found = next((pair for pair in _PAIRS if set(pair) <= cameras), None)
    if found is None:
        raise RigError(
            f"{name} has camera {listed([str(camera) for camera in sorted(cameras)])}; needed are 0 and 1, or 2 and 3: "
            "of raw data, their S, K, D, R and T, as the calib_cam_to_cam.txt of the day has them"
        )
    return found, f"cameras {found[0]} and {found[1]}; a left folder called image_00 or image_02 would tell which"


def _lens(document: Document, camera: int, image_size: Size | None) -> Lens:
    if document.has(f"S_0{camera}"):
        size = whole_size(document.name, document.array(_entry("S", camera), (2,)))
    elif image_size is not None:
        size = image_size
    else:
        raise RigError(f"{document.name} lacks S_0{camera}, the image size; needed is width and height")
    return Lens(document.array(_entry("K", camera), (3, 3)), document.array(_entry("D", camera), (5,)), size, "pinhole")


def _entry(letter: str, camera: int) -> Entry:
    return Entry(f"{letter} of camera {camera}", (f"{letter}_0{camera}",))
