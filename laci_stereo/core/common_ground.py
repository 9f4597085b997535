"""Several drives past one sensor in one level frame: merging of their grounds, transformation of each drive onto it.

The drives are also moved from the map onto the ground, if their altitudes show a slope.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.special import chdtrc

from laci_stereo.core.errors import CombineError
from laci_stereo.core.estimation.consensus import Estimates, uncorrelated
from laci_stereo.core.estimation.passage import Passage, utc
from laci_stereo.core.frames import FloatArray, invert, planar
from laci_stereo.core.ground.merge import Chart
from laci_stereo.core.ground.plane import GroundPlane
from laci_stereo.core.matching import PlanarMatch
from laci_stereo.core.messages.cam import MAX_GAP_S
from laci_stereo.core.messages.slope import slope_of
from laci_stereo.core.tracking.reframing import (
    moved_vehicle,
    reported_on_map,
    transformed_background,
    transformed_track,
)
from laci_stereo.core.world import World

CONTRADICTION_RATE = 0.01
"""Share of selections of grounds with correct covariances of which it is said that they differ; that of `compare`."""

GROUND_GATE = 5.0
"""Difference of two grounds in standard deviations beyond which they are not of one sensor: one of 10 000 pairs is
beyond 4.6 (3 degrees of freedom), and the covariance of a ground does not include that other parts of the road are seen
each time, for example because wheels hide it."""

MOVED_RATE = float(chdtrc(3, GROUND_GATE**2))
"""The same for any number of grounds: the chance of that difference, 1.5e-5."""

SWAY_RAD = 5e-4
"""Standard deviation of the tilt of an untouched sensor from drive to drive: a steel mast 0.15 m wide and 6 m high
whose sunny side is 5 K warmer bends by 1.2e-5 / K x 5 K / 0.15 m x 6 m = 2.4 mrad, which is the extreme case."""

GROWTH_M = 1e-3
"""Standard deviation of its height from drive to drive: 6 m of steel and 15 K."""


@dataclass(frozen=True)
class MergedGround:
    """The common ground of several drives.

    Attributes
    ----------
    ground : GroundPlane
    kept : tuple of int
        The drives of whose grounds it is the mean.
    objections : tuple of str
        How grounds differ that should be one, and which drives are left out for it.
    """

    ground: GroundPlane
    kept: tuple[int, ...]
    objections: tuple[str, ...] = ()


def merge_grounds(passages: Sequence[Passage]) -> MergedGround:
    """Return the mean of the grounds of several drives, weighted by their inverse covariances.

    The road and the sensor are the same each time, so the errors of the drives are fully correlated: the information is
    the mean of theirs, not the sum. Grounds that differ by more than they claim are not as good as they claim, see
    `Estimates.excess`. Drives with one and the same ground are of one recording or
    of one earlier result, and have one vote.

    Raises
    ------
    CombineError
        If grounds differ so much that the sensor was moved between them, unless a few are wrong by a majority's vote.
    """
    drives = _by_ground(passages)
    if len(drives) == 1:
        return MergedGround(passages[0].ground, drives[0])
    chart = Chart.around(passages[0].ground)
    planes = [passages[numbers[0]].ground for numbers in drives]
    sway = np.diag([SWAY_RAD, SWAY_RAD, GROWTH_M]) ** 2
    covariances = np.array([chart.covariance(plane) + sway for plane in planes])
    grounds = _Grounds(chart.values(planes), uncorrelated(covariances), passages, drives)
    kept, objections = _one_ground(grounds)
    mean, covariance = grounds.mean(kept)
    merged = chart.plane(mean, grounds.excess(kept) * len(kept) * covariance)
    return MergedGround(merged, tuple(sorted(i for each in kept for i in drives[each])), objections)


def _by_ground(passages: Sequence[Passage]) -> list[tuple[int, ...]]:
    """Return which drives have one and the same ground."""
    found: dict[tuple[object, ...], list[int]] = {}
    for i, passage in enumerate(passages):
        plane = passage.ground
        same = (plane.normal.tobytes(), plane.height_m, plane.covariance_sensor.tobytes())
        found.setdefault(same, []).append(i)
    return [tuple(numbers) for numbers in found.values()]


@dataclass(frozen=True)
class _Grounds(Estimates):
    """Different grounds in one chart.

    Attributes
    ----------
    passages : sequence of Passage
    drives : sequence of tuple of int
        Those with each ground.
    """

    passages: Sequence[Passage]
    drives: Sequence[tuple[int, ...]]

    def chance(self, chosen: Sequence[int]) -> float:
        """Return an upper bound of the probability that grounds with correct covariances differ by as much.

        Tested are all of them together, and each one against the others and the earlier against the later ones: many
        that differ little do not hide one that differs much, or a step. Both, and each of these, count (Bonferroni).
        """
        together = super().chance(chosen)
        if len(chosen) <= 2:
            return together
        steps = [self.difference(*halves)[1] for halves in self.halves(chosen)]
        contrasts = np.append(self.distances(chosen), steps)
        return min(1.0, 2.0 * min(together, len(contrasts) * float(chdtrc(3, contrasts.max() ** 2))))

    def halves(self, chosen: Sequence[int]) -> list[tuple[list[int], list[int]]]:
        """Return the earlier and the later ones of some grounds, by each moment with at least two before and since."""
        order = sorted(chosen, key=lambda i: self.first_ns([i]))
        both = [(order[:count], order[count:]) for count in range(2, len(order) - 1)]
        return [(early, late) for early, late in both if self.last_ns(early) < self.first_ns(late)]

    def agree(self, chosen: Sequence[int]) -> bool:
        return self.chance(chosen) >= CONTRADICTION_RATE

    def of(self, chosen: Sequence[int]) -> list[Passage]:
        """Return the drives with some of the grounds, in their order."""
        return [self.passages[i] for i in sorted(i for each in chosen for i in self.drives[each])]

    def first_ns(self, chosen: Sequence[int]) -> int:
        """Return the Unix time of the first sighting of some grounds' drives."""
        return min(passage.span_ns[0] for passage in self.of(chosen))

    def last_ns(self, chosen: Sequence[int]) -> int:
        """Return the Unix time of the last sighting of some grounds' drives."""
        return max(passage.span_ns[1] for passage in self.of(chosen))

    def names(self, chosen: Sequence[int]) -> str:
        return ", ".join(passage.name for passage in self.of(chosen))

    def others(self, chosen: Sequence[int]) -> str:
        """Return in words what a drive is compared with."""
        drives = self.of(chosen)
        return drives[0].name if len(drives) == 1 else f"the {len(drives)} other drives"


def _one_ground(grounds: _Grounds) -> tuple[list[int], tuple[str, ...]]:
    """Return the grounds to be taken for one, and what is to be said against it."""
    everyone = list(range(len(grounds)))
    chance = grounds.chance(everyone)
    if chance >= CONTRADICTION_RATE:
        return everyone, ()
    kept, gone = _vote(grounds)
    moved = _moved(grounds, kept, gone)
    if chance >= MOVED_RATE:
        when = "" if moved is None else f" between {_between(grounds, *moved)}"
        others, some = moved or (kept, gone)
        told = (
            f"the drives do not see one ground: in {grounds.names(some)} the sensor's "
            f"{_off(grounds, some, others, grounds.others(others))}; by chance grounds differ so in "
            f"{100 * chance:.1g} % of cases: was the sensor moved{when}?"
        )
        return everyone, (told,)
    if moved is not None:
        before, since = moved
        raise CombineError(
            f"the sensor was moved between {_between(grounds, *moved)}: in {grounds.names(since)} its "
            f"{_off(grounds, since, before, grounds.names(before))}; needed are drives from before or from since"
        )
    _check_majority(grounds, kept, gone)
    return kept, tuple(
        f"{grounds.names([one])} left out: in it the sensor's {_off(grounds, [one], kept, grounds.others(kept))}: was "
        "it moved, or is this ground wrong?"
        for one in gone
    )


def _vote(grounds: _Grounds) -> tuple[list[int], list[int]]:
    """Return grounds that agree, and the rest: the farthest one is taken away until the others agree."""
    kept = everyone = list(range(len(grounds)))
    while not grounds.agree(kept):
        farthest = kept[int(grounds.distances(kept).argmax())]
        kept = [i for i in kept if i != farthest]
    # One that was far from the rest only because of those that went after it comes back.
    for i in everyone:
        if i not in kept and grounds.agree(more := sorted([*kept, i])):
            kept = more
    gone = [i for i in everyone if i not in kept]
    # Of two groups of one size, that of the first drive is what the other one is compared with.
    return (gone, kept) if len(gone) == len(kept) and 0 in gone else (kept, gone)


def _moved(grounds: _Grounds, kept: list[int], gone: list[int]) -> tuple[list[int], list[int]] | None:
    """Return the grounds before and since a moment when the sensor was moved, at least two each, or None.

    That is where the vote divides them, or where either side agrees and two planes, one for each side, explain all of
    them better than one plane for those kept and another one for each of the rest. A plane has three parameters, and
    each costs two in chi-square (Akaike 1974, "A new look at the statistical model identification").
    """
    if len(gone) > 1 and len(kept) > 1:
        for early, late in ((kept, gone), (gone, kept)):
            if grounds.last_ns(early) < grounds.first_ns(late):
                return early, late
    least, found = grounds.chi_square(kept) + 2.0 * 3.0 * (len(gone) - 1), None
    for early, late in grounds.halves(range(len(grounds))):
        chi_square = grounds.chi_square(early) + grounds.chi_square(late)
        if chi_square < least and grounds.agree(early) and grounds.agree(late):
            least, found = chi_square, (early, late)
    return found


def _check_majority(grounds: _Grounds, kept: list[int], gone: list[int]) -> None:
    """Raise if nothing shows that those left out are wrong."""
    if 2 * len(kept) <= len(grounds):
        raise CombineError(
            f"the sensor was moved between the drives: in {grounds.names(gone)} its "
            f"{_off(grounds, gone, kept, grounds.names(kept))}; needed are grounds that agree to {GROUND_GATE:g} sigma"
        )
    for i, j in product(gone, kept):
        if grounds.agree([i, *(k for k in kept if k != j)]):
            one, other = sorted((i, j))
            raise CombineError(
                f"the sensor was moved between the drives: in {grounds.names([other])} its "
                f"{_off(grounds, [other], [one], grounds.names([one]))}, and the other drives agree with either; "
                "needed is one more drive to tell which is wrong"
            )


def _off(grounds: _Grounds, some: list[int], others: list[int], named: str) -> str:
    off, sigmas = grounds.difference(some, others)
    turned_deg = np.degrees(np.arcsin(min(1.0, float(np.linalg.norm(off[:2])))))
    return f"tilt is {turned_deg:.2f} deg and its height {off[2]:+.3f} m off {named} ({sigmas:.1f} sigma)"


def _between(grounds: _Grounds, early: list[int], late: list[int]) -> str:
    return f"{utc(grounds.last_ns(early))} and {utc(grounds.first_ns(late))} UTC"


def lay(passage: Passage, ground: GroundPlane, world: World) -> Passage:
    """Transform a drive to the level frame of another ground and the map of another world in the same UTM zone."""
    T_own_sensor = passage.ground.T_level_sensor(passage.axes)
    T_level_sensor = ground.T_level_sensor(passage.axes)
    T_level_own = T_level_sensor @ invert(T_own_sensor)
    T_own_world_level = planar(passage.match.yaw_rad, passage.match.shift) @ invert(T_level_own)
    yaw = float(np.arctan2(T_own_world_level[1, 0], T_own_world_level[0, 0]))
    shift = T_own_world_level[None, :2, 3]
    if passage.vehicle.slope is not None:
        shift = passage.vehicle.slope.on_map(shift)
    xy, yaw_rad = reported_on_map(passage.vehicle)
    return replace(
        passage,
        world=world,
        ground=ground,
        background=transformed_background(T_level_own, passage.background),
        track=transformed_track(T_level_own, passage.track),
        vehicle=moved_vehicle(passage.vehicle, _between_worlds(xy, passage.world, world), yaw_rad, None),
        match=PlanarMatch(yaw, _between_worlds(shift, passage.world, world)[0]),
    )


def _between_worlds(xy: FloatArray, own: World, world: World) -> FloatArray:
    return world.from_utm(own.to_utm(xy))


def along_ground(passages: Sequence[Passage]) -> list[Passage]:
    """Move drives from the map of one world onto their common ground, if their altitudes determine its slope."""
    slope = slope_of([_heights_in_view(passage) for passage in passages])
    if slope is None:
        return list(passages)
    return [
        replace(
            passage,
            vehicle=moved_vehicle(passage.vehicle, *reported_on_map(passage.vehicle), slope),
            match=replace(passage.match, shift=slope.along_ground(passage.match.shift[None])[0]),
        )
        for passage in passages
    ]


def _heights_in_view(passage: Passage) -> tuple[FloatArray, FloatArray]:
    """Return the positions and altitudes reported while a drive is in view: farther away the road may bend."""
    vehicle = passage.vehicle
    seen_s = np.array([sighting.stamp_s for sighting in passage.track.sightings]) + passage.time_offset_s
    near = (vehicle.stamps_s >= seen_s.min() - MAX_GAP_S) & (vehicle.stamps_s <= seen_s.max() + MAX_GAP_S)
    altitude_m = np.full(len(near), np.nan) if vehicle.altitude_m is None else vehicle.altitude_m
    return reported_on_map(vehicle)[0][near], altitude_m[near]
