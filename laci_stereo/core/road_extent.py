"""The road along a way: what is seen below it, and to either side as far as that goes on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from laci_stereo.core.cloud import PointCloud
from laci_stereo.core.cluster import cells_of
from laci_stereo.core.frames import (
    Axes,
    BoolArray,
    FloatArray,
    IntArray,
    along_line,
    between,
    dot_xy,
    perpendicular,
    transform,
)
from laci_stereo.core.ground_fit import SHARED_IN_CELL
from laci_stereo.core.ground_uneven import CLASS_B_M
from laci_stereo.core.road_cells import CELL_M, LASER_RAD, Cells
from laci_stereo.core.road_edges import VERGES_M
from laci_stereo.core.road_surface import OTHER, Surface, height_of
from laci_stereo.core.robust import NORMAL
from laci_stereo.core.settings import GroundSettings
from laci_stereo.core.sighting import sigma_z
from laci_stereo.core.tracking import Track

REACH_M = 20.0
"""So far beside a way road is looked for, unless it ends before: from one edge to the other of five lanes. The more is
seen of a road, the less do its waves tilt it."""

NO_WINDOW_RAD = 1e-6
"""Narrower than what two cells are apart."""

COARSE_M = 0.003
"""What squares of that size differ by on an even road: chippings, markings, covers."""

LOW_M = 0.7
"""What is farther above or below the plane that was found before, and twice that with its noise, is no road: land that
falls by 5 % is as far off after 14 m."""

TURN_M, SMOOTH_M = 3.5, 2.5
"""How far before and behind a place the direction of the way is taken from, and over how much its places are averaged:
they jump as other sides of the vehicle come into view."""

PIECE_M = 6.0
"""The road is as wide over so much of its length: half of a crossing's mouth. What is seen of the next pieces on the
same side tells it too: at the ends of a way little is seen of one."""

WANDER_M = 0.25
"""Within its lane a vehicle wanders by as much, and so do the boxes on it, one standard deviation."""

HALF_VEHICLE_M = 1.25
"""So far to either side there is road: vehicles are up to 2.55 m wide (EU directive 96/53/EC)."""

NEAR_M, START_STEPS, START_LOOKS = 0.05, 20, 2
"""What is nearer than that, or than its noise, to the plane that most of a lane is on is road at first: a kerb, were it
among that, would be explained as a steep crown, and what is left out comes back with what is seen around it. And the
steps to that plane, and how often what is seen is placed on it: the plane that was known is a foot off, a hundredth of
the way to it then."""

STEP_M = 1.0
"""The road goes on by so much at a time: over more, what is not known of it yet would hide a kerb."""

KERB_M, NO_ROAD_M = 0.08, 0.15
"""Mean height above the road of what is none, and its standard deviation: kerbs have 3 to 15 cm, banks rise or fall."""

KNOWN_M = KERB_M / 2
"""Where the surface is known less well, a kerb may pass for its slope: such places wait until it is known better, but
not those below the vehicle. By what roads fall by beforehand (`OTHER`) that is 1.4 m from what is seen: one ring of a
scanner tells no slope, and the next one may be as far off."""

MOST_LIKELY = 3.0
"""Logarithm of the odds: no cell tells by more than twenty to one whether it is road."""

VERGE_FALL = 0.01
"""Where a road ends that falls by so much more than farther in, that may be on a verge: a verge falls by twice as much
more at least (see `laci_stereo.core.road_edges.EDGES`), but half of what is looked at may not be on it."""

GATE = 3.0

MOST_EDGES = 4
"""A crossing has as many corners."""

FIRST_CELLS, LEAST_CELLS = 6, 36
"""So many below the way tell a plane and that they are on it; fewer than so many in all are no road: 4 m of a lane."""


@dataclass(frozen=True)
class Road:
    """What a road may be: its surface, if so many edges are left out as were found one after the other, or fewer.

    What passes for an edge mostly is one, so the last surface is the road's. But the mouth of another road, where the
    crown ends, and the other side of a crown, of which little is seen, do so as well. Surfaces through different places
    cannot be told apart by their evidence, so each is as likely.
    """

    surfaces: tuple[Surface, ...]

    @property
    def found(self) -> Surface:
        """The last one."""
        return self.surfaces[-1]

    def apart(self) -> FloatArray:
        """Return how far the planes may be from the last one's, squared and averaged, shape (3, 3): as `Surface.plane`.

        A surface that is torn between an edge and a crown has its plane between what both would make of it: how far
        these are from one another is in its doubt, of which nothing is left once the edge is taken for one.
        """
        last, _, _ = self.found.plane()
        squares: FloatArray = np.zeros((3, 3))
        for surface in self.surfaces[:-1]:
            off, _, torn = surface.plane()
            by_place = np.eye(3)
            by_place[0, 1:] = self.found.middle - surface.middle  # where the last one is told
            off = by_place @ off - last
            squares += np.outer(off, off) + by_place @ torn @ by_place.T
        return squares / len(self.surfaces)


def places(track: Track) -> FloatArray:
    """Return the way of a vehicle, level frame, shape (n, 2), every `CELL_M`, however fast it was or long it stood.

    Where it comes back over its own way, as who backs out of a yard and drives off, that is left out: nothing new is
    below it, and what was to the left of it would be to the right.
    """
    cells = np.floor(np.array([sighting.box.centre for sighting in track.sightings]) / CELL_M)
    first = np.sort(np.unique(cells, axis=0, return_index=True)[1])
    seen = (cells[first] + 0.5) * CELL_M
    along_m = along_line(seen)
    at_m = np.arange(0.0, along_m[-1] + CELL_M, CELL_M)
    middles = between(at_m, along_m, seen)
    number = np.arange(len(middles))
    reach = np.minimum(np.minimum(number, number[::-1]), round(SMOOTH_M / CELL_M))
    sums = np.concatenate([np.zeros((1, 2)), np.cumsum(middles, axis=0)])
    smooth: FloatArray = (sums[number + reach + 1] - sums[number - reach]) / (2 * reach + 1)[:, None]
    # Where it was not seen for longer, the way may have turned; but frames may be seldom.
    steps_m = np.diff(along_m)
    longest_m = max(PIECE_M, 1.5 * float(np.median(steps_m))) if len(steps_m) else PIECE_M
    kept = np.append(steps_m, 0.0)[np.searchsorted(along_m, at_m, side="right") - 1] < longest_m
    return _once(smooth[kept], at_m[kept])


def prolonged(way: FloatArray, before: FloatArray, after: FloatArray) -> FloatArray:
    """Return a way and what comes before and after it, as far as it is long itself, but no farther than `REACH_M`.

    A scanner's rings meet a vehicle nearer than the road that is below it, so that where it was seen may be none of the
    road, but some is before and behind that. Over more than its own length a way's direction is not known.

    Parameters
    ----------
    way : ndarray, shape (n, 2)
        See `places`.
    before, after : ndarray, shape (m, 2)
        From its first and its last place on, outwards; as a whole they may be off.
    """
    most_m = min(REACH_M, float(along_line(way)[-1]))
    parts = []
    for end, path in ((way[0], before), (way[-1], after)):
        along_m = along_line(path)
        at_m = np.arange(CELL_M, min(most_m, along_m[-1]), CELL_M)
        parts.append(between(at_m, along_m, path - path[0] + end))
    whole = np.concatenate([parts[0][::-1], way, parts[1]])
    return _once(whole, along_line(whole))


def _once(way: FloatArray, along_m: FloatArray) -> FloatArray:
    """Return a way without where it comes back over itself."""
    again = np.linalg.norm(way[:, None] - way, axis=2) < HALF_VEHICLE_M
    again &= along_m < along_m[:, None] - 2 * HALF_VEHICLE_M
    once: FloatArray = way[~again.any(axis=1)]
    return once


def road_along(
    way: FloatArray,
    clouds: Sequence[PointCloud],
    T_level_sensor: FloatArray,
    axes: Axes,
    before: FloatArray,
    settings: GroundSettings,
) -> Road | None:
    """Return the road along a way; None where none is seen.

    Parameters
    ----------
    way : ndarray, shape (n, 2)
        Level frame; see `places`.
    clouds : sequence of PointCloud
        Without what moves.
    T_level_sensor : ndarray, shape (4, 4)
        Into the level frame of a plane that is near the road's.
    axes : Axes
        Of the sensor.
    before : ndarray, shape (3,)
        Height at the origin, and slopes, of the ground near which a road is beforehand; see `Surface`.
    settings : GroundSettings
    """
    on_plane = _cells(way, clouds, T_level_sensor, axes)
    if not len(on_plane):
        return None
    cells = on_plane
    for _ in range(START_LOOKS):
        lane = cells[np.abs(cells.left_m) < HALF_VEHICLE_M]
        cells = _at_height(on_plane, _below(lane, cells.xy, before), way, T_level_sensor[2, 3])
    away_m, along_rad = np.abs(cells.left_m), _along_rad(way)
    limit_m = np.full(cells.piece.max() + 1, HALF_VEHICLE_M)
    on_road = away_m < HALF_VEHICLE_M
    on_road &= np.abs(cells.z - _below(cells[on_road], cells.xy, before)) < np.maximum(NEAR_M, np.sqrt(cells.variance))
    for _ in range(round(REACH_M / STEP_M)):
        if on_road.sum() < FIRST_CELLS:
            return None
        height, variance = Surface(cells[on_road], settings.shared_noise_share, before, along_rad).heights(cells)
        off_m = cells.z - height
        alike = (settings.shared_noise_share * cells.sigma_m) ** 2  # what all points err by is no kerb
        known = (variance - alike < KNOWN_M**2) | (away_m < HALF_VEHICLE_M)
        variance = variance + cells.variance + CLASS_B_M**2
        limit_m = _limits(cells, off_m, variance, limit_m)
        on_road = (away_m < limit_m[cells.piece]) & (off_m**2 < GATE**2 * variance) & known
        cells = _at_height(on_plane, height, way, T_level_sensor[2, 3])
    if on_road.sum() < LEAST_CELLS:
        return None
    land = off_m**2 < GATE**2 * (variance + NO_ROAD_M**2)
    on_road |= land & _beyond_verges(cells, height, limit_m, on_road)
    ends_m = _ends(cells, off_m, variance, limit_m)
    return _without_edges(evened(cells[on_road]), settings.shared_noise_share, before, along_rad, ends_m)


def evened(cells: Cells) -> Cells:
    """Return cells beside an even way, if theirs wanders about one: crowns and edges along it do not wander.

    Over what is seen such a way is straight, or bends evenly.
    """
    x, y = (cells.xy - cells.xy.mean(axis=0)).T
    shapes = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    even_m = shapes @ np.linalg.lstsq(shapes, cells.left_m, rcond=None)[0]
    wanders = np.sqrt(np.mean((cells.left_m - even_m) ** 2)) < WANDER_M
    return replace(cells, left_m=even_m) if wanders else cells


def _without_edges(
    cells: Cells, shared_noise_share: float, before: FloatArray, along_rad: float, ends_m: tuple[float, float]
) -> Road:
    """Return a road, without what is rather behind an edge than not: it may have another edge then."""
    surfaces: list[Surface] = []
    while len(surfaces) < MOST_EDGES:
        surfaces.append(Surface(cells, shared_noise_share, before, along_rad, ends_m, edges=True))
        within = surfaces[-1].behind < 0.5
        if within.all() or within.sum() < LEAST_CELLS:
            break
        cells = cells[within]
    return Road(tuple(surfaces))


def _beyond_verges(cells: Cells, height: FloatArray, limit_m: FloatArray, on_road: BoolArray) -> BoolArray:
    """Tell which cells, shape (n,), are up to twice a verge beyond where a road may have ended on one.

    What falls there may be the other side of a crown as well. But behind a verge there is land, which rises from it:
    that looked like a kerb, and tells.

    Parameters
    ----------
    cells : Cells
    height : ndarray, shape (n,)
        Of the road's surface.
    limit_m : ndarray, shape (k,)
        How far to its side each piece of the road goes on.
    on_road : ndarray of bool, shape (n,)
    """
    narrow_m, wide_m = VERGES_M
    found = np.zeros(len(cells), dtype=bool)
    for piece, end_m in enumerate(limit_m.tolist()):
        out_m = (cells.left_m if piece % 2 else -cells.left_m) - end_m
        near = on_road & (np.abs(cells.piece // 2 - piece // 2) <= 1)
        outer, inner = (near & (out_m > -far) & (out_m < -to) for far, to in ((narrow_m, 0.0), (2 * wide_m, wide_m)))
        if min(outer.sum(), inner.sum()) < FIRST_CELLS:
            continue
        if _slope(out_m[inner], height[inner]) - _slope(out_m[outer], height[outer]) > VERGE_FALL:
            found |= (cells.piece == piece) & (out_m >= 0.0) & (out_m < 2 * wide_m)
    return found


def _slope(x: FloatArray, z: FloatArray) -> float:
    """Return by how much z rises along x, least squares."""
    off = x - x.mean()
    return float(off @ z / max(off @ off, 1e-9))


def _cells(way: FloatArray, clouds: Sequence[PointCloud], T_level_sensor: FloatArray, axes: Axes) -> Cells:
    """Gather what is low and near the way in squares of the ground plan."""
    sensor = T_level_sensor[:3, 3]
    levels = [transform(T_level_sensor, cloud.points) for cloud in clouds]
    sigma_m = np.concatenate(
        [
            sigma_z(xyz - sensor, cloud.sigma_along_m, cloud.sigma_across_m)
            for xyz, cloud in zip(levels, clouds, strict=True)
        ]
    )
    level = np.concatenate(levels)
    low = np.abs(level[:, 2]) < LOW_M + np.minimum(GATE * sigma_m, LOW_M)
    z, sigma_m, ray = level[low, 2], sigma_m[low], np.concatenate([cloud.points for cloud in clouds])[low]
    # Noise moves points along their lines of sight, which are known: else a scan's ring would be as steep as these are.
    # So they are taken to where these meet the plane, and later the road's surface.
    xy = level[low, :2] * (sensor[2] / (sensor[2] - z))[:, None]
    near = np.asarray(cKDTree(way).query(xy, distance_upper_bound=REACH_M)[0]) < REACH_M
    xy, z, sigma_m, ray = xy[near], z[near], sigma_m[near], ray[near]
    cell = np.unique(cells_of(xy, CELL_M), return_inverse=True)[1].reshape(-1)
    count = np.bincount(cell)
    middle = np.stack([np.bincount(cell, column) / count for column in xy.T], axis=1)
    noise = np.bincount(cell, sigma_m**2) / count
    height = _medians(z, cell)
    spread = NORMAL * _medians(np.abs(z - height[cell]), cell)
    # A median is less exact than a mean by pi / 2.
    variance = np.pi / 2 * np.maximum(noise, spread**2) / count + SHARED_IN_CELL * noise + COARSE_M**2
    nearest, left_m, beyond_m = _beside(way, middle)
    piece = 2 * (along_line(way)[nearest] // PIECE_M).astype(np.int64) + (left_m > 0.0)
    beside = np.abs(beyond_m) < 2 * CELL_M  # and neither before the way nor behind it
    even = spread < GATE * np.sqrt(noise + COARSE_M**2)
    bearing = np.column_stack(
        [np.arctan2(*middle.T[::-1]), np.arctan2(height - sensor[2], np.linalg.norm(middle, axis=1))]
    )
    window_rad = max(cloud.window_rad for cloud in clouds)
    sight = bearing / max(NO_WINDOW_RAD, window_rad)
    common_m, layer = np.sqrt(noise), np.full(len(count), np.nan)
    if window_rad == 0.0:
        elevation_rad = np.arcsin(np.clip(ray @ axes.up / np.linalg.norm(ray, axis=1), -1.0, 1.0))
        layer = np.bincount(cell, elevation_rad) / count / LASER_RAD
    elif len(count):
        # An offset of all disparities, whatever the texture: a plane is seen as another plane, raised as depth is.
        forward = T_level_sensor[:3, :3] @ axes.forward
        depth_m = middle @ forward[:2] - sensor @ forward
        common_m = depth_m * np.median(common_m / depth_m)
    return Cells(middle, height, variance, common_m, left_m, piece, sight, layer)[beside & even]


def _at_height(cells: Cells, height: FloatArray, way: FloatArray, sensor_m: float) -> Cells:
    """Move cells along their lines of sight from the plane to a height, shape (n,): a crown is seen from aside.

    Where a surface is not known it may be anywhere, above the sensor as well, and cells would be at no place.
    """
    most_m = min(2 * LOW_M, sensor_m / 2)
    xy = cells.xy * (1.0 - height.clip(-most_m, most_m) / sensor_m)[:, None]
    return replace(cells, xy=xy, left_m=_beside(way, xy)[1])


def _beside(way: FloatArray, xy: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return which place of a way is nearest to others, and how far to the left of it and beyond it they are."""
    nearest = np.asarray(cKDTree(way).query(xy)[1])
    forward, off = _directions(way)[nearest], xy - way[nearest]
    return nearest, dot_xy(perpendicular(forward), off), dot_xy(forward, off)


def _medians(values: FloatArray, group: IntArray) -> FloatArray:
    ordered = values[np.lexsort((values, group))]
    count = np.bincount(group)
    first = np.cumsum(count) - count
    medians: FloatArray = (ordered[first + (count - 1) // 2] + ordered[first + count // 2]) / 2
    return medians


def _directions(way: FloatArray) -> FloatArray:
    """Return the direction of a way at each of its places, shape (n, 2)."""
    number, reach = np.arange(len(way)), round(TURN_M / CELL_M)
    along = way[np.minimum(number + reach, len(way) - 1)] - way[np.maximum(number - reach, 0)]
    directions: FloatArray = along / np.maximum(np.linalg.norm(along, axis=1), 1e-9)[:, None]
    return directions


def _along_rad(way: FloatArray) -> float:
    """Return the direction of a way, but for quarters of a turn: before and behind a turn it is the same."""
    x, y = _directions(way).T
    return float(np.angle(((x + 1j * y) ** 4).mean())) / 4


def _below(lane: Cells, xy: FloatArray, before: FloatArray) -> FloatArray:
    """Return the height, at places of shape (n, 2), of a plane through most of a lane's cells: some are raised.

    Reweighted least squares, as for Cauchy's distribution.
    """
    if not len(lane):
        return height_of(before, xy)
    middle = lane.xy.mean(axis=0)
    basis, weight = np.column_stack([np.ones(len(lane)), lane.xy - middle]), 1.0 / (lane.variance + NEAR_M**2)
    z = lane.z - height_of(before, lane.xy)
    prior, plane = np.diag(np.array(OTHER) ** -2.0), np.zeros(3)
    for _ in range(START_STEPS):
        robust = weight / (1.0 + weight * (z - basis @ plane) ** 2)
        plane = np.linalg.solve(prior + (basis.T * robust) @ basis, basis.T @ (robust * z))
    return height_of(before, xy) + height_of(plane, xy - middle)


def _limits(cells: Cells, off_m: FloatArray, variance: FloatArray, limit_m: FloatArray) -> FloatArray:
    """Return how far to its side each piece of the road goes on, shape (k,): at most a step farther than before.

    That is a cell before where the evidence that cells are road, summed from the way on over it and the next pieces, is
    largest: the last of these may be on the edge and show some of both, and the surface that bends up there would take
    the next step for the road.

    Parameters
    ----------
    cells : Cells
    off_m, variance : ndarray, shape (n,)
        How far each is above the surface, and the variance of that if it is road.
    limit_m : ndarray, shape (k,)
    """
    evidence = _evidence(off_m, variance)
    away_m = np.abs(cells.left_m)
    found = np.minimum(limit_m + STEP_M, REACH_M)
    for piece, most_m in enumerate(found.tolist()):
        members = np.flatnonzero(_with_next(cells, piece) & (away_m < most_m))
        members = members[np.argsort(away_m[members])]
        total = np.cumsum(evidence[members])
        beyond = int(np.argmax(total)) + 1 if (total > 0.0).any() else 0
        if beyond < len(members):
            found[piece] = max(HALF_VEHICLE_M, float(away_m[members[beyond]]) - CELL_M)
    return found


def _ends(cells: Cells, off_m: FloatArray, variance: FloatArray, limit_m: FloatArray) -> tuple[float, float]:
    """Return how far to the left of the way the road was seen to end on its right and on its left.

    That is where what is beyond is surely none and higher, in the middle of all pieces; infinitely far where that is
    nowhere. What is lower may be the other side of a crown. Parameters are those of `_limits`.
    """
    evidence, away_m = _evidence(off_m, variance), np.abs(cells.left_m)
    ends: tuple[list[float], list[float]] = ([], [])
    for piece, end_m in enumerate(limit_m.tolist()):
        beyond = _with_next(cells, piece) & (away_m >= end_m) & (away_m < end_m + STEP_M)
        if evidence[beyond].sum() < -MOST_LIKELY and off_m[beyond].mean() > 0.0:
            ends[piece % 2].append(end_m)
    right, left = (float(np.median(each)) if each else np.inf for each in ends)
    return -right, left


def _with_next(cells: Cells, piece: int) -> BoolArray:
    """Tell which cells are on a piece of the road or on the next ones on its side, shape (n,)."""
    return np.isin(cells.piece, (piece - 2, piece, piece + 2))


def _evidence(off_m: FloatArray, variance: FloatArray) -> FloatArray:
    """Return how likely it is that cells are road and no kerb or bank, shape (n,), as a logarithm of odds."""
    other = variance + NO_ROAD_M**2
    evidence = ((off_m - KERB_M) ** 2 / other + np.log(other) - off_m**2 / variance - np.log(variance)) / 2
    return np.clip(evidence, -MOST_LIKELY, MOST_LIKELY)
