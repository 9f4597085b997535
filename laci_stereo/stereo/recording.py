"""A stereo recording as a source of point clouds; only image regions that can show moving objects are matched."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TypeVar

import cv2
import numpy as np

from laci_stereo.core.cloud import PointCloud, empty_cloud
from laci_stereo.core.errors import ImageError, SettingError
from laci_stereo.core.frames import OPENCV_AXES, Axes, BoolArray, FloatArray, IntArray, Raster
from laci_stereo.core.ground.plane import fit_ground
from laci_stereo.core.settings import GroundSettings
from laci_stereo.core.subsampling import spread
from laci_stereo.io.ahead import map_ahead, workers
from laci_stereo.io.images import StereoPair
from laci_stereo.io.rig.stereo_rig import StereoRig
from laci_stereo.mask.apply import Moving, windows
from laci_stereo.mask.picture import Crop
from laci_stereo.mask.stage import GlimpseRays, VehicleMask
from laci_stereo.stereo.disparity import LARGEST_PX, Disparity, Region, check_matched, match
from laci_stereo.stereo.reader import GreyReader
from laci_stereo.stereo.rectify import Rectification, View, already_rectified, rectify, with_right_turned
from laci_stereo.stereo.scene import Look, RoadDisparity, learn_look, regions, shrink
from laci_stereo.stereo.settings import StereoSettings

log = logging.getLogger(__name__)

LOOK_FRAMES = 31
"""Number of frames from which the scene at rest is learnt (`learn_look`)."""

QUIET_FRAMES, FURTHER_FRAMES = 6, 4
"""Numbers of whole frames that are matched for the ground and the background. Frames with the least motion show most of
both; the further ones, spread over the recording, show the places where an object stood for a while in the former."""

SURVEY_STRIDE, SURVEY_PIXELS = 2, 2_800_000
"""Only every second pixel of a whole frame is used in both directions: adjacent pixels share the matching window. Of
images with more pixels than the second number, whole frames are matched at a size below it, or the survey would take
minutes and hundreds of megabytes for each: time grows with the cube of the width. Ground and background are then as
exact as those of a camera of 1.4 to 2.8 megapixels; what moves is matched at full size."""

COARSE_WIDTH = 480
"""Width to which a pair is downscaled for the first estimate of the road plane, pixels."""

NEAREST_M = 1.5
"""Least distance that is searched for disparities: no point is assumed nearer; the lowest supported mounting height is
1.5 m."""

POINTING_SIGMA_PX = 0.3
"""Standard deviation of a pixel's bearing: uniform distribution within the pixel."""

Item = TypeVar("Item")


@dataclass(frozen=True)
class Scene:
    """What is learnt from frames spread over the recording before the recording is streamed.

    Attributes
    ----------
    look : Look
    road : RoadDisparity
    surveyed : tuple of StereoPair
        Pairs with the least motion and some of the others; the whole frames of the survey.
    spare : tuple of StereoPair
        The remaining pairs, in ascending order of motion; they replace surveyed pairs that cannot be used.
    """

    look: Look
    road: RoadDisparity
    surveyed: tuple[StereoPair, ...]
    spare: tuple[StereoPair, ...]


@dataclass(frozen=True)
class Pixels:
    """Pixels of the rectified left image with a disparity.

    Attributes
    ----------
    v, u : ndarray of int, shape (n,)
        Row and column.
    d, sigma_px : ndarray, shape (n,)
        Disparity and its standard deviation, pixels.
    """

    v: IntArray
    u: IntArray
    d: FloatArray
    sigma_px: FloatArray


@dataclass(frozen=True)
class Changes:
    """The parts of a pair that differ from the scene at rest.

    Attributes
    ----------
    left : ndarray
        The left image, raw, as stored.
    regions : tuple of Region
    matched : Pixels
    """

    left: Raster
    regions: tuple[Region, ...]
    matched: Pixels


class StereoRecording:
    """Frames of a stereo camera (implements `PointCloudSource`).

    Parameters
    ----------
    pairs : sequence of StereoPair
        Ascending in time.
    rig : StereoRig
    settings : StereoSettings
    ground : GroundSettings
        Settings of the first estimate of the road plane, from which the disparity range follows.
    background : sequence of StereoPair or None
        Pairs without moving objects. None: they are searched for.
    mask : VehicleMask or None
        Reduces the moving points to those of vehicles; the survey is not masked.
    """

    kind = "stereo"

    def __init__(
        self,
        pairs: Sequence[StereoPair],
        rig: StereoRig,
        settings: StereoSettings | None = None,
        ground: GroundSettings | None = None,
        background: Sequence[StereoPair] | None = None,
        name: str = "stereo camera",
        mask: VehicleMask | None = None,
    ) -> None:
        self.name = name
        self.pairs = pairs
        self.settings = settings or StereoSettings()
        self.rig = with_right_turned(already_rectified(rig) if self.settings.rectified else rig, self.settings.turn_deg)
        _check_disparities(self.settings, self.rig)
        self.reader = GreyReader(self.rig)
        self._ground = ground or GroundSettings()
        self._background = background
        self.mask = mask
        self._threads = workers(self.settings.workers)

    @property
    def axes(self) -> Axes:
        """OpenCV's: x right, y down, z forward."""
        return OPENCV_AXES

    @property
    def span_ns(self) -> tuple[int, int]:
        """First and last stamp."""
        return self.pairs[0].stamp_ns, self.pairs[-1].stamp_ns

    @property
    def skipped(self) -> tuple[str, ...]:
        """The reason for each image that could not be used, one line each."""
        return tuple(self.reader.skipped[path] for path in sorted(self.reader.skipped))

    def __len__(self) -> int:
        return len(self.pairs)

    def __iter__(self) -> Iterator[PointCloud]:
        """Yield every frame, reduced to the points that differ from the scene at rest."""
        scene = self._scene
        if self.mask is None:
            yield from map_ahead(partial(self._moving_cloud, scene), self.pairs, self._threads)
        else:
            frames = map_ahead(partial(self._moving_pixels, scene, self.mask), self.pairs, self._threads)
            yield from self.mask.apply(frames, self.settings.refine_window_px // 2)
        self.reader.check([pair.images for pair in self.pairs])

    def survey(self) -> Iterator[PointCloud]:
        """Yield whole frames, subsampled: those that differ least from the scene at rest, and some others."""
        scene = self._scene
        clouds = list(map_ahead(self._whole_cloud, scene.surveyed, self._threads))
        clouds += map_ahead(self._whole_cloud, scene.spare[: clouds.count(None)], self._threads)
        yield from sorted((cloud for cloud in clouds if cloud is not None), key=lambda cloud: cloud.stamp_ns)

    def mask_rays(self, stamp_ns: int) -> GlimpseRays | None:
        """Return the mask's effect on a frame in its latest pass; None without a mask."""
        if self.mask is None:
            return None
        glimpse, plane = self.mask.tally.glimpses.get(stamp_ns), self.rectification
        return GlimpseRays() if glimpse is None else glimpse.as_rays(plane.rays_at, plane.size)

    @cached_property
    def rectification(self) -> Rectification:
        """The common image plane of both cameras."""
        return rectify(self.rig)

    def whole_region(self) -> Region:
        """Return the whole image as a region, with the disparities that can occur in it."""
        width, height = self.rectification.size
        return self._limited(Region(0, 0, width, height, *self._scene.road.range(0, 0, width, height)))

    @cached_property
    def _scene(self) -> Scene:
        candidates = spread(self.pairs if self._background is None else self._background, LOOK_FRAMES)
        self.reader.eight_bit.learn_from(pair.left for pair in spread(self.pairs, LOOK_FRAMES))
        read = [(pair, self._shrunken(pair)) for pair in candidates]
        self.reader.check([pair.images for pair in candidates])
        usable = [(pair, image) for pair, image in read if image is not None]
        look = learn_look([image for _, image in usable])
        ranked = [pair for pair, _ in sorted(usable, key=lambda item: float(look.changed(item[1]).mean()))]
        taken = surveyed(ranked, [pair.stamp_ns for pair in ranked])
        return Scene(look, self._first_look(ranked), tuple(taken), tuple(pair for pair in ranked if pair not in taken))

    def _shrunken(self, pair: StereoPair) -> Raster | None:
        image = self.reader.read(pair.left)
        return None if image is None else shrink(self.rectification.left.look_up(image))

    def _first_look(self, pairs: Sequence[StereoPair]) -> RoadDisparity:
        """Fit the road plane to the first usable pair, downscaled, over every disparity that is possible at all."""
        plane = self.rectification
        pair, left, right = self._first_usable(pairs)
        factor = max(plane.size[0] // COARSE_WIDTH, 1)
        small = (plane.size[0] // factor, plane.size[1] // factor)
        largest = min(int(plane.focal_px * plane.baseline_m / NEAREST_M / factor), small[0])
        images = [
            cv2.resize(view.look_up(image), small, interpolation=cv2.INTER_AREA)
            for view, image in ((plane.left, left), (plane.right, right))
        ]
        disparity = self._matched_small(images, Region(0, 0, *small, 0, largest))
        check_matched(disparity, self.pairs[0].left.parent, images, self.settings)
        seen = np.ones(disparity.values.shape, dtype=bool)
        cloud = self._points(pair.stamp_ns, self._enlarged(disparity, seen, factor), factor)
        up, settings = self.axes.up, self._ground.any_support
        ground = fit_ground(cloud.points, cloud.sigma_along_m, cloud.sigma_across_m, up, settings, cloud.window_rad)
        log.info("first look: the camera hangs %.2f m over the road", ground.height_m)
        return RoadDisparity.of(ground, plane)

    def _first_usable(self, pairs: Sequence[StereoPair]) -> tuple[StereoPair, Raster, Raster]:
        for pair in pairs:
            left, right = self.reader.read(pair.left), self.reader.read(pair.right)
            if left is not None and right is not None:
                return pair, left, right
        self.reader.check([pair.images for pair in pairs])
        raise ImageError(self.reader.first_complaint())

    def _whole_cloud(self, pair: StereoPair) -> PointCloud | None:
        left, right = self.reader.read(pair.left), self.reader.read(pair.right)
        if left is None or right is None:
            return None
        plane, region = self.rectification, self.whole_region()
        factor = math.ceil(math.sqrt(plane.size[0] * plane.size[1] / SURVEY_PIXELS))
        if factor == 1:
            seen = np.zeros(plane.size[::-1], dtype=bool)
            seen[::SURVEY_STRIDE, ::SURVEY_STRIDE] = True
            return self._points(pair.stamp_ns, self._matched(left, right, [region], seen))
        # Means of an odd number of pixels lie in the middle of one, as those of an even number do not.
        first, mean = factor // 2, (factor // 2 * 2 + 1,) * 2
        images = [
            np.ascontiguousarray(cv2.blur(view.look_up(image, to_match=True), mean)[first::factor, first::factor])
            for view, image in ((plane.left, left), (plane.right, right))
        ]
        height, width = images[0].shape
        seen = np.zeros((height, width), dtype=bool)
        seen[::SURVEY_STRIDE, ::SURVEY_STRIDE] = True
        small = Region(0, 0, width, height, region.smallest // factor, -(-region.largest // factor))
        return self._points(pair.stamp_ns, self._enlarged(self._matched_small(images, small), seen, factor), factor)

    def _matched_small(self, images: Sequence[Raster], region: Region) -> Disparity:
        """Match two whole images, downscaled and rectified."""
        left, right = (cv2.copyMakeBorder(image, 0, 0, region.reach, 0, cv2.BORDER_REPLICATE) for image in images)
        return match(left, right, region, self.settings)

    def _enlarged(self, disparity: Disparity, seen: BoolArray, factor: int) -> Pixels:
        """Return the usable ones of some pixels of an image that was downscaled, as they would be at full size."""
        v, u = np.nonzero(np.isfinite(disparity.values) & seen)
        values, sigma_px = disparity.values[v, u], disparity.sigma[v, u]
        return self._usable(
            Pixels(v * factor + factor // 2, u * factor + factor // 2, values * factor, sigma_px * factor)
        )

    def _moving_cloud(self, scene: Scene, pair: StereoPair) -> PointCloud:
        seen = self._changes(scene, pair)
        return empty_cloud(pair.stamp_ns) if seen is None else self._points(pair.stamp_ns, seen.matched)

    def _moving_pixels(self, scene: Scene, mask: VehicleMask, pair: StereoPair) -> Moving | int:
        """Return the moving points with their pixels and image crops; only the stamp if nothing moves."""
        seen = self._changes(scene, pair)
        if seen is None:
            return pair.stamp_ns
        pixels = seen.matched
        road = scene.road.row @ np.stack([pixels.u, pixels.v, np.ones(len(pixels.u))])
        image = self.reader.eight_bit.colour(seen.left)
        rectangles = [(region.x0, region.y0, region.x1, region.y1) for region in seen.regions]
        crops = [
            Crop(pair.stamp_ns, x0, y0, self.rectification.left.look_up(image, slice(y0, y1), slice(x0, x1)))
            for x0, y0, x1, y1 in windows(rectangles, self.rectification.size, mask.finder.least_px)
        ]
        return Moving(
            self._points(pair.stamp_ns, pixels),
            pixels.u,
            pixels.v,
            (pixels.d - road) / pixels.sigma_px,
            scene.road.height_m * (1.0 - road / pixels.d),
            tuple(crops),
        )

    def _changes(self, scene: Scene, pair: StereoPair) -> Changes | None:
        """Match what differs from the scene at rest; None if nothing differs or an image cannot be used."""
        raw = self.reader.raw(pair.left)
        if raw is None:
            return None
        left = self.reader.eight_bit.grey(raw)
        changed = scene.look.changed(shrink(self.rectification.left.look_up(left)))
        found = [self._limited(region) for region in regions(changed, self.rectification.size, scene.road)]
        if not found:
            return None
        right = self.reader.read(pair.right)
        if right is None:
            return None
        seen = cv2.resize(changed.astype(np.uint8), self.rectification.size, interpolation=cv2.INTER_NEAREST) > 0
        return Changes(raw, tuple(found), self._matched(left, right, found, seen))

    def _limited(self, region: Region) -> Region:
        """Apply the user's disparity range; without one, exclude disparities of points nearer than `NEAREST_M`."""
        if self.settings.disparities is not None:
            return replace(region, smallest=self.settings.disparities[0], largest=self.settings.disparities[1])
        nearest = int(self.rectification.focal_px * self.rectification.baseline_m / NEAREST_M)
        largest = min(region.largest, nearest, region.x1, LARGEST_PX)
        return replace(region, smallest=min(region.smallest, largest), largest=largest)

    def _matched(self, left: Raster, right: Raster, found: Sequence[Region], seen: BoolArray) -> Pixels:
        parts = []
        for region in found:
            disparity = match(
                with_context(self.rectification.left, left, region),
                with_context(self.rectification.right, right, region),
                region,
                self.settings,
            )
            v, u = np.nonzero(np.isfinite(disparity.values) & seen[region.y0 : region.y1, region.x0 : region.x1])
            parts.append((v + region.y0, u + region.x0, disparity.values[v, u], disparity.sigma[v, u]))
        return self._usable(Pixels(*(np.concatenate(part) for part in zip(*parts, strict=True))))

    def _usable(self, pixels: Pixels) -> Pixels:
        """Return the pixels that both cameras see and whose disparity exceeds its standard deviation."""
        plane = self.rectification
        u_right = np.rint(pixels.u - pixels.d).astype(np.int64)
        # A disparity within its noise of zero allows any distance, even one that overflows.
        usable = (pixels.d > pixels.sigma_px) & (u_right >= 0) & plane.left.valid[pixels.v, pixels.u]
        usable &= plane.right.valid[pixels.v, u_right.clip(0)]
        return Pixels(pixels.v[usable], pixels.u[usable], pixels.d[usable], pixels.sigma_px[usable])

    def _points(self, stamp_ns: int, pixels: Pixels, factor: int = 1) -> PointCloud:
        """Reproject pixels with a disparity into space: depth = f b / d along the pixel's ray.

        ``factor`` is that by which the images were downscaled for matching.
        """
        plane = self.rectification
        v, u, d = pixels.v, pixels.u, pixels.d
        depth = plane.focal_px * plane.baseline_m / d
        points = plane.rays_at(v, u) * depth[:, None]
        inner = plane.left.inner[v, u] & plane.right.inner[v, np.rint(u - d).astype(np.int64)]
        return PointCloud(
            stamp_ns,
            points,
            sigma_along_m=np.linalg.norm(points, axis=1) * pixels.sigma_px / d,
            sigma_across_m=depth * (POINTING_SIGMA_PX / plane.focal_px),
            at_edge=~inner,
            window_rad=factor * self.settings.refine_window_px / plane.focal_px,
            cameras=plane.cameras,
        )


def _check_disparities(settings: StereoSettings, rig: StereoRig) -> None:
    width, _ = rig.left.size
    if settings.disparities is not None and settings.disparities[1] >= width:
        smallest, largest = settings.disparities
        raise SettingError(f"disparities are {smallest}..{largest}; needed is less than the images' width, {width}")
    if settings.disparities is not None and settings.disparities[1] > LARGEST_PX:
        smallest, largest = settings.disparities
        raise SettingError(
            f"disparities are {smallest}..{largest}; needed are at most {LARGEST_PX}, as OpenCV returns no more: "
            "make the images and their calibration smaller"
        )


def surveyed(ranked: Sequence[Item], stamps: Sequence[int]) -> list[Item]:
    """Take the first `QUIET_FRAMES` items, and `FURTHER_FRAMES` of the others, uniformly spaced in time.

    Parameters
    ----------
    ranked : sequence
        In ascending order of motion.
    stamps : sequence of int
        The stamp of each item.

    Returns
    -------
    list
        In order of time.
    """
    ordered = sorted(range(len(ranked)), key=lambda index: stamps[index])
    others = [index for index in ordered if index >= QUIET_FRAMES]
    taken = {*range(min(QUIET_FRAMES, len(ranked))), *spread(others, FURTHER_FRAMES)}
    return [ranked[index] for index in ordered if index in taken]


def with_context(view: View, image: Raster, region: Region) -> Raster:
    """Rectify a region plus the columns to its left that the matcher needs; the image border is replicated outwards."""
    start = region.x0 - region.reach
    part = view.look_up(image, slice(region.y0, region.y1), slice(max(start, 0), region.x1), to_match=True)
    return cv2.copyMakeBorder(part, 0, 0, max(-start, 0), 0, cv2.BORDER_REPLICATE)
