"""The last fit of the ground plane, in inverse range.

``1 / rho = m . e`` (see `laci_stereo.core.ground_rays`) is linear in m; for a stereo camera 1 / rho is the disparity up
to an exact factor of the ray, so its noise is uniform there, and for a LiDAR the known noise of the range is carried
over to first order.

The plane is divided into cells, `_CELL` rad wide and `_CELL` of the logarithm of range deep, which grow with the range.
A cell, and not a point, is what supports a plane: dense surfaces near the sensor do not outvote the road, the
mean of a cell is so exact that the foot of a wall and a pavement stand out from it, and noise shared by neighbours is
counted once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter
from scipy.special import ndtr

from laci_stereo.core.errors import GroundError
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray
from laci_stereo.core.ground_rays import GATE, Rays, random_part
from laci_stereo.core.ground_uneven import covariance_of_unevenness, patches_of
from laci_stereo.core.settings import GroundSettings

# 1 m at 20 m: narrower than a car or a pavement, and wide enough for the mean of many points.
_CELL = 0.05
# Several in each of some thousand cells.
_POINTS = 50_000
_MAX_ITERATIONS = 30
# Length of a step in standard deviations of the result, squared: first for laying the cells, then for good.
_NEAR, _SETTLED = 0.1**2, 0.01**2
# Tukey's constant for 95 % efficiency on normal noise.
_TUKEY = 4.685
# Of a point's variance, what its cell shares: a matcher's window is a fifth of a cell wide, so that 25 fit into it.
SHARED_IN_CELL = 0.04
# Kerbs are up to 0.15 m high; what is higher stands out by itself.
_KERB_M = 0.15
# Blocks of five by five cells: wider than a matcher's window reaches, and about as wide as a pavement.
_BLOCK = 5
# Directions within a cell of each other have a condition number of about 1 / _CELL^4; nothing solvable is near this.
_SINGULAR = 1e13
# Parts of the largest unevenness that are tried, in steps that change a standard deviation by less than a half.
_FRACTIONS = np.array([0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0])
# Degrees of freedom that let one cell in twenty be an outlier.
_STUDENT = 4.0


@dataclass(frozen=True)
class Fit:
    """The result of the fit in inverse range.

    Attributes
    ----------
    m : ndarray, shape (3,)
    covariance : ndarray, shape (3, 3)
        Of m.
    unevenness_m : float
        Standard deviation of the ground about the plane.
    cells, cells_seen : int
        Cells that support the plane, and all with a free view of it.
    area_m2 : float
        What the supporting cells cover.
    """

    m: FloatArray
    covariance: FloatArray
    unevenness_m: float
    cells: int
    cells_seen: int
    area_m2: float


@dataclass(frozen=True)
class _Partition:
    """Rays with a free view of the plane, the number of the cell of each, and each cell's azimuth and ring."""

    rays: Rays
    cell: IntArray
    place: IntArray


@dataclass(frozen=True)
class _Cells:
    """Means over the points of each cell that are on the plane within their noise.

    ``variance`` is that of the mean residual, ``sigma`` the standard deviation of one point's 1 / range through noise
    along its ray, ``per_metre`` what 1 m above the plane adds to 1 / range, ``place`` the cell's azimuth and ring,
    ``area_m2`` what it covers on the plane, to within the slant.
    """

    residual: FloatArray
    direction: FloatArray
    variance: FloatArray
    sigma: FloatArray
    per_metre: FloatArray
    place: IntArray
    area_m2: FloatArray


@dataclass(frozen=True)
class _Solution:
    """The plane, the cells it was fitted to, the weight of each, 0 to 1, and what its residual adds to m as (n, 3)."""

    m: FloatArray
    cells: _Cells
    weight: FloatArray
    gain: FloatArray
    unevenness_m: float


def fit_inverse_range(rays: Rays, m: FloatArray, settings: GroundSettings) -> Fit:
    """Solve 1 / range = m . e robustly; the cells follow the plane, so they are laid a second time.

    Parameters
    ----------
    rays : Rays
    m : ndarray, shape (3,)
        The start.
    settings : GroundSettings

    Raises
    ------
    GroundError
        If too few cells support the plane, or none that spans it.
    """
    rays = random_part(rays, _POINTS)
    m = _solve(_partition(rays, m), m, _NEAR, settings).m
    partition = _partition(rays, m)
    solution = _solve(partition, m, _SETTLED, settings)
    supports = solution.weight > 0.0
    return Fit(
        m=solution.m,
        covariance=_covariance(solution, settings),
        unevenness_m=solution.unevenness_m,
        cells=int(supports.sum()),
        cells_seen=len(partition.place),
        area_m2=float(solution.cells.area_m2[supports].sum()),
    )


def _partition(rays: Rays, m: FloatArray) -> _Partition:
    """Divide the rays that have a free view of the plane, within the range seen, into cells.

    A ray is chosen for its bearing and for what stands beyond it, never for the range measured along it: that would
    cut the noise on one side.
    """
    normal = -m / np.linalg.norm(m)
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(normal)))], normal)
    azimuth = np.arctan2(rays.directions @ np.cross(normal, x), rays.directions @ x) + np.pi
    sector = np.floor(azimuth / _CELL).astype(np.int64)
    inverse = rays.directions @ m
    least = 1.0 / float(rays.range_m.max())
    log_range = -np.log(np.maximum(inverse, least)) / _CELL
    first = float(log_range.min())
    ring = np.floor(log_range - first).astype(np.int64)
    kept = (inverse > least) & ~_hidden(rays, m, sector, ring, first)
    if not kept.any():
        raise GroundError("rays with a free view of the best plane: 0 found, more needed")
    sector, ring = sector[kept], ring[kept]
    # Per ring as many cells as make them _CELL wide: the circle shrinks to a point below the sensor.
    steepness = np.exp(-_CELL * (first + ring + 0.5)) / np.linalg.norm(m)
    around = np.floor(azimuth[kept] * np.sqrt(np.maximum(1.0 - steepness**2, 0.0)) / _CELL).astype(np.int64)
    _, example, cell = np.unique(ring * (around.max() + 1) + around, return_index=True, return_inverse=True)
    place = np.stack([sector[example], ring[example]], axis=1)
    return _Partition(rays[kept], cell.reshape(-1).astype(np.int64), place)


def _hidden(rays: Rays, m: FloatArray, sector: IntArray, ring: IntArray, first: float) -> BoolArray:
    """Return which rays would meet the plane behind the foot of something that stands on it, shape (n,).

    Just behind the foot of a wall its points are still on the plane within their noise, all of them on one side. But
    the rays above these show the wall, and how far away it is.

    Parameters
    ----------
    rays : Rays
    m : ndarray, shape (3,)
    sector, ring : ndarray, shape (n,)
        Where the ray points: azimuth, and logarithm of the range at which it meets the plane, both in cells. Rays near
        the horizon are in the last ring.
    first : float
        The logarithm at which ring 0 begins, in cells.
    """
    shape = (int(sector.max()) + 1, int(ring.max()) + 1)
    index = sector * shape[1] + ring

    def total(values: FloatArray | BoolArray) -> FloatArray:
        sums = np.bincount(index, values, minlength=shape[0] * shape[1])
        return sums.astype(np.float64).reshape(shape)

    least = 1.0 / float(rays.range_m.max())
    measured, inverse = 1.0 / rays.range_m, rays.directions @ m
    low = inverse > -least
    inverse = np.maximum(inverse, least)
    sigma = np.sqrt(rays.variance_of_inverse(inverse, m))
    above = low & (measured - inverse > GATE * sigma)
    stands = total(above) > 0.5 * np.maximum(total(low), 1.0)
    # One standard deviation nearer, since it is the noise of the points there that hides the foot.
    foot = total(above * (measured + sigma)) / np.maximum(total(above), 1.0)
    # What the next ring with something standing in it shows: beyond the last one nothing is.
    rings = np.arange(shape[1])
    beyond = np.minimum.accumulate(np.where(stands, rings, shape[1])[:, ::-1], axis=1)[:, ::-1]
    nearest = np.take_along_axis(np.pad(foot, ((0, 0), (0, 1))), beyond, axis=1)
    hidden: BoolArray = (nearest > np.exp(-_CELL * (first + rings + 1)))[sector, ring]
    return hidden


def _solve(partition: _Partition, m: FloatArray, settled: float, settings: GroundSettings) -> _Solution:
    """Reweight until m moves by much less than its own standard deviation."""
    raised_share = np.full(partition.place.max(axis=0) + 1, 0.5)
    for _ in range(_MAX_ITERATIONS):
        cells = _cell_means(partition, m, settings)
        unevenness_m = _unevenness(cells, settings)
        uneven = (unevenness_m * cells.per_metre) ** 2
        variance = cells.variance + uneven
        raised = _raised(cells, variance, raised_share[tuple(cells.place.T)])
        raised_share = _share_around(cells, raised, raised_share.shape)
        weight = _tukey(cells.residual / np.sqrt(variance)) * (1.0 - raised)
        weight *= _tukey(_mean_around(cells, weight / variance, uneven))
        check_count(int(np.count_nonzero(weight)), settings)
        response = (cells.direction * (weight / variance)[:, None]).T
        information = response @ cells.direction
        if np.linalg.cond(information) > _SINGULAR:
            raise GroundError("directions that support the best plane: all in one plane found, a spread needed")
        step = np.linalg.solve(information, response @ cells.residual)
        m = m + step
        if step @ information @ step < settled:
            break
    return _Solution(m, cells, weight, np.linalg.solve(information, response).T, unevenness_m)


def _covariance(solution: _Solution, settings: GroundSettings) -> FloatArray:
    """Return the covariance of m, shape (3, 3): of noise, of unevenness, and of what all points have in common."""
    cells, gain = solution.cells, solution.gain
    supports = solution.weight > 0.0
    each = np.where(supports, cells.variance / np.where(supports, solution.weight, 1.0), 0.0)
    # b standard deviations of each point, where all have them in common, add b times this to m.
    shared = settings.shared_noise_share * (cells.sigma @ gain)
    patches = patches_of(
        solution.m, cells.direction, cells.area_m2, cells.residual, cells.variance, solution.weight, gain
    )
    uneven = covariance_of_unevenness(patches)
    covariance: FloatArray = (gain.T * each) @ gain + uneven + np.outer(shared, shared)
    return covariance


def _cell_means(partition: _Partition, m: FloatArray, settings: GroundSettings) -> _Cells:
    rays, cell, size = partition.rays, partition.cell, len(partition.place)
    inverse = rays.directions @ m
    meets = inverse > 0.0
    if not meets.all():
        rays, cell, inverse = rays[meets], cell[meets], inverse[meets]
    residual = 1.0 / rays.range_m - inverse
    variance = rays.variance_of_inverse(inverse, m)
    per_metre = np.linalg.norm(m) * inverse
    weight = _tukey(residual / np.sqrt(variance + (settings.unevenness_m * per_metre) ** 2)) / variance
    total = np.bincount(cell, weight, minlength=size)
    kept = total > 0.0
    check_count(int(np.count_nonzero(kept)), settings)
    columns = [residual, *rays.directions.T, rays.sigma_of_inverse(inverse), variance, weight * variance, per_metre]
    means = [np.bincount(cell, weight * column, minlength=size)[kept] / total[kept] for column in columns]
    return _Cells(
        residual=means[0],
        direction=np.stack(means[1:4], axis=1),
        variance=means[6] / total[kept] + SHARED_IN_CELL * means[5],
        sigma=means[4],
        per_metre=means[7],
        place=partition.place[kept],
        area_m2=(_CELL * np.linalg.norm(m) / means[7]) ** 2,
    )


def _unevenness(cells: _Cells, settings: GroundSettings) -> float:
    """Return the standard deviation of the ground's height, the likeliest under Student's t.

    Only cells below the plane are asked: those above may be pavement or grass, but below the ground there is nothing
    but noise.
    """
    below = cells.residual < 0.0
    tried_m = settings.unevenness_m * _FRACTIONS
    variance = cells.variance[below] + (tried_m[:, None] * cells.per_metre[below]) ** 2
    squared = cells.residual[below] ** 2
    cost = np.sum(np.log(variance) + (_STUDENT + 1.0) * np.log1p(squared / (_STUDENT * variance)), axis=1)
    return float(tried_m[int(np.argmin(cost))])


def _raised(cells: _Cells, variance: FloatArray, share: FloatArray) -> FloatArray:
    """Return how likely each cell is raised by up to a kerb, shape (n,), where so large a share of its like is.

    Far away a pavement does not stand out from the noise. But a cell that is a little above the plane is likelier one
    than a cell below it, and a weight of how likely it is ground leaves no bias: over all cells, raised or not, the
    mean of this weight times any function is the mean of the function over the ground.
    """
    sigma = np.sqrt(variance)
    standardised, kerb = cells.residual / sigma, _KERB_M * cells.per_metre / sigma
    # Both densities in standard deviations; heights up to the kerb's are equally likely.
    ground = (1.0 - share) * np.exp(-0.5 * standardised**2) / np.sqrt(2.0 * np.pi)
    above = share * (ndtr(standardised) - ndtr(standardised - kerb)) / kerb
    raised: FloatArray = above / np.maximum(ground + above, np.finfo(float).tiny)
    return raised


def _share_around(cells: _Cells, raised: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Return the share of raised cells around each place, of the shape of the grid of places.

    As if one more cell were there that is like the mean of all.
    """
    index = tuple(cells.place.T)

    def around(values: FloatArray) -> FloatArray:
        grid = np.zeros(shape)
        np.add.at(grid, index, values)
        sums: FloatArray = uniform_filter(grid, size=_BLOCK, mode="constant") * float(_BLOCK**2)
        return np.maximum(sums, 0.0)

    share: FloatArray = (around(raised) + raised.mean()) / (around(np.ones(len(raised))) + 1.0)
    return share


def _mean_around(cells: _Cells, pull: FloatArray, uneven: FloatArray) -> FloatArray:
    """Return the mean residual of the cells around each one in its own standard deviations, shape (n,).

    In a single cell far away a pavement is lost in the noise, in a block of cells it is not. Unevenness is taken as
    common to all of them.
    """
    index = tuple(cells.place.T)

    def around(values: FloatArray) -> FloatArray:
        grid = np.zeros(cells.place.max(axis=0) + 1)
        np.add.at(grid, index, values)
        sums: FloatArray = uniform_filter(grid, size=_BLOCK, mode="constant")[index]
        return sums * float(_BLOCK**2)

    # Sums of what is nowhere negative, up to the filter's rounding.
    total = np.maximum(around(pull), np.maximum(pull, np.finfo(float).tiny))
    standardised: FloatArray = around(pull * cells.residual) / total / np.sqrt(1.0 / total + uneven)
    return standardised


def check_count(cells: int, settings: GroundSettings) -> None:
    """Hold the number of cells that support a plane against the settings.

    Raises
    ------
    GroundError
        If there are too few.
    """
    if cells < settings.min_cells:
        raise GroundError(
            f"cells of {_CELL} rad on the best plane: {cells} found, at least {settings.min_cells} needed"
        )


def _tukey(standardised: FloatArray) -> FloatArray:
    """Return Tukey's biweight, 1 at zero and 0 from `_TUKEY` on."""
    weight: FloatArray = np.maximum(1.0 - (standardised / _TUKEY) ** 2, 0.0) ** 2
    return weight
