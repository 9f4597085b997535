"""Whether the halves of a drive contradict each other: the sensor was moved, or the errors of the messages changed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from laci_stereo.core.errors import MatchError
from laci_stereo.core.estimation.evidence import evidence_of
from laci_stereo.core.estimation.joint import HELD_ROWS, JointFit, fit_jointly
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.frames import FloatArray, wrap
from laci_stereo.core.settings import SYNCHRONISED_S, Settings
from laci_stereo.core.tracking.sighting import Sighting
from laci_stereo.core.tracking.tracks import Track

SURELY = 5.0
"""Mahalanobis distance in three dimensions by which the halves may differ: of 60 000 drives without a fault, one
exceeds it. Errors that both halves share, such as the clock offset, are included in both covariances, so that even
fewer do."""


@dataclass(frozen=True)
class Difference:
    """The difference between the sensor's poses by the second and the first half of a drive.

    Attributes
    ----------
    off : ndarray, shape (3,)
        Difference in yaw [rad], and in x and y of the world frame at the middle of the vehicle's points [m].
    sigmas : float
        The same in standard deviations (Mahalanobis distance).
    since_s : float
        Time in the recording at which the second half begins.
    """

    off: FloatArray
    sigmas: float
    since_s: float

    def __str__(self) -> str:
        turn_deg, shift_m = np.degrees(abs(self.off[0])), float(np.hypot(*self.off[1:]))
        return (
            f"what is seen before and after {self.since_s:.1f} s in the recording differs by {turn_deg:.2f} deg and "
            f"{shift_m:.2f} m ({self.sigmas:.1f} sigma): the sensor was moved meanwhile, or one half of the messages "
            "is wrong"
        )


def compare_halves(own: Passage, fit: JointFit, settings: Settings) -> Difference | None:
    """Compare the separate estimates of a drive's halves; None where they agree, or one has too few frames.

    Parameters
    ----------
    own : Passage
    fit : JointFit
        Of the whole drive.
    settings : Settings
    """
    sightings = own.track.sightings
    middle = len(sightings) // 2
    try:
        first, second = (_alone(own, part, fit) for part in (sightings[:middle], sightings[middle:]))
    except MatchError:
        return None
    if min(first.frames, second.frames) < settings.match.min_frames:
        return None
    place = fit.centre_level[None]
    off = np.array(
        [wrap(second.match.yaw_rad - first.match.yaw_rad), *(second.match(place) - first.match(place))[0]],
        dtype=np.float64,
    )
    covariance = first.covariance_about(fit.centre_level) + second.covariance_about(fit.centre_level)
    sigmas = float(np.sqrt(off @ np.linalg.solve(covariance, off)))
    return Difference(off, sigmas, sightings[middle].stamp_s) if sigmas > SURELY else None


def with_difference(fit: JointFit, difference: Difference) -> JointFit:
    """Return a fit whose covariance includes its halves' difference: it lies between them, and either may be right."""
    return replace(fit, covariance=fit.covariance + np.outer(difference.off, difference.off) / 4.0)


def _alone(own: Passage, sightings: Sequence[Sighting], fit: JointFit) -> JointFit:
    """Fit a half of a drive with the priors of the whole, which allow for any mistakes found in it.

    Clocks that were never set are those of the whole drive: a half at constant speed would not determine them.
    """
    vehicle, offset_s, settings = own.vehicle, fit.time_offsets_s[0], fit.settings
    if settings.clock_sigma_s > SYNCHRONISED_S:
        vehicle, offset_s = replace(vehicle, stamps_s=vehicle.stamps_s - offset_s), 0.0
        settings = replace(settings, clock_sigma_s=max(SYNCHRONISED_S, fit.time_sigmas_s[0]))
    drive = evidence_of(Track(tuple(sightings)), vehicle, own.ground.height_m).thinned(HELD_ROWS)
    return fit_jointly([drive], fit.match, [offset_s], settings, close=True, mistakes=False)
