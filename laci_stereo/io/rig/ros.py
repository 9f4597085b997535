"""ROS: one camera_info file per camera, as image_pipeline's cameracalibrator or ``topic echo`` writes it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from laci_stereo.core.errors import RigError
from laci_stereo.io.rig.document import Document, Entry, numbers
from laci_stereo.io.rig.opencv import COEFFICIENTS, model_of
from laci_stereo.io.rig.stereo_rig import ForImages, Lens, Model, Size, StereoRig, projection_shift, rectified_pair

_K = Entry("camera matrix", ("camera_matrix", "K"))
_D = Entry("distortion", ("distortion_coefficients", "D"))
_R = Entry("rectification", ("rectification_matrix", "R"))
_P = Entry("projection", ("projection_matrix", "P"))
_ALL = (_K, _D, _R, _P)


def read_ros(documents: Sequence[Document], images: ForImages) -> StereoRig | None:
    """Read two camera_info files; None if the files are in another format.

    P[0, 3] of the right camera is minus focal length times baseline; each R rotates its camera into the common image
    plane.

    Raises
    ------
    RigError
    """
    if not all(document.find(entry) is not None for document in documents for entry in _ALL):
        return None
    if len(documents) == 1:
        raise RigError(
            f"{documents[0].name} is the camera_info of one camera; needed is the other one's too: "
            "--stereo LEFT.yaml --stereo RIGHT.yaml"
        )
    left, right, order = _in_order(documents)
    left_P, right_P = (document.array(_P, (3, 4)) for document in (left, right))
    for document, P in ((left, left_P), (right, right_P)):
        if P[0, 0] <= 0 or P[1, 1] <= 0 or P[2, 2] <= 0:
            raise RigError(
                f"{document.name}: P has the focal length {P[0, 0]:g}, {P[1, 1]:g}; needed are positive ones"
            )
    shift = projection_shift(right_P) - projection_shift(left_P)
    if not shift.any():
        raise RigError(
            f"{right.name}: P[0,3] is {right_P[0, 3]:g}, as the left camera's; needed is minus focal length times "
            "baseline there, as a stereo calibration writes it"
        )
    left_R, right_R = (document.array(_R, (3, 3)) for document in (left, right))
    left_lens, right_lens = (_lens(document, images.size) for document in (left, right))
    baseline = f"baseline {np.linalg.norm(shift):.4g} m from P of {right.name}"
    rectified = rectified_pair(left_P, right_P, left_lens.size, ("rectified images as the P of both cameras say",))
    return StereoRig(
        left_lens,
        right_lens,
        right_R.T @ left_R,
        right_R.T @ shift,
        ("ROS camera_info of two cameras, for raw images; rotation between them from both R", baseline, *order),
        rectified,
    )


def _in_order(documents: Sequence[Document]) -> tuple[Document, Document, tuple[str, ...]]:
    """Return the left and the right camera's document, which has the baseline in its P, and notes on the order."""
    first, second = documents
    shifts = [projection[0, 3] for projection in (document.array(_P, (3, 4)) for document in documents)]
    if shifts[0] != 0 and shifts[1] == 0:
        return second, first, (f"{second.name} is the left camera's, since P of {first.name} holds the baseline",)
    return first, second, ()


def _lens(document: Document, image_size: Size | None) -> Lens:
    size = document.size() or image_size
    if size is None:
        raise RigError(f"{document.name} lacks the image size; needed are image_width and image_height")
    model: Model = model_of(document)
    found = document.find(_D)
    values = None if found is None else numbers(found[1])
    if values is None or not values.size:
        distortion = np.zeros(4)
    else:
        distortion = document.array(_D, *((count,) for count in COEFFICIENTS[model]))
    return Lens(document.array(_K, (3, 3)), distortion, size, model)
