"""A stereo camera without images: true depth along pixels' rays, and a simulation of block matching on it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, get_args

import cv2
import numpy as np
from scipy.special import ndtri

from laci_stereo.core.cloud import Cameras, PointCloud
from laci_stereo.core.frames import BoolArray, FloatArray, IntArray, invert, transform
from laci_stereo.io.rig.stereo_rig import Lens, StereoRig
from laci_stereo.stereo.recording import POINTING_SIGMA_PX
from laci_stereo.stereo.scene import BLEED_PX
from laci_stereo.stereo.settings import StereoSettings
from tools.scenes.geometry import Hits, Material, RayCaster
from tools.scenes.textures import mirror, mirrored

StereoName = Literal["stereo_02", "stereo_05", "stereo_10"]
STEREOS: tuple[StereoName, ...] = get_args(StereoName)

WIDTH_PX, STRIDE = 1280, 3
"""Width of the images, and the spacing of the pixels that have a ray."""

EDGE_PX = 8
"""Half-width of the matching windows: nearer to the image's border they are cut off."""

JUMP_PX = 1.5
"""A larger step of disparity between neighbouring rays is a border between two surfaces."""


@dataclass(frozen=True)
class Surface:
    """Results of matching on a material.

    Attributes
    ----------
    open_ : float
        Fraction of its pixels without a disparity.
    sigma_px : float
        Standard deviation of the matched disparities: the median, as it varies with the texture.
    gross : float
        Fraction of the matched pixels that have the disparity of another surface.
    """

    open_: float
    sigma_px: float
    gross: float


SURFACES = {
    Material.ROAD: Surface(0.002, 0.07, 0.0002),
    Material.PAINT: Surface(0.3, 0.09, 0.0),
    Material.KERB: Surface(0.1, 0.08, 0.0),
    Material.GRASS: Surface(0.001, 0.05, 0.0002),
    Material.WALL: Surface(0.005, 0.09, 0.0001),
    Material.FOLIAGE: Surface(0.003, 0.08, 0.0),
    Material.METAL: Surface(0.1, 0.1, 0.01),
    Material.CAR_PAINT: Surface(0.3, 0.16, 0.02),
    Material.GLASS: Surface(0.5, 0.16, 0.06),
    Material.TYRE: Surface(0.1, 0.08, 0.0),
    Material.CLOTH: Surface(0.0, 0.09, 0.0),
    Material.LAMP: Surface(0.1, 0.1, 0.01),
}
"""Measured on rendered pairs, matched by the tool itself: ``python -m tools.scenes.compare_disparity`` with ``--first
100 --seeds 3 --frames 3`` and with ``--first 200 --seeds 4 --frames 2``, the scenes' mean, rounded. Scenes differ: 0.08
to 0.48 of car paint is open, 0.24 to 0.61 of glass, and 0 to 0.64 of painted lines where they are overexposed; up to
0.09 of paint and 0.25 of glass is gross. Lamps, which were too small, have the values of metal."""

SKY = Surface(1.0, 0.1, 0.0)

MOST_OPEN = 0.99
"""Upper bound of the open fraction for the median texture of the matched pixels: above it, as in the sky, nothing is
matched."""

SPREAD = 0.6
"""Standard deviation of the logarithm of sigma within a material; from the same comparison: the root mean square is 1.4
times the median, exp(SPREAD^2)."""

TOLD = 0.5
"""Fraction of sigma that the matcher claims, in addition to its floor; from the same comparison: 0.103 to 0.130 px on
the road, 0.103 to 0.205 px on paint, from the tenth to the ninetieth percentile."""

WINDOW_SIGMA_PX = 4.0
"""Noise is smoothed with this standard deviation: its correlation falls to 1 / e at twice this distance; in the same
comparison, at 7 to 8 px."""

GROSS_SIGMA_PX = 5.0
"""Mismatches are smoothed with this standard deviation: the matcher drops islands of less than 100 pixels."""

GROSS_PX = (1.0, 2.0)
"""Mismatches are too far by at least the first, and by more with the second as a standard deviation; in the same
comparison, medians of 1.3 to 1.9 px on paint and 1 to 5 px on glass, which shows specular reflections."""

ALBEDOS = (0.04, 0.8)
"""Albedos of black and of white bodies: the less light a body scatters, the more its specular reflections show."""

BESIDE_PX, BESIDE_OPEN = 6, 0.2
"""Within this distance outside of a near outline, at least this fraction is open; in the same comparison, 0.1 to
0.4."""


@dataclass(frozen=True)
class StereoCamera:
    """A rectified pair; axes are OpenCV's.

    Attributes
    ----------
    name : StereoName
    baseline_m, focal_px : float
    size_px : tuple of int
    stride : int
        Spacing of the pixels that have a ray, in both directions.
    period_s : float
    focal_error, baseline_error : float
        Relative errors of focal length and baseline in its calibration; positive if it overestimates them.
    turned_deg : tuple of float
        Rotation of its right camera since it was calibrated, see `StereoSettings.turn_deg`.
    apart_s : float
        Time from its left to its right images.
    """

    name: StereoName
    baseline_m: float
    focal_px: float
    size_px: tuple[int, int] = (WIDTH_PX, WIDTH_PX * 9 // 16)
    stride: int = STRIDE
    period_s: float = 0.1
    focal_error: float = 0.0
    baseline_error: float = 0.0
    turned_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    apart_s: float = 0.0

    @property
    def turned_px(self) -> float:
        """Increase of the disparities by the right camera's yaw; rows determine pitch and roll, so these are known."""
        return -self.focal_px * float(np.radians(self.turned_deg[1]))

    @cached_property
    def as_told(self) -> StereoCamera:
        """The camera as its calibration describes it."""
        return replace(
            self,
            focal_px=self.focal_px * (1.0 + self.focal_error),
            baseline_m=self.baseline_m * (1.0 + self.baseline_error),
            focal_error=0.0,
            baseline_error=0.0,
            turned_deg=(0.0, 0.0, 0.0),
            apart_s=0.0,
        )

    def at_rate(self, frame_rate_hz: float) -> StereoCamera:
        """Return the camera at another frame rate."""
        return replace(self, period_s=1.0 / frame_rate_hz)

    @cached_property
    def pixels(self) -> tuple[FloatArray, FloatArray]:
        """Column and row of each ray's pixel, relative to the principal point, shape (rows, columns)."""
        width, height = self.size_px
        u = np.arange(self.stride // 2, width, self.stride) - (width - 1) / 2
        v = np.arange(self.stride // 2, height, self.stride) - (height - 1) / 2
        across, down = np.meshgrid(u, v)
        return across, down

    @cached_property
    def rays(self) -> FloatArray:
        """Points at depth 1 on each ray, shape (rows * columns, 3)."""
        u, v = self.pixels
        return np.column_stack([u.ravel() / self.focal_px, v.ravel() / self.focal_px, np.ones(u.size)])

    @cached_property
    def ray_lengths(self) -> FloatArray:
        """Distance over depth on each ray, shape (rows * columns,)."""
        lengths: FloatArray = np.linalg.norm(self.rays, axis=1)
        return lengths

    @property
    def rig(self) -> StereoRig:
        """The rig whose raw images are the rectified ones."""
        width, height = self.size_px
        f = self.focal_px
        K = np.array([[f, 0.0, (width - 1) / 2], [0.0, f, (height - 1) / 2], [0.0, 0.0, 1.0]])
        lens = Lens(K, np.zeros(5), self.size_px, "pinhole")
        return StereoRig(lens, lens, np.eye(3), np.array([-self.baseline_m, 0.0, 0.0]))

    def sees(self, points: FloatArray) -> BoolArray:
        """Return which points, shape (n, 3), in the sensor frame, are in the field of view."""
        depth = np.maximum(points[:, 2], 1e-6)
        seen: BoolArray = points[:, 2] > 0.5
        for axis, extent in enumerate(self.size_px):
            seen &= np.abs(points[:, axis] / depth) < extent / 2 / self.focal_px
        return seen


def stereo_camera(name: StereoName, focal_px: float = 1100.0, width_px: int = WIDTH_PX) -> StereoCamera:
    """Return a camera with a baseline of 0.2, 0.5 or 1 m; images of any width have about as many rays."""
    baseline_m = {"stereo_02": 0.2, "stereo_05": 0.5, "stereo_10": 1.0}[name]
    stride = max(1, round(STRIDE * width_px / WIDTH_PX))
    return StereoCamera(name, baseline_m, focal_px, (width_px, width_px * 9 // 16), stride)


@dataclass(frozen=True)
class Mounted:
    """A camera mounted in a scene; its rays' intersections with static bodies are the same in every frame.

    Attributes
    ----------
    camera : StereoCamera
    caster : RayCaster
    T_world_sensor : ndarray, shape (4, 4)
    """

    camera: StereoCamera
    caster: RayCaster
    T_world_sensor: FloatArray

    @cached_property
    def directions(self) -> FloatArray:
        """Unit direction of each ray in the world, shape (rows * columns, 3)."""
        unit = self.camera.rays / self.camera.ray_lengths[:, None]
        turned: FloatArray = unit @ self.T_world_sensor[:3, :3].T
        return turned

    @cached_property
    def moving(self) -> BoolArray:
        """Bodies, with the sky appended, that appear as a change; leaves sway permanently, which is taken for noise."""
        leafy = (bool((body.mesh.material == Material.FOLIAGE).any()) for body in self.caster.bodies)
        moving = [not body.static and not leaves for body, leaves in zip(self.caster.bodies, leafy, strict=True)]
        return np.array([*moving, False])

    def hits(self, time_s: float) -> Hits:
        """Return the first intersections of the rays."""
        return self.caster.before(self._still, self.T_world_sensor[:3, 3], self.directions, time_s)

    @cached_property
    def _still(self) -> Hits:
        return self.caster.still(self.T_world_sensor[:3, 3], self.directions)


@dataclass(frozen=True)
class StereoFlaws:
    """How disparities differ from the truth.

    Attributes
    ----------
    noise : float
        Scales the standard deviation of disparities.
    lasting : float
        Fraction of their variance that is the same in all frames, where nothing moves: a third on the road in the
        comparison of `SURFACES`, 0.6 on that of two path-traced recordings.
    offset_px : float
        Offset of all disparities: rectification leaves 0.03 to 0.05 px.
    bleed_px : float
        Growth of a near surface at its borders; 0.3 to 1.7 in the comparison of
        `SURFACES`, where a fifth of the growth is open.
    gross : float
        Scales the fraction of mismatches.
    open_ : float
        Scales the fraction of pixels without a disparity.
    gloss_px : float
        Decrease of disparities where only a body's specular reflection is visible: on sides of cars at a grazing angle
        of 13 deg, the median was 0 to 0.45 px too small in nine rendered scenes.
    """

    noise: float = 1.0
    lasting: float = 0.6
    offset_px: float = 0.0
    bleed_px: float = 1.25
    gross: float = 1.0
    open_: float = 1.0
    gloss_px: float = 0.0


@dataclass(frozen=True)
class Matched:
    """A frame of disparities.

    Attributes
    ----------
    disparity_px, sigma_px : ndarray, shape (rows, columns)
        NaN where nothing is matched.
    moving : ndarray of bool, shape (rows, columns)
        Near a moving body.
    body : ndarray of int64, shape (rows, columns)
        The body that each ray truly meets; -1 for none.
    """

    disparity_px: FloatArray
    sigma_px: FloatArray
    moving: BoolArray
    body: IntArray


def match_frame(mounted: Mounted, flaws: StereoFlaws, time_s: float, seed: tuple[int, int]) -> Matched:
    """Simulate the disparities of the frame at ``time_s``.

    Parameters
    ----------
    mounted : Mounted
    flaws : StereoFlaws
    time_s : float
    seed : tuple of int
        Seeds of the scene and of the frame.
    """
    rng = np.random.default_rng(seed)
    camera, hits = mounted.camera, mounted.hits(time_s)
    shape = camera.pixels[0].shape
    faces = mounted.caster.faces(hits)
    open_, sigma, gross, shiny = (values.reshape(shape) for values in _surfaces(mounted.caster, faces))
    true = (camera.focal_px * camera.baseline_m * camera.ray_lengths / hits.distance_m).reshape(shape)
    true = true - _moved_px(mounted, hits, time_s).reshape(shape)
    texture = _texture(mounted.caster, hits.body, faces, seed[0]).reshape(shape) + _smooth(shape, 4, rng)
    texture /= np.sqrt(3.0)
    matched = _bled(true, flaws.bleed_px / camera.stride, rng)
    beside = _bled(true, float(round(BESIDE_PX / camera.stride)), rng) > true
    open_ = np.where(open_ < 1.0, flaws.open_ * open_, 1.0)
    # The worst texture is open: the median texture of the matched pixels is above that of all.
    middle = ndtri((1.0 + np.minimum(open_, MOST_OPEN)) / 2)
    open_ = np.maximum(open_, np.where(beside, flaws.open_ * BESIDE_OPEN, 0.0))
    # The near surfaces of both images grow, so the grown pixels pass the left-right consistency check.
    hidden = _occluded(camera, true) & (matched <= true + JUMP_PX)
    sigma = flaws.noise * sigma * np.exp(SPREAD * (middle - texture))
    told = np.hypot(StereoSettings().disparity_floor_px, TOLD * sigma)
    values = matched + flaws.offset_px + camera.turned_px + sigma * _noise(mounted, flaws, hits.body, seed[0], rng)
    elsewhere = _smooth(shape, GROSS_SIGMA_PX / camera.stride, rng) > -ndtri(flaws.gross * gross)
    values -= flaws.gloss_px * _mirrored(mounted, hits, shiny.ravel(), seed[0]).reshape(shape)
    too_far = GROSS_PX[0] + GROSS_PX[1] * np.abs(_smooth(shape, GROSS_SIGMA_PX / camera.stride, rng))
    values = np.where(elsewhere, values - too_far, values)
    known = (texture > ndtri(open_)) & ~hidden & (true > 0.5) & (values > told)
    known &= told <= StereoSettings().max_disparity_sigma_px
    body = hits.body.reshape(shape)
    reach = 2 * (BLEED_PX // camera.stride) + 1
    moving = cv2.dilate(mounted.moving[body].astype(np.uint8), np.ones((reach, reach), np.uint8)) > 0
    return Matched(np.where(known, values, np.nan), np.where(known, told, np.nan), moving, body)


def _moved_px(mounted: Mounted, hits: Hits, time_s: float) -> FloatArray:
    """Return by how many columns each ray's point moves in the right image since the left image's time, shape (n,)."""
    camera, moved = mounted.camera, np.zeros(len(hits.body))
    if camera.apart_s == 0.0:
        return moved
    T_sensor_world = invert(mounted.T_world_sensor)
    for index in np.flatnonzero(mounted.moving[:-1]).tolist():
        rays = np.flatnonzero(hits.body == index)
        points = mounted.T_world_sensor[:3, 3] + hits.distance_m[rays, None] * mounted.directions[rays]
        pose = mounted.caster.bodies[index].pose
        T_later = pose(time_s + camera.apart_s) @ invert(pose(time_s))
        columns = [
            camera.focal_px * (seen[:, 0] - camera.baseline_m) / seen[:, 2]
            for seen in (transform(T_sensor_world, points), transform(T_sensor_world @ T_later, points))
        ]
        moved[rays] = columns[1] - columns[0]
    return moved


def reproject(camera: StereoCamera, stamp_ns: int, matched: Matched, where: BoolArray) -> PointCloud:
    """Return the points of a frame.

    Parameters
    ----------
    camera : StereoCamera
    stamp_ns : int
        Unix time, nanoseconds.
    matched : Matched
    where : ndarray of bool, shape (rows, columns)
        Only these pixels.
    """
    keep = np.isfinite(matched.disparity_px) & where
    d, sigma, camera = matched.disparity_px[keep], matched.sigma_px[keep], camera.as_told
    u, v = (axis[keep] for axis in camera.pixels)
    depth = camera.focal_px * camera.baseline_m / d
    points = camera.rays[keep.ravel()] * depth[:, None]
    width, height = camera.size_px
    edge = (np.abs(u) > width / 2 - EDGE_PX) | (np.abs(v) > height / 2 - EDGE_PX) | (u - d < EDGE_PX - width / 2)
    return PointCloud(
        stamp_ns,
        points,
        sigma_along_m=np.linalg.norm(points, axis=1) * sigma / d,
        sigma_across_m=depth * (POINTING_SIGMA_PX / camera.focal_px),
        at_edge=edge,
        window_rad=StereoSettings().refine_window_px / camera.focal_px,
        cameras=Cameras(np.array([camera.baseline_m, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])),
    )


def _surfaces(caster: RayCaster, faces: IntArray) -> tuple[FloatArray, ...]:
    """Return for each ray: fraction without a disparity, standard deviation, fraction of mismatches, `mirror`."""
    kinds = [*((SURFACES[material], mirror(material)) for material in Material), (SKY, 0.0)]
    table = np.array([(kind.open_, kind.sigma_px, kind.gross, shiny) for kind, shiny in kinds])
    # A ray that meets nothing has the last index.
    return tuple(table[np.append(caster.materials, len(Material))[faces]].T)


def _mirrored(mounted: Mounted, hits: Hits, shiny: FloatArray, seed: int) -> FloatArray:
    """Return which fraction of the contrast at each ray is specular, shape (n,), from the reflectance ``shiny``."""
    least, most = np.log(ALBEDOS)
    of_body = np.exp(np.random.default_rng([seed, 6]).uniform(least, most, len(mounted.caster.bodies) + 1))
    scattered, cos = of_body[hits.body], -(mounted.directions * hits.normal).sum(axis=1)
    light = np.where(shiny > 0.0, mirrored(shiny, cos), 0.0)
    contrast: FloatArray = light**2 / (light**2 + ((1.0 - light) * scattered) ** 2)
    return contrast


def _texture(caster: RayCaster, body: IntArray, faces: IntArray, seed: int) -> FloatArray:
    """Return how well the surface at each ray can be matched: a normal number of the body plus one of the triangle."""
    rng = np.random.default_rng([seed, 5])
    of_body, of_face = (np.append(rng.normal(size=n), 0.0) for n in (len(caster.bodies), len(caster.materials)))
    sums: FloatArray = of_body[body] + of_face[faces]
    return sums


def _bled(true: FloatArray, cells: float, rng: np.random.Generator) -> FloatArray:
    """Grow near surfaces by a number of grid cells; a fraction of a cell is grown at random."""
    grown: FloatArray = true.copy()
    whole, part = int(cells), cells - int(cells)
    for step in range(whole + 1):
        near = np.asarray(cv2.dilate(grown, np.ones((3, 3), np.uint8)), dtype=np.float64)
        take = near > grown + JUMP_PX
        if step == whole:
            take &= rng.random(true.shape) < part
        grown = np.where(take, near, grown)
    return grown


def _occluded(camera: StereoCamera, true: FloatArray) -> BoolArray:
    """Return which pixels the right camera does not see: a pixel to their right occludes them there."""
    u = camera.pixels[0]
    column = u - true
    beyond = np.minimum.accumulate(column[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(true.shape, dtype=bool)
    hidden[:, :-1] = beyond[:, 1:] < column[:, :-1] - 0.5
    outside: BoolArray = column < -camera.size_px[0] / 2
    return hidden | outside


def _noise(mounted: Mounted, flaws: StereoFlaws, body: IntArray, seed: int, rng: np.random.Generator) -> FloatArray:
    """Return the noise of disparities over its standard deviation, shape (rows, columns)."""
    camera = mounted.camera
    shape, width = camera.pixels[0].shape, WINDOW_SIGMA_PX / camera.stride
    lasting = np.where(mounted.moving[body].reshape(shape), 0.0, flaws.lasting)
    noise: FloatArray = np.sqrt(lasting) * _smooth(shape, width, np.random.default_rng([seed, 7]))
    return noise + np.sqrt(1.0 - lasting) * _smooth(shape, width, rng)


def _smooth(shape: tuple[int, ...], sigma: float, rng: np.random.Generator) -> FloatArray:
    """Return Gaussian noise of unit variance, smoothed with a standard deviation of ``sigma`` cells."""
    blurred = cv2.GaussianBlur(rng.normal(size=shape), (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
    kernel = cv2.getGaussianKernel(int(8 * sigma) | 1, sigma)
    # The variance of a weighted sum of independent numbers is the sum of the squared weights.
    return np.asarray(blurred, dtype=np.float64) / float((kernel**2).sum())
