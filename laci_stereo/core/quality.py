"""How far the paper's estimate can be trusted: its covariance and a verdict."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from laci_stereo.core.cam import VehicleTrack
from laci_stereo.core.frames import BoolArray, FloatArray, rotate_xy, wrap
from laci_stereo.core.matching import PlanarMatch, match_track
from laci_stereo.core.result import Quality, Verdict
from laci_stereo.core.settings import MatchSettings, QualitySettings
from laci_stereo.core.tracking import Track


@dataclass(frozen=True)
class Doubt:
    """One standard deviation of each thing that the paper's method estimates.

    Attributes
    ----------
    position_m : float
        Of the track as a whole, along each axis of the plane.
    yaw_rad : float
    spread_m : float
        Root of the mean squared distance of the track from its middle.
    """

    position_m: float
    yaw_rad: float
    spread_m: float

    @property
    def track_xy_m(self) -> float:
        """Root of the mean squared error in the plane along the track."""
        return float(np.sqrt(2 * self.position_m**2 + (self.yaw_rad * self.spread_m) ** 2))


def doubt_of(match: PlanarMatch, track: Track, vehicle: VehicleTrack, settings: MatchSettings) -> Doubt:
    """Estimate the errors of the paper's match.

    A sensor sees the near sides of a vehicle, so its boxes lack what faces away. The match is repeated with boxes that
    have grown away from the sensor to the vehicle's true size, and by how much that changes the result is its doubt.
    To this comes what then remains between the tracks. It changes as slowly as the side in view, so it is not averaged
    over frames; the yaw leans on the last point of the trace and on the mean of the others, each with that error.

    Parameters
    ----------
    match : PlanarMatch
    track : Track
    vehicle : VehicleTrack
    settings : MatchSettings
        Of the match.
    """
    xy_world, yaw_world, known = vehicle.at(track.stamps_s)
    xy_level, xy_world = track.centres[known], xy_world[known]
    grown = xy_level + _lacking(track, vehicle, wrap(yaw_world - match.yaw_rad))[known]
    regrown = match_track(grown, xy_world, settings)
    shifted = (match(grown) - regrown(grown)).mean(axis=0)
    remains = float(np.sqrt(((regrown(grown) - xy_world) ** 2).mean()))
    lengths = np.linalg.norm(xy_world[:-1] - xy_world[-1], axis=1)
    spread = float(np.sqrt(((xy_world - xy_world.mean(axis=0)) ** 2).sum(axis=1).mean()))
    return Doubt(
        position_m=float(np.hypot(remains, np.sqrt((shifted**2).mean()))),
        yaw_rad=float(
            np.hypot(wrap(regrown.yaw_rad - match.yaw_rad), np.sqrt(2) * remains / np.sqrt((lengths**2).mean()))
        ),
        spread_m=spread,
    )


def _lacking(track: Track, vehicle: VehicleTrack, yaw_level: FloatArray) -> FloatArray:
    """Return from the boxes' middles to those that they would have with the vehicle's true size, shape (n, 2)."""
    seen = track.usable
    sizes = np.array([(sighting.box.length_m, sighting.box.width_m) for sighting in seen])
    turned = np.array([sighting.box.yaw_rad for sighting in seen]) - yaw_level
    c, s = np.abs(np.cos(turned)), np.abs(np.sin(turned))
    extents = np.column_stack(
        [(sizes * np.column_stack([c, s])).sum(axis=1), (sizes * np.column_stack([s, c])).sum(axis=1)]
    )
    sight = rotate_xy(-yaw_level, track.centres / np.linalg.norm(track.centres, axis=1, keepdims=True))
    # Half of the points are on the near side, and the outermost of n lies at the quantile 1 / n.
    outermost = -ndtri(1 / np.array([max(sighting.count / 2, 2.0) for sighting in seen]))
    noise = 2 * outermost * np.array([sighting.sigma_m for sighting in seen])
    true = np.array([vehicle.length_m, vehicle.width_m])
    lacking = true - (extents - noise[:, None] * np.abs(sight)).clip(0.0, true)
    return rotate_xy(yaw_level, np.sign(sight) * lacking / 2)


def covariance_of(
    doubt: Doubt, ground_covariance: FloatArray, match: PlanarMatch, middle_level: FloatArray
) -> FloatArray:
    """Return the covariance of (rotation vector, translation) in the world, about the track's middle, shape (6, 6).

    Parameters
    ----------
    doubt : Doubt
    ground_covariance : ndarray, shape (3, 3)
        Of (rotation about level x, about level y, height), see `GroundPlane.covariance_level`.
    match : PlanarMatch
    middle_level : ndarray, shape (2,)
        The track's middle in the level frame; there the tilt moves the ground by (d x p)_z = d_x p_y - d_y p_x.
    """
    to_world = np.zeros((6, 3))
    to_world[:2, :2] = rotate_xy(match.yaw_rad, np.eye(2)).T
    to_world[5] = [middle_level[1], -middle_level[0], 1.0]
    covariance: FloatArray = to_world @ ground_covariance @ to_world.T
    covariance[2, 2] += doubt.yaw_rad**2
    covariance[3, 3] += doubt.position_m**2
    covariance[4, 4] += doubt.position_m**2
    return covariance


def judge(
    doubt: Doubt,
    ground_covariance: FloatArray,
    residual_rms_m: float,
    track: Track,
    known: BoolArray,
    settings: QualitySettings,
) -> Quality:
    """Hold the doubt against the thresholds.

    Parameters
    ----------
    doubt : Doubt
    ground_covariance : ndarray, shape (3, 3)
    residual_rms_m : float
    track : Track
    known : ndarray of bool, shape (n,)
        Of the track's usable sightings: the sender's position at that time is known.
    settings : QualitySettings
    """
    yaw_deg = float(np.degrees(doubt.yaw_rad))
    tilt_deg = float(np.degrees(np.sqrt(np.linalg.eigvalsh(ground_covariance[:2, :2])[-1])))
    height = float(np.sqrt(ground_covariance[2, 2]))
    checks = [
        ("position along the track", doubt.track_xy_m, "m", settings.max_sigma_m),
        ("yaw", yaw_deg, "deg", settings.max_sigma_deg),
        ("tilt", tilt_deg, "deg", settings.max_sigma_deg),
    ]
    reasons = tuple(
        f"{what} is known to {value:.3g} {unit}; the limit is {limit:.3g} {unit}"
        for what, value, unit, limit in checks
        if value > limit
    )
    worst = max(value / limit for _, value, _, limit in checks)
    verdict: Verdict = "pass" if worst <= 1 else "warn" if worst <= settings.fail_factor else "fail"
    left_out = dict(track.flaws())
    if not known.all():
        left_out["unknown"] = int((~known).sum())
    return Quality(
        verdict=verdict,
        reasons=reasons,
        track_xy_sigma_m=doubt.track_xy_m,
        yaw_sigma_deg=yaw_deg,
        tilt_sigma_deg=tilt_deg,
        height_sigma_m=height,
        residual_rms_m=residual_rms_m,
        frames_used=int(known.sum()),
        frames_seen=len(track.sightings),
        left_out=left_out,
    )
