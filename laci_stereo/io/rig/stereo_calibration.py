"""Calibrations of stereo cameras, read from the files that calibration tools write."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from laci_stereo.core.errors import RigError
from laci_stereo.io.rig.basalt import read_basalt
from laci_stereo.io.rig.depthai import read_depthai
from laci_stereo.io.rig.document import Document
from laci_stereo.io.rig.kalibr import read_kalibr
from laci_stereo.io.rig.kitti import read_kitti, read_kitti_rectified
from laci_stereo.io.rig.matlab import read_matlab
from laci_stereo.io.rig.middlebury import read_middlebury
from laci_stereo.io.rig.opencv import read_opencv
from laci_stereo.io.rig.ros import read_ros
from laci_stereo.io.rig.stereo_rig import (
    ForImages,
    Size,
    StereoRig,
    check_resolution,
    check_rig,
    check_size,
    with_baseline,
)
from laci_stereo.io.rig.syntax import read_document
from laci_stereo.io.rig.zed import read_zed
from laci_stereo.io.text_file import listed

CALIBRATION_FILES: tuple[tuple[str, ...], ...] = (
    *((f"stereo.{suffix}",) for suffix in ("yaml", "yml", "json", "xml", "txt", "mat", "npz")),
    *((f"left.{suffix}", f"right.{suffix}") for suffix in ("yaml", "yml")),
    *((f"intrinsics.{suffix}", f"extrinsics.{suffix}") for suffix in ("yml", "yaml", "xml", "json")),
    ("*camchain*.yaml",),
    ("calib.txt",),
    ("calib_cam_to_cam.txt",),
    ("SN*.conf",),
)
"""File names by which a calibration is found, in order of preference; its format is recognised by its content."""

_USUAL = (
    "stereo.yaml, left.yaml with right.yaml, intrinsics.yml with extrinsics.yml, camchain*.yaml, calib.txt, "
    "calib_cam_to_cam.txt or SN*.conf"
)

Reader: TypeAlias = Callable[[Document, ForImages], StereoRig | None]

_IN_ONE_FILE: tuple[Reader, ...] = (
    read_kalibr,
    read_kitti,
    read_kitti_rectified,
    read_middlebury,
    read_matlab,
    read_basalt,
    read_depthai,
    read_zed,
)
"""Readers of formats of a single file, in the order in which they are tried; one returns None for another format."""


def calibration_files(given: Path | Sequence[Path], left_folder: Path) -> tuple[Path, ...]:
    """Return the files of a stereo calibration: those given, or those found beside the left images.

    One or two files are given, or a folder that holds them under their usual names; if nothing is, the folder of
    ``left_folder`` is searched.

    Raises
    ------
    RigError
        If no calibration is found.
    """
    paths = (given,) if isinstance(given, Path) else tuple(given)
    if not paths:
        beside = left_folder.absolute().parent
        found = _found_in(beside)
        if not found:
            raise RigError(f"{beside}: no {_USUAL}; needed is one, or --stereo FILE (of rig: FILE before LEFT)")
        return found
    if len(paths) == 1 and paths[0].is_dir():
        found = _found_in(paths[0])
        if not found:
            raise RigError(f"{paths[0]} is a folder; needed is a file, or a folder with {_USUAL}")
        return found
    return paths


def read_stereo_calibration(
    files: Path | Sequence[Path],
    image_size: Size | None = None,
    left_folder: Path | None = None,
    baseline_m: float | None = None,
    right_folder: Path | None = None,
) -> StereoRig:
    """Read a stereo calibration and check that it is plausible.

    Parameters
    ----------
    files : path, or sequence of path
        One or two files, in any format of docs/stereo-calibrations.md.
    image_size : tuple of int, optional
        Width and height of the images to be calibrated, pixels.
    left_folder, right_folder : path, optional
        The folders of the images; their names may determine which cameras of a file with several are meant.
    baseline_m : float, optional
        The distance between the cameras, where the file's lengths are in an unknown unit.

    Raises
    ------
    RigError
        If the calibration cannot be read, lacks an entry, is for images of another size, or describes no usable stereo
        camera.
    """
    rig = read_rig(files, ForImages(image_size, left_folder, baseline_m, right_folder))
    if image_size is not None:
        check_size(_names(files), rig, image_size)
    return rig


def read_rig(files: Path | Sequence[Path], images: ForImages) -> StereoRig:
    """Read a stereo calibration as `read_stereo_calibration` does, but for images of any size.

    Raises
    ------
    RigError
    """
    paths = (files,) if isinstance(files, Path) else tuple(files)
    if not 1 <= len(paths) <= 2:
        raise RigError(
            f"{len(paths)} files are given as the stereo calibration; needed is one, or two that belong together"
        )
    documents = [read_document(path) for path in paths]
    with np.errstate(all="ignore"):  # huge numbers overflow to infinity, which is refused
        rig = _read(documents, images)
        if images.baseline_m is not None:
            rig = with_baseline(_names(paths), rig, images.baseline_m)
        if images.size is not None and rig.left.size == images.size and not _tells_size(documents, images):
            check_resolution(_names(paths), rig)
        check_rig(_names(paths), rig)
        return rig if rig.rectified is None or _usable(rig.rectified) else replace(rig, rectified=None)


def _read(documents: Sequence[Document], images: ForImages) -> StereoRig:
    if (rig := read_ros(documents, images)) is not None:
        return rig
    readers = _IN_ONE_FILE if len(documents) == 1 else ()
    found = (rig for read in readers if (rig := read(documents[0], images)) is not None)
    return next(found, None) or read_opencv(documents, images)


def _tells_size(documents: Sequence[Document], images: ForImages) -> bool:
    """Return whether the files state the image size."""
    try:
        _read(documents, replace(images, size=None))
    except RigError:
        return False
    return True


def _usable(rig: StereoRig) -> bool:
    try:
        check_rig("", rig)
    except RigError:
        return False
    return True


def _names(files: Path | Sequence[Path]) -> str:
    return str(files) if isinstance(files, Path) else " + ".join(map(str, files))


def _found_in(folder: Path) -> tuple[Path, ...]:
    for names in CALIBRATION_FILES:
        if "*" in names[0]:
            found = sorted(path for path in folder.glob(names[0]) if path.is_file())
            if len(found) > 1:
                raise RigError(
                    f"{folder} holds {listed([path.name for path in found])}; needed is one of them, as --stereo FILE"
                )
        else:
            found = [folder / name for name in names if (folder / name).is_file()]
        if len(found) == len(names):
            return tuple(found)
    return ()
