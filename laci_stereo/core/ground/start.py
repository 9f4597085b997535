"""A robust start for the ground plane, and the paper's iterated principal axes from there.

The paper iterates principal axes from all points, which converges to a wrong plane when walls are in view. Here the
start is chosen by random sampling: among planes through three points that are near enough to horizontal, the one with
the most of the view on it and the least below it. Planes are represented by m as in `laci_stereo.core.ground.rays`.
"""

from __future__ import annotations

import numpy as np

from laci_stereo.core.errors import GroundError
from laci_stereo.core.frames import BoolArray, FloatArray
from laci_stereo.core.ground.rays import GATE, Rays, random_part
from laci_stereo.core.settings import GroundSettings

# Largest number of points used: they determine a fraction of the view of 0.3 to within 0.007.
_POINTS = 4000
# If 15 % of the points are ground, a triple is all ground with a probability of 0.3 %: of 2000, 6 are expected, and
# none occurs with a probability of 0.2 %.
_TRIPLES = 2000
# Height of the scene: the range of heights over which points that are not on the ground are distributed uniformly.
_SCENE_HEIGHT_M = 10.0
# All planes are first scored with this many points, which determine a fraction of the view to within 0.02; then the
# best planes, this fraction of all, are scored with all points.
_FEW_POINTS = 500
_BEST_SHARE = 0.1
# Number of planes scored at a time, so that their data stay in a processor's cache.
_SLICE = 8
# Thresholds of the iterations in standard deviations: the plane of a triple is off by more than the noise of its
# points.
_THRESHOLDS = (2.0 * GATE, 1.5 * GATE, *(12 * [GATE]))


def robust_start(rays: Rays, up: FloatArray, settings: GroundSettings, *, farther: float = 0.0) -> FloatArray:
    """Return the plane through three random points for which the rays give the largest evidence, shape (3,).

    Parameters
    ----------
    rays : Rays
        One ray per bearing, so that the score measures a fraction of the view.
    up : ndarray, shape (3,)
        Unit vector in the sensor frame.
    settings : GroundSettings
    farther : float
        Power of its range by which each ray is weighted: 0 measures a fraction of the view, 1 a fraction of azimuth and
        log range, 3 a fraction of area.

    Raises
    ------
    GroundError
        If no sampled plane is within the tilt and heights of the settings.
    """
    rays = random_part(rays, _POINTS)
    drawn = np.random.default_rng(0).integers(len(rays), size=(_TRIPLES, 3))
    a, b, c = (rays.points[drawn[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    offset = np.sum(normal * a, axis=1)
    planes = normal[offset != 0.0] / offset[offset != 0.0, None]
    planes = planes[can_be_ground(planes, up, settings)]
    if len(planes) == 0:
        raise GroundError(f"planes through three points: none found {where_it_can_be(settings)}")
    ranked = planes[np.argsort(-_scores(random_part(rays, _FEW_POINTS), planes, settings, farther))]
    finalists = ranked[: max(1, round(_BEST_SHARE * len(ranked)))]
    best: FloatArray = finalists[int(np.argmax(_scores(rays, finalists, settings, farther)))]
    return best


def _scores(rays: Rays, planes: FloatArray, settings: GroundSettings, farther: float) -> FloatArray:
    slices = (planes[i : i + _SLICE] for i in range(0, len(planes), _SLICE))
    return np.concatenate([_score(rays, part, settings, farther) for part in slices])


def _score(rays: Rays, planes: FloatArray, settings: GroundSettings, farther: float) -> FloatArray:
    """Return the evidence for each plane, shape (k,): that of the rays on it minus that of the rays that end below it.

    The evidence of a ray is the log-likelihood ratio of its height on the plane to a uniform height in the scene, so
    that a wall, blurred by depth noise into a slab of several metres, gives no evidence for planes that cut through it.
    """
    heights, variance = rays.heights_above(planes)
    variance += settings.unevenness_m**2
    squared = heights**2 / variance
    evidence = np.maximum(np.log(_SCENE_HEIGHT_M / np.sqrt(2.0 * np.pi)) - 0.5 * np.log(variance), 0.0)
    on = np.maximum(evidence - 0.5 * squared, 0.0)
    each = np.where(squared > GATE**2, np.where(heights < 0.0, -evidence, 0.0), on)
    score: FloatArray = each @ rays.range_m**farther * np.linalg.norm(planes, axis=1) ** farther
    return score


def can_be_ground(planes: FloatArray, up: FloatArray, settings: GroundSettings) -> BoolArray:
    """Return which planes, shape (k, 3), are within the tilt and heights of the settings, shape (k,)."""
    length = np.linalg.norm(planes, axis=1)
    near_up = -planes @ up >= length * np.cos(np.radians(settings.max_tilt_deg))
    within: BoolArray = near_up & (length * settings.min_height_m <= 1.0) & (length * settings.max_height_m >= 1.0)
    return within


def where_it_can_be(settings: GroundSettings) -> str:
    """Return the limits of `can_be_ground` in words."""
    return (
        f"within {settings.max_tilt_deg:g} deg of up and {settings.min_height_m:g} to {settings.max_height_m:g} m "
        "below the sensor, one needed"
    )


def principal_axes(rays: Rays, m: FloatArray, settings: GroundSettings) -> FloatArray:
    """Fit principal axes to the inliers, with a shrinking threshold, until the inliers stay the same (section III-A).

    If too few points are near the current plane to determine another one, the current plane is returned.
    """
    inliers = np.zeros(len(rays), dtype=bool)
    for threshold in _THRESHOLDS:
        heights, variance = rays.heights_above(m[None])
        variance = variance[0] + settings.unevenness_m**2
        previous, inliers = inliers, np.abs(heights[0]) <= threshold * np.sqrt(variance)
        if inliers.sum() < settings.min_points or (threshold == GATE and np.array_equal(previous, inliers)):
            break
        weight = 1.0 / variance[inliers]
        centre = weight @ rays.points[inliers] / weight.sum()
        centred = rays.points[inliers] - centre
        normal = np.linalg.eigh((centred * weight[:, None]).T @ centred)[1][:, 0]
        m = normal / (normal @ centre)
    return m
