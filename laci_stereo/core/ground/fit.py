"""The final fit of the ground plane, in inverse range.

The model ``1 / rho = m . e`` (see `laci_stereo.core.ground.rays`) is linear in m. For a stereo camera 1 / rho is the
disparity times a factor that each ray determines exactly, so its noise is uniform there; for a LiDAR the known noise of
the range is propagated to first order.

The plane is divided into cells, `_CELL` rad wide and `_CELL` of log range deep, so that their size grows with the
range. The support of a plane is counted in cells, not points: dense surfaces near the sensor do not outvote the road;
the mean of a cell is so accurate that the foot of a wall and a pavement stand out; and noise shared by neighbouring
points is counted once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter
from scipy.special import ndtr

from laci_stereo.core.errors import GroundError
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray
from laci_stereo.core.ground.rays import GATE, Rays, random_part
from laci_stereo.core.ground.uneven import covariance_of_unevenness, patches_of
from laci_stereo.core.robust import STUDENT, TUKEY
from laci_stereo.core.settings import GroundSettings

# Side of a cell: 1 m at 20 m, narrower than a car or a pavement, and wide enough for the mean of many points.
_CELL = 0.05
# Largest number of points used: several in each of a few thousand cells.
_POINTS = 50_000
_MAX_ITERATIONS = 30
# Convergence limits, squared length of a step in standard deviations of m: for placing the cells, and for the result.
_NEAR, _SETTLED = 0.1**2, 0.01**2
# Largest height of a kerb; higher objects stand out from the noise without further evidence.
_KERB_M = 0.15
# Side of a block in cells: wider than the reach of a matching window, and about as wide as a pavement.
_BLOCK = 5
# Largest condition number: directions within one cell have about 1 / _CELL^4, and no solvable case is near this limit.
_SINGULAR = 1e13
# Fractions of the largest unevenness that are tried; from 0.1 on, neighbouring ones differ by at most a half.
_FRACTIONS = np.array([0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8, 1.0])


@dataclass(frozen=True)
class Fit:
    """The result of the fit in inverse range.

    Attributes
    ----------
    m : ndarray, shape (3,)
        The plane; see `laci_stereo.core.ground.rays`.
    covariance : ndarray, shape (3, 3)
        Covariance of m.
    unevenness_m : float
        Standard deviation of the ground about the plane.
    cells, cells_seen : int
        Number of cells that support the plane, and of all cells with a free view of it.
    area_m2 : float
        Area on the plane that the supporting cells cover.
    """

    m: FloatArray
    covariance: FloatArray
    unevenness_m: float
    cells: int
    cells_seen: int
    area_m2: float


@dataclass(frozen=True)
class _Partition:
    """Rays with a free view of the plane, the index of each ray's cell, and each cell's azimuth sector and ring."""

    rays: Rays
    cell: IntArray
    place: IntArray


@dataclass(frozen=True)
class _Cells:
    """Means over those points of each cell that are on the plane within their noise.

    ``variance`` is that of the mean residual by which cells are weighted; ``covaried`` what the covariance of points in
    the same matching window adds to it in sums over many cells; ``sigma`` the standard deviation of one point's 1 /
    range due to noise along its ray; ``per_metre`` the increase of 1 / range per metre above the plane; ``place`` the
    cell's azimuth sector and ring; ``area_m2`` the area of the cell on the plane, apart from the slant.
    """

    residual: FloatArray
    direction: FloatArray
    variance: FloatArray
    covaried: FloatArray
    sigma: FloatArray
    per_metre: FloatArray
    place: IntArray
    area_m2: FloatArray


@dataclass(frozen=True)
class _Solution:
    """The plane m, the n cells that it was fitted to, and their weights (0 to 1).

    ``gain``, shape (n, 3), is the derivative of m with respect to the residual of each cell.
    """

    m: FloatArray
    cells: _Cells
    weight: FloatArray
    gain: FloatArray
    unevenness_m: float


def fit_inverse_range(rays: Rays, m: FloatArray, settings: GroundSettings) -> Fit:
    """Solve 1 / range = m . e robustly, twice, because the cells depend on the plane.

    Parameters
    ----------
    rays : Rays
    m : ndarray, shape (3,)
        Initial value of the plane.
    settings : GroundSettings

    Raises
    ------
    GroundError
        If too few cells support the plane, or if the directions of those that do lie in one plane.
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
    """Divide the rays that have a free view of the plane, within the measured range, into cells.

    A ray is selected by its bearing and by the objects seen in the rays above it, never by its own measured range: that
    would truncate the noise on one side.
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
    # The number of cells per ring keeps them _CELL wide: the circle shrinks to a point below the sensor.
    steepness = np.exp(-_CELL * (first + ring + 0.5)) / np.linalg.norm(m)
    around = np.floor(azimuth[kept] * np.sqrt(np.maximum(1.0 - steepness**2, 0.0)) / _CELL).astype(np.int64)
    _, example, cell = np.unique(ring * (around.max() + 1) + around, return_index=True, return_inverse=True)
    place = np.stack([sector[example], ring[example]], axis=1)
    return _Partition(rays[kept], cell.reshape(-1).astype(np.int64), place)


def _hidden(rays: Rays, m: FloatArray, sector: IntArray, ring: IntArray, first: float) -> BoolArray:
    """Return which rays would meet the plane behind the foot of an object that stands on it, shape (n,).

    Just behind the foot of a wall, the points of the wall are still on the plane within their noise, all of them on one
    side of it. The rays above them, however, show the wall and its distance.

    Parameters
    ----------
    rays : Rays
    m : ndarray, shape (3,)
    sector, ring : ndarray, shape (n,)
        Direction of each ray, in cells: its azimuth, and the log range at which it meets the plane. Rays near the
        horizon are in the last ring.
    first : float
        The log range at which ring 0 begins, in cells.
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
    # The foot is taken one standard deviation nearer, since the noise of the points there hides it.
    foot = total(above * (measured + sigma)) / np.maximum(total(above), 1.0)
    # Inverse range of the foot in this ring or the next one that contains a standing object; 0 beyond the last one.
    rings = np.arange(shape[1])
    beyond = np.minimum.accumulate(np.where(stands, rings, shape[1])[:, ::-1], axis=1)[:, ::-1]
    nearest = np.take_along_axis(np.pad(foot, ((0, 0), (0, 1))), beyond, axis=1)
    hidden: BoolArray = (nearest > np.exp(-_CELL * (first + rings + 1)))[sector, ring]
    return hidden


def _solve(partition: _Partition, m: FloatArray, settled: float, settings: GroundSettings) -> _Solution:
    """Solve by iteratively reweighted least squares, until m moves by much less than its own standard deviation.

    ``settled`` is the convergence limit: the squared length of a step in standard deviations.
    """
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
    """Return the covariance of m, shape (3, 3), due to noise, unevenness, and the error shared by all points."""
    cells, gain = solution.cells, solution.gain
    supports = solution.weight > 0.0
    noise = cells.variance + cells.covaried
    each = np.where(supports, noise / np.where(supports, solution.weight, 1.0), 0.0)
    # A shared error of b standard deviations in every point adds b times `cells.sigma @ gain` to m.
    shared = settings.shared_noise_share * (cells.sigma @ gain)
    patches = patches_of(solution.m, cells.direction, cells.area_m2, cells.residual, noise, solution.weight, gain)
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
    single, noise, inverse = means[6] / total[kept], means[5], means[7] / np.linalg.norm(m)
    # A matching window fills this fraction of a cell seen at a right angle, and more of one at a grazing angle. The
    # weights do without the latter: a pavement would not stand out from noise that is claimed in full. On two
    # recordings the actual variance is half of the claimed one, and two fifths of it differ from frame to frame. A
    # scanner's points share the error of their laser.
    window = (rays.window_rad / _CELL) ** 2
    shared = min(window, 1.0) if window > 0.0 else settings.shared_noise_share**2
    return _Cells(
        residual=means[0],
        direction=np.stack(means[1:4], axis=1),
        variance=(1.0 - shared) * single + shared * noise,
        covaried=np.maximum(window * np.linalg.norm(m) / inverse - shared, 0.0) * noise,
        sigma=means[4],
        per_metre=means[7],
        place=partition.place[kept],
        area_m2=(_CELL / inverse) ** 2,
    )


def _unevenness(cells: _Cells, settings: GroundSettings) -> float:
    """Return the maximum-likelihood standard deviation of the ground's height under Student's t.

    Only cells below the plane are used: those above it may be pavement or grass, but below the ground there is only
    noise.
    """
    below = cells.residual < 0.0
    tried_m = settings.unevenness_m * _FRACTIONS
    variance = cells.variance[below] + (tried_m[:, None] * cells.per_metre[below]) ** 2
    squared = cells.residual[below] ** 2
    cost = np.sum(np.log(variance) + (STUDENT + 1.0) * np.log1p(squared / (STUDENT * variance)), axis=1)
    return float(tried_m[int(np.argmin(cost))])


def _raised(cells: _Cells, variance: FloatArray, share: FloatArray) -> FloatArray:
    """Return the probability that each cell is raised by up to the height of a kerb, shape (n,).

    Far away a pavement does not stand out from the noise. A cell slightly above the plane is, however, more likely to
    be pavement than a cell below it, and weighting each cell by its probability of being ground leaves no bias: over
    all cells, raised or not, the expectation of this weight times any function is proportional to the function's
    expectation over the ground.

    ``share``, shape (n,), is the prior probability: the fraction of raised cells around each cell.
    """
    sigma = np.sqrt(variance)
    standardised, kerb = cells.residual / sigma, _KERB_M * cells.per_metre / sigma
    # Both densities are per standard deviation; the prior of a raised cell's height is uniform up to the kerb's.
    ground = (1.0 - share) * np.exp(-0.5 * standardised**2) / np.sqrt(2.0 * np.pi)
    above = share * (ndtr(standardised) - ndtr(standardised - kerb)) / kerb
    raised: FloatArray = above / np.maximum(ground + above, np.finfo(float).tiny)
    return raised


def _share_around(cells: _Cells, raised: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Return the fraction of raised cells in the block around each place, with the shape of the grid of places.

    One pseudo-cell with the mean of all cells is added to each block.
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
    """Return the mean residual of the block around each cell, in standard deviations of this mean, shape (n,).

    Far away a pavement is lost in the noise of a single cell, but not in that of a block of cells. Unevenness is taken
    as fully correlated within a block.
    """
    index = tuple(cells.place.T)

    def around(values: FloatArray) -> FloatArray:
        grid = np.zeros(cells.place.max(axis=0) + 1)
        np.add.at(grid, index, values)
        sums: FloatArray = uniform_filter(grid, size=_BLOCK, mode="constant")[index]
        return sums * float(_BLOCK**2)

    # The sums are of non-negative values; the limit removes the filter's rounding errors.
    total = np.maximum(around(pull), np.maximum(pull, np.finfo(float).tiny))
    standardised: FloatArray = around(pull * cells.residual) / total / np.sqrt(1.0 / total + uneven)
    return standardised


def check_count(cells: int, settings: GroundSettings) -> None:
    """Check the number of cells that support a plane against the settings.

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
    """Return Tukey's biweight: 1 at zero, and 0 from `TUKEY` on."""
    weight: FloatArray = np.maximum(1.0 - (standardised / TUKEY) ** 2, 0.0) ** 2
    return weight
