"""What of a log is wrong: messages that do not fit the others, and dimensions that cannot be a body's."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from laci_stereo.core.errors import CamError
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray, dot_xy, rotate_xy, wrap

TOLD_SIGMA_M = 0.05
"""Of a position against those before and after it, at the least, where messages tell how exact they are: receivers with
corrections tell 1 to 3 cm, and switch between satellites now and then."""

UNTOLD_SIGMA_M = 0.1
"""The same where messages tell nothing: receivers without corrections smooth their positions to that."""

SPEED_SIGMA_MPS = 0.1
"""Of a speed: ETSI's step is 1 cm/s, wheels and Doppler tell 5 to 10 cm/s."""

DIRECTION_SIGMA_RAD = 0.05
"""Of the direction of motion against the heading that is told: receivers err by 0.5 deg, and the rear axle's place is
guessed, which makes 3 deg in a tight bend."""

REAR_AXLE_SHARE = -0.3
"""Where the rear axle is, from the middle, over the length: cars and buses alike."""

LONG_M = 12.0
"""What is longer is a bus, or a lorry with a trailer (Directive 96/53/EC)..."""

TOWING_AXLES_M = (5.0, 7.0, 8.5)
"""...whose wheels that do not steer are so far behind its front: a tractor's of a semi-trailer (1.4 m of overhang and
3.6 m to the axle), a lorry's, an articulated bus's in front of the joint."""

PASSED_OVER = -math.log(0.1)
"""What it costs to take a message for wrong: in a log that is worth anything nine of ten are right."""

JUMPED = -math.log(0.002)
"""What it costs to take a step for a jump: one in five hundred, which is one in a minute. It is 3.5 sigma, so that a
tenth of a second at 10 m/s leaves 0.3 m where exactness is told, and 0.5 m where not."""

NEIGHBOURS = 5
"""Messages on either side whose median tells a speed that is not sent, in spite of some that are wrong."""

WIDEST_M = 2.6
"""No vehicle may be wider without a permit (2.55 m, refrigerated ones 2.60 m: Directive 96/53/EC; 102 inches = 2.59 m:
23 CFR 658.15), mirrors excepted. More is told by those who count the mirrors; their bodies are as wide as allowed."""

SLOWEST_M = 0.01
"""Less than this between two messages is no motion: a position's last digit."""

USUAL_WIDTH_M, USUAL_WIDTH_SIGMA_M = 1.80, 0.08
"""Of passenger cars (the mean of those sold in Europe since 2018; 1.6 m is a small one, 2.0 m a large one)."""

WIDER_PER_M, WIDTH_SIGMA_M = 0.16, 0.07
"""How much wider longer cars are, and how they differ then: from 1.63 m at 3.6 m to vans' 2.02 m at 5.9 m."""

MIRRORS_M, MIRRORS_SIGMA_M = 0.3, 0.1
"""By how much both mirrors stand out: 0.15 to 0.28 m on cars, 0.33 to 0.46 m on vans."""

OVER_MIRRORS = 0.2
"""How likely a width is told over the mirrors: SAE J2735 counts all that the factory fits, as some papers do."""

ROUNDED_M = 0.05
"""Of a width that is told to 0.1 m, some by rounding upwards."""

USUAL_LENGTH_M, USUAL_LENGTH_SIGMA_M = 4.4, 0.4
"""Of passenger cars: small ones are 3.6 m long, large ones 5.2 m."""

LONGEST_CAR_M = 6.0
"""What is longer and tells no width is a lorry or a bus."""

ALLOWED_WIDTH_M, ALLOWED_WIDTH_SIGMA_M = 2.55, 0.05


def levers(told: tuple[float, float], length_m: float) -> list[tuple[float, float]]:
    """Return the levers to the point whose position is told from those that may go where the heading points in a bend.

    These are the rear axle, or that of what tows, or the middle, where a body's yaw is told, and the point itself where
    its own direction is.

    Parameters
    ----------
    told : tuple of float
        Vehicle frame, from the middle.
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
    """Tell which messages fit one another.

    One follows from another if its position is where both speeds and directions lead in the time between. Of all ways
    to go through a log from message to message, passing over some and taking some steps for jumps, the likeliest is
    taken; of what jumps divide, the part with most messages is kept.

    Parameters
    ----------
    stamps_s : ndarray, shape (n,)
        Ascending.
    xy : ndarray, shape (n, 2)
        Positions in the world, metres.
    yaw_rad : ndarray, shape (n,)
        Directions that were told; NaN where none was. Whoever reverses may tell the opposite one.
    speed_mps : ndarray, shape (n,)
        NaN where none was told.
    levers : sequence of tuple of float
        See `levers`.
    sigma_m : float
        What the messages tell of their positions; NaN where nothing.
    longest_s : float
        What is on both sides of a longer gap cannot be compared.
    """
    speed = np.abs(np.where(np.isfinite(speed_mps), speed_mps, usual_speed(stamps_s, xy)))
    direction = np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad)])
    backwards = onwards_mps(stamps_s, xy, yaw_rad) < 0.0
    velocity = np.where(backwards, -speed, speed)[:, None] * direction
    white = np.sqrt(2.0) * (max(TOLD_SIGMA_M, sigma_m) if np.isfinite(sigma_m) else UNTOLD_SIGMA_M)

    points = np.stack([xy - rotate_xy(yaw_rad, np.tile(lever, (len(xy), 1))) for lever in levers])
    farthest_m = max(float(np.hypot(*lever)) for lever in levers)

    def strain(i: int, j: IntArray) -> FloatArray:
        """Return how much less likely it is that i follows from each of j than in the best case."""
        passed, fast = stamps_s[i] - stamps_s[j], (speed[i] + speed[j]) / 2
        expected = (velocity[i] + velocity[j]) / 2 * passed[:, None]
        off = np.fmin.reduce(np.linalg.norm(points[:, i, None] - points[:, j] - expected, axis=2))
        # Where the direction is the point's own but the speed the wheels', the point swings out faster than that.
        swing = farthest_m * np.abs(wrap(yaw_rad[i] - yaw_rad[j]))
        most = np.hypot(1.0, swing / np.maximum(fast * passed, SLOWEST_M))
        longer = dot_xy(xy[i] - xy[j], expected) / np.maximum(dot_xy(expected, expected), SLOWEST_M**2)
        own = xy[i] - xy[j] - np.clip(longer, 1.0, most)[:, None] * expected
        off = np.fmin(off, np.linalg.norm(own, axis=1))
        off = np.where(np.isfinite(off), off, np.abs(np.linalg.norm(xy[i] - xy[j], axis=1) - fast * passed))
        squared: FloatArray = (off / np.hypot(white, (SPEED_SIGMA_MPS + DIRECTION_SIGMA_RAD * fast) * passed)) ** 2
        return squared / 2

    keep = np.zeros(len(stamps_s), dtype=bool)
    gaps = np.flatnonzero(np.diff(stamps_s) > longest_s) + 1
    for part in np.split(np.arange(len(stamps_s)), gaps):
        starts = np.searchsorted(stamps_s, stamps_s[part] - longest_s).clip(part[0])
        keep[_likeliest(part, starts, strain)] = True
    return keep


def _likeliest(part: IntArray, starts: IntArray, strain: Callable[[int, IntArray], FloatArray]) -> IntArray:
    """Return the longest piece without a jump of the likeliest way through a part of a log (dynamic programming).

    Parameters
    ----------
    part : ndarray, shape (n,)
        Consecutive indices of messages.
    starts : ndarray, shape (n,)
        The first message that each can follow from.
    strain : callable
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
    """Return how fast positions move, shape (n,), by the medians over some messages before and after."""
    speed: FloatArray = np.nanmedian(np.linalg.norm(_rates(stamps_s, xy), axis=2), axis=1)
    return speed


def usual_velocity(stamps_s: FloatArray, xy: FloatArray) -> FloatArray:
    """Return how positions move, shape (n, 2), by the medians over some messages before and after."""
    velocity: FloatArray = np.nanmedian(_rates(stamps_s, xy), axis=1)
    return velocity


def onwards_mps(stamps_s: FloatArray, xy: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Return how fast positions move where the yaw points, shape (n,), negative backwards; 0 where it is not told."""
    direction = np.nan_to_num(np.column_stack([np.cos(yaw_rad), np.sin(yaw_rad)]))
    onwards: FloatArray = np.nanmedian(np.einsum("nkj,nj->nk", _rates(stamps_s, xy), direction), axis=1)
    return onwards


def _rates(stamps_s: FloatArray, xy: FloatArray) -> FloatArray:
    """Return the velocity from each of n > 1 messages to its neighbours, shape (n, neighbours, 2); NaN beyond ends."""
    around = np.concatenate([np.arange(-NEIGHBOURS, 0), np.arange(1, NEIGHBOURS + 1)])
    other = np.arange(len(xy))[:, None] + around
    beyond = (other < 0) | (other >= len(xy))
    other = other.clip(0, len(xy) - 1)
    passed = np.where(beyond, np.nan, stamps_s[other] - stamps_s[:, None])
    rates: FloatArray = (xy[other] - xy[:, None]) / passed[..., None]
    return rates


def dimensions(length_m: FloatArray, width_m: FloatArray) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """Return a vehicle's length and width, what they may be off by beyond what is usual, and remarks.

    Parameters
    ----------
    length_m, width_m : ndarray, shape (n,)
        As told; NaN where not.

    Returns
    -------
    size, sigma : ndarray, shape (2,)
        Metres.
    remarks : tuple of str
        What had to be assumed.

    Raises
    ------
    CamError
        If it is wider than long, or as wide as a lorry and of unknown length.
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
        remarks.append(f"the messages tell no length of the vehicle: taken as a car's, {length} +- {sigma[0]} m")
    if not np.isfinite(width):
        car = length <= LONGEST_CAR_M
        width = USUAL_WIDTH_M if car else ALLOWED_WIDTH_M
        sigma[1] = USUAL_WIDTH_SIGMA_M if car else ALLOWED_WIDTH_SIGMA_M
        kind = "car" if car else "lorry"
        remarks.append(f"the messages tell no width of the vehicle: taken as a {kind}'s, {width} +- {sigma[1]} m")
    elif width > WIDEST_M:
        remarks.append(
            f"the messages tell a width of {width:.2f} m, more than roads allow ({WIDEST_M} m), so it is over "
            f"the mirrors: taken as {ALLOWED_WIDTH_M} +- {ALLOWED_WIDTH_SIGMA_M} m"
        )
        width, sigma[1] = ALLOWED_WIDTH_M, ALLOWED_WIDTH_SIGMA_M
    elif sigma[0] == 0.0 and length <= LONGEST_CAR_M:
        told, (width, sigma[1]) = width, _without_mirrors(length, width)
        if width < told:
            remarks.append(
                f"the messages tell a width of {told:.2f} m, which a vehicle of {length:.2f} m has over its mirrors: "
                f"taken as {width:.2f} +- {sigma[1]:.2f} m"
            )
    return np.array([length, width]), sigma, tuple(remarks)


def _without_mirrors(length_m: float, told_m: float) -> tuple[float, float]:
    """Return the likelier of a car's width as told and its width if that is over the mirrors, and what it may be off.

    By Bayes' rule between the two, from how wide cars of this length are; the other one counts in the variance. What is
    told is not over the mirrors where the body would be even wider.
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
