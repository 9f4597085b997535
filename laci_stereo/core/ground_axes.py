"""The ground below a sensor whose axes were told, and which axes it would need where there is none."""

from __future__ import annotations

from laci_stereo.core.errors import GroundError
from laci_stereo.core.frames import OPENCV_AXES, Axes, FloatArray
from laci_stereo.core.ground import GroundPlane, fit_ground
from laci_stereo.core.settings import GroundSettings

UPS = {
    "z up": (0.0, 0.0, 1.0),
    "z down": (0.0, 0.0, -1.0),
    "y up": (0.0, 1.0, 0.0),
    "y down": (0.0, -1.0, 0.0),
    "y forward, x up": (1.0, 0.0, 0.0),
    "y forward, x down": (-1.0, 0.0, 0.0),
}
"""All ways in which an axis can point upwards, as `--axes` takes them."""


def ground_below(
    points: FloatArray, sigma_along_m: FloatArray, sigma_across_m: FloatArray, axes: Axes, settings: GroundSettings
) -> GroundPlane:
    """Fit the ground plane (see `fit_ground`); one that little of the view supports must be confirmed by a road.

    Raises
    ------
    GroundError
        If there is none where the axes put it. If there is one elsewhere, as below a sensor that hangs upside down, it
        says with which axes; a camera's are what they are.
    """
    cloud = points, sigma_along_m, sigma_across_m
    try:
        return fit_ground(*cloud, axes.up, settings)
    except GroundError as error:
        areas_m2 = {} if axes == OPENCV_AXES else _elsewhere(cloud, axes, settings)
        if not areas_m2:
            return fit_ground(*cloud, axes.up, settings.any_support)
        likeliest = max(areas_m2, key=lambda name: areas_m2[name])
        raise GroundError(f"{error}; there is a ground with --axes '{likeliest}'") from error


def _elsewhere(
    cloud: tuple[FloatArray, FloatArray, FloatArray], axes: Axes, settings: GroundSettings
) -> dict[str, float]:
    """Return what the grounds cover that there are with other axes, by their names, square metres."""
    areas_m2 = {}
    for name, up in UPS.items():
        if up != tuple(axes.up):
            try:
                areas_m2[name] = fit_ground(*cloud, up, settings).support_area_m2
            except GroundError:
                continue
    return areas_m2
