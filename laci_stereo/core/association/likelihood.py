"""The likelihood of what was seen of one station's vehicle under a hypothesis.

Frames are not independent, because the visible part of a vehicle changes only as it moves, so all evidence is counted
per metre of its path: in *stretches* of `MatchSettings.stretch_m`, whose sightings are independent of one another. A
*stranger* is any moving object but the sender's vehicle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation, label

from laci_stereo.core.association.motion import OUTLIER, Motion, completed, cost, fit_all, path_shares, trust
from laci_stereo.core.association.scene import KNOT_S, TABLE_S, Knots, Poses, Scene, Sender
from laci_stereo.core.frames import BoolArray, FloatArray, rotate_xy
from laci_stereo.core.robust import weighted_median
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.tracking.tracks import GATE, Track

PRECISIONS = (1.0, 0.7, 0.5, 0.35, 0.25)
"""Possible standard deviations of positions, relative to the settings' sigma: from GNSS alone down to carrier
phases."""

RADIAL_SIGMA_MPS = 0.3
"""Standard deviation of a radial speed: turning wheels, and the Doppler cell of a radar."""

RADIAL_SLOPE = 0.05
"""Relative error of a radial speed: a sensor 6 m above ground and 20 m away measures cos(17 deg) = 0.95 of a speed
along the ground."""

SIZE_SIGMA_M = 0.5
"""Standard deviation of a box's excess length over the vehicle's diagonal: the reach of a cluster at both of its
ends."""

SPEED_SPREAD = 0.2
"""Standard deviation of the speeds of free traffic, relative to their mean: how likely a stranger has the same
speed."""

MANOEUVRES = 3
"""Number of manoeuvres that a stranger may make: straight on, to the left, or to the right. However special a drive is,
a stranger may make the same one at another time, since it has the same roads and traffic lights."""

OTHER_TIME_S = 3.0
"""Longest shift in time, earlier and later, at which a drive is tried: one that fits at a larger shift has turned or
stopped elsewhere by then."""

USUAL_MPS2 = 1.0
"""Standard deviation of accelerations in traffic, along and across the direction of motion."""

MAX_ORDER = 5
"""Largest order of the polynomials that a stranger's path is modelled by; it has one or two bends and stops in view."""

MAX_GOOD_SIGMA = 2.0
"""Largest median of the residuals of a correct match: their median is 1.2 sigma in two dimensions; with five stretches,
2 % exceed this."""

MISSED = -math.log(0.2)
"""Negative log-likelihood of a stretch in which a vehicle that must be in view is not seen: one in five is hidden by
other traffic."""

HIDDEN_STRETCHES = 2.0
"""Mean number of further stretches for which an object that hides a vehicle, such as an oncoming one, goes on to do
so."""


@dataclass(frozen=True)
class Account:
    """Evidence about one station under a hypothesis.

    Attributes
    ----------
    station : int
    tracks : tuple of int
        Indices of its vehicle's tracks, the one that is explained best first.
    explained : float
        Number of frames that are explained, each weighted by how well.
    typical : float
        Median residual, in sigma.
    value : float
        Log-likelihood ratio against all tracks being strangers'.
    way : float
        Part of ``value`` that comes from the path, as far as boxes determine it.
    coincidence : float
        Negative log probability that a stranger is where the vehicle must be.
    """

    station: int
    tracks: tuple[int, ...]
    explained: float
    typical: float
    value: float
    way: float
    coincidence: float


def hold_against(scene: Scene, sender: Sender, motion: Motion) -> Account:
    """Compare a hypothesis with everything that was seen, for one station."""
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
    # A track of the vehicle together with what it tows counts only where no track of the vehicle alone fits.
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
    """Join the fragments of one drive; of two seen at once, both parts of the vehicle, the best explained counts."""
    first, *others = (scene.tracks[index] for index in account.tracks)
    for other in others:
        first = first.joined(other)
    return first


def _odd(knots: Knots, poses: Poses, motion: Motion, sender: Sender) -> FloatArray:
    """Return the squared deviations, in sigma, of the sightings' size and radial speed."""
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
    """Return for how long (s) the sender's drive would fit a track as well as it does now if driven earlier or later.

    A bend that is driven at a steady speed fits for long, because the fitted motion absorbs the shift. An unknown clock
    offset adds to this: it would have been set to any time at which the drive fits.
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
    """Return the log-likelihood ratio of a track being the sender's against it being a stranger's.

    The fitted motion absorbs any position and direction. A stranger's path is a polynomial of time, each of whose
    coefficients must have the right value to within its resolution by chance: for the speed that is sigma sqrt(12 / n)
    over the whole length of n stretches, or what radial speeds determine; for what bends the path it is sigma / sqrt(n)
    relative to a usual a t^2 / 8, on both axes. Alternatively, the stranger makes the sender's manoeuvre: the odds of
    that are the fraction ``often`` of times at which it fits, and those of having the sender's speed.
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
        # However special a drive is, a stranger's may be just like it; then only the noise remains as the polynomial's
        # residual.
        stranger = min(stranger, min(surprise, alike) + _misfit(rest, weight, 2 * order + 2))
    return min(stranger - _misfit(q, weight, 3), alike)


def _polynomial_misfit(
    powers: FloatArray, xy_level: FloatArray, sigma: FloatArray, q: FloatArray, weight: FloatArray
) -> FloatArray:
    """Return the squared residuals, in sigma, of a robust fit of a path by a polynomial.

    The first iteration has the weights of the residuals ``q`` of the sender's drive.
    """
    for _ in range(3):
        root = np.sqrt(weight * trust(q))[:, None] / sigma[:, None]
        polynomial = np.linalg.lstsq(root * powers, root * xy_level)[0]
        q = ((xy_level - powers @ polynomial) ** 2).sum(axis=1) / sigma**2
    return q


def _misfit(q: FloatArray, weight: FloatArray, fitted: int) -> float:
    """Return the negative log-likelihood of squared residuals, in sigma, after a fit of some parameters.

    Sigma is an upper bound of the noise, and the residuals determine whether it is less: all `PRECISIONS` are equally
    likely a priori.
    """
    scale = np.asarray(PRECISIONS)[:, None]
    right = (1 - OUTLIER) * np.exp(-np.minimum(q / scale**2, 200.0) / 2) / scale**2
    each = np.log(OUTLIER + right) @ weight + fitted * np.log(scale[:, 0])
    return -float(np.logaddexp.reduce(each) - math.log(len(scale)))


def _missed(scene: Scene, sender: Sender, motion: Motion, near: BoolArray) -> float:
    """Return the negative log-likelihood of not seeing the vehicle where it must be in view."""
    stamps_s = scene.knots.stamp_s
    bins = np.arange(stamps_s.min(), stamps_s.max() + KNOT_S, KNOT_S)
    poses = sender.at(bins + motion.offset_s)
    must = poses.known & scene.in_view(rotate_xy(-motion.yaw_rad, poses.xy - motion.shift))
    seen = np.zeros(len(bins), dtype=bool)
    seen[np.round((stamps_s[near] - bins[0]) / KNOT_S).astype(np.int64)] = True
    seen = binary_dilation(seen)
    run, _ = label(must & ~seen)
    path = np.linalg.norm(poses.velocity, axis=1) * KNOT_S / scene.settings.stretch_m
    missed = np.bincount(run, path)[1:]
    return float((MISSED * np.minimum(missed, 1.0) + np.maximum(missed - 1.0, 0.0) / HIDDEN_STRETCHES).sum())
