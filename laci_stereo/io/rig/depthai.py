"""OAK cameras: DepthAI's calibration JSON, with cameras by socket, each with the transform to another one."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from laci_stereo.core.errors import RigError
from laci_stereo.core.frames import FloatArray, invert, rigid
from laci_stereo.io.file_storage import Node
from laci_stereo.io.rig.document import Document, Entry
from laci_stereo.io.rig.stereo_rig import ForImages, Lens, Model, StereoRig
from laci_stereo.io.text_file import listed

_MODELS: dict[int, Model] = {0: "pinhole", 1: "fisheye"}
_SOCKETS = (1, 2)
"""Sockets of the left and the right camera where the file does not state them: CAM_B and CAM_C."""

_Cameras = Mapping[int, Document]


def read_depthai(document: Document, _images: ForImages) -> StereoRig | None:
    """Read a file that ``eepromToJsonFile`` wrote; None if the file is in another format.

    Raises
    ------
    RigError
    """
    listing = document.root.get("cameraData")
    if not isinstance(listing, list):
        return None
    cameras = _cameras(document.name, listing)
    left, right = _sockets(document)
    missing = {left, right} - cameras.keys()
    if missing:
        raise RigError(
            f"{document.name}: cameraData has the sockets {listed([str(socket) for socket in cameras])}; "
            f"needed are the left and the right camera's, {left} and {right}"
        )
    from_left, from_right = _chain(cameras, left), _chain(cameras, right)
    common = next((socket for socket in from_left if socket in from_right), None)
    if common is None:
        raise RigError(
            f"{document.name}: the extrinsics of the sockets {left} and {right} lead to no camera that both lead to; "
            "needed are extrinsics that do"
        )
    T_right_left = invert(from_right[common]) @ from_left[common]
    notes = (
        f"DepthAI: socket {left} is the left camera, socket {right} the right one",
        "extrinsics lead from a camera to its toCameraSocket; centimetres",
    )
    lenses = [_lens(cameras[socket]) for socket in (left, right)]
    return StereoRig(lenses[0], lenses[1], T_right_left[:3, :3], T_right_left[:3, 3], notes)


def _cameras(name: str, listing: list[Node]) -> dict[int, Document]:
    cameras: dict[int, Document] = {}
    for item in listing:
        if not (isinstance(item, list) and len(item) == 2 and isinstance(item[0], float) and isinstance(item[1], dict)):
            raise RigError(
                f"{name}: cameraData holds something that is no pair of a socket and a camera; needed are these"
            )
        socket = _whole(name, item[0])
        cameras[socket] = Document(f"{name}: socket {socket}", item[1])
    return cameras


def _sockets(document: Document) -> tuple[int, int]:
    """Return the sockets of the left and the right camera."""
    if not document.has("stereoRectificationData"):
        return _SOCKETS
    told = document.part("stereoRectificationData")
    left, right = (
        _whole(told.name, told.number("socket", name)) if told.has(name) else -1
        for name in ("leftCameraSocket", "rightCameraSocket")
    )
    return (left, right) if left >= 0 and right >= 0 and left != right else _SOCKETS


def _whole(name: str, value: float) -> int:
    if not (-1 <= value <= 100 and value == int(value)):
        raise RigError(f"{name}: a socket is {value:g}; needed is a small whole number")
    return int(value)


def _chain(cameras: _Cameras, start: int) -> dict[int, FloatArray]:
    """Follow the extrinsics from a camera; return the transforms, shape (4, 4), from it to each camera on the way."""
    chain, socket = {start: np.eye(4)}, start
    while True:
        extrinsics = cameras[socket].part("extrinsics")
        onward = _whole(extrinsics.name, extrinsics.number("socket", "toCameraSocket"))
        if onward not in cameras or onward in chain:
            return chain
        chain[onward] = _transform(extrinsics) @ chain[socket]
        socket = onward


def _transform(extrinsics: Document) -> FloatArray:
    """Return the transform, shape (4, 4), metres, from a camera to its ``toCameraSocket``."""
    measured, designed = (
        np.array([extrinsics.part(name).number("translation", axis) for axis in "xyz"])
        if extrinsics.has(name)
        else np.zeros(3)
        for name in ("translation", "specTranslation")
    )
    translation = measured if measured.any() else designed
    return rigid(extrinsics.array(Entry("rotation", ("rotationMatrix",)), (3, 3)), translation / 100.0)


def _lens(camera: Document) -> Lens:
    kind = camera.number("camera type", "cameraType") if camera.has("cameraType") else 0.0
    model = _MODELS.get(int(kind)) if kind in (0.0, 1.0) else None
    if model is None:
        raise RigError(f"{camera.name}: cameraType is {kind:g}; needed is 0 (perspective) or 1 (fisheye)")
    size = camera.size()
    if size is None:
        raise RigError(f"{camera.name} lacks the image size; needed are width and height")
    shapes = ((4,), (5,), (8,), (12,), (14,))
    distortion = camera.array(Entry("distortion", ("distortionCoeff",)), *shapes)
    K = camera.array(Entry("camera matrix", ("intrinsicMatrix",)), (3, 3))
    return Lens(K, distortion[:4] if model == "fisheye" else distortion, size, model)
