"""Find the pose of a roadside sensor on the map, from one connected vehicle that drives by.

>>> import laci_stereo
>>> result = laci_stereo.calibrate("left", "right", "cam.csv")  # doctest: +SKIP
>>> result.calibration.T_utm_sensor  # doctest: +SKIP
>>> result.save("calibration")  # doctest: +SKIP
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from laci_stereo.core.errors import CalibrationError, InputError, LaciError
    from laci_stereo.core.messages.cam import CENTRE, FRONT, ReferencePoint
    from laci_stereo.core.settings import Settings
    from laci_stereo.job import Result
    from laci_stereo.run import Options, calibrate
    from laci_stereo.stereo.settings import StereoSettings

__all__ = [
    "CENTRE",
    "FRONT",
    "CalibrationError",
    "InputError",
    "LaciError",
    "Options",
    "ReferencePoint",
    "Result",
    "Settings",
    "StereoSettings",
    "calibrate",
]

_HOMES = {
    "laci_stereo.core.messages.cam": ("CENTRE", "FRONT", "ReferencePoint"),
    "laci_stereo.core.errors": ("CalibrationError", "InputError", "LaciError"),
    "laci_stereo.core.settings": ("Settings",),
    "laci_stereo.job": ("Result",),
    "laci_stereo.run": ("Options", "calibrate"),
    "laci_stereo.stereo.settings": ("StereoSettings",),
}


def __getattr__(name: str) -> object:
    """Import a name on demand: importing all takes a second, in which a command should be able to start."""
    home = next((home for home, names in _HOMES.items() if name in names), None)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(home), name)
