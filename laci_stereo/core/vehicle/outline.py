"""The visible outline of a vehicle on the ground plan: which side each line of sight meets, and each point's distance.

The outline is the rectangle of the reported length and width, with the features by which a real body differs from it:
ends and sides that may be a few centimetres farther out or in, that bow and taper, sides that draw in towards the sills
except at the wheels, round corners, and a lorry's cab, which is narrower than its load. Only the lower part of a body,
below the bonnet and the windows, has this length and width; `LOWEST_M` and the heights after it bound that part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.columns import Columns
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray, dot_xy, perpendicular
from laci_stereo.core.settings import VehicleSettings

LOWEST_M = 0.25
"""Height above the ground at which bumpers and sills begin, roughly; the ground clearance of a car is 0.12 to 0.2 m."""

GROUND_SIGMAS = VehicleSettings.ground_sigmas
"""Points within this many standard deviations of the ground were taken as ground."""

HIGHEST_M = 0.65
"""Height up to which a car is upright: the bonnet of a passenger car begins at 0.65 to 0.75 m, above which its front
end leans back."""

ENDS_HIGHEST_M = 0.6
"""The same height for the ends of a car as seen by a scanner: bonnet and boot begin with an edge that is round by 5 cm
or more. A scanner resolves it; a matching window is taller."""

SIDES_HIGHEST_M = 0.9
"""The same height for the sides of a car as seen by a scanner: above it the windows recede and the mirrors protrude by
0.2 m. A matcher also sees through the windows above, to surfaces metres behind the sides."""

HEAVY_WIDTH_M = 2.2
"""Least width of a lorry or a bus, whose walls are upright; passenger cars are at most 2.1 m wide without mirrors."""

HEAVY_HIGHEST_M = 3.0
"""Height up to which the walls of a lorry or a bus are upright: their roofs are at 3 m or more."""

HEAVY_FRONT_HIGHEST_M = 1.2
"""The same height for their fronts: the windscreen recedes and begins at 1.2 m, so that drivers see the road."""

MIRRORS_M = 1.0
"""Distance behind the front within which the sides count as upright only as high up as the front: there the mirrors of
a lorry protrude by 0.2 m, and a car's wings are round."""

CAB_M = 2.0
"""Length of a lorry's cab: 1.6 m without a berth, 2.3 m with one."""

WAIST_M = 0.65
"""Height from which a car's sides have their full width; below it they draw in towards the sills, except at the wheels,
which protrude as far as the waist."""

OVERHANGS = (0.19, 0.205)
"""Distances of the front axle from the front and of the rear axle from the rear, over the vehicle's length: 0.17 to
0.21 and 0.16 to 0.23 in seven models of 3.6 to 4.9 m."""

WHEEL_M = (0.2, 0.46)
"""Distances ahead of an axle's expected place, or behind it, up to which there surely is a wheel, and beyond which
there surely is none: a tyre's radius is 0.33 m, and axles are at most 0.13 m from their expected place."""

SHAPE = (
    "front", "rear", "side", "lever_y", "front_bow", "rear_bow", "taper", "cab", "sill", "front_radius", "rear_radius"
)  # fmt: skip
"""The parameters of an outline, metres: how far front, rear and sides extend beyond the rectangle; the outline's shift
to the left; how far ends and sides recede at their corners; how far the cab's sides recede; how far a car's sides
recede at the sills; and the radii of the corners."""

SHAPE_MEAN = np.array([-0.015, -0.015, -0.015, 0.0, 0.03, 0.03, 0.03, 0.0, 0.04, 0.25, 0.25])
SHAPE_SIGMA = np.array([0.02, 0.02, 0.02, 0.0, 0.03, 0.03, 0.03, 0.001, 0.03, 0.12, 0.12])
"""Prior mean and standard deviation of the shape of any vehicle at this height. Length and width bound the whole body,
at its handles, wheel arches and bumper's edge; panels and bumpers recede from that by up to 3 cm, ends and sides curve
by as much, doors draw in by 1 to 8 cm from the waist to the sill, and the corners' radii range from 0.1 m for a van to
0.5 m for a small car."""

HEAVY_CAB_M = (0.04, 0.05)
"""Prior mean and standard deviation of how far a cab's sides recede, for vehicles as wide as a lorry: cabs are 2.3 to
2.5 m wide, their loads up to 2.55 m, and a bus has no cab."""

HEAVY_SILL_M = (0.0, 0.01)
"""The same for the sills of vehicles as wide as a lorry, whose sides are upright."""

_LEVER_Y, _CAB, _SILL = (SHAPE.index(name) for name in ("lever_y", "cab", "sill"))

SHARP_M = 0.05
"""Radius below which a corner's radius fades to 0 instead of becoming negative: r = s ln(1 + exp(x / s))."""

OUTLINE_SIGMA_M = 0.03
"""Standard deviation of a real body about such an outline: wheel arches, handles, bumper grooves."""

CORNER_SIGMA_M = 0.05
"""The additional standard deviation at corners, which are not exactly arcs of circles."""

FACES = 5
"""Number of faces: rear, front, right, left, and the corner that a line of sight passes by."""

BORDERS = 2
"""Number of further faces: the right and the left border, which the outermost lines of sight touch."""

SIDES = 4
"""Number of sides: the first four faces."""

_REAR, _FRONT, PASSED = 0, 1, 4


@dataclass(frozen=True)
class Hits(Columns):
    """How points lie relative to an outline.

    Attributes
    ----------
    distance : ndarray, shape (n,)
        Signed distance along the normal of the side that the line of sight meets; positive outside, metres.
    variance : ndarray, shape (n,)
        Variance of the distance: the point's noise, and the deviations of a real body from the outline.
    normal : ndarray, shape (n, 2)
        Outward normal, vehicle frame.
    by_shape : ndarray, shape (n, 11)
        Derivatives of the distance by `SHAPE`.
    face : ndarray of int, shape (n,)
        0 rear, 1 front, 2 right, 3 left, 4 passed by, 5 and 6 touched at its right and left border.
    reach : ndarray, shape (n,)
        Ratio of the distance from the sensor to the side to that from the sensor to the point.
    cos : ndarray, shape (n,)
        Cosine of the angle between line of sight and normal, the ratio of distance to range; 0 where a line of sight
        passes by.
    within : ndarray, shape (n,)
        How far inside the outline's nearer border, as seen from the sensor, the line of sight meets it, metres; 0 where
        it passes by.
    """

    distance: FloatArray
    variance: FloatArray
    normal: FloatArray
    by_shape: FloatArray
    face: IntArray
    reach: FloatArray
    cos: FloatArray
    within: FloatArray


def meet(
    xy: FloatArray,
    origin: FloatArray,
    sigma_along: FloatArray,
    sigma_across: FloatArray,
    size: tuple[float, float],
    shape: FloatArray,
    z: FloatArray,
) -> Hits:
    """Find where each line of sight meets an outline.

    Bearings are much more accurate than ranges in a camera, and as accurate in a scanner; the line of sight therefore
    determines which side a point is from, even where noise has moved it nearer to another one.

    Parameters
    ----------
    xy : ndarray, shape (n, 2)
        Points in the vehicle frame, metres.
    origin : ndarray, shape (n, 2)
        The sensor in the vehicle frame.
    sigma_along, sigma_across : ndarray, shape (n,)
        Standard deviations on the ground plan, along and across the line of sight.
    size : tuple of float
        Length and width that the messages report.
    shape : ndarray, shape (11,)
        See `SHAPE`.
    z : ndarray, shape (n,)
        Height of the points above the ground.
    """
    half = np.array([size[0] / 2, size[1] / 2])
    middle, shape = about_middle(shape)
    rays = _rays(xy - middle, origin - middle)
    sides = _meet_sides(rays, half, shape, z)
    corners = _meet_corners(rays, sides, half, shape)
    round_, passes, normal, enter = corners.round_, corners.passes, corners.normal, corners.enter
    cos = np.abs(dot_xy(normal, rays.u))
    own = OUTLINE_SIGMA_M**2 + np.where(round_, CORNER_SIGMA_M**2, 0.0)
    of_faces = np.where(sides.at_end, np.where(rays.ahead, 1, 0), np.where(rays.left, 3, 2))
    return Hits(
        distance=np.where(passes, corners.misses, (enter - rays.far) * cos),
        variance=(cos * sigma_along) ** 2 + (1.0 - cos**2) * sigma_across**2 + own,
        normal=normal,
        by_shape=_by_shape(rays, sides, corners, shape),
        face=np.where(passes, PASSED, of_faces),
        reach=np.where(passes, 1.0, enter / rays.far),
        cos=np.where(passes, 0.0, cos),
        within=corners.within,
    )


@dataclass(frozen=True)
class _Rays:
    """Lines of sight: their origin, direction and distance to the point, and which end and which side they can meet."""

    origin: FloatArray
    u: FloatArray
    far: FloatArray
    ahead: BoolArray
    left: BoolArray


def about_middle(shape: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the outline's middle in the vehicle frame, shape (2,), and the shape relative to it.

    Where the reported positions are those of another place on the vehicle than was stated, the middle may be half a
    length ahead or behind.
    """
    front, rear = shape[:2].tolist()
    about = shape.copy()
    about[:2], about[_LEVER_Y] = (front + rear) / 2, 0.0
    return np.array([(front - rear) / 2, shape[_LEVER_Y]]), about


def _rays(xy: FloatArray, origin: FloatArray) -> _Rays:
    ray = xy - origin
    far = np.hypot(ray[:, 0], ray[:, 1])
    u = ray / far[:, None]
    u = np.where(np.abs(u) < 1e-9, 1e-9, u)
    return _Rays(origin, u, far, origin[:, 0] > 0.0, origin[:, 1] > 0.0)


@dataclass(frozen=True)
class _Sides:
    """Where lines of sight meet the outline without the arcs at its corners.

    Attributes
    ----------
    enter : ndarray, shape (n,)
        Distance along each line of sight.
    hit : ndarray of bool, shape (n,)
        Whether it meets the outline.
    at_end : ndarray of bool, shape (n,)
        Whether it does so at an end rather than at a side.
    normal : ndarray, shape (n, 2)
    bent, tapered : ndarray, shape (n,)
        Fraction of its bow by which an end recedes there, and of its taper by which a side does.
    beside_cab : ndarray of bool, shape (n,)
    drawn : ndarray, shape (n,)
        Fraction of the recess of its sill by which a side recedes there.
    """

    enter: FloatArray
    hit: BoolArray
    at_end: BoolArray
    normal: FloatArray
    bent: FloatArray
    tapered: FloatArray
    beside_cab: BoolArray
    drawn: FloatArray


def _meet_sides(rays: _Rays, half: FloatArray, shape: FloatArray, z: FloatArray) -> _Sides:
    longer, _, side, _, front_bow, rear_bow, taper, cab, sill, *_ = shape
    origin, u = rays.origin, rays.u
    sign_x, sign_y = np.where(rays.ahead, 1.0, -1.0), np.where(rays.left, 1.0, -1.0)
    end_x = sign_x * (half[0] + longer)
    side_y = sign_y * (half[1] + side)
    bow = np.where(rays.ahead, front_bow, rear_bow)
    low = np.clip((WAIST_M - z) / (WAIST_M - LOWEST_M), 0.0, 1.0)

    t_end = (end_x - origin[:, 0]) / u[:, 0]
    t_side = (side_y - origin[:, 1]) / u[:, 1]
    for _ in range(2):  # ends bow quadratically, sides taper: by centimetres, so this converges at once
        eta = np.clip((origin[:, 1] + t_end * u[:, 1]) / half[1], -1.0, 1.0)
        t_end = (end_x - sign_x * bow * eta**2 - origin[:, 0]) / u[:, 0]
        xi = np.clip((origin[:, 0] + t_side * u[:, 0]) / half[0], -1.0, 1.0)
        beside_cab = half[0] * (1.0 - xi) < CAB_M
        drawn = low * (1.0 - _wheels(half[0] * xi, 2.0 * half[0]))
        drawn_in = taper * _tapered(xi)[0] + cab * beside_cab + sill * drawn
        t_side = (side_y - sign_y * drawn_in - origin[:, 1]) / u[:, 1]
    t_end = np.where(np.abs(origin[:, 0]) > np.abs(end_x), t_end, -np.inf)
    t_side = np.where(np.abs(origin[:, 1]) > np.abs(side_y), t_side, -np.inf)
    at_end = t_end >= t_side
    enter = np.maximum(t_end, t_side)
    hit = (enter > 0.0) & (enter < _leave(origin, u, half + np.array([longer, side])))
    eta, xi = np.where(at_end, eta, 0.0), np.where(at_end, 0.0, xi)
    tapered, slope = _tapered(xi)
    lean_end, lean_side = 2.0 * bow * eta / half[1], taper * slope / half[0]
    normal = np.column_stack([np.where(at_end, sign_x, lean_side), np.where(at_end, lean_end, sign_y)])
    normal /= np.hypot(normal[:, 0], normal[:, 1])[:, None]
    return _Sides(enter, hit, at_end, normal, eta**2, tapered, beside_cab, drawn)


@dataclass(frozen=True)
class _Corners:
    """Where lines of sight meet the outline with its arcs; those that miss it are assigned to the nearest corner.

    Attributes
    ----------
    enter : ndarray, shape (n,)
        Distance along each line of sight.
    normal : ndarray, shape (n, 2)
    round_, passes : ndarray of bool, shape (n,)
        Whether it meets an arc or passes by one; and whether it passes by.
    misses : ndarray, shape (n,)
        Distance by which a line of sight misses the arc; negative where it meets it.
    at_front : ndarray of bool, shape (n,)
        Whether the arc is one of the front's.
    within : ndarray, shape (n,)
        See `Hits`.
    """

    enter: FloatArray
    normal: FloatArray
    round_: BoolArray
    passes: BoolArray
    misses: FloatArray
    at_front: BoolArray
    within: FloatArray


def _meet_corners(rays: _Rays, sides: _Sides, half: FloatArray, shape: FloatArray) -> _Corners:
    origin, u, hit = rays.origin, rays.u, sides.hit
    corner = _corners(half, shape)
    beside = np.column_stack([-u[:, 1], u[:, 0]])
    aside = corner[:, :2] @ beside.T - dot_xy(origin, beside)
    met = origin + np.where(hit, sides.enter, rays.far)[:, None] * u
    away = np.stack([np.maximum(np.abs(met[:, 0] - x), np.abs(met[:, 1] - y)) for x, y in corner[:, :2]])
    which = np.where(hit, away, np.abs(aside)).argmin(axis=0)
    at, radius = corner[which, :2], corner[which, 2]
    outward = np.sign(at)
    centre = at - outward * radius[:, None]
    beyond = (met - centre) * outward > 0.0
    round_ = ~hit | (beyond[:, 0] & beyond[:, 1])
    off = dot_xy(centre - origin, beside)
    misses = np.abs(off) - radius
    t_arc = dot_xy(centre - origin, u) - np.sqrt(np.maximum(radius**2 - off**2, 0.0))
    passes = round_ & (misses >= 0.0)
    arc = round_ & ~passes
    radial = (origin + t_arc[:, None] * u - centre) / radius[:, None]
    normal = np.where(arc[:, None], radial, sides.normal)
    return _Corners(
        enter=np.where(arc, t_arc, np.where(passes, rays.far, sides.enter)),
        normal=np.where(passes[:, None], beside * -np.sign(off)[:, None], normal),
        round_=round_,
        passes=passes,
        misses=misses,
        at_front=outward[:, 0] > 0.0,
        within=np.where(hit, np.minimum(aside.max(axis=0), -aside.min(axis=0)), 0.0).clip(0.0),
    )


def _by_shape(rays: _Rays, sides: _Sides, corners: _Corners, shape: FloatArray) -> FloatArray:
    """Return the derivatives of the distances by the shape, shape (n, 11)."""
    round_, normal = corners.round_, corners.normal
    bent, tapered = np.where(round_, 1.0, sides.bent), np.where(round_, 1.0, sides.tapered)
    of_front = np.where(round_, corners.at_front, rays.ahead)
    of_end, of_side = round_ | sides.at_end, round_ | ~sides.at_end
    out_x, out_y = np.where(of_end, np.abs(normal[:, 0]), 0.0), np.where(of_side, np.abs(normal[:, 1]), 0.0)
    fading = 1.0 / (1.0 + np.exp(-shape[-2:] / SHARP_M))
    by_radius = np.where(round_, np.abs(normal[:, 0]) + np.abs(normal[:, 1]) - 1.0, 0.0) * np.where(of_front, *fading)
    by_shape = np.empty((len(normal), len(SHAPE)))
    by_ends = ((0, -out_x), (SHAPE.index("front_bow"), out_x * bent), (SHAPE.index("front_radius"), by_radius))
    for column, by_end in by_ends:  # the front's column, followed by the rear's
        by_shape[:, column], by_shape[:, column + 1] = np.where(of_front, by_end, 0.0), np.where(of_front, 0.0, by_end)
    by_shape[:, 2], by_shape[:, _LEVER_Y], by_shape[:, SHAPE.index("taper")] = -out_y, -normal[:, 1], out_y * tapered
    by_shape[:, _CAB] = out_y * np.where(round_, of_front, sides.beside_cab)
    by_shape[:, _SILL] = out_y * np.where(round_, 0.0, sides.drawn)
    return by_shape


def touch(xy: FloatArray, origin: FloatArray, to_left: BoolArray, size: tuple[float, float], shape: FloatArray) -> Hits:
    """Find by how much lines of sight miss the borders of an outline that they should touch.

    Whatever the points' ranges, a line of sight touches the outline at the corner that lies farthest to that side.

    Parameters
    ----------
    xy, origin : ndarray, shape (n, 2)
        Points and the sensor in the vehicle frame, metres.
    to_left : ndarray of bool, shape (n,)
        Whether the line of sight should touch the left border, so that the whole outline lies to its right.
    size, shape
        See `meet`.

    Returns
    -------
    Hits
        The ``distance`` is perpendicular to the line of sight and positive where it misses the outline. The
        ``variance`` is only that of a real body about the outline. The ``reach`` is the ratio of the distance at which
        the line of sight is nearest to that corner to the distance of the point.
    """
    middle, shape = about_middle(shape)
    xy, origin, (of_front, of_rear) = xy - middle, origin - middle, shape[-2:]
    corner = _corners(np.array(size) / 2, shape)
    outward = np.sign(corner[:, :2])
    centres = corner[:, :2] - outward * corner[:, 2:]
    far = np.hypot(*(xy - origin).T)
    ray = (xy - origin) / far[:, None]
    normal = np.where(to_left, 1.0, -1.0)[:, None] * perpendicular(ray)
    beyond = normal @ centres.T - dot_xy(normal, origin)[:, None] + corner[:, 2]
    which = beyond.argmax(axis=1)
    (out_x, out_y), front = np.abs(normal).T, outward[which, 0] > 0.0
    by_radius = (out_x + out_y - 1.0) / (1.0 + np.exp(-np.where(front, of_front, of_rear) / SHARP_M))
    ends = np.column_stack([front, ~front])
    by_end, no_sill = out_x[:, None] * ends, np.zeros(len(far))  # the waist is in view as well, and protrudes
    return Hits(
        distance=-beyond.max(axis=1),
        variance=np.full(len(far), OUTLINE_SIGMA_M**2 + CORNER_SIGMA_M**2),
        normal=normal,
        by_shape=np.column_stack(
            [-by_end, -out_y, -normal[:, 1], by_end, out_y, out_y * front, no_sill, by_radius[:, None] * ends]
        ),
        face=FACES + to_left,
        reach=dot_xy(centres[which] - origin, ray) / far,
        cos=np.zeros(len(far)),
        within=np.zeros(len(far)),
    )


def _tapered(xi: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the fraction of the sides' taper at places along them, from -1 to 1, and its derivative.

    The taper grows with the fourth power of the distance from the middle, that is over the length of a wing.
    """
    square = xi**2
    return square * square, 4.0 * square * xi


def _wheels(x: FloatArray, length_m: float) -> FloatArray:
    """Return how certain a wheel is at places along a car's side, shape (n,), from 0 to 1."""
    ahead, behind = ((0.5 - share) * length_m for share in OVERHANGS)
    away = np.minimum(np.abs(x - ahead), np.abs(x + behind))
    within, beyond = WHEEL_M
    wheels: FloatArray = np.clip((beyond - away) / (beyond - within), 0.0, 1.0)
    return wheels


def _leave(origin: FloatArray, u: FloatArray, half: FloatArray) -> FloatArray:
    """Return the distance along each line of sight at which it leaves the rectangle."""
    nearer: FloatArray = ((np.sign(u) * half - origin) / u).min(axis=1)
    return nearer


def _corners(half: FloatArray, shape: FloatArray) -> FloatArray:
    """Return where the four corners would be without their arcs, and their radii, shape (4, 3)."""
    longer, _, side, _, front_bow, rear_bow, taper, cab, _, *radii = shape
    x = np.array([half[0] + longer - front_bow, -half[0] - longer + rear_bow])
    y = half[1] + side - taper - np.array([cab, 0.0])
    radius = np.clip(SHARP_M * np.logaddexp(0.0, np.divide(radii, SHARP_M)), 1e-3, 0.9 * y)
    return np.array([[x[end], way * y[end], radius[end]] for end, way in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0))])


def expected_shape(width_m: float) -> tuple[FloatArray, FloatArray]:
    """Return prior mean and standard deviation of the shape of a vehicle of this width, shape (11,) each."""
    mean, sigma = SHAPE_MEAN.copy(), SHAPE_SIGMA.copy()
    if width_m >= HEAVY_WIDTH_M:
        mean[_CAB], sigma[_CAB] = HEAVY_CAB_M
        mean[_SILL], sigma[_SILL] = HEAVY_SILL_M
    return mean, sigma


def highest_of(width_m: float, face: IntArray, behind_m: FloatArray, *, matched: bool) -> FloatArray:
    """Return the height up to which a vehicle of this width is upright, shape (n,), metres.

    Parameters
    ----------
    width_m : float
    face : ndarray of int, shape (n,)
        Face that the line of sight meets.
    behind_m : ndarray, shape (n,)
        Distance behind the front end.
    matched : bool
        The points are from a matcher, not from a scanner.
    """
    ahead = (face == _FRONT) | (face == PASSED) | (behind_m < MIRRORS_M)
    if width_m >= HEAVY_WIDTH_M:
        return np.where(ahead, HEAVY_FRONT_HIGHEST_M, HEAVY_HIGHEST_M)
    if matched:
        return np.full(len(face), HIGHEST_M)
    ends = (face == _FRONT) | (face == _REAR)
    return np.select([ends, ahead], [ENDS_HIGHEST_M, HIGHEST_M], SIDES_HIGHEST_M)


def lowest_of(sigma_z: FloatArray) -> FloatArray:
    """Return the height above which points with this noise of their heights are surely not of the road, (n,), metres.

    Less than five standard deviations above the road, points in the far half of their noise were removed with the road.
    """
    lowest_m: FloatArray = np.maximum(LOWEST_M, GROUND_SIGMAS * sigma_z) + 2.0 * sigma_z
    return lowest_m


def on_the_wall(
    height_m: float, z: FloatArray, hits: Hits, sigma_z: FloatArray, blur_m: FloatArray, highest_m: FloatArray
) -> BoolArray:
    """Tell which lines of sight meet the outline at a height where it is upright.

    The height is that at which the line of sight meets the outline, not that of the noisy point: selecting by the
    point's own height would keep points of the wall that were measured too near and points of the bonnet that were
    measured too far. Where the noise of heights blurs the wall's lowest part into the road, the points below are kept
    as well (`Low`), so that none are missing. A line of sight that passes by the outline has no other height than that
    of its point.

    Parameters
    ----------
    height_m : float
        Height of the sensor above the ground.
    z, sigma_z : ndarray, shape (n,)
        Height of the points, and its standard deviation.
    hits : Hits
    blur_m : ndarray, shape (n,)
        Height above the wall's lower edge up to which what is below the edge still affects the points.
    highest_m : ndarray, shape (n,)
        See `highest_of`.
    """
    met = height_m + (z - height_m) * hits.reach
    all_kept = (GROUND_SIGMAS * sigma_z > LOWEST_M) & (hits.face != PASSED)
    lowest_m = np.where(all_kept, LOWEST_M + blur_m * hits.reach, lowest_of(sigma_z))
    chosen: BoolArray = (met > lowest_m) & (met < highest_m)
    return chosen
