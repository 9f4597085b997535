"""Fit of the ground with the sensor's given axes, and a search for other axes where these lead to no ground."""

from __future__ import annotations

from collections.abc import Callable

from laci_stereo.core.errors import GroundError
from laci_stereo.core.frames import OPENCV_AXES, Axes, FloatArray
from laci_stereo.core.ground.plane import GroundPlane, fit_ground
from laci_stereo.core.settings import GroundSettings

UPS = {
    "z up": (0.0, 0.0, 1.0),
    "z down": (0.0, 0.0, -1.0),
    "y up": (0.0, 1.0, 0.0),
    "y down": (0.0, -1.0, 0.0),
    "y forward, x up": (1.0, 0.0, 0.0),
    "y forward, x down": (-1.0, 0.0, 0.0),
}
"""The up vector of each choice of axes, named as `--axes` takes it."""


def ground_below(
    points: FloatArray,
    sigma_along_m: FloatArray,
    sigma_across_m: FloatArray,
    axes: Axes,
    settings: GroundSettings,
    window_rad: float = 0.0,
) -> GroundPlane:
    """Fit the ground plane (see `fit_ground`), if need be with little support, which a road must confirm later.

    Raises
    ------
    GroundError
        If there is no ground in the direction that the axes define. If there is one in another direction, as for a
        sensor that hangs upside down, the message names the axes that lead to it; a camera's axes are fixed, so no
        others are tried.
    """

    def fit(up: tuple[float, float, float], needed: GroundSettings = settings) -> GroundPlane:
        return fit_ground(points, sigma_along_m, sigma_across_m, up, needed, window_rad)

    try:
        return fit(axes.up)
    except GroundError as error:
        elsewhere = "" if axes == OPENCV_AXES else ground_elsewhere(axes, fit)
        if not elsewhere:
            return fit(axes.up, settings.any_support)
        raise GroundError(f"{error}; {elsewhere}") from error


def ground_elsewhere(axes: Axes, fit: Callable[[tuple[float, float, float]], GroundPlane]) -> str:
    """Return in words with which other axes there is a ground, the largest one; empty without any.

    Parameters
    ----------
    axes : Axes
        With which there is none.
    fit : callable
        Maps an up vector to the ground in its opposite direction, or raises a `GroundError`.
    """
    areas_m2 = {}
    for name, up in UPS.items():
        if up != tuple(axes.up):
            try:
                areas_m2[name] = fit(up).support_area_m2
            except GroundError:
                continue
    if not areas_m2:
        return ""
    return f"there is a ground with --axes '{max(areas_m2, key=lambda name: areas_m2[name])}'"
