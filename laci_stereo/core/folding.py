"""What is longer than any rigid body folds in bends: a lorry or a car with its trailer, or an articulated bus.

How far what is behind the joint is off then depends on hitches and drawbars that no message tells. By about how much it
folds follows from the way, and so does when it is straight again.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray
from laci_stereo.core.outline import HEAVY_WIDTH_M
from laci_stereo.core.tractrix import BodyYaw

LONGEST_RIGID_M = 15.0
"""Lorries without a trailer end at 12 m, buses that do not fold at 15 m (Directive 96/53/EC, annex I)."""

LONGEST_VAN_M = 7.5
"""What is no lorry or bus is a car or a van, the longest of which are 7.4 m long."""

TOWED_M = 8.0
"""A semi-trailer's axles are 7.5 to 8.2 m behind its kingpin; with shorter drawbars it folds less."""

STRAIGHT_RAD = 0.02
"""What folds by less is off by 0.25 m at its end, as much as a length or a position may be; headings err by less."""

WEAVE_M = 4.0 * TOWED_M
"""Between folds to either side that are nearer to one another it is never straight: what is left of a fold after so far
is a fiftieth, and what is seen between them is on its way from one to the other."""


def longest_rigid(width_m: float) -> float:
    """Return how long a rigid vehicle of some width may be, metres."""
    return LONGEST_VAN_M if width_m < HEAVY_WIDTH_M else LONGEST_RIGID_M


def folded(body: BodyYaw, stamps_s: FloatArray, along_m: FloatArray) -> BoolArray:
    """Tell when a vehicle that is too long to be rigid is no longer straight, shape (n,).

    A trailer's wheels follow its hitch as a body's rear axle follows its front: by a tractrix. One that weaves follows
    late, which would pass for an error of the clocks.

    Parameters
    ----------
    body : BodyYaw
    stamps_s, along_m : ndarray, shape (n,)
        Of the messages, and how far the vehicle has come by then.
    """
    angle = body.at(stamps_s, TOWED_M)[0]
    found: BoolArray = np.abs(angle) > STRAIGHT_RAD
    folds = np.flatnonzero(found)
    for one, other in pairwise(folds.tolist()):
        if angle[one] * angle[other] < 0.0 and along_m[other] - along_m[one] < WEAVE_M:
            found[one:other] = True
    return found
