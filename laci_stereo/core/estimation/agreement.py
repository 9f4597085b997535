"""Which of several drives agree on the pose of the sensor, and which one contradicts the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.special import chdtri

from laci_stereo.core.errors import CombineError
from laci_stereo.core.estimation.evidence import Evidence
from laci_stereo.core.estimation.joint import JointFit, fit_jointly
from laci_stereo.core.estimation.passage import Passage
from laci_stereo.core.frames import FloatArray, wrap
from laci_stereo.core.settings import JointSettings

FALSE_ALARM = 1e-3
"""Probability that any drive is left out although all of them agree."""


@dataclass(frozen=True)
class LeftOut:
    """A drive that contradicts the others.

    Attributes
    ----------
    name : str
    shift_m, turn_deg : float
        Differences in position and yaw between its own estimate and that of the others, in the middle of all drives.
    sigmas : float
        The same in standard deviations (Mahalanobis distance of yaw, x and y).
    others : int
        Number of other drives, which agree.
    """

    name: str
    shift_m: float
    turn_deg: float
    sigmas: float
    others: int

    def __str__(self) -> str:
        return (
            f"{self.name} left out: it alone is {self.shift_m:.2f} m and {self.turn_deg:.2f} deg "
            f"({self.sigmas:.1f} sigma) off the joint result of the {self.others} other drives"
        )


@dataclass(frozen=True)
class Together:
    """The joint estimate from several drives.

    Attributes
    ----------
    passages : tuple of Passage
        Those that agree, the most informative one first.
    drives : tuple of Evidence
        Of the same drives.
    fit : JointFit
    left_out : tuple of LeftOut
    """

    passages: tuple[Passage, ...]
    drives: tuple[Evidence, ...]
    fit: JointFit
    left_out: tuple[LeftOut, ...]

    @property
    def sightings(self) -> int:
        """Number of frames in which the vehicles were seen."""
        return sum(len(each.track.sightings) for each in self.passages)


def fit_together(
    passages: Sequence[Passage], drives: Sequence[Evidence], alone: Sequence[JointFit], settings: JointSettings
) -> Together:
    """Return the joint estimate from all drives that agree.

    Parameters
    ----------
    passages : sequence of Passage
        In one level frame.
    drives : sequence of Evidence
    alone : sequence of JointFit
        The estimate from each drive by itself.
    settings : JointSettings

    Raises
    ------
    CombineError
        See `agreeing`.
    """
    kept, left_out = agreeing([passage.name for passage in passages], alone)
    kept.sort(key=lambda i: float(np.trace(alone[i].covariance[1:, 1:])))
    fit = alone[kept[0]]
    if len(kept) > 1:
        offsets = [alone[i].time_offsets_s[0] for i in kept]
        stations = [passages[i].station_id for i in kept]
        fit = fit_jointly([drives[i] for i in kept], fit.match, offsets, settings, stations=stations, close=True)
    used = tuple(replace(passages[i], time_offset_s=s) for i, s in zip(kept, fit.time_offsets_s, strict=True))
    return Together(used, tuple(drives[i] for i in kept), fit, left_out)


def agreeing(names: Sequence[str], alone: Sequence[JointFit]) -> tuple[list[int], tuple[LeftOut, ...]]:
    """Return the drives that agree, and those that do not: the worst one is left out until the rest agree.

    Raises
    ------
    CombineError
        If no majority agrees, or another selection would agree as well.
    """
    kept = list(range(len(alone)))
    if all_agree(alone):
        return kept, ()
    values, covariances = _at_one_place(alone)
    distance = _distances(values, covariances, kept)
    while len(kept) > 1 and distance.max() > _gate(len(kept)):
        del kept[int(distance.argmax())]
        distance = _distances(values, covariances, kept)
    gone = [i for i in range(len(alone)) if i not in kept]
    found = tuple(_left_out(names[i], i, kept, values, covariances) for i in gone)
    if 2 * len(kept) <= len(alone):
        worst = max(found, key=lambda each: each.sigmas)
        raise CombineError(
            f"no majority of the {len(alone)} drives ({', '.join(names)}) agrees: {worst.name} alone is "
            f"{worst.shift_m:.2f} m and {worst.turn_deg:.2f} deg ({worst.sigmas:.1f} sigma) off; needed are more "
            "drives that agree"
        )
    for i, j in product(gone, kept):
        swapped = [i if k == j else k for k in kept]
        if _distances(values, covariances, swapped).max() <= _gate(len(swapped)):
            raise CombineError(
                f"{names[i]} and {names[j]} contradict each other, and the other drives agree with either; needed is "
                "one more drive to tell which is wrong"
            )
    return kept, found


def all_agree(alone: Sequence[JointFit]) -> bool:
    """Tell whether none of several drives contradicts the others."""
    distance = _distances(*_at_one_place(alone), list(range(len(alone))))
    return bool(distance.max() <= _gate(len(alone)))


def _at_one_place(alone: Sequence[JointFit]) -> tuple[FloatArray, FloatArray]:
    """Return yaw, x and y by every drive, shape (n, 3), in the middle of all drives, and their covariances."""
    place = np.mean([fit.centre_level for fit in alone], axis=0)
    first = alone[0].match.yaw_rad
    values, covariances = [], []
    for fit in alone:
        values.append([first + float(wrap(fit.match.yaw_rad - first)), *fit.match(place[None])[0]])
        covariances.append(fit.covariance_about(place))
    return np.array(values), np.array(covariances)


def _distances(values: FloatArray, covariances: FloatArray, chosen: Sequence[int]) -> FloatArray:
    """Return the Mahalanobis distance of each of the chosen from all the others together, shape (len(chosen),)."""
    if len(chosen) < 2:
        return np.zeros(len(chosen))
    return np.array([_apart(i, [j for j in chosen if j != i], values, covariances)[1] for i in chosen])


def _apart(one: int, others: Sequence[int], values: FloatArray, covariances: FloatArray) -> tuple[FloatArray, float]:
    """Return the difference of one from all the others together, shape (3,), and its Mahalanobis distance."""
    mean, covariance = weighted_mean(values[list(others)], covariances[list(others)])
    off = values[one] - mean
    return off, float(np.sqrt(off @ np.linalg.solve(covariance + covariances[one], off)))


def _gate(count: int) -> float:
    """Return the Mahalanobis distance that is significant for any of so many drives (Bonferroni; yaw, x and y)."""
    return float(np.sqrt(chdtri(3, FALSE_ALARM / count)))


def _left_out(name: str, one: int, kept: Sequence[int], values: FloatArray, covariances: FloatArray) -> LeftOut:
    off, sigmas = _apart(one, kept, values, covariances)
    return LeftOut(name, float(np.hypot(*off[1:])), float(np.degrees(abs(off[0]))), sigmas, len(kept))


def weighted_mean(values: FloatArray, covariances: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the mean of independent estimates, shape (n, 3), weighted by their information, and its covariance."""
    information = np.linalg.inv(covariances)
    covariance: FloatArray = np.linalg.inv(information.sum(axis=0))
    mean: FloatArray = covariance @ np.einsum("nij,nj->i", information, values)
    return mean, covariance
