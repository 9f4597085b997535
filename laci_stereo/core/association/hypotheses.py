"""Association: which of all moving objects is a sender's vehicle.

A hypothesis is one rigid motion from the level frame into the world frame, with one clock offset. It holds for all
stations at once and is judged by its log-likelihood: an object where a sender must be supports it, the more so the less
probable that is by chance; a sender that must be in view but is not seen counts against it. Successive frames are not
independent, because the visible part of a vehicle changes only as it moves, so all evidence is counted per metre of its
path. A stranger is any object that is not the vehicle of the sender in question.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from laci_stereo.core.association.choice import Choice, Likeness, Other, no_likeness
from laci_stereo.core.association.late_senders import by_another_clock
from laci_stereo.core.association.likelihood import MAX_GOOD_SIGMA, Account, hold_against, joined
from laci_stereo.core.association.meetings import meeting_seeds
from laci_stereo.core.association.motion import Motion, Seed, find_seeds, refit
from laci_stereo.core.association.scene import Scene, Sender, extent, lay_out
from laci_stereo.core.association.words import (
    by_chance,
    folding,
    lingering,
    named,
    no_fit,
    nothing_found,
    odds,
    tie,
    towing,
)
from laci_stereo.core.errors import MatchError, TrackError
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.settings import MatchSettings, with_turn
from laci_stereo.core.tracking.tracks import GATE, Times, Track, bridged_s

log = logging.getLogger(__name__)

SILENT = -math.log(0.05)
"""Largest log-likelihood penalty for another sender that is not seen: one sender in twenty is no vehicle that a sensor
detects.

This is also the prior probability that none of the tracks is the sender's vehicle."""

IN_LINE = math.log(10.0)
"""One other vehicle in ten drives in line with the sender's, on its path and at its speed. When such a vehicle is the
alternative, path evidence from outlines counts no further than these log odds, or than that from boxes if it is
larger."""

UNSEEN_S = 1.0
"""After being out of sight for this long, an object may be a different one when it is seen again."""

HALF_LANE_M = 1.75
"""A vehicle that drives in line with the sender's is no farther than this from the sender's path."""

OUTLINE_REACH = 10.0
"""Log odds by which outlines can change the order of two hypotheses: two contradictions of the leading one, each of
which one sender in fifty may cause by a mistake, and the other one's gain."""

BOXES_S = 0.1
"""Boxes do not distinguish clock offsets that are closer than this: box positions err by decimetres, and vehicles drive
at several metres per second."""

MOST_OUTLINES = 8
"""Largest number of hypotheses that are compared with the outlines: there are always more, far less likely ones."""


@dataclass(frozen=True)
class _Hypothesis:
    seed: Seed
    motion: Motion
    accounts: tuple[Account, ...]
    value: float
    way: float
    by_others: float
    strayed_s: Times = ()
    fit: PlanarMatch | None = None
    late_s: float = 0.0

    @property
    def account(self) -> Account:
        """The evidence about the seed's station; that about the other stations follows it."""
        return self.accounts[0]

    def place(self, xy_level: FloatArray) -> FloatArray:
        """Map points, shape (n, 2), from the level to the world frame, by the outline's fit where there is one."""
        return self.motion.place(xy_level) if self.fit is None else self.fit(xy_level)

    @property
    def against_others(self) -> float:
        """The log odds without the evidence that a vehicle in line with the sender's could have as well."""
        return self.value - max(0.0, self.way - max(self.account.way, IN_LINE))


def choose_track(
    tracks: Sequence[Track],
    vehicles: Mapping[int, VehicleTrack],
    settings: MatchSettings | None = None,
    likeness: Likeness = no_likeness,
) -> Choice:
    """Find which track belongs to which sender: the one whose motion and body are most likely those of its vehicle.

    Each pair of a track and a station yields a rigid motion and a clock offset. Each of these hypotheses is then
    compared with everything that was seen, and all tracks that it places on the vehicle are joined.

    Parameters
    ----------
    tracks : sequence of Track
    vehicles : mapping of int to VehicleTrack
        By station.
    settings : MatchSettings
    likeness : callable
        Compares outlines; called for the few hypotheses whose motion is likely enough.

    Raises
    ------
    TrackError
        If no sender moves during the recording or while it is seen, or no track is long enough.
    MatchError
        If no track fits any sender, or two fit equally well.
    """
    settings = settings or MatchSettings()
    turn_s = max((track.turn_s for track in tracks), default=0.0)
    settings = replace(settings, clock_sigma_s=with_turn(settings.clock_sigma_s, turn_s))
    _check_motion(vehicles, settings)
    scene = lay_out(tracks, vehicles, settings)
    seeds = find_seeds(scene)
    if not seeds:
        raise TrackError(nothing_found(tracks, settings) + folding(vehicles) + lingering(scene))
    hypotheses = _hypotheses(scene, [*meeting_seeds(scene, seeds), *seeds])
    if not hypotheses:
        raise MatchError(no_fit(scene, seeds) + folding(vehicles) + lingering(scene) + towing(scene))
    far = {seed.track for seed in seeds if extent(tracks[seed.track].centres) >= settings.min_path_m}
    weighed = _weighed(scene, _of_moving(scene, hypotheses, vehicles), vehicles, likeness)
    return _decide(scene, _of_moving(scene, weighed, vehicles), far)


def _of_moving(
    scene: Scene, hypotheses: Sequence[_Hypothesis], vehicles: Mapping[int, VehicleTrack]
) -> list[_Hypothesis]:
    """Return the hypotheses whose vehicle moves while it is seen: a stationary object would fit the others as well."""
    least_m = scene.settings.min_path_m
    paths_m = [_seen_path(scene, one, one.account, _on_vehicle(scene, one, one.account)) for one in hypotheses]
    moving = [one for one, path_m in zip(hypotheses, paths_m, strict=True) if path_m >= least_m]
    if not moving:
        path_m, best = max(zip(paths_m, hypotheses, strict=True), key=lambda each: each[1].value)
        raise TrackError(
            f"the vehicle of station {best.account.station} moves {path_m:.1f} m while it is seen; needed are "
            f"{least_m:.1f} m{folding(vehicles)}"
        )
    return moving


def _weighed(
    scene: Scene, hypotheses: Sequence[_Hypothesis], vehicles: Mapping[int, VehicleTrack], likeness: Likeness
) -> list[_Hypothesis]:
    """Add the outlines' evidence, whose paths are more exact than the boxes', to the hypotheses it could decide."""
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
    """Return the largest log odds that the path of a track joined from pieces can contribute.

    Each further piece may be another object that is, however improbably, where the vehicle must be.
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
    # If the sender was seen, each candidate is equally likely its vehicle; if not, one of them may still fit by chance.
    objects = 1 + len(candidates - set(best.account.tracks))
    _check_whole(scene, best, [one for one in rivals if one.value > math.log(objects)], track)
    claims = [(_margin(scene, best, one), one.account) for one in rivals]
    # A second sender with the same track is on the same vehicle, or the track belongs to only one of the two.
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
        raise MatchError(f"{tied}; needed are {odds(least)}{towing(scene)}")
    even, objection = best.value - math.log(objects), ""
    needed = scene.settings.least_seen_log_odds - SILENT
    if even < needed:
        chance = by_chance(scene, best.account, objects, even)
        raise MatchError(f"{chance}; needed are {odds(needed)}{lingering(scene)}{towing(scene)}")
    # A result without any objection must hold even at prior odds of one to one that the sender was seen at all.
    if second is not None and margin < min(even, scene.settings.clear_log_odds):
        objection = tie(scene, best.account, second, margin)
    elif even < scene.settings.clear_log_odds:
        objection = by_chance(scene, best.account, objects, even)
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
        by_chance=objection,
        others=_others(scene, best, agreeing),
    )


def _check_whole(scene: Scene, best: _Hypothesis, rivals: Sequence[_Hypothesis], track: Track) -> None:
    """Refuse one part of a drive if the other part fits the same messages, but by another motion.

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
    """Return whether one track begins where and when the other ends, like those of one vehicle hidden in between.

    The ends are then no farther apart than the vehicle's length, as different parts of it may be visible, plus the
    distance that it drives meanwhile.
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
    """Return the log odds between two contradictory hypotheses.

    If the other one's vehicle is the sender's, the best one's may drive in line with it: on its path, at another time.
    """
    sender = scene.senders[other.account.station]
    way = sender.table[sender.known, :2]
    place = other.motion.place(scene.tracks[best.seed.track].centres)
    off = np.array([np.linalg.norm(way - at, axis=1).min() for at in place])
    if np.median(off) > HALF_LANE_M:
        return best.value - other.value
    return best.against_others - other.against_others


def _agree(scene: Scene, best: _Hypothesis, other: _Hypothesis) -> bool:
    """Return whether two hypotheses are compatible.

    They are if the best motion also places the other's track onto that sender's vehicle, if that track lies inside the
    best one's vehicle, or if both motions map the sightings to the same places: nearer to one another than two vehicles
    ever are.
    """
    if any(account.station == other.seed.station and other.seed.track in account.tracks for account in best.accounts):
        return True
    if other.seed.station == best.seed.station and _is_part(scene, best, other.seed.track):
        return True
    xy = np.concatenate([scene.tracks[one.seed.track].centres for one in (best, other)])
    apart = np.linalg.norm(best.place(xy) - other.place(xy), axis=1)
    return bool(apart.max() < scene.senders[best.seed.station].width_m)


def _is_part(scene: Scene, best: _Hypothesis, track: int) -> bool:
    """Return whether a track is mostly where the best hypothesis has the vehicle: no other object can be there."""
    sender = scene.senders[best.seed.station]
    knots = scene.knots[(scene.knots.track == track) & scene.knots.usable]
    poses = sender.at(knots.stamp_s + best.motion.offset_s)
    inside = np.linalg.norm(best.motion.place(knots.xy) - poses.xy, axis=1) <= sender.reach_m
    return bool(inside[poses.known].mean() > 0.5) if poses.known.any() else False


def _on_vehicle(scene: Scene, best: _Hypothesis, account: Account) -> Track:
    """Return a sender's track without what cannot be its vehicle, such as objects it was confused with at its ends."""
    track, sender = joined(scene, account), scene.senders[account.station]
    poses = sender.at(np.array([one.stamp_s for one in track.sightings]) + best.motion.offset_s)
    off = best.motion.place(np.array([one.middle for one in track.sightings])) - poses.xy
    sigma = np.hypot(scene.settings.position_sigma_m, [one.sigma_m for one in track.sightings])
    near = np.linalg.norm(off, axis=1) <= sender.reach_m + GATE * sigma
    return track.where(near | ~poses.known).without(best.strayed_s if account is best.account else ())


def unseen_s(stamps_s: FloatArray) -> float:
    """Return for how long an object seen at some times, shape (n,), may be out of sight and still count as seen.

    That is at least one missing frame.
    """
    return max(UNSEEN_S, bridged_s(stamps_s))


def _seen_path(scene: Scene, best: _Hypothesis, account: Account, track: Track) -> float:
    """Return the distance that a sender's vehicle drives while its track is seen, without its drive while unseen.

    Stretches that stay within the vehicle's own reach do not count either: any stationary object would fit them as
    well.
    """
    sender = scene.senders[account.station]
    stamps_s = np.array([one.stamp_s for one in track.usable])
    poses = sender.at(stamps_s + best.motion.offset_s)
    stretches = np.split(np.arange(len(stamps_s)), np.flatnonzero(np.diff(stamps_s) > unseen_s(stamps_s)) + 1)
    moving = [stretch for stretch in stretches if extent(poses.xy[stretch]) > sender.reach_m]
    return float(sum(np.ptp(poses.path_m[stretch]) for stretch in moving))


def _others(scene: Scene, best: _Hypothesis, agreeing: Sequence[_Hypothesis]) -> tuple[Other, ...]:
    """Return other senders that are equally clearly seen: by the best motion, by their own motions, or by other clocks.

    A motion of their own that is compatible with the best one may place the sensor up to a vehicle's width elsewhere,
    and may so find a vehicle where the best motion has none.
    """
    sure, others = [best.account], []
    # The last generator reads `sure` only when its turn comes.
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
    """Yield other senders' accounts by the best motion, each track once, with the log odds that these are theirs."""
    own, *others = best.accounts
    for account in _each_track_once(own, others):
        yield best, account, account.value + account.coincidence + SILENT


def _each_track_once(own: Account, others: Iterable[Account]) -> Iterator[Account]:
    """Yield the other senders' accounts, the likeliest first, except those whose tracks a likelier one has claimed."""
    claimed = set(own.tracks)
    for account in sorted(others, key=lambda one: -one.value):
        if claimed.isdisjoint(account.tracks):
            claimed |= set(account.tracks)
            yield account


def _by_themselves(best: _Hypothesis, agreeing: Sequence[_Hypothesis]) -> Iterator[tuple[_Hypothesis, Account, float]]:
    """Yield the accounts of other senders by motions of their own, likewise with their log odds."""
    for one in sorted(agreeing, key=lambda one: -one.value):
        late_s = float(one.motion.offset_s - best.motion.offset_s)
        yield replace(one, late_s=late_s if abs(late_s) > BOXES_S else 0.0), one.account, one.value - one.by_others


def _by_other_clocks(
    scene: Scene, best: _Hypothesis, sure: Sequence[Account]
) -> Iterator[tuple[_Hypothesis, Account, float]]:
    """Yield the accounts of senders that are not yet sure by other clock offsets, likewise with their log odds."""
    for station, sender in scene.senders.items():
        if any(station == each.station for each in sure):
            continue
        taken = {track for each in sure for track in each.tracks}
        if (found := by_another_clock(scene, best.motion, sender, taken)) is not None:
            account, late_s = found
            motion = replace(best.motion, offset_s=best.motion.offset_s + late_s)
            yield replace(best, motion=motion, late_s=late_s), account, account.value + account.coincidence + SILENT


def _hypotheses(scene: Scene, seeds: Sequence[Seed]) -> list[_Hypothesis]:
    """Compare the seeds with the whole scene; a seed that a better one's hypothesis includes is skipped."""
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
    # By the track alone a clock offset that is common to two would get lost again.
    for _ in range(0 if seed.meeting else 2):
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
    return _Hypothesis(seed, motion, (own, *others), value, own.way, by_others)


def _check_motion(vehicles: Mapping[int, VehicleTrack], settings: MatchSettings) -> None:
    paths = {station: extent(vehicle.xy) for station, vehicle in vehicles.items()}
    station = max(paths, key=lambda key: paths[key])
    if paths[station] < settings.min_path_m:
        lasts_s = float(np.ptp(vehicles[station].stamps_s))
        raise TrackError(
            f"the vehicle of station {station} stands still, or hardly moves: {paths[station]:.2f} m in the "
            f"{lasts_s:.1f} s of its CAMs; needed are {settings.min_path_m:.1f} m"
        )
