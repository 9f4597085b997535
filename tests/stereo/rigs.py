"""Stereo rigs of every kind that can be met, small enough for tests."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from laci_stereo.core.frames import FloatArray
from laci_stereo.io.rig.stereo_rig import Lens, Model, StereoRig

SIZE = (400, 300)
FOCAL_PX = 360.0
BASELINE_M = 0.5

FIVE = (-0.25, 0.08, 1e-3, -8e-4, -0.01)
EIGHT = (0.4, -0.2, -6e-4, 1e-3, 0.02, 0.65, -0.15, 0.03)
TWELVE = (-0.2, 0.05, 5e-4, 5e-4, 0.0, 0.02, 0.01, 0.0, 2e-3, -1e-3, -1e-3, 2e-3)
FISHEYE = (0.03, -0.01, 0.004, -0.001)


def lens(
    distortion: tuple[float, ...] = (0.0,) * 5,
    model: Model = "pinhole",
    focal: float = 1.0,
    shift: tuple[float, float] = (0.0, 0.0),
    size: tuple[int, int] = SIZE,
) -> Lens:
    """Return a lens; ``focal`` is a factor, ``shift`` moves the principal point by pixels."""
    f = FOCAL_PX * focal * size[0] / SIZE[0]
    K = np.array([[f, 0.0, (size[0] - 1) / 2 + shift[0]], [0.0, 1.01 * f, (size[1] - 1) / 2 + shift[1]], [0, 0, 1]])
    if not np.any(distortion):
        K[1, 1] = f
    return Lens(K, np.array(distortion), size, model)


def rig(left: Lens, right: Lens, turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0), side: int = 1) -> StereoRig:
    """Return a rig; ``turn_deg`` turns the right camera, which stands left of the first if ``side`` is -1."""
    R = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    centre: FloatArray = np.array([side * BASELINE_M, 0.0, 0.0])
    if np.any(turn_deg):
        centre += np.array([0.0, 0.01, -0.015])
    return StereoRig(left, right, R, -R @ centre)


def ideal(size: tuple[int, int] = SIZE) -> StereoRig:
    return rig(lens(size=size), lens(size=size))


RIGS: dict[str, StereoRig] = {
    "ideal": ideal(),
    "five": rig(lens(FIVE), lens(FIVE, shift=(3.0, -2.0)), (0.2, -0.3, 0.1)),
    "eight": rig(lens(EIGHT), lens(EIGHT), (-0.1, 0.2, -0.3)),
    "twelve": rig(lens(TWELVE), lens(TWELVE), (0.3, 0.1, 0.2)),
    "askew": rig(lens(FIVE), lens(EIGHT, focal=1.06, shift=(-12.0, 9.0)), (1.2, 1.5, -1.0)),
    "mirrored": rig(lens(), lens(), side=-1),
    "mirrored askew": rig(lens(FIVE, shift=(5.0, 2.0)), lens(FIVE, focal=0.97), (-0.8, 1.0, 0.7), side=-1),
    "fisheye": rig(lens(FISHEYE, "fisheye", 0.8), lens(FISHEYE, "fisheye", 0.8), (0.4, -0.5, 0.6)),
}
