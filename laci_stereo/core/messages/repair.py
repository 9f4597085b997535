"""Errors in a log: messages that are inconsistent with the others, and dimensions that cannot be those of a body.

A message's *lever* is the vector to the point that its position refers to from the point that moves where its heading
points: a rear axle, or the middle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from laci_stereo.core.errors import CamError
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray, dot_xy, rotate_xy, wrap

TOLD_SIGMA_M = 0.05
"""Least standard deviation of a position relative to those before and after it where messages report their accuracy:
receivers with corrections report 1 to 3 cm, and switch between satellites now and then."""

UNTOLD_SIGMA_M = 0.1
"""The same where messages report no accuracy: receivers without corrections smooth their positions to that."""

SPEED_SIGMA_MPS = 0.1
"""Standard deviation of a speed: ETSI's resolution is 1 cm/s, wheel and Doppler speeds are accurate to 5 to 10 cm/s."""

DIRECTION_SIGMA_RAD = 0.05
"""Standard deviation of the direction of motion relative to the reported heading: receivers err by 0.5 deg, and the
position of the rear axle is assumed, which makes 3 deg in a tight bend."""

REAR_AXLE_SHARE = -0.3
"""Position of the rear axle relative to the vehicle's middle, over its length: the same for cars and buses."""

LONG_M = 12.0
"""Longer vehicles are buses, or lorries with a trailer (Directive 96/53/EC)..."""

TOWING_AXLES_M = (5.0, 7.0, 8.5)
"""...whose rear axle of the towing part is that far behind the front: a semi-trailer's tractor (1.4 m of overhang and
3.6 m of wheelbase), a lorry, an articulated bus ahead of its joint."""

PASSED_OVER = -math.log(0.1)
"""Cost (negative log-likelihood) of discarding a message as wrong: in any usable log nine of ten are right."""

JUMPED = -math.log(0.002)
"""Cost (negative log-likelihood) of explaining a step as a jump: one message in five hundred, which is one a minute. It
corresponds to 3.5 sigma: 0.1 s at 10 m/s leaves 0.3 m where accuracy is reported, and 0.5 m where it is not."""

STANDING_MPS = 0.5
"""Below this speed the heading, which is the direction of motion, does not determine the yaw of the vehicle's body."""

BRAKES_MPS2 = 8.0
"""Largest deceleration of a car, on a dry road."""

NEIGHBOURS = 5
"""Messages on either side over which the median speed is taken where none is reported; it is robust to some wrong
ones."""

WIDEST_M = 2.6
"""No vehicle may be wider without a permit (2.55 m, refrigerated ones 2.60 m: Directive 96/53/EC; 102 inches = 2.59 m:
23 CFR 658.15), mirrors excepted. Senders that report more include the mirrors; their bodies have the permitted
width."""

SLOWEST_M = 0.01
"""A shorter distance between two messages is no motion: it is the last digit of a position."""

USUAL_WIDTH_M, USUAL_WIDTH_SIGMA_M = 1.80, 0.08
"""Width of passenger cars (mean of those sold in Europe since 2018; a small one has 1.6 m, a large one 2.0 m)."""

WIDER_PER_M, WIDTH_SIGMA_M = 0.16, 0.07
"""Increase of a car's width with its length, and the dispersion about it: from 1.63 m at 3.6 m to vans' 2.02 m at 5.9
m."""

MIRRORS_M, MIRRORS_SIGMA_M = 0.3, 0.1
"""Protrusion of both mirrors together: 0.15 to 0.28 m on cars, 0.33 to 0.46 m on vans."""

OVER_MIRRORS = 0.2
"""Prior probability that a reported width includes the mirrors: SAE J2735 counts everything that is fitted by the
factory, as some vehicle papers do."""

ROUNDED_M = 0.05
"""Standard deviation of a width that is reported to 0.1 m, by some senders rounded up."""

USUAL_LENGTH_M, USUAL_LENGTH_SIGMA_M = 4.4, 0.4
"""Length of passenger cars: small ones are 3.6 m long, large ones 5.2 m."""

LONGEST_CAR_M = 6.0
"""A longer vehicle without a reported width is a lorry or a bus."""

ALLOWED_WIDTH_M, ALLOWED_WIDTH_SIGMA_M = 2.55, 0.05


def held_positions(stamps_s: FloatArray, xy: FloatArray, speed_mps: FloatArray, standing_mps: float) -> BoolArray:
    """Return which messages repeat an older position, shape (n,), although the vehicle moves.

    Senders repeat a receiver's last position until it has a new one, such as one per second in ten messages. That the
    vehicle moves is reported by its speed, or where that is missing follows from the next position.

    Parameters
    ----------
    stamps_s : ndarray, shape (n,)
        Times of the messages, ascending.
    xy : ndarray, shape (n, 2)
        Their positions, metres.
    speed_mps : ndarray, shape (n,)
        The reported speeds; NaN where unknown.
    standing_mps : float
        Speed up to which a vehicle may be stationary.
    """
    new = np.append(True, (np.diff(xy, axis=0) != 0.0).any(axis=1))
    first = np.flatnonzero(new)
    lasts_s = np.maximum(np.diff(stamps_s[first]), 1e-9)
    by_positions = np.append(np.linalg.norm(np.diff(xy[first], axis=0), axis=1) / lasts_s, 0.0)[np.cumsum(new) - 1]
    held: BoolArray = ~new & (np.where(np.isfinite(speed_mps), speed_mps, by_positions) > standing_mps)
    return held


def levers(told: tuple[float, float], length_m: float) -> list[tuple[float, float]]:
    """Return the possible levers from the point that moves where the heading points to the reported point.

    The former is the rear axle, or that of the towing part, or the middle, if the reported heading is the body's yaw;
    the lever is zero if the heading is the reported point's own direction of motion.

    Parameters
    ----------
    told : tuple of float
        Reported point, vehicle frame, from the middle.
    length_m : float
    """
    x, y = told
    axles = [REAR_AXLE_SHARE * length_m]
    if length_m > LONG_M:
        axles += [length_m / 2 - behind_m for behind_m in TOWING_AXLES_M]
    return [(0.0, 0.0), (x, y), *((x - axle, y) for axle in axles)]


def fitting(
    stamps_s: FloatArray,
    xy: FloatArray,
    yaw_rad: FloatArray,
    speed_mps: FloatArray,
    levers: Sequence[tuple[float, float]],
    sigma_m: float,
    longest_s: float,
) -> BoolArray:
    """Return which messages are consistent with one another.

    One message follows from another if its position is where the speeds and directions of both lead in the time
    between. Of all paths through a log from message to message, each of which discards some messages and explains some
    steps as jumps, the likeliest is taken; of the parts that jumps divide it into, the one with most messages is kept.

    Parameters
    ----------
    stamps_s : ndarray, shape (n,)
        Ascending.
    xy : ndarray, shape (n, 2)
        Positions in the world, metres.
    yaw_rad : ndarray, shape (n,)
        Reported directions; NaN where none was. A vehicle that reverses may report the opposite one: of its motion,
        which its speed is along, while levers are turned with its body.
    speed_mps : ndarray, shape (n,)
        NaN where none was reported.
    levers : sequence of tuple of float
        See `levers`.
    sigma_m : float
        Reported standard deviation of the positions; NaN if none is.
    longest_s : float
        Messages on both sides of a longer gap are not compared.
    """
    speed = np.abs(np.where(np.isfinite(speed_mps), speed_mps, usual_speed(stamps_s, xy)))
    direction = np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad)])
    parts = np.split(np.arange(len(stamps_s)), np.flatnonzero(np.diff(stamps_s) > longest_s) + 1)
    body, backwards = _body_and_sense(stamps_s, xy, yaw_rad, speed, parts)
    velocity = np.where(backwards, -speed, speed)[:, None] * direction
    white = np.sqrt(2.0) * (max(TOLD_SIGMA_M, sigma_m) if np.isfinite(sigma_m) else UNTOLD_SIGMA_M)

    points = np.stack([xy - rotate_xy(body, np.tile(lever, (len(xy), 1))) for lever in levers])
    farthest_m = max(float(np.hypot(*lever)) for lever in levers)

    def strain(i: int, j: IntArray) -> FloatArray:
        """Return the negative log-likelihood, relative to its best value, of i following from each of j."""
        passed, fast = stamps_s[i] - stamps_s[j], (speed[i] + speed[j]) / 2
        expected = (velocity[i] + velocity[j]) / 2 * passed[:, None]
        off = np.fmin.reduce(np.linalg.norm(points[:, i, None] - points[:, j] - expected, axis=2))
        # Where the direction is the reported point's own, but the speed the wheels', the point swings out faster than
        # that.
        swing = farthest_m * np.abs(wrap(yaw_rad[i] - yaw_rad[j]))
        most = np.hypot(1.0, swing / np.maximum(fast * passed, SLOWEST_M))
        longer = dot_xy(xy[i] - xy[j], expected) / np.maximum(dot_xy(expected, expected), SLOWEST_M**2)
        own = xy[i] - xy[j] - np.clip(longer, 1.0, most)[:, None] * expected
        off = np.fmin(off, np.linalg.norm(own, axis=1))
        off = np.where(np.isfinite(off), off, np.abs(np.linalg.norm(xy[i] - xy[j], axis=1) - fast * passed))
        squared: FloatArray = (off / np.hypot(white, (SPEED_SIGMA_MPS + DIRECTION_SIGMA_RAD * fast) * passed)) ** 2
        return squared / 2

    keep = np.zeros(len(stamps_s), dtype=bool)
    for part in parts:
        starts = np.searchsorted(stamps_s, stamps_s[part] - longest_s).clip(part[0])
        keep[_likeliest(part, starts, strain)] = True
    return keep


def _body_and_sense(
    stamps_s: FloatArray, xy: FloatArray, yaw_rad: FloatArray, speed_mps: FloatArray, parts: Sequence[IntArray]
) -> tuple[FloatArray, BoolArray]:
    """Return the body's yaw, and which messages move against the direction that they report, each of shape (n,)."""
    body, backwards = yaw_rad.copy(), onwards_mps(stamps_s, xy, yaw_rad) < 0.0
    for part in parts:
        reverses = _reversing(stamps_s[part], yaw_rad[part], speed_mps[part])
        body[part] += np.pi * reverses
        runs = np.split(part, np.flatnonzero(np.diff(reverses)) + 1)
        for run in runs if len(runs) > 1 else ():
            if len(run) > 1:  # neighbours of before and after the direction turned over move the other way
                backwards[run] = onwards_mps(stamps_s[run], xy[run], yaw_rad[run]) < 0.0
    return body, backwards


def _reversing(stamps_s: FloatArray, yaw_rad: FloatArray, speed_mps: FloatArray) -> BoolArray:
    """Return in which messages the reported direction is opposite to the body's, shape (n,).

    It is a direction of motion, so it turns over where a vehicle stops and goes back: where its speeds before and after
    are such that it can have stopped in between. Elsewhere such a direction is wrong. A vehicle that creeps or stands
    may report either, but its body stays as it was. Nobody drives faster backwards than forwards.

    Parameters
    ----------
    stamps_s, yaw_rad, speed_mps : ndarray, shape (n,)
        Of messages without a long gap; speeds are not negative.
    """
    sure = np.flatnonzero(np.isfinite(yaw_rad) & (speed_mps >= STANDING_MPS))
    if not len(sure):
        return np.zeros(len(stamps_s), dtype=bool)
    one, other = sure[:-1], sure[1:]
    stops = speed_mps[one] + speed_mps[other] <= BRAKES_MPS2 * (stamps_s[other] - stamps_s[one])
    turned_over = stops & (np.cos(yaw_rad[other] - yaw_rad[one]) < 0.0)
    back: BoolArray = np.append(False, np.cumsum(turned_over) % 2 == 1)
    if speed_mps[sure[back]].max(initial=0.0) > speed_mps[sure[~back]].max(initial=0.0):
        back = ~back
    last = np.searchsorted(sure, np.arange(len(stamps_s)), side="right").clip(1) - 1
    reverses: BoolArray = np.cos(yaw_rad - (yaw_rad[sure] + np.pi * back)[last]) < 0.0
    return reverses


def _likeliest(part: IntArray, starts: IntArray, strain: Callable[[int, IntArray], FloatArray]) -> IntArray:
    """Return the longest piece without a jump of the likeliest path through a part of a log (dynamic programming).

    Parameters
    ----------
    part : ndarray, shape (n,)
        Consecutive indices of messages.
    starts : ndarray, shape (n,)
        Index of the first message that each can follow from.
    strain : callable
        Negative log-likelihood of message i following from each of the messages j.
    """
    first = int(part[0])
    cost = PASSED_OVER * np.arange(len(part), dtype=np.float64)
    before = np.full(len(part), -1)
    jumped = np.zeros(len(part), dtype=bool)
    for i in range(1, len(part)):
        j = np.arange(starts[i] - first, i)
        bent = strain(first + i, first + j)
        total = cost[j] + PASSED_OVER * (i - 1 - j) + np.minimum(bent, JUMPED)
        best = int(total.argmin())
        if total[best] < cost[i]:
            cost[i], before[i], jumped[i] = total[best], j[best], bent[best] > JUMPED
    i = int((cost + PASSED_OVER * np.arange(len(part))[::-1]).argmin())
    pieces: list[list[int]] = [[]]
    while i >= 0:
        pieces[-1].append(first + i)
        if jumped[i]:
            pieces.append([])
        i = int(before[i])
    return np.array(max(pieces, key=len))


def usual_speed(stamps_s: FloatArray, xy: FloatArray) -> FloatArray:
    """Return the speed of the positions, shape (n,), the median over some messages before and after each."""
    speed: FloatArray = np.nanmedian(np.linalg.norm(_rates(stamps_s, xy), axis=2), axis=1)
    return speed


def usual_velocity(stamps_s: FloatArray, xy: FloatArray) -> FloatArray:
    """Return the velocity of the positions, shape (n, 2), the medians over some messages before and after each."""
    velocity: FloatArray = np.nanmedian(_rates(stamps_s, xy), axis=1)
    return velocity


def onwards_mps(stamps_s: FloatArray, xy: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Return the speed of the positions along the yaw, shape (n,), negative backwards; 0 where no yaw is reported."""
    direction = np.nan_to_num(np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad)]))
    onwards: FloatArray = np.nanmedian(np.einsum("nkj,nj->nk", _rates(stamps_s, xy), direction), axis=1)
    return onwards


def _rates(stamps_s: FloatArray, xy: FloatArray) -> FloatArray:
    """Return the velocity from each of n > 1 messages to its neighbours, shape (n, neighbours, 2); NaN past ends."""
    around = np.concatenate([np.arange(-NEIGHBOURS, 0), np.arange(1, NEIGHBOURS + 1)])
    other = np.arange(len(xy))[:, None] + around
    beyond = (other < 0) | (other >= len(xy))
    other = other.clip(0, len(xy) - 1)
    passed = np.where(beyond, np.nan, stamps_s[other] - stamps_s[:, None])
    rates: FloatArray = (xy[other] - xy[:, None]) / passed[..., None]
    return rates


def dimensions(length_m: FloatArray, width_m: FloatArray) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """Return a vehicle's length and width, their uncertainty in addition to the usual one, and remarks.

    Parameters
    ----------
    length_m, width_m : ndarray, shape (n,)
        As reported; NaN where not.

    Returns
    -------
    size, sigma : ndarray, shape (2,)
        Dimensions and their additional standard deviations, metres.
    remarks : tuple of str
        What had to be assumed.

    Raises
    ------
    CamError
        If the vehicle is wider than long, or as wide as a lorry and of unknown length.
    """
    length, width = _told(length_m), _told(width_m)
    if width > length:
        raise CamError(
            f"the vehicle's width, {width:.2f} m, exceeds its length, {length:.2f} m; exchanged? Needed is a larger "
            "length"
        )
    sigma, remarks = np.zeros(2), []
    if not np.isfinite(length):
        if width > WIDEST_M - 2 * ALLOWED_WIDTH_SIGMA_M:
            raise CamError(
                f"the vehicle's length is in none of the {len(length_m)} messages, and its width, {width:.2f} m, is "
                "that of a lorry or a bus, which may be of any; needed is its length"
            )
        length, sigma[0] = USUAL_LENGTH_M, USUAL_LENGTH_SIGMA_M
        remarks.append(f"the messages report no length of the vehicle: taken as a car's, {length} +- {sigma[0]} m")
    if not np.isfinite(width):
        car = length <= LONGEST_CAR_M
        width = USUAL_WIDTH_M if car else ALLOWED_WIDTH_M
        sigma[1] = USUAL_WIDTH_SIGMA_M if car else ALLOWED_WIDTH_SIGMA_M
        kind = "car" if car else "lorry"
        remarks.append(f"the messages report no width of the vehicle: taken as a {kind}'s, {width} +- {sigma[1]} m")
    elif width > WIDEST_M:
        remarks.append(
            f"the messages report a width of {width:.2f} m, more than roads allow ({WIDEST_M} m), so it is over "
            f"the mirrors: taken as {ALLOWED_WIDTH_M} +- {ALLOWED_WIDTH_SIGMA_M} m"
        )
        width, sigma[1] = ALLOWED_WIDTH_M, ALLOWED_WIDTH_SIGMA_M
    elif sigma[0] == 0.0 and length <= LONGEST_CAR_M:
        told, (width, sigma[1]) = width, _without_mirrors(length, width)
        if width < told:
            remarks.append(
                f"the messages report a width of {told:.2f} m, which a vehicle of {length:.2f} m has over its mirrors: "
                f"taken as {width:.2f} +- {sigma[1]:.2f} m"
            )
    return np.array([length, width]), sigma, tuple(remarks)


def _without_mirrors(length_m: float, told_m: float) -> tuple[float, float]:
    """Return a car's likelier width, with or without the mirrors subtracted, and its additional standard deviation.

    Bayes' rule decides between the two, with the widths of cars of this length as the prior; the less likely one counts
    in the variance. A reported width does not include the mirrors where the body's would come out even larger.
    """
    usual_m = USUAL_WIDTH_M + WIDER_PER_M * (length_m - USUAL_LENGTH_M)
    sigmas = np.hypot(WIDTH_SIGMA_M, (ROUNDED_M, math.hypot(ROUNDED_M, MIRRORS_SIGMA_M)))
    away = (told_m - usual_m - np.array([0.0, MIRRORS_M])) / sigmas
    as_told, over = np.array([1.0 - OVER_MIRRORS, OVER_MIRRORS]) * np.exp(-(away**2) / 2) / sigmas
    is_over = float(over / max(as_told + over, 1e-300))
    know = np.array([WIDTH_SIGMA_M, math.hypot(ROUNDED_M, MIRRORS_SIGMA_M)]) ** -2
    body_m = float(know @ (usual_m, told_m - MIRRORS_M) / know.sum())
    if body_m >= told_m:
        return told_m, 0.0
    variance, apart = float(1.0 / know.sum()), (told_m - body_m) ** 2
    if is_over > 0.5:
        return body_m, math.sqrt(variance + (1.0 - is_over) * apart)
    return told_m, math.sqrt(is_over * (variance + apart))


def _told(values_m: FloatArray) -> float:
    known = values_m[np.isfinite(values_m)]
    return float(np.median(known)) if len(known) else float("nan")
