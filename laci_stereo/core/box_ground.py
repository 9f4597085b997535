"""The ground plane below the boxes of a detector, which stand on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from laci_stereo.core.errors import GroundError
from laci_stereo.core.frames import Axes, BoolArray, FloatArray, IntArray, transform
from laci_stereo.core.ground import GroundPlane
from laci_stereo.core.ground_start import can_be_ground, where_it_can_be
from laci_stereo.core.robust import NORMAL, weighted_median
from laci_stereo.core.settings import GroundSettings

MIN_SPREAD_M = 0.9
"""The boxes must be spread by this standard deviation across the line along which they are spread most: half a car's
width, by which a box's centre may be off. The traffic of one straight lane has 0.3 m, that of two has 1.7 m."""

MIN_STRETCHES = 6
"""Twice as many independent stretches of road as a plane has unknowns, or what remains says nothing about its error."""

LEVEL_SIGMA_DEG = 0.25
"""What is meant by vertical: half of a graduation of a circular bubble, 30 minutes of arc for 2 mm."""

HEIGHT_SIGMA_M = 0.05
"""What is meant by a sensor's height where a person tells it: measured from its middle, by tape, to the decimetre."""

SLOPE_SIGMA = 0.03
"""How steep a road is where a sensor stands level above it: 6 % are two standard deviations."""

BENT_PER_M = 1.0 / 2100.0
"""How much a road is bent along its way: the tightest crest for 50 km/h has a radius of 700 m, which is taken for three
standard deviations (AASHTO, A Policy on Geometric Design of Highways and Streets: 7 m for each percent of slope)."""

_GATE = 3.0
"""Boxes within so many standard deviations stand on the plane; of normal noise that is all but 0.3 %."""

_CELL_M = 1.0
"""All boxes of one object within this distance count once, so that a vehicle that waits does not outweigh the rest."""

_START_SCALE_M = 0.01
"""The start minimises distances rather than squares: this is less than any detector's noise."""

_EXACT_M = 1e-3
"""No box is more exact, so this much never makes an outlier."""

_STEPS = 20
"""Each step turns the plane by what is left of its error times noise over spread, so a few reach any precision."""


def level_ground(height_m: float, axes: Axes) -> GroundPlane:
    """Return the ground below a sensor whose up axis is vertical.

    Parameters
    ----------
    height_m : float
        Of the sensor above the ground.
    axes : Axes
    """
    up = np.asarray(axes.up, dtype=np.float64)
    tilt = np.radians(LEVEL_SIGMA_DEG) ** 2
    ground = GroundPlane(up / np.linalg.norm(up), height_m, np.zeros((4, 4)), 0.0, 0, 0.0, 0.0, 0.0)
    return replace(ground, covariance_sensor=_in_sensor(np.diag([tilt, tilt, HEIGHT_SIGMA_M**2]), ground, axes))


@dataclass(frozen=True)
class Below:
    """Where the boxes' own heights have the ground below a sensor that is said to be level.

    Attributes
    ----------
    height_m, height_sigma_m : float
        How high the sensor stands, and one standard deviation.
    slope, slope_sigma : float
        How steeply the ground falls or rises, in the direction in which it does so most: 0 where the sensor's up axis
        is at right angles to it.
    """

    height_m: float
    height_sigma_m: float
    slope: float
    slope_sigma: float


def ground_below(points: FloatArray, above_ground_m: FloatArray, axes: Axes) -> Below:
    """Return where the boxes' own heights have the ground below a sensor that is said to be level.

    The road may rise, and bend up to where the boxes are; and boxes may all err alike, as one of them does.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Of each box, sensor frame, metres; at least one.
    above_ground_m : ndarray, shape (n,)
        How high that point is above the ground.
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
        noise_m = max(float(np.median(off_m)) * NORMAL, _EXACT_M)
        near = off_m <= _GATE * noise_m
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
    """Fit the plane that the boxes stand on.

    A robust start; then principal axes of the boxes near the plane: their heights over it are fitted by a plane, step
    by step, until that is the same one. What one object's boxes err by lasts for a while, so they are not independent;
    of what remains, the correlation along the tracks tells how many are.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Of each box, sensor frame, metres.
    above_ground_m : ndarray, shape (n,)
        How high that point is above the ground.
    objects : sequence of ndarray of int64
        Which boxes are of one object, in the order of time.
    axes : Axes
    settings : GroundSettings

    Raises
    ------
    GroundError
        If they do not span a plane, or none that can be the ground.
    """
    if len(points) < settings.min_points:
        raise GroundError(
            f"boxes with z and height: {len(points)} found, at least {settings.min_points} needed to find the ground; "
            "or say --level HEIGHT"
        )
    ground = _start(points, above_ground_m, axes)
    boxes = _counted(points, above_ground_m, objects, ground, axes)
    for _ in range(_STEPS):
        ground = _turned(ground, _heights(boxes, ground, axes).correction(), axes)
    heights = _heights(boxes, ground, axes)
    _check(heights, ground, axes, settings)
    covariance = heights.covariance(settings.shared_noise_share)
    tilt_deg = float(np.degrees(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1])))
    if tilt_deg > settings.max_tilt_sigma_deg:
        raise GroundError(
            f"standard deviation of the tilt of the plane below the boxes: {tilt_deg:.2f} deg found, at most "
            f"{settings.max_tilt_sigma_deg:g} deg needed; record more traffic, or say --level HEIGHT"
        )
    near = float(heights.near.mean())
    return replace(
        ground,
        covariance_sensor=_in_sensor(covariance, ground, axes),
        inlier_share=near,
        support_cells=int(heights.stretches()),
        support_share=near,
        support_area_m2=12 * float(np.prod(heights.spread_m())),  # of the rectangle that is spread like that
        unevenness_m=heights.sigma_m(),
    )


@dataclass(frozen=True)
class _Boxes:
    """Boxes, one object after the other: place in the sensor frame, height over ground, object, weight."""

    points: FloatArray
    above_m: FloatArray
    label: IntArray
    weight: FloatArray


@dataclass(frozen=True)
class _Heights:
    """How high boxes, which should stand on a plane, are above it, and where they are on it (level frame)."""

    xy: FloatArray
    above_m: FloatArray
    label: IntArray
    weight: FloatArray
    near: BoolArray

    @property
    def design(self) -> FloatArray:
        """What a small rotation about level x and y and a lift change about the heights, shape (n, 3)."""
        return np.column_stack([self.xy[:, 1], -self.xy[:, 0], np.ones(len(self.xy))])

    @property
    def information(self) -> FloatArray:
        """Of one standard deviation of 1 m, shape (3, 3)."""
        information: FloatArray = (self.design * self.weight[:, None]).T @ self.design
        return information

    def correction(self) -> FloatArray:
        """Return the rotation and lift, shape (3,), after which the plane lies below the boxes."""
        found: FloatArray = -np.linalg.pinv(self.information) @ (self.design.T @ (self.weight * self.above_m))
        return found

    def spread_m(self) -> FloatArray:
        """Return the standard deviations of the places across and along the line of largest spread."""
        return self._spread()[0]

    def _spread(self) -> tuple[FloatArray, FloatArray]:
        """Return the same, and the directions, shape (2, 2): one each column."""
        squares, axes = np.linalg.eigh(np.cov(self.xy.T, aweights=self.weight, ddof=0))
        return np.sqrt(squares.clip(0.0)), axes

    def sigma_m(self) -> float:
        """Return the standard deviation of the heights."""
        return float(np.sqrt(np.average(self.above_m**2, weights=self.weight)))

    def stretches(self) -> float:
        """Return how many of the boxes are independent, by the correlation of their heights along the tracks.

        The sum over lags ends where they are not correlated any more (Geyer's initial positive sequence), else what
        the fit takes out of few tracks would count as correlation. What is below a box's last digit is no height.
        """
        weighted = self.weight * self.above_m
        squares = float((weighted * self.above_m).sum() + self.weight.sum() * _EXACT_M**2)
        total = squares
        for lag in range(1, len(weighted)):
            same = self.label[lag:] == self.label[:-lag]
            pairs = float((weighted[lag:] * weighted[:-lag])[same].sum())
            if pairs <= 0.0:
                break
            total += 2 * pairs
        return float(self.weight.sum()) * squares / total

    def covariance(self, shared_share: float) -> FloatArray:
        """Return the covariance of (rotation about level x, about level y, height); of the noise a share is common."""
        stretches = self.stretches()
        inflation = self.weight.sum() / (stretches - 3)
        variance = self.sigma_m() ** 2 * inflation
        covariance: FloatArray = np.linalg.inv(self.information) * variance + self._bent(variance)
        covariance[2, 2] += (shared_share * self.sigma_m()) ** 2
        return covariance

    def _bent(self, variance_m2: float) -> FloatArray:
        """Return what the road's bending leaves unknown of the plane, shape (3, 3).

        On a bent road the slope is another one a standard deviation of the boxes' places farther on, along and across.
        How bent it is, the heights tell as far as they do; of the rest, what is known of roads (`BENT_PER_M`).

        Parameters
        ----------
        variance_m2 : float
            Of the heights, in units of their weights.
        """
        middle = np.average(self.xy, axis=0, weights=self.weight)
        spread_m, axes = self._spread()
        along = (self.xy - middle) @ axes
        design = np.column_stack([self.design, along**2 / 2.0])
        prior = np.diag([0.0, 0.0, 0.0, 1.0, 1.0]) * variance_m2 / BENT_PER_M**2
        inverse = np.linalg.pinv((design * self.weight[:, None]).T @ design + prior)
        bend = inverse @ (design.T @ (self.weight * self.above_m))
        squared = bend[3:] ** 2 + variance_m2 * np.diag(inverse)[3:]
        # A slope along (x, y) is a turn about (-y, x).
        about = np.stack([-axes[1], axes[0]])
        unknown = np.zeros((3, 3))
        unknown[:2, :2] = (about * squared * spread_m**2) @ about.T
        return unknown


def _start(points: FloatArray, above_m: FloatArray, axes: Axes) -> GroundPlane:
    """Return the plane with the least sum of distances, in the frame that the sensor's own axes call level."""
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
    # z = a x + b y + c is turned by b about x, by -a about y; the plane lies at -height.
    return _turned(level, np.array([-b, a, -c]), axes)


def _counted(
    points: FloatArray, above_m: FloatArray, objects: Sequence[IntArray], ground: GroundPlane, axes: Axes
) -> _Boxes:
    """Line boxes up by object, and let each object count once in each cell of the road."""
    rows = np.concatenate(objects)
    label = np.repeat(np.arange(len(objects)), [len(one) for one in objects])
    cells = np.floor(transform(ground.T_level_sensor(axes), points[rows])[:, :2] / _CELL_M).astype(np.int64)
    _, where, counts = np.unique(np.column_stack([label, cells]), axis=0, return_inverse=True, return_counts=True)
    return _Boxes(points[rows], above_m[rows], label, 1.0 / counts[where.reshape(-1)])


def _heights(boxes: _Boxes, ground: GroundPlane, axes: Axes) -> _Heights:
    """Hold boxes against a plane; what is far above or below it does not stand on it."""
    level = transform(ground.T_level_sensor(axes), boxes.points)
    above_m = level[:, 2] - boxes.above_m
    middle = weighted_median(above_m, boxes.weight)
    sigma_m = NORMAL * weighted_median(np.abs(above_m - middle), boxes.weight)
    near = np.abs(above_m - middle) <= _GATE * sigma_m + _EXACT_M
    return _Heights(level[:, :2], above_m, boxes.label, np.where(near, boxes.weight, 0.0), near)


def _turned(ground: GroundPlane, by: FloatArray, axes: Axes) -> GroundPlane:
    """Turn a plane about level x and y by small angles, and lift the sensor over it."""
    x, y, lift_m = by
    normal = ground.T_level_sensor(axes)[:3, :3].T @ np.array([-y, x, 1.0])
    length = float(np.linalg.norm(normal))
    return replace(ground, normal=normal / length, height_m=(ground.height_m + float(lift_m)) / length)


def _in_sensor(covariance: FloatArray, ground: GroundPlane, axes: Axes) -> FloatArray:
    """Carry a covariance of (rotation about level x, about level y, height) over to `covariance_sensor`."""
    to_sensor = np.zeros((4, 3))
    to_sensor[:3, :2] = ground.T_level_sensor(axes)[:2, :3].T
    to_sensor[3, 2] = 1.0
    carried: FloatArray = to_sensor @ covariance @ to_sensor.T
    return carried


def _check(heights: _Heights, ground: GroundPlane, axes: Axes, settings: GroundSettings) -> None:
    spread_m = float(heights.spread_m()[0])
    if spread_m < MIN_SPREAD_M:
        raise GroundError(
            f"the boxes lie on one line: {spread_m:.2f} m of spread across it found, at least {MIN_SPREAD_M:g} m "
            "needed to tell how the ground is tilted; record traffic on other lanes or a turn, or say --level HEIGHT"
        )
    stretches = heights.stretches()
    if stretches < MIN_STRETCHES:
        raise GroundError(
            f"independent stretches of road under the boxes: {stretches:.1f} found, at least {MIN_STRETCHES} needed to "
            "find the ground; record more traffic, or say --level HEIGHT"
        )
    up = np.asarray(axes.up, dtype=np.float64)
    too_near = ground.height_m < settings.min_height_m
    if too_near or not can_be_ground((-ground.normal / ground.height_m)[None], up / np.linalg.norm(up), settings)[0]:
        tilt_deg = np.degrees(np.arccos(np.clip(ground.normal @ up, -1.0, 1.0)))
        raise GroundError(
            f"plane below the boxes: {tilt_deg:.1f} deg from up, {ground.height_m:.2f} m below found, "
            f"{where_it_can_be(settings)}; or say --level HEIGHT"
        )
