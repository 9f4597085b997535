"""The placement by the paper's method: the centres of boxes matched with the positions of the messages."""

from __future__ import annotations

from collections import Counter

import numpy as np

from laci_stereo.core.estimation.joint import JointFit
from laci_stereo.core.matching import match_track
from laci_stereo.core.messages.cam import VehicleTrack
from laci_stereo.core.quality import Placement, uncertainty_by_paper
from laci_stereo.core.settings import MatchSettings
from laci_stereo.core.tracking.tracks import Track


def place_by_paper(track: Track, vehicle: VehicleTrack, settings: MatchSettings) -> Placement:
    """Match the boxes' centres with the positions of the messages (paper section III-D).

    A box whose longer side is nearer to the vehicle's width than to its length shows one end of the vehicle, not its
    middle. Such boxes are left out as too thin, unless too few others remain.

    Raises
    ------
    MatchError
        If the drive is too short to determine the yaw.
    """
    xy_world, _, known = vehicle.at(track.stamps_s)
    longer = np.array([max(sighting.box.length_m, sighting.box.width_m) for sighting in track.usable])
    whole = known & (longer > (vehicle.length_m + vehicle.width_m) / 2)
    used = whole if whole.sum() >= settings.min_frames else known
    xy_level, xy_world = track.centres[used], xy_world[used]
    match = match_track(xy_level, xy_world, settings)
    left_out = track.flaws() + Counter(unknown=int((~known).sum()), thin=int((known & ~used).sum()))
    uncertainty = uncertainty_by_paper(match, track, vehicle, used, settings)
    fit = JointFit(
        match=match,
        time_offsets_s=(0.0,),
        covariance=uncertainty.covariance,
        centre_level=xy_level.mean(axis=0),
        time_sigmas_s=(0.0,),
        corrections=((),),
        residual_rms_m=float(np.sqrt(((match(xy_level) - xy_world) ** 2).sum(axis=1).mean())),
        frames=int(used.sum()),
    )
    return Placement(
        fit=fit,
        uncertainty=uncertainty,
        left_out={str(reason): count for reason, count in left_out.items() if count},
        contradictions=vehicle.objections,
    )
