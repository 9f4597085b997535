"""Matches the vehicle's track in the sensor with its track in the world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.errors import MatchError
from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.settings import MatchSettings


@dataclass(frozen=True)
class PlanarMatch:
    """The transform from the level to the world frame: a rotation by yaw, then a translation.

    Attributes
    ----------
    yaw_rad : float
    shift : ndarray, shape (2,)
        Translation in the world frame, metres.
    """

    yaw_rad: float
    shift: FloatArray

    def __call__(self, xy_level: FloatArray) -> FloatArray:
        """Map points on the ground plan, shape (n, 2), from the level to the world frame."""
        moved: FloatArray = rotate_xy(self.yaw_rad, xy_level) + self.shift
        return moved


def match_track(xy_level: FloatArray, xy_world: FloatArray, settings: MatchSettings | None = None) -> PlanarMatch:
    """Match two tracks point by point (paper section III-D).

    Yaw is the circular mean of the angles between the location vectors of both tracks relative to the last point,
    without short vectors; the translation is the mean difference after rotation.

    Parameters
    ----------
    xy_level, xy_world : ndarray, shape (n, 2)
        The vehicle's centre at the same times, metres.
    settings : MatchSettings

    Raises
    ------
    MatchError
        If no point is far enough from the last one.
    """
    settings = settings or MatchSettings()
    vectors_level = xy_level[:-1] - xy_level[-1:]
    vectors_world = xy_world[:-1] - xy_world[-1:]
    lengths = np.minimum(np.linalg.norm(vectors_level, axis=1), np.linalg.norm(vectors_world, axis=1))
    long_enough = lengths >= settings.min_vector_m
    if not long_enough.any():
        raise MatchError(
            f"the vehicle is at most {lengths.max(initial=0.0):.1f} m away from its last position while it is seen; "
            f"needed are {settings.min_vector_m:.1f} m to tell the yaw"
        )
    angles = _angle(vectors_world[long_enough]) - _angle(vectors_level[long_enough])
    yaw = float(np.arctan2(np.sin(angles).mean(), np.cos(angles).mean()))
    return PlanarMatch(yaw, (xy_world - rotate_xy(yaw, xy_level)).mean(axis=0))


def _angle(vectors: FloatArray) -> FloatArray:
    return np.arctan2(vectors[:, 1], vectors[:, 0])
