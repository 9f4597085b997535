"""The result of a calibration, and its quality."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from laci_stereo.core.estimation.drive_prior import Correction
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.frames import Axes, FloatArray, wrap
from laci_stereo.core.ground.plane import GroundPlane
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.messages.slope import Slope
from laci_stereo.core.settings import SYNCHRONISED_S, Method
from laci_stereo.core.tracking.background import Background
from laci_stereo.core.tracking.tracks import Track
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


@dataclass(frozen=True)
class Calibration:
    """The pose of a sensor, and the data from which it was estimated.

    Attributes
    ----------
    world : World
    T_world_sensor : ndarray, shape (4, 4)
    T_level_sensor : ndarray, shape (4, 4)
    covariance : ndarray, shape (6, 6)
        Of (rotation vector, rad; translation, m), applied on the left in the world frame about ``centre_world``.
    centre_world : ndarray, shape (3,)
        The middle of the vehicle's track.
    time_offset_s, time_sigma_s : float
        To be added to the sensor's stamps to get the CAMs' time, and its standard deviation.
    station_id : int
    ground : GroundPlane
    background : Background
    track : Track
        Of the vehicle, in the level frame.
    vehicle : VehicleTrack
        In the world frame.
    match : PlanarMatch
    paper : PlanarMatch or None
        The result of the paper's method; None where it has none.
    axes : Axes
        Of the sensor.
    quality : Quality
    method : {"joint", "paper"}
    clock_sigma_s : float
        Prior standard deviation of the clock offset.
    turn : float
        Rotation of the scanner, see `JointFit`.
    nearer : Correction or None
        See `JointFit`.
    found : tuple of str
        Other findings of the estimate.
    others : tuple of Passage
        Further drives from which it was estimated, in the same level and world frames.
    body : VehicleTrack or None
        See `Passage`.
    """

    world: World
    T_world_sensor: FloatArray
    T_level_sensor: FloatArray
    covariance: FloatArray
    centre_world: FloatArray
    time_offset_s: float
    time_sigma_s: float
    station_id: int
    ground: GroundPlane
    background: Background
    track: Track
    vehicle: VehicleTrack
    match: PlanarMatch
    paper: PlanarMatch | None
    axes: Axes
    quality: Quality
    method: Method
    clock_sigma_s: float = SYNCHRONISED_S
    turn: float = 0.0
    nearer: Correction | None = None
    found: tuple[str, ...] = ()
    others: tuple[Passage, ...] = ()
    body: VehicleTrack | None = None

    @property
    def passages(self) -> tuple[Passage, ...]:
        """The drives from which it was estimated, its own first."""
        own = Passage(
            world=self.world,
            axes=self.axes,
            ground=self.ground,
            background=self.background,
            track=self.track,
            vehicle=self.vehicle,
            station_id=self.station_id,
            match=self.match,
            time_offset_s=self.time_offset_s,
            method=self.method,
            clock_sigma_s=self.clock_sigma_s,
            turn=self.turn,
            body=self.body,
        )
        return (own, *self.others)

    @property
    def T_utm_sensor(self) -> FloatArray:
        """The best rigid transform to UTM around the track, shape (4, 4)."""
        return self.world.utm_from_sensor(self.T_world_sensor, self.centre_world)

    @property
    def slope(self) -> Slope | None:
        """The slope of the ground, which may be level; None where the messages' altitudes do not determine it."""
        return self.vehicle.slope

    @property
    def T_enu_sensor(self) -> FloatArray | None:
        """The transform to east, north and up against gravity, shape (4, 4); None where no slope is known.

        Its origin is that of the world frame. On a level road it equals ``T_world_sensor``.
        """
        return None if self.slope is None else self.slope.T_enu_world @ self.T_world_sensor

    @property
    def remarks(self) -> tuple[str, ...]:
        """Assumptions about the messages, what was left out of them, and other findings."""
        return (*self.vehicle.remarks, *self.found)

    @property
    def paper_differs(self) -> tuple[float, float] | None:
        """The difference of the paper's method: of objects on the track, metres (RMS), and in yaw, degrees, or None."""
        if self.paper is None:
            return None
        seen = np.array([sighting.middle for sighting in self.track.sightings])
        shift = np.sqrt(((self.paper(seen) - self.match(seen)) ** 2).sum(axis=1).mean())
        return float(shift), float(np.degrees(abs(wrap(self.paper.yaw_rad - self.match.yaw_rad))))

    @property
    def height_m(self) -> float:
        """Height of the sensor above the ground."""
        return self.ground.height_m

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
