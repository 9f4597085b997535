"""Whether the object seen is the vehicle that the messages describe: its length, and its path at their times."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from laci_stereo.core.association.choice import Resemblance
from laci_stereo.core.association.likelihood import MANOEUVRES, OTHER_TIME_S, SPEED_SPREAD, USUAL_MPS2
from laci_stereo.core.association.motion import rigid_motion
from laci_stereo.core.association.pieces import seen_share
from laci_stereo.core.errors import MatchError
from laci_stereo.core.estimation.drive_prior import Correction
from laci_stereo.core.estimation.evidence import evidence_of
from laci_stereo.core.estimation.joint import RoughFit, fit_roughly
from laci_stereo.core.frames import BoolArray, FloatArray, along_line, between, rotate_xy
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.messages.receiver import KNOTS_PER_TIME, decay, position_sigma_m
from laci_stereo.core.settings import JointSettings, with_turn
from laci_stereo.core.tracking.tracks import Times, Track

STRANGER_LENGTH_M = 0.6
"""Standard deviation of the difference between the lengths of two cars, which are 4.4 +- 0.4 m. Widths differ by a
tenth of a metre only, which is also the error that a camera's distances have in common, so they are not compared."""

MISTAKEN = 0.02
"""One sender in fifty reports something wrong, by as much as strangers differ."""

MOSTLY_SEEN, HIDDEN, STRANGER_SMALL = 0.5, 0.05, 0.5
"""Of one vehicle in twenty, less than half of the length is visible at a time although its side is in view: something
hides it, or it is dark. Every second stranger is as small relative to a long vehicle: a cyclist has room for any path
of its own along a bus."""

FREE_M = 2.0
"""Standard deviation of a stranger's positions about the path of the sender that it was aligned with."""

FREE_DEG = 5.0
"""Assumed standard deviation of the reported heading relative to the body: a stranger's body follows its path as well,
so the heading only excludes yaws that are far from those of any path."""

FREE_LEVER_M = 1.0
"""Assumed standard deviation of the reference point on the vehicle: front, middle and rear axle are some 2 m apart. A
reference point that was mistaken for another one is reported as such; it is no reason to take the vehicle for a
stranger."""

FREE_S, MOST_KNOTS = 1.0, 16
"""Interval of the knots of a stranger's path, which resolves how it brakes and bends, and the largest number of these
knots."""

EXACT_M = (0.1, 0.3)
"""Positions may be as exact as reported, or have one of these standard deviations during a passage, whatever is
reported."""

STRAYED, MOST_STRAYED = 0.1, 1 / 3
"""Probability that a second of a track shows something else that is stationary or moves beside the vehicle, and the
largest fraction of such seconds with which a track can still be distinguished from one of something else."""

SHIFT_S = 0.05
"""Step of the times at which a drive is tried: half a metre at 10 m/s, within which the quality of a fit changes
little."""

_GRID = np.linspace(-6.0, 6.0, 241)


def resemblance(
    track: Track, vehicle: VehicleTrack, start: PlanarMatch, time_offset_s: float, height_m: float,
    settings: JointSettings | None = None,
) -> Resemblance:  # fmt: skip
    """Return the log odds that a track is the vehicle's, against that of a stranger which moves like it.

    The outline is registered with priors of the length and the path that are as wide as strangers'. The ratio of the
    probability of the result if the messages are true to that if not is the ratio of both priors, averaged over the
    posterior that the points leave (the Savage-Dickey density ratio, for a prior of any form).

    Parameters
    ----------
    track : Track
    vehicle : VehicleTrack
    start : PlanarMatch
        Motion from the level into the world frame, by the track and the vehicle's.
    time_offset_s : float
    height_m : float
        Height of the sensor above the ground.
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
        if np.linalg.eigvalsh(rough.information)[-1] < FREE_M**-2:  # noise hides the outline: boxes determine more
            return Resemblance()
        way, strayed_s = _way(rough, vehicle, time_offset_s, clocks)
        if way < 0.0:  # or the sender is mistaken about its reference point
            lever = fit_roughly(drive, start, time_offset_s, replace(free, lever_sigma_m=FREE_LEVER_M))
            mistaken, strayed = _way(lever, vehicle, time_offset_s, clocks)
            if mistaken + math.log(MISTAKEN) > way:
                way, strayed_s = mistaken + math.log(MISTAKEN), strayed
        alone = track.without(strayed_s)
        if 2 * len(alone.sightings) < len(track.sightings):  # then the rest is no more likely the vehicle
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
    """Return the log odds that the path is the sender's, and the intervals in which something else was seen.

    A stranger's path differs in speed, and it brakes and bends elsewhere. Alternatively, the stranger makes the
    sender's manoeuvre, but has its speed and its time by chance: it fits equally well at as many other times as the
    sender's drive does when it is shifted to these.
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
    """Return the log evidence, and the knots about which something else was seen for that, shape (k,).

    Knots are freed one by one, as long as the evidence grows by more than `STRAYED` costs.
    """
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
    """Return the log evidence, up to a constant, if the errors have a covariance of ``prior`` on each axis."""
    values, vectors = np.linalg.eigh(prior)
    root = np.kron(np.eye(2), vectors * np.sqrt(np.maximum(values, 0.0)))
    inner = np.eye(len(root)) + root.T @ fit.information @ root
    pull = root.T @ fit.pull
    return float(pull @ np.linalg.solve(inner, pull) - np.linalg.slogdet(inner)[1]) / 2


def _alike(
    fit: RoughFit, xy: FloatArray, vehicle: VehicleTrack, time_offset_s: float, own: FloatArray, settings: JointSettings
) -> float:
    """Return the negative log probability that a stranger makes the sender's manoeuvre at its speed and at its time."""
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
    """Return the log of the ratio of the sender's prior to the stranger's, averaged over the posterior."""
    told = math.sqrt(max(correction.sigma**2 - differs**2, 1e-12))
    values = correction.value + correction.after * _GRID
    weight = np.exp(-(_GRID**2) / 2)
    stranger = _density(values, correction.sigma)
    sender = (1.0 - MISTAKEN) * _density(values, told) + MISTAKEN * stranger
    return float(np.log(np.average(sender / np.maximum(stranger, 1e-300), weights=weight)))


def _density(values: FloatArray, sigma: float) -> FloatArray:
    density: FloatArray = np.exp(-((values / sigma) ** 2) / 2) / sigma
    return density
