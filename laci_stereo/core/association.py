"""Which of all that moved is a sender's vehicle.

A hypothesis is one rigid motion of the level frame into the world with one clock offset. It stands for all stations at
once, and is judged by the logarithm of its likelihood: what lies where a sender must be speaks for it by how unlikely
that would be by chance, and a sender that must be in view but is not speaks against it. Frames are not independent,
because what is visible of a vehicle changes only as it moves, so everything is counted per metre of its path.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from laci_stereo.core.association_words import (
    by_chance,
    folding,
    lingering,
    named,
    no_fit,
    nothing_found,
    tie,
    towing,
)
from laci_stereo.core.cam import VehicleTrack
from laci_stereo.core.choice import Choice, Likeness, Other, no_likeness
from laci_stereo.core.errors import MatchError, TrackError
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.late_senders import by_another_clock
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.settings import MatchSettings, with_turn
from laci_stereo.core.track_likelihood import MAX_GOOD_SIGMA, Account, hold_against, joined
from laci_stereo.core.track_motion import Motion, Seed, find_seeds, refit
from laci_stereo.core.track_scene import Scene, Sender, extent, lay_out
from laci_stereo.core.tracking import GATE, Times, Track, bridged_s

log = logging.getLogger(__name__)

SILENT = -math.log(0.05)
"""The most that another sender can cost by not being seen: one in twenty is no vehicle that a sensor detects.

So likely it is, too, that none of the tracks is the sender's."""

IN_LINE = math.log(10.0)
"""One other vehicle in ten drives in line with the sender's, on its way and at its speed. By how much more exactly a
track fits than boxes show then tells no more of which of two it is."""

UNSEEN_S = 1.0
"""What is not seen for so long may be something else when it is seen again."""

HALF_LANE_M = 1.75
"""No farther from its way is what drives in line."""

OUTLINE_REACH = 10.0
"""What outlines can tell: two contradictions, each of which one sender in fifty may cause by a mistake, and back."""

BOXES_S = 0.1
"""By boxes clocks are not told apart that are nearer to each other: they are decimetres off, and vehicles drive at some
metres a second."""

MOST_OUTLINES = 8
"""So many hypotheses are held against the outlines at the most: of those far down there are always more."""


@dataclass(frozen=True)
class _Hypothesis:
    seed: Seed
    motion: Motion
    account: Account
    accounts: tuple[Account, ...]
    value: float
    way: float
    strayed_s: Times = ()
    fit: PlanarMatch | None = None
    late_s: float = 0.0
    by_others: float = 0.0

    def place(self, xy_level: FloatArray) -> FloatArray:
        """Map points, shape (n, 2), from the level to the world frame, as exactly as is known."""
        return self.motion.place(xy_level) if self.fit is None else self.fit(xy_level)

    @property
    def against_others(self) -> float:
        """The value, but for what a track that follows the sender's vehicle could have as well."""
        return self.value - max(0.0, self.way - max(self.account.way, IN_LINE))


def choose_track(
    tracks: Sequence[Track],
    vehicles: Mapping[int, VehicleTrack],
    settings: MatchSettings | None = None,
    likeness: Likeness = no_likeness,
) -> Choice:
    """Find which track is which sender's: the one whose motion, and whose body, is most likely the vehicle's.

    Each pair of a track and a station is brought together by a rigid motion and a clock offset. Each such hypothesis is
    then held against everything that was seen, and all tracks that it puts onto the vehicle are joined.

    Parameters
    ----------
    tracks : sequence of Track
    vehicles : mapping of int to VehicleTrack
        By station.
    settings : MatchSettings
    likeness : callable
        Asked of the few whose motion comes into question.

    Raises
    ------
    TrackError
        If no sender moves while it is recorded, or no track is long enough.
    MatchError
        If none fits, or two fit equally well.
    """
    settings = settings or MatchSettings()
    turn_s = max((track.turn_s for track in tracks), default=0.0)
    settings = replace(settings, clock_sigma_s=with_turn(settings.clock_sigma_s, turn_s))
    _check_motion(vehicles, settings)
    scene = lay_out(tracks, vehicles, settings)
    seeds = find_seeds(scene)
    if not seeds:
        raise TrackError(nothing_found(tracks, settings) + folding(vehicles) + lingering(scene))
    hypotheses = _hypotheses(scene, seeds)
    if not hypotheses:
        raise MatchError(no_fit(scene, seeds) + folding(vehicles) + lingering(scene) + towing(scene))
    far = {seed.track for seed in seeds if extent(tracks[seed.track].centres) >= settings.min_path_m}
    weighed = _weighed(scene, _of_moving(scene, hypotheses), vehicles, likeness)
    return _decide(scene, _of_moving(scene, weighed), far)


def _of_moving(scene: Scene, hypotheses: Sequence[_Hypothesis]) -> list[_Hypothesis]:
    """Leave out those whose vehicle hardly moves while it is seen: whatever stands there would fit as well."""
    least_m = scene.settings.min_path_m
    paths_m = [_seen_path(scene, one, one.account, _on_vehicle(scene, one, one.account)) for one in hypotheses]
    moving = [one for one, path_m in zip(hypotheses, paths_m, strict=True) if path_m >= least_m]
    if not moving:
        path_m, best = max(zip(paths_m, hypotheses, strict=True), key=lambda each: each[1].value)
        raise TrackError(
            f"the vehicle of station {best.account.station} moves {path_m:.1f} m while it is seen; needed are "
            f"{least_m:.1f} m"
        )
    return moving


def _weighed(
    scene: Scene, hypotheses: Sequence[_Hypothesis], vehicles: Mapping[int, VehicleTrack], likeness: Likeness
) -> list[_Hypothesis]:
    """Add what outlines tell to the hypotheses that it could decide between: of the way more exactly than boxes."""
    ordered = sorted(hypotheses, key=lambda one: -one.value)
    weighed = []
    for rank, one in enumerate(ordered):
        if rank < MOST_OUTLINES and one.value > ordered[0].value - OUTLINE_REACH:
            fit = PlanarMatch(float(one.motion.yaw_rad), one.motion.shift)
            track = _on_vehicle(scene, one, one.account)
            alike = likeness(track, vehicles[one.account.station], fit, float(one.motion.offset_s))
            log.debug("station %d: %.1f by boxes, by outlines %s (log odds)", one.account.station, one.value, alike)
            way = one.way if alike.way is None else min(alike.way, _of_pieces(scene, one.account, track, alike.way))
            value = one.value + alike.body + way - one.way
            one = replace(one, value=value, way=way, strayed_s=alike.strayed_s, fit=alike.fit)
        weighed.append(one)
    return weighed


def _of_pieces(scene: Scene, account: Account, track: Track, way: float) -> float:
    """Return the most that a way can tell whose track is joined of pieces.

    Each further piece may be something else that is where the vehicle must be, as improbable as that is.
    """
    first = scene.tracks[account.tracks[0]]
    share = min(1.0, len(first.sightings) / max(1, len(track.sightings)))
    return max(way, 0.0) * share + (len(account.tracks) - 1) * account.coincidence


def _decide(scene: Scene, hypotheses: Sequence[_Hypothesis], candidates: Set[int]) -> Choice:
    best = max(hypotheses, key=lambda one: one.value)
    track = _on_vehicle(scene, best, best.account)
    agreeing: list[_Hypothesis] = []
    rivals: list[_Hypothesis] = []
    for one in hypotheses:
        if one is not best:
            (agreeing if _agree(scene, best, one) else rivals).append(one)
    # If its sender was seen, each candidate is as likely its vehicle; if not, one of them may still fit by chance.
    objects = 1 + len(candidates - set(best.account.tracks))
    _check_whole(scene, best, [one for one in rivals if one.value > math.log(objects)], track)
    claims = [(_margin(scene, best, one), one.account) for one in rivals]
    # A second sender with the same track is on the same vehicle, or one of the two is not what is seen.
    mine = set(best.account.tracks)
    claims += [
        (best.account.value - account.value, account)
        for account in best.accounts
        if account is not best.account and mine & set(account.tracks)
    ]
    margin, second = min(claims, key=lambda claim: claim[0], default=(math.inf, None))
    least = scene.settings.least_log_odds
    if second is not None and margin < least:
        tied = tie(scene, best.account, second, margin)
        raise MatchError(f"{tied}; needed are {math.exp(least):.0f} to 1{towing(scene)}")
    even, doubt = best.value - math.log(objects), ""
    needed = scene.settings.least_seen_log_odds - SILENT
    if even < needed:
        chance = by_chance(scene, best.account, objects, even)
        raise MatchError(f"{chance}; needed are {math.exp(needed):.0f} to 1{lingering(scene)}{towing(scene)}")
    # A result that nothing is said against must hold even if it is as likely as not that the sender was never seen.
    if second is not None and margin < min(even, scene.settings.clear_log_odds):
        doubt = tie(scene, best.account, second, margin)
    elif even < scene.settings.clear_log_odds:
        doubt = by_chance(scene, best.account, objects, even)
    return Choice(
        station=best.account.station,
        track=track,
        explained=best.account.explained,
        second=0.0 if second is None else second.explained,
        fit=PlanarMatch(float(best.motion.yaw_rad), best.motion.shift),
        time_offset_s=float(best.motion.offset_s),
        log_likelihood=best.value,
        log_likelihood_margin=margin,
        second_is="nothing else" if second is None else named(scene, best.account, second),
        doubt=doubt,
        others=_others(scene, best, agreeing),
    )


def _check_whole(scene: Scene, best: _Hypothesis, rivals: Sequence[_Hypothesis], track: Track) -> None:
    """Refuse a part of a drive whose other part fits the same messages, but by another motion.

    Raises
    ------
    MatchError
    """
    sender = scene.senders[best.account.station]
    for rival in rivals:
        other = _on_vehicle(scene, rival, rival.account)
        if rival.account.station != sender.station or not _goes_on(sender, track, other, best.motion):
            continue
        places = [one.place(other.centres) for one in (best, rival)]
        off_m = float(np.median(np.linalg.norm(places[0] - places[1], axis=1)))
        raise MatchError(
            f"the vehicle of station {sender.station} is seen in {len(track.usable)} frames, and in "
            f"{len(other.usable)} frames right before or after these, but by the latter its messages are {off_m:.1f} m "
            "elsewhere: are their positions where --cam-reference has them, and their headings those of the drive?"
        )


def _goes_on(sender: Sender, one: Track, other: Track, motion: Motion) -> bool:
    """Tell whether one track begins where and when the other ends, as one vehicle's does that was hidden in between.

    They are then no farther apart than the vehicle is long, and drives meanwhile: different parts of it may be seen.
    """
    if one.shares(other) or not len(other.usable):
        return False
    first, second = sorted((one, other), key=lambda track: track.sightings[0].stamp_s)
    begins = second.sightings[0]
    if abs(begins.stamp_s - first.sightings[-1].stamp_s) > max(unseen_s(one.stamps_s), unseen_s(other.stamps_s)):
        return False
    last = min(first.sightings, key=lambda seen: abs(seen.stamp_s - begins.stamp_s))
    stamps_s = np.array([last.stamp_s, begins.stamp_s])
    driven_m = float(np.ptp(sender.at(stamps_s + motion.offset_s).path_m))
    return float(np.linalg.norm(begins.middle - last.middle)) <= sender.length_m + driven_m


def _margin(scene: Scene, best: _Hypothesis, other: _Hypothesis) -> float:
    """Return the log odds between two hypotheses that say something else.

    If the other's vehicle is the sender's, the best one's may drive in line with it: on its way, at another time.
    """
    sender = scene.senders[other.account.station]
    way = sender.table[sender.known, :2]
    place = other.motion.place(scene.tracks[best.seed.track].centres)
    off = np.array([np.linalg.norm(way - at, axis=1).min() for at in place])
    if np.median(off) > HALF_LANE_M:
        return best.value - other.value
    return best.against_others - other.against_others


def _agree(scene: Scene, best: _Hypothesis, other: _Hypothesis) -> bool:
    """Tell whether two hypotheses say the same.

    They do where the best motion also puts the other's track onto its vehicle, or at least into it, and where both
    motions put what was seen to the same places: nearer to one another than two vehicles ever are.
    """
    if any(account.station == other.seed.station and other.seed.track in account.tracks for account in best.accounts):
        return True
    if other.seed.station == best.seed.station and _is_part(scene, best, other.seed.track):
        return True
    xy = np.concatenate([scene.tracks[one.seed.track].centres for one in (best, other)])
    apart = np.linalg.norm(best.place(xy) - other.place(xy), axis=1)
    return bool(apart.max() < scene.senders[best.seed.station].width_m)


def _is_part(scene: Scene, best: _Hypothesis, track: int) -> bool:
    """Tell whether a track is mostly where the vehicle itself is: nothing else can be there."""
    sender = scene.senders[best.seed.station]
    knots = scene.knots[(scene.knots.track == track) & scene.knots.usable]
    poses = sender.at(knots.stamp_s + best.motion.offset_s)
    inside = np.linalg.norm(best.motion.place(knots.xy) - poses.xy, axis=1) <= sender.reach_m
    return bool(inside[poses.known].mean() > 0.5) if poses.known.any() else False


def _on_vehicle(scene: Scene, best: _Hypothesis, account: Account) -> Track:
    """Return a sender's track without what cannot be its vehicle, such as what it was confused with at its ends."""
    track, sender = joined(scene, account), scene.senders[account.station]
    poses = sender.at(np.array([one.stamp_s for one in track.sightings]) + best.motion.offset_s)
    off = best.motion.place(np.array([one.middle for one in track.sightings])) - poses.xy
    sigma = np.hypot(scene.settings.position_sigma_m, [one.sigma_m for one in track.sightings])
    near = np.linalg.norm(off, axis=1) <= sender.reach_m + GATE * sigma
    return track.where(near | ~poses.known).without(best.strayed_s if account is best.account else ())


def unseen_s(stamps_s: FloatArray) -> float:
    """Return for how long something that was seen at some times, shape (n,), can be out of sight and count as seen.

    That is one missing frame at least.
    """
    return max(UNSEEN_S, bridged_s(stamps_s))


def _seen_path(scene: Scene, best: _Hypothesis, account: Account, track: Track) -> float:
    """Return how far a sender's vehicle drives while a track is seen, without what it drives meanwhile unseen.

    While it stays within its own reach, whatever stands there would do as well: that does not count either.
    """
    sender = scene.senders[account.station]
    stamps_s = np.array([one.stamp_s for one in track.usable])
    poses = sender.at(stamps_s + best.motion.offset_s)
    stretches = np.split(np.arange(len(stamps_s)), np.flatnonzero(np.diff(stamps_s) > unseen_s(stamps_s)) + 1)
    moving = [stretch for stretch in stretches if extent(poses.xy[stretch]) > sender.reach_m]
    return float(sum(np.ptp(poses.path_m[stretch]) for stretch in moving))


def _others(scene: Scene, best: _Hypothesis, agreeing: Sequence[_Hypothesis]) -> tuple[Other, ...]:
    """Return other senders that are as clearly seen: where a hypothesis has them, by themselves, or by other clocks.

    Those that agree with it may have the sensor up to a vehicle's width elsewhere, where it has nothing of them.
    """
    sure, others = [best.account], []
    # The last of these looks at what is sure when it is its turn.
    ways = chain(_by_one_motion(best), _by_themselves(best, agreeing), _by_other_clocks(scene, best, sure))
    for one, account, log_odds in ways:
        if any(account.station == each.station or set(account.tracks) & set(each.tracks) for each in sure):
            continue
        if log_odds < scene.settings.clear_log_odds or account.typical > MAX_GOOD_SIGMA:
            continue
        track = _on_vehicle(scene, one, account)
        if len(track.usable) and _seen_path(scene, one, account, track) >= scene.settings.min_path_m:
            sure.append(account)
            others.append(Other(account.station, track, one.late_s, alone=account is one.account))
    return tuple(others)


def _by_one_motion(best: _Hypothesis) -> Iterator[tuple[_Hypothesis, Account, float]]:
    """Yield what is where the other senders must be, and the log odds that it is theirs; each track once."""
    own, *others = best.accounts
    for account in _each_track_once(own, others):
        yield best, account, account.value + account.coincidence + SILENT


def _each_track_once(own: Account, others: Iterable[Account]) -> Iterator[Account]:
    """Yield the other senders' accounts, the likeliest first, but for those of tracks that are another's already."""
    claimed = set(own.tracks)
    for account in sorted(others, key=lambda one: -one.value):
        if claimed.isdisjoint(account.tracks):
            claimed |= set(account.tracks)
            yield account


def _by_themselves(best: _Hypothesis, agreeing: Sequence[_Hypothesis]) -> Iterator[tuple[_Hypothesis, Account, float]]:
    """Yield the same of what other senders' own motions show."""
    for one in sorted(agreeing, key=lambda one: -one.value):
        late_s = float(one.motion.offset_s - best.motion.offset_s)
        its = replace(one, late_s=late_s if abs(late_s) > BOXES_S else 0.0)
        yield its, one.account, one.value - one.by_others


def _by_other_clocks(
    scene: Scene, best: _Hypothesis, sure: Sequence[Account]
) -> Iterator[tuple[_Hypothesis, Account, float]]:
    """Yield the same of what is elsewhere on the ways of senders that are not sure."""
    for station, sender in scene.senders.items():
        if any(station == each.station for each in sure):
            continue
        taken = {track for each in sure for track in each.tracks}
        if (found := by_another_clock(scene, best.motion, sender, taken)) is not None:
            account, late_s = found
            motion = replace(best.motion, offset_s=best.motion.offset_s + late_s)
            its = replace(best, motion=motion, late_s=late_s)
            yield its, account, account.value + account.coincidence + SILENT


def _hypotheses(scene: Scene, seeds: Sequence[Seed]) -> list[_Hypothesis]:
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


def _judge(scene: Scene, seed: Seed) -> _Hypothesis | None:
    sender = scene.senders[seed.station]
    motion = seed.motion
    own = hold_against(scene, sender, motion)
    for _ in range(2):
        if not own.tracks:
            return None
        motion = refit(scene, sender, own.tracks, motion)
        own = hold_against(scene, sender, motion)
    if seed.track not in own.tracks or own.typical > MAX_GOOD_SIGMA:
        return None
    others = [hold_against(scene, other, motion) for other in scene.senders.values() if other is not sender]
    prior = -((float(motion.offset_s) / scene.settings.clock_sigma_s) ** 2) / 2
    by_others = sum(max(each.value + each.coincidence, -SILENT) for each in _each_track_once(own, others))
    value = prior + own.value + by_others
    return _Hypothesis(seed, motion, own, (own, *others), value, own.way, by_others=by_others)


def _check_motion(vehicles: Mapping[int, VehicleTrack], settings: MatchSettings) -> None:
    paths = {station: extent(vehicle.xy) for station, vehicle in vehicles.items()}
    station = max(paths, key=lambda key: paths[key])
    if paths[station] < settings.min_path_m:
        lasts_s = float(np.ptp(vehicles[station].stamps_s))
        raise TrackError(
            f"the vehicle of station {station} stands still, or hardly moves: {paths[station]:.2f} m in the "
            f"{lasts_s:.1f} s of its CAMs; needed are {settings.min_path_m:.1f} m"
        )
