"""How likely a hypothesis makes what was seen of one station.

Frames are not independent, because what is visible of a vehicle changes only as it moves, so everything is counted per
metre of its path.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, label

from laci_stereo.core.frames import BoolArray, FloatArray, rotate_xy
from laci_stereo.core.robust import weighted_median
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.track_motion import OUTLIER, Motion, completed, cost, fit_all, path_shares, trust
from laci_stereo.core.track_scene import KNOT_S, TABLE_S, Knots, Poses, Scene, Sender
from laci_stereo.core.tracking import GATE, Track

PRECISIONS = (1.0, 0.7, 0.5, 0.35, 0.25)
"""How exact positions may be, relative to the settings' sigma: from GNSS alone down to one with carrier phases."""

RADIAL_SIGMA_MPS = 0.3
"""Of a radial speed: wheels and the Doppler cell of a radar."""

RADIAL_SLOPE = 0.05
"""A sensor 6 m above ground that is 20 m away sees cos(17 deg) = 0.95 of a speed along the ground."""

SIZE_SIGMA_M = 0.5
"""By how much a box may be longer than the vehicle's diagonal: the reach of a cluster on both of its ends."""

SPEED_SPREAD = 0.2
"""Standard deviation of the speeds of free traffic, relative to their mean: how likely a stranger has the same."""

MANOEUVRES = 3
"""However special a drive is, a stranger may make the same at another time, since it has the same roads and lights:
straight on, to the left or to the right."""

OTHER_TIME_S = 3.0
"""Searched is so long before and after; what fits at a time farther off has turned or stopped elsewhere by then."""

USUAL_MPS2 = 1.0
"""Standard deviation of accelerations in traffic, along and across."""

MAX_ORDER = 5
"""Up to this order a stranger's path is a polynomial; its bends and stops within the view are one or two."""

MAX_GOOD_SIGMA = 2.0
"""The median of what remains of a right match is 1.2 sigma in two dimensions; of five stretches, 2 % exceed this."""

MISSED = -math.log(0.2)
"""What a stretch costs in which a vehicle that must be in view is not seen: one in five is hidden by other traffic."""

HIDDEN_STRETCHES = 2.0
"""What hides a vehicle, such as one that comes towards it, does so on average for two more stretches."""


@dataclass(frozen=True)
class Account:
    """What a hypothesis says of one station.

    Attributes
    ----------
    station : int
    tracks : tuple of int
        Those that are its vehicle's, the one that is explained best first.
    explained : float
        Of how many frames.
    typical : float
        The median of what remains, in sigma.
    value : float
        Log likelihood, over that of all tracks being strangers'.
    way : float
        What of it the way tells, as far as boxes show it.
    coincidence : float
        Minus the log probability that a stranger is where the vehicle must be.
    """

    station: int
    tracks: tuple[int, ...]
    explained: float
    typical: float
    value: float
    way: float
    coincidence: float


def hold_against(scene: Scene, sender: Sender, motion: Motion) -> Account:
    """Hold a hypothesis against all that was seen, for one station."""
    settings = scene.settings
    knots = scene.knots
    poses = sender.at(knots.stamp_s + motion.offset_s)
    xy, sigma = completed(knots, poses, motion.yaw_rad, sender, settings)
    remains = np.linalg.norm(rotate_xy(motion.yaw_rad, xy) + motion.shift - poses.xy, axis=-1)
    usable = poses.known & knots.usable
    closeness = np.where(usable, np.maximum(1 - (remains / sender.reach_m) ** 2, 0.0), 0.0) * knots.frames
    explained = np.bincount(knots.track, closeness, len(scene.tracks))
    possible = np.bincount(knots.track, usable * knots.frames, len(scene.tracks))
    with np.errstate(invalid="ignore", divide="ignore"):
        fitting = np.flatnonzero(explained / possible >= settings.min_explained)
    more = np.bincount(knots.track, (_too_long(knots, sender) > GATE) * usable * knots.frames, len(scene.tracks))
    alone = fitting[more[fitting] < 0.5 * possible[fitting]]
    # A track of the vehicle as one with what it tows counts only where none of the vehicle alone fits.
    fitting = alone if len(alone) else fitting
    fitting = fitting[np.argsort(-explained[fitting], kind="stable")]
    missed = _missed(scene, sender, motion, poses.known & (remains <= 2 * sender.reach_m))
    mine = np.flatnonzero(np.isin(knots.track, fitting) & usable)
    mine = mine[np.argsort(knots.stamp_s[mine], kind="stable")]
    of_mine = sender.at(knots.stamp_s[mine] + motion.offset_s)
    weight = path_shares(of_mine, knots.stamp_s[mine], settings)
    stretches = float(weight.sum())
    if stretches == 0.0:
        return Account(sender.station, (), 0.0, math.inf, -missed, 0.0, 0.0)
    q = (remains[mine] / sigma[mine]) ** 2
    odd = float(weight @ cost(_odd(knots[mine], of_mine, motion, sender)))
    sigma_m = float(np.sqrt(np.average(sigma[mine] ** 2, weights=weight)))
    fits_s = _fits_for(scene, sender, knots[mine], motion, weight)
    often = fits_s / max(float(np.ptp(knots.stamp_s)), KNOT_S)
    evidence = _evidence(knots[mine], xy[mine], sigma[mine], q, weight, often, settings)
    return Account(
        station=sender.station,
        tracks=tuple(fitting.tolist()),
        explained=float(explained[fitting].sum()),
        typical=math.sqrt(weighted_median(q, weight)),
        value=evidence - odd - missed,
        way=evidence,
        coincidence=max(0.0, -math.log(2 * math.pi * sigma_m**2 * scene.density)),
    )


def joined(scene: Scene, account: Account) -> Track:
    """Join the fragments of one drive, the longest first; what is seen beside them is another part of the vehicle."""
    first, *others = (scene.tracks[index] for index in account.tracks)
    for other in others:
        first = first.joined(other)
    return first


def _odd(knots: Knots, poses: Poses, motion: Motion, sender: Sender) -> FloatArray:
    """Return what else than the position is wrong with the sightings, squared in sigma: size and speed."""
    sight = knots.xy / np.maximum(np.linalg.norm(knots.xy, axis=1, keepdims=True), 1e-9)
    radial = (rotate_xy(-motion.yaw_rad, poses.velocity) * sight).sum(axis=1)
    off = np.where(np.isfinite(knots.radial_mps), knots.radial_mps - radial, 0.0) / _radial_sigma(radial)
    odd: FloatArray = _too_long(knots, sender) ** 2 + off**2
    return odd


def _too_long(knots: Knots, sender: Sender) -> FloatArray:
    """Return by how much boxes are longer than the vehicle, in sigma."""
    longer_m: FloatArray = np.maximum(knots.length_m - 2 * sender.reach_m - 5 * knots.sigma_m, 0.0)
    return longer_m / SIZE_SIGMA_M


def _radial_sigma(radial_mps: FloatArray) -> FloatArray:
    sigma: FloatArray = np.hypot(RADIAL_SIGMA_MPS, RADIAL_SLOPE * radial_mps)
    return sigma


def _fits_for(scene: Scene, sender: Sender, knots: Knots, motion: Motion, weight: FloatArray) -> float:
    """Return for how long (s) the sender's drive fits a track as well as now, were it driven earlier or later.

    A bend that is driven at a steady speed fits for long, because the motion takes the shift up. A clock that is not
    known would have been set to any time at which it fits.
    """
    settings = scene.settings
    steps = round(OTHER_TIME_S / TABLE_S)
    shifts_s = TABLE_S * np.arange(-steps, steps + 1)
    poses = sender.at(knots.stamp_s + motion.offset_s + shifts_s[:, None])
    _, _, (q, _) = fit_all(knots, poses, weight * poses.known, sender, settings)
    worse = np.array([_misfit(one, weight, 3) for one in q]) - _misfit(q[steps], weight, 3)
    worse[~poses.known.all(axis=1)] = math.inf
    return TABLE_S * float(np.exp(-np.maximum(worse, 0.0)).sum()) + math.sqrt(2 * math.pi) * settings.clock_sigma_s


def _evidence(
    knots: Knots,
    xy_level: FloatArray,
    sigma: FloatArray,
    q: FloatArray,
    weight: FloatArray,
    often: float,
    settings: MatchSettings,
) -> float:
    """Return the log likelihood of a track if it is the sender's over that if it is a stranger's.

    The motion that is fitted takes up any position and direction. A stranger follows a polynomial of time. Of each of
    its coefficients it must have the right value within the resolution: for the speed that is sigma sqrt(12 / n) in the
    whole length of n stretches, or what radial speeds tell, for what bends the path sigma / sqrt(n) in some a t^2 / 8,
    on both axes. Or it makes the sender's manoeuvre: as ``often`` as that fits by its time, if it has its speed too.
    """
    stretches = float(weight.sum())
    sigma_m = float(np.sqrt(np.average(sigma**2, weights=weight)))
    span_s = float(np.ptp(knots.stamp_s))
    by_place = (settings.stretch_m * stretches) ** 2 * stretches / (12 * sigma_m**2)
    by_radial = float(weight @ np.nan_to_num(knots.radial_mps / _radial_sigma(knots.radial_mps)) ** 2)
    speed = SPEED_SPREAD * math.sqrt(by_place + by_radial)
    bend = USUAL_MPS2 * span_s**2 / 8 * math.sqrt(stretches) / sigma_m
    powers = np.vander((knots.stamp_s - knots.stamp_s.mean()) / max(span_s, KNOT_S), MAX_ORDER + 1, increasing=True)
    alike = math.log(MANOEUVRES) + math.log(max(1.0, speed)) - math.log(min(often, 1.0))
    stranger = math.inf
    for order in range(1, min(MAX_ORDER, len(knots) - 1) + 1):
        surprise = math.log(max(1.0, speed)) + 2 * (order - 1) * math.log(max(1.0, bend))
        rest = _polynomial_misfit(powers[:, : order + 1], xy_level, sigma, q, weight)
        # However special a drive is, a stranger's may be just like it; the polynomial then leaves its noise alone.
        stranger = min(stranger, min(surprise, alike) + _misfit(rest, weight, 2 * order + 2))
    return min(stranger - _misfit(q, weight, 3), alike)


def _polynomial_misfit(
    powers: FloatArray, xy_level: FloatArray, sigma: FloatArray, q: FloatArray, weight: FloatArray
) -> FloatArray:
    """Return what a polynomial leaves of a path, squared in sigma, at first without what the sender's drive misfits."""
    for _ in range(3):
        root = np.sqrt(weight * trust(q))[:, None] / sigma[:, None]
        polynomial = np.linalg.lstsq(root * powers, root * xy_level)[0]
        q = ((xy_level - powers @ polynomial) ** 2).sum(axis=1) / sigma**2
    return q


def _misfit(q: FloatArray, weight: FloatArray, fitted: int) -> float:
    """Return minus the log likelihood of residuals, squared in sigma, after a fit of some parameters.

    Sigma is what the noise may be, and the residuals tell whether it is less: all of `PRECISIONS` are as likely.
    """
    scale = np.asarray(PRECISIONS)[:, None]
    right = (1 - OUTLIER) * np.exp(-np.minimum(q / scale**2, 200.0) / 2) / scale**2
    each = np.log(OUTLIER + right) @ weight + fitted * np.log(scale[:, 0])
    return -float(np.logaddexp.reduce(each) - math.log(len(scale)))


def _missed(scene: Scene, sender: Sender, motion: Motion, near: BoolArray) -> float:
    """Return minus the log likelihood of what is not seen: where a vehicle must be in view, but nothing is."""
    stamps_s = scene.knots.stamp_s
    bins = np.arange(stamps_s.min(), stamps_s.max() + KNOT_S, KNOT_S)
    poses = sender.at(bins + motion.offset_s)
    must = poses.known & scene.in_view(rotate_xy(-motion.yaw_rad, poses.xy - motion.shift))
    there = np.zeros(len(bins), dtype=bool)
    there[np.round((stamps_s[near] - bins[0]) / KNOT_S).astype(np.int64)] = True
    there = binary_dilation(there)
    run, _ = label(must & ~there)
    path = np.linalg.norm(poses.velocity, axis=1) * KNOT_S / scene.settings.stretch_m
    missed = np.bincount(run, path)[1:]
    return float((MISSED * np.minimum(missed, 1.0) + np.maximum(missed - 1.0, 0.0) / HIDDEN_STRETCHES).sum())
