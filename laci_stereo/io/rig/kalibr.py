"""Kalibr: a camchain of cameras, each with the transform from the preceding one."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from laci_stereo.core.errors import RigError
from laci_stereo.core.frames import FloatArray
from laci_stereo.io.rig.document import Document, Entry
from laci_stereo.io.rig.stereo_rig import ForImages, Lens, Model, StereoRig
from laci_stereo.io.text_file import listed, quoted

_CHAIN = Entry("transform from the camera before it", ("T_cn_cnm1",))
_MODELS: Mapping[str, Model] = {"radtan": "pinhole", "equidistant": "fisheye", "none": "pinhole"}


def read_kalibr(document: Document, images: ForImages) -> StereoRig | None:
    """Read a camchain; None if the file is in another format.

    Raises
    ------
    RigError
    """
    cameras = sorted(name for name in document.root if re.fullmatch(r"cam\d{1,2}", name))
    chain = [name for name in cameras if isinstance(document.root[name], dict)]
    if not chain or not document.part(chain[0]).has("intrinsics", "distortion_model"):
        return None
    if len(chain) < 2:
        raise RigError(f"{document.name}: the camchain has {listed(chain)} only; needed are two cameras")
    first = images.left_camera or 0
    names = (f"cam{first}", f"cam{first + 1}")
    if not set(names) <= set(chain):
        names = (chain[0], chain[1])
    left, right = (document.part(name) for name in names)
    T_right_left = right.array(_CHAIN, (4, 4))
    _check_last_row(right.name, T_right_left)
    return StereoRig(
        _lens(left, images),
        _lens(right, images),
        T_right_left[:3, :3],
        T_right_left[:3, 3],
        (f"Kalibr camchain: {names[0]} is left, {names[1]} right, of {len(chain)} cameras; T_cn_cnm1 in metres",),
    )


def _check_last_row(name: str, T: FloatArray) -> None:
    if not np.allclose(T[3], [0.0, 0.0, 0.0, 1.0]):
        raise RigError(f"{name}: T_cn_cnm1 ends in {T[3]}; needed is a rigid transform, which ends in 0, 0, 0, 1")


def _lens(camera: Document, images: ForImages) -> Lens:
    projection, distortion = camera.text("camera_model"), camera.text("distortion_model")
    if projection != "pinhole":
        raise RigError(
            f"{camera.name}: camera_model is {quoted(str(projection))}, which OpenCV's rectification does not know; "
            "needed is pinhole (kalibr_calibrate_cameras --models pinhole-radtan or pinhole-equi)"
        )
    model = _MODELS.get(str(distortion))
    if model is None:
        raise RigError(
            f"{camera.name}: distortion_model is {quoted(str(distortion))}; needed is radtan, equidistant or none "
            "(kalibr_calibrate_cameras --models pinhole-radtan or pinhole-equi)"
        )
    fx, fy, cx, cy = camera.array(Entry("intrinsics", ("intrinsics",)), (4,))
    coefficients = (
        np.zeros(4) if distortion == "none" else camera.array(Entry("distortion", ("distortion_coeffs",)), (4,))
    )
    size = camera.size() or images.size
    if size is None:
        raise RigError(f"{camera.name} lacks the image size; needed is resolution")
    return Lens(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), coefficients, size, model)
