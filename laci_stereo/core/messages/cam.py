"""Cooperative Awareness Messages (CAMs): one sender's log, and the track of its vehicle in the world frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import Akima1DInterpolator, PPoly

from laci_stereo.core.columns import Columns
from laci_stereo.core.errors import CamError, TrackError
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray, along_line, rotate_xy, wrap
from laci_stereo.core.messages.headings import READINGS, WRONG_SHARE, check_filled, check_forwards, check_reading
from laci_stereo.core.messages.repair import (
    REAR_AXLE_SHARE,
    STANDING_MPS,
    dimensions,
    fitting,
    held_positions,
    levers,
    onwards_mps,
    usual_speed,
    usual_velocity,
)
from laci_stereo.core.messages.slope import Slope
from laci_stereo.core.messages.steps import largest_step
from laci_stereo.core.vehicle.folding import folded, longest_rigid
from laci_stereo.core.vehicle.tractrix import BodyYaw, body_yaw
from laci_stereo.core.world import World

MAX_GAP_S = 1.5
"""Longest gap between messages that is interpolated across (the lowest rate that ETSI allows is 1 Hz)."""

ELLIPSE_SIGMAS = 2.4477
"""Semi-axis of the 95 % ellipse of a two-dimensional normal distribution, in standard deviations: sqrt(-2 ln 0.05)."""

TIGHTEST_M, HURRIED_MPS2 = 3.0, 2.0
"""Smallest turning radius of the middle of a small car's rear axle (turning circle of 9.5 m from kerb to kerb,
wheelbase of 2.4 m), and the largest acceleration that a driver uses in order to turn round."""

NARROWEST_M = 1.1
"""No car is narrower (the narrowest quadricycles are 1.2 m wide). The body of a two-wheeler's rider is half as wide as
the handlebars."""

COARSE_DECIMALS, ROUNDED_SHARE = 5, 1e-3
"""Largest number of decimals of latitudes and longitudes that is checked for rounding (five are a metre), and how near
to a multiple of the last decimal's step a rounded value is, as a fraction of that step."""

METRES_PER_DEG = 111_195.0
"""Length of a degree of latitude on a sphere with the Earth's radius: wrong by at most 0.5 %."""

OTHER_SPEEDS = {"km/h": 3.6, "knots": 3.6 / 1.852, "miles per hour": 3.6 / 1.609344, "cm/s": 100.0}
"""Units that senders use instead of m/s, as multiples of m/s; no two of these are within 10 % of each other."""


@dataclass(frozen=True)
class CamLog(Columns):
    """Messages in order of time. Values that a sender did not know are NaN.

    Attributes
    ----------
    stamps_ns : ndarray of int64, shape (n,)
        Unix time (UTC), nanoseconds, ascending.
    station_id : ndarray of int64, shape (n,)
    latitude_deg, longitude_deg : ndarray, shape (n,)
        Position of the reference point, WGS84.
    heading_deg : ndarray, shape (n,)
        Direction of motion, clockwise from true north.
    speed_mps, altitude_m : ndarray, shape (n,)
    length_m, width_m : ndarray, shape (n,)
        Dimensions of the vehicle.
    semi_major_95_m, semi_minor_95_m, ellipse_orientation_deg : ndarray, shape (n,)
        The 95 % confidence ellipse of the position; its orientation is that of the major axis, clockwise from true
        north.
    """

    stamps_ns: IntArray
    station_id: IntArray
    latitude_deg: FloatArray
    longitude_deg: FloatArray
    heading_deg: FloatArray
    speed_mps: FloatArray
    altitude_m: FloatArray
    length_m: FloatArray
    width_m: FloatArray
    semi_major_95_m: FloatArray
    semi_minor_95_m: FloatArray
    ellipse_orientation_deg: FloatArray

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def stations(self) -> list[int]:
        """Return the stations in the log, the one with most messages first."""
        ids, counts = np.unique(self.station_id, return_counts=True)
        return [int(station) for station in ids[np.argsort(-counts, kind="stable")]]

    def between(self, first_ns: int, last_ns: int, clock_sigma_s: float = 0.0) -> CamLog:
        """Return the messages from just before to just after an interval, so that its ends can be interpolated.

        The margin covers clock offsets between messages and sensor of up to three times their prior standard deviation
        (`MatchSettings`).
        """
        margin_ns = int((MAX_GAP_S + 3.0 * clock_sigma_s) * 1e9)
        return self[(self.stamps_ns >= first_ns - margin_ns) & (self.stamps_ns <= last_ns + margin_ns)]

    @property
    def may_drive(self) -> BoolArray:
        """Which messages are not of a vehicle that stands by its speed, shape (n,)."""
        may: BoolArray = ~(self.speed_mps < STANDING_MPS)
        return may

    def of(self, station: int) -> CamLog:
        """Return the messages of one station."""
        return self[self.station_id == station]

    def exact_to(self, sigma_m: float) -> CamLog:
        """Return the messages with a given position uncertainty (standard deviation) where they do not report one."""
        told = np.isfinite(self.semi_major_95_m) | np.isfinite(self.semi_minor_95_m)
        major_m, minor_m = (
            np.where(told, axis, ELLIPSE_SIGMAS * sigma_m) for axis in (self.semi_major_95_m, self.semi_minor_95_m)
        )
        return replace(self, semi_major_95_m=major_m, semi_minor_95_m=minor_m)


@dataclass(frozen=True)
class ReferencePoint:
    """Point that a sender's positions refer to, in the vehicle frame (x forward, y left, from the box's centre).

    ETSI EN 302 637-2 puts it on the ground under the centre of the vehicle's front side: ``x_m`` is then half the
    vehicle's length, which None stands for.
    """

    x_m: float | None = None
    y_m: float = 0.0

    def offset(self, length_m: float) -> FloatArray:
        """Return the point in the vehicle frame, shape (2,)."""
        return np.array([length_m / 2 if self.x_m is None else self.x_m, self.y_m])


FRONT = ReferencePoint()
CENTRE = ReferencePoint(x_m=0.0)


@dataclass(frozen=True)
class VehicleTrack:
    """A vehicle's poses in the world at the stamps of its messages.

    Attributes
    ----------
    stamps_s : ndarray, shape (n,)
        Seconds since ``epoch_ns``, ascending.
    epoch_ns : int
        Unix time of second zero: the recording's first stamp.
    xy : ndarray, shape (n, 2)
        Position of the centre of the vehicle's box, on the ground, in the world frame.
    yaw_rad : ndarray, shape (n,)
        Yaw of the vehicle's body, unwrapped.
    length_m, width_m : float
    reference : tuple of float
        The point that the messages' positions refer to, vehicle frame.
    position_sigma_m : float
        Standard deviation of these positions along each axis, including that of a step between them if there is one;
        NaN where no message reports any.
    guessed_m : tuple of float
        Standard deviations of length and width where they had to be assumed, in addition to those of reported
        dimensions.
    remarks : tuple of str
        What was assumed or left out.
    objections : tuple of str
        Objections: why the messages as a whole may be wrong.
    slope : Slope or None
        Slope of the ground, where it is known; positions and yaws are then along the ground, not on the level map.
    altitude_m : ndarray, shape (n,), or None
        Altitudes of the messages, NaN where not reported; None where none is.
    """

    stamps_s: FloatArray
    epoch_ns: int
    xy: FloatArray
    yaw_rad: FloatArray
    length_m: float
    width_m: float
    reference: tuple[float, float] = (0.0, 0.0)
    position_sigma_m: float = float("nan")
    guessed_m: tuple[float, float] = (0.0, 0.0)
    remarks: tuple[str, ...] = ()
    objections: tuple[str, ...] = ()
    slope: Slope | None = None
    altitude_m: FloatArray | None = None

    def at(self, stamps_s: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Interpolate the track.

        Position and yaw follow a modified Akima spline, which does not overshoot where the motion changes abruptly.

        Returns
        -------
        xy : ndarray, shape (m, 2)
        yaw_rad : ndarray, shape (m,)
        known : ndarray of bool, shape (m,)
            False before the first message, after the last one, in gaps longer than `MAX_GAP_S`, and while the vehicle
            articulates in a bend; the pose is NaN there.
        """
        first, last = self.stretch(stamps_s)
        known = (first <= stamps_s) & (stamps_s <= last) & (first < last)
        pose = np.full((len(stamps_s), 3), np.nan)
        for begin, way in self._ways.items():
            within = known & (first == begin)
            if within.any():
                pose[within] = way(stamps_s[within])
        return pose[:, :2], pose[:, 2], known

    def stretch(self, stamps_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the interval, around the last message before each time, within which the track is known without a gap.

        Its start and its end, both of shape (m,); a time that is later than the end lies in a gap.
        """
        before = np.searchsorted(self.stamps_s, stamps_s, side="right").clip(1) - 1
        first, last = self._stretches
        return first[before], last[before]

    @cached_property
    def _stretches(self) -> tuple[FloatArray, FloatArray]:
        """For each message, the first and last stamp of the interval around it within which the track has no gap."""
        broken = (np.diff(self.stamps_s) > MAX_GAP_S) | self.folded[:-1] | self.folded[1:]
        first = np.where(np.append(True, broken), self.stamps_s, -np.inf)
        last = np.where(np.append(broken, True), self.stamps_s, np.inf)
        return np.maximum.accumulate(first), np.minimum.accumulate(last[::-1])[::-1]

    @cached_property
    def folded(self) -> BoolArray:
        """Whether the vehicle articulates in a bend at each message, so that it is no rigid body, shape (n,)."""
        if self.length_m <= longest_rigid(self.width_m):
            return np.zeros(len(self.stamps_s), dtype=bool)
        return folded(self.body, self.stamps_s, along_line(self.xy))

    @cached_property
    def body(self) -> BodyYaw:
        """Yaw of the body relative to the reported headings, for any lever."""
        return body_yaw(self.stamps_s, self.xy, self.yaw_rad)

    @cached_property
    def _ways(self) -> dict[float, PPoly]:
        """The path through each interval without a gap, by its start: messages beyond a gap do not affect its shape."""
        ways = {}
        for begin, end in zip(*(np.unique(ends) for ends in self._stretches), strict=True):
            part = (begin <= self.stamps_s) & (self.stamps_s <= end)
            if np.count_nonzero(part) == 2:
                ways[float(begin)] = _arc(self.stamps_s[part], self.xy[part], self.yaw_rad[part])
            elif part.sum() > 2:
                poses = np.column_stack([self.xy, self.yaw_rad])[part]
                ways[float(begin)] = Akima1DInterpolator(self.stamps_s[part], poses, method="makima")
        return ways


def _arc(stamps_s: FloatArray, xy: FloatArray, yaw_rad: FloatArray) -> PPoly:
    """Return the poses between two messages at constant speed and constant yaw rate: a parabola."""
    chord, turn, span_s = xy[1] - xy[0], float(wrap(yaw_rad[1] - yaw_rad[0])), stamps_s[1] - stamps_s[0]
    bend = turn / 2 * np.array([-chord[1], chord[0]])
    by_power = np.append(bend, 0.0) / span_s**2, np.append(chord - bend, turn) / span_s, np.append(xy[0], yaw_rad[0])
    return PPoly(np.array(by_power)[:, None], stamps_s)


def vehicle_track(log: CamLog, world: World, epoch_ns: int, reference: ReferencePoint = FRONT) -> VehicleTrack:
    """Turn one station's messages into the track of the centre of its vehicle, in the world frame.

    Parameters
    ----------
    log : CamLog
        Messages of one station.
    world : World
    epoch_ns : int
        Unix time of second zero of the track's stamps.
    reference : ReferencePoint
        Point of the vehicle that the positions refer to.

    Raises
    ------
    CamError
        If fewer than two messages have a position of their own, or no two are close enough in time, or fewer than half
        are consistent with one another, or headings have the wrong unit, axis or sign.
    TrackError
        If the vehicle is stationary, or so long that it articulates and no two consecutive messages find it straight.
    """
    log = log[world.holds(log.latitude_deg, log.longitude_deg)] if len(log) else log
    if len(log) < 2:
        raise CamError(f"{len(log)} CAMs with a position while it is recorded; needed are at least 2")
    (length, width), guessed, remarks = dimensions(log.length_m, log.width_m)
    xy = world.from_geodetic(log.latitude_deg, log.longitude_deg)
    held = held_positions((log.stamps_ns - epoch_ns) / 1e9, xy, log.speed_mps, STANDING_MPS)
    if held.any():
        repeat = (
            f"{np.count_nonzero(held)} of {len(held)} messages of station {log.station_id[0]} repeat an older position"
        )
        if np.count_nonzero(~held) < 2:
            raise CamError(
                f"{repeat}, while their speed is up to {np.nanmax(log.speed_mps):.1f} m/s: needed are positions that "
                "change with it, as of a receiver that has not lost its satellites"
            )
        remarks += (f"{repeat}: left out",)
        log, xy = log[~held], xy[~held]
    x, y = reference.offset(float(length)).tolist()
    arms = levers((x, y), float(length))
    fits, objections = _fitting(log, world, xy, arms)
    if not fits.all():
        left_out = f"{np.count_nonzero(~fits)} of {len(fits)} messages of station {log.station_id[0]} are left out"
        left_out += ": their positions do not follow from the others by speed and heading"
        remarks += (left_out,)
        if np.mean(~fits) > WRONG_SHARE:
            objections = (*objections, left_out)
    # The positions may refer to another point than was specified: the front, the middle, or the rear axle.
    elsewhere = ((x, y), *((share * float(length), 0.0) for share in (0.5, 0.0, REAR_AXLE_SHARE)))
    places = [arm for each in elsewhere for arm in levers(each, float(length))]
    whole = fits | _another_part(log, world, xy, fits, arms)
    sigma_m, stepped = _with_steps(log[whole], world, epoch_ns, xy[whole], places)
    log, xy_reference = log[fits], xy[fits]
    stamps_s = (log.stamps_ns - epoch_ns) / 1e9
    if (np.diff(stamps_s) > MAX_GAP_S).all():
        raise CamError(
            f"the {len(log)} messages of station {log.station_id[0]} are {np.diff(stamps_s).min():.2f} s apart or "
            f"more; needed are two within {MAX_GAP_S} s, as positions are not interpolated over longer gaps"
        )
    yaw = _body_yaw(log, world, xy_reference)
    if not np.isfinite(log.heading_deg).any():
        remarks += ("the messages report no heading: taken as that of the motion, as if the vehicle drove forwards",)
    altitude_m, of_altitude = _altitudes(log.altitude_m)
    remarks += of_altitude
    xy = xy_reference - rotate_xy(yaw, np.tile([x, y], (len(log), 1)))
    track = VehicleTrack(
        stamps_s=stamps_s,
        epoch_ns=epoch_ns,
        xy=xy,
        yaw_rad=yaw,
        length_m=float(length),
        width_m=float(width),
        reference=(x, y),
        position_sigma_m=sigma_m,
        guessed_m=(float(guessed[0]), float(guessed[1])),
        remarks=remarks,
        objections=(*objections, *stepped, *_narrow(float(width), int(log.station_id[0]))),
        altitude_m=altitude_m,
    )
    if not track.folded.any():
        return track
    return replace(track, remarks=(*remarks, _check_folding(track, int(log.station_id[0]))))


def _altitudes(altitude_m: FloatArray) -> tuple[FloatArray | None, tuple[str, ...]]:
    """Return the altitudes, shape (n,), or None if they are unknown, and what is to be remarked about them.

    A receiver's altitudes vary by centimetres at least: where all are 0, the sender fills in what it does not know.
    """
    known = altitude_m[np.isfinite(altitude_m)]
    if known.any():
        return altitude_m, ()
    return None, ("the messages report 0 m as altitude throughout: taken as unknown",) if len(known) else ()


def _fitting(
    log: CamLog, world: World, xy: FloatArray, arms: Sequence[tuple[float, float]]
) -> tuple[BoolArray, tuple[str, ...]]:
    """Return which messages, at positions ``xy``, are consistent with one another, and why all may be wrong.

    Raises
    ------
    CamError
        If fewer than half of them are, or only one is, or headings have the wrong unit, axis or sign: then not some
        messages are wrong, but a quantity in all of them.
    """
    station = int(log.station_id[0])
    stamps_s = (log.stamps_ns - log.stamps_ns[0]) / 1e9
    north = world.yaw_from_heading(np.zeros(len(log)), log.latitude_deg, log.longitude_deg)
    yaw = north - np.radians(log.heading_deg)

    def fitting_by(yaw: FloatArray) -> BoolArray:
        return fitting(stamps_s, xy, yaw, log.speed_mps, arms, _position_sigma(log), MAX_GAP_S)

    fits = fitting_by(yaw)
    if (log.heading_deg == 0.0).all():
        check_filled(fits, fitting_by(np.full(len(yaw), np.nan)), station)
    velocity = usual_velocity(stamps_s, xy)
    course_deg = np.degrees(north - np.arctan2(velocity[:, 1], velocity[:, 0]))
    check_reading(log.heading_deg, course_deg, np.linalg.norm(velocity, axis=1), station)
    if np.count_nonzero(fits) < max(2, len(fits) / 2):
        told = float(np.nanmedian(log.speed_mps)) if np.isfinite(log.speed_mps).any() else float("nan")
        moved = float(np.median(usual_speed(stamps_s, xy)))
        likely = [
            f"speed is in {unit}" for unit, per_mps in OTHER_SPEEDS.items() if abs(told - per_mps * moved) < 0.05 * told
        ]
        likely += _rounding(log, moved * float(np.median(np.diff(stamps_s))))
        likely += [
            words
            for words, read in READINGS
            if np.mean(fitting_by(north - np.radians(read(log.heading_deg)))) > 1.0 - WRONG_SHARE
        ]
        raise CamError(
            f"the messages of station {station} contradict one another: {np.count_nonzero(fits)} of "
            f"{len(fits)} positions follow from the one before by speed and heading, needed is half; the reported "
            f"speed is {told:.1f} m/s, the positions move at {moved:.1f} m/s (medians)"
            f"{'; likely: ' if likely else ''}{', or '.join(likely)}"
        )
    reversing = check_forwards(onwards_mps(stamps_s, xy, yaw)[fits], station)
    return fits, (reversing,) if reversing else ()


def _rounding(log: CamLog, step_m: float) -> list[str]:
    """Return words if positions are rounded to more than half of the distance driven between messages."""
    places = np.concatenate([log.latitude_deg, log.longitude_deg])
    for decimals in range(COARSE_DECIMALS + 1):
        steps = places * 10.0**decimals
        if (np.abs(steps - np.round(steps)) < ROUNDED_SHARE).all():
            rounded_m = METRES_PER_DEG / 10.0**decimals
            words = f"positions are rounded to {decimals} decimals, {rounded_m:.1f} m; ETSI's have 7"
            return [words] if rounded_m > step_m / 2.0 else []
    return []


def _another_part(
    log: CamLog, world: World, xy: FloatArray, fits: BoolArray, arms: Sequence[tuple[float, float]]
) -> BoolArray:
    """Return which of the messages left out are consistent with one another; none if each may be wrong by itself."""
    found = np.zeros(len(fits), dtype=bool)
    left = np.flatnonzero(~fits)
    most = WRONG_SHARE * len(fits)
    if len(left) > max(1, most):
        part = log[left]
        yaw = world.yaw_from_heading(part.heading_deg, part.latitude_deg, part.longitude_deg)
        stamps_s = (part.stamps_ns - part.stamps_ns[0]) / 1e9
        found[left] = fitting(stamps_s, xy[left], yaw, part.speed_mps, arms, _position_sigma(part), MAX_GAP_S)
    return found if np.count_nonzero(found) > most else np.zeros(len(fits), dtype=bool)


def _with_steps(
    log: CamLog, world: World, epoch_ns: int, xy: FloatArray, arms: Sequence[tuple[float, float]]
) -> tuple[float, tuple[str, ...]]:
    """Return the standard deviation of positions, including that of a step between them, and words on the step.

    Which side of the step is right is not known: a position taken from either side is off by nothing or by the whole
    step.
    """
    told_m = _position_sigma(log)
    stamps_s, yaw = (log.stamps_ns - epoch_ns) / 1e9, _body_yaw(log, world, xy)
    onwards = onwards_mps(stamps_s, xy, yaw)
    speed = np.where(np.isfinite(log.speed_mps), np.abs(log.speed_mps), np.abs(onwards))
    step_m, at_s = largest_step(stamps_s, xy, yaw, np.copysign(speed, onwards), arms, told_m)
    if step_m == 0.0:
        return told_m, ()
    words = (
        f"the positions of station {log.station_id[0]} jump sideways by {step_m:.2f} m, {at_s:.1f} s into the "
        "recording: those before or those after it are wrong by as much"
    )
    return float(np.hypot(np.nan_to_num(told_m), step_m / np.sqrt(2.0))), (words,)


def _narrow(width_m: float, station: int) -> tuple[str, ...]:
    """Return an objection if a vehicle is too narrow to be modelled as a box."""
    if width_m >= NARROWEST_M:
        return ()
    words = (
        f"the vehicle of station {station} is {width_m:.2f} m wide, as two-wheelers are over their handlebars, and "
        f"what is seen of it is narrower: the result is off by up to {width_m / 4.0:.2f} m; drive a car"
    )
    return (words,)


def _check_folding(track: VehicleTrack, station: int) -> str:
    """Return words on how many of a station's messages cannot be used because its vehicle articulates.

    Raises
    ------
    TrackError
        If no two consecutive messages are left.
    """
    folds, count = track.folded, f"{np.count_nonzero(track.folded)} of {len(track.folded)} messages"
    what = (
        f"the vehicle of station {station} is {track.length_m:.1f} m long, more than a rigid one that is "
        f"{track.width_m:.1f} m wide may be ({longest_rigid(track.width_m):g} m), so it articulates in bends"
    )
    if (folds[1:] | folds[:-1]).all():
        raise TrackError(f"{what}, which it does at {count}: drive straight")
    return f"{what}: {count} are left out, at which it does"


def _position_sigma(log: CamLog) -> float:
    """Return the standard deviation of the positions, RMS over both axes of their 95 % ellipses; NaN without one.

    Along the major axis it is too small, by a factor of at most the square root of 2, and the error of a place, which
    is the RMS over both axes, is as it is reported. An axis that is not reported is assumed to be as long as the other.
    """
    major, minor = log.semi_major_95_m, log.semi_minor_95_m
    squares = np.where(np.isfinite(major), major, minor) ** 2 + np.where(np.isfinite(minor), minor, major) ** 2
    known = squares[np.isfinite(squares)]
    return float(np.sqrt(np.median(known) / 2.0)) / ELLIPSE_SIGMAS if len(known) else float("nan")


def _body_yaw(log: CamLog, world: World, xy: FloatArray) -> FloatArray:
    """Return the body's yaw, unwrapped: the reported heading, interpolated while the vehicle is stationary.

    Where no message reports a heading, the direction in which the positions move is used.
    """
    yaw = world.yaw_from_heading(log.heading_deg, log.latitude_deg, log.longitude_deg)
    stamps_s = (log.stamps_ns - log.stamps_ns[0]) / 1e9
    if not np.isfinite(yaw).any():
        velocity = np.gradient(xy, stamps_s, axis=0)
        yaw = np.arctan2(velocity[:, 1], velocity[:, 0])
    speed = np.where(np.isfinite(log.speed_mps), log.speed_mps, _speed(xy, log.stamps_ns))
    sure = np.isfinite(yaw) & (speed >= STANDING_MPS)
    if not sure.any():
        fastest_mps = float(np.nanmax(speed[np.isfinite(yaw)], initial=0.0))
        raise TrackError(
            f"the vehicle of station {log.station_id[0]} stands still: its speed is at most {fastest_mps:.2f} m/s "
            f"according to its CAMs; needed are {STANDING_MPS} m/s"
        )
    drive = np.append(0, np.cumsum(_may_turn(np.diff(stamps_s), (speed[1:] + speed[:-1]) / 2)))[sure]
    parts = [
        _without_reversing(yaw[sure][drive == number], speed[sure][drive == number]) for number in np.unique(drive)
    ]
    filled: FloatArray = np.interp(stamps_s, stamps_s[sure], np.unwrap(np.concatenate(parts)))
    return filled


def _may_turn(passed_s: FloatArray, speed_mps: FloatArray) -> BoolArray:
    """Return during which gaps, shape (n,), a vehicle may turn by a right angle, given its mean speed at their ends.

    It may drive faster in the meantime, but has to accelerate and brake for that.
    """
    way_m = passed_s * (np.abs(speed_mps) + HURRIED_MPS2 * passed_s / 4)
    return (passed_s > MAX_GAP_S) & (way_m > TIGHTEST_M * np.pi / 2)


def _without_reversing(yaw: FloatArray, speed_mps: FloatArray) -> FloatArray:
    """Return the body's yaw from directions of motion, shape (n,), of messages between which it cannot turn round.

    From one message to the next no body turns by more than a right angle, so a direction that does belongs to a vehicle
    that reverses; and nobody drives faster backwards than forwards.
    """
    body = np.unwrap(yaw, period=np.pi)
    forwards = np.cos(yaw - body) > 0.0
    return body if speed_mps[forwards].max(initial=0.0) >= speed_mps[~forwards].max(initial=0.0) else body + np.pi


def _speed(xy: FloatArray, stamps_ns: IntArray) -> FloatArray:
    step = np.linalg.norm(np.diff(xy, axis=0), axis=1) / (np.diff(stamps_ns) / 1e9)
    return np.concatenate([step[:1], step])
