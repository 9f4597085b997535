"""Which of several drives agree on the pose of the sensor, and which one contradicts the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.special import chdtri

from laci_stereo.core.errors import CombineError
from laci_stereo.core.estimation.consensus import Estimates, uncorrelated
from laci_stereo.core.estimation.evidence import Evidence
from laci_stereo.core.estimation.joint import JointFit, fit_jointly
from laci_stereo.core.estimation.passage import Passage, utc
from laci_stereo.core.estimation.problem import Problem
from laci_stereo.core.estimation.scanner_turn import FIXED, Turn
from laci_stereo.core.frames import FloatArray, wrap
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.settings import JointSettings

FALSE_ALARM = 1e-3
"""Probability that any drive is left out although all of them agree."""

UNEVEN = 1e-2
"""Probability that drives differ by as much, below which that is an objection, as in a comparison of two results."""

LEAST_LOG_ODDS = float(np.log(100.0))
"""Log odds by which one group of drives that agree must be likelier than another one."""

MOST_COMMON = 1.0 - 1e-4
"""Largest fraction of the standard deviation of an estimate that may be due to its prior, so that the covariance of
several estimates stays regular."""

LEAST_RIVALS, RIVAL_SHARE = 2, 0.5
"""Drives that contradict the others, but agree with one another, are wrong alike, or right: as after the sensor was
moved, or with the same wrong setting. One by itself may be wrong by chance. Where they are half as many as the others,
a majority says little about which of both it is."""


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
        Its covariance includes by how much the drives differ more than they should.
    left_out : tuple of LeftOut
    objections : tuple of str
        Why the result may be wrong: drives were left out, or differ by more than they should.
    """

    passages: tuple[Passage, ...]
    drives: tuple[Evidence, ...]
    fit: JointFit
    left_out: tuple[LeftOut, ...]
    objections: tuple[str, ...] = ()

    @property
    def sightings(self) -> int:
        """Number of frames in which the vehicles were seen."""
        return sum(len(each.track.sightings) for each in self.passages)


def fit_together(
    passages: Sequence[Passage],
    drives: Sequence[Evidence],
    alone: Sequence[JointFit],
    settings: JointSettings,
    start: PlanarMatch | None = None,
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
    start : PlanarMatch or None
        A transform by which all drives are where they were seen, with their passages' clock offsets, to begin with;
        None begins with the estimates by themselves.

    Raises
    ------
    CombineError
        See `agreeing`.
    """
    stations = [passage.station_id for passage in passages]
    estimates = estimates_of(alone, stations)
    kept, left_out = agreeing([passage.name for passage in passages], estimates)
    kept.sort(key=lambda i: float(np.trace(alone[i].covariance[1:, 1:])))
    fit = alone[kept[0]]
    if len(kept) > 1:
        offsets = [alone[i].time_offsets_s[0] if start is None else passages[i].time_offset_s for i in kept]
        begin, close, senders = start or fit.match, start is None, [stations[i] for i in kept]
        fit = fit_jointly([drives[i] for i in kept], begin, offsets, settings, stations=senders, close=close)
        fit = replace(fit, covariance=estimates.excess(kept) * fit.covariance)
    used = tuple(replace(passages[i], time_offset_s=s) for i, s in zip(kept, fit.time_offsets_s, strict=True))
    objections = [_left_behind(passages, kept, left_out)] if left_out else []
    if (chance := estimates.chance(kept)) < UNEVEN:
        objections.append(
            f"the {len(kept)} drives differ by more than their uncertainties, as by chance in {chance:.1%} of cases: "
            "messages or clocks of some may be wrong"
        )
    return Together(used, tuple(drives[i] for i in kept), fit, left_out, tuple(objections))


def agreeing(names: Sequence[str], estimates: Estimates) -> tuple[list[int], tuple[LeftOut, ...]]:
    """Return the largest group of drives that agree, and the others, which contradict it.

    Raises
    ------
    CombineError
        If no majority agrees, another selection would agree as well, or so many others agree with one another that it
        is not clear which group is right.
    """
    everyone = list(range(len(estimates)))
    if _agree(estimates, everyone):
        return everyone, ()
    groups = sorted(_groups(estimates), key=lambda group: _cost(estimates, group))
    kept = groups[0]
    gone = [i for i in everyone if i not in kept]
    found = tuple(_left_out(names[i], i, kept, estimates) for i in gone)
    if 2 * len(kept) <= len(everyone):
        worst = max(found, key=lambda each: each.sigmas)
        raise CombineError(
            f"no majority of the {len(everyone)} drives ({', '.join(names)}) agrees: {worst.name} alone is "
            f"{worst.shift_m:.2f} m and {worst.turn_deg:.2f} deg ({worst.sigmas:.1f} sigma) off; needed are more "
            "drives that agree"
        )
    for i, j in product(gone, kept):
        swapped = [i if k == j else k for k in kept]
        if _agree(estimates, swapped):
            raise CombineError(
                f"{names[i]} and {names[j]} contradict each other, and the other drives agree with either; needed is "
                "one more drive to tell which is wrong"
            )
    for rivals in groups[1:]:
        ours, theirs = sorted(set(kept) - set(rivals)), sorted(set(rivals) - set(kept))
        many = len(theirs) >= max(LEAST_RIVALS, RIVAL_SHARE * len(ours))
        if many or (theirs and _cost(estimates, rivals) < _cost(estimates, kept) + LEAST_LOG_ODDS):
            shift_m, turn_deg = _between(estimates, theirs, ours)
            either = "; or ".join(", ".join(names[i] for i in group) for group in (ours, theirs))
            raise CombineError(
                f"the drives agree in two groups, {shift_m:.2f} m and {turn_deg:.2f} deg apart: {either}; needed are "
                "those of one, if the sensor was moved or messages are wrong in the other"
            )
    return kept, found


def _left_behind(passages: Sequence[Passage], kept: Sequence[int], left_out: Sequence[LeftOut]) -> str:
    """Return in words that drives were left out, and that the sensor may have been moved if they are the last."""
    names = {each.name for each in left_out}
    gone = [passage.span_ns for passage in passages if passage.name in names]
    used = [passages[i].span_ns for i in kept]
    contradict = "contradicts the others and was" if len(gone) == 1 else "contradict the others and were"
    words = f"{len(gone)} of {len(passages)} drives {contradict} left out"
    for before, after, result_is in ((used, gone, "before that"), (gone, used, "after it")):
        last_ns, first_ns = max(end_ns for _, end_ns in before), min(begin_ns for begin_ns, _ in after)
        if last_ns < first_ns:
            return (
                f"{words}, all {'later' if after is gone else 'earlier'} than those: if the sensor was moved between "
                f"{utc(last_ns)} and {utc(first_ns)} UTC, the result is of the time {result_is}"
            )
    return words


def all_agree(estimates: Estimates) -> bool:
    """Tell whether none of several drives contradicts the others, and they differ no more than they should."""
    return _agree(estimates, range(len(estimates)))


def estimates_of(alone: Sequence[JointFit], stations: Sequence[int]) -> Estimates:
    """Return yaw, x and y by each drive alone, in the middle of all drives.

    What drives have in common, such as the sensor's clock and its range bias, or a sender's vehicle, moves their
    estimates alike, or against each other if they go opposite ways. `Recordings` derives it from their times and
    ``stations``, the sender of each.
    """
    place = np.mean([fit.centre_level for fit in alone], axis=0)
    first = alone[0].match.yaw_rad
    values = [[first + float(wrap(fit.match.yaw_rad - first)), *fit.match(place[None])[0]] for fit in alone]
    own = np.array([fit.covariance_about(place) for fit in alone])
    covariance = uncorrelated(own)
    if all(fit.drives for fit in alone):
        moved = np.array(_by_common(alone, stations, place, own))
        each = range(len(alone))
        covariance = np.einsum("nis,mjs->nimj", moved, moved)
        covariance[each, :, each] = own
    return Estimates(np.array(values), covariance)


def _by_common(
    alone: Sequence[JointFit], stations: Sequence[int], place: FloatArray, own: FloatArray
) -> list[FloatArray]:
    """Return how independent errors that drives share move their estimates of yaw, x and y, shape (3, errors) each.

    They account for no more of each estimate's own covariance than `MOST_COMMON`.
    """
    first, drives = alone[0], [fit.drives[0] for fit in alone]
    problem = Problem(drives, np.zeros(4), np.zeros(2), first.settings, Turn(first.turn, FIXED), stations)
    found = []
    for fit, errors, covariance in zip(alone, problem.prior_errors(), own, strict=True):
        root = np.linalg.cholesky(covariance)
        by_prior = np.linalg.solve(root, fit.moved_to(place) @ fit.by_prior)
        left, shares, right = np.linalg.svd(by_prior, full_matrices=False)
        found.append(root @ (left * np.minimum(shares, MOST_COMMON)) @ right @ errors)
    return found


def _agree(estimates: Estimates, chosen: Sequence[int]) -> bool:
    """Tell whether none of the chosen is far from the others, nor all of them together are too far apart."""
    if len(chosen) < 2:
        return True
    return estimates.chance(chosen) >= FALSE_ALARM and estimates.distances(chosen).max() <= _gate(len(chosen))


def _cost(estimates: Estimates, group: Sequence[int]) -> float:
    """Return the negative log-likelihood of a group, if a drive that is left out costs as much as the gate."""
    left_out = len(estimates) - len(group)
    return estimates.chi_square(group) / 2.0 + left_out * _gate(len(estimates)) ** 2 / 2.0


def _groups(estimates: Estimates) -> list[list[int]]:
    """Return the groups of drives that agree, each in ascending order: the largest that begins with each drive.

    A group takes in the nearest of the others, as long as all agree. Beginning with all of them and leaving out the
    worst, many vague drives would be drawn to a few sharp ones that are wrong.
    """
    count = len(estimates)
    groups = set()
    for first in range(count):
        group = [first]
        for other in sorted(set(range(count)) - {first}, key=lambda i: estimates.difference([i], [first])[1]):
            if _agree(estimates, [*group, other]):
                group.append(other)
        groups.add(tuple(sorted(group)))
    return [list(group) for group in sorted(groups)]


def _gate(count: int) -> float:
    """Return the Mahalanobis distance that is significant for any of so many drives (Bonferroni; yaw, x and y)."""
    return float(np.sqrt(chdtri(3, FALSE_ALARM / count)))


def _left_out(name: str, one: int, kept: Sequence[int], estimates: Estimates) -> LeftOut:
    return LeftOut(name, *_between(estimates, [one], kept), estimates.difference([one], kept)[1], len(kept))


def _between(estimates: Estimates, some: Sequence[int], others: Sequence[int]) -> tuple[float, float]:
    """Return the differences in position, metres, and yaw, degrees, between the means of two groups."""
    off, _ = estimates.difference(some, others)
    return float(np.hypot(*off[1:])), float(np.degrees(abs(off[0])))
