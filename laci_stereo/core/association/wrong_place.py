"""Whether moving objects fit the messages if positions refer to another point of the vehicle than specified."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from laci_stereo.core.association.case import Alternative, Case, clearly_better
from laci_stereo.core.association.resemblance import FREE_LEVER_M
from laci_stereo.core.frames import rotate_xy
from laci_stereo.core.messages.cam import CENTRE, FRONT, ReferencePoint, VehicleTrack
from laci_stereo.core.messages.repair import REAR_AXLE_SHARE


def place_off(case: Case) -> Alternative | None:
    """Return the reference point by which positions certainly fit moving objects; None if there is no other one.

    Called where nothing fits as specified; on a straight road everything would. The positions of all senders have the
    same reference point, as for the option. Outlines are compared right away: the box of the visible part of a lorry
    may be off by half its length.
    """
    as_told = replace(case, settings=case.settings.any_fit).chosen()
    tried = {
        f"--cam-reference {place}": replace(case, vehicles=moved) for place, moved in _elsewhere(case.vehicles).items()
    }
    return clearly_better(tried, case, as_told, "the messages' positions were of another point on the vehicle")


def _elsewhere(vehicles: Mapping[int, VehicleTrack]) -> dict[str, dict[int, VehicleTrack]]:
    """Return the vehicles' tracks for each usual place of a receiver on a vehicle, by the option for it.

    The specified reference point is left out: it leaves all of them where they are.
    """
    places = {"front": FRONT, "center": CENTRE}
    for vehicle in vehicles.values():
        behind_m = -REAR_AXLE_SHARE * vehicle.length_m
        places[f"rear-axle:{behind_m:.1f}"] = ReferencePoint(-round(behind_m, 1))
    found = {}
    for option, place in places.items():
        moved = {station: _moved(vehicle, place) for station, vehicle in vehicles.items()}
        if any(moved[station] is not vehicle for station, vehicle in vehicles.items()):
            found[option] = moved
    return found


def _moved(vehicle: VehicleTrack, place: ReferencePoint) -> VehicleTrack:
    """Return a vehicle's track for another reference point; the same track if outlines can correct the change.

    A lateral offset that was specified belongs to an antenna that is not at this point.
    """
    reference = place.offset(vehicle.length_m)
    by = np.asarray(vehicle.reference) - reference
    if abs(by[0]) < FREE_LEVER_M:
        return vehicle
    xy = vehicle.xy + rotate_xy(vehicle.yaw_rad, np.tile(by, (len(vehicle.yaw_rad), 1)))
    return replace(vehicle, xy=xy, reference=(float(reference[0]), float(reference[1])))
