"""Every setting of the core, its default, and why it has that value. The command line only overrides."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class GroundSettings:
    """How the ground plane is found.

    Attributes
    ----------
    max_tilt_deg : float
        Largest angle between the plane's normal and the sensor's own up axis. Sensors are pitched by up to 35 deg
        and rolled by a few; a wall that faces a sensor pitched by 35 deg appears 55 deg from up.
    min_height_m, max_height_m : float
        Between these the sensor hangs over the ground.
    """

    max_tilt_deg: float = 48.0
    min_height_m: float = 1.5
    max_height_m: float = 40.0


@dataclass(frozen=True)
class BoxSettings:
    """The paper's box fit (section III-C).

    Attributes
    ----------
    light_bin_m : float
        Width dx of the bins of the light beams.
    bar_bin_m : float
        Width of the bins of the histogram along the line, whose densest is the bar P.
    line_tolerance_m : float
        theta_thresh: points this near to the line are its points Q.
    """

    light_bin_m: float = 0.2
    bar_bin_m: float = 0.2
    line_tolerance_m: float = 0.2
