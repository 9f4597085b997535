"""Whether what was seen is the vehicle that the messages describe: as long, and on its way in its time."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from laci_stereo.core.cam import VehicleTrack
from laci_stereo.core.choice import Resemblance
from laci_stereo.core.drive_prior import Correction
from laci_stereo.core.errors import MatchError
from laci_stereo.core.evidence import evidence_of
from laci_stereo.core.frames import BoolArray, FloatArray, along_line, between, rotate_xy
from laci_stereo.core.joint import RoughFit, fit_roughly
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.pieces import seen_share
from laci_stereo.core.receiver import KNOTS_PER_TIME, decay, position_sigma_m
from laci_stereo.core.settings import JointSettings, with_turn
from laci_stereo.core.track_likelihood import MANOEUVRES, OTHER_TIME_S, SPEED_SPREAD, USUAL_MPS2
from laci_stereo.core.track_motion import rigid_motion
from laci_stereo.core.tracking import Times, Track

STRANGER_LENGTH_M = 0.6
"""Standard deviation of how the lengths of two cars differ: they are 4.4 +- 0.4 m. Widths differ by a tenth only, which
is what a camera's distances err by together, so they tell nothing."""

MISTAKEN = 0.02
"""One sender in fifty tells something wrong, by as much as strangers differ."""

MOSTLY_SEEN, HIDDEN, STRANGER_SMALL = 0.5, 0.05, 0.5
"""Of one vehicle in twenty less than half is seen at a time though its side is: something hides it or it is dark. Every
second stranger is as small against a long vehicle: a cyclist has room for any way of its own along a bus."""

FREE_M = 2.0
"""Standard deviation of where a stranger is about the way of the sender that it was brought together with."""

FREE_DEG = 5.0
"""Standard deviation of the heading that is told, against the body: a stranger's body follows its way as well, so that
only what is far from any is told by it."""

FREE_LEVER_M = 1.0
"""Standard deviation of where on the vehicle its position is: front, middle and rear axle are some 2 m apart, and that
one was taken for another is said, and no reason to take the vehicle for a stranger's."""

FREE_S, MOST_KNOTS = 1.0, 16
"""A stranger's way has one knot a second, which shows how it brakes and bends, but no more than so many."""

EXACT_M = (0.1, 0.3)
"""Positions may be as exact as they are told, or as these standard deviations during a passage, whatever is told."""

STRAYED, MOST_STRAYED = 0.1, 1 / 3
"""Probability that a second of a track shows something else that stands or moves beside the vehicle, and the largest
share of such seconds in a track that can be told from one of something else."""

SHIFT_S = 0.05
"""Step at which a drive is tried at other times: at 10 m/s half a metre, within which what fits changes little."""

_GRID = np.linspace(-6.0, 6.0, 241)


def resemblance(
    track: Track, vehicle: VehicleTrack, start: PlanarMatch, time_offset_s: float, height_m: float,
    settings: JointSettings | None = None,
) -> Resemblance:  # fmt: skip
    """Return the log odds that a track is the vehicle's, against that of a stranger which moves like it.

    The outline is registered with a length as free as strangers', on a way as free as theirs. How likely what is
    found is if the messages tell the truth, over how likely if not, is the ratio of both priors, averaged over what
    the points leave open (the Savage-Dickey ratio of densities, for a prior of any form).

    Parameters
    ----------
    track : Track
    vehicle : VehicleTrack
    start : PlanarMatch
        From the level into the world frame, by the track and the vehicle's.
    time_offset_s : float
    height_m : float
        Of the sensor above the ground.
    settings : JointSettings
    """
    settings = settings or JointSettings()
    length_m, width_m = vehicle.guessed_m
    stranger = replace(vehicle, guessed_m=(math.hypot(length_m, STRANGER_LENGTH_M), width_m))
    drive = evidence_of(track, replace(stranger, position_sigma_m=FREE_M), height_m)
    if not len(drive.points):
        return Resemblance()
    step_s = max(FREE_S, float(np.ptp(drive.stamps_s)) / MOST_KNOTS)
    clocks = replace(settings, clock_sigma_s=with_turn(settings.clock_sigma_s, drive.turn_s))
    free = replace(settings, bias_time_s=KNOTS_PER_TIME * step_s, bias_way_m=math.inf, heading_sigma_deg=FREE_DEG)
    try:
        rough = fit_roughly(drive, start, time_offset_s, free)
        if np.linalg.eigvalsh(rough.information)[-1] < FREE_M**-2:  # noise hides the outline: boxes tell more
            return Resemblance()
        way, strayed_s = _way(rough, vehicle, time_offset_s, clocks)
        if way < 0.0:  # or the sender is mistaken about which of its points it tells the position of
            lever = fit_roughly(drive, start, time_offset_s, replace(free, lever_sigma_m=FREE_LEVER_M))
            mistaken, strayed = _way(lever, vehicle, time_offset_s, clocks)
            if mistaken + math.log(MISTAKEN) > way:
                way, strayed_s = mistaken + math.log(MISTAKEN), strayed
        alone = track.without(strayed_s)
        if 2 * len(alone.sightings) < len(track.sightings):  # then what is left is no more likely the vehicle
            alone, strayed_s = track, ()
        drive = evidence_of(alone, stranger, height_m)
        fit = fit_roughly(drive, start, time_offset_s, settings)
    except MatchError:
        return Resemblance()
    (length,) = (correction for correction in fit.corrections if correction.what == "length")
    body = _odds(length, STRANGER_LENGTH_M)
    if seen_share(drive, fit.match, time_offset_s) < MOSTLY_SEEN:
        body += math.log(HIDDEN / STRANGER_SMALL)
    return Resemblance(body, way, strayed_s, fit.match)


def _way(fit: RoughFit, vehicle: VehicleTrack, time_offset_s: float, settings: JointSettings) -> tuple[float, Times]:
    """Return the log odds that the way is the sender's, and from when to when something else was seen.

    A stranger's differs in speed, and it brakes and bends elsewhere. Or it makes the sender's manoeuvre, but has its
    speed by chance, and its time: it fits as well at as many other times as the drive shifted to these does.
    """
    stamps_s = fit.knots_s + time_offset_s
    xy, _, known = vehicle.at(np.clip(stamps_s, *vehicle.stamps_s[[0, -1]]))
    if not known.all():
        xy = between(stamps_s, vehicle.stamps_s, vehicle.xy)
    told_m = position_sigma_m(vehicle.position_sigma_m, settings)
    apart_s = fit.knots_s - fit.knots_s.mean()
    span_s = max(float(np.ptp(apart_s)), 1e-3)
    speed_mps = float(np.linalg.norm(np.diff(xy, axis=0), axis=1).sum()) / span_s
    other = (SPEED_SPREAD * speed_mps) ** 2 * np.outer(apart_s, apart_s)
    other += USUAL_MPS2**2 / 4 * np.outer(apart_s**2, apart_s**2)
    owns = [max(exact, told_m) ** 2 * decay(fit.knots_s, along_line(xy), settings) for exact in (told_m, *EXACT_M)]
    senders = [_most_likely(fit, own) for own in owns]
    sender = np.logaddexp.reduce([value for value, _ in senders])
    stranger = np.logaddexp.reduce([_most_likely(fit, own + other)[0] for own in owns])
    best = int(np.argmax([value for value, _ in senders]))
    alike = _alike(fit, xy, vehicle, time_offset_s, owns[best], settings)
    different = np.logaddexp(math.log1p(-MISTAKEN) + sender - stranger, math.log(MISTAKEN))
    half_s = float(fit.knots_s[1] - fit.knots_s[0]) / 2
    strayed = fit.knots_s[senders[best][1]]
    return float(min(different, alike)), tuple((float(at - half_s), float(at + half_s)) for at in strayed)


def _most_likely(fit: RoughFit, prior: FloatArray) -> tuple[float, BoolArray]:
    """Return the log probability of what was found, and about which knots something else was seen, shape (k,)."""
    strayed = np.zeros(len(fit.knots_s))
    best = _log_evidence(fit, prior)
    for _ in range(round(MOST_STRAYED * len(strayed))):
        tried = [strayed + one for one in np.diag(np.where(strayed == 0.0, FREE_M**2, 0.0)) if one.any()]
        values = [_log_evidence(fit, prior + np.diag(one)) for one in tried]
        index = int(np.argmax(values))
        if values[index] + math.log(STRAYED) <= best:
            break
        best, strayed = values[index] + math.log(STRAYED), tried[index]
    return best, strayed > 0.0


def _log_evidence(fit: RoughFit, prior: FloatArray) -> float:
    """Return the log probability of what was found, where the errors have a covariance of ``prior`` on each axis."""
    values, vectors = np.linalg.eigh(prior)
    root = np.kron(np.eye(2), vectors * np.sqrt(np.maximum(values, 0.0)))
    inner = np.eye(len(root)) + root.T @ fit.information @ root
    pull = root.T @ fit.pull
    return float(pull @ np.linalg.solve(inner, pull) - np.linalg.slogdet(inner)[1]) / 2


def _alike(
    fit: RoughFit, xy: FloatArray, vehicle: VehicleTrack, time_offset_s: float, own: FloatArray, settings: JointSettings
) -> float:
    """Return minus the log probability that a stranger makes the sender's manoeuvre with its speed and in its time."""
    prior = np.linalg.inv(np.kron(np.eye(2), own))
    weight = fit.information - fit.information @ np.linalg.solve(prior + fit.information, fit.information)
    found = np.linalg.lstsq(fit.information, fit.pull)[0]
    way = (xy - xy.mean(axis=0)).T.ravel()
    speed = SPEED_SPREAD * math.sqrt(max(float(way @ weight @ way), 0.0))
    steps = round(OTHER_TIME_S / SHIFT_S)
    fits = 0.0
    for shift_s in SHIFT_S * np.arange(-steps, steps + 1):
        moved, _, known = vehicle.at(fit.knots_s + time_offset_s + shift_s)
        if known.all():
            yaw, shift = rigid_motion(moved, xy, np.ones(len(xy)))
            off = found + (rotate_xy(yaw, moved) + shift - xy).T.ravel()
            fits += math.exp(-max(float(off @ weight @ off - found @ weight @ found), 0.0) / 2)
    often_s = SHIFT_S * fits + math.sqrt(2 * math.pi) * settings.clock_sigma_s
    often = min(1.0, often_s / max(float(np.ptp(fit.knots_s)), SHIFT_S))
    return math.log(MANOEUVRES) + math.log(max(1.0, speed)) - math.log(often)


def _odds(correction: Correction, differs: float) -> float:
    """Return the log of the mean ratio of the sender's prior over the stranger's."""
    told = math.sqrt(max(correction.sigma**2 - differs**2, 1e-12))
    values = correction.value + correction.after * _GRID
    weight = np.exp(-(_GRID**2) / 2)
    stranger = _density(values, correction.sigma)
    sender = (1.0 - MISTAKEN) * _density(values, told) + MISTAKEN * stranger
    return float(np.log(np.average(sender / np.maximum(stranger, 1e-300), weights=weight)))


def _density(values: FloatArray, sigma: float) -> FloatArray:
    density: FloatArray = np.exp(-((values / sigma) ** 2) / 2) / sigma
    return density
