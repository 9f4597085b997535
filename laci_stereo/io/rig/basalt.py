"""Basalt's calibration.json: cameras with poses in the frame of an inertial sensor (IMU)."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from laci_stereo.core.errors import RigError
from laci_stereo.core.frames import FloatArray
from laci_stereo.io.file_storage import Node
from laci_stereo.io.rig.document import Document, numbers, whole_size
from laci_stereo.io.rig.stereo_rig import ForImages, Lens, Model, StereoRig
from laci_stereo.io.text_file import quoted

_COEFFICIENTS: dict[str, tuple[str, ...]] = {
    "pinhole": (),
    "pinhole-radtan4": ("k1", "k2", "p1", "p2"),
    "pinhole-radtan5": ("k1", "k2", "p1", "p2", "k3"),
    "pinhole-radtan8": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "kb4": ("k1", "k2", "k3", "k4"),
}
_PLACE = ("px", "py", "pz", "qx", "qy", "qz", "qw")


def read_basalt(document: Document, images: ForImages) -> StereoRig | None:
    """Read a calibration; None if the file is in another format.

    Raises
    ------
    RigError
    """
    inner = document.root.get("value0", document.root)
    if not isinstance(inner, dict) or not {"T_imu_cam", "intrinsics"} <= inner.keys():
        return None
    found = Document(document.name, inner)
    poses, lenses = (_cameras(found, name) for name in ("T_imu_cam", "intrinsics"))
    count = min(len(poses), len(lenses))
    if count < 2:
        raise RigError(f"{found.name}: {count} cameras have intrinsics and T_imu_cam; needed are two")
    first = images.left_camera or 0
    first = first if first + 1 < count else 0
    left, right = (_lens(lenses[number], found, number, images) for number in (first, first + 1))
    R_left, t_left = _pose(poses[first])
    R_right, t_right = _pose(poses[first + 1])
    return StereoRig(
        left,
        right,
        R_right.T @ R_left,
        R_right.T @ (t_left - t_right),
        (f"Basalt: camera {first} is left, {first + 1} right, of {count}; T_imu_cam maps a camera to the IMU, metres",),
    )


def _cameras(found: Document, name: str) -> list[Document]:
    node: Node = found.root[name]
    if not isinstance(node, list):
        raise RigError(f"{found.name}: {name} is no list; needed is one, of cameras")
    cameras = [Document(f"{found.name}: {name}[{i}]", each) for i, each in enumerate(node) if isinstance(each, dict)]
    if len(cameras) != len(node):
        raise RigError(f"{found.name}: {name} holds something that is no camera; needed is a list of cameras")
    return cameras


def _pose(camera: Document) -> tuple[FloatArray, FloatArray]:
    """Return R, shape (3, 3), and t, shape (3,), metres, of the transform from the camera to the IMU."""
    px, py, pz, *quaternion = (camera.number("pose", name) for name in _PLACE)
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1.0) <= 1e-3:
        raise RigError(f"{camera.name}: the quaternion's length is {length:g}; needed is 1")
    return Rotation.from_quat(quaternion).as_matrix(), np.array([px, py, pz])


def _lens(camera: Document, found: Document, number: int, images: ForImages) -> Lens:
    kind = camera.text("camera_type")
    if kind not in _COEFFICIENTS:
        raise RigError(
            f"{camera.name}: camera_type is {quoted(str(kind))}, which OpenCV's rectification does not know; needed is "
            "pinhole, pinhole-radtan8 or kb4 (basalt_calibrate --cam-types kb4 kb4)"
        )
    values = camera.part("intrinsics")
    fx, fy, cx, cy = (values.number("intrinsics", name) for name in ("fx", "fy", "cx", "cy"))
    coefficients = [values.number("distortion", name) for name in _COEFFICIENTS[kind]]
    model: Model = "fisheye" if kind == "kb4" else "pinhole"
    sizes = numbers(found.root.get("resolution", ""))
    if sizes is not None and sizes.ndim == 2 and sizes.shape[1] == 2 and number < len(sizes):
        size = whole_size(f"{found.name}: resolution", sizes[number])
    elif images.size is not None:
        size = images.size
    else:
        raise RigError(f"{found.name}: resolution[{number}] is missing; needed are width and height")
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return Lens(K, np.array(coefficients or [0.0] * 4), size, model)
