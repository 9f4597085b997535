"""Which of all that moved is a sender's vehicle.

A hypothesis is one rigid motion of the level frame into the world with one clock offset. It stands for all stations at
once, and is judged by the logarithm of its likelihood: what lies where a sender must be speaks for it by how unlikely
that would be by chance, and a sender that must be in view but is not speaks against it. Frames are not independent,
because what is visible of a vehicle changes only as it moves, so everything is counted per metre of its path.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.ndimage import binary_dilation, label

from laci_stereo.core.cam import VehicleTrack
from laci_stereo.core.errors import MatchError, TrackError
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray, rotate_xy, wrap
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.tracking import Track

KNOT_S = 0.4
"""Sightings are averaged over this time; braking at 9 m/s^2 bends the path by 9 * 0.4^2 / 24 = 6 cm meanwhile."""

TABLE_S = 0.05
"""Step at which a sender's poses are tabled; between them 9 m/s^2 bends the path by 3 mm."""

OUTLIER = 0.005
"""Weight of a wrong sighting beside a right one: one in twenty is wrong, and it is spread over ten times the area."""

PRECISIONS = (1.0, 0.7, 0.5, 0.35, 0.25)
"""How exact positions may be, relative to the settings' sigma: from GNSS alone down to one with carrier phases."""

WORST = -math.log(OUTLIER)
"""What a stretch costs whose sightings are all wrong."""

GRAZING = 0.3
"""A side that is seen at less than this angle (rad) is foreshortened to a third; from there on its part fades out."""

HEADING_SIGMA_RAD = 0.2
"""Of a box that is clearly longer than wide: one of its sides is off by a point's noise of 0.3 m in half a length."""

RADIAL_SIGMA_MPS = 0.3
"""Of a radial speed: wheels and the Doppler cell of a radar."""

RADIAL_SLOPE = 0.05
"""A sensor 6 m above ground that is 20 m away sees cos(17 deg) = 0.95 of a speed along the ground."""

SIZE_SIGMA_M = 0.5
"""By how much a box may be longer than the vehicle's diagonal: the reach of a cluster on both of its ends."""

SPEED_SPREAD = 0.2
"""Standard deviation of the speeds of free traffic, relative to their mean: how likely a stranger has the same."""

SAME_MANOEUVRE = math.log(10_000.0)
"""However special a drive is: of a hundred strangers that are recorded for a minute one makes the same turn within half
a second, and of a hundred of these one has the same speed all the way, since they have the same roads and lights."""

USUAL_MPS2 = 1.0
"""Standard deviation of accelerations in traffic, along and across."""

MAX_ORDER = 5
"""Up to this order a stranger's path is a polynomial; its bends and stops within the view are one or two."""

MISSED = -math.log(0.2)
"""What a stretch costs in which a vehicle that must be in view is not seen: one in five is hidden by other traffic."""

HIDDEN_STRETCHES = 2.0
"""What hides a vehicle, such as one that comes towards it, does so on average for two more stretches."""

SILENT = -math.log(0.05)
"""The most that another sender can cost by not being seen: one in twenty is no vehicle that a sensor detects."""

VIEW_CELL_M = 5.0
"""Where something was seen, so far around it everything can be seen: about a vehicle's length."""

MAX_GOOD_SIGMA = 2.0
"""The median of what remains of a right match is 1.2 sigma in two dimensions; of five stretches, 2 % exceed this."""

SEARCH_KNOTS = 30
"""So many knots of a track bring it together with a sender's; all of them judge the result."""


@dataclass(frozen=True)
class Choice:
    """The track that is the sender's.

    Attributes
    ----------
    station : int
    track : Track
        Its fragments joined.
    explained : float
        Of how many frames the fit accounts for, each counted by how well.
    second : float
        The same of the best other candidate.
    fit : PlanarMatch
        The motion from the level into the world frame that brings the track onto the sender's.
    time_offset_s : float
        To be added to the sensor's stamps to get the CAMs' time.
    log_likelihood_margin : float
        Log odds against the second-best hypothesis that says something else; infinite if there is none.
    second_is : str
        What that is, in words.
    """

    station: int
    track: Track
    explained: float
    second: float
    fit: PlanarMatch
    time_offset_s: float
    log_likelihood_margin: float
    second_is: str


@dataclass(frozen=True)
class _Knots:
    """Averages over a track's successive sightings; each attribute has shape (n,), and ``xy`` (n, 2)."""

    track: IntArray
    stamp_s: FloatArray
    xy: FloatArray
    length_m: FloatArray
    width_m: FloatArray
    yaw_rad: FloatArray
    sigma_m: FloatArray
    radial_mps: FloatArray
    frames: FloatArray
    usable: BoolArray

    def __len__(self) -> int:
        return len(self.stamp_s)

    def __getitem__(self, keep: BoolArray | IntArray) -> _Knots:
        return _Knots(*(getattr(self, field.name)[keep] for field in fields(self)))


@dataclass(frozen=True)
class _Poses:
    """Of a sender's vehicle: each attribute has the shape of the stamps, ``xy`` and ``velocity`` one axis more."""

    xy: FloatArray
    velocity: FloatArray
    yaw_rad: FloatArray
    path_m: FloatArray
    known: BoolArray


@dataclass(frozen=True)
class _Sender:
    """A sender's poses on a regular grid of times that begins at ``first_s``."""

    station: int
    first_s: float
    table: FloatArray
    known: BoolArray
    length_m: float
    width_m: float

    @property
    def reach_m(self) -> float:
        """Half of the diagonal: the centre of what is visible of a vehicle is no farther from its own."""
        return math.hypot(self.length_m, self.width_m) / 2

    def at(self, stamps_s: FloatArray) -> _Poses:
        """Interpolate; where the sender was silent the poses mean nothing."""
        place = (stamps_s - self.first_s) / TABLE_S
        before = np.floor(place).astype(np.int64).clip(0, len(self.table) - 2)
        share = (place - before)[..., None]
        values = self.table[before] * (1 - share) + self.table[before + 1] * share
        inside = (place >= 0) & (place <= len(self.table) - 1)
        known = inside & self.known[before] & self.known[before + 1]
        return _Poses(values[..., 0:2], values[..., 2:4], values[..., 4], values[..., 5], known)


@dataclass(frozen=True)
class _Motion:
    """A hypothesis; the yaw has shape (g,) and the shift (g, 2), or () and (2,) of a single one."""

    yaw_rad: FloatArray
    shift: FloatArray
    offset_s: FloatArray


@dataclass(frozen=True)
class _Seed:
    """What one track and one station say by themselves."""

    station: int
    track: int
    motion: _Motion
    score: float
    share: float


@dataclass(frozen=True)
class _Account:
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
    coincidence : float
        Minus the log probability that a stranger is where the vehicle must be.
    """

    station: int
    tracks: tuple[int, ...]
    explained: float
    typical: float
    value: float
    coincidence: float


@dataclass(frozen=True)
class _Hypothesis:
    seed: _Seed
    motion: _Motion
    account: _Account
    accounts: tuple[_Account, ...]
    value: float


@dataclass(frozen=True)
class _Scene:
    tracks: Sequence[Track]
    knots: _Knots
    senders: Mapping[int, _Sender]
    seen_cells: BoolArray
    first_cell: FloatArray
    density: float
    settings: MatchSettings

    def in_view(self, xy_level: FloatArray) -> BoolArray:
        """Tell where on the ground, shape (n, 2), a vehicle would have been seen."""
        cell = np.floor((xy_level - self.first_cell) / VIEW_CELL_M)
        inside = np.all((cell >= 0) & (cell < self.seen_cells.shape), axis=1)
        i, j = np.where(inside[:, None], cell, 0).astype(np.int64).T
        seen: BoolArray = inside & self.seen_cells[i, j]
        return seen


def choose_track(
    tracks: Sequence[Track], vehicles: Mapping[int, VehicleTrack], settings: MatchSettings | None = None
) -> Choice:
    """Find which track is which sender's: the one whose motion is most likely the vehicle's.

    Each pair of a track and a station is brought together by a rigid motion and a clock offset. Each such hypothesis is
    then held against everything that was seen, and all tracks that it puts onto the vehicle are joined.

    Parameters
    ----------
    tracks : sequence of Track
    vehicles : mapping of int to VehicleTrack
        By station.
    settings : MatchSettings

    Raises
    ------
    TrackError
        If no sender moves while it is recorded, or no track is long enough.
    MatchError
        If none fits, or two fit equally well.
    """
    settings = settings or MatchSettings()
    _check_motion(vehicles, settings)
    scene = _scene(tracks, vehicles, settings)
    seeds = _seeds(scene)
    if not seeds:
        raise TrackError(_nothing_found(tracks, settings))
    hypotheses = _hypotheses(scene, seeds)
    if not hypotheses:
        raise MatchError(_no_fit(seeds, vehicles, settings))
    return _decide(scene, hypotheses)


def _decide(scene: _Scene, hypotheses: Sequence[_Hypothesis]) -> Choice:
    best = max(hypotheses, key=lambda one: one.value)
    rivals = [one for one in hypotheses if one is not best and not _agree(best, one)]
    claims = [(best.value - one.value, one.account) for one in rivals]
    # A second sender with the same track is on the same vehicle, or one of the two is not what is seen.
    mine = set(best.account.tracks)
    claims += [
        (best.account.value - account.value, account)
        for account in best.accounts
        if account is not best.account and mine & set(account.tracks)
    ]
    margin, second = min(claims, key=lambda claim: claim[0], default=(math.inf, None))
    track = _joined(scene, best.account)
    if second is not None and margin < scene.settings.clear_log_odds:
        raise MatchError(_tie(scene, best.account, second, margin))
    return Choice(
        station=best.account.station,
        track=track,
        explained=best.account.explained,
        second=0.0 if second is None else second.explained,
        fit=PlanarMatch(float(best.motion.yaw_rad), best.motion.shift),
        time_offset_s=float(best.motion.offset_s),
        log_likelihood_margin=margin,
        second_is="nothing else" if second is None else _named(scene, best.account, second),
    )


def _agree(best: _Hypothesis, other: _Hypothesis) -> bool:
    """Tell whether the best motion also puts the other's track onto its vehicle, and so both say the same."""
    return any(
        account.station == other.seed.station and other.seed.track in account.tracks for account in best.accounts
    )


def _joined(scene: _Scene, account: _Account) -> Track:
    """Join the fragments of one drive, the longest first; what is seen beside them is another part of the vehicle."""
    first, *others = (scene.tracks[index] for index in account.tracks)
    for other in others:
        if first.disjoint(other):
            first = first.joined(other)
    return first


# ---------------------------------------------------------------------------------------- hypotheses


def _seeds(scene: _Scene) -> list[_Seed]:
    """Bring each track together with each station, the one with the best match first."""
    seeds = []
    for index in range(len(scene.tracks)):
        knots = scene.knots[(scene.knots.track == index) & scene.knots.usable]
        if knots.frames.sum() < scene.settings.min_frames or _extent(knots.xy) < scene.settings.min_path_m:
            continue
        for sender in scene.senders.values():
            seed = _seed(index, knots, sender, scene.settings)
            if seed is not None:
                seeds.append(seed)
    return sorted(seeds, key=lambda seed: -seed.score)


def _seed(index: int, knots: _Knots, sender: _Sender, settings: MatchSettings) -> _Seed | None:
    """Search the clock offset on a grid, and around its best."""
    knots = knots[np.linspace(0, len(knots) - 1, min(len(knots), SEARCH_KNOTS)).round().astype(np.int64)]
    now = sender.at(knots.stamp_s)
    fastest_mps = max(float(np.linalg.norm(now.velocity, axis=1).max()), 1.0)
    limit_s = 3 * settings.clock_sigma_s
    # A step moves the vehicle by less than its reach, most of which the motion takes up; the grid is then narrowed.
    steps = math.ceil(limit_s * fastest_mps / (3 * settings.position_sigma_m))
    offsets_s, step_s = np.linspace(-limit_s, limit_s, 2 * steps + 1), limit_s / max(steps, 1)
    found: _Seed | None = None
    for _ in range(4):
        found = _best_offset(index, knots, sender, offsets_s, settings)
        if found is None or found.share < settings.min_explained / 2:
            break
        offsets_s, step_s = found.motion.offset_s + np.linspace(-step_s, step_s, 7), step_s / 3
    return found


def _best_offset(
    index: int, knots: _Knots, sender: _Sender, offsets_s: FloatArray, settings: MatchSettings
) -> _Seed | None:
    poses = sender.at(knots.stamp_s + offsets_s[:, None])
    frames = poses.known @ knots.frames
    span = np.ptp(np.where(poses.known[..., None], poses.xy, poses.xy[:, :1]), axis=1)
    enough = (frames >= settings.min_frames) & (np.linalg.norm(span, axis=1) >= settings.min_path_m)
    if not enough.any():
        return None
    offsets_s = offsets_s[enough]
    poses = _Poses(*(getattr(poses, field.name)[enough] for field in fields(poses)))
    weight = poses.known * _path_shares(poses, knots.stamp_s, settings)
    yaw, shift, remains = _fit(knots, poses, weight, sender, settings)
    score = (weight * (WORST - _cost(remains[0]))).sum(axis=1) - (offsets_s / settings.clock_sigma_s) ** 2 / 2
    best = int(np.argmax(score))
    closeness = np.maximum(1 - (remains[1][best] / sender.reach_m) ** 2, 0.0)
    share = float((closeness * poses.known[best]) @ knots.frames / (poses.known[best] @ knots.frames))
    motion = _Motion(yaw[best], shift[best], offsets_s[best])
    return _Seed(sender.station, index, motion, float(score[best]), share)


def _path_shares(poses: _Poses, stamps_s: FloatArray, settings: MatchSettings) -> FloatArray:
    """Return how many independent stretches each knot stands for: its part of the path, shape (..., n)."""
    if len(stamps_s) < 2:
        return np.zeros_like(poses.path_m)
    half_s = np.minimum(np.diff(stamps_s), 2 * KNOT_S) / 2
    speed = np.linalg.norm(poses.velocity, axis=-1)
    time_s = np.append(half_s, half_s[-1])
    time_s[1:-1] += half_s[:-1]
    shares: FloatArray = speed * time_s / settings.stretch_m
    return shares


def _fit(
    knots: _Knots, poses: _Poses, weight: FloatArray, sender: _Sender, settings: MatchSettings
) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
    """Fit a motion at each of g offsets, robustly, from the best of three starts: the whole track and its halves.

    Returns
    -------
    yaw : ndarray, shape (g,)
    shift : ndarray, shape (g, 2)
    remains : tuple of ndarray, shape (g, n)
        Squared in sigma, and in metres.
    """
    half = len(knots) // 2
    parts = np.ones((3, len(knots)))
    parts[1, half:] = parts[2, :half] = 1e-3
    level = np.broadcast_to(knots.xy, poses.xy.shape)
    starts = []
    for part in parts:
        yaw, shift = _rigid(level, poses.xy, weight * part)
        # A start is judged by how much of the path it brings to within the vehicle's reach.
        q = ((rotate_xy(yaw[:, None], level) + shift[:, None] - poses.xy) ** 2).sum(axis=-1) / sender.reach_m**2
        starts.append((yaw, shift, q, (weight * q / (q + 1.0)).sum(axis=1)))
    pick = np.argmin([cost for *_, cost in starts], axis=0)
    rows = np.arange(len(pick))
    yaw = np.array([start[0] for start in starts])[pick, rows]
    q = np.array([start[2] for start in starts])[pick, rows]
    for widening in (1.0, 4.0, 1.0, 1.0):
        xy, sigma = _completed(knots, poses.yaw_rad - yaw[:, None], sender, settings)
        yaw, shift = _rigid(xy, poses.xy, weight * _trust(q / widening) / sigma**2)
        remains = np.linalg.norm(rotate_xy(yaw[:, None], xy) + shift[:, None] - poses.xy, axis=-1)
        q = (remains / sigma) ** 2
    return yaw, shift, (q, remains)


def _cost(q: FloatArray) -> FloatArray:
    """Return minus the log likelihood of what remains, squared in sigma, when some sightings are wrong."""
    cost: FloatArray = -np.log(OUTLIER + (1 - OUTLIER) * np.exp(-np.minimum(q, 100.0) / 2))
    return cost


def _trust(q: FloatArray) -> FloatArray:
    """Return the probability that a sighting is right."""
    right = (1 - OUTLIER) * np.exp(-np.minimum(q, 60.0) / 2)
    trust: FloatArray = right / (right + OUTLIER)
    return trust + 1e-9


def _rigid(level: FloatArray, world: FloatArray, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the yaw, shape (...), and the shift, shape (..., 2), of the least-squares motions of (..., n, 2)."""
    weight = weight / np.maximum(weight.sum(axis=-1, keepdims=True), 1e-12)
    middle_level = np.einsum("...n,...nk->...k", weight, level)
    middle_world = np.einsum("...n,...nk->...k", weight, world)
    a, b = level - middle_level[..., None, :], world - middle_world[..., None, :]
    dot = (weight * (a * b).sum(axis=-1)).sum(axis=-1)
    cross = (weight * (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])).sum(axis=-1)
    yaw = np.arctan2(cross, dot)
    return yaw, middle_world - rotate_xy(yaw, middle_level)


def _completed(
    knots: _Knots, yaw_level: FloatArray, sender: _Sender, settings: MatchSettings
) -> tuple[FloatArray, FloatArray]:
    """Grow the boxes away from the sensor to the vehicle's size: their centres, shape (..., n, 2), and their sigma.

    What is lacking faces away from the sensor, so by half of it the centre is off. Where it is hidden by something else
    it may lack on the near side too: by twice the standard deviation the centre is back where it was.
    """
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
    grown = knots.xy + rotate_xy(yaw_level, (sight / GRAZING).clip(-1.0, 1.0) * lacking / 2)
    variance = settings.position_sigma_m**2 + knots.sigma_m**2 + (lacking**2).sum(axis=-1) / 16
    return grown, np.sqrt(variance)


# ---------------------------------------------------------------------------------------- the judgement


def _hypotheses(scene: _Scene, seeds: Sequence[_Seed]) -> list[_Hypothesis]:
    """Hold the seeds against the whole scene; what a better one says too is not repeated."""
    found: list[_Hypothesis] = []
    for seed in seeds:
        if seed.share < scene.settings.min_explained:
            continue
        if any(
            seed.track in account.tracks and account.station == seed.station
            for one in found
            for account in one.accounts
        ):
            continue
        hypothesis = _judge(scene, seed)
        if hypothesis is not None:
            found.append(hypothesis)
    return found


def _judge(scene: _Scene, seed: _Seed) -> _Hypothesis | None:
    sender = scene.senders[seed.station]
    motion = seed.motion
    own = _account(scene, sender, motion)
    for _ in range(2):
        if not own.tracks:
            return None
        motion = _refit(scene, sender, own.tracks, motion)
        own = _account(scene, sender, motion)
    if seed.track not in own.tracks or own.typical > MAX_GOOD_SIGMA:
        return None
    others = [_account(scene, other, motion) for other in scene.senders.values() if other is not sender]
    prior = -((float(motion.offset_s) / scene.settings.clock_sigma_s) ** 2) / 2
    value, claimed = prior + own.value, set(own.tracks)
    for account in sorted(others, key=lambda one: -one.value):
        if claimed.isdisjoint(account.tracks):
            value += max(account.value + account.coincidence, -SILENT)
            claimed |= set(account.tracks)
    return _Hypothesis(seed, motion, own, (own, *others), value)


def _refit(scene: _Scene, sender: _Sender, tracks: Sequence[int], motion: _Motion) -> _Motion:
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


def _account(scene: _Scene, sender: _Sender, motion: _Motion) -> _Account:
    """Hold a hypothesis against all that was seen, for one station."""
    settings = scene.settings
    knots = scene.knots
    poses = sender.at(knots.stamp_s + motion.offset_s)
    xy, sigma = _completed(knots, poses.yaw_rad - motion.yaw_rad, sender, settings)
    remains = np.linalg.norm(rotate_xy(motion.yaw_rad, xy) + motion.shift - poses.xy, axis=-1)
    usable = poses.known & knots.usable
    closeness = np.where(usable, np.maximum(1 - (remains / sender.reach_m) ** 2, 0.0), 0.0) * knots.frames
    explained = np.bincount(knots.track, closeness, len(scene.tracks))
    possible = np.bincount(knots.track, usable * knots.frames, len(scene.tracks))
    with np.errstate(invalid="ignore", divide="ignore"):
        fitting = np.flatnonzero(explained / possible >= settings.min_explained)
    fitting = fitting[np.argsort(-explained[fitting], kind="stable")]
    missed = _missed(scene, sender, motion, poses.known & (remains <= 2 * sender.reach_m))
    mine = np.flatnonzero(np.isin(knots.track, fitting) & usable)
    mine = mine[np.argsort(knots.stamp_s[mine], kind="stable")]
    of_mine = sender.at(knots.stamp_s[mine] + motion.offset_s)
    weight = _path_shares(of_mine, knots.stamp_s[mine], settings)
    stretches = float(weight.sum())
    if stretches == 0.0:
        return _Account(sender.station, (), 0.0, math.inf, -missed, 0.0)
    q = (remains[mine] / sigma[mine]) ** 2
    odd = float(weight @ _cost(_odd(knots[mine], of_mine, motion, sender)))
    sigma_m = float(np.sqrt(np.average(sigma[mine] ** 2, weights=weight)))
    evidence = _evidence(knots[mine], xy[mine], sigma[mine], q, weight, settings)
    return _Account(
        station=sender.station,
        tracks=tuple(fitting.tolist()),
        explained=float(explained[fitting].sum()),
        typical=math.sqrt(_median(q, weight)),
        value=evidence - odd - missed,
        coincidence=max(0.0, -math.log(2 * math.pi * sigma_m**2 * scene.density)),
    )


def _odd(knots: _Knots, poses: _Poses, motion: _Motion, sender: _Sender) -> FloatArray:
    """Return what else than the position is wrong with the sightings, squared in sigma: size, direction and speed."""
    too_long = np.maximum(knots.length_m - 2 * sender.reach_m - 5 * knots.sigma_m, 0.0) / SIZE_SIGMA_M
    long = (knots.length_m > 1.5 * knots.width_m) & (knots.length_m > sender.length_m / 2)
    turned = wrap(2 * (knots.yaw_rad + motion.yaw_rad - poses.yaw_rad)) / 2
    turned = np.where(long, turned, 0.0) / HEADING_SIGMA_RAD
    sight = knots.xy / np.maximum(np.linalg.norm(knots.xy, axis=1, keepdims=True), 1e-9)
    radial = (rotate_xy(-motion.yaw_rad, poses.velocity) * sight).sum(axis=1)
    sigma_mps = np.hypot(RADIAL_SIGMA_MPS, RADIAL_SLOPE * radial)
    off = np.where(np.isfinite(knots.radial_mps), knots.radial_mps - radial, 0.0) / sigma_mps
    odd: FloatArray = too_long**2 + turned**2 + off**2
    return odd


def _evidence(
    knots: _Knots, xy_level: FloatArray, sigma: FloatArray, q: FloatArray, weight: FloatArray, settings: MatchSettings
) -> float:
    """Return the log likelihood of a track if it is the sender's over that if it is a stranger's.

    The motion that is fitted takes up any position and direction. A stranger follows a polynomial of time. Of each of
    its coefficients it must have the right value within the resolution: for the speed that is sigma sqrt(12 / n) in the
    whole length of n stretches, for what bends the path sigma / sqrt(n) in some a t^2 / 8, on both axes.
    """
    stretches = float(weight.sum())
    sigma_m = float(np.sqrt(np.average(sigma**2, weights=weight)))
    span_s = float(np.ptp(knots.stamp_s))
    speed = SPEED_SPREAD * settings.stretch_m * stretches**1.5 / (math.sqrt(12) * sigma_m)
    bend = USUAL_MPS2 * span_s**2 / 8 * math.sqrt(stretches) / sigma_m
    powers = np.vander((knots.stamp_s - knots.stamp_s.mean()) / max(span_s, KNOT_S), MAX_ORDER + 1, increasing=True)
    stranger = math.inf
    for order in range(1, min(MAX_ORDER, len(knots) - 1) + 1):
        surprise = math.log(max(1.0, speed)) + 2 * (order - 1) * math.log(max(1.0, bend))
        rest = _polynomial_misfit(powers[:, : order + 1], xy_level, sigma, q, weight)
        # A stranger may also drive just like the sender; then the polynomial leaves the noise of its sightings.
        alike = SAME_MANOEUVRE + _misfit(rest, weight, 3)
        stranger = min(stranger, alike, surprise + _misfit(rest, weight, 2 * order + 2))
    return stranger - _misfit(q, weight, 3)


def _polynomial_misfit(
    powers: FloatArray, xy_level: FloatArray, sigma: FloatArray, q: FloatArray, weight: FloatArray
) -> FloatArray:
    """Return what a polynomial leaves of a path, squared in sigma, at first without what the sender's drive misfits."""
    for _ in range(3):
        root = np.sqrt(weight * _trust(q))[:, None] / sigma[:, None]
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


def _missed(scene: _Scene, sender: _Sender, motion: _Motion, near: BoolArray) -> float:
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


def _median(values: FloatArray, weight: FloatArray) -> float:
    order = np.argsort(values)
    share = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(share, share[-1] / 2)])


# ---------------------------------------------------------------------------------------- the scene


def _scene(tracks: Sequence[Track], vehicles: Mapping[int, VehicleTrack], settings: MatchSettings) -> _Scene:
    knots = _knots(tracks)
    senders = {
        station: _sender(station, vehicle) for station, vehicle in vehicles.items() if len(vehicle.stamps_s) >= 2
    }
    usable = knots.xy[knots.usable] if knots.usable.any() else np.zeros((1, 2))
    first_cell = usable.min(axis=0) - 2 * VIEW_CELL_M
    cells = np.floor((usable - first_cell) / VIEW_CELL_M).astype(np.int64)
    seen = np.zeros(cells.max(axis=0) + 3, dtype=bool)
    seen[tuple(cells.T)] = True
    # How many other objects there are for each square metre where there are any, at one time.
    bins = max(1, len(np.unique(np.floor(knots.stamp_s / KNOT_S))))
    density = max(len(knots) / bins, 1.0) / (np.count_nonzero(seen) * VIEW_CELL_M**2)
    view = binary_dilation(seen, np.ones((3, 3), dtype=bool))
    return _Scene(tracks, knots, senders, view, first_cell, float(density), settings)


def _knots(tracks: Sequence[Track]) -> _Knots:
    sightings = [(index, one) for index, track in enumerate(tracks) for one in track.sightings]
    index = np.array([index for index, _ in sightings], dtype=np.int64)
    usable = np.array([one.flaw is None for _, one in sightings], dtype=bool)
    stamps_s = np.array([one.stamp_s for _, one in sightings])
    xy = np.array([one.box.centre for _, one in sightings]).reshape(-1, 2)
    others = np.array(
        [
            (
                one.box.length_m,
                one.box.width_m,
                one.box.yaw_rad,
                one.sigma_m,
                np.nan if one.radial_mps is None else one.radial_mps,
            )
            for _, one in sightings
        ]
    ).reshape(-1, 5)
    key = np.column_stack([index, usable, np.floor(stamps_s / KNOT_S)])
    order = np.lexsort((stamps_s, key[:, 2], key[:, 1], key[:, 0]))
    new = np.append(True, (np.diff(key[order], axis=0) != 0).any(axis=1))[: len(order)]
    starts = np.flatnonzero(new)
    count = np.diff(np.append(starts, len(order)))
    middle = order[starts + count // 2]

    def mean(values: FloatArray) -> FloatArray:
        total: FloatArray = np.add.reduceat(values[order], starts, axis=0) if len(starts) else values
        return total / (count[:, None] if values.ndim == 2 else count)

    length, width, yaw, sigma, radial = others[middle].T
    return _Knots(
        index[middle], mean(stamps_s), mean(xy), length, width, yaw, sigma, radial, count.astype(float), usable[middle]
    )


def _sender(station: int, vehicle: VehicleTrack) -> _Sender:
    vehicle = _without_jumps(vehicle)
    first_s, last_s = float(vehicle.stamps_s[0]), float(vehicle.stamps_s[-1])
    steps = np.arange(max(2, math.ceil((last_s - first_s) / TABLE_S) + 1), dtype=np.float64)
    grid = first_s + TABLE_S * steps
    xy, yaw, known = vehicle.at(grid)
    for values in (*xy.T, yaw):
        values[~known] = np.interp(grid[~known], grid[known], values[known])
    velocity = np.gradient(xy, TABLE_S, axis=0)
    path = np.cumsum(np.linalg.norm(velocity, axis=1)) * TABLE_S
    return _Sender(
        station, first_s, np.column_stack([xy, velocity, yaw, path]), known, vehicle.length_m, vehicle.width_m
    )


def _without_jumps(vehicle: VehicleTrack) -> VehicleTrack:
    """Leave out messages whose position is off a line through those around it, by the medians of its parts."""
    t, reach_m = vehicle.stamps_s, math.hypot(vehicle.length_m, vehicle.width_m) / 2
    good = np.ones(len(t), dtype=bool)
    share = ((t[1:-1] - t[:-2]) / (t[2:] - t[:-2]))[:, None]
    chord = vehicle.xy[:-2] * (1 - share) + vehicle.xy[2:] * share
    odd = t[1:-1][np.linalg.norm(vehicle.xy[1:-1] - chord, axis=1) > reach_m / 2]
    for i in np.flatnonzero([np.abs(odd - stamp).min(initial=math.inf) < 0.5 for stamp in t]):
        first, last = np.searchsorted(t, (t[i] - 1.0, t[i] + 1.0))
        if last - first < 7:  # too few to outvote what is wrong
            continue
        time, xy = t[first:last] - t[i], vehicle.xy[first:last]
        a, b = np.triu_indices(last - first, (last - first) // 2)
        slope = np.median((xy[b] - xy[a]) / (time[b] - time[a])[:, None], axis=0)
        expected = np.median(xy - time[:, None] * slope, axis=0)
        good[i] = np.linalg.norm(vehicle.xy[i] - expected) <= reach_m
    if good.sum() < 2:
        return vehicle
    return VehicleTrack(
        t[good], vehicle.epoch_ns, vehicle.xy[good], vehicle.yaw_rad[good], vehicle.length_m, vehicle.width_m
    )


# ---------------------------------------------------------------------------------------- in words


def _named(scene: _Scene, best: _Account, second: _Account) -> str:
    if second.station != best.station:
        return f"station {second.station}"
    return f"another moving object, seen in {len(_joined(scene, second).usable)} frames"


def _tie(scene: _Scene, best: _Account, second: _Account, margin: float) -> str:
    frames = [len(_joined(scene, account).usable) for account in (best, second)]
    what = (
        f"stations {best.station} and {second.station}"
        if second.station != best.station
        else f"two moving objects, seen in {frames[0]} and {frames[1]} frames,"
    )
    return (
        f"{what} fit equally well (odds of {math.exp(margin):.1f} to 1; needed are "
        f"{math.exp(scene.settings.clear_log_odds):.0f} to 1): name the sender's station, or record a drive with a "
        "turn or less traffic"
    )


def _no_fit(seeds: Sequence[_Seed], vehicles: Mapping[int, VehicleTrack], settings: MatchSettings) -> str:
    best = max(seeds, key=lambda seed: seed.share)
    stations = ", ".join(str(station) for station in sorted(vehicles))
    return (
        f"no moving object fits the CAMs: {best.share:.0%} of the frames of the best of {len(seeds)} explained; needed "
        f"are {settings.min_explained:.0%}, within {MAX_GOOD_SIGMA:.0f} sigma; not seen: station {stations}"
    )


def _check_motion(vehicles: Mapping[int, VehicleTrack], settings: MatchSettings) -> None:
    paths = {station: _extent(vehicle.xy) for station, vehicle in vehicles.items()}
    station = max(paths, key=lambda key: paths[key])
    if paths[station] < settings.min_path_m:
        raise TrackError(
            f"the vehicle of station {station} stands still: it moves {paths[station]:.2f} m according to its CAMs; "
            f"needed are {settings.min_path_m:.1f} m"
        )


def _extent(xy: FloatArray) -> float:
    return float(np.linalg.norm(np.ptp(xy, axis=0))) if len(xy) else 0.0


def _nothing_found(tracks: Sequence[Track], settings: MatchSettings) -> str:
    longest = max((len(track.usable) for track in tracks), default=0)
    widest = max((_extent(track.centres) for track in tracks), default=0.0)
    flaws: Counter[str] = sum((track.flaws() for track in tracks), Counter())
    left_out = ", ".join(f"{count} {flaw}" for flaw, count in sorted(flaws.items())) or "none"
    return (
        f"no vehicle was found: {len(tracks)} moving objects, the longest seen in {longest} frames, the farthest "
        f"moving {widest:.1f} m (left out: {left_out}); needed is one that is seen in {settings.min_frames} frames "
        f"while its CAMs tell its position, and moves {settings.min_path_m:.1f} m"
    )
