"""Fit of the ground plane to a point cloud (the paper's section III-A)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laci_stereo.core.errors import GroundError
from laci_stereo.core.frames import Axes, FloatArray, rigid
from laci_stereo.core.ground.fit import Fit, check_count, fit_inverse_range
from laci_stereo.core.ground.rays import GATE, Rays, as_rays, one_per_bearing
from laci_stereo.core.ground.start import can_be_ground, principal_axes, robust_start, where_it_can_be
from laci_stereo.core.settings import GroundSettings

# Below this angle between forward and the normal, a tilt of 0.01 deg already yaws the level frame by 0.5 deg.
_MIN_FORWARD_ANGLE_DEG = 1.0
# Power of the range by which a ray is weighted: 1 measures azimuth and log range uniformly, 3 measures area.
_FARTHER = 2.0
_DEFAULTS = GroundSettings()


@dataclass(frozen=True)
class GroundPlane:
    """A plane in the sensor frame: ``normal . p + height_m = 0``.

    Attributes
    ----------
    normal : ndarray, shape (3,)
        Unit vector in the sensor frame that points from the plane to the sensor, which is up.
    height_m : float
        Height of the sensor's origin above the plane.
    covariance_sensor : ndarray, shape (4, 4)
        Covariance of (rotation vector in sensor axes [rad], height [m]), of rank 3: a rotation about the normal leaves
        the plane unchanged. The rotation vector is the one that, applied after the estimated transform, yields the true
        one. The covariance includes the noise of each point, noise shared by a cell or by all points, and the
        unevenness of a paved road as far as the points do not determine it. It does not include a ground that is bent
        as a whole, by a wave longer than the visible part, or that is raised a few centimetres over much of its area.
        See `covariance_level`.
    inlier_share : float
        Fraction of all points that lie on the plane within their noise.
    support_cells : int
        Number of cells of bearing that agree with the plane.
    support_share : float
        Fraction of supporting cells among all cells with a free view of the plane within the measured range.
    support_area_m2 : float
        Area on the plane that the supporting cells cover.
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
            The sensor's axes; ``forward``, projected onto the plane, becomes x.

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

        If d is the small rotation vector made of the first two, ``exp(d) @ T_level_sensor`` is the true transform.

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


def fit_ground(
    points: FloatArray,
    sigma_along_m: FloatArray,
    sigma_across_m: FloatArray,
    up: tuple[float, float, float],
    settings: GroundSettings = _DEFAULTS,
    window_rad: float = 0.0,
) -> GroundPlane:
    """Fit the ground plane (paper, section III-A).

    The fit has three stages: a robust start, the paper's iterated principal axes from that start, and a final fit in
    inverse range, in which the plane is linear and the noise of a stereo camera is uniform. Of the paper's height
    vector only the third component is meant: the distance along the normal.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Points in the sensor frame, metres; all lines of sight start at the origin.
    sigma_along_m, sigma_across_m : ndarray, shape (n,)
        Standard deviations along and across the line of sight, metres.
    up : tuple of float
        Axis in the sensor frame that points roughly against gravity.
    settings : GroundSettings
    window_rad : float
        Side of a camera's square matching window, as an angle: points in one window share their noise. 0 for a scanner.

    Returns
    -------
    GroundPlane

    Raises
    ------
    GroundError
        If the input is malformed, or no plane within the settings has enough support.
    """
    up_axis = _checked_up(up)
    rays = as_rays(points, sigma_along_m, sigma_across_m, settings, window_rad)
    thinned = one_per_bearing(rays)
    m = robust_start(thinned, up_axis, settings)
    m = principal_axes(thinned, m, settings)
    fit = fit_inverse_range(rays, m, settings)
    return _plane(rays, fit, up_axis, settings)


def fit_farther_ground(
    points: FloatArray,
    sigma_along_m: FloatArray,
    sigma_across_m: FloatArray,
    up: tuple[float, float, float],
    settings: GroundSettings = _DEFAULTS,
    window_rad: float = 0.0,
) -> GroundPlane:
    """Fit the ground plane with a larger weight on distant points; parameters and errors are those of `fit_ground`.

    A verge below the sensor fills more of the view than the road behind it, and a plane through the verge and the near
    lane is the plane of neither. The stage of principal axes is left out: it would lead back to that plane, since it
    gives the largest weight to the nearest points.
    """
    up_axis = _checked_up(up)
    rays = as_rays(points, sigma_along_m, sigma_across_m, settings, window_rad)
    m = robust_start(one_per_bearing(rays), up_axis, settings, farther=_FARTHER)
    return _plane(rays, fit_inverse_range(rays, m, settings), up_axis, settings)


def fit_ground_beside(
    points: FloatArray,
    sigma_along_m: FloatArray,
    sigma_across_m: FloatArray,
    ground: GroundPlane,
    within_m: tuple[float, float],
    settings: GroundSettings = _DEFAULTS,
    window_rad: float = 0.0,
) -> GroundPlane:
    """Fit the ground plane to the points that are off a known ground plane but near it.

    Terrain that fills more of the view than the road does captures the first fit. A road that is higher than this
    terrain then appears as an object on it, and the vehicles on the road merge with that object.

    Parameters
    ----------
    points, sigma_along_m, sigma_across_m, settings, window_rad
        See `fit_ground`, which also lists the errors.
    ground : GroundPlane
        The known ground plane.
    within_m : tuple of float
        The least and the largest height of the points above that plane.
    """
    rays = as_rays(points, sigma_along_m, sigma_across_m, settings, window_rad)
    (heights,), (variance,) = rays.heights_above(-ground.normal[None] / ground.height_m)
    off = np.abs(heights) > GATE * np.sqrt(variance + ground.unevenness_m**2)
    beside = off & (heights > within_m[0]) & (heights < within_m[1])
    x, y, z = ground.normal.tolist()
    return fit_ground(points[beside], sigma_along_m[beside], sigma_across_m[beside], (x, y, z), settings, window_rad)


def check_support(ground: GroundPlane, settings: GroundSettings) -> None:
    """Check the support of a plane against the settings.

    Raises
    ------
    GroundError
        If too few cells, or too small a fraction of them, support the plane.
    """
    check_count(ground.support_cells, settings)
    _check_share(ground.support_share, settings)


def _check_share(share: float, settings: GroundSettings) -> None:
    if share < settings.min_support_share:
        raise GroundError(
            f"share of the view that supports the best plane: {100 * share:.1f} % found, "
            f"at least {100 * settings.min_support_share:g} % needed"
        )


def _checked_up(up: tuple[float, float, float]) -> FloatArray:
    axis = np.asarray(up, dtype=np.float64)
    if axis.shape != (3,) or not np.isfinite(axis).all() or not np.linalg.norm(axis) > 0.0:
        raise GroundError(f"up axis: {up} found, three finite numbers that are not all zero needed")
    unit: FloatArray = axis / np.linalg.norm(axis)
    return unit


def _plane(rays: Rays, fit: Fit, up: FloatArray, settings: GroundSettings) -> GroundPlane:
    """Check the position and support of a fit, and convert m and its covariance to normal and height."""
    height_m = 1.0 / float(np.linalg.norm(fit.m))
    normal = -height_m * fit.m
    if not can_be_ground(fit.m[None], up, settings)[0]:
        tilt_deg = np.degrees(np.arccos(np.clip(normal @ up, -1.0, 1.0)))
        found = f"{tilt_deg:.1f} deg from up, {height_m:.2f} m below"
        raise GroundError(f"best plane: {found} found, {where_it_can_be(settings)}")
    support_share = fit.cells / fit.cells_seen
    _check_share(support_share, settings)
    # d(height) = height^2 normal . dm; d(normal) = -height (I - normal normal^T) dm; rotation = d(normal) x normal.
    cross = np.cross(np.eye(3), normal)
    jacobian = np.vstack([-height_m * cross.T, height_m**2 * normal])
    covariance = jacobian @ fit.covariance @ jacobian.T
    tilt_sigma_deg = float(np.degrees(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1])))
    if tilt_sigma_deg > settings.max_tilt_sigma_deg:
        raise GroundError(
            f"standard deviation of the best plane's tilt: {tilt_sigma_deg:.2f} deg found, "
            f"at most {settings.max_tilt_sigma_deg:g} deg needed"
        )
    heights, variance = rays.heights_above(fit.m[None])
    on_plane = np.abs(heights) <= GATE * np.sqrt(variance + fit.unevenness_m**2)
    return GroundPlane(
        normal=normal,
        height_m=height_m,
        covariance_sensor=covariance,
        inlier_share=float(np.mean(on_plane)),
        support_cells=fit.cells,
        support_share=support_share,
        support_area_m2=fit.area_m2,
        unevenness_m=fit.unevenness_m,
    )
