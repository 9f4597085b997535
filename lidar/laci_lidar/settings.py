"""All settings of the LiDAR, with their defaults and the reasons for these."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from laci_stereo.core.errors import SettingError
from laci_stereo.core.frames import FORWARD_LEFT_UP_AXES, Axes


@dataclass(frozen=True)
class Sweep:
    """Rotation of a scanner whose scans do not contain the points' own times.

    Attributes
    ----------
    stamp_at : {"start", "middle", "end"}
        The moment of the sweep to which a scan's stamp refers.
    direction : {"ccw", "cw"}
        Direction of rotation seen from above, as the sensor is mounted.
    rate_hz : float
        Rotations of the mirror or head per second; a scanner with a field of 100 deg sweeps it in 100 / 360 of a
        rotation.
    start_deg : float or None
        Azimuth at which a sweep begins, counter-clockwise from forward. None: the border of the field of view; for an
        all-round field, the start according to the order of the points, else behind the sensor.
    """

    stamp_at: Literal["start", "middle", "end"] = "start"
    direction: Literal["ccw", "cw"] = "cw"
    rate_hz: float = 10.0
    start_deg: float | None = None

    def __post_init__(self) -> None:
        if self.stamp_at not in ("start", "middle", "end"):
            raise SettingError(f"the stamp is at {self.stamp_at!r} of a sweep; needed is 'start', 'middle' or 'end'")
        if self.direction not in ("ccw", "cw"):
            raise SettingError(f"the direction of a sweep is {self.direction!r}; needed is 'ccw' or 'cw'")
        if not 0.5 <= self.rate_hz <= 200.0:
            raise SettingError(f"the rate of sweeps is {self.rate_hz:g} Hz; needed is 0.5 to 200 turns in a second")
        if self.start_deg is not None and not -360.0 <= self.start_deg <= 360.0:
            raise SettingError(f"a sweep starts at {self.start_deg:g} deg; needed is -360 to 360")


AtOnce: TypeAlias = Literal["none"]
"""No sweep: a flash LiDAR, or scans whose points have been motion-compensated to the stamp."""


@dataclass(frozen=True)
class LidarSettings:
    """Settings of the conversion from scans to point clouds.

    Attributes
    ----------
    range_sigma_m : float or None
        Standard deviation of a range. None: estimated from the range differences of neighbouring points on the ground.
    angle_sigma_rad : float or None
        Standard deviation of a bearing. None: derived from the step between neighbouring beams.
    sweep : Sweep, "none" or None
        Rotation of the scanner; "none": all points of a scan were taken at its stamp, whatever times they contain.
        None: the points' own times are used if the scans contain them; otherwise the rotation is estimated from the
        drive.
    accumulate : int
        Number of scans accumulated into one frame, for patterns that do not repeat and need several scans to fill the
        view.
    min_range_m : float
        Nearer points are on the sensor's own mast and housing; the lowest supported mounting height is 1.5 m.
    axes : Axes
        Directions of forward and up in the sensor frame.
    workers : int
        Number of scans read concurrently; 0: the number of processors, at most 4, because reading is limited by the
        disk.
    """

    range_sigma_m: float | None = None
    angle_sigma_rad: float | None = None
    sweep: Sweep | AtOnce | None = None
    accumulate: int = 1
    min_range_m: float = 1.0
    axes: Axes = FORWARD_LEFT_UP_AXES
    workers: int = 0

    def __post_init__(self) -> None:
        for name, largest, unit in (("range_sigma_m", 1.0, "m"), ("angle_sigma_rad", 0.1, "rad")):
            value = getattr(self, name)
            if value is not None and not 0.0 < value <= largest:
                raise SettingError(f"{name} is {value:g} {unit}; needed is more than 0 and at most {largest:g} {unit}")
        if self.sweep not in (None, "none") and not isinstance(self.sweep, Sweep):
            raise SettingError(f"the sweep is {self.sweep!r}; needed is 'none', or how the scanner turns")
        if not 1 <= self.accumulate <= 1000:
            raise SettingError(f"accumulate is {self.accumulate}; needed is 1 to 1000 scans in a frame")
        if not 0.0 <= self.min_range_m < 50.0:
            raise SettingError(f"min_range_m is {self.min_range_m:g} m; needed is 0 to 50 m")
