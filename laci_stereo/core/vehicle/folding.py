"""Articulated vehicles, which are longer than any rigid one: a lorry or car with a trailer, or an articulated bus.

How far the part behind the joint deviates depends on hitches and drawbars that no message reports. The approximate
articulation angle follows from the path, and so does the time at which the vehicle is straight again.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray
from laci_stereo.core.vehicle.outline import HEAVY_WIDTH_M
from laci_stereo.core.vehicle.tractrix import BodyYaw

LONGEST_RIGID_M = 15.0
"""Longest rigid vehicle: lorries without a trailer are up to 12 m long, rigid buses up to 15 m (Directive 96/53/EC,
annex I)."""

LONGEST_VAN_M = 7.5
"""Longest rigid vehicle that is no lorry or bus: the longest vans are 7.4 m long."""

TOWED_M = 8.0
"""Assumed distance of a trailer's axles behind its hitch: a semi-trailer's are 7.5 to 8.2 m behind its kingpin; with
shorter drawbars the articulation is less."""

STRAIGHT_RAD = 0.02
"""Largest articulation angle of a vehicle that counts as straight: its end deviates by 0.25 m, as much as a length or a
position may be off; headings err by less."""

WEAVE_M = 4.0 * TOWED_M
"""A vehicle is not straight between articulations to opposite sides that are closer together than this: over this
distance an articulation decays to a fiftieth, and any state in between is a passage from one side to the other."""


def longest_rigid(width_m: float) -> float:
    """Return the length of the longest rigid vehicle of some width, metres."""
    return LONGEST_VAN_M if width_m < HEAVY_WIDTH_M else LONGEST_RIGID_M


def folded(body: BodyYaw, stamps_s: FloatArray, along_m: FloatArray) -> BoolArray:
    """Return when a vehicle that is too long to be rigid is not straight, shape (n,).

    A trailer's wheels follow its hitch as a body's rear axle follows its front: along a tractrix. A trailer that weaves
    follows with a delay, which would be mistaken for a clock offset.

    Parameters
    ----------
    body : BodyYaw
    stamps_s, along_m : ndarray, shape (n,)
        Stamps of the messages, and the distance that the vehicle has driven by then.
    """
    angle = body.at(stamps_s, TOWED_M)[0]
    found: BoolArray = np.abs(angle) > STRAIGHT_RAD
    folds = np.flatnonzero(found)
    for one, other in pairwise(folds.tolist()):
        if angle[one] * angle[other] < 0.0 and along_m[other] - along_m[one] < WEAVE_M:
            found[one:other] = True
    return found
