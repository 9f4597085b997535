"""Matching the vehicle's track in the sensor with its track in the world."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from laci_stereo.core.cam import VehicleTrack
from laci_stereo.core.errors import MatchError, TrackError
from laci_stereo.core.frames import FloatArray, rotate_xy
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.tracking import Track


@dataclass(frozen=True)
class PlanarMatch:
    """The transform from the level into the world frame: turn by yaw, then shift.

    Attributes
    ----------
    yaw_rad : float
    shift : ndarray, shape (2,)
        Metres, world.
    """

    yaw_rad: float
    shift: FloatArray

    def __call__(self, xy_level: FloatArray) -> FloatArray:
        """Map points on the ground plan, shape (n, 2), from level to world."""
        moved: FloatArray = rotate_xy(self.yaw_rad, xy_level) + self.shift
        return moved


def match_track(xy_level: FloatArray, xy_world: FloatArray, settings: MatchSettings | None = None) -> PlanarMatch:
    """Match two tracks point by point (paper section III-D).

    Yaw is the circular mean of the angles between the location vectors of both tracks relative to the last point,
    short vectors left out; the translation is the mean difference after rotation.

    Parameters
    ----------
    xy_level, xy_world : ndarray, shape (n, 2)
        The vehicle's centre at the same times, metres.
    settings : MatchSettings

    Raises
    ------
    MatchError
        If no point is far enough from the last one.
    """
    settings = settings or MatchSettings()
    vectors_level = xy_level[:-1] - xy_level[-1:]
    vectors_world = xy_world[:-1] - xy_world[-1:]
    lengths = np.minimum(np.linalg.norm(vectors_level, axis=1), np.linalg.norm(vectors_world, axis=1))
    long_enough = lengths >= settings.min_vector_m
    if not long_enough.any():
        raise MatchError(
            f"the vehicle is at most {lengths.max(initial=0.0):.1f} m away from its last position while it is seen; "
            f"needed are {settings.min_vector_m:.1f} m to tell the yaw"
        )
    angles = _angle(vectors_world[long_enough]) - _angle(vectors_level[long_enough])
    yaw = float(np.arctan2(np.sin(angles).mean(), np.cos(angles).mean()))
    return PlanarMatch(yaw, (xy_world - rotate_xy(yaw, xy_level)).mean(axis=0))


def _angle(vectors: FloatArray) -> FloatArray:
    return np.arctan2(vectors[:, 1], vectors[:, 0])


@dataclass(frozen=True)
class Choice:
    """The track that is the sender's.

    Attributes
    ----------
    station : int
    track : Track
    explained : float
        Of how many frames the fit accounts for, each counted by how well.
    second : float
        The same of the best other candidate.
    """

    station: int
    track: Track
    explained: float
    second: float


@dataclass(frozen=True)
class _Candidate:
    station: int
    track: Track
    fit: PlanarMatch
    explained: float
    frames: int

    @property
    def share(self) -> float:
        return self.explained / self.frames


def choose_track(
    tracks: Sequence[Track], vehicles: Mapping[int, VehicleTrack], settings: MatchSettings | None = None
) -> Choice:
    """Find which track is which sender's: the one that lies best on a vehicle's track in the world.

    Each pair is brought together by a rigid motion; a frame counts by 1 - (r / r_max)^2, where r is what remains and
    r_max is half of the vehicle's diagonal, because the centre of what is visible of a vehicle is no farther from its
    own. Fragments of the chosen track, torn apart by an occlusion, are joined to it; a track that its motion brings
    onto a vehicle as well is no rival.

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
    candidates = [
        candidate
        for station, vehicle in vehicles.items()
        for track in tracks
        if (candidate := _candidate(station, vehicle, track, settings)) is not None
    ]
    if not candidates:
        raise TrackError(_nothing_found(tracks, settings))
    candidates.sort(key=lambda candidate: candidate.explained, reverse=True)
    fitting = [candidate for candidate in candidates if candidate.share >= settings.min_explained]
    if not fitting:
        raise MatchError(
            f"no moving object fits the CAMs: {candidates[0].share:.0%} of the frames of the best of {len(candidates)} "
            f"explained; needed are {settings.min_explained:.0%}"
        )
    best, *others = fitting
    second = 0.0
    for other in others:
        joined = _join(best, other, vehicles, settings)
        if joined is not None:
            best = joined
        elif _agree(best, other, vehicles):
            continue
        elif other.explained > settings.clear_share * best.explained:
            raise MatchError(_tie(best, other))
        else:
            second = max(second, other.explained)
    return Choice(best.station, best.track, best.explained, second)


def _join(
    best: _Candidate, other: _Candidate, vehicles: Mapping[int, VehicleTrack], settings: MatchSettings
) -> _Candidate | None:
    """Return two fragments of one drive, torn apart by an occlusion, as one, if one motion fits both."""
    if best.station != other.station or not best.track.disjoint(other.track):
        return None
    joined = _candidate(best.station, vehicles[best.station], best.track.joined(other.track), settings)
    if joined is None or joined.explained < best.explained + settings.clear_share * other.explained:
        return None
    return joined


def _agree(best: _Candidate, other: _Candidate, vehicles: Mapping[int, VehicleTrack]) -> bool:
    """Tell whether the best motion also puts the other track onto its vehicle, and so both say the same.

    It is another part of the same vehicle, where nothing else can be, or another sender that is in view too. Two
    stations with one track agree as well, but one of them is not what is seen.
    """
    if best.station != other.station and best.track.shares(other.track):
        return False
    vehicle = vehicles[other.station]
    xy_world, _, known = vehicle.at(other.track.stamps_s)
    remains = np.linalg.norm(best.fit(other.track.centres) - xy_world, axis=1)[known]
    return bool(np.median(remains) < _reach(vehicle))


def _reach(vehicle: VehicleTrack) -> float:
    return float(np.hypot(vehicle.length_m, vehicle.width_m)) / 2


def _tie(best: _Candidate, other: _Candidate) -> str:
    what = (
        f"stations {best.station} and {other.station}"
        if other.station != best.station
        else f"two moving objects, seen in {len(best.track.usable)} and {len(other.track.usable)} frames,"
    )
    return (
        f"{what} fit equally well ({best.explained:.1f} and {other.explained:.1f} frames explained); "
        "needed is one that stands out: name the sender's station, or record a drive with a turn or less traffic"
    )


def _check_motion(vehicles: Mapping[int, VehicleTrack], settings: MatchSettings) -> None:
    paths = {station: _path(vehicle.xy) for station, vehicle in vehicles.items()}
    station = max(paths, key=lambda key: paths[key])
    if paths[station] < settings.min_path_m:
        raise TrackError(
            f"the vehicle of station {station} stands still: it moves {paths[station]:.2f} m according to its CAMs; "
            f"needed are {settings.min_path_m:.1f} m"
        )


def _path(xy: FloatArray) -> float:
    return float(np.linalg.norm(np.ptp(xy, axis=0))) if len(xy) else 0.0


def _nothing_found(tracks: Sequence[Track], settings: MatchSettings) -> str:
    longest = max((len(track.usable) for track in tracks), default=0)
    widest = max((_path(track.centres) for track in tracks), default=0.0)
    flaws: Counter[str] = sum((track.flaws() for track in tracks), Counter())
    left_out = ", ".join(f"{count} {flaw}" for flaw, count in sorted(flaws.items())) or "none"
    return (
        f"no vehicle was found: {len(tracks)} moving objects, the longest seen in {longest} frames, the farthest "
        f"moving {widest:.1f} m (left out: {left_out}); needed is one that is seen in {settings.min_frames} frames "
        f"while its CAMs tell its position, and moves {settings.min_path_m:.1f} m"
    )


def _candidate(station: int, vehicle: VehicleTrack, track: Track, settings: MatchSettings) -> _Candidate | None:
    xy_world, _, known = vehicle.at(track.stamps_s)
    level, world = track.centres[known], xy_world[known]
    if len(level) < settings.min_frames or min(_path(level), _path(world)) < settings.min_path_m:
        return None
    weight = np.ones(len(level))
    for _ in range(5):
        fit = _rigid_fit(level, world, weight)
        remains = np.linalg.norm(fit(level) - world, axis=1) / _reach(vehicle)
        weight = np.maximum(1 - remains**2, 1e-3)
    return _Candidate(station, track, fit, float(np.maximum(1 - remains**2, 0).sum()), len(level))


def _rigid_fit(level: FloatArray, world: FloatArray, weight: FloatArray) -> PlanarMatch:
    """Return the least-squares rigid motion in the plane."""
    middle_level = np.average(level, axis=0, weights=weight)
    middle_world = np.average(world, axis=0, weights=weight)
    a, b = level - middle_level, world - middle_world
    dot = (weight * (a * b).sum(axis=1)).sum()
    cross = (weight * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])).sum()
    yaw = float(np.arctan2(cross, dot))
    return PlanarMatch(yaw, middle_world - rotate_xy(yaw, middle_level))
