"""Sensor-independent calibration: no files, no OpenCV."""

from laci_stereo.core.background import learn_background
from laci_stereo.core.box import fit_box
from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.ground import fit_ground
from laci_stereo.core.matching import match_track

__all__ = ["calibrate", "fit_box", "fit_ground", "learn_background", "match_track"]
