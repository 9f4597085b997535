"""Sensor-independent calibration: no files, no OpenCV."""

from laci_stereo.core.calibrate import calibrate
from laci_stereo.core.ground.plane import fit_ground
from laci_stereo.core.matching import match_track
from laci_stereo.core.tracking.background import learn_background
from laci_stereo.core.tracking.box import fit_box

__all__ = ["calibrate", "fit_box", "fit_ground", "learn_background", "match_track"]
