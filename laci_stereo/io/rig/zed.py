"""ZED cameras: Stereolabs' calibration file, SN<serial number>.conf, of raw images in each resolution.

Read as Stereolabs' tool for stereo calibration writes it from OpenCV's results: T is (-Baseline, TY, TZ) in
millimetres, and RX, CV, RZ are the rotation vector.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from laci_stereo.core.errors import RigError
from laci_stereo.core.frames import FloatArray
from laci_stereo.io.rig.document import Document
from laci_stereo.io.rig.stereo_rig import ForImages, Lens, Model, Size, StereoRig, side_by_side
from laci_stereo.io.text_file import listed

_MODES: Mapping[Size, str] = {
    (2208, 1242): "2K",
    (1920, 1080): "FHD",
    (1280, 720): "HD",
    (672, 376): "VGA",
    (1920, 1200): "FHD1200",
    (960, 600): "SVGA",
    (3840, 2160): "4K",
    (3200, 1800): "QHDPLUS",
}
"""Names of the resolutions in sections and entries."""

_ASIDE = ("TY", "TZ")
"""The translation's other two parts, which older files lack."""

_FIVE, _EIGHT = ("k1", "k2", "p1", "p2", "k3"), ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
_FISHEYE = ("k1", "k2", "k3", "k4")


def read_zed(document: Document, images: ForImages) -> StereoRig | None:
    """Read the calibration for the resolution of the images; None if the file is in another format.

    Raises
    ------
    RigError
    """
    if not any(name.startswith("LEFT_CAM_") for name in document.root):
        return None
    size = _size(document.name, images.size)
    mode = _MODES[size]
    left, right = (_lens(document, side, mode, size) for side in ("LEFT", "RIGHT"))
    stereo = document.part("STEREO")
    baseline = stereo.number("baseline", "Baseline")
    lacking = [name for name in _ASIDE if not (stereo.has(name) or stereo.has(f"{name}_{mode}"))]
    aside = [0.0 if name in lacking else stereo.number(name, name, f"{name}_{mode}") for name in _ASIDE]
    turn = [stereo.number(name, f"{name}_{mode}") for name in ("RX", "CV", "RZ")]
    notes = (
        f"ZED: the sections of {mode}, for raw (unrectified) images of {size[0]} x {size[1]} pixels",
        f"baseline {baseline:g} taken as millimetres, as the format says",
        *(f"{name}, which the file lacks, taken as 0" for name in lacking),
    )
    t_right_left_m = np.array([-baseline, *aside]) / 1000.0
    return StereoRig(left, right, Rotation.from_rotvec(turn).as_matrix(), t_right_left_m, notes)


def _size(name: str, size: Size | None) -> Size:
    sizes = listed([f"{width} x {height}" for width, height in _MODES])
    if size is None:
        raise RigError(f"{name} is of a ZED, in several resolutions; needed are the images that it is for")
    if size in _MODES:
        return size
    hint = next((words for mode in _MODES if (words := side_by_side(mode, size))), "")
    raise RigError(f"{name} is of a ZED, the images are {size[0]} x {size[1]} pixels{hint}; needed are {sizes}")


def _lens(document: Document, side: str, mode: str, size: Size) -> Lens:
    camera = document.part(f"{side}_CAM_{mode}")
    fx, fy, cx, cy = (camera.number(name, name) for name in ("fx", "fy", "cx", "cy"))
    coefficients, model = _distortion(camera if camera.has("k1") else document.part(f"{side}_DISTO"))
    return Lens(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), coefficients, size, model)


def _distortion(part: Document) -> tuple[FloatArray, Model]:
    """Return the coefficients of a section, and their model.

    Sections of a resolution have five. The one for all has eight, or four of a fisheye lens, padded with zeros or not.
    """
    names = _EIGHT if part.has("k4") else _FIVE
    others = [part.number(name, name) for name in names if name not in _FISHEYE and part.has(name)]
    if names is _EIGHT and not any(others):
        return np.array([part.number(name, name) for name in _FISHEYE]), "fisheye"
    return np.array([part.number(name, name) for name in names]), "pinhole"
