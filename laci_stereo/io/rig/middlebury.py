"""Middlebury's calib.txt (also ETH3D's): a rectified pair whose principal points may have different columns."""

from __future__ import annotations

import numpy as np

from laci_stereo.core.errors import RigError
from laci_stereo.io.rig.document import Document, Entry
from laci_stereo.io.rig.stereo_rig import ForImages, StereoRig, rectified_pair

_ROUNDING_PX = 0.002
"""Largest rounding error of a difference of principal points with three decimals."""


def read_middlebury(document: Document, images: ForImages) -> StereoRig | None:
    """Read a calib.txt; None if the file is in another format.

    Raises
    ------
    RigError
    """
    if not document.has("cam0", "cam1", "baseline"):
        return None
    K_left, K_right = (document.array(Entry("camera matrix", (name,)), (3, 3)) for name in ("cam0", "cam1"))
    baseline_m = document.number("baseline", "baseline") / 1000.0
    size = document.size() or images.size
    if size is None:
        raise RigError(f"{document.name} lacks the image size; needed are width and height")
    offset = float(K_right[0, 2] - K_left[0, 2])
    doffs = document.number("doffs", "doffs") if document.has("doffs") else offset
    if not abs(doffs - offset) <= _ROUNDING_PX:
        raise RigError(
            f"{document.name}: doffs is {doffs:g}, the principal points are {offset:g} pixels apart; needed is the same"
        )
    left_P = np.column_stack([K_left, np.zeros(3)])
    right_P = np.column_stack([K_right, K_right @ [-baseline_m, 0.0, 0.0]])
    notes = (
        "Middlebury calib.txt, for rectified images; the sensor is the rectified left camera",
        f"baseline {1000 * baseline_m:g} taken as millimetres, as the format says",
        f"disparities are counted from the principal points, {offset:g} pixels apart (doffs)",
    )
    return rectified_pair(left_P, right_P, size, notes)
