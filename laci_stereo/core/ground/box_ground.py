"""The ground plane below the boxes of a detector, on the assumption that the boxes stand on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import f as fisher

from laci_stereo.core.errors import GroundError
from laci_stereo.core.frames import Axes, FloatArray, IntArray, transform
from laci_stereo.core.ground.axes import ground_elsewhere
from laci_stereo.core.ground.box_heights import (
    BENT_PER_M,
    BOX_HEIGHT_SIGMA_M,
    EXACT_M,
    HeightFit,
    Heights,
    counted,
    fit_heights,
    heights_above,
)
from laci_stereo.core.ground.plane import GroundPlane
from laci_stereo.core.ground.rays import GATE
from laci_stereo.core.ground.start import can_be_ground, where_it_can_be
from laci_stereo.core.robust import NORMAL
from laci_stereo.core.settings import GroundSettings

MIN_SPREAD_M = 0.9
"""Least standard deviation of the boxes' places across the line of their largest spread: half a car's width, by which a
box's centre may be off. The traffic of one straight lane has 0.3 m, that of two lanes 1.7 m."""

MIN_STRETCHES = 6
"""Least number of independent stretches of road: twice the number of a plane's unknowns, below which the residuals do
not determine its error."""

LEVEL_SIGMA_DEG = 0.25
"""Standard deviation of a vertical axis about each horizontal axis: half a graduation of a circular bubble, 30 minutes
of arc for 2 mm."""

LEVEL_SIGMA_RAD = float(np.radians(LEVEL_SIGMA_DEG))

HEIGHT_SIGMA_M = 0.05
"""Standard deviation of a sensor's height as given by the user: measured from its middle, by tape, to the decimetre."""

SLOPE_SIGMA = 0.03
"""Standard deviation of a road's slope relative to a level sensor: 6 % are two standard deviations."""

LOOSER = 3.0
"""Factor by which the tilt of a plane below boxes may be known less well than that of one through a cloud: a plane as
unsure as that is no sign that something else was taken for the ground, and up to there the verdict is a warning."""

FEWEST_BOXES = 10
"""With fewer boxes, the median height of an object has more than two fifths of the noise of one box."""

CLEARLY = 100.0
"""Odds, to 1, beyond which a result is not given without a warning, as in `MatchSettings`."""

_START_SCALE_M = 0.01
"""Scale of the robust loss of the start, less than any detector's noise, so that distances rather than squares are
minimised."""

_STEPS = 20
"""Largest number of steps: each leaves a fraction of the error, the ratio of noise to spread, so a few reach any
precision."""

_STILL = 1e-9
"""Correction, in radians and metres, below which there are no more steps: far below any noise."""


def level_ground(height_m: float, axes: Axes, tilt_sigma_rad: float = LEVEL_SIGMA_RAD) -> GroundPlane:
    """Return the ground below a sensor whose up axis is vertical.

    Parameters
    ----------
    height_m : float
        Height of the sensor above the ground.
    axes : Axes
    tilt_sigma_rad : float
        Standard deviation of the up axis about each horizontal axis.
    """
    up = np.asarray(axes.up, dtype=np.float64)
    tilt = tilt_sigma_rad**2
    ground = GroundPlane(up / np.linalg.norm(up), height_m, np.zeros((4, 4)), 0.0, 0, 0.0, 0.0, 0.0)
    return replace(ground, covariance_sensor=_in_sensor(np.diag([tilt, tilt, HEIGHT_SIGMA_M**2]), ground, axes))


@dataclass(frozen=True)
class Below:
    """The ground according to the boxes' own heights, below a sensor that the user states to be level.

    Attributes
    ----------
    height_m, height_sigma_m : float
        Height of the sensor above the ground, and its standard deviation.
    slope, slope_sigma : float
        Slope of the ground in its steepest direction, and its standard deviation: 0 where the sensor's up axis is
        perpendicular to the ground.
    """

    height_m: float
    height_sigma_m: float
    slope: float
    slope_sigma: float


def ground_by_heights(points: FloatArray, above_ground_m: FloatArray, axes: Axes) -> Below:
    """Return the ground according to the boxes' own heights, below a sensor that the user states to be level.

    The standard deviations allow for a slope of the road, for its curvature between the sensor and the boxes, and for
    an error of the size of one box's noise that all boxes share.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Reference point of each box, sensor frame, metres; at least one.
    above_ground_m : ndarray, shape (n,)
        Height of that point above the ground.
    axes : Axes
    """
    up = np.asarray(axes.up, dtype=np.float64)
    up /= np.linalg.norm(up)
    below_m = above_ground_m - points @ up
    across = np.linalg.svd(up[None])[2][1:]
    plan = np.column_stack([np.ones(len(points)), points @ across.T])
    prior = np.diag([0.0, SLOPE_SIGMA**-2, SLOPE_SIGMA**-2])
    value = np.array([np.median(below_m), 0.0, 0.0])
    for _ in range(_STEPS):
        off_m = np.abs(below_m - plan @ value)
        noise_m = max(float(np.median(off_m)) * NORMAL, EXACT_M)
        near = off_m <= GATE * noise_m
        information = plan[near].T @ plan[near] / noise_m**2 + prior
        value = np.linalg.solve(information, plan[near].T @ below_m[near] / noise_m**2)
    far_m2 = float(np.median((plan[:, 1:] ** 2).sum(axis=1)))
    covariance, slope = np.linalg.inv(information), float(np.hypot(*value[1:]))
    sigma_m = float(np.sqrt(noise_m**2 + (BENT_PER_M / 2 * far_m2) ** 2 + covariance[0, 0]))
    steepest = value[1:] / max(slope, 1e-12)
    variance = float(steepest @ covariance[1:, 1:] @ steepest) + BENT_PER_M**2 / 4 * far_m2
    return Below(float(value[0]), sigma_m, slope, float(np.sqrt(variance)))


def plane_below(
    points: FloatArray, above_ground_m: FloatArray, objects: Sequence[IntArray], axes: Axes, settings: GroundSettings
) -> GroundPlane:
    """Fit the plane on which the boxes stand.

    After a robust start, the heights of the boxes near the plane are fitted by a correction of the plane, step by step
    until it converges. The boxes of one object share an error of their own, as a detector errs about its height: where
    each of two lanes has few objects, these errors look like a tilt, while along each object's path they change
    nothing. They are random effects of the fit (see `fit_heights`). Other errors persist for a while along a path: the
    effective number of independent boxes is estimated from the correlation of the residuals.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Reference point of each box, sensor frame, metres.
    above_ground_m : ndarray, shape (n,)
        Height of that point above the ground.
    objects : sequence of ndarray of int64
        Indices of the boxes of each object, in the order of time.
    axes : Axes
    settings : GroundSettings

    Raises
    ------
    GroundError
        If there are too few boxes, or if they do not span a plane, or one that cannot be the ground.
    """
    _check_count(points, settings)
    ground, heights = _fitted(points, above_ground_m, objects, axes)
    fit = fit_heights(heights)
    _check(fit, ground, axes, settings)
    covariance = fit.covariance(settings.shared_noise_share)
    tilt_deg = float(np.degrees(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1])))
    largest_deg = LOOSER * settings.max_tilt_sigma_deg
    if tilt_deg > largest_deg:
        raise GroundError(
            f"standard deviation of the tilt of the plane below the boxes: {tilt_deg:.2f} deg found, at most "
            f"{largest_deg:g} deg needed; record more traffic, or say --level HEIGHT"
        )
    near = float(heights.near.mean())
    return replace(
        ground,
        covariance_sensor=_in_sensor(covariance, ground, axes),
        inlier_share=near,
        support_cells=int(heights.stretches()),
        support_share=near,
        support_area_m2=12 * float(np.prod(fit.spread_m)),  # of a rectangle with this spread
        unevenness_m=heights.sigma_m(),
    )


@dataclass(frozen=True)
class Unlike:
    """How far objects are off the plane below their boxes, by two points of the boxes that positions may be of.

    Attributes
    ----------
    given_m, other_m : float
        Standard deviations of the objects' heights above the plane, by the given and by the other point.
    """

    given_m: float
    other_m: float


def unlike_origin(
    points: FloatArray,
    above_m: tuple[FloatArray, FloatArray],
    objects: Sequence[IntArray],
    axes: Axes,
    settings: GroundSettings,
) -> Unlike | None:
    """Return how well objects stand on one plane if the other point clearly fits better than the given one, else None.

    By the wrong point an object is off by half of its height, which those of different heights are not by one plane.
    Each object counts once, by its median height above the plane, as its errors persist, and the worst one by either
    point does not count, so that no single object decides. Both variances over the objects are of the same boxes, and
    share the errors of positions and road, so their ratio disperses less than that of independent ones (Fisher's F),
    whose quantile at odds of `CLEARLY` to 1 it has to exceed. Where only the given point brings in the error of the
    boxes' heights (`BOX_HEIGHT_SIGMA_M`), the other one gets it, too: among vehicles of one height this error would
    always speak for the other.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Reference point of each box, sensor frame, metres.
    above_m : tuple of ndarray, shape (n,)
        Height of that point above the ground: as given, and if it is the boxes' other point, NaN where unknown.
    objects : sequence of ndarray of int64
        Indices of the boxes of each object; those with fewer than `FEWEST_BOXES` do not count.
    axes : Axes
    settings : GroundSettings
    """
    both = np.isfinite(above_m[1])
    objects = [kept for rows in objects if len(kept := rows[both[rows]]) >= FEWEST_BOXES]
    freedom = len(objects) - 3  # a plane has three unknowns
    if freedom < 1:
        return None
    rows = np.concatenate(objects)
    points, above_m = points[rows], (above_m[0][rows], above_m[1][rows])
    objects = np.split(np.arange(len(rows)), np.cumsum([len(one) for one in objects])[:-1])
    (_, given_m), (ground, other_m) = (_scatter_m(points, above, objects, axes) for above in above_m)
    brought_m = BOX_HEIGHT_SIGMA_M / 2 if np.median(above_m[0]) > 0.0 else 0.0
    needed = float(fisher.ppf(1.0 - 1.0 / CLEARLY, freedom, freedom))
    clearly = given_m**2 > needed * (other_m**2 + brought_m**2 + EXACT_M**2)
    return Unlike(given_m, other_m) if clearly and _can_be_ground(ground, axes, settings) else None


def _scatter_m(
    points: FloatArray, above_m: FloatArray, objects: Sequence[IntArray], axes: Axes
) -> tuple[GroundPlane, float]:
    """Return the plane below the boxes, and the standard deviation of the objects' heights above it but the worst's."""
    ground, _ = _fitted(points, above_m, objects, axes)
    level_m = transform(ground.T_level_sensor(axes), points)[:, 2] - above_m
    off_m = np.sort([abs(np.median(level_m[rows])) for rows in objects])[:-1]
    return ground, float(np.sqrt((off_m**2).sum() / (len(objects) - 3)))


def first_plane(points: FloatArray, above_ground_m: FloatArray, axes: Axes, settings: GroundSettings) -> GroundPlane:
    """Return the robust start of `plane_below`, for boxes that are not linked to objects yet, whatever it is like.

    Raises
    ------
    GroundError
        If there are too few boxes.
    """
    _check_count(points, settings)
    return _start(points, above_ground_m, axes)


def elsewhere_below(
    points: FloatArray, above_ground_m: FloatArray, objects: Sequence[IntArray], axes: Axes, settings: GroundSettings
) -> str:
    """Return the words of `ground_elsewhere` for boxes; the parameters are those of `plane_below`."""

    def below(up: tuple[float, float, float]) -> GroundPlane:
        forward = (0.0, 1.0, 0.0) if up[0] else (1.0, 0.0, 0.0)
        return plane_below(points, above_ground_m, objects, Axes(forward, up), settings)

    return ground_elsewhere(axes, below)


def _fitted(
    points: FloatArray, above_m: FloatArray, objects: Sequence[IntArray], axes: Axes
) -> tuple[GroundPlane, Heights]:
    """Return the plane below the boxes, whatever it is like, and the boxes' heights above it."""
    ground = _start(points, above_m, axes)
    boxes = counted(points, above_m, objects, ground, axes)
    for _ in range(_STEPS):
        correction = fit_heights(heights_above(boxes, ground, axes)).correction
        ground = _turned(ground, correction, axes)
        if np.abs(correction).max() < _STILL:
            break
    return ground, heights_above(boxes, ground, axes)


def _start(points: FloatArray, above_m: FloatArray, axes: Axes) -> GroundPlane:
    """Return the plane with the least sum of distances from the boxes' bottoms, measured along the sensor's up axis."""
    level = GroundPlane(np.asarray(axes.up, dtype=np.float64), 0.0, np.zeros((4, 4)), 0.0, 0, 0.0, 0.0, 0.0)
    x, y, z = transform(level.T_level_sensor(axes), points).T
    bottom = z - above_m
    design = np.column_stack([x, y, np.ones(len(x))])

    def off(plane: FloatArray) -> FloatArray:
        distance: FloatArray = design @ plane - bottom
        return distance

    begin = np.array([0.0, 0.0, float(np.median(bottom))])
    fitted = least_squares(off, begin, loss="soft_l1", f_scale=_START_SCALE_M, x_scale="jac")
    a, b, c = fitted.x
    # z = a x + b y + c is rotated by b about x and by -a about y; c is the negative height.
    return _turned(level, np.array([-b, a, -c]), axes)


def _turned(ground: GroundPlane, by: FloatArray, axes: Axes) -> GroundPlane:
    """Rotate a plane about level x and y by small angles, and raise the sensor above it."""
    x, y, lift_m = by
    normal = ground.T_level_sensor(axes)[:3, :3].T @ np.array([-y, x, 1.0])
    length = float(np.linalg.norm(normal))
    return replace(ground, normal=normal / length, height_m=(ground.height_m + float(lift_m)) / length)


def _in_sensor(covariance: FloatArray, ground: GroundPlane, axes: Axes) -> FloatArray:
    """Convert a covariance of (rotation about level x, about level y, height) to `GroundPlane.covariance_sensor`."""
    to_sensor = np.zeros((4, 3))
    to_sensor[:3, :2] = ground.T_level_sensor(axes)[:2, :3].T
    to_sensor[3, 2] = 1.0
    carried: FloatArray = to_sensor @ covariance @ to_sensor.T
    return carried


def _check_count(points: FloatArray, settings: GroundSettings) -> None:
    if len(points) < settings.min_points:
        raise GroundError(
            f"boxes with z and height: {len(points)} found, at least {settings.min_points} needed to find the ground; "
            "or say --level HEIGHT"
        )


def _can_be_ground(ground: GroundPlane, axes: Axes, settings: GroundSettings) -> bool:
    """Return whether a plane is where the ground may be."""
    if ground.height_m < settings.min_height_m:
        return False
    up = np.asarray(axes.up, dtype=np.float64)
    return bool(can_be_ground((-ground.normal / ground.height_m)[None], up / np.linalg.norm(up), settings)[0])


def _check(fit: HeightFit, ground: GroundPlane, axes: Axes, settings: GroundSettings) -> None:
    spread_m = float(fit.spread_m[0])
    if spread_m < MIN_SPREAD_M:
        raise GroundError(
            f"the boxes lie on one line: {spread_m:.2f} m of spread across it found, at least {MIN_SPREAD_M:g} m "
            "needed to tell how the ground is tilted; record traffic on other lanes or a turn, or say --level HEIGHT"
        )
    if fit.freedom < MIN_STRETCHES:
        raise GroundError(
            f"independent stretches of road under the boxes: {fit.freedom:.1f} found, at least {MIN_STRETCHES} needed "
            "to find the ground; record more traffic, or say --level HEIGHT"
        )
    if not _can_be_ground(ground, axes, settings):
        up = np.asarray(axes.up, dtype=np.float64)
        tilt_deg = np.degrees(np.arccos(np.clip(ground.normal @ up, -1.0, 1.0)))
        raise GroundError(
            f"plane below the boxes: {tilt_deg:.1f} deg from up, {ground.height_m:.2f} m below found, "
            f"{where_it_can_be(settings)}; or say --level HEIGHT"
        )
