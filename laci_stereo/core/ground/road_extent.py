"""The extent of the road along a vehicle's path: the surface below the path, and to either side up to the road's ends.

The path is a sequence of places in the level frame, `CELL_M` apart (see `places`). Each side of the road is divided
along the path into *pieces* of `PIECE_M`, each of which has a limit of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from laci_stereo.core.cloud import PointCloud, window_of
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
from laci_stereo.core.ground.rays import GATE
from laci_stereo.core.ground.road_cells import CELL_M, LASER_RAD, Cells
from laci_stereo.core.ground.road_edges import VERGES_M
from laci_stereo.core.ground.road_surface import OTHER, Surface, height_of
from laci_stereo.core.ground.uneven import CLASS_B_M
from laci_stereo.core.robust import NORMAL
from laci_stereo.core.settings import GroundSettings
from laci_stereo.core.tracking.cluster import cells_of
from laci_stereo.core.tracking.sighting import sigma_z
from laci_stereo.core.tracking.tracks import Track

REACH_M = 20.0
"""Largest distance from the path at which road is searched, unless it ends before: from one edge of five lanes to the
other. The larger the visible part of a road, the less do its waves tilt the plane."""

NO_WINDOW_RAD = 1e-6
"""Width of the matching window of a sensor without one: narrower than the distance between two cells."""

COARSE_M = 0.003
"""Standard deviation of the heights of cells on an even road: chippings, markings, covers."""

SHARED_AT_M = 10.0
"""Points of a cell share their noise as far as one matching window fills the cell at this distance, where those of a
road are most precise. Farther away one window fills a cell, but most of the variance that is claimed there is the
offset of all disparities, which the road's covariance contains already, or differs from frame to frame: on two
recordings, one window's own variance was a third of the claimed one, and three fifths of it lasted."""

SURFACE_SHARE = 0.2**2
"""Fraction of a scanner's variance that the points of a cell share: their range errors depend on the reflectance and
on the angle of incidence, which they have in common. Taken as a fifth of the noise; each laser's own error comes on
top."""

LOW_M = 0.7
"""Points farther above or below the plane that was found before are not road; with their noise, up to twice this is
allowed. Terrain that falls by 5 % is this far off after 14 m."""

TURN_M, SMOOTH_M = 3.5, 2.5
"""Distances before and behind a place of the path from which its direction is computed, and over which its position is
averaged: the measured positions jump as other sides of the vehicle come into view."""

JUMPS = 1.5
"""Ratio of the path through some boxes to the way from the first to the last above which they jump to and fro; at 2 the
path seems to lead over its own parts (`_once`), and a right-angled turn has 1.4."""

PIECE_M = 6.0
"""Length of a piece, over which the road is taken as equally wide: half of the mouth of a crossing. The next pieces on
the same side are evidence of its width too, since little is seen of a piece at the ends of a path."""

WANDER_M = 0.25
"""Standard deviation by which a vehicle wanders within its lane, and its boxes about the vehicle."""

HALF_VEHICLE_M = 1.25
"""Distance to either side of the path within which there is road: vehicles are up to 2.55 m wide (EU directive
96/53/EC)."""

NEAR_M, START_STEPS, START_LOOKS = 0.05, 20, 2
"""The start. Cells nearer than `NEAR_M`, or than their noise, to the plane through most of the lane are taken as road
first: a kerb among them would be explained as a steep crown, and cells that are left out are added later with those
around them. `START_STEPS` is the number of steps of the fit of this plane, `START_LOOKS` the number of times that the
cells are placed on it: the plane known before may be off by 0.3 m, and only a hundredth of this remains then."""

STEP_M = 1.0
"""Distance by which the limits of the road are moved outwards at a time: over a longer one, the uncertainty of the
extrapolated surface would hide a kerb."""

KERB_M, NO_ROAD_M = 0.08, 0.15
"""Mean and standard deviation of the height of other surfaces above the road: kerbs are 3 to 15 cm high, banks rise or
fall."""

KNOWN_M = KERB_M / 2
"""Largest standard deviation of the surface at a cell that is taken as road. Where it is larger, a kerb may be mistaken
for the slope of the road, so the cell has to wait until the surface is better known, unless it is below the vehicle.
With the prior of slopes (`OTHER`) this is reached 1.4 m from the visible road: one ring of a scanner determines no
slope, and the next ring may be that far off."""

MOST_LIKELY = 3.0
"""Largest log odds from one cell: no cell is evidence for or against road by more than twenty to one."""

VERGE_FALL = 0.01
"""If a road falls at its limit by this much more than farther inside, its outermost part may be a verge: a verge falls
by at least twice as much more (see `laci_stereo.core.ground.road_edges.EDGES`), but half of the examined cells may not
be on it."""

MOST_EDGES = 4
"""Largest number of edges found one after the other: the number of corners of a crossing."""

FIRST_CELLS, LEAST_CELLS = 6, 36
"""Least number of cells below the path that determine a plane and confirm it, and least number of cells of a road: 4 m
of a lane."""


@dataclass(frozen=True)
class Road:
    """Possible surfaces of a road: the first one without any edge removed, each next one with one more edge removed.

    A detected edge is mostly real, so the last surface is taken for the road's. The mouth of another road, where the
    crown ends, and the other side of a crown of which little is seen, can however be mistaken for an edge. The evidence
    of surfaces through different cells cannot be compared, so all of them are equally likely.
    """

    surfaces: tuple[Surface, ...]

    @property
    def found(self) -> Surface:
        """The last surface, with all edges removed."""
        return self.surfaces[-1]

    def apart(self) -> FloatArray:
        """Return the mean squared deviation of the planes from the last one, shape (3, 3), in `Surface.plane`'s units.

        The plane of a surface that is ambiguous between an edge and a crown lies between the planes of the two
        explanations. Their difference is part of its covariance, but no longer of that of the last surface, for which
        the edge has been accepted.
        """
        last, _, _ = self.found.plane()
        squares: FloatArray = np.zeros((3, 3))
        for surface in self.surfaces[:-1]:
            off, _, torn = surface.plane()
            by_place = np.eye(3)
            by_place[0, 1:] = self.found.middle - surface.middle  # to the place of the last plane's height
            off = by_place @ off - last
            squares += np.outer(off, off) + by_place @ torn @ by_place.T
        return squares / len(self.surfaces)


def places(track: Track) -> FloatArray:
    """Return the path of a vehicle, level frame, shape (n, 2), with a uniform spacing of `CELL_M` whatever its speed.

    Parts in which the vehicle drives over its own path again, for example after backing out of a yard, are left out:
    nothing new is below them, and left and right would be exchanged.
    """
    cells = np.floor(_thinned(np.array([sighting.box.centre for sighting in track.sightings])) / CELL_M)
    first = np.sort(np.unique(cells, axis=0, return_index=True)[1])
    seen = (cells[first] + 0.5) * CELL_M
    along_m = along_line(seen)
    at_m = np.arange(0.0, along_m[-1] + CELL_M, CELL_M)
    middles = between(at_m, along_m, seen)
    number = np.arange(len(middles))
    reach = np.minimum(np.minimum(number, number[::-1]), round(SMOOTH_M / CELL_M))
    sums = np.concatenate([np.zeros((1, 2)), np.cumsum(middles, axis=0)])
    smooth: FloatArray = (sums[number + reach + 1] - sums[number - reach]) / (2 * reach + 1)[:, None]
    # In a longer gap between sightings the path may have turned; but frames may be infrequent.
    steps_m = np.diff(along_m)
    longest_m = max(PIECE_M, 1.5 * float(np.median(steps_m))) if len(steps_m) else PIECE_M
    kept = np.append(steps_m, 0.0)[np.searchsorted(along_m, at_m, side="right") - 1] < longest_m
    return _once(smooth[kept], at_m[kept])


def _thinned(centres: FloatArray) -> FloatArray:
    """Return the centres of boxes, shape (m, 2), and instead of those that jump to and fro on the spot, their mean.

    Boxes of a slow vehicle, or of frequent frames, jump by more than the vehicle moves. A path through all of them
    would be several times as long as the vehicle's, and seem to lead over its own parts.
    """
    kept: list[FloatArray] = []
    begin, total = 0, np.zeros(2)
    for end in range(1, len(centres) + 1):
        total = total + centres[end - 1]
        if end < len(centres) and np.linalg.norm(centres[end] - total / (end - begin)) < HALF_VEHICLE_M:
            continue
        part = centres[begin:end]
        jumps = along_line(part)[-1] > JUMPS * np.linalg.norm(part[-1] - part[0])
        kept.append(part.mean(axis=0, keepdims=True) if jumps else part)
        begin, total = end, np.zeros(2)
    return np.concatenate(kept)


def prolonged(way: FloatArray, before: FloatArray, after: FloatArray) -> FloatArray:
    """Return a path extended at both ends by up to its own length, but by no more than `REACH_M`, shape (k, 2).

    A scanner's rings meet a vehicle before they meet the road below it, so no road may be seen where the vehicle was
    seen, but some before and behind that. Beyond its own length the direction of a path is not known.

    Parameters
    ----------
    way : ndarray, shape (n, 2)
        The path; see `places`.
    before, after : ndarray, shape (m, 2)
        Paths outwards from its first and its last place; each may be offset as a whole.
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
    """Return a path without the parts that lead over an earlier part of it; ``along_m`` is the distance travelled."""
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
    """Return the road along a path; None if no road is seen.

    Parameters
    ----------
    way : ndarray, shape (n, 2)
        The path in the level frame; see `places`.
    clouds : sequence of PointCloud
        Clouds without the points of moving objects.
    T_level_sensor : ndarray, shape (4, 4)
        Transform into the level frame of a plane near that of the road.
    axes : Axes
        Axes of the sensor.
    before : ndarray, shape (3,)
        Prior mean of the road's plane: height at the origin, and slopes, of the ground; see `Surface`.
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
        alike = (settings.shared_noise_share * cells.sigma_m) ** 2  # an error of all points is no kerb
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
    """Return cells with distances from a smooth path, if their own path only wanders about a smooth one.

    Crowns and edges along the path do not wander as vehicles do. Over the visible road a smooth path is straight or has
    a uniform curvature.
    """
    x, y = (cells.xy - cells.xy.mean(axis=0)).T
    shapes = np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])
    even_m = shapes @ np.linalg.lstsq(shapes, cells.left_m, rcond=None)[0]
    wanders = np.sqrt(np.mean((cells.left_m - even_m) ** 2)) < WANDER_M
    return replace(cells, left_m=even_m) if wanders else cells


def _without_edges(
    cells: Cells, shared_noise_share: float, before: FloatArray, along_rad: float, ends_m: tuple[float, float]
) -> Road:
    """Return a road after repeated removal of the cells that are more likely behind an edge than not.

    After each removal the remaining road may have another edge.
    """
    surfaces: list[Surface] = []
    while len(surfaces) < MOST_EDGES:
        surfaces.append(Surface(cells, shared_noise_share, before, along_rad, ends_m, edges=True))
        within = surfaces[-1].behind < 0.5
        if within.all() or within.sum() < LEAST_CELLS:
            break
        cells = cells[within]
    return Road(tuple(surfaces))


def _beyond_verges(cells: Cells, height: FloatArray, limit_m: FloatArray, on_road: BoolArray) -> BoolArray:
    """Return which cells, shape (n,), lie within twice a verge's width beyond a limit of the road that may be a verge.

    A surface that falls there may also be the other side of a crown. But behind a verge the terrain rises from it,
    which looked like a kerb; these cells decide between the two.

    Parameters
    ----------
    cells : Cells
    height : ndarray, shape (n,)
        Height of the road's surface at each cell.
    limit_m : ndarray, shape (k,)
        Distance from the path at which each piece of the road ends.
    on_road : ndarray of bool, shape (n,)
        Whether each cell was taken as road.
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
    """Return the least-squares slope of z along x."""
    off = x - x.mean()
    return float(off @ z / max(off @ off, 1e-9))


def _cells(way: FloatArray, clouds: Sequence[PointCloud], T_level_sensor: FloatArray, axes: Axes) -> Cells:
    """Average the points that are low and near the path in square cells of the ground plan."""
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
    # Noise moves points along their lines of sight, so a scan's ring would appear as steep as these. As the lines of
    # sight are known, points are moved along them to the plane, and later to the road's surface.
    xy = level[low, :2] * (sensor[2] / (sensor[2] - z))[:, None]
    near = np.asarray(cKDTree(way).query(xy, distance_upper_bound=REACH_M)[0]) < REACH_M
    xy, z, sigma_m, ray = xy[near], z[near], sigma_m[near], ray[near]
    cell = np.unique(cells_of(xy, CELL_M), return_inverse=True)[1].reshape(-1)
    count = np.bincount(cell)
    middle = np.stack([np.bincount(cell, column) / count for column in xy.T], axis=1)
    noise = np.bincount(cell, sigma_m**2) / count
    height = _medians(z, cell)
    spread = NORMAL * _medians(np.abs(z - height[cell]), cell)
    window_rad = window_of(clouds)
    within = min((window_rad * SHARED_AT_M / CELL_M) ** 2, 1.0) if window_rad > 0.0 else SURFACE_SHARE
    # The variance of a median is pi / 2 times that of a mean.
    variance = np.pi / 2 * np.maximum(noise, spread**2) / count + within * noise + COARSE_M**2
    nearest, left_m, beyond_m = _beside(way, middle)
    piece = 2 * (along_line(way)[nearest] // PIECE_M).astype(np.int64) + (left_m > 0.0)
    beside = np.abs(beyond_m) < 2 * CELL_M  # and neither before the path nor behind it
    even = spread < GATE * np.sqrt(noise + COARSE_M**2)
    bearing = np.column_stack(
        [np.arctan2(*middle.T[::-1]), np.arctan2(height - sensor[2], np.linalg.norm(middle, axis=1))]
    )
    sight = bearing / max(NO_WINDOW_RAD, window_rad)
    common_m, layer = np.sqrt(noise), np.full(len(count), np.nan)
    if window_rad == 0.0:
        elevation_rad = np.arcsin(np.clip(ray @ axes.up / np.linalg.norm(ray, axis=1), -1.0, 1.0))
        layer = np.bincount(cell, elevation_rad) / count / LASER_RAD
    elif len(count):
        # An offset of all disparities, whatever the texture: a plane appears as another plane, raised in proportion to
        # depth.
        forward = T_level_sensor[:3, :3] @ axes.forward
        depth_m = middle @ forward[:2] - sensor @ forward
        common_m = depth_m * np.median(common_m / depth_m)
    return Cells(middle, height, variance, common_m, left_m, piece, sight, layer)[beside & even]


def _at_height(cells: Cells, height: FloatArray, way: FloatArray, sensor_m: float) -> Cells:
    """Move cells along their lines of sight from the plane to a given height, shape (n,), such as that of a crown.

    Heights are limited: where a surface is not known it may come out anywhere, even above the sensor, and the cells
    would have no position. ``sensor_m`` is the height of the sensor above the plane.
    """
    most_m = min(2 * LOW_M, sensor_m / 2)
    xy = cells.xy * (1.0 - height.clip(-most_m, most_m) / sensor_m)[:, None]
    return replace(cells, xy=xy, left_m=_beside(way, xy)[1])


def _beside(way: FloatArray, xy: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return the index of the path's place nearest to each point, and the point's distances to its left and ahead."""
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
    """Return the unit vector of the path's direction at each of its places, shape (n, 2)."""
    number, reach = np.arange(len(way)), round(TURN_M / CELL_M)
    along = way[np.minimum(number + reach, len(way) - 1)] - way[np.maximum(number - reach, 0)]
    directions: FloatArray = along / np.maximum(np.linalg.norm(along, axis=1), 1e-9)[:, None]
    return directions


def _along_rad(way: FloatArray) -> float:
    """Return the mean direction of a path modulo 90 deg, which is the same before and after a right-angled turn."""
    x, y = _directions(way).T
    return float(np.angle(((x + 1j * y) ** 4).mean())) / 4


def _below(lane: Cells, xy: FloatArray, before: FloatArray) -> FloatArray:
    """Return the height, at places of shape (n, 2), of a robust plane through the cells of a lane.

    Some cells may be raised, so the plane is fitted by iteratively reweighted least squares with Cauchy's weights.
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
    """Return the distance from the path at which each piece of the road ends, shape (k,): at most a step farther.

    The evidence that cells are road is summed from the path outwards, over the piece and the next ones. The limit is
    one cell inside the place where the sum is largest: the last cell may be on the edge and contain points of both
    sides, and a surface that bends up there would include the next step.

    Parameters
    ----------
    cells : Cells
    off_m, variance : ndarray, shape (n,)
        Height of each cell above the surface, and its variance if the cell is road.
    limit_m : ndarray, shape (k,)
        The previous limits.
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
    """Return the distances to the left of the path at which the road was seen to end on its right and on its left.

    An end is seen where the cells beyond a piece's limit are clearly not road, and higher; lower ones may be the other
    side of a crown. The result is the median over all pieces of a side, and infinite if there is no such end.
    Parameters are those of `_limits`.
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
    """Return which cells are on a piece of the road or on the next ones on its side, shape (n,)."""
    return np.isin(cells.piece, (piece - 2, piece, piece + 2))


def _evidence(off_m: FloatArray, variance: FloatArray) -> FloatArray:
    """Return the log odds that cells are road rather than a kerb or bank, shape (n,), limited to `MOST_LIKELY`."""
    other = variance + NO_ROAD_M**2
    evidence = ((off_m - KERB_M) ** 2 / other + np.log(other) - off_m**2 / variance - np.log(variance)) / 2
    return np.clip(evidence, -MOST_LIKELY, MOST_LIKELY)
