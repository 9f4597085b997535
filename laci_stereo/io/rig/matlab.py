"""MATLAB's stereoParameters, converted to a struct, in a .mat file or in JSON."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from laci_stereo.core.errors import RigError
from laci_stereo.core.frames import FloatArray
from laci_stereo.io.rig.document import Document, Entry, plain
from laci_stereo.io.rig.mat_file import TO_STRUCT
from laci_stereo.io.rig.stereo_rig import ForImages, Lens, Size, StereoRig
from laci_stereo.io.text_file import quoted

_METRES: Mapping[str, float] = {
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetres"), 1e-3),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetres"), 1e-2),
    **dict.fromkeys(("m", "meter", "meters", "metres"), 1.0),
    **dict.fromkeys(("in", "inch", "inches"), 0.0254),
}
_ROTATION = Entry("rotation of camera 2", ("RotationOfCamera2",))
_TRANSLATION = Entry("translation of camera 2", ("TranslationOfCamera2",))
_POSE = Entry("pose of camera 2", ("A", "T"))


def read_matlab(document: Document, images: ForImages) -> StereoRig | None:
    """Read stereo parameters as ``toStruct`` returns them; None if the file has none.

    MATLAB multiplies row vectors from the left, so its older matrices are transposed; and it counts pixels from one.

    Raises
    ------
    RigError
    """
    found = _parameters(document)
    if found is None:
        return None
    left, left_notes = _lens(found.part("CameraParameters1"), images.size)
    right, _ = _lens(found.part("CameraParameters2"), images.size)
    metres, unit = _unit(found.part("CameraParameters1"))
    R, t, how = _pose(found)
    return StereoRig(left, right, R, t * metres, ("MATLAB stereoParameters", how, unit, *left_notes))


def _parameters(document: Document) -> Document | None:
    """Return the part of a file that describes a stereo camera: the whole file or one of its variables."""
    parts = [
        Document(f"{document.name}: {name}", node) for name, node in document.root.items() if isinstance(node, dict)
    ]
    return next((part for part in (document, *parts) if part.has("CameraParameters1", "CameraParameters2")), None)


def _pose(found: Document) -> tuple[FloatArray, FloatArray, str]:
    """Return R (3, 3) and t (3,) of ``p_2 = R p_1 + t`` in the file's unit, and a note on the origin."""
    if found.has("RotationOfCamera2", "TranslationOfCamera2"):
        transposed = found.array(_ROTATION, (3, 3))
        note = "RotationOfCamera2 transposed, as MATLAB multiplies rows from the left"
        return transposed.T, found.array(_TRANSLATION, (3,)), note
    if not found.has("PoseCamera2"):
        raise RigError(f"{found.name} lacks RotationOfCamera2 and PoseCamera2; needed is one, {TO_STRUCT}")
    pose = found.part("PoseCamera2")
    if pose.has("R", "Translation"):
        R = pose.array(Entry("rotation", ("R",)), (3, 3))
        return R, pose.array(Entry("translation", ("Translation",)), (3,)), "PoseCamera2: from camera 1 to camera 2"
    matrix = pose.array(_POSE, (4, 4))
    # A rigidtform3d has the last row 0 0 0 1; its predecessor rigid3d is transposed.
    upright = matrix if not matrix[3, :3].any() else matrix.T
    note = "PoseCamera2: from camera 1 to camera 2" + ("" if upright is matrix else ", transposed")
    return upright[:3, :3], upright[:3, 3], note


def _lens(camera: Document, image_size: Size | None) -> tuple[Lens, tuple[str, ...]]:
    """Return a lens, and notes on the interpretation of its matrix."""
    K = camera.array(Entry("camera matrix", ("K", "IntrinsicMatrix")), (3, 3))
    notes: tuple[str, ...] = ()
    if K[2, :2].any() and not K[:2, 2].any():
        K, notes = K.T, ("IntrinsicMatrix transposed",)
    # In MATLAB the centre of the first pixel is (1, 1).
    K = K - np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    radial = camera.array(Entry("radial distortion", ("RadialDistortion",)), (2,), (3,))
    tangential = np.zeros(2)
    if camera.has("TangentialDistortion"):
        tangential = camera.array(Entry("tangential distortion", ("TangentialDistortion",)), (2,))
    size = camera.size(order=(1, 0)) or image_size  # MATLAB's order is rows, columns
    if size is None:
        raise RigError(f"{camera.name} lacks ImageSize; needed are rows and columns")
    notes = (*notes, "principal points less one pixel, which MATLAB counts from one")
    return Lens(K, np.concatenate([radial[:2], tangential, radial[2:]]), size, "pinhole"), notes


def _unit(camera: Document) -> tuple[float, str]:
    """Return the unit of lengths in metres, and a note on its source."""
    unit = camera.text("WorldUnits")
    if not unit:
        return 1e-3, "lengths taken as millimetres, MATLAB's default"
    metres = _METRES.get(plain(unit))
    if metres is None:
        raise RigError(f"{camera.name}: WorldUnits is {quoted(unit)}; needed is mm, cm, m or inches")
    return metres, f"lengths in {unit}, as WorldUnits says"
