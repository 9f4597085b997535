"""Whether what moves fits the messages if their positions are of another place on the vehicle than was said."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from laci_stereo.core.cam import VehicleTrack
from laci_stereo.core.case import Case, Instead, log_odds_between
from laci_stereo.core.frames import rotate_xy

PLACES = {"front": 0.5, "centre": 0.0, "rear": -0.5}
"""Where positions may be, in lengths ahead of the centre of the box. Receivers are mounted anywhere: what is left is
told by the outline."""

TOLD = 0.25
"""Nearer to where it was said to be, in lengths, is no other place."""


def place_off(case: Case) -> Instead | None:
    """Say from where on the vehicle positions would surely fit what moves; None if from nowhere, or as they are.

    Asked where nothing fits as it was said; straight on everything would. Outlines are asked at once: the box of what
    is seen of a lorry may be half a length off.
    """
    as_told = replace(case, settings=case.settings.any_fit).chosen()
    searched = math.log(len(PLACES) - 1)  # one of two fits so well by chance more often than a single one
    clearly, found = case.settings.least_log_odds + searched, []
    for name, share in PLACES.items():
        moved = {station: _moved(vehicle, share) for station, vehicle in case.vehicles.items()}
        if all(moved[station] is vehicle for station, vehicle in case.vehicles.items()):
            continue
        choice = replace(case, vehicles=moved).chosen()
        if choice is not None and not choice.doubt and log_odds_between(choice, as_told) > clearly:
            rear = f"{moved[choice.station].reference[0]:.2f},0"
            option = {"front": "front", "centre": "center", "rear": rear}[name]
            words = (
                f"were the messages' positions those of the vehicle's {name}, station {choice.station} would be seen "
                f"where they say: --cam-reference {option}"
            )
            found.append(Instead(choice, words))
    return max(found, key=lambda each: each.choice.log_likelihood, default=None)


def _moved(vehicle: VehicleTrack, share: float) -> VehicleTrack:
    """Return where a vehicle is if positions are so many lengths ahead of its centre; itself if that was said."""
    place = np.array([share * vehicle.length_m, 0.0])
    by = np.asarray(vehicle.reference) - place
    if abs(by[0]) < TOLD * vehicle.length_m:
        return vehicle
    xy = vehicle.xy + rotate_xy(vehicle.yaw_rad, np.tile(by, (len(vehicle.yaw_rad), 1)))
    return replace(vehicle, xy=xy, reference=(float(place[0]), 0.0))
