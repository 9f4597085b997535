"""The ground plane in a cloud of points (the paper's section III-A).

A robust start, the paper's iterated principal axes, and a last fit in inverse range. For a ray with unit direction e
and range rho the plane ``normal . p + height = 0`` reads ``1 / rho = m . e`` with ``m = -normal / height``. That is
linear in m; for a stereo camera 1 / rho is the disparity up to an exact factor of the ray, so its noise is uniform
there, and for a LiDAR the known noise of the range is carried over to first order.

The scene is divided into cells of bearing, `_CELL` rad wide, which on the ground grow with the range. A cell, and not
a point, is what supports a plane: dense surfaces near the sensor do not outvote the road, the mean of a cell is so
exact that the foot of a wall and a pavement stand out from it, and noise shared by neighbours is counted once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter

from laci_stereo.core.errors import GroundError
from laci_stereo.core.frames import Axes, BoolArray, FloatArray, IntArray, rigid
from laci_stereo.core.settings import GroundSettings

# 1 m at 20 m: narrower than a car or a pavement, and wide enough for the mean of many points.
_CELL = 0.05
# 0.6 deg: finer than the cells, and still only some ten thousand bearings in any field of view.
_BEARING = 0.01
_START_POINTS = 4000
_FINAL_POINTS = 50_000
# With 15 % of ground among the points a triple is all ground with 0.3 %: 2000 leave 6 expected, 0.2 % for none.
_TRIPLES = 2000
# Up to so many times the range seen, a ray near the horizon is told from its neighbours.
_HORIZON = 4.0
_SEEDS = 12
# As high as the things that stand about: where a point that is not on the ground may be.
_SCENE_HEIGHT_M = 10.0
_SQRT_2_PI = float(np.sqrt(2.0 * np.pi))
_PASSES = 3
_MAX_ITERATIONS = 30
# After six halvings the largest unevenness is a third of a millimetre.
_ANNEALING = 6
# Squared length of a step in standard deviations of the result.
_SETTLED = 1e-6
# Beyond three standard deviations lies 0.3 % of normal noise.
_GATE = 3.0
# Tukey's constant for 95 % efficiency on normal noise.
_TUKEY = 4.685
# Blocks of five by five cells: wider than a matcher's window reaches, and about as wide as a pavement.
_BLOCK = 5
# A road falls from its crown to its gutter: its height is common to about as much as half its width.
_BEND_M = 7.0
# What is common to more than so small a part of the view is no unevenness of the plane but the plane.
_PATCHES = 12
# Half of the cells on the road: an eighth of the triples are.
_CELL_TRIPLES = 300
# Three directions as near to one plane as a cell is wide span none: their determinant is below _CELL cubed.
_FLAT = _CELL**3
# Of the variance of a point, what its cell may share, until the fit knows: a matcher's window is a tenth of a cell.
_START_SHARED = 0.1
# Directions within a cell of each other have a condition number of about 1 / _CELL^4; nothing solvable is near this.
_SINGULAR = 1e13
# Grid for the scatter of cells, in steps that change a standard deviation by less than a half.
_SHARED = np.array([0.0, 0.005, 0.01, 0.02, 0.04, 0.08, 0.16, 0.32, 0.64, 1.0])
_FRACTIONS = np.array([0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0])
# Degrees of freedom that let one cell in twenty be an outlier.
_STUDENT = 4.0
# Below this angle between forward and the normal, a tilt of 0.01 deg already turns the level frame by 0.5 deg.
_MIN_FORWARD_ANGLE_DEG = 1.0
_DEFAULTS = GroundSettings()


@dataclass(frozen=True)
class GroundPlane:
    """A plane in the sensor frame: ``normal . p + height_m = 0``.

    Attributes
    ----------
    normal : ndarray, shape (3,)
        Unit vector in the sensor frame, towards the sensor, so up.
    height_m : float
        Of the sensor's origin above the plane.
    covariance_sensor : ndarray, shape (4, 4)
        Of (rotation vector in sensor axes [rad], height [m]), of rank 3: a turn about the normal does not exist. The
        rotation vector is the one that, applied after the estimate, makes it true. Noise common to a cell, unevenness
        common to some metres, and what blocks of cells scatter beyond these are in it; it assumes that farther parts
        are independent, so a ground that is bent as a whole, or raised a few centimetres over much of it, is not.
        See `covariance_level`.
    inlier_share : float
        Of all points, those on the plane within their noise.
    support_cells : int
        Cells of bearing that agree with the plane.
    support_share : float
        The same over all cells with a free view of the plane within the range seen.
    support_area_m2 : float
        What the supporting cells cover on the plane.
    unevenness_m : float
        Standard deviation of the ground about the plane, beyond the noise of the points.
    """

    normal: FloatArray
    height_m: float
    covariance_sensor: FloatArray
    inlier_share: float
    support_cells: int
    support_share: float
    support_area_m2: float
    unevenness_m: float

    def T_level_sensor(self, axes: Axes) -> FloatArray:
        """Return the transform, shape (4, 4), from the sensor into the level frame.

        Parameters
        ----------
        axes : Axes
            Its ``forward``, projected onto the plane, becomes x.

        Raises
        ------
        GroundError
            If forward is so nearly parallel to the normal that x is undefined.
        """
        forward = np.asarray(axes.forward, dtype=np.float64)
        x = forward - (self.normal @ forward) * self.normal
        angle_deg = np.degrees(np.arcsin(min(1.0, float(np.linalg.norm(x) / np.linalg.norm(forward)))))
        if angle_deg < _MIN_FORWARD_ANGLE_DEG:
            raise GroundError(
                f"angle between the sensor's forward axis and the ground's normal: {angle_deg:.2f} deg found, "
                f"at least {_MIN_FORWARD_ANGLE_DEG:g} deg needed"
            )
        x /= np.linalg.norm(x)
        return rigid(np.stack([x, np.cross(self.normal, x), self.normal]), np.array([0.0, 0.0, self.height_m]))

    def covariance_level(self, axes: Axes) -> FloatArray:
        """Return the covariance, shape (3, 3), of (rotation about level x, about level y, height) [rad, rad, m].

        With the small rotation vector d of the first two, ``exp(d) @ T_level_sensor`` is the true transform.

        Raises
        ------
        GroundError
            As `T_level_sensor`.
        """
        to_level = np.eye(4)
        to_level[:3, :3] = self.T_level_sensor(axes)[:3, :3]
        kept = [0, 1, 3]
        covariance: FloatArray = (to_level @ self.covariance_sensor @ to_level.T)[np.ix_(kept, kept)]
        return covariance

    def heights(self, points_sensor: FloatArray) -> FloatArray:
        """Return the signed heights, shape (n,), of points, shape (n, 3), above the plane in metres."""
        heights: FloatArray = points_sensor @ self.normal + self.height_m
        return heights


@dataclass(frozen=True)
class _Rays:
    """Points as rays from the sensor's origin.

    ``growth`` is p in sigma_along ~ range^p: the noise at the range the plane predicts follows from it. Weights taken
    at the measured range would favour the points that happen to be measured too near.
    """

    directions: FloatArray
    range_m: FloatArray
    sigma_along_m: FloatArray
    sigma_bearing_rad: FloatArray
    growth: float

    def __len__(self) -> int:
        return len(self.range_m)

    def __getitem__(self, keep: BoolArray | IntArray) -> _Rays:
        return _Rays(
            self.directions[keep],
            self.range_m[keep],
            self.sigma_along_m[keep],
            self.sigma_bearing_rad[keep],
            self.growth,
        )

    @property
    def points(self) -> FloatArray:
        return self.directions * self.range_m[:, None]

    def variance_of_inverse(self, inverse: FloatArray, m: FloatArray) -> FloatArray:
        """Variance of 1 / range - m . e, to first order, where the plane m predicts 1 / range as ``inverse`` > 0."""
        along = self.sigma_along_m * (self.range_m * inverse) ** -self.growth * inverse**2
        across_squared = np.maximum(m @ m - inverse**2, 0.0) * self.sigma_bearing_rad**2
        variance: FloatArray = along**2 + across_squared
        return variance

    def variance_of_height(self, normal: FloatArray) -> FloatArray:
        """Variance of normal . p for many normals, shape (k, 3), as shape (k, n), at the measured range."""
        cosine_squared = (normal @ self.directions.T) ** 2
        across = (self.sigma_bearing_rad * self.range_m) ** 2
        variance: FloatArray = cosine_squared * (self.sigma_along_m**2 - across) + across
        return variance


def fit_ground(
    points: FloatArray,
    sigma_along_m: FloatArray,
    sigma_across_m: FloatArray,
    up: tuple[float, float, float],
    settings: GroundSettings = _DEFAULTS,
) -> GroundPlane:
    """Fit the ground plane (paper, section III-A).

    The paper iterates principal axes from all points, which goes astray when walls are in view. Here planes through
    three points compete first: near enough to ``up``, with much area on them and little below them. Principal axes of
    the inliers then improve the best ones, and a robust fit in inverse range gives the result. Only the third component
    of the paper's vector of height is meant: the distance along the normal.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Sensor frame, metres; all lines of sight leave the origin.
    sigma_along_m, sigma_across_m : ndarray, shape (n,)
        Standard deviations along and across the line of sight, metres.
    up : tuple of float
        Roughly against gravity, in the sensor frame.
    settings : GroundSettings

    Returns
    -------
    GroundPlane

    Raises
    ------
    GroundError
        If the input is malformed, or no plane within the settings has enough support.
    """
    up_axis = _checked_up(up)
    rays = _rays(points, sigma_along_m, sigma_across_m, settings)
    start = _robust_start(rays, up_axis, settings)
    fit = _fit_inverse_range(_random_part(rays, _FINAL_POINTS), start, settings)
    return _plane(rays, fit, up_axis, settings)


def _checked_up(up: tuple[float, float, float]) -> FloatArray:
    axis = np.asarray(up, dtype=np.float64)
    if axis.shape != (3,) or not np.isfinite(axis).all() or not np.linalg.norm(axis) > 0.0:
        raise GroundError(f"up axis: {up} found, three finite numbers that are not all zero needed")
    unit: FloatArray = axis / np.linalg.norm(axis)
    return unit


def _rays(points: FloatArray, sigma_along_m: FloatArray, sigma_across_m: FloatArray, settings: GroundSettings) -> _Rays:
    """Check the input and turn it into rays."""
    points, along, across = (np.asarray(a, dtype=np.float64) for a in (points, sigma_along_m, sigma_across_m))
    if points.ndim != 2 or points.shape[1] != 3:
        raise GroundError(f"shape of the points: {points.shape} found, (n, 3) needed")
    for name, sigma in (("along", along), ("across", across)):
        if sigma.shape != (len(points),):
            raise GroundError(f"shape of sigma_{name}_m: {sigma.shape} found, ({len(points)},) needed")
    if len(points) < settings.min_points:
        raise GroundError(f"number of points: {len(points)} found, at least {settings.min_points} needed")
    ranges = np.linalg.norm(points, axis=1)
    for name, bad, needed in (
        ("points", ~np.isfinite(ranges), "finite coordinates"),
        ("points", ranges == 0.0, "a range above 0 m"),
        ("sigma_along_m", ~(np.isfinite(along) & (along > 0.0)), "finite values above 0 m"),
        ("sigma_across_m", ~(np.isfinite(across) & (across >= 0.0)), "finite values of at least 0 m"),
    ):
        if bad.any():
            first = int(np.argmax(bad))
            value = {"points": points, "sigma_along_m": along, "sigma_across_m": across}[name][first]
            raise GroundError(f"{name}: {value} found at index {first}, {needed} needed")
    return _Rays(points / ranges[:, None], ranges, along, across / ranges, _noise_growth(ranges, along))


def _noise_growth(range_m: FloatArray, sigma_along_m: FloatArray) -> float:
    """Return p of sigma_along ~ range^p: 2 for a stereo camera, 0 for a LiDAR, and never outside these."""
    x = np.log(range_m)
    x -= x.mean()
    spread = float(x @ x)
    if spread == 0.0:
        return 0.0
    return float(np.clip(x @ np.log(sigma_along_m) / spread, 0.0, 2.0))


def _random_part(rays: _Rays, size: int) -> _Rays:
    if len(rays) <= size:
        return rays
    return rays[np.sort(np.random.default_rng(0).choice(len(rays), size, replace=False))]


def _one_per_bearing(rays: _Rays) -> _Rays:
    """Keep one random ray of each small cube on the unit sphere, and of these as many as the start needs."""
    order = np.random.default_rng(0).permutation(len(rays))
    _, first = np.unique(_packed(rays.directions[order], _BEARING), return_index=True)
    return _random_part(rays[order[first]], _START_POINTS)


def _packed(values: FloatArray, cell: float) -> IntArray:
    """Return one integer per row of values, shape (n, 3), the same for rows in one cubic cell."""
    index = np.floor((values - values.min(axis=0)) / cell).astype(np.int64)
    size = index.max(axis=0) + 1
    packed: IntArray = (index[:, 0] * size[1] + index[:, 1]) * size[2] + index[:, 2]
    return packed


def _area_weights(rays: _Rays) -> FloatArray:
    """Weigh each point so that the weights on any surface add up to its area: 1 / (points in its voxel).

    Noise along the line of sight spreads a wall over many layers of voxels: that many are not more wall.
    """
    voxel_m = _CELL * float(np.median(rays.range_m))
    _, member, count = np.unique(_packed(rays.points, voxel_m), return_inverse=True, return_counts=True)
    layers = np.maximum(_SQRT_2_PI * rays.sigma_along_m / voxel_m, 1.0)
    weights: FloatArray = 1.0 / (count[member.reshape(-1)] * layers)
    return weights


def _admissible(normal: FloatArray, height_m: FloatArray, up: FloatArray, settings: GroundSettings) -> BoolArray:
    """Return which planes, normals of shape (k, 3), are where the ground can be."""
    near_up = normal @ up >= np.cos(np.radians(settings.max_tilt_deg))
    admissible: BoolArray = near_up & (height_m >= settings.min_height_m) & (height_m <= settings.max_height_m)
    return admissible


def _score(
    rays: _Rays, weights: FloatArray, normal: FloatArray, height_m: FloatArray, settings: GroundSettings
) -> FloatArray:
    """Evidence for each plane, shape (k,): the area on it less the area below it, times what each point proves.

    That is the logarithm of how much likelier its height is on the plane than anywhere in the scene, so that a wall,
    blurred by depth noise into a slab of several metres, is no evidence for the planes that cut through the slab.
    """
    points = rays.points
    score = np.empty(len(normal))
    # Slices that stay in a processor's cache.
    for part in (slice(i, i + 32) for i in range(0, len(normal), 32)):
        sigma = np.sqrt(rays.variance_of_height(normal[part]) + settings.unevenness_m**2)
        standardised = (normal[part] @ points.T + height_m[part, None]) / sigma
        proof = np.maximum(np.log(_SCENE_HEIGHT_M / (_SQRT_2_PI * sigma)), 0.0)
        on = np.where(standardised > _GATE, 0.0, np.maximum(proof - 0.5 * standardised**2, 0.0))
        score[part] = np.where(standardised < -_GATE, -proof, on) @ weights
    return score


def _robust_start(rays: _Rays, up: FloatArray, settings: GroundSettings) -> FloatArray:
    """Return m of the plane that wins among random triples and what principal axes make of the best ones."""
    part = _one_per_bearing(rays)
    weights = _area_weights(part)
    normal, height_m = _planes_through_triples(part, weights)
    admissible = _admissible(normal, height_m, up, settings)
    normal, height_m = normal[admissible], height_m[admissible]
    if len(normal) == 0:
        raise GroundError(f"planes through three points: none found {_within(settings)}")
    best = np.argsort(-_score(part, weights, normal, height_m, settings), kind="stable")[:_SEEDS]
    improved = [_principal_axes(part, normal[i], float(height_m[i]), settings) for i in best]
    normal = np.vstack([normal[best], [n for n, _ in improved]])
    height_m = np.append(height_m[best], [h for _, h in improved])
    admissible = _admissible(normal, height_m, up, settings)
    normal, height_m = normal[admissible], height_m[admissible]
    winner = int(np.argmax(_score(part, weights, normal, height_m, settings)))
    m: FloatArray = -normal[winner] / height_m[winner]
    return m


def _within(settings: GroundSettings) -> str:
    return (
        f"within {settings.max_tilt_deg:g} deg of up and {settings.min_height_m:g} to {settings.max_height_m:g} m "
        "below the sensor, one needed"
    )


def _planes_through_triples(rays: _Rays, weights: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return normals, shape (k, 3), towards the sensor, and heights, shape (k,), of planes through random triples."""
    drawn = np.random.default_rng(0).choice(len(rays), size=(_TRIPLES, 3), p=weights / weights.sum())
    a, b, c = (rays.points[drawn[:, i]] for i in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1)
    spans = length > 0.0
    normal = normal[spans] / length[spans, None]
    offset = -np.sum(normal * a[spans], axis=1)
    side = np.where(offset < 0.0, -1.0, 1.0)
    return normal * side[:, None], offset * side


def _principal_axes(
    rays: _Rays, normal: FloatArray, height_m: float, settings: GroundSettings
) -> tuple[FloatArray, float]:
    """Fit principal axes to the inliers, with a shrinking threshold, until the inliers stay the same.

    Returns the plane it was given where too few points are near to span another one.
    """
    inliers = np.zeros(len(rays), dtype=bool)
    for threshold in (2.0 * _GATE, 1.5 * _GATE, *(12 * [_GATE])):
        variance = rays.variance_of_height(normal[None])[0] + settings.unevenness_m**2
        previous, inliers = inliers, np.abs(rays.points @ normal + height_m) <= threshold * np.sqrt(variance)
        if inliers.sum() < settings.min_points or (threshold == _GATE and np.array_equal(previous, inliers)):
            break
        weight = 1.0 / variance[inliers]
        centre = weight @ rays.points[inliers] / weight.sum()
        centred = rays.points[inliers] - centre
        normal = np.linalg.eigh((centred * weight[:, None]).T @ centred)[1][:, 0]
        height_m = float(-normal @ centre)
        if height_m < 0.0:
            normal, height_m = -normal, -height_m
    return normal, height_m


@dataclass(frozen=True)
class _Fit:
    """The result of the fit in inverse range: m, its covariance, shape (3, 3), and what supports it."""

    m: FloatArray
    covariance: FloatArray
    unevenness_m: float
    cells: int
    cells_seen: int
    area_m2: float


@dataclass(frozen=True)
class _Partition:
    """Rays with a free view of the plane, the number of the cell of each, and each cell's place in polar steps."""

    rays: _Rays
    cell: IntArray
    place: IntArray


@dataclass(frozen=True)
class _Cells:
    """Means over the cells in which most rays agree with the plane.

    ``variance`` is that of the mean residual if the points are independent, ``noise`` that of one point, ``per_metre``
    what a height of 1 m above the plane adds to 1 / range. ``place`` is (azimuth, logarithm of range) in steps of
    `_CELL`, ``area_m2`` that of the whole cell on the plane, to within the slant, and ``seen`` the number of all cells.
    """

    residual: FloatArray
    direction: FloatArray
    variance: FloatArray
    noise: FloatArray
    per_metre: FloatArray
    place: IntArray
    area_m2: FloatArray
    seen: int

    @property
    def common(self) -> FloatArray:
        """How many cells share one unevenness of the ground."""
        bend_m2 = min(_BEND_M**2, float(self.area_m2.sum()) / _PATCHES)
        shared: FloatArray = np.maximum(bend_m2 / self.area_m2, 1.0)
        return shared


def _fit_inverse_range(rays: _Rays, m: FloatArray, settings: GroundSettings) -> _Fit:
    """Solve 1 / range = m . e robustly; the cells follow the plane, so they are laid anew until that settles."""
    for _ in range(_PASSES - 1):
        m = _fit_cells(_partition(rays, m), m, settings).m
    return _fit_cells(_partition(rays, m), m, settings)


def _partition(rays: _Rays, m: FloatArray) -> _Partition:
    """Divide the rays that have a free view of the plane, within the range seen in their direction, into cells.

    A ray is chosen for its bearing and for what stands beyond it, never for the range measured along it: that would
    cut the noise on one side.
    """
    normal = -m / np.linalg.norm(m)
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(normal)))], normal)
    x /= np.linalg.norm(x)
    azimuth = np.arctan2(rays.directions @ np.cross(normal, x), rays.directions @ x) + np.pi
    sector = np.floor(azimuth / _CELL).astype(np.int64)
    # Where a range limit ends the data, only what was measured too near is left of what lies beyond.
    farthest = np.zeros(sector.max() + 1)
    np.maximum.at(farthest, sector, rays.range_m)
    inverse = rays.directions @ m
    least = 1.0 / (_HORIZON * farthest.max())
    sigma = np.sqrt(rays.variance_of_inverse(np.maximum(inverse, least), m))
    log_range = -np.log(np.maximum(inverse, least)) / _CELL
    first = log_range.min()
    ring = np.floor(log_range - first).astype(np.int64)
    kept = inverse > 1.0 / farthest[sector] + _GATE * sigma
    kept &= ~_behind(1.0 / rays.range_m, inverse, sigma, sector, ring, first, least)
    if not kept.any():
        raise GroundError("rays with a free view of the best plane: 0 found, more needed")
    # Per ring as many cells as make them _CELL wide: the circle shrinks to a point below the sensor.
    steepness = np.exp(-_CELL * (first + ring[kept] + 0.5)) / np.linalg.norm(m)
    around = np.floor(azimuth[kept] * np.sqrt(np.maximum(1.0 - steepness**2, 0.0)) / _CELL).astype(np.int64)
    _, example, cell = np.unique(ring[kept] * (around.max() + 1) + around, return_index=True, return_inverse=True)
    place = np.stack([sector[kept][example], ring[kept][example]], axis=1)
    return _Partition(rays[kept], cell.reshape(-1).astype(np.int64), place)


def _behind(
    measured: FloatArray,
    inverse: FloatArray,
    sigma: FloatArray,
    sector: IntArray,
    ring: IntArray,
    first: float,
    least: float,
) -> BoolArray:
    """Return which rays would meet the plane behind the foot of something that stands on it, shape (n,).

    Just behind the foot of a wall its points are still on the plane within their noise, all of them on one side. But
    the rays above these show the wall, and how far away it is.

    Parameters
    ----------
    measured, inverse, sigma : ndarray, shape (n,)
        1 / range as measured, on the plane, and the standard deviation of the difference.
    sector, ring : ndarray, shape (n,)
        Where the ray points: azimuth, and logarithm of the range at which it meets the plane.
    first, least : float
        The logarithm at which ring 0 begins, in units of a ring, and 1 / range of the last ring.
    """
    shape = (int(sector.max()) + 1, int(ring.max()) + 1)
    index = sector * shape[1] + ring

    def total(values: FloatArray) -> FloatArray:
        sums = np.bincount(index, values, minlength=shape[0] * shape[1])
        return sums.astype(np.float64).reshape(shape)

    low = inverse > -least
    above = (low & (measured - inverse > _GATE * sigma)).astype(np.float64)
    standing = total(above) > 0.5 * np.maximum(total(low.astype(np.float64)), 1.0)
    # One standard deviation nearer, since it is the noise of the points there that hides the foot.
    foot = total(above * (measured + sigma)) / np.maximum(total(above), 1.0)
    hidden = np.zeros(shape, dtype=bool)
    nearest = np.zeros(shape[0])
    for i in reversed(range(shape[1])):
        nearest = np.where(standing[:, i], foot[:, i], nearest)
        hidden[:, i] = nearest > np.exp(-_CELL * (first + i + 1))
        nearest[~hidden[:, i]] = 0.0
    return hidden[sector, ring]


def _fit_cells(partition: _Partition, m: FloatArray, settings: GroundSettings) -> _Fit:
    """Reweight until m moves by much less than its own standard deviation."""
    m = _lowest(_cell_means(partition, m, settings), m, settings)
    for iteration in range(_MAX_ITERATIONS):
        cells = _cell_means(partition, m, settings)
        shared, unevenness_m = _scatter(cells, settings)
        unevenness_m = max(unevenness_m, settings.unevenness_m * 0.5 ** (iteration + 1))
        noise = cells.variance + shared * cells.noise
        uneven = (unevenness_m * cells.per_metre) ** 2
        weight = _tukey(cells.residual / np.sqrt(noise + uneven))
        weight *= _tukey(_mean_around(cells, weight / (noise + uneven), uneven))
        _check_count(int(np.count_nonzero(weight)), settings)
        pull = weight / (noise + uneven * cells.common)
        information = (cells.direction * pull[:, None]).T @ cells.direction
        if np.linalg.cond(information) > _SINGULAR:
            raise GroundError("directions that support the best plane: all in one plane found, a spread needed")
        step = np.linalg.solve(information, cells.direction.T @ (pull * cells.residual))
        m = m + step
        if iteration >= _ANNEALING and step @ information @ step < _SETTLED:
            break
    supports = weight > 0.0
    return _Fit(
        m=m,
        covariance=np.linalg.inv(information) * _inflation(cells, pull, cells.residual - cells.direction @ step),
        unevenness_m=unevenness_m,
        cells=int(supports.sum()),
        cells_seen=cells.seen,
        area_m2=float(cells.area_m2[supports].sum()),
    )


def _mean_around(cells: _Cells, pull: FloatArray, uneven: FloatArray) -> FloatArray:
    """Return the mean residual of the cells around each one in its own standard deviations, shape (n,).

    In a single cell far away a pavement is lost in the noise, in a block of cells it is not. Unevenness is taken as
    common to all of them.
    """
    shape = cells.place.max(axis=0) + 1
    index = np.ravel_multi_index((cells.place[:, 0], cells.place[:, 1]), shape)

    def around(values: FloatArray) -> FloatArray:
        grid = np.bincount(index, values, minlength=int(np.prod(shape))).reshape(shape)
        sums: FloatArray = uniform_filter(grid, size=_BLOCK, mode="constant")[cells.place[:, 0], cells.place[:, 1]]
        return sums * float(_BLOCK**2)

    # Sums of what is nowhere negative, up to the filter's rounding.
    total = np.maximum(around(pull), np.maximum(pull, np.finfo(float).tiny))
    standardised: FloatArray = around(pull * cells.residual) / total / np.sqrt(1.0 / total + uneven)
    return standardised


def _inflation(cells: _Cells, pull: FloatArray, residual: FloatArray) -> float:
    """Return by how much blocks of cells scatter more than independent cells would, but at least 1."""
    _, block = np.unique(cells.place // _BLOCK, axis=0, return_inverse=True)
    block = block.reshape(-1)
    total = np.bincount(block, pull)
    used = total > 0.0
    mean = np.bincount(block, pull * residual)[used] / total[used]
    return max(1.0, float(total[used] @ mean**2) / max(float(np.count_nonzero(used)) - 3.0, 1.0))


def _lowest(cells: _Cells, m: FloatArray, settings: GroundSettings) -> FloatArray:
    """Return m of the plane through three cells that agrees with the most cells, less those below it.

    The start may lie between the road and the pavements beside it. The means of cells are exact enough to tell these
    apart, and a cell below the road does not exist.
    """
    drawn = np.random.default_rng(0).integers(len(cells.residual), size=(_CELL_TRIPLES, 3))
    matrix = cells.direction[drawn]
    spans = np.abs(np.linalg.det(matrix)) > _FLAT
    steps = np.linalg.solve(matrix[spans], cells.residual[drawn[spans]][:, :, None])[:, :, 0]
    steps = np.vstack([np.zeros(3), steps])
    residual = cells.residual - steps @ cells.direction.T
    uneven = (0.5 * settings.unevenness_m * cells.per_metre) ** 2
    gate = _GATE * np.sqrt(cells.variance + _START_SHARED * cells.noise + uneven)
    votes = (np.abs(residual) <= gate) @ (1 / cells.common) - (residual < -gate) @ (1 / cells.common)
    lowest: FloatArray = m + steps[int(np.argmax(votes))]
    return lowest


def _cell_means(partition: _Partition, m: FloatArray, settings: GroundSettings) -> _Cells:
    """Return the weighted means of the cells in which most rays agree with the plane.

    Raises
    ------
    GroundError
        If there are too few of these.
    """
    inverse = partition.rays.directions @ m
    meets = inverse > 0.0
    rays, cell, inverse = partition.rays[meets], partition.cell[meets], inverse[meets]
    size = len(partition.place)
    residual = 1.0 / rays.range_m - inverse
    variance = rays.variance_of_inverse(inverse, m)
    per_metre = np.linalg.norm(m) * inverse
    weight = _tukey(residual / np.sqrt(variance + (settings.unevenness_m * per_metre) ** 2))
    count = np.bincount(cell, minlength=size)
    # The few points on the plane in a cell full of others are the foot of a wall or a tyre.
    kept = np.bincount(cell, weight > 0.0, minlength=size) > 0.5 * count
    _check_count(int(np.count_nonzero(kept)), settings)
    weight /= variance
    total = np.bincount(cell, weight, minlength=size)[kept]
    columns = [residual, *rays.directions.T, weight * variance, variance, per_metre]
    sums = [np.bincount(cell, weight * column, minlength=size)[kept] / total for column in columns]
    return _Cells(
        residual=sums[0],
        direction=np.stack(sums[1:4], axis=1),
        variance=sums[4] / total,
        noise=sums[5],
        per_metre=sums[6],
        place=partition.place[kept],
        area_m2=(_CELL * np.linalg.norm(m) / sums[6]) ** 2,
        seen=int(np.count_nonzero(count)),
    )


def _check_count(cells: int, settings: GroundSettings) -> None:
    if cells < settings.min_cells:
        raise GroundError(
            f"cells of {_CELL} rad on the best plane: {cells} found, at least {settings.min_cells} needed"
        )


def _scatter(cells: _Cells, settings: GroundSettings) -> tuple[float, float]:
    """Return how the cells below the plane scatter beyond the noise of independent points.

    The share of a point's variance that all points of a cell have in common, as a matcher's window makes it, and the
    standard deviation of the ground's height: the likeliest pair under Student's t. Only cells below are asked: those
    above may be pavement or grass, but below the ground there is nothing but noise.
    """
    below = cells.residual < 0.0
    squared, per_metre = cells.residual[below] ** 2, cells.per_metre[below]
    shared, height_m = (a.ravel() for a in np.meshgrid(_SHARED, settings.unevenness_m * _FRACTIONS))
    variance = cells.variance[below] + shared[:, None] * cells.noise[below] + (height_m[:, None] * per_metre) ** 2
    cost = np.sum(np.log(variance) + (_STUDENT + 1.0) * np.log1p(squared / (_STUDENT * variance)), axis=1)
    best = int(np.argmin(cost))
    return float(shared[best]), float(height_m[best])


def _tukey(standardised: FloatArray) -> FloatArray:
    """Return Tukey's biweight, 1 at zero and 0 from `_TUKEY` on."""
    weight: FloatArray = np.maximum(1.0 - (standardised / _TUKEY) ** 2, 0.0) ** 2
    return weight


def _plane(rays: _Rays, fit: _Fit, up: FloatArray, settings: GroundSettings) -> GroundPlane:
    """Check the fit's place and support, and carry m and its covariance over to normal and height."""
    height_m = 1.0 / float(np.linalg.norm(fit.m))
    normal = -fit.m * height_m
    if not _admissible(normal[None], np.array([height_m]), up, settings)[0]:
        tilt_deg = np.degrees(np.arccos(np.clip(normal @ up, -1.0, 1.0)))
        raise GroundError(f"best plane: {tilt_deg:.1f} deg from up, {height_m:.2f} m below found, {_within(settings)}")
    support_share = fit.cells / fit.cells_seen
    if support_share < settings.min_support_share:
        raise GroundError(
            f"share of the view that supports the best plane: {100 * support_share:.1f} % found, "
            f"at least {100 * settings.min_support_share:g} % needed"
        )
    # d(height) = height^2 normal . dm; d(normal) = -height (I - normal normal^T) dm; the turn is d(normal) x normal.
    cross = np.cross(np.eye(3), normal)
    jacobian = np.vstack([-height_m * cross.T, height_m**2 * normal])
    covariance = jacobian @ fit.covariance @ jacobian.T
    tilt_sigma_deg = float(np.degrees(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1])))
    if tilt_sigma_deg > settings.max_tilt_sigma_deg:
        raise GroundError(
            f"standard deviation of the best plane's tilt: {tilt_sigma_deg:.2f} deg found, "
            f"at most {settings.max_tilt_sigma_deg:g} deg needed"
        )
    gate = _GATE * np.sqrt(rays.variance_of_height(normal[None])[0] + fit.unevenness_m**2)
    return GroundPlane(
        normal=normal,
        height_m=height_m,
        covariance_sensor=covariance,
        inlier_share=float(np.mean(np.abs(rays.points @ normal + height_m) <= gate)),
        support_cells=fit.cells,
        support_share=support_share,
        support_area_m2=fit.area_m2,
        unevenness_m=fit.unevenness_m,
    )
