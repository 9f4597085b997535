"""Find where a roadside sensor stands and looks, from one connected vehicle that drives by.

>>> import laci_stereo
>>> result = laci_stereo.calibrate("left", "right", "cam.csv")  # doctest: +SKIP
>>> result.calibration.T_utm_sensor  # doctest: +SKIP
>>> result.save("calibration")  # doctest: +SKIP
"""

from laci_stereo.core.cam import CENTRE, FRONT, ReferencePoint
from laci_stereo.core.errors import CalibrationError, InputError, LaciError
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
