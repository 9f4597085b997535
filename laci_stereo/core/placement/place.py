"""The placement by a joint fit: whether it can be used, its uncertainty, and the objections to it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from laci_stereo.core.association.words import shares
from laci_stereo.core.errors import MatchError, OpenError
from laci_stereo.core.estimation.evidence import Evidence
from laci_stereo.core.estimation.joint import JointFit
from laci_stereo.core.frames import rotate_xy
from laci_stereo.core.placement.advice import advice, reported_sigma_m
from laci_stereo.core.placement.findings import against_messages, against_sensor, remarks_on
from laci_stereo.core.placement.seen_length import seen_lengths, with_uncertainty_along
from laci_stereo.core.quality import Placement, Uncertainty
from laci_stereo.core.settings import Settings
from laci_stereo.core.vehicle import outline

LEAST_EXPLAINED = 0.5
"""Least fraction of the points that the outline must explain; below it something else was registered."""


def place(
    fit: JointFit, drives: Sequence[Evidence], sightings: int, settings: Settings, names: Sequence[str] = ("",)
) -> Placement:
    """Return a joint fit with its uncertainty, and with what in the messages contradicts it.

    Parameters
    ----------
    fit : JointFit
    drives : sequence of Evidence
        Those of the fit.
    sightings : int
        Number of frames of all drives in which the vehicle was seen.
    settings : Settings
    names : sequence of str
        Names of the drives, for messages.

    Raises
    ------
    MatchError
        If too few frames show anything of the outline, or if it explains too few of the points.
    OpenError
        If the drives leave a direction open.
    """
    check_registered(fit, drives, settings)
    middles = np.concatenate([drive.middles for drive in drives])
    arms = rotate_xy(fit.match.yaw_rad, middles - fit.centre_level)
    weakest_m, _ = Uncertainty(fit.covariance, arms).weakest
    most_m = max(settings.quality.open_m, 3.0 * min(reported_sigma_m(drive.vehicle) for drive in drives))
    if weakest_m > most_m:
        raise OpenError(
            f"the position along the weakest direction is known to {weakest_m:.2f} m; needed are {most_m:.2f} m: "
            f"{advice(fit, Uncertainty(fit.covariance, arms), drives[0])}"
        )
    lengths = seen_lengths(fit, drives)
    fit = with_uncertainty_along(fit, drives, lengths)
    covariance = fit.covariance.copy()
    covariance[1:, 1:] += fit.covariance_by_optics(middles)
    uncertainty = Uncertainty(covariance, arms)
    known = sum(
        int(drive.vehicle.at(drive.stamps_s + offset_s)[2].sum())
        for drive, offset_s in zip(drives, fit.time_offsets_s, strict=True)
    )
    bare = max(0, known - fit.standing - fit.frames)
    left_out = {"unknown": sightings - known, "standing": fit.standing, "bare": bare}
    return Placement(
        fit=fit,
        uncertainty=uncertainty,
        left_out={reason: count for reason, count in left_out.items() if count},
        remarks=tuple(remarks_on(fit, drives, names, settings.joint)),
        advice=advice(fit, uncertainty, drives[0], min(each.lacking_m for each in lengths)),
        contradictions=(*against_messages(fit, drives, lengths, names), *against_sensor(fit, settings.joint)),
    )


def check_registered(fit: JointFit, drives: Sequence[Evidence], settings: Settings) -> None:
    """Raise `MatchError` if too few frames show anything of the outline, or if it explains too few of the points."""
    if fit.frames < settings.match.min_frames:
        raise MatchError(
            f"the vehicle's outline is seen in {fit.frames} frames while its CAMs report its position; needed are "
            f"{settings.match.min_frames}{_blurred(drives)}"
        )
    if fit.explained < LEAST_EXPLAINED:
        explained, needed = shares(fit.explained, LEAST_EXPLAINED)
        raise MatchError(
            f"the outline that the messages report explains {explained} of the vehicle's points; needed are {needed}: "
            "something else is seen with it, or its messages are wrong"
        )


def _blurred(drives: Sequence[Evidence]) -> str:
    """Return in words that the matching window mixes outline and road; empty if it does not, or without points."""
    blurs_m = np.concatenate([drive.blur_m for drive in drives])
    if not len(blurs_m):  # boxes of a detector
        return ""
    blur_m = float(np.median(blurs_m))
    sides, behind_m = np.arange(outline.SIDES), np.full(outline.SIDES, np.inf)
    highest_m = max(
        float(outline.highest_of(drive.vehicle.width_m, sides, behind_m, matched=True).max()) for drive in drives
    )
    if outline.LOWEST_M + blur_m < highest_m:
        return ""
    return (
        f"; the matcher's window is {2 * blur_m:.1f} m high there, so that the outline below {highest_m:.2f} m cannot "
        "be told from the road: record it nearer, or with more pixels"
    )
