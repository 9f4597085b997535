"""Heights of a detector's boxes above a plane: which stand on it, and the plane, bends and errors that explain them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from laci_stereo.core.frames import Axes, BoolArray, FloatArray, IntArray, transform
from laci_stereo.core.ground.plane import GroundPlane
from laci_stereo.core.ground.rays import GATE
from laci_stereo.core.robust import NORMAL, weighted_median

BENT_PER_M = 1.0 / 2100.0
"""Standard deviation of a road's vertical curvature along its course: the tightest crest for 50 km/h has a radius of
700 m, which is taken as three standard deviations (AASHTO, A Policy on Geometric Design of Highways and Streets: 7 m
for each percent of slope)."""

BOX_HEIGHT_SIGMA_M = 0.15
"""Standard deviation of the error of an object's height that persists in all of its boxes: a tenth of a car's."""

OBJECT_SIGMA_M = BOX_HEIGHT_SIGMA_M / 2
"""Standard deviation of the error of an object's bottom that persists in all of its boxes, before any is seen: what is
known is the height of its centre, and half of its height is subtracted."""

OBJECT_WEIGHT = 1.0
"""Number of objects as which `OBJECT_SIGMA_M` counts when this standard deviation is estimated from the objects."""

_CELL_M = 1.0
"""Side of the cells in which all boxes of one object count once, so that a waiting vehicle does not outweigh the
rest."""

_WINDOW_M = 5.0
"""Length of the path over which an object's places are averaged: a car's length, over which it drives straight on."""

EXACT_M = 1e-3
"""Least noise of a box's height: no detector is more exact, so a deviation of this size is never an outlier."""

_CONVERGED = 1e-3
"""Relative change of the variances at which their estimation ends: far below their own uncertainty."""

_STEPS = 20
"""Largest number of steps of the estimation of the variances."""


@dataclass(frozen=True)
class Boxes:
    """Boxes, ordered by object: point in the sensor frame, its height above ground, index of the object, weight.

    ``smoothed`` are the points as `_smoothed` returns them: their noise would otherwise count as places on the road.
    """

    points: FloatArray
    smoothed: FloatArray
    above_m: FloatArray
    label: IntArray
    weight: FloatArray


@dataclass(frozen=True)
class Heights:
    """Heights of the boxes above a plane on which they should stand, and their places on it (level frame)."""

    xy: FloatArray
    above_m: FloatArray
    label: IntArray
    weight: FloatArray
    near: BoolArray

    @property
    def design(self) -> FloatArray:
        """Derivative of the heights by small rotations about level x and y and a vertical shift, shape (n, 3)."""
        return np.column_stack([self.xy[:, 1], -self.xy[:, 0], np.ones(len(self.xy))])

    def spread(self) -> tuple[FloatArray, FloatArray]:
        """Return the standard deviations of the places across and along the line of largest spread, and these axes.

        Returns
        -------
        spread_m : ndarray, shape (2,)
        axes : ndarray, shape (2, 2)
            As columns.
        """
        squares, axes = np.linalg.eigh(np.cov(self.xy.T, aweights=self.weight, ddof=0))
        return np.sqrt(squares.clip(0.0)), axes

    def sigma_m(self) -> float:
        """Return the weighted root mean square of the heights."""
        return float(np.sqrt(np.average(self.above_m**2, weights=self.weight)))

    def stretches(self) -> float:
        """Return the effective number of independent boxes, from the correlation of their heights along the tracks.

        The sum over lags ends where the correlation is no longer positive (Geyer's initial positive sequence), since
        with few tracks the degrees of freedom of the fit would otherwise count as correlation. Heights below `EXACT_M`
        count as independent noise.
        """
        weighted = self.weight * self.above_m
        squares = float((weighted * self.above_m).sum() + self.weight.sum() * EXACT_M**2)
        total = squares
        for lag in range(1, len(weighted)):
            same = self.label[lag:] == self.label[:-lag]
            pairs = float((weighted[lag:] * weighted[:-lag])[same].sum())
            if pairs <= 0.0:
                break
            total += 2 * pairs
        return float(self.weight.sum()) * squares / total


@dataclass(frozen=True)
class HeightFit:
    """The plane and the bends of the road that fit the boxes' heights.

    Attributes
    ----------
    unknowns : ndarray, shape (5,)
        Rotations about level x and y and vertical shift of what the heights are measured above, and the curvatures of
        the road across and along the line of largest spread, 1/m.
    unknowns_covariance : ndarray, shape (5, 5)
    noise_m, object_m : float
        Standard deviations of one box's height, and of the part that all boxes of one object share.
    freedom : float
        Effective number of boxes whose errors about their object's mean are independent, less the number of objects.
    spread_m, axes : ndarray, shape (2,), (2, 2)
        As `Heights.spread` returns them.
    """

    unknowns: FloatArray
    unknowns_covariance: FloatArray
    noise_m: float
    object_m: float
    freedom: float
    spread_m: FloatArray
    axes: FloatArray

    @property
    def correction(self) -> FloatArray:
        """The rotations and vertical shift, shape (3,), that move the plane below the boxes."""
        back: FloatArray = -self.unknowns[:3]
        return back

    def covariance(self, shared_share: float) -> FloatArray:
        """Return the covariance of (rotation about level x, about level y, height), shape (3, 3).

        On a bent road the slope changes over one standard deviation of the boxes' places, along and across.
        ``shared_share`` is the fraction of the heights' standard deviation that is an error shared by all boxes.
        """
        covariance: FloatArray = self.unknowns_covariance[:3, :3].copy()
        squared = self.unknowns[3:] ** 2 + np.diag(self.unknowns_covariance)[3:]
        # A slope along (x, y) is a rotation about (-y, x).
        about = np.stack([-self.axes[1], self.axes[0]])
        covariance[:2, :2] += (about * squared * self.spread_m**2) @ about.T
        covariance[2, 2] += shared_share**2 * (self.noise_m**2 + self.object_m**2)
        return covariance


def fit_heights(heights: Heights) -> HeightFit:
    """Fit the plane, the road's bends and each object's own error to the boxes' heights.

    The objects' errors are random effects of a linear mixed model (Laird and Ware, Random-Effects Models for
    Longitudinal Data, Biometrics 38, 1982), which are eliminated from the normal equations. Their variance is estimated
    by expectation maximisation, with `OBJECT_SIGMA_M` as that of `OBJECT_WEIGHT` more objects, since few objects leave
    little over: a plane goes through any three. The curvatures have the prior for roads (`BENT_PER_M`).
    """
    spread_m, axes = heights.spread()
    along = (heights.xy - np.average(heights.xy, axis=0, weights=heights.weight)) @ axes
    bends = along**2 / 2
    bends -= np.average(bends, axis=0, weights=heights.weight)
    design = np.column_stack([heights.design, bends])
    prior = np.diag([0.0, 0.0, 0.0, 1.0, 1.0]) / BENT_PER_M**2

    def of_objects(values: FloatArray) -> FloatArray:
        summed: FloatArray = np.zeros((heights.label.max() + 1, *values.shape[1:]))
        np.add.at(summed, heights.label, (values.T * heights.weight).T)
        return summed

    weight, designs, above_m = (of_objects(each) for each in (np.ones(len(design)), design, heights.above_m))
    total, objects = float(weight.sum()), int((weight > 0.0).sum())
    squares, product = design.T @ (design.T * heights.weight).T, design.T @ (heights.weight * heights.above_m)
    variance, of_object = max(heights.sigma_m(), EXACT_M) ** 2, OBJECT_SIGMA_M**2
    for _ in range(_STEPS):
        # An object's own error is this fraction of the sum of its boxes' heights above the plane.
        share = 1.0 / (weight + variance / of_object)
        covariance = np.linalg.pinv((squares - (designs.T * share) @ designs) / variance + prior)
        unknowns = covariance @ (product - designs.T @ (share * above_m)) / variance
        own_m = share * (above_m - designs @ unknowns)
        by_plane = (designs.T * share).T
        own_variance = variance * share + np.einsum("ki,ij,kj->k", by_plane, covariance, by_plane)
        means = (above_m - designs @ unknowns) / np.maximum(weight, np.finfo(np.float64).tiny)
        left = replace(heights, above_m=heights.above_m - design @ unknowns - means[heights.label])
        freedom = left.stretches() - objects
        before = np.array([variance, of_object])
        variance = max(left.sigma_m(), EXACT_M) ** 2 * total / max(freedom - 3, 1.0)
        expected = float((own_m**2 + own_variance)[weight > 0.0].sum())
        of_object = (OBJECT_WEIGHT * OBJECT_SIGMA_M**2 + expected) / (OBJECT_WEIGHT + objects)
        if np.abs(np.array([variance, of_object]) / before - 1.0).max() < _CONVERGED:
            break
    noise_m, object_m = left.sigma_m(), float(np.sqrt(of_object))
    return HeightFit(unknowns, covariance, noise_m, object_m, freedom, spread_m, axes)


def counted(
    points: FloatArray, above_m: FloatArray, objects: Sequence[IntArray], ground: GroundPlane, axes: Axes
) -> Boxes:
    """Order boxes by object, with weights by which each object counts once in each cell of the road."""
    rows = np.concatenate(objects)
    label = np.repeat(np.arange(len(objects)), [len(one) for one in objects])
    cells = np.floor(transform(ground.T_level_sensor(axes), points[rows])[:, :2] / _CELL_M).astype(np.int64)
    _, where, counts = np.unique(np.column_stack([label, cells]), axis=0, return_inverse=True, return_counts=True)
    weight = 1.0 / counts[where.reshape(-1)]
    return Boxes(points[rows], _smoothed(points[rows], label, weight), above_m[rows], label, weight)


def _smoothed(points: FloatArray, label: IntArray, weight: FloatArray) -> FloatArray:
    """Return the weighted means of the points around each one along its object's path, shape (n, 3).

    As an object counts once in each cell, the sum of its weights is the number of cells that it has passed. A window
    reaches as far ahead as back, and not beyond the path's ends, so that straight paths remain as they are.
    """
    smoothed = np.empty_like(points)
    for rows in _of_each(label):
        passed = np.cumsum(weight[rows]) - weight[rows] / 2
        reach = np.minimum(np.minimum(passed - passed[0], passed[-1] - passed), _WINDOW_M / _CELL_M / 2) + 1e-9
        first, end = np.searchsorted(passed, passed - reach), np.searchsorted(passed, passed + reach)
        sums = np.cumsum(np.column_stack([points[rows] * weight[rows, None], weight[rows]]), axis=0)
        sums = np.vstack([np.zeros(4), sums])
        within = sums[end] - sums[first]
        smoothed[rows] = within[:, :3] / within[:, 3:]
    return smoothed


def _of_each(label: IntArray) -> list[IntArray]:
    """Return the rows of each object."""
    return np.split(np.arange(len(label)), np.flatnonzero(np.diff(label)) + 1)


def heights_above(boxes: Boxes, ground: GroundPlane, axes: Axes) -> Heights:
    """Return the boxes' heights above a plane; boxes far above or below it do not stand on it and get the weight 0.

    Far is a box by its distance from its object's median, or an object by that of its median from the others', relative
    to the median of such distances. Of the objects, the three nearest do not count for it, as a plane goes through any
    three; and no object is far within what is assumed of their errors before any is seen.
    """
    level = transform(ground.T_level_sensor(axes), boxes.points)
    above_m = level[:, 2] - boxes.above_m
    objects = _of_each(boxes.label)
    middles = np.array([weighted_median(above_m[rows], boxes.weight[rows]) for rows in objects])
    weights = np.array([boxes.weight[rows].sum() for rows in objects])
    off_m = np.abs(above_m - middles[boxes.label])
    objects_off_m = np.abs(middles - weighted_median(middles, weights))
    noise_m = max(NORMAL * weighted_median(off_m, boxes.weight), EXACT_M)
    farther = np.argsort(objects_off_m)[3:]
    usual_m = weighted_median(objects_off_m[farther], weights[farther]) if len(farther) else np.inf
    objects_m = max(NORMAL * usual_m, OBJECT_SIGMA_M)
    near = (off_m <= GATE * noise_m) & (objects_off_m <= GATE * objects_m)[boxes.label]
    xy = transform(ground.T_level_sensor(axes), boxes.smoothed)[:, :2]
    return Heights(xy, above_m, boxes.label, np.where(near, boxes.weight, 0.0), near)
