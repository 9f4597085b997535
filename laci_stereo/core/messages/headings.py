"""Headings that are wrong in all messages of a log: in another unit, from another axis, or turned by 180 deg."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from laci_stereo.core.errors import CamError
from laci_stereo.core.frames import BoolArray, FloatArray
from laci_stereo.core.messages.repair import DIRECTION_SIGMA_RAD

MOVING_MPS = 2.0
"""At lower speeds, errors of positions change the direction in which they move."""

FEWEST = 5
"""With fewer messages nothing can be said about all of them."""

WRONG_SHARE = 0.3
"""Largest fraction of messages that may be wrong, each by itself."""

SURELY_OFF_DEG = float(np.degrees(4.0 * DIRECTION_SIGMA_RAD))
"""Four standard deviations: correct headings are not off by as much in most messages."""

REVERSING_MPS = 4.0
"""Nobody reverses faster: it is a jogger's pace, and the driver has to look back all the time."""

NEEDED = "needed are degrees clockwise from north"

Reading = Callable[[FloatArray], FloatArray]
READINGS: tuple[tuple[str, Reading], ...] = (
    ("headings are in radians", np.degrees),
    ("headings are in radians, counter-clockwise from east", lambda told: 90.0 - np.degrees(told)),
    ("headings are counter-clockwise from east", lambda told: 90.0 - told),
    ("headings are counter-clockwise, or the longitudes lack their sign", lambda told: -told),
    ("the latitudes lack their sign", lambda told: 180.0 - told),
    ("headings are in degrees and were taken for tenths", lambda told: 10.0 * told),
)
"""What senders and loggers write instead of headings, with functions from that to the heading; angles lie between -180
and 180 deg."""


def check_reading(heading_deg: FloatArray, course_deg: FloatArray, speed_mps: FloatArray, station: int) -> None:
    """Check that headings are degrees clockwise from north.

    They are not if another interpretation is close to the direction in which the positions move, while the reported
    headings are close neither to that direction nor to its opposite.

    Parameters
    ----------
    heading_deg : ndarray, shape (n,)
        As reported; NaN where not.
    course_deg, speed_mps : ndarray, shape (n,)
        Direction, clockwise from north, and speed of the motion of the positions.
    station : int

    Raises
    ------
    CamError
        With the likely interpretations.
    """
    moves = np.isfinite(heading_deg) & (speed_mps >= MOVING_MPS)
    if np.count_nonzero(moves) < FEWEST:
        return
    told, course = _half_turn(heading_deg[moves]), course_deg[moves]
    off = np.abs(_half_turn(told - course))
    off_deg = _most(np.minimum(off, 180.0 - off))
    if off_deg <= SURELY_OFF_DEG:
        return
    likely = [words for words, read in READINGS if _most(np.abs(_half_turn(read(told) - course))) < off_deg / 4]
    if likely:
        raise CamError(
            f"heading is {off_deg:.0f} deg off the way in which the positions of station {station} move, such as "
            f"{heading_deg[moves][0]:.4g} where they move towards {course[0] % 360.0:.0f} deg; {NEEDED}; likely: "
            f"{', or '.join(likely)}"
        )


def check_forwards(onwards_mps: FloatArray, station: int) -> str:
    """Check that a vehicle does not reverse faster than anybody would, and return words if it reverses all the time.

    Parameters
    ----------
    onwards_mps : ndarray, shape (n,)
        Speed of the positions along the heading; negative where they move the opposite way.
    station : int

    Raises
    ------
    CamError
        If it reverses in most of the messages in which it is faster than people reverse.
    """
    turned = (
        "the headings are turned by 180 deg, or count counter-clockwise, or longitudes or latitudes lack their sign"
    )
    fast, back = np.abs(onwards_mps) > REVERSING_MPS, onwards_mps < 0.0
    count = np.count_nonzero(fast & back)
    if 2 * count > np.count_nonzero(fast) and count > 1:
        raise CamError(
            f"the vehicle of station {station} would reverse at up to {-onwards_mps.min():.1f} m/s in {count} of "
            f"{len(onwards_mps)} messages: its positions move the other way than heading says; needed are at most "
            f"{REVERSING_MPS:g} m/s; likely: {turned}"
        )
    moves = np.abs(onwards_mps) >= MOVING_MPS
    if np.count_nonzero(moves) < FEWEST or np.count_nonzero(moves & back) <= 0.9 * np.count_nonzero(moves):
        return ""
    return (
        f"the vehicle of station {station} reverses all the way, by its headings; if it does not, {turned}, and the "
        "result is off by up to its length"
    )


def check_filled(fits: BoolArray, fits_without: BoolArray, station: int) -> None:
    """Check that headings that are all 0 are real, rather than a placeholder for unknown ones.

    Parameters
    ----------
    fits, fits_without : ndarray of bool, shape (n,)
        Which messages are consistent with one another, with and without their headings.
    station : int

    Raises
    ------
    CamError
        If more messages are consistent without headings than chance explains.
    """
    gained = np.count_nonzero(fits_without) - np.count_nonzero(fits)
    if gained > WRONG_SHARE / 2 * len(fits):
        raise CamError(
            f"heading is 0 in all of {len(fits)} messages of station {station}, but {gained} of their positions move "
            f"another way; {NEEDED}, or none at all where they are not known"
        )


def _half_turn(angle_deg: FloatArray) -> FloatArray:
    """Return the same angles, wrapped to between -180 and 180 deg."""
    wrapped: FloatArray = (angle_deg + 180.0) % 360.0 - 180.0
    return wrapped


def _most(off_deg: FloatArray) -> float:
    """Return the largest error among correct headings: the quantile that excludes the fraction that may be wrong."""
    return float(np.quantile(off_deg, 1.0 - WRONG_SHARE))
