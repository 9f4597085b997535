"""How vehicles move: the rear axle follows a path, and the body follows it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from scipy.ndimage import uniform_filter1d

from laci_stereo.core.frames import FloatArray, rotate_xy

DriveKind = Literal[
    "straight", "left_turn", "right_turn", "stop_and_go", "roundabout", "reverse", "lane_change", "reverse_in_turn"
]
DRIVES: tuple[DriveKind, ...] = (
    "straight", "left_turn", "right_turn", "stop_and_go", "roundabout", "reverse", "lane_change",
)  # fmt: skip
"""Those that scenes draw from; the others are only drawn when asked for."""

FIRST_S, LAST_S = -15.0, 45.0
STEP_S, STEP_M = 5e-3, 0.02
TOWED_STEP_S = 0.02

LATERAL_MPS2 = 2.5
"""Largest lateral acceleration at which drivers take a bend: 2 to 3 m/s^2 (Levison et al., FHWA-RD-01-108)."""


@dataclass(frozen=True)
class Drive:
    """The motion of a vehicle's rear axle (kinematic bicycle model): the body is aligned with the rear axle's path.

    Attributes
    ----------
    start : tuple of float
        Where the first leg begins, metres.
    yaw_rad : float
        Direction there.
    legs : tuple of (float, float)
        Length in metres and turn to the left in radians; straight before the first and after the last.
    ramp_m : float
        Length of path over which the curvature passes linearly from one leg's to the next one's.
    speeds : tuple of (float, float)
        Time in s and speed in m/s, linear in between; negative is backwards.
    ease_s : float
        Time over which the acceleration passes from one interval of speeds to the next, so that the jerk is limited.
    pivot : tuple of float
        A time in s, and the distance along the path in m at that time.
    wander : tuple of float
        Deviation from the lane's middle: amplitude and wavelength in m, and a phase in rad.
    """

    start: tuple[float, float]
    yaw_rad: float
    legs: tuple[tuple[float, float], ...] = ()
    ramp_m: float = 4.0
    speeds: tuple[tuple[float, float], ...] = ((0.0, 8.0),)
    ease_s: float = 0.8
    pivot: tuple[float, float] = (0.0, 0.0)
    wander: tuple[float, float, float] = (0.0, 50.0, 0.0)

    def at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the rear axle's positions, shape (n, 2), and the body's yaw, shape (n,), unwrapped."""
        path, x, y, yaw, _ = self._path
        driven = np.interp(times_s, self._time, self._driven)
        xy = np.column_stack([np.interp(driven, path, x), np.interp(driven, path, y)])
        return xy, np.interp(driven, path, yaw)

    def speed(self, times_s: FloatArray) -> FloatArray:
        """Return the rear axle's speed, negative backwards, shape (n,)."""
        return np.interp(times_s, self._time, self._speed)

    def curvature(self, times_s: FloatArray) -> FloatArray:
        """Return the curvature of the rear axle's path, 1/m, positive to the left, shape (n,)."""
        driven = np.interp(times_s, self._time, self._driven)
        return np.interp(driven, self._path[0], self._path[4])

    def placed(self, yaw_rad: float, xy: tuple[float, float] = (0.0, 0.0)) -> Drive:
        """Return the drive rotated about the origin and then translated."""
        x, y = (rotate_xy(yaw_rad, np.array(self.start)) + xy).tolist()
        return replace(self, start=(x, y), yaw_rad=self.yaw_rad + yaw_rad)

    def mirrored(self) -> Drive:
        """Return the drive with left and right exchanged."""
        return replace(
            self,
            start=(self.start[0], -self.start[1]),
            yaw_rad=-self.yaw_rad,
            legs=tuple((length, -turn) for length, turn in self.legs),
        )

    @cached_property
    def _time(self) -> FloatArray:
        return np.arange(FIRST_S, LAST_S, STEP_S)

    @cached_property
    def _speed(self) -> FloatArray:
        knots = np.array(self.speeds)
        wanted = np.interp(self._time, knots[:, 0], knots[:, 1])
        eased: FloatArray = uniform_filter1d(wanted, max(round(self.ease_s / STEP_S), 1), mode="nearest")
        return eased

    @cached_property
    def _driven(self) -> FloatArray:
        time_s, path_m = self.pivot
        return path_m + _cumulated(self._speed, self._time, time_s)

    @cached_property
    def _path(self) -> tuple[FloatArray, ...]:
        low, high = float(self._driven.min()) - 1.0, float(self._driven.max()) + 1.0
        path = np.arange(min(low, 0.0) - 2 * self.ramp_m, max(high, 0.0) + self.ramp_m, STEP_M)
        ends = np.cumsum([0.0, *(length for length, _ in self.legs)])
        rates = np.array([0.0, *(turn / length for length, turn in self.legs), 0.0])
        curvature = rates[np.searchsorted(ends, path, side="right")]
        curvature = uniform_filter1d(curvature, max(round(self.ramp_m / STEP_M), 1), mode="nearest")
        amplitude, wavelength, phase = self.wander
        wave = 2 * np.pi / wavelength
        yaw = self.yaw_rad + _cumulated(curvature, path, -self.ramp_m) + amplitude * wave * np.cos(wave * path + phase)
        curvature = curvature - amplitude * wave**2 * np.sin(wave * path + phase)
        # The first leg is straight before its ramp.
        x = self.start[0] - self.ramp_m * np.cos(self.yaw_rad) + _cumulated(np.cos(yaw), path, -self.ramp_m)
        y = self.start[1] - self.ramp_m * np.sin(self.yaw_rad) + _cumulated(np.sin(yaw), path, -self.ramp_m)
        return path, x, y, yaw, curvature


@dataclass(frozen=True)
class Towed:
    """The motion of a trailer's axle: its hitch moves with the towing vehicle, and its wheels do not slip sideways.

    Attributes
    ----------
    drive : Drive
        The drive of the towing vehicle's rear axle.
    hitch_m : float
        Position of the hitch ahead of that axle.
    drawbar_m : float
        Distance from the hitch to the trailer's axle.
    """

    drive: Drive
    hitch_m: float
    drawbar_m: float

    def at(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the trailer axle's positions, shape (n, 2), and the trailer's yaw, shape (n,), unwrapped."""
        yaw = np.interp(times_s, *self._yaw)
        behind = rotate_xy(yaw, np.tile([-self.drawbar_m, 0.0], (len(yaw), 1)))
        return self._hitch(times_s) + behind, yaw

    def _hitch(self, times_s: FloatArray) -> FloatArray:
        xy, yaw = self.drive.at(times_s)
        return xy + rotate_xy(yaw, np.tile([self.hitch_m, 0.0], (len(yaw), 1)))

    @cached_property
    def _yaw(self) -> tuple[FloatArray, FloatArray]:
        times = np.arange(FIRST_S, LAST_S, TOWED_STEP_S)
        moved = np.diff(self._hitch(times), axis=0)
        yaw = np.empty(len(times))
        yaw[0] = self.drive.at(times[:1])[1][0]
        for index, (x, y) in enumerate(moved.tolist()):
            now = yaw[index]
            yaw[index + 1] = now + (y * np.cos(now) - x * np.sin(now)) / self.drawbar_m
        return times, yaw


def _cumulated(rate: FloatArray, over: FloatArray, zero: float) -> FloatArray:
    """Return the integral of a rate from ``zero``."""
    total = np.concatenate([[0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * np.diff(over))])
    since: FloatArray = total - np.interp(zero, over, total)
    return since


@dataclass(frozen=True)
class Lanes:
    """The dimensions of a crossing that drives depend on; it is at the origin, and its arms lie along the axes.

    Attributes
    ----------
    offset_m : float
        Offset of the lane's middle from the road's, to the right.
    ring_m : float
        Radius at which vehicles drive around the middle of a roundabout.
    """

    offset_m: float
    ring_m: float


def draw_drive(
    rng: np.random.Generator, kind: DriveKind, lanes: Lanes, tightest_m: float, speed_mps: float | None, middle_s: float
) -> Drive:
    """Draw a drive that comes along x, to the right of the axis, and is half through its manoeuvre at ``middle_s``.

    Parameters
    ----------
    rng : Generator
    kind : DriveKind
    lanes : Lanes
    tightest_m : float
        Smallest turning radius of the vehicle.
    speed_mps : float or None
        None draws it: 3 to 20 m/s, slower in bends.
    middle_s : float
    """
    legs, start = _legs(rng, kind, lanes, tightest_m)
    total = sum(length for length, _ in legs)
    sharpest = max((abs(turn) / length for length, turn in legs), default=0.0)
    fastest = min(20.0, float(np.sqrt(LATERAL_MPS2 / sharpest)) if sharpest > 0.0 else 20.0)
    speed = rng.uniform(3.0, fastest) if speed_mps is None else speed_mps
    drive = Drive(
        start=start,
        yaw_rad=0.0,
        legs=legs,
        ramp_m=float(rng.uniform(3.0, 5.0)),
        speeds=_speeds(rng, kind, speed, middle_s),
        ease_s=float(rng.uniform(0.6, 1.2)),
        pivot=(middle_s, total / 2),
        wander=(rng.uniform(0.0, 0.2), rng.uniform(40.0, 80.0), rng.uniform(0.0, 2 * np.pi)),
    )
    if kind not in ("left_turn", "right_turn", "reverse_in_turn"):
        return drive
    # The smoothed curvature shifts the end of the path: the start is moved so that the turn ends in its lane.
    bare = replace(drive, wander=(0.0, 50.0, 0.0))
    path, x = bare._path[:2]
    wanted = -lanes.offset_m if kind == "right_turn" else lanes.offset_m
    end = float(np.interp(total + drive.ramp_m, path, x))
    return replace(drive, start=(start[0] + wanted - end, start[1]))


def _legs(
    rng: np.random.Generator, kind: DriveKind, lanes: Lanes, tightest_m: float
) -> tuple[tuple[tuple[float, float], ...], tuple[float, float]]:
    """Return the legs, and where the first one begins."""
    right = np.pi / 2
    if kind in ("left_turn", "right_turn", "reverse_in_turn"):
        turn = -right if kind == "right_turn" else right
        radius = max(rng.uniform(6.5, 11.0) if kind == "right_turn" else rng.uniform(8.0, 13.0), tightest_m)
        return ((radius * right, turn),), (0.0, -lanes.offset_m)
    if kind == "roundabout":
        return _around(rng, lanes, tightest_m)
    if kind == "lane_change":
        length, angle = rng.uniform(12.0, 25.0), rng.uniform(0.06, 0.12)
        return ((length, angle), (length, -angle)), (-length, -lanes.offset_m)
    return (), (0.0, -lanes.offset_m)


def _around(
    rng: np.random.Generator, lanes: Lanes, tightest_m: float
) -> tuple[tuple[tuple[float, float], ...], tuple[float, float]]:
    """Return legs that enter to the right, go around to the left, leave to the right: circles that touch each other."""
    entry = max(rng.uniform(10.0, 16.0), tightest_m)
    ring = max(lanes.ring_m, tightest_m)
    down = lanes.offset_m + entry
    back = float(np.sqrt((ring + entry) ** 2 - down**2))
    angle = float(np.arctan2(back, down))
    quarters = float(rng.choice([0.0, 0.5, 1.0]) * np.pi)
    around = 2 * angle + quarters
    return ((entry * angle, -angle), (ring * around, around), (entry * angle, -angle)), (-back, -lanes.offset_m)


def _speeds(
    rng: np.random.Generator, kind: DriveKind, speed: float, middle_s: float
) -> tuple[tuple[float, float], ...]:
    brake, gain = rng.uniform(1.5, 3.0), rng.uniform(1.0, 2.5)
    if kind == "stop_and_go":
        stop, wait = middle_s + rng.uniform(-1.0, 0.5), rng.uniform(1.0, 3.0)
        go = stop + wait
        return ((stop - speed / brake, speed), (stop, 0.0), (go, 0.0), (go + speed / gain, speed))
    if kind in ("reverse", "reverse_in_turn"):
        back = -rng.uniform(1.5, 3.0)
        stop, spell = middle_s - rng.uniform(2.0, 3.0), rng.uniform(2.0, 3.5)
        turn = stop + 1.0
        end = turn + spell + 2.0
        return (
            (stop - speed / brake, speed), (stop, 0.0), (turn, 0.0), (turn + 1.0, back), (turn + 1.0 + spell, back),
            (end, 0.0), (end + 0.5, 0.0), (end + 0.5 + speed / gain, speed),
        )  # fmt: skip
    change = rng.uniform(-0.3, 0.3) * speed
    spell = rng.uniform(1.5, 4.0)
    return ((middle_s - spell, speed - change / 2), (middle_s + spell, speed + change / 2))
