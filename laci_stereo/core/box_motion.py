"""What a detector's boxes contradict in their own motion: yaws that do not lie along it, speeds of the other sign."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from laci_stereo.core.frames import FloatArray, wrap
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.tracking.tracks import Track

ASKEW_DEG = 22.5
"""Median angle between boxes and their motion beyond which the yaws are wrong: halfway between 0 deg, that of right
ones, and 45 deg, that of yaws which say nothing, as a longer side is 0 to 90 deg off. Noise of a detector (5 deg) and
the slip of a vehicle's middle in a tight bend (15 deg) remain below."""

OBLONG = 1.5
"""Least ratio of a box's sides that have a direction: the shortest cars have 1.6 (2.7 m by 1.7 m), people about 1."""

CLEARLY_LESS = 0.25
"""Where the other sign leaves less than this share of the difference between two speeds, the sign is wrong: of speeds
with the right one, it leaves twice the speed instead of the noise."""


def contradictions(tracks: Sequence[Track], settings: MatchSettings) -> tuple[str, ...]:
    """Return what the motion of boxes contradicts in their yaws and radial speeds, one line each.

    Parameters
    ----------
    tracks : sequence of Track
        In a level frame below the sensor; of these, the objects that move as far as a sender's vehicle has to.
    settings : MatchSettings
    """
    moves = [tuple(_moves(track, settings.min_path_m)) for track in tracks if len(track.usable) >= settings.min_frames]
    moving = [each for each in moves if each]
    return (*_askew(moving), *_other_sign(moving))


def _moves(track: Track, step_m: float) -> Iterator[Track]:
    """Yield successive parts of a track in which the object moves by ``step_m``."""
    first, xy = 0, track.centres
    for last in range(1, len(xy)):
        if np.linalg.norm(xy[last] - xy[first]) >= step_m:
            yield Track(track.usable[first : last + 1])
            first = last


def _askew(moving: Sequence[Sequence[Track]]) -> tuple[str, ...]:
    """Return words on boxes whose longer sides do not lie along their motion."""
    off_deg = [float(np.median(np.concatenate([*map(_off_deg, moves)]))) for moves in moving if _are_oblong(moves)]
    if not off_deg or np.median(off_deg) <= ASKEW_DEG:
        return ()
    words = (
        f"the boxes' longer sides are {np.median(off_deg):.0f} deg off the direction of their motion, in the median of "
        f"{len(off_deg)} moving objects: needed is a yaw in radians from x towards y, with the length along it"
    )
    return (words,)


def _are_oblong(moves: Sequence[Track]) -> bool:
    """Return whether an object has boxes, with one side that is clearly the longer one."""
    sizes = [(one.box.length_m, one.box.width_m) for move in moves for one in move.usable if one.box.length_m > 0.0]
    length, width = np.median(np.array(sizes), axis=0) if sizes else (0.0, 1.0)
    return bool(length >= OBLONG * width)


def _off_deg(move: Track) -> FloatArray:
    """Return the angles, from 0 to 90 deg, between an object's boxes and its motion, shape (n,); without its points."""
    dx, dy = move.centres[-1] - move.centres[0]
    yaw = np.array([sighting.box.yaw_rad for sighting in move.usable if sighting.box.length_m > 0.0])
    off: FloatArray = np.degrees(np.abs(wrap(2 * (yaw - np.arctan2(dy, dx)))) / 2)
    return off


def _other_sign(moving: Sequence[Sequence[Track]]) -> tuple[str, ...]:
    """Return words on radial speeds that are positive towards the sensor."""
    speeds = np.array([_radial(move) for moves in moving for move in moves]).reshape(-1, 2)
    told, driven = speeds[np.isfinite(speeds).all(axis=1)].T
    if not len(told):
        return ()
    as_told, opposite = (float(np.median(np.abs(driven - sign * told))) for sign in (1.0, -1.0))
    if opposite >= CLEARLY_LESS * as_told:
        return ()
    words = (
        f"radial_speed is {as_told:.1f} m/s off the change of the objects' distance, in the median, and with the other "
        f"sign {opposite:.1f} m/s: needed is a speed that is positive away from the sensor"
    )
    return (words,)


def _radial(move: Track) -> tuple[float, float]:
    """Return the median radial speed of an object, NaN if unknown, and the rate at which its distance changes."""
    told = [sighting.radial_mps for sighting in move.usable if sighting.radial_mps is not None]
    range_m = np.linalg.norm(move.centres[[0, -1]], axis=1)
    rate = float(np.diff(range_m)[0] / (move.stamps_s[-1] - move.stamps_s[0]))
    return float(np.median(told)) if told else float("nan"), rate
