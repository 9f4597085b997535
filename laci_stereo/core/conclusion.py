"""From an estimate to a result: the drives that it was made from, the pose of the sensor, and its uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from laci_stereo.core.errors import MatchError
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.frames import planar
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.placement.by_paper import place_by_paper
from laci_stereo.core.quality import Placement, covariance_of, judge
from laci_stereo.core.result import Calibration
from laci_stereo.core.settings import Settings


def conclude(passages: Sequence[Passage], placement: Placement, settings: Settings) -> Calibration:
    """Return the result of an estimate, including that of the paper's method for the result's own drive.

    Parameters
    ----------
    passages : sequence of Passage
        In one level frame and along one ground, with the estimate's clock offsets; the result's own drive first.
    placement : Placement
    settings : Settings
    """
    passages, placement = _agreeing_with_the_map(passages, placement)
    fit = placement.fit
    own, *others = (
        replace(passage, match=fit.match, method=settings.method, turn=fit.turn, body=body)
        for passage, body in zip(passages, fit.bodies or [None] * len(passages), strict=True)
    )
    own = replace(own, clock_sigma_s=settings.joint.clock_sigma_s, apart_sigma_s=settings.joint.apart_sigma_s)
    T_level_sensor = own.ground.T_level_sensor(own.axes)
    ground_covariance = own.ground.covariance_level(own.axes)
    frames_seen = sum(len(each.track.sightings) for each in passages)
    return Calibration(
        passages=(own, *others),
        T_world_sensor=planar(fit.match.yaw_rad, fit.match.shift) @ T_level_sensor,
        T_level_sensor=T_level_sensor,
        covariance=covariance_of(placement.uncertainty, ground_covariance, fit.match, fit.centre_level),
        centre_world=np.append(fit.match(fit.centre_level), 0.0),
        time_sigma_s=fit.time_sigmas_s[0],
        paper=_by_paper(own, settings),
        quality=judge(placement, ground_covariance, frames_seen, settings.quality),
        nearer=fit.nearer,
        found=placement.remarks,
    )


def _agreeing_with_the_map(passages: Sequence[Passage], placement: Placement) -> tuple[Sequence[Passage], Placement]:
    """Make a sloping ground agree with the map in the middle of the data that the estimate was made from.

    Along a sloping ground another pivot is another origin, so that all positions shift by the same vector.
    """
    slope = passages[0].vehicle.slope
    if slope is None:
        return passages, placement
    fit = placement.fit
    middle = fit.match(fit.centre_level)
    pivot = slope.on_map(middle[None])[0]
    shift, slope = pivot - middle, replace(slope, pivot=pivot)

    def moved(vehicle: VehicleTrack) -> VehicleTrack:
        return replace(vehicle, xy=vehicle.xy + shift, slope=slope)

    match = replace(fit.match, shift=fit.match.shift + shift)
    fit = replace(fit, match=match, bodies=tuple(map(moved, fit.bodies)))
    return [replace(each, vehicle=moved(each.vehicle)) for each in passages], replace(placement, fit=fit)


def _by_paper(own: Passage, settings: Settings) -> PlanarMatch | None:
    try:
        return place_by_paper(own.track, own.vehicle, settings.match).fit.match
    except MatchError:
        return None
