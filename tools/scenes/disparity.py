"""A stereo camera without images: true depth along pixels' rays, and what block matching makes of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import cv2
import numpy as np

from laci_stereo.core.frames import BoolArray, FloatArray, IntArray
from laci_stereo.stereo.recording import POINTING_SIGMA_PX
from laci_stereo.stereo.scene import BLEED_PX
from laci_stereo.stereo.settings import StereoSettings
from tools.scenes.geometry import Body, Hits, Material, RayCaster

StereoName = Literal["stereo_02", "stereo_05", "stereo_10"]
STEREOS: tuple[StereoName, ...] = get_args(StereoName)

EDGE_PX = 8
"""Windows reach so far: nearer to the image's border they are cut off."""

JUMP_PX = 1.5
"""A larger step of disparity between neighbouring rays is a border between two surfaces."""

UNTEXTURED = {
    Material.ROAD: 0.15,
    Material.PAINT: 0.1,
    Material.KERB: 0.15,
    Material.GRASS: 0.03,
    Material.WALL: 0.3,
    Material.FOLIAGE: 0.02,
    Material.METAL: 0.4,
    Material.CAR_PAINT: 0.45,
    Material.GLASS: 0.6,
    Material.TYRE: 0.4,
    Material.CLOTH: 0.3,
    Material.LAMP: 0.3,
}
"""Share of a surface that block matching leaves open: as the tool's own matcher does on rendered images, roughly."""

LEAST_SIGMA_PX = 0.02
"""What is told of the noise even where there is none."""

GLOSSY = 0.3
"""Of the glass that is matched, so much shows what it mirrors."""


@dataclass(frozen=True)
class StereoCamera:
    """A rectified pair; axes are OpenCV's.

    Attributes
    ----------
    name : StereoName
    baseline_m, focal_px : float
    size_px : tuple of int
    stride : int
        A ray for every pixel so far apart, in both directions.
    period_s : float
    """

    name: StereoName
    baseline_m: float
    focal_px: float
    size_px: tuple[int, int] = (1280, 720)
    stride: int = 3
    period_s: float = 0.1

    @cached_property
    def pixels(self) -> tuple[FloatArray, FloatArray]:
        """Column and row of each ray's pixel from the principal point, shape (rows, columns)."""
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

    def sees(self, points: FloatArray) -> BoolArray:
        """Tell which points, shape (n, 3), in the sensor frame, are in the field of view."""
        depth = np.maximum(points[:, 2], 1e-6)
        seen: BoolArray = points[:, 2] > 0.5
        for axis, extent in enumerate(self.size_px):
            seen &= np.abs(points[:, axis] / depth) < extent / 2 / self.focal_px
        return seen


def stereo_camera(name: StereoName, focal_px: float = 1100.0) -> StereoCamera:
    """Return a camera with a baseline of 0.2, 0.5 or 1 m."""
    return StereoCamera(name, {"stereo_02": 0.2, "stereo_05": 0.5, "stereo_10": 1.0}[name], focal_px)


@dataclass(frozen=True)
class StereoFlaws:
    """How disparities differ from the truth.

    Attributes
    ----------
    sigma_px : tuple of float
        Smallest and largest standard deviation of a disparity: the better the texture, the smaller.
    correlated : float
        Share of its variance that neighbours within a window have in common: windows of 11 px overlap.
    offset_px : float
        Of all disparities: rectification keeps 0.03 to 0.05 px.
    bleed_px : float
        By so much a near surface grows at its borders.
    gross : float
        Share of plain mismatches.
    """

    sigma_px: tuple[float, float] = (0.1, 0.25)
    correlated: float = 0.6
    offset_px: float = 0.0
    bleed_px: float = 2.0
    gross: float = 0.004


@dataclass(frozen=True)
class Matched:
    """A frame of disparities.

    Attributes
    ----------
    disparity_px, sigma_px : ndarray, shape (rows, columns)
        NaN where nothing is matched.
    moving : ndarray of bool, shape (rows, columns)
        Near to what moves.
    body : ndarray of int64, shape (rows, columns)
        What each ray truly meets; -1 for nothing.
    """

    disparity_px: FloatArray
    sigma_px: FloatArray
    moving: BoolArray
    body: IntArray


def match_frame(
    camera: StereoCamera,
    flaws: StereoFlaws,
    caster: RayCaster,
    T_world_sensor: FloatArray,
    time_s: float,
    seed: tuple[int, int],
) -> Matched:
    """Simulate the disparities of the frame at ``time_s``.

    Parameters
    ----------
    camera : StereoCamera
    flaws : StereoFlaws
    caster : RayCaster
    T_world_sensor : ndarray, shape (4, 4)
    time_s : float
    seed : tuple of int
        Of the scene and of the frame.
    """
    rng = np.random.default_rng(seed)
    shape = camera.pixels[0].shape
    lengths = np.linalg.norm(camera.rays, axis=1)
    directions = (camera.rays / lengths[:, None]) @ T_world_sensor[:3, :3].T
    hits = caster.cast(T_world_sensor[:3, 3], directions, time_s)
    true = (camera.focal_px * camera.baseline_m * lengths / hits.distance_m).reshape(shape)
    moved = np.array([*map(_moves, caster.bodies), False])[hits.body].reshape(shape)
    texture = _texture(caster, hits, shape, seed[0], rng)
    matched = _bled(true, flaws.bleed_px / camera.stride, rng)
    low, high = flaws.sigma_px
    sigma = low + (high - low) * (1.0 - texture)
    # Both images' near surfaces grow, so what has grown passes the check from right to left.
    hidden = _occluded(camera, true) & (matched <= true + JUMP_PX)
    open_ = _open(caster, hits, texture, shape) | hidden | (true <= 0.5)
    values = matched + flaws.offset_px + sigma * _noise(shape, flaws.correlated, camera.stride, rng)
    glass = _of_material(caster, hits, Material.GLASS).reshape(shape)
    gross = (rng.random(shape) < flaws.gross) | (glass & (rng.random(shape) < GLOSSY))
    values = np.where(gross, values * rng.uniform(0.3, 1.2, shape), values)
    reach = 2 * (BLEED_PX // camera.stride) + 1
    moving = cv2.dilate(moved.astype(np.uint8), np.ones((reach, reach), np.uint8)) > 0
    known = ~open_ & (values > sigma) & (sigma <= StereoSettings().max_disparity_sigma_px)
    body = hits.body.reshape(shape)
    told = np.maximum(sigma, LEAST_SIGMA_PX)
    return Matched(np.where(known, values, np.nan), np.where(known, told, np.nan), moving, body)


def reproject(
    camera: StereoCamera, matched: Matched, where: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Return points, their noise along and across the line of sight, and whether they are at the border.

    Parameters
    ----------
    camera : StereoCamera
    matched : Matched
    where : ndarray of bool, shape (rows, columns)
        Only these pixels.
    """
    keep = np.isfinite(matched.disparity_px) & where
    d, sigma = matched.disparity_px[keep], matched.sigma_px[keep]
    u, v = (axis[keep] for axis in camera.pixels)
    depth = camera.focal_px * camera.baseline_m / d
    points = camera.rays[keep.ravel()] * depth[:, None]
    width, height = camera.size_px
    edge = (np.abs(u) > width / 2 - EDGE_PX) | (np.abs(v) > height / 2 - EDGE_PX) | (u - d < EDGE_PX - width / 2)
    along = np.linalg.norm(points, axis=1) * sigma / d
    return points, along, depth * (POINTING_SIGMA_PX / camera.focal_px), edge


def _moves(body: Body) -> bool:
    """Tell whether a body shows as a change; swaying leaves do all the time, which a camera takes for noise."""
    return not body.static and not bool((body.mesh.material == Material.FOLIAGE).any())


def _of_material(caster: RayCaster, hits: Hits, material: Material) -> BoolArray:
    found = np.zeros(len(hits.body), dtype=bool)
    for index in np.unique(hits.body[hits.body >= 0]):
        here = np.flatnonzero(hits.body == index)
        found[here] = caster.bodies[index].mesh.material[hits.triangle[here]] == material
    return found


def _texture(
    caster: RayCaster, hits: Hits, shape: tuple[int, ...], seed: int, rng: np.random.Generator
) -> FloatArray:  # fmt: skip
    """Return how well each pixel can be matched, 0 to 1: half of it belongs to the surface, half to the view."""
    own = np.zeros(len(hits.body))
    for index in np.unique(hits.body[hits.body >= 0]):
        here = np.flatnonzero(hits.body == index)
        faces = len(caster.bodies[index].mesh.material)
        own[here] = np.random.default_rng([seed, int(index)]).random(faces)[hits.triangle[here]]
    view = _smooth(shape, 4, rng)
    # The normal distribution's own function would be exact; this is within 2 %.
    rank = 1.0 / (1.0 + np.exp(-1.7 * view))
    mixed: FloatArray = (own.reshape(shape) + rank) / 2
    return mixed


def _open(caster: RayCaster, hits: Hits, texture: FloatArray, shape: tuple[int, ...]) -> BoolArray:
    """Tell where there is too little texture: the mean of two uniform numbers has the triangular distribution."""
    share = np.ones(len(hits.body))  # the sky has none
    table = np.array([UNTEXTURED[material] for material in Material])
    for index in np.unique(hits.body[hits.body >= 0]):
        here = np.flatnonzero(hits.body == index)
        share[here] = table[caster.bodies[index].mesh.material[hits.triangle[here]]]
    limit = np.where(share < 0.5, np.sqrt(share / 2), 1 - np.sqrt((1 - share) / 2))
    return texture < limit.reshape(shape)


def _bled(true: FloatArray, cells: float, rng: np.random.Generator) -> FloatArray:
    """Let near surfaces grow by so many cells of the grid, at random where it is a part of one."""
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
    """Tell which pixels the right camera does not see: something to their right lies before them there."""
    u = camera.pixels[0]
    column = u - true
    beyond = np.minimum.accumulate(column[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(true.shape, dtype=bool)
    hidden[:, :-1] = beyond[:, 1:] < column[:, :-1] - 0.5
    outside: BoolArray = column < -camera.size_px[0] / 2
    return hidden | outside


def _noise(shape: tuple[int, ...], correlated: float, stride: int, rng: np.random.Generator) -> FloatArray:
    common = _smooth(shape, max(11 / stride / 3, 0.5), rng)
    mixed: FloatArray = np.sqrt(correlated) * common + np.sqrt(1 - correlated) * rng.normal(size=shape)
    return mixed


def _smooth(shape: tuple[int, ...], sigma: float, rng: np.random.Generator) -> FloatArray:
    """Return Gaussian noise of unit variance that is smooth over ``sigma`` cells."""
    blurred = cv2.GaussianBlur(rng.normal(size=shape), (0, 0), sigma, borderType=cv2.BORDER_REFLECT)
    kernel = cv2.getGaussianKernel(int(8 * sigma) | 1, sigma)
    # The variance of a sum of independent numbers is the sum of the squared weights.
    return np.asarray(blurred, dtype=np.float64) / float((kernel**2).sum())
