"""The result of a calibration, and its quality."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from laci_stereo.core.estimation.drive_prior import Correction
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.frames import Axes, FloatArray, wrap
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.slope import Slope
from laci_stereo.core.world import World

Verdict = Literal["pass", "warn", "fail"]


@dataclass(frozen=True)
class Quality:
    """The quality of a calibration.

    Attributes
    ----------
    verdict : {"pass", "warn", "fail"}
    reasons : tuple of str
        Why the verdict is not "pass".
    track_xy_sigma_m : float
        Expected error, in the plane, of an object's position on the vehicle's track: the root mean square of the
        two-dimensional error, one standard deviation.
    weakest_sigma_m, weakest_yaw_deg : float
        The standard deviation in the direction in which the positions of objects on the track are least certain, and
        that direction, counter-clockwise from grid east.
    advice : str
        Why that is, and which drive would improve it.
    yaw_sigma_deg, tilt_sigma_deg, height_sigma_m : float
    residual_rms_m : float
        By the paper's method the distance between the two tracks, by the joint one that of the points from the outline.
    frames_used, frames_seen : int
        Number of frames of the vehicle that were used, and number in which it was seen at all.
    left_out : dict of str to int
        Numbers of frames that were left out, by reason: cut, far, thin, unknown (no CAM at that time), standing (the
        vehicle is stationary and seen there in enough others), bare (no point of the outline).
    """

    verdict: Verdict
    reasons: tuple[str, ...]
    track_xy_sigma_m: float
    weakest_sigma_m: float
    weakest_yaw_deg: float
    advice: str
    yaw_sigma_deg: float
    tilt_sigma_deg: float
    height_sigma_m: float
    residual_rms_m: float
    frames_used: int
    frames_seen: int
    left_out: dict[str, int]

    def doubted(self, *reasons: str) -> Quality:
        """Return this quality with additional reasons; with any, the verdict is no longer "pass"."""
        verdict: Verdict = "warn" if self.verdict == "pass" and reasons else self.verdict
        return replace(self, verdict=verdict, reasons=(*self.reasons, *reasons))

    def failed(self, *reasons: str) -> Quality:
        """Return this quality with additional reasons; with any, the verdict is "fail"."""
        return replace(self, verdict="fail" if reasons else self.verdict, reasons=(*reasons, *self.reasons))


@dataclass(frozen=True)
class Calibration:
    """The pose of a sensor, and the drives from which it was estimated.

    Attributes
    ----------
    passages : tuple of Passage
        The drives, in the same level and world frames, the result's own first.
    T_world_sensor : ndarray, shape (4, 4)
    T_level_sensor : ndarray, shape (4, 4)
    covariance : ndarray, shape (6, 6)
        Of (rotation vector, rad; translation, m), applied on the left in the world frame about ``centre_world``.
    centre_world : ndarray, shape (3,)
        The middle of the vehicle's track.
    time_sigma_s : float
        Standard deviation of the clock offset of its own drive.
    paper : PlanarMatch or None
        The result of the paper's method; None where it has none.
    quality : Quality
    nearer : Correction or None
        See `JointFit`.
    found : tuple of str
        Other findings of the estimate.
    """

    passages: tuple[Passage, ...]
    T_world_sensor: FloatArray
    T_level_sensor: FloatArray
    covariance: FloatArray
    centre_world: FloatArray
    time_sigma_s: float
    paper: PlanarMatch | None
    quality: Quality
    nearer: Correction | None = None
    found: tuple[str, ...] = ()

    def doubted(self, *reasons: str) -> Calibration:
        """Return this result with objections to its recording; its drives keep them."""
        return self._objected(reasons, self.quality.doubted(*reasons))

    def failed(self, *reasons: str) -> Calibration:
        """Return this result with reasons why its recording is spoilt; its drives keep them."""
        return self._objected(reasons, self.quality.failed(*reasons))

    def _objected(self, reasons: tuple[str, ...], quality: Quality) -> Calibration:
        passages = (replace(each, objections=(*each.objections, *reasons)) for each in self.passages)
        return replace(self, quality=quality, passages=tuple(passages))

    @property
    def drive(self) -> Passage:
        """The result's own drive."""
        return self.passages[0]

    @property
    def others(self) -> tuple[Passage, ...]:
        """The other drives."""
        return self.passages[1:]

    @property
    def world(self) -> World:
        """The world frame."""
        return self.drive.world

    @property
    def axes(self) -> Axes:
        """The axes of the sensor."""
        return self.drive.axes

    @property
    def T_utm_sensor(self) -> FloatArray:
        """The best rigid transform to UTM around the track, shape (4, 4)."""
        return self.world.utm_from_sensor(self.T_world_sensor, self.centre_world)

    @property
    def slope(self) -> Slope | None:
        """The slope of the ground, which may be level; None where the messages' altitudes do not determine it."""
        return self.drive.vehicle.slope

    @property
    def T_enu_sensor(self) -> FloatArray | None:
        """The transform to east, north and up against gravity, shape (4, 4); None where no slope is known.

        Its origin is that of the world frame. On a level road it equals ``T_world_sensor``.
        """
        return None if self.slope is None else self.slope.T_enu_world @ self.T_world_sensor

    @property
    def remarks(self) -> tuple[str, ...]:
        """Assumptions about the messages, what was left out of them, and other findings."""
        return (*self.drive.vehicle.remarks, *self.found)

    @property
    def paper_differs(self) -> tuple[float, float] | None:
        """The difference of the paper's method: of objects on the track, metres (RMS), and in yaw, degrees, or None."""
        if self.paper is None:
            return None
        seen = np.array([sighting.middle for sighting in self.drive.track.sightings])
        shift = np.sqrt(((self.paper(seen) - self.drive.match(seen)) ** 2).sum(axis=1).mean())
        return float(shift), float(np.degrees(abs(wrap(self.paper.yaw_rad - self.drive.match.yaw_rad))))

    @property
    def height_m(self) -> float:
        """Height of the sensor above the ground."""
        return self.drive.ground.height_m

    @property
    def viewing_angles(self) -> ViewingAngles:
        """The viewing direction of the sensor."""
        return viewing_angles(self.T_world_sensor, self.axes)


@dataclass(frozen=True)
class ViewingAngles:
    """The viewing direction of a sensor, as angles that a person on site can check.

    Attributes
    ----------
    yaw_deg : float
        Of the forward axis, counter-clockwise from grid east.
    down_deg : float
        Angle of the forward axis below the horizon (pitch).
    roll_deg : float
        Clockwise rotation of the sensor about the forward axis, as seen from behind it.
    """

    yaw_deg: float
    down_deg: float
    roll_deg: float


def viewing_angles(T_world_sensor: FloatArray, axes: Axes) -> ViewingAngles:
    """Return the viewing direction of a transform, shape (4, 4)."""
    forward = T_world_sensor[:3, :3] @ np.array(axes.forward)
    up = T_world_sensor[:3, :3] @ np.array(axes.up)
    right_level = np.cross(forward, [0.0, 0.0, 1.0])
    right_level /= max(float(np.linalg.norm(right_level)), 1e-12)
    up_level = np.cross(right_level, forward)
    return ViewingAngles(
        yaw_deg=float(np.degrees(np.arctan2(forward[1], forward[0]))),
        down_deg=float(np.degrees(np.arcsin(np.clip(-forward[2], -1, 1)))),
        roll_deg=float(np.degrees(np.arctan2(up @ right_level, up @ up_level))),
    )
