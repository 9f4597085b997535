"""The uncertainty of an estimate: its covariance, the direction in which it is weakest, and a verdict."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.special import ndtri

from laci_stereo.core.estimation.joint import JointFit
from laci_stereo.core.frames import BoolArray, FloatArray, rotate_xy, wrap
from laci_stereo.core.matching import PlanarMatch, match_track
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.result import Quality, Verdict
from laci_stereo.core.settings import MatchSettings, QualitySettings
from laci_stereo.core.tracking.tracks import Track


@dataclass(frozen=True)
class Uncertainty:
    """The uncertainty of a transform in the plane.

    Attributes
    ----------
    covariance : ndarray, shape (3, 3)
        Covariance of (yaw [rad], x, y [m]) in the world frame, about the track's middle.
    arms : ndarray, shape (n, 2)
        Vectors from the track's middle to its points, world frame, metres.
    """

    covariance: FloatArray
    arms: FloatArray

    @property
    def yaw_rad(self) -> float:
        """Standard deviation of the yaw."""
        return float(np.sqrt(self.covariance[0, 0]))

    @cached_property
    def along_track(self) -> FloatArray:
        """Covariance of an object's position in the world, averaged over the track, shape (2, 2)."""
        by = np.zeros((len(self.arms), 2, 3))
        by[:, 0, 0], by[:, 1, 0] = -self.arms[:, 1], self.arms[:, 0]
        by[:, 0, 1] = by[:, 1, 2] = 1.0
        mean: FloatArray = (by @ self.covariance @ by.transpose(0, 2, 1)).mean(axis=0)
        return mean

    @property
    def track_xy_m(self) -> float:
        """Root mean square error of positions in the plane along the track."""
        return float(np.sqrt(np.trace(self.along_track)))

    @property
    def weakest(self) -> tuple[float, float]:
        """The direction in which an object's position is least known: its standard deviation, metres, and yaw, rad."""
        values, vectors = np.linalg.eigh(self.along_track)
        return float(np.sqrt(values[-1])), float(np.arctan2(vectors[1, -1], vectors[0, -1]))


@dataclass(frozen=True)
class Placement:
    """An estimate of where the level frame is in the world frame.

    Attributes
    ----------
    fit : JointFit
        By the paper's method its clock offset is 0, and it has no corrections.
    uncertainty : Uncertainty
        Its uncertainty, of which a part is not in the fit's covariance.
    left_out : dict of str to int
        Numbers of frames that were not used, by reason.
    remarks : tuple of str
        Other findings.
    advice : str
        Which drive would improve the weakest direction.
    contradictions : tuple of str
        Objections: what the points contradict in the messages or in what was stated about them, either of which may be
        wrong.
    """

    fit: JointFit
    uncertainty: Uncertainty
    left_out: dict[str, int] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    advice: str = ""
    contradictions: tuple[str, ...] = ()


def uncertainty_by_paper(
    match: PlanarMatch, track: Track, vehicle: VehicleTrack, used: BoolArray, settings: MatchSettings
) -> Uncertainty:
    """Estimate the uncertainty of the paper's match.

    A sensor sees the near sides of a vehicle, so that its boxes lack the sides that face away. The match is repeated
    with boxes that were enlarged away from the sensor to the vehicle's true size; the change of the result is the first
    part of the uncertainty. The second part is the remaining difference between the tracks. It changes as slowly as the
    visible side, so that it is not averaged over frames; the yaw depends on the last point of the trace and on the mean
    of the others, each with that error.

    Parameters
    ----------
    match : PlanarMatch
    track : Track
    vehicle : VehicleTrack
    used : ndarray of bool, shape (n,)
        Which of the track's usable sightings were matched.
    settings : MatchSettings
        Settings of the match.
    """
    xy_world, yaw_world, _ = vehicle.at(track.stamps_s)
    xy_level, xy_world = track.centres[used], xy_world[used]
    grown = xy_level + _lacking(track, vehicle, wrap(yaw_world - match.yaw_rad))[used]
    regrown = match_track(grown, xy_world, settings)
    shifted = (match(grown) - regrown(grown)).mean(axis=0)
    remains = float(np.sqrt(((regrown(grown) - xy_world) ** 2).mean()))
    lengths = np.linalg.norm(xy_world[:-1] - xy_world[-1], axis=1)
    position = float(np.hypot(remains, np.sqrt((shifted**2).mean())))
    yaw = float(np.hypot(wrap(regrown.yaw_rad - match.yaw_rad), np.sqrt(2) * remains / np.sqrt((lengths**2).mean())))
    return Uncertainty(np.diag([yaw, position, position]) ** 2, xy_world - xy_world.mean(axis=0))


def _lacking(track: Track, vehicle: VehicleTrack, yaw_level: FloatArray) -> FloatArray:
    """Return the vectors from the boxes' middles to those of boxes of the true size, level frame, shape (n, 2)."""
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
    uncertainty: Uncertainty, ground_covariance: FloatArray, match: PlanarMatch, middle_level: FloatArray
) -> FloatArray:
    """Return the covariance of (rotation vector, translation) in the world, about the track's middle, shape (6, 6).

    Parameters
    ----------
    uncertainty : Uncertainty
    ground_covariance : ndarray, shape (3, 3)
        Of (rotation about level x, about level y, height), see `GroundPlane.covariance_level`.
    match : PlanarMatch
    middle_level : ndarray, shape (2,)
        The track's middle in the level frame, at which a tilt d moves the ground by (d x p)_z = d_x p_y - d_y p_x.
    """
    to_world = np.zeros((6, 3))
    to_world[:2, :2] = rotate_xy(match.yaw_rad, np.eye(2)).T
    to_world[5] = [middle_level[1], -middle_level[0], 1.0]
    covariance: FloatArray = to_world @ ground_covariance @ to_world.T
    covariance[2:5, 2:5] += uncertainty.covariance
    return covariance


def judge(placement: Placement, ground_covariance: FloatArray, frames_seen: int, settings: QualitySettings) -> Quality:
    """Compare the uncertainty with the thresholds, and return the verdict with the values it is based on.

    Parameters
    ----------
    placement : Placement
    ground_covariance : ndarray, shape (3, 3)
    frames_seen : int
        Number of frames in which the vehicles were seen.
    settings : QualitySettings
    """
    uncertainty = placement.uncertainty
    yaw_deg = float(np.degrees(uncertainty.yaw_rad))
    tilt_deg = float(np.degrees(np.sqrt(np.linalg.eigvalsh(ground_covariance[:2, :2])[-1])))
    height = float(np.sqrt(ground_covariance[2, 2]))
    checks = [
        ("position along the track", uncertainty.track_xy_m, "m", settings.max_sigma_m),
        ("yaw", yaw_deg, "deg", settings.max_sigma_deg),
        ("tilt", tilt_deg, "deg", 2.0 * settings.max_sigma_deg),
    ]
    reasons = tuple(
        f"{what} is known to {_beyond(value, limit)} {unit}; the limit is {limit:.3g} {unit}"
        for what, value, unit, limit in checks
        if value > limit
    )
    worst = max(value / limit for _, value, _, limit in checks)
    reasons += placement.contradictions
    verdict: Verdict = "pass" if worst <= 1 and not reasons else "warn" if worst <= settings.fail_factor else "fail"
    weakest_m, weakest_rad = uncertainty.weakest
    return Quality(
        verdict=verdict,
        reasons=reasons,
        track_xy_sigma_m=uncertainty.track_xy_m,
        weakest_sigma_m=weakest_m,
        weakest_yaw_deg=float(np.degrees(weakest_rad)) % 180.0,
        advice=placement.advice,
        yaw_sigma_deg=yaw_deg,
        tilt_sigma_deg=tilt_deg,
        height_sigma_m=height,
        residual_rms_m=placement.fit.residual_rms_m,
        frames_used=placement.fit.frames,
        frames_seen=frames_seen,
        left_out=placement.left_out,
    )


def _beyond(value: float, limit: float) -> str:
    """Format a number beyond a limit with as many digits as are needed to distinguish it from the limit."""
    return next(told for digits in range(3, 18) if (told := f"{value:.{digits}g}") != f"{limit:.{digits}g}")
