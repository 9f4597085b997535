"""Whether the body that was seen is the one that the messages describe: as long, and there in time."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from laci_stereo.core.cam import VehicleTrack
from laci_stereo.core.drive_model import Correction
from laci_stereo.core.errors import MatchError
from laci_stereo.core.evidence import evidence_of
from laci_stereo.core.frames import FloatArray
from laci_stereo.core.joint import fit_roughly
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.settings import JointSettings
from laci_stereo.core.tracking import Track

STRANGER_LENGTH_M = 0.6
"""Standard deviation of how the lengths of two cars differ: they are 4.4 +- 0.4 m. Widths differ by a tenth only, which
is what a camera's distances err by together, so they tell nothing."""

STRANGER_CLOCK_S = 0.5
"""A stranger passes at any time; what was searched is less than that, or that is what is unknown."""

MISTAKEN = 0.02
"""One sender in fifty tells something wrong, by as much as strangers differ."""

_GRID = np.linspace(-6.0, 6.0, 241)


def resemblance(
    track: Track, vehicle: VehicleTrack, start: PlanarMatch, time_offset_s: float, height_m: float,
    settings: JointSettings | None = None,
) -> float:  # fmt: skip
    """Return the log odds that a track's body is the vehicle's, against that of a stranger which moves like it.

    The outline is registered with a length as free as strangers'. How likely what is
    found is if the messages tell the truth, over how likely if not, is the ratio of both priors, averaged over what
    the points leave open (the Savage-Dickey ratio of densities, for a prior of any form). That a clock agrees speaks
    for nobody: it was set so that the tracks fit.

    Parameters
    ----------
    track : Track
    vehicle : VehicleTrack
    start : PlanarMatch
        From the level into the world frame, by the track and the vehicle's.
    time_offset_s : float
    height_m : float
        Of the sensor above the ground.
    settings : JointSettings

    Returns
    -------
    float
        0 where nothing of an outline was seen.
    """
    length_m, width_m = vehicle.guessed_m
    stranger = replace(vehicle, guessed_m=(math.hypot(length_m, STRANGER_LENGTH_M), width_m))
    drive = evidence_of(track, stranger, height_m)
    if not len(drive.points):
        return 0.0
    try:
        fit = fit_roughly(drive, start, time_offset_s, settings)
    except MatchError:
        return 0.0
    found = {correction.what: correction for correction in fit.corrections[0]}
    return _odds(found["length"], STRANGER_LENGTH_M) + min(0.0, _odds(_wide_clock(found["clock"]), STRANGER_CLOCK_S))


def _wide_clock(clock: Correction) -> Correction:
    """Return the clock's correction as if strangers' had been allowed: where it is far off, the data ruled."""
    return replace(clock, sigma=math.hypot(clock.sigma, STRANGER_CLOCK_S))


def _odds(correction: Correction, differs: float) -> float:
    """Return the log of the mean ratio of the sender's prior over the stranger's."""
    told = math.sqrt(max(correction.sigma**2 - differs**2, 1e-12))
    values = correction.value + correction.after * _GRID
    weight = np.exp(-(_GRID**2) / 2)
    stranger = _density(values, correction.sigma)
    sender = (1.0 - MISTAKEN) * _density(values, told) + MISTAKEN * stranger
    return float(np.log(np.average(sender / np.maximum(stranger, 1e-300), weights=weight)))


def _density(values: FloatArray, sigma: float) -> FloatArray:
    density: FloatArray = np.exp(-((values / sigma) ** 2) / 2) / sigma
    return density
