"""Messages on why no track is certainly a sender's."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial import cKDTree

from laci_stereo.core.association.likelihood import MAX_GOOD_SIGMA, SIZE_SIGMA_M, Account, hold_against, joined
from laci_stereo.core.association.motion import Seed
from laci_stereo.core.association.scene import TABLE_S, Scene, extent
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.tracking.tracks import Track

COVERED_SHARE = 0.9
"""Fraction of the time from which a covered place counts as background, see `learn_background`: it is empty in no more
than a tenth of the frames."""

TURNED_RAD = np.radians(30.0)
"""A drive that turns by as much needs no further turn."""

EVEN_ODDS = 2.0
"""Up to these odds people call two things equally likely."""


MOST_LOG_ODDS = 9.0
"""Larger log odds are told as these: they say more of the model than of the scene."""


def two_digits(number: float) -> str:
    """Return a number of at least 1 to two significant digits, such as "2.5" or "8100"."""
    return f"{number:.1f}" if number < 9.95 else f"{float(f'{number:.2g}'):.0f}"


def odds(log_odds: float) -> str:
    """Return odds in words, such as "2.5 to 1" or "1 to 8100"."""
    size = two_digits(math.exp(min(abs(log_odds), MOST_LOG_ODDS)))
    return f"{size} to 1" if log_odds >= 0.0 else f"1 to {size}"


def shares(found: float, needed: float) -> tuple[str, str]:
    """Return two shares in per cent, with as many digits, up to two, as are needed to tell them apart."""
    told = [(f"{found:.{digits}%}", f"{needed:.{digits}%}") for digits in range(3)]
    return next((both for both in told if both[0] != both[1]), told[-1])


def named(scene: Scene, best: Account, second: Account) -> str:
    """Return the name of the second-best hypothesis."""
    if second.station != best.station:
        return f"station {second.station}"
    return f"another moving object, seen in {len(joined(scene, second).usable)} frames"


def tie(scene: Scene, best: Account, second: Account, margin: float) -> str:
    """Return the message that two hypotheses, whose log odds are ``margin``, fit nearly equally well."""
    frames = [len(joined(scene, account).usable) for account in (best, second)]
    what = (
        f"stations {best.station} and {second.station}"
        if second.station != best.station
        else f"two moving objects, seen in {frames[0]} and {frames[1]} frames,"
    )
    # Where one may drive in line with the other, the best hypothesis need not be the likelier of the two.
    margin = max(margin, 0.0)
    nearly = "" if math.exp(margin) < EVEN_ODDS else "nearly "
    well = f"{what} fit {nearly}equally well (odds of {odds(margin)})"
    if second.station != best.station and not set(best.tracks) & set(second.tracks):
        return (
            f"{well}, each with another vehicle, but no single pose of the sensor fits both: a clock may be off, and "
            "with it the result by either alone; record a drive with a turn"
        )
    name = "name the sender's station, or " if len(scene.senders) > 1 else ""
    return f"{well}: {name}record a drive with a turn or less traffic"


def by_chance(scene: Scene, best: Account, objects: int, log_odds: float) -> str:
    """Return the message that the object that fits may be a stranger, with the log odds that it is not."""
    track = joined(scene, best)
    poses = scene.senders[best.station].at(np.array([sighting.stamp_s for sighting in track.usable]))
    turns = np.ptp(poses.yaw_rad[poses.known]) > TURNED_RAD if poses.known.any() else False
    return (
        f"station {best.station} fits one of {objects} moving objects, seen in {len(track.usable)} frames, but that "
        f"may be by chance (odds of {odds(log_odds)} that it is its vehicle): record a longer drive"
        f"{', or one with less traffic' if turns else ', or one with a turn'}"
    )


def no_fit(scene: Scene, seeds: Sequence[Seed]) -> str:
    """Return the message that nothing fits, with how well the best candidate did."""
    best, least = max(seeds, key=lambda seed: seed.share), scene.settings.min_explained
    stations = ", ".join(str(station) for station in sorted(scene.senders))
    off = hold_against(scene, scene.senders[best.station], best.motion).typical
    within = f", {off:.1f} sigma off on average" if np.isfinite(off) else ""
    share, needed = shares(best.share, least)
    return (
        f"no moving object fits the CAMs: {share} of the frames of the best of {len(seeds)} explained"
        f"{within}; needed are {needed}, within {MAX_GOOD_SIGMA:.0f} sigma; not seen: station {stations}"
    )


def folding(vehicles: Mapping[int, VehicleTrack]) -> str:
    """Return words on vehicles that articulate in bends, where their messages cannot be used."""
    counts = {station: np.count_nonzero(vehicle.folded) for station, vehicle in sorted(vehicles.items())}
    return "".join(
        f"; station {station}'s, {vehicles[station].length_m:.1f} m long, articulates in bends, at {count} of "
        f"{len(vehicles[station].stamps_s)} messages, where it is no rigid outline: drive straight"
        for station, count in counts.items()
        if count
    )


def lingering(scene: Scene) -> str:
    """Return words on vehicles that hardly leave their own place, where they may be taken for the background."""
    seen_s = np.array([sighting.stamp_s for track in scene.tracks for sighting in track.sightings])
    times_s = np.arange(seen_s.min(), seen_s.max(), TABLE_S) if len(seen_s) else seen_s
    found = []
    for station, sender in sorted(scene.senders.items()):
        poses = sender.at(times_s)
        xy = poses.xy[poses.known]
        if not len(xy):
            continue
        near = cKDTree(xy).query_ball_point(xy, sender.length_m / 2, return_length=True)
        share = near.max() / len(xy)
        if share >= COVERED_SHARE:
            found.append(
                f"; station {station}'s, {sender.length_m:.1f} m long, occupies one place {share:.0%} of the "
                "time, and so may be taken for background: drive on by more than its length"
            )
    return "".join(found)


def towing(scene: Scene) -> str:
    """Return words if the object seen longest is longer than any sender's vehicle, such as a car with its trailer."""
    longest = max(scene.tracks, key=lambda track: len(track.usable), default=None)
    if longest is None or extent(longest.centres) < scene.settings.min_path_m:
        return ""
    told_m = max(sender.length_m for sender in scene.senders.values())
    lengths_m = np.array([[one.box.length_m, 5 * one.sigma_m] for one in longest.usable])
    if np.median(lengths_m[:, 0] - lengths_m[:, 1]) < told_m + SIZE_SIGMA_M:
        return ""
    return (
        f"; what was seen longest, in {len(longest.usable)} frames, is {np.median(lengths_m[:, 0]):.1f} m long, and no "
        f"sender reports more than {told_m:.1f} m: if it tows something, drive without that"
    )


def nothing_found(tracks: Sequence[Track], settings: MatchSettings) -> str:
    """Return the message that no track is long enough to be a vehicle's."""
    longest = max((len(track.usable) for track in tracks), default=0)
    widest = max((extent(track.centres) for track in tracks), default=0.0)
    flaws: Counter[str] = sum((track.flaws() for track in tracks), Counter())
    left_out = ", ".join(f"{count} {flaw}" for flaw, count in sorted(flaws.items())) or "none"
    return (
        f"no vehicle was found: {len(tracks)} moving objects, the longest seen in {longest} frames, the farthest "
        f"moving {widest:.1f} m (left out: {left_out}); needed is one that is seen in {settings.min_frames} frames "
        f"while its CAMs report its position, and moves {settings.min_path_m:.1f} m"
    )
