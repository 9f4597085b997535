"""The rigid motion and the clock offset that align one track with one sender's."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from laci_stereo.core.association.scene import KNOT_S, Knots, Poses, Scene, Sender, extent
from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.subsampling import evenly

OUTLIER = 0.005
"""Likelihood of an outlier relative to a correct sighting: one in twenty is one, spread over ten times the area."""

WORST = -math.log(OUTLIER)
"""Cost (negative log-likelihood) of a stretch whose sightings are all outliers."""

GRAZING = 0.3
"""Angle (rad) at which a side is foreshortened to a third; at smaller angles the correction for its missing part fades
out."""

SEARCH_KNOTS = 30
"""Number of a track's knots with which a motion is searched; all of them judge the result."""


@dataclass(frozen=True)
class Motion:
    """A hypothesis: the motion from the level to the world frame, and the clock offset.

    The yaw has shape (g,) and the shift (g, 2), or () and (2,) of a single one.
    """

    yaw_rad: FloatArray
    shift: FloatArray
    offset_s: FloatArray

    def place(self, xy_level: FloatArray) -> FloatArray:
        """Map points, shape (n, 2), from the level to the world frame, by a single hypothesis."""
        return rotate_xy(self.yaw_rad, xy_level) + self.shift


@dataclass(frozen=True)
class Seed:
    """The best alignment of one track with one station.

    Attributes
    ----------
    station, track : int
    motion : Motion
    score : float
        Log-likelihood against outliers.
    share : float
        Fraction of the frames that it explains.
    meeting : bool
        Whether the motion fits another track and station as well; otherwise all others are disregarded.
    """

    station: int
    track: int
    motion: Motion
    score: float
    share: float
    meeting: bool = False


def find_seeds(scene: Scene) -> list[Seed]:
    """Align each track with each station; return the alignments with the best score first."""
    seeds = []
    for index in range(len(scene.tracks)):
        knots = scene.knots[(scene.knots.track == index) & scene.knots.usable]
        if knots.frames.sum() < scene.settings.min_frames:
            continue
        for sender in scene.senders.values():
            # A stationary object's position wanders by less, as more or less of it is seen; how far the vehicle drives
            # is judged later, from all fragments together.
            if extent(knots.xy) < sender.reach_m:
                continue
            seed = _seed(index, knots, sender, scene.settings)
            if seed is not None:
                seeds.append(seed)
    return sorted(seeds, key=lambda seed: -seed.score)


def _seed(index: int, knots: Knots, sender: Sender, settings: MatchSettings) -> Seed | None:
    """Search the clock offset on a grid, then on finer ones around the best value."""
    knots = knots[evenly(len(knots), SEARCH_KNOTS)]
    offsets_s, step_s = offset_steps(sender, settings)
    found: Seed | None = None
    for _ in range(4):
        found = _best_offset(index, knots, sender, offsets_s, settings)
        if found is None or found.share < settings.min_explained / 2:
            break
        offsets_s, step_s = found.motion.offset_s + np.linspace(-step_s, step_s, 7), step_s / 3
    return found


def offset_steps(sender: Sender, settings: MatchSettings) -> tuple[FloatArray, float]:
    """Return a grid of clock offsets, and its step, s.

    A step moves the vehicle by less than its reach, most of which the fitted motion absorbs.
    """
    told = sender.table[sender.known, 2:4]
    fastest_mps = max(float(np.linalg.norm(told, axis=1).max(initial=0.0)), 1.0)
    limit_s = 3 * settings.clock_sigma_s
    steps = math.ceil(limit_s * fastest_mps / (3 * settings.position_sigma_m))
    return np.linspace(-limit_s, limit_s, 2 * steps + 1), limit_s / max(steps, 1)


def _best_offset(
    index: int, knots: Knots, sender: Sender, offsets_s: FloatArray, settings: MatchSettings
) -> Seed | None:
    poses = sender.at(knots.stamp_s + offsets_s[:, None])
    frames = poses.known @ knots.frames
    span = np.ptp(np.where(poses.known[..., None], poses.xy, poses.xy[:, :1]), axis=1)
    enough = (frames >= settings.min_frames) & (np.linalg.norm(span, axis=1) >= sender.reach_m)
    if not enough.any():
        return None
    offsets_s = offsets_s[enough]
    poses = poses[enough]
    weight = poses.known * path_shares(poses, knots.stamp_s, settings)
    yaw, shift, remains = fit_all(knots, poses, weight, sender, settings)
    score = (weight * (WORST - cost(remains[0]))).sum(axis=1) - (offsets_s / settings.clock_sigma_s) ** 2 / 2
    best = int(np.argmax(score))
    closeness = np.maximum(1 - (remains[1][best] / sender.reach_m) ** 2, 0.0)
    share = float((closeness * poses.known[best]) @ knots.frames / (poses.known[best] @ knots.frames))
    motion = Motion(yaw[best], shift[best], offsets_s[best])
    return Seed(sender.station, index, motion, float(score[best]), share)


def path_shares(poses: Poses, stamps_s: FloatArray, settings: MatchSettings) -> FloatArray:
    """Return the number of independent stretches that each knot represents, by its part of the path, shape (..., n)."""
    if len(stamps_s) < 2:
        return np.zeros_like(poses.path_m)
    half_s = np.minimum(np.diff(stamps_s), 2 * KNOT_S) / 2
    speed = np.linalg.norm(poses.velocity, axis=-1)
    time_s = np.append(half_s, half_s[-1])
    time_s[1:-1] += half_s[:-1]
    shares: FloatArray = speed * time_s / settings.stretch_m
    return shares


def fit_all(
    knots: Knots, poses: Poses, weight: FloatArray, sender: Sender, settings: MatchSettings
) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
    """Fit a motion at each of g offsets, robustly, from the best of three starts: the whole track and its two halves.

    Returns
    -------
    yaw : ndarray, shape (g,)
    shift : ndarray, shape (g, 2)
    remains : tuple of ndarray, shape (g, n)
        Residuals: squared and in units of sigma, and in metres.
    """
    half = len(knots) // 2
    parts = np.ones((3, len(knots)))
    parts[1, half:] = parts[2, :half] = 1e-3
    level = np.broadcast_to(knots.xy, poses.xy.shape)
    starts = []
    for part in parts:
        yaw, shift = rigid_motion(level, poses.xy, weight * part)
        # A start is judged by how much of the path it maps to within the vehicle's reach.
        q = ((rotate_xy(yaw[:, None], level) + shift[:, None] - poses.xy) ** 2).sum(axis=-1) / sender.reach_m**2
        starts.append((yaw, shift, q, (weight * q / (q + 1.0)).sum(axis=1)))
    pick = np.argmin([cost for *_, cost in starts], axis=0)
    rows = np.arange(len(pick))
    yaw = np.array([start[0] for start in starts])[pick, rows]
    q = np.array([start[2] for start in starts])[pick, rows]
    for widening in (1.0, 4.0, 1.0, 1.0):
        xy, sigma = completed(knots, poses, yaw[:, None], sender, settings)
        yaw, shift = rigid_motion(xy, poses.xy, weight * trust(q / widening) / sigma**2)
        remains = np.linalg.norm(rotate_xy(yaw[:, None], xy) + shift[:, None] - poses.xy, axis=-1)
        q = (remains / sigma) ** 2
    return yaw, shift, (q, remains)


def cost(q: FloatArray) -> FloatArray:
    """Return the negative log-likelihood of squared residuals, in sigma, in the presence of outliers."""
    cost: FloatArray = -np.log(OUTLIER + (1 - OUTLIER) * np.exp(-np.minimum(q, 100.0) / 2))
    return cost


def trust(q: FloatArray) -> FloatArray:
    """Return the probability that a sighting is no outlier."""
    right = (1 - OUTLIER) * np.exp(-np.minimum(q, 60.0) / 2)
    trust: FloatArray = right / (right + OUTLIER)
    return trust + 1e-9


def rigid_motion(level: FloatArray, world: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the yaw, shape (...), and shift, shape (..., 2), of the least-squares motions of points (..., n, 2)."""
    weight = weight / np.maximum(weight.sum(axis=-1, keepdims=True), 1e-12)
    middle_level = np.einsum("...n,...nk->...k", weight, level)
    middle_world = np.einsum("...n,...nk->...k", weight, world)
    a, b = level - middle_level[..., None, :], world - middle_world[..., None, :]
    dot = (weight * (a * b).sum(axis=-1)).sum(axis=-1)
    cross = (weight * (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])).sum(axis=-1)
    yaw = np.arctan2(cross, dot)
    return yaw, middle_world - rotate_xy(yaw, middle_level)


def completed(
    knots: Knots, poses: Poses, yaw_rad: FloatArray, sender: Sender, settings: MatchSettings
) -> tuple[FloatArray, FloatArray]:
    """Extend boxes away from the sensor to the vehicle's size; return their centres, shape (..., n, 2), and sigma.

    The missing part of a box is on the side away from the sensor, so its centre is off by half of that, or for a
    detector's box as likely not at all (`Knots`). Where another object hides the vehicle, it may also be on the near
    side: two standard deviations reach back to the original centre.
    """
    yaw_level = poses.yaw_rad - yaw_rad
    turned = knots.yaw_rad - yaw_level
    c, s = np.abs(np.cos(turned)), np.abs(np.sin(turned))
    lacking = np.stack(
        [
            sender.length_m - knots.length_m * c - knots.width_m * s,
            sender.width_m - knots.length_m * s - knots.width_m * c,
        ],
        axis=-1,
    ).clip(0.0)
    sight = rotate_xy(-yaw_level, knots.xy / np.maximum(np.linalg.norm(knots.xy, axis=1, keepdims=True), 1e-9))
    grown = knots.xy + rotate_xy(yaw_level, (sight / GRAZING).clip(-1.0, 1.0) * knots.partial[..., None] * lacking / 2)
    variance = settings.position_sigma_m**2 + knots.sigma_m**2 + (lacking**2).sum(axis=-1) / 16
    # The middle was computed from the reference point at the vehicle's front along the heading instead of the body's
    # yaw.
    variance = variance + (sender.length_m / 2 * np.sin(poses.slip_rad)) ** 2
    return grown, np.sqrt(variance)


def refit(scene: Scene, sender: Sender, tracks: Sequence[int], motion: Motion) -> Motion:
    """Fit the motion and the clock offset to all fragments at once."""
    knots = scene.knots[np.isin(scene.knots.track, tracks) & scene.knots.usable]
    knots = knots[np.argsort(knots.stamp_s, kind="stable")]
    step_s = scene.settings.position_sigma_m / 10.0
    for _ in range(2):
        found = _best_offset(0, knots, sender, motion.offset_s + np.linspace(-step_s, step_s, 5), scene.settings)
        if found is None:
            return motion
        motion, step_s = found.motion, step_s / 3
    return motion
