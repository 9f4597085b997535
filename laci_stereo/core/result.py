"""The result of a calibration, and how far it can be trusted."""

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
from laci_stereo.core.settings import Method
from laci_stereo.core.tracking.background import Background
from laci_stereo.core.tracking.tracks import Track
from laci_stereo.core.world import World

Verdict = Literal["pass", "warn", "fail"]


@dataclass(frozen=True)
class Quality:
    """How far a calibration can be trusted.

    Attributes
    ----------
    verdict : {"pass", "warn", "fail"}
    reasons : tuple of str
        Why it is not a pass.
    track_xy_sigma_m : float
        By how much an object on the vehicle's track would be misplaced in the plane: the root of the mean square of
        the two-dimensional error, one sigma.
    weakest_sigma_m, weakest_yaw_deg : float
        The direction in which objects on the track are least well placed, counter-clockwise from grid east, and the
        standard deviation there.
    advice : str
        Why that is, and which drive would mend it.
    yaw_sigma_deg, tilt_sigma_deg, height_sigma_m : float
    residual_rms_m : float
        By the paper's method the distance between the two tracks, by the joint one that of the points from the outline.
    frames_used, frames_seen : int
        Frames of the vehicle in the match, and frames in which it was seen at all.
    left_out : dict of str to int
        Frames that were left out, by reason: cut, far, thin, unknown (no CAM at that time), standing (where it is seen
        in enough others), bare (no point of the outline).
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
        """Return the same with what else may be wrong, if anything: it is then no pass."""
        verdict: Verdict = "warn" if self.verdict == "pass" and reasons else self.verdict
        return replace(self, verdict=verdict, reasons=(*self.reasons, *reasons))


@dataclass(frozen=True)
class Calibration:
    """Where a sensor stands and looks, and what that was concluded from.

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
        In the world.
    match : PlanarMatch
    paper : PlanarMatch or None
        What the paper's method says; None where it says nothing.
    axes : Axes
        Of the sensor.
    quality : Quality
    method : {"joint", "paper"}
    clock_sigma_s : float
        What was known of the clocks' offset beforehand, one standard deviation.
    turn : float
        How the scanner turned, see `JointFit`.
    nearer : Correction or None
        See `JointFit`.
    found : tuple of str
        What else the estimate found.
    others : tuple of Passage
        Further drives that it was estimated from, in the same level frame and world.
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
    clock_sigma_s: float = 0.010
    turn: float = 0.0
    nearer: Correction | None = None
    found: tuple[str, ...] = ()
    others: tuple[Passage, ...] = ()
    body: VehicleTrack | None = None

    @property
    def passages(self) -> tuple[Passage, ...]:
        """The drives that it was estimated from, its own first."""
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
        """The best rigid transform into UTM around the track, shape (4, 4)."""
        return self.world.utm_from_sensor(self.T_world_sensor, self.centre_world)

    @property
    def slope(self) -> Slope | None:
        """Of the ground, which may be level; None where the messages' altitudes do not tell it."""
        return self.vehicle.slope

    @property
    def T_enu_sensor(self) -> FloatArray | None:
        """The transform into east, north and up against gravity, shape (4, 4); None where no slope is known.

        Its origin is the world's. On a level road it is ``T_world_sensor``.
        """
        return None if self.slope is None else self.slope.T_enu_world @ self.T_world_sensor

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was assumed of the messages, or left out of them, and what else was found."""
        return (*self.vehicle.remarks, *self.found)

    @property
    def paper_differs(self) -> tuple[float, float] | None:
        """By how much the paper's method differs: of objects on the track, metres (RMS), and in angle, degrees."""
        if self.paper is None:
            return None
        seen = np.array([sighting.middle for sighting in self.track.sightings])
        shift = np.sqrt(((self.paper(seen) - self.match(seen)) ** 2).sum(axis=1).mean())
        return float(shift), float(np.degrees(abs(wrap(self.paper.yaw_rad - self.match.yaw_rad))))

    @property
    def height_m(self) -> float:
        """Of the sensor above the ground."""
        return self.ground.height_m

    @property
    def viewing_angles(self) -> ViewingAngles:
        """Where the sensor looks."""
        return viewing_angles(self.T_world_sensor, self.axes)


@dataclass(frozen=True)
class ViewingAngles:
    """Where a sensor looks, in words that a person on site can check.

    Attributes
    ----------
    yaw_deg : float
        Of the forward axis, counter-clockwise from grid east.
    down_deg : float
        By how much the forward axis points below the horizon.
    roll_deg : float
        By how much the sensor is turned clockwise about the forward axis, seen from behind it.
    """

    yaw_deg: float
    down_deg: float
    roll_deg: float


def viewing_angles(T_world_sensor: FloatArray, axes: Axes) -> ViewingAngles:
    """Read the viewing direction off a transform, shape (4, 4)."""
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
